"""The complete humanoid holds still: motion of four of its joints (Lima et al. 2013, Table 3, Figs. 12 and 13).

The paper holds a static posture with the standard model and with motor inertia plus spring-damper (MIPSD) and gives the
largest and smallest angle and the standard deviation of four joints.  It does not state whether the robot stands or its
trunk is fixed, which controller and gains it has, or how long it runs.  Its numbers give hints on two of these.

Controller: under the AX-12's law, a voltage proportional to the error, the joints droop under their load, here by 0.3
to 0.5 deg.  The paper's MIPSD values lie within 0.05 deg around the references, so something removed the droop:
integral action, which the program has and which is used here, or some gravity compensation.  Both laws are simulated.

Base: by default the program puts a robot on the ground; both bases are simulated.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from ..model import Base, Ground, Model
from ..robot_file import load_robot
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate_batch, standing_state
from ..scene.compile import CompiledScene, GearboxKind, IntegratorName, compile_scene
from ..view.style import BLUE, ORANGE, look
from .claim import Claim, Verdict, classify, question, within
from .common import (
    ENCODER_STEP,
    EXPLICIT,
    IMPLICIT,
    INTEGRATOR_NAMES,
    LINE_STYLES,
    SERVO_COLORS,
    in_threads,
    scale_masses,
    subplots,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Joint -> reference [deg] and the paper's largest angle, smallest angle, standard deviation [deg] with each model; the
# joints of the robot carry the names and signs of the paper's table.
TABLE_3 = {
    "left_lateral_shoulder": (-45.0, {"standard": (-45.06, -47.21, 0.39), "mipsd": (-44.96, -45.04, 0.01)}),
    "right_front_shoulder": (25.0, {"standard": (25.00, 24.13, 0.16), "mipsd": (25.04, 24.97, 0.01)}),
    "right_lateral_shoulder": (25.0, {"standard": (26.60, 24.15, 0.50), "mipsd": (25.03, 24.96, 0.01)}),
    "left_elbow": (45.0, {"standard": (48.40, 44.19, 0.84), "mipsd": (45.05, 44.95, 0.01)}),
}
JOINTS = tuple(TABLE_3)
FACTOR = 3.0  # within which a deviation counts as the same: masses and gains are unknown
GEARBOXES: tuple[GearboxKind, ...] = ("standard", "mipsd")
INTEGRATORS: tuple[IntegratorName, ...] = (EXPLICIT, IMPLICIT)
BASES: tuple[Base, ...] = ("floating", "fixed")
P = math.inf  # integral time of the proportional law [s]
INTEGRAL_TIME = 1.0  # [s]; with a third of it the standing robot sways ever more and falls, with every model
SHORT_INTEGRAL_TIME = 0.3  # [s]
DRAWS = 3  # sets of initial postures, by which the order of the joints is judged


@dataclass(frozen=True)
class Case:
    """A robot in its posture; the defaults are our choices for what the paper does not state."""

    gearbox: GearboxKind = "standard"
    integrator: IntegratorName = EXPLICIT  # the paper's program of 2012
    base: Base = "floating"  # standing on the ground, or held at the trunk
    integral_time: float = INTEGRAL_TIME  # Ti = Kp / Ki [s]
    Kp: float = 61.0  # [V/rad] the AX-12's as delivered, robots/servos/ax12.toml
    step: float = 1e-3  # [s] the program's default
    mass: float = 1.0  # of all links, times those of robots/humanoid; inertias go with it
    resolution: float = 0.0  # of the encoder [rad]; the program reads the exact angle
    draw: int = 0  # which random initial postures, of `DRAWS`


@dataclass(frozen=True)
class PostureSettings:
    """Varied parameters, and the duration of each case."""

    gains: tuple[float, ...]  # [V/rad] 8: the authors' scene of 2008; 61: AX-12
    steps: tuple[float, ...]  # [s]
    masses: tuple[float, ...]  # 0.8: the authors' first scene of this robot, 1.957 kg; 0.6: as far again
    disturbances: int  # random initial postures of each case; eight fill a vector
    tilt: float = math.radians(0.1)  # [rad] their standard deviation from the references, in all joints
    duration: float = 20.0  # [s]
    dropped: float = 10.0  # [s] of the start, not measured: integral action takes some integral times
    resolution: float = ENCODER_STEP  # [rad] what the AX-12's encoder resolves

    def __post_init__(self) -> None:
        if not 0 <= self.dropped < self.duration < math.inf:
            raise ValueError(f"dropped is {self.dropped} s of {self.duration} s; drop less than the whole run")
        if self.disturbances < 1:
            raise ValueError(f"disturbances is {self.disturbances}; at least 1 is needed")


QUICK = PostureSettings(gains=(8.0, 30.0, 61.0, 120.0), steps=(5e-4, 1e-3, 2e-3), masses=(0.6, 0.8), disturbances=8)
FULL = PostureSettings(
    gains=(8.0, 15.0, 30.0, 45.0, 61.0, 90.0, 120.0, 200.0, 300.0),
    steps=(1e-4, 2.5e-4, 5e-4, 1e-3, 2e-3, 5e-3),
    masses=(0.5, 0.6, 0.7, 0.8, 0.9),
    disturbances=32,
)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Angles of the four `JOINTS` after `dropped`, for each disturbance; NaN where the robot fell."""

    highest: np.ndarray  # (n, 4) [deg]
    lowest: np.ndarray  # (n, 4) [deg]
    mean: np.ndarray  # (n, 4) [deg]
    deviation: np.ndarray  # (n, 4) standard deviation [deg]
    statuses: tuple[str, ...]  # (n,) of the trajectories
    time: np.ndarray  # (samples,) of the first disturbance [s]
    angle: np.ndarray  # (samples, 4) of the first disturbance [deg]

    @property
    def typical(self) -> np.ndarray:
        """Median standard deviation (4,) [deg] where the robot stands; NaN if it falls under every disturbance."""
        stands = ~np.isnan(self.deviation).any(axis=1)
        return np.median(self.deviation[stands], axis=0) if stands.any() else np.full(self.deviation.shape[1], np.nan)

    @property
    def fell(self) -> bool:
        return "fell" in self.statuses


