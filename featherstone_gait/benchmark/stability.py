"""Find the largest stable step of stiff servos, measured and by linear theory.

Arms of 1 to 7 links of the robot `arm7`, hanging, have AX-12 servos in three gearbox models; the number of joints, the
gear ratio, the inertia of the rotor and the gain vary.  For each integrator the study `stable_step` finds by bisection
the largest step with which the servos bring the arm to rest from 0.05 rad, where nothing clips, and from 0.5 rad, where
voltage and current do at first; eight starts each, in lanes.  Beside it stands the largest stable step of linear theory
(`linear_stability.py`).  Inductance, speed filter, slew limit and Coulomb friction are left out, so that the theory is
that of the simulated servo.  Its control is sampled, every 10 ms or every step of more.

Without `full` one quantity at a time differs from the AX-12 with seven joints; with it all combinations run too, which
takes hours.  Finished runs are kept beside the table, so a later run continues.

    featherstone-gait benchmark stability        two minutes
"""

from __future__ import annotations

import functools
import json
import math
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from ..base.files import read_csv
from ..core.compile.jit import source_hash
from ..model import Model
from ..robot_file import load_robot, load_servo, save_robot
from ..study import read_study, run_study
from ..study.bisection import largest
from ..study.measures import LARGEST, SMALLEST
from ..study.table import TABLE
from ..view.style import COLORS as LOOK_COLORS
from ..view.style import look, subplots
from .linear_stability import growth, linearized
from .table import machine, save_figure, tabulate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

JOINTS = (1, 2, 3, 5, 7)
RATIOS = (160.0, 200.0, 254.0, 320.0, 400.0)
INERTIAS = (1e-10, 1e-9, 1e-8, 1e-7, 1e-6)  # [kg m^2]
GAINS = (15.0, 30.0, 61.0, 122.0)  # [V/rad]
AX12: dict[str, Any] = {"gearbox.ratio": 254.0, "gearbox.rotor_inertia": 1e-7, "servo.Kp": 61.0}
IDEAL: dict[str, Any] = {"inductance": 0.0, "speed_filter": 0.0, "current_slew": 1e9, "coulomb_friction": 0.0}
GEARBOXES = ("standard", "rotor", "mipsd")
INTEGRATORS = ("simtwo", "rk4", "midpoint", "implicit_euler")
TILTS = (0.05, 0.5)  # [rad]
DURATION = 8.0  # [s]
PERIOD = 0.01  # of the controllers [s]


class Point(NamedTuple):
    """A setting that was run."""

    joints: int
    ratio: float
    rotor_inertia: float  # [kg m^2]
    Kp: float  # [V/rad]
    gearbox: str
    integrator: str
    tilt: float  # [rad]


