"""The largest stable step of stiff servos, measured and by linear theory.

Arms of 1 to 7 links of the robot `arm7`, hanging, with AX-12 servos in three gearbox models; what varies is the number
of joints, the gear ratio, the inertia of the rotor and the gain.  For each integrator the study `stable_step` finds by
bisection the largest step with which the servos bring the arm to rest from 0.05 rad, where nothing clips, and from 0.5
rad, where voltage and current do at first; eight starts each, in lanes.  Next to it stands the step at which the linear
theory of `linear_stability` says the same.  Inductance, speed filter, slew limit and Coulomb friction are left
out, so that the theory is that of the simulated servo; its control is sampled, every 10 ms or every step of more.

Without `full` one quantity at a time differs from the AX-12 with seven joints; with it there are all combinations too,
which takes hours.  Finished runs are kept beside the table: started again, it goes on.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ..base.files import read_csv
from ..core.compile.jit import source_hash
from ..model import Model
from ..robot_file import load_robot, load_servo, save_robot
from ..study import read_study, run_study
from ..study.bisection import largest
from ..study.measures import LARGEST, SMALLEST
from ..study.table import TABLE
from ..view.style import COLOURS as LOOK_COLOURS
from ..view.style import look
from .linear_stability import growth, linearized
from .machine import machine
from .table import save_figure, write_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

JOINTS = (1, 2, 3, 5, 7)
RATIOS = (160.0, 200.0, 254.0, 320.0, 400.0)
INERTIAS = (1e-10, 1e-9, 1e-8, 1e-7, 1e-6)  # [kg m^2]
GAINS = (15.0, 30.0, 61.0, 122.0)  # [V/rad]
AX12: dict[str, Any] = {"ratio": 254.0, "rotor_inertia": 1e-7, "Kp": 61.0}
IDEAL: dict[str, Any] = {"inductance": 0.0, "speed_filter": 0.0, "current_slew": 1e9, "coulomb_friction": 0.0}
GEARBOXES = ("standard", "rotor", "mipsd")
INTEGRATORS = ("simtwo", "rk4", "midpoint", "implicit_euler")
TILTS = (0.05, 0.5)  # [rad]
DURATION = 8.0  # [s]
PERIOD = 0.01  # of the controllers [s]


class Point(NamedTuple):
    """What was run."""

    joints: int
    ratio: float
    rotor_inertia: float  # [kg m^2]
    Kp: float  # [V/rad]
    servos: str
    integrator: str
    tilt: float  # [rad]


class Found(NamedTuple):
    """Steps [s]: the largest that is stable and the smallest that is not, NaN where there is none; by linear theory."""

    stable: float
    unstable: float
    linear: float


def run(out_dir: Path, full: bool = False) -> dict[Point, Found]:
    """Run the studies; print the table, write stability.csv and stability.png into `out_dir`."""
    out_dir = Path(out_dir)
    folder = out_dir / f"stability_{source_hash()[:8]}"
    folder.mkdir(parents=True, exist_ok=True)
    measured: dict[Point, tuple[float, float]] = {}
    studies = slices() + (combinations() if full else [])
    for k, (name, joints, vary) in enumerate(studies, start=1):
        print(f"study {k} of {len(studies)}: {name}")
        measured |= _study(folder, name, joints, vary)
    found = {point: Found(*steps, linear_step(point)) for point, steps in measured.items()}
    host = machine()
    print(host)
    _print(found)
    _write(out_dir / "stability.csv", found, host)
    _plot(out_dir / "stability.png", found)
    return found


def slices() -> list[tuple[str, int, dict]]:
    """Studies (name, joints, what varies) through the AX-12 with seven joints."""
    rigid = {"scene.gearbox": GEARBOXES[1:]}
    return [
        *((f"joints{n}", n, {}) for n in JOINTS[:-1]),
        ("ratio", 7, {"servo.ratio": RATIOS}),
        ("rotor_inertia", 7, {"servo.rotor_inertia": INERTIAS, **rigid}),
        ("gain", 7, {"servo.Kp": GAINS}),
    ]


def combinations() -> list[tuple[str, int, dict]]:
    """Studies of all combinations; the standard model has no rotor."""
    both = {"servo.ratio": RATIOS[::2], "servo.Kp": GAINS[1:]}
    geared = both | {"servo.rotor_inertia": INERTIAS[1:], "scene.gearbox": GEARBOXES[1:]}
    return [
        study
        for n in JOINTS
        for study in ((f"standard{n}", n, both | {"scene.gearbox": GEARBOXES[:1]}), (f"geared{n}", n, geared))
    ]


@functools.cache
def arm(links: int) -> Model:
    """The first links of `arm7`, hanging at zero and without stops."""
    whole = load_robot("arm7")

    def hung(vector: tuple[float, float, float]) -> tuple[float, float, float]:
        return (vector[0], vector[1], -vector[2])

    bodies = (replace(link, center_of_mass=hung(link.center_of_mass)) for link in whole.links[: links + 1])
    free: dict[str, Any] = {"type": "continuous", "lower": -math.inf, "upper": math.inf}
    joints = (replace(joint, xyz=hung(joint.xyz), **free) for joint in whole.joints[:links])
    return Model(f"arm{links}", tuple(bodies), tuple(joints))


def _study(folder: Path, name: str, joints: int, vary: dict) -> dict[Point, tuple[float, float]]:
    """Write a study, run it and read its table."""
    save_robot(arm(joints), folder / f"arm{joints}.urdf")
    vary = {"scene.gearbox": GEARBOXES, "scene.integrator": INTEGRATORS, "posture.tilt": TILTS} | vary
    fixed = {key: value for key, value in (AX12 | IDEAL).items() if f"servo.{key}" not in vary}
    lines = [f'robot = "arm{joints}.urdf"', 'experiment = "stable_step"', f"duration = {DURATION}"]
    lines += ["[servo]", 'type = "ax12"', *(f"{key} = {value!r}" for key, value in fixed.items())]
    lines += ["[vary]", *(f"{key} = {_toml(values)}" for key, values in vary.items())]
    path = folder / f"{name}.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    outcome = run_study(read_study(path), folder, batch=2, progress=True)
    (_, header), *rows = read_csv(outcome.table, TABLE)
    return dict(_row(joints, dict(zip(header, row))) for _, row in rows)


def _toml(values: Iterable[str | float]) -> str:
    return "[" + ", ".join(f'"{v}"' if isinstance(v, str) else repr(v) for v in values) + "]"


def _row(joints: int, row: dict) -> tuple[Point, tuple[float, float]]:
    ratio, inertia, Kp = (float(row.get(f"servo.{key}", value)) for key, value in AX12.items())
    point = Point(joints, ratio, inertia, Kp, row["scene.gearbox"], row["scene.integrator"], float(row["posture.tilt"]))
    stable, unstable = (float(row[f"{name}_step_s"] or math.nan) for name in ("stable", "unstable"))
    return point, (stable, unstable)


def linear_step(point: Point) -> float:
    """The largest stable step of the linear theory [s], looked for as the measured one is; NaN if none is."""
    return _linear_step(point._replace(tilt=0.0))


@functools.cache
def _linear_step(point: Point) -> float:
    servo = load_servo("ax12", **IDEAL, ratio=point.ratio, rotor_inertia=point.rotor_inertia)
    linear = linearized(arm(point.joints), servo, point.servos)
    return largest(
        lambda h: growth(point.integrator, linear, point.Kp, h, PERIOD) < 1.0, SMALLEST, LARGEST, width=1.001
    )[0]


# ---------------------------------------------------------------------------------------------- output


def _print(found: dict[Point, Found]) -> None:
    """The points through the AX-12 with seven joints, and how far theory and measurement agree in all."""
    print(f"largest stable step [ms] +-1.5 %; > stable up to the largest tried, - not stable from {SMALLEST:g} s on")
    head = " ".join(f"{integrator:>26}" for integrator in INTEGRATORS)
    print(f"{'':44}{head}")
    names = f"{'joints':>6} {'ratio':>6} {'J [kg m^2]':>11} {'Kp [V/rad]':>11} {'model':9}"
    print(names + " " + " ".join(f"{'0.05 rad':>8} {'0.5 rad':>8} {'theory':>8}" for _ in INTEGRATORS))
    for scene in dict.fromkeys(point[:5] for point in found if _on_slice(point)):
        cells = []
        for integrator in INTEGRATORS:
            small, clipped = (found[Point(*scene, integrator, tilt)] for tilt in TILTS)
            cells += [_shown(small.stable), _shown(clipped.stable), _shown(small.linear)]
        n, ratio, inertia, Kp, servos = scene
        print(f"{n:6} {ratio:6.0f} {inertia:11.0e} {Kp:11.0f} {servos:9} " + " ".join(cells))
    print("measured by theory, smallest and largest of all points with both:")
    for servos, integrator in product(GEARBOXES, INTEGRATORS):
        texts = []
        for tilt in TILTS:
            ratios = _ratios(found, servos, integrator, tilt)
            texts.append(f"{tilt:g} rad {min(ratios):.3f} to {max(ratios):.3f} ({len(ratios)})" if ratios else "")
        print(f"  {servos:9} {integrator:15} " + "   ".join(texts))


def _ratios(found: dict[Point, Found], servos: str, integrator: str, tilt: float) -> list[float]:
    """Measured by linear step, where both lie within the steps tried."""
    chosen = [f for p, f in found.items() if (p.servos, p.integrator, p.tilt) == (servos, integrator, tilt)]
    return [math.sqrt(f.stable * f.unstable) / f.linear for f in chosen if f.stable < LARGEST and f.linear < LARGEST]


def _shown(step: float) -> str:
    if math.isnan(step):
        return f"{'-':>8}"
    return f"{('>' if step >= LARGEST else '') + format(1e3 * step, '.3g'):>8}"


def _on_slice(point: Point) -> bool:
    """Whether at most one quantity differs from the AX-12 with seven joints."""
    return sum(a != b for a, b in zip(point[:4], (7, *AX12.values()))) <= 1


def _write(path: Path, found: dict[Point, Found], notes: str) -> None:
    columns = ["joints", "ratio", "rotor_inertia_kg_m2", "Kp_V_rad", "gearbox", "integrator", "tilt_rad"]
    columns += ["stable_step_s", "unstable_step_s", "linear_step_s"]
    rows = ([*point, *("" if math.isnan(x) else x for x in steps)] for point, steps in found.items())
    write_table(path, columns, rows, notes)


COLOURS = dict(zip(("implicit_euler", "rk4", "midpoint", "simtwo"), LOOK_COLOURS))
SWEPT = {"joints": "joints", "ratio": "gear ratio", "rotor_inertia": "rotor inertia [kg m²]", "Kp": "gain [V/rad]"}
TITLES = {"standard": "standard: no rotor", "rotor": "rotor, rigid gearbox", "mipsd": "mipsd: rotor behind a spring"}


@look()
def _plot(path: Path, found: dict[Point, Found]) -> None:
    """A row for each gearbox model, a column for each quantity."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    panels = figure.subplots(len(GEARBOXES), len(SWEPT), sharey=True, sharex="col")
    for row, servos in zip(panels, GEARBOXES):
        for panel, swept in zip(row, SWEPT):
            if (servos, swept) == ("standard", "rotor_inertia"):
                _legend(panel)
            else:
                _panel(panel, found, servos, swept)
        row[0].set_ylabel(f"{TITLES[servos]}\nlargest stable step [ms]")
    for panel, swept in zip(panels[-1], SWEPT):
        panel.set_xlabel(SWEPT[swept])
    figure.suptitle(
        "Largest stable step of a hanging arm with AX-12 servos; unless varied: 7 joints, ratio 254, "
        "rotor $10^{-7}$ kg m², gain 61 V/rad",
        fontsize=11,
    )
    save_figure(figure, path)