@dataclass(frozen=True, eq=False)
class PostureResult:
    settings: PostureSettings
    inertias: np.ndarray  # (4,) that the joints feel, without rotors [kg m^2]
    outcomes: dict[Case, Outcome]

    def of(self, **changes: Any) -> Outcome:
        """Return the outcome of `Case()` with some fields changed."""
        return self.outcomes[Case(**changes)]


def run(settings: PostureSettings = QUICK, seed: int = 0, progress: bool = False) -> PostureResult:
    """Hold the posture in every case; seed: of the initial disturbances, which all cases share."""
    cases = all_cases(settings)
    model = load_robot("humanoid")
    shape = settings.disturbances, model.nv - 6
    noise = [settings.tilt * np.random.default_rng(seed + k).standard_normal(shape) for k in range(DRAWS)]
    outcomes = in_threads(lambda case: hold(case, settings, noise[case.draw]), cases, "posture", progress)
    felt = np.array(scene_of(Case(base="fixed")).preflight.inertias)
    return PostureResult(settings, felt[_places(model)], dict(zip(cases, outcomes)))


def all_cases(settings: PostureSettings) -> list[Case]:
    """Return the cases: the table for both bases and laws, then one varied parameter at a time."""
    models = [Case(gearbox, integrator) for gearbox, integrator in product(GEARBOXES, INTEGRATORS)]
    laws = (P, INTEGRAL_TIME)
    cases = [replace(m, base=base, integral_time=Ti) for m in models for base, Ti in product(BASES, laws)]
    cases += ordered()
    cases += [Case("rotor", integrator, "fixed") for integrator in INTEGRATORS]
    cases += [replace(m, integral_time=SHORT_INTEGRAL_TIME) for m in models]
    cases += [replace(m, step=5e-4, base=base, integral_time=Ti) for m in models for base, Ti in product(BASES, laws)]
    cases += [replace(m, mass=mass) for m in models for mass in settings.masses]
    cases += [replace(m, base="fixed", step=2e-3) for m in models]
    cases += [replace(m, base="fixed", Kp=Kp) for m in models for Kp in settings.gains]
    cases += [replace(m, base="fixed", step=h) for m in models for h in settings.steps]
    cases += [replace(m, base="fixed", resolution=settings.resolution) for m in models]
    return list(dict.fromkeys(cases))