class Row(NamedTuple):
    """One line of the table; steps are NaN where there is none."""

    joints: Annotated[int, "joints", "6"]
    ratio: Annotated[float, "ratio", "6.0f"]
    rotor_inertia_kg_m2: Annotated[float, "J kg m^2", "9.0e"]
    Kp_V_rad: Annotated[float, "Kp V/rad", "8.0f"]
    gearbox: Annotated[str, "gearbox", "<9"]
    integrator: Annotated[str, "integrator", "<15"]
    tilt_rad: Annotated[float, "tilt rad", "8g"]
    stable_step_s: Annotated[float, "stable s", "9.3g"]  # the largest that is stable
    unstable_step_s: Annotated[float, "unstable s", "10.3g"]  # the smallest that is not
    linear_step_s: Annotated[float, "theory s", "9.3g"]  # the largest that is stable by linear theory

    @property
    def point(self) -> Point:
        return Point(*self[:7])

    @property
    def measured(self) -> float:
        """Geometric mean of the stable and the unstable step [s]."""
        return math.sqrt(self.stable_step_s * self.unstable_step_s)


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Run the studies; print the table, write stability.csv and stability.png into `out_dir`."""
    folder = out_dir / f"stability_{source_hash()[:8]}"
    folder.mkdir(parents=True, exist_ok=True)
    found: dict[Point, Row] = {}
    studies = slices() + (combinations() if full else [])
    for k, (name, joints, vary) in enumerate(studies, start=1):
        print(f"study {k} of {len(studies)}: {name}")
        found |= {row.point: row for row in _study(folder, name, joints, vary)}
    host = machine()
    print(f"{host}\nthe largest stable step of those from {SMALLEST:g} to {LARGEST:g} s, +-1.5 %")
    rows = tabulate(out_dir / "stability.csv", Row, found.values(), host)
    _print_ratios(rows)
    _plot(out_dir / "stability.png", rows)
    return rows


def slices() -> list[tuple[str, int, dict]]:
    """List studies (name, joints, what varies) through the AX-12 with seven joints."""
    rigid = {"scene.gearbox": GEARBOXES[1:]}
    return [
        *((f"joints{n}", n, {}) for n in JOINTS[:-1]),
        ("ratio", 7, {"gearbox.ratio": RATIOS}),
        ("rotor_inertia", 7, {"gearbox.rotor_inertia": INERTIAS, **rigid}),
        ("gain", 7, {"servo.Kp": GAINS}),
    ]


def combinations() -> list[tuple[str, int, dict]]:
    """List studies of all combinations; the standard model has no rotor."""
    both = {"gearbox.ratio": RATIOS[::2], "servo.Kp": GAINS[1:]}
    geared = both | {"gearbox.rotor_inertia": INERTIAS[1:], "scene.gearbox": GEARBOXES[1:]}
    return [
        study
        for n in JOINTS
        for study in ((f"standard{n}", n, both | {"scene.gearbox": GEARBOXES[:1]}), (f"geared{n}", n, geared))
    ]


@functools.cache
def arm(links: int) -> Model:
    """Return the first links of `arm7`, hanging at zero and without stops."""
    whole = load_robot("arm7")

    def hung(vector: tuple[float, float, float]) -> tuple[float, float, float]:
        return (vector[0], vector[1], -vector[2])

    bodies = (replace(link, center_of_mass=hung(link.center_of_mass)) for link in whole.links[: links + 1])
    free: dict[str, Any] = {"type": "continuous", "lower": -math.inf, "upper": math.inf}
    joints = (replace(joint, xyz=hung(joint.xyz), **free) for joint in whole.joints[:links])
    return Model(f"arm{links}", tuple(bodies), tuple(joints))


def _study(folder: Path, name: str, joints: int, vary: dict) -> list[Row]:
    """Write a study, run it and read its table."""
    save_robot(arm(joints), folder / f"arm{joints}.urdf")
    vary = {"scene.gearbox": GEARBOXES, "scene.integrator": INTEGRATORS, "posture.tilt": TILTS} | vary
    fixed = AX12 | {f"servo.{key}": value for key, value in IDEAL.items()}
    lines = [f'robot = "arm{joints}.urdf"', 'experiment = "stable_step"', f"duration = {DURATION}"]
    lines += ['servo.type = "ax12"', *(f"{key} = {value!r}" for key, value in fixed.items() if key not in vary)]
    lines += ["[vary]", *(f"{key} = {json.dumps(values)}" for key, values in vary.items())]
    path = folder / f"{name}.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    outcome = run_study(read_study(path), folder, batch=2, progress=True)
    (_, header), *rows = read_csv(outcome.table, TABLE)
    return [_row(joints, dict(zip(header, row))) for _, row in rows]


def _row(joints: int, row: dict) -> Row:
    ratio, inertia, Kp = (float(row.get(key, value)) for key, value in AX12.items())
    gearbox, integrator, tilt = row["scene.gearbox"], row["scene.integrator"], float(row["posture.tilt"])
    point = Point(joints, ratio, inertia, Kp, gearbox, integrator, tilt)
    stable, unstable = (float(row[f"{name}_step_s"] or math.nan) for name in ("stable", "unstable"))
    return Row(*point, stable, unstable, linear_step(point))


def linear_step(point: Point) -> float:
    """Return the largest stable step by linear theory [s], found by the same bisection; NaN if there is none."""
    return _linear_step(point._replace(tilt=0.0))


@functools.cache
def _linear_step(point: Point) -> float:
    servo = load_servo("ax12", **IDEAL, ratio=point.ratio, rotor_inertia=point.rotor_inertia)
    linear = linearized(arm(point.joints), servo, point.gearbox)
    return largest(
        lambda h: growth(point.integrator, linear, point.Kp, h, PERIOD) < 1.0, SMALLEST, LARGEST, width=1.001
    )[0]


def _print_ratios(rows: list[Row]) -> None:
    """Print how far theory and measurement agree."""
    print("measured by theory, smallest and largest of all points with both:")
    for gearbox, integrator, tilt in product(GEARBOXES, INTEGRATORS, TILTS):
        chosen = [row for row in rows if (row.gearbox, row.integrator, row.tilt_rad) == (gearbox, integrator, tilt)]
        ratios = [row.measured / row.linear_step_s for row in chosen
                  if row.stable_step_s < LARGEST and row.linear_step_s < LARGEST]  # fmt: skip
        if ratios:
            print(f"  {gearbox:9} {integrator:15} {tilt:g} rad {min(ratios):.3f} to {max(ratios):.3f} ({len(ratios)})")


COLORS = dict(zip(("implicit_euler", "rk4", "midpoint", "simtwo"), LOOK_COLORS))
SWEPT = {"joints": "joints", "ratio": "gear ratio", "rotor_inertia": "rotor inertia [kg m²]", "Kp": "gain [V/rad]"}
TITLES = {"standard": "standard: no rotor", "rotor": "rotor, rigid gearbox", "mipsd": "mipsd: rotor behind a spring"}


@look()
def _plot(path: Path, rows: list[Row]) -> None:
    """Draw a row for each gearbox model, a column for each quantity."""
    figure, panels = subplots(11.0, 8.0, len(GEARBOXES), len(SWEPT), sharey=True, sharex="col")
    for line, gearbox in zip(panels, GEARBOXES):
        for panel, swept in zip(line, SWEPT):
            if (gearbox, swept) == ("standard", "rotor_inertia"):
                panel.set_axis_off()
                panel.legend(*panels[0][0].get_legend_handles_labels(), loc="center", fontsize=8).set_in_layout(False)
            else:
                _panel(panel, rows, gearbox, swept)
        line[0].set_ylabel(f"{TITLES[gearbox]}\nlargest stable step [ms]")
    for panel, swept in zip(panels[-1], SWEPT):
        panel.set_xlabel(SWEPT[swept])
    figure.suptitle(
        "Largest stable step of a hanging arm with AX-12 servos; unless varied: 7 joints, ratio 254, "
        "rotor $10^{-7}$ kg m², gain 61 V/rad",
        fontsize=11,
    )
    save_figure(figure, path)


def _panel(panel: Axes, rows: list[Row], gearbox: str, swept: str) -> None:
    """Draw one quantity; the upper edge means stable at all steps tried, the lower edge at none."""
    low, high, through = 1e3 * SMALLEST, 1e3 * LARGEST, (7, *AX12.values())
    rest = [k for k, name in enumerate(SWEPT) if name != swept]
    for integrator, tilt in product(INTEGRATORS, TILTS):
        chosen = [row for row in rows if row[4:7] == (gearbox, integrator, tilt)]
        line = sorted(row for row in chosen if all(row[k] == through[k] for k in rest))
        x, color = [getattr(row.point, swept) for row in line], COLORS[integrator]
        if tilt == TILTS[0]:
            theory = [1e3 * row.linear_step_s for row in line]
            panel.plot(x, theory, "-", color=color, linewidth=1.2, label=f"{integrator}, linear theory")
        y = [high if row.stable_step_s >= LARGEST else low if row.stable_step_s != row.stable_step_s
             else 1e3 * row.measured for row in line]  # fmt: skip
        fill, size = (color, 3.0) if tilt == TILTS[0] else ("none", 6.5)
        panel.plot(x, y, "o", markersize=size, markerfacecolor=fill, color=color, clip_on=False,
                   label=f"from {tilt:g} rad")  # fmt: skip
    panel.axhline(1e3 * PERIOD, color="0.6", linestyle=":", linewidth=1.0, label="controllers' period")
    panel.set(xscale="log", yscale="log", ylim=(low, high))
    values = {"joints": JOINTS, "ratio": RATIOS, "rotor_inertia": INERTIAS, "Kp": GAINS}[swept]
    panel.set_xticks(values, [f"{value:g}" for value in values])
    panel.xaxis.minorticks_off()