def _panel(panel: Axes, found: dict[Point, Found], servos: str, swept: str) -> None:
    low, high = 1e3 * SMALLEST, 1e3 * LARGEST
    rest = [k for k, name in enumerate(SWEPT) if name != swept]
    through = (7, *AX12.values())
    for integrator, tilt in product(INTEGRATORS, TILTS):
        line = sorted(
            (getattr(p, swept), f)
            for p, f in found.items()
            if (p.servos, p.integrator, p.tilt) == (servos, integrator, tilt) and all(p[k] == through[k] for k in rest)
        )
        x, color = [value for value, _ in line], COLOURS[integrator]
        if tilt == TILTS[0]:
            panel.plot(x, [1e3 * f.linear for _, f in line], "-", color=color, linewidth=1.2)
        measured = [1e3 * math.sqrt(f.stable * f.unstable) if f.stable < LARGEST else math.nan for _, f in line]
        hollow: dict[str, Any] = {"markerfacecolor": "none" if tilt == TILTS[1] else color, "markeredgecolor": color}
        size = {0.05: 3.0, 0.5: 6.5}[tilt]
        panel.plot(x, measured, "o", markersize=size, linestyle="", **hollow)
        beyond = [value for value, f in line if f.stable >= LARGEST]
        none = [value for value, f in line if math.isnan(f.stable)]
        if beyond:  # marks that reach over the frame; an empty line of them would upset the layout
            panel.plot(beyond, [high] * len(beyond), "^", markersize=size, linestyle="", clip_on=False, **hollow)
        if none:
            panel.plot(none, [low] * len(none), "x", markersize=size, color="0.2", clip_on=False)
    panel.axhline(1e3 * PERIOD, color="0.6", linestyle=":", linewidth=1.0)
    panel.set(xscale="log", yscale="log", ylim=(0.8 * low, 1.25 * high))
    values = {"joints": JOINTS, "ratio": RATIOS, "rotor_inertia": INERTIAS, "Kp": GAINS}[swept]
    exponents = [f"$10^{{{math.log10(v):.0f}}}$" for v in values]
    panel.set_xticks(values, exponents if swept == "rotor_inertia" else [f"{v:g}" for v in values])
    panel.xaxis.minorticks_off()


def _legend(panel: Axes) -> None:
    from matplotlib.lines import Line2D

    panel.set_axis_off()
    gray: dict[str, Any] = {"color": "0.35", "linestyle": ""}
    handles = [Line2D([], [], color=COLOURS[name], label=name) for name in INTEGRATORS]
    handles += [
        Line2D([], [], color="0.35", label="linear theory"),
        Line2D([], [], marker="o", markersize=3, label="from 0.05 rad", **gray),
        Line2D([], [], marker="o", markersize=6.5, markerfacecolor="none", label="from 0.5 rad, clipped", **gray),
        Line2D([], [], marker="^", label="stable up to 100 ms", **gray),
        Line2D([], [], marker="x", label="no stable step", **gray),
        Line2D([], [], color="0.6", linestyle=":", label="controllers' period"),
    ]
    panel.legend(handles=handles, loc="center", fontsize=8.5).set_in_layout(False)