def ordered() -> list[Case]:
    """Return the cases of the standard model in which the order of the joints is asked for."""
    return [
        Case(base=base, integral_time=Ti, draw=k) for base, Ti, k in product(BASES, (INTEGRAL_TIME, P), range(DRAWS))
    ]


def scene_of(case: Case) -> CompiledScene:
    """Compile the humanoid with the case's gearbox and base."""
    model = load_robot("humanoid", case.base)
    servo = next(iter(model.servos.values()))  # the same in every joint
    controller = replace(servo.controller, Kp=case.Kp, Ki=case.Kp / case.integral_time)
    servo = replace(servo, controller=controller, encoder_resolution=case.resolution)
    model = replace(scale_masses(model, case.mass), servos=dict.fromkeys(model.joint_names, servo))
    ground = Ground() if case.base == "floating" else None
    return compile_scene(model, case.gearbox, ground, case.integrator, case.step)


def hold(case: Case, settings: PostureSettings, noise: np.ndarray) -> Outcome:
    """Hold the posture from deviations `noise` (n, joints) [rad]."""
    scene = scene_of(case)
    places, start = _places(scene.model), standing_state if case.base == "floating" else initial_state
    target = np.zeros(len(scene.model.joint_names))  # all other joints at 0: straight legs, arms down
    target[places] = np.radians([reference for reference, _ in TABLE_3.values()])
    states = [start(scene, target + each) for each in noise]
    references = [Reference([0.0], target[None])] * len(states)
    sample = max(case.step, 1e-3)
    how: dict[str, Any] = dict(record=("q",), record_interval=sample, estimate_error=False)
    runs = simulate_batch(scene, settings.duration, states, references, **how)
    angles = np.degrees(np.stack([run["q"][:, places] for run in runs]))
    late = angles[:, runs[0]["time"] >= settings.dropped].copy()
    late[[not run.end_time >= settings.duration - 1e-9 for run in runs]] = np.nan
    numbers = (late.max(axis=1), late.min(axis=1), late.mean(axis=1), late.std(axis=1))
    return Outcome(*numbers, tuple(run.status for run in runs), runs[0]["time"], angles[0])


def _places(model: Model) -> list[int]:
    return [model.joint_names.index(name) for name in JOINTS]


# ---------------------------------------------------------------------------------------------- claims


def table(result: PostureResult) -> str:
    """Return the paper's Table 3 and ours as text: extreme angles and median deviation, in degrees.

    Last, the error of the step: how far half of it moves any of these.
    """
    head = f"{'max, min, deviation [deg]':42}" + "".join(f"{_title(joint):>24}" for joint in JOINTS)
    lines = [f"{head}{'half the step':>16}"]
    for gearbox in GEARBOXES:
        paper = _row(f"paper, {gearbox}", *zip(*[values[gearbox] for _, values in TABLE_3.values()]))
        lines.append(f"{paper}{'':16}")
        for base, Ti, integrator in product(BASES, (INTEGRAL_TIME, P), INTEGRATORS):
            o = result.of(gearbox=gearbox, base=base, integral_time=Ti, integrator=integrator)
            half = result.of(gearbox=gearbox, base=base, integral_time=Ti, integrator=integrator, step=5e-4)
            name = f"{gearbox}, {integrator}, {BASE[base]}, {'P' if Ti == P else 'PI'}"
            off = np.abs(np.array(_numbers(o)) - _numbers(half)).max()
            lines.append(f"{_row(name, *_numbers(o))}{off:16.1g}")
    return "\n".join(lines)


def _numbers(outcome: Outcome) -> tuple[np.ndarray, ...]:
    return outcome.highest.max(axis=0), outcome.lowest.min(axis=0), outcome.typical


def _row(name: str, *numbers: Iterable[float]) -> str:
    return f"{name:42}" + "".join(f"{high:10.2f} {low:7.2f} {d:5.2f}" for high, low, d in zip(*numbers))


def check(result: PostureResult) -> list[Claim]:
    """Return the paper's claims about this posture, standing and with integral action."""
    return [_standard(result), _mipsd(result), _decrease(result), _centered(result), _order(result), _cause(result)]


def _standard(result: PostureResult) -> Claim:
    found, half, coarse = result.of(), result.of(step=5e-4), result.of(base="fixed", step=2e-3)
    paper = _paper("standard")[:, 2]
    lighter = {mass: result.of(mass=mass).typical for mass in result.settings.masses}
    masses = "; ".join(f"{_joints(ours)} at {mass:g}" for mass, ours in lighter.items())
    alike = [mass for mass, ours in lighter.items() if _near(paper, ours)]
    why = (
        f"Rule: each within a factor {FACTOR:g}. Range over disturbances "
        f"{_joints(found.deviation.min(axis=0))} to {_joints(found.deviation.max(axis=0))}; trunk fixed "
        f"{_joints(result.of(base='fixed').typical)}. The size depends on how far the step exceeds what the inertias "
        f"of the joints allow: {_joints(half.typical)} at half the step, {_joints(coarse.typical)} at twice the step "
        "(trunk fixed). The paper gives no masses; with all masses scaled: "
        f"{masses}{f', within the factor at {alike[0]:g}' if alike else ''}."
    )
    verdict = classify(_near(paper, found.typical))
    factor = _factor(paper, found.typical)
    claim, ours = f"Standard model: {WHAT}", _joints(found.typical)
    return Claim(claim, _joints(paper), ours, verdict, why, "Table 3", factor, within(FACTOR))


def _mipsd(result: PostureResult) -> Claim:
    found, half = result.of(gearbox="mipsd"), result.of(gearbox="mipsd", step=5e-4)
    fixed, proportional = result.of(gearbox="mipsd", base="fixed"), result.of(gearbox="mipsd", integral_time=P)
    encoder = result.of(gearbox="mipsd", base="fixed", resolution=result.settings.resolution)
    paper = _paper("mipsd")[:, 2]
    why = (
        f"Rule: each within a factor {FACTOR:g}. Nothing in these equations moves a robot at rest: "
        f"{_joints(fixed.typical)} remain with the trunk fixed, {_joints(proportional.typical)} standing with the P "
        f"law. Standing with integral action, a slow sway dies away (at half the step {_joints(half.typical)}). The "
        "paper's 0.01 deg may be the noise of its engine, or its last digit; an encoder like the AX-12's would alone "
        f"cause {_joints(encoder.typical)} (trunk fixed)."
    )
    verdict = classify(_near(paper, found.typical))
    return Claim(f"MIPSD model: {WHAT}", _joints(paper), _joints(found.typical), verdict, why, "Table 3", holds=True)


def _decrease(result: PostureResult) -> Claim:
    ratios = {}
    for base, Ti in product(BASES, (INTEGRAL_TIME, P)):
        both = [result.of(gearbox=gearbox, base=base, integral_time=Ti).typical for gearbox in GEARBOXES]
        ratios[f"{BASE[base]}, {'P' if Ti == P else 'PI'}"] = float((both[0] / both[1]).min())
    paper = (_paper("standard")[:, 2] / _paper("mipsd")[:, 2]).min()
    least = ", ".join(f"{ratio:.2g} {name}" for name, ratio in ratios.items())
    standing = ratios[f"{BASE['floating']}, PI"]
    why = (
        f"Rule: the least ratio of the joints, standing and with integral action, within a factor {FACTOR:g} of the "
        "paper's; in direction if the deviation is larger in every joint on both bases with both laws. Least ratios: "
        f"{least}."
    )
    verdict = classify(1.0 / FACTOR < standing / paper < FACTOR, min(ratios.values()) > 1.0)
    claim, ours = "The deviation falls in all four joints with MIPSD", f"at least {standing:.2g} times"
    factor = standing / paper
    number = f"at least {paper:.0f} times"
    return Claim(claim, number, ours, verdict, why, "Table 3", factor, within(FACTOR), order=True)


def _centered(result: PostureResult) -> Claim:
    reference = np.array([angle for angle, _ in TABLE_3.values()])
    off = {
        (base, Ti): abs(result.of(gearbox="mipsd", base=base, integral_time=Ti).mean - reference).max(axis=0)
        for base, Ti in product(BASES, (INTEGRAL_TIME, P))
    }
    models = [{"gearbox": s, "integrator": i} for s, i in product(GEARBOXES, INTEGRATORS)]
    falls = sum(result.of(**model, integral_time=SHORT_INTEGRAL_TIME).fell for model in models)
    why = (
        f"Rule: mean within 0.05 deg of the reference. With integral action (Ti = {INTEGRAL_TIME:g} s) it differs by "
        f"{_joints(off['floating', INTEGRAL_TIME])} standing, {_joints(off['fixed', INTEGRAL_TIME])} with the trunk "
        f"fixed. With the AX-12's own P law the joints droop by {_joints(off['floating', P])}, which contradicts the "
        f"paper's table. With faster integral action, Ti = {SHORT_INTEGRAL_TIME:g} s, the standing robot sways and "
        f"falls with {falls} of 4 models."
    )
    verdict = classify(off["floating", INTEGRAL_TIME].max() < 0.05)
    ours = _joints(off["floating", INTEGRAL_TIME])
    claim = "MIPSD holds the angles around their references"
    return Claim(claim, "within 0.05 deg", ours, verdict, why, "Table 3", holds=True)


def _order(result: PostureResult) -> Claim:
    """Return the claim about the order of the joints."""
    orders = {case: tuple(np.argsort(-result.outcomes[case].typical)) for case in ordered()}
    paper = tuple(np.argsort(-_paper("standard")[:, 2]))
    same = {base: sum(order == paper for case, order in orders.items() if case.base == base) for base in BASES}
    found = {
        base: " or ".join(
            " > ".join(_title(JOINTS[k]) for k in order)
            for order in dict.fromkeys(order for case, order in orders.items() if case.base == base)
        )
        for base in BASES
    }
    n = len(orders) // len(BASES)
    why = (
        f"Rule: the same order on both bases, with both laws and {DRAWS} sets of disturbances; in direction in more "
        f"than half of these {len(orders)}. {'; '.join(f'{BASE[base]}: {words}' for base, words in found.items())}. "
        "A joint with little inertia shakes more; left lateral, right front, right lateral shoulder and elbow have "
        f"{', '.join(f'{x:.1e}' for x in result.inertias)} kg m²."
    )
    verdict = classify(sum(same.values()) == len(orders), sum(same.values()) > n)
    words = " > ".join(_title(JOINTS[k]) for k in paper)
    ours = "the same order in " + " and ".join(f"{count} of {n} {BASE[base]}" for base, count in same.items())
    return Claim("Which joints shake most with the standard model", words, ours, verdict, why, "Table 3", order=True)


def _cause(result: PostureResult) -> Claim:
    standing, fixed = (result.of(integrator=IMPLICIT, base=base) for base in BASES)
    rotor = result.of(gearbox="rotor", base="fixed")
    still = all(set(o.statuses) == {"ok"} and o.typical.max() < 0.01 for o in (standing, fixed))
    why = (
        "Rule: yes if the standard model, integrated implicitly, moves by 0.01 deg or more. Its deviations are "
        f"{_joints(standing.typical)} standing, {_joints(fixed.typical)} with the trunk fixed; with a rigid gearbox "
        f"and a rotor in the paper's explicit order they are {_joints(rotor.typical)} (trunk fixed). The rotor or the "
        "implicit step is enough; the spring-damper is not needed."
    )
    verdict: Verdict = "not reproduced" if still else "reproduced"
    ours = "the standard model, integrated implicitly, also holds still" if still else "yes"
    return question("The MIPSD gearbox is needed to hold still", ours, verdict, why)


BASE = {"floating": "standing", "fixed": "trunk fixed"}
WHAT = "standard deviation of left lateral, right front, right lateral shoulder, left elbow [deg]"


def _paper(gearbox: str) -> np.ndarray:
    """Return largest, smallest angle and deviation of the joints (4, 3) [deg]."""
    return np.array([values[gearbox] for _, values in TABLE_3.values()])


def _joints(values: Collection[float]) -> str:
    if max(values) < 1e-4:
        return "<1e-4 each"
    return ", ".join("<1e-4" if x < 1e-4 else f"{x:.2g}" for x in values)


def _factor(paper: np.ndarray, ours: np.ndarray) -> float:
    """Return the geometric mean over the joints of ours over the paper's."""
    return math.exp(float(np.mean(np.log(ours / paper))))


def _near(paper: np.ndarray, ours: np.ndarray) -> bool:
    """Return whether every joint's deviation is the paper's within `FACTOR`."""
    return bool((abs(np.log(ours / paper)) < math.log(FACTOR)).all())


def _title(joint: str) -> str:
    return joint.replace("_", " ")


# ---------------------------------------------------------------------------------------------- figures

FLOOR = 1e-6  # of what is shown of a deviation [deg]


@look()
def plot(result: PostureResult) -> dict[str, Figure]:
    """Return the figures, by caption."""
    return {
        "The left elbow over time, as in the paper's Fig. 13": _elbow(result),
        "Table 3 as a picture: range and standard deviation about the reference": _ranges(result),
        "What the paper leaves unsaid: step, gain and masses": _dependence(result),
    }


def _elbow(result: PostureResult) -> Figure:
    figure, axes = subplots(11.0, 3.6, 1, 3, sharey=True)
    models = (("standard", EXPLICIT), ("mipsd", EXPLICIT), ("standard", IMPLICIT))
    for panel, (gearbox, integrator) in zip(axes, models):
        for base, color in (("floating", ORANGE), ("fixed", BLUE)):
            o = result.of(gearbox=gearbox, integrator=integrator, base=base)
            panel.plot(o.time, o.angle[:, JOINTS.index("left_elbow")], color=color, linewidth=0.7, label=BASE[base])
        panel.set(xlabel="time [s]", title=f"{gearbox}, {INTEGRATOR_NAMES[integrator]}")
    axes[0].set_ylabel("left elbow [deg]")
    lines, names = axes[0].get_legend_handles_labels()
    for line in figure.legend(lines, names, loc="outside lower center", ncols=2).get_lines():
        line.set_linewidth(2.0)
    return figure


def _ranges(result: PostureResult) -> Figure:
    """Draw ranges over all disturbances (thin), and mean (the paper's: middle) ± deviation (thick)."""
    figure, axes = subplots(13.0, 4.2, 1, 4, sharey=True)
    rows: list[tuple] = []
    for gearbox in GEARBOXES:
        rows.append((gearbox, None, "", 0.0))
        rows += [(gearbox, i, base, Ti) for i, base, Ti in product(INTEGRATORS, BASES, (INTEGRAL_TIME, P))]
    for j, (panel, joint) in enumerate(zip(axes, JOINTS)):
        for k, (gearbox, integrator, base, Ti) in enumerate(rows):
            color = SERVO_COLORS[gearbox]
            if integrator is None:
                high, low, deviation = TABLE_3[joint][1][gearbox]
                middle, color = 0.5 * (high + low), "0.3"
            else:
                o = result.of(gearbox=gearbox, integrator=integrator, base=base, integral_time=Ti)
                high, low, deviation = o.highest[:, j].max(), o.lowest[:, j].min(), o.typical[j]
                middle = np.median(o.mean[:, j])
            reference = TABLE_3[joint][0]
            panel.plot(np.array([low, high]) - reference, [k, k], color=color, linewidth=1.2, marker="|", markersize=7)
            spread = np.array([middle - deviation, middle + deviation]) - reference
            panel.plot(spread, [k, k], color=color, linewidth=5.0, alpha=0.6, solid_capstyle="butt")
        panel.axvline(0.0, color="0.6", linewidth=0.8)
        panel.set_title(_title(joint), fontsize=10)
        panel.set_xscale("symlog", linthresh=0.1)
        panel.set_xticks([-1.0, -0.1, 0.0, 0.1, 1.0], ["-1", "-0.1", "0", "0.1", "1"])
    names = [
        f"paper, {gearbox}" if i is None else f"{gearbox}, {i}, {BASE[base]}, {'P' if Ti == P else 'PI'}"
        for gearbox, i, base, Ti in rows
    ]
    axes[0].set_yticks(range(len(rows)), names, fontsize=8)
    axes[0].invert_yaxis()
    figure.supxlabel("angle less reference [deg]", fontsize=10)
    return figure


def _dependence(result: PostureResult) -> Figure:
    figure, axes = subplots(12.0, 4.0, 1, 3, sharey=True)
    settings, paper = result.settings, _paper("standard")[:, 2].max()
    sweeps: tuple[tuple[str, float, list[dict[str, Any]]], ...] = (
        ("step [ms]", 1e3, [{"base": "fixed", "step": h} for h in settings.steps]),
        ("gain [V/rad]", 1.0, [{"base": "fixed", "Kp": Kp} for Kp in settings.gains]),
        ("masses [times ours]", 1.0, [{"mass": m} for m in (*settings.masses, 1.0)]),
    )
    for panel, (label, scale, changes) in zip(axes, sweeps):
        places = [scale * list(change.values())[-1] for change in changes]
        for gearbox, integrator in product(GEARBOXES, INTEGRATORS):
            found = [result.of(gearbox=gearbox, integrator=integrator, **change) for change in changes]
            values = [max(o.typical.max(), FLOOR) if not o.fell else math.nan for o in found]
            style = {"color": SERVO_COLORS[gearbox], "linestyle": LINE_STYLES[integrator], "marker": "."}
            panel.plot(places, values, label=f"{gearbox}, {INTEGRATOR_NAMES[integrator]}", **style)
            bad = [k for k, o in enumerate(found) if "chatter" in o.statuses]
            panel.plot([places[k] for k in bad], [values[k] for k in bad], "x", color="black", markersize=7)
        panel.axhline(paper, color="0.4", linestyle=":", linewidth=1.0)
        panel.set(xlabel=label, yscale="log")
        panel.set_title(BASE[changes[0].get("base", Case.base)], fontsize=10)
    axes[0].set_ylabel("largest deviation of a joint [deg]")
    axes[0].annotate(f"paper {paper:g}", (0.02, paper), xycoords=("axes fraction", "data"), fontsize=7, va="bottom")
    lines, names = axes[0].get_legend_handles_labels()
    crosses = axes[0].plot([], [], "x", color="black")
    figure.legend([*lines, *crosses], [*names, "chatter"], loc="outside lower center", ncols=5, fontsize=8)
    return figure
