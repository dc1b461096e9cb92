"""Gear ratio and number of joints: the two causes of instability that the paper states, varied.

Section 3: the standard model is unstable "for the high values of the gearbox ratio".  Abstract: so is a robot with a
high number of joints.  The arm of `seven_joint_arm` is held upright at gear ratios from 50 to 500 and with one to ten
joints, with the standard gearbox, with the rotor's inertia alone and with MIPSD: in the paper's kind of program at
1 ms, and by error control, which shows what of it is physics.  The gearbox's stiffness and damping at the output stay.

Linear theory stands beside it: near rest a controller tick of that program is a linear map of angles, speeds, currents
and rotors, and the largest modulus of its eigenvalues says by how much a small disturbance grows from tick to tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from ..dynamics import inverse_dynamics, mass_matrix
from ..model import Model
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate_batch
from ..scene.compile import GearboxKind, IntegratorName, compile_scene
from ..view.style import look
from .claim import Claim, Verdict, classify, question, span
from .common import EXPLICIT, SERVO_COLORS, in_threads, subplots
from .seven_joint_arm import DEG2, FALLEN, GEARBOXES, Case, arm, draw_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPER_RATIO, PAPER_JOINTS = 254.0, 7
CONTROLLED: IntegratorName = "extrapolation"  # the integrator of the runs by error control
STEP = 1e-3  # [s] the default of the paper's program
SMALL_STEP = 1e-5  # [s] with which the linear map is the physical one to 1 %


@dataclass(frozen=True)
class RatioSettings:
    """Varied parameters, and the duration of each case."""

    ratios: tuple[float, ...]  # every ratio with every number of joints
    joints: tuple[int, ...]  # of links alike, each with a servo
    disturbances: int  # random initial tilts of each arm
    tilt: float = Case.tilt  # [rad] their standard deviation
    duration: float = 8.0  # [s] the second half is measured
    rtol: float = 1e-6  # of the runs by error control


QUICK = RatioSettings((50.0, 100.0, 150.0, 254.0, 400.0), (1, 2, 4, 7, 10), 2)
FULL = RatioSettings((50.0, 75.0, 100.0, 150.0, 200.0, 254.0, 300.0, 400.0, 500.0), tuple(range(1, 11)), 8)


@dataclass(frozen=True, eq=False)
class Held:
    """An arm that is held: errors of the lowest joint for each disturbance, and what linear theory says."""

    explicit: np.ndarray  # (n,) mean square angle in the paper's kind of program [rad^2]
    controlled: np.ndarray  # (n,) the same by error control [rad^2]
    chatters: bool  # velocities alternate from step to step in a run of the first kind
    growth: float  # of a small disturbance from tick to tick in the paper's kind of program [-]
    physical: float  # the same for a step that tends to zero [-]

    @property
    def typical(self) -> float:
        """Median error in the paper's kind of program [rad^2]."""
        return float(np.median(self.explicit))

    @property
    def word(self) -> str:
        return ("chatters" if self.chatters else "holds") if self.stands else "falls"

    @property
    def stands(self) -> bool:
        """Return whether servos can hold this arm at all: whether it stands by error control."""
        return bool(self.controlled.max() < FALLEN**2)

    @property
    def unstable(self) -> bool:
        """Return whether linear theory calls the program unstable where the arm is not."""
        return self.growth > 1.0 > self.physical


Place = tuple[GearboxKind, float, int]  # gearbox, gear ratio, number of joints


@dataclass(frozen=True, eq=False)
class RatioResult:
    settings: RatioSettings
    held: dict[Place, Held]

    def over_ratios(self, gearbox: GearboxKind, joints: int = PAPER_JOINTS) -> list[Held]:
        return [self.held[gearbox, ratio, joints] for ratio in self.settings.ratios]

    def over_joints(self, gearbox: GearboxKind, ratio: float = PAPER_RATIO) -> list[Held]:
        return [self.held[gearbox, ratio, n] for n in self.settings.joints]

    def standing(self, gearbox: GearboxKind) -> list[Held]:
        """Return the arms that servos can hold."""
        return [one for place, one in self.held.items() if place[0] == gearbox and one.stands]


def run(settings: RatioSettings = QUICK, seed: int = 0, progress: bool = False) -> RatioResult:
    """Hold each arm; seed: of the initial tilts, which all share."""
    places = list(product(GEARBOXES, settings.ratios, settings.joints))
    tilts = settings.tilt * np.random.default_rng(seed).standard_normal((settings.disturbances, max(settings.joints)))
    held = in_threads(lambda place: hold(place, settings, tilts), places, "ratio and joints", progress)
    return RatioResult(settings, dict(zip(places, held)))


def robot(place: Place) -> Model:
    """Return the arm of `seven_joint_arm` with another gear ratio and number of joints, each link like the last."""
    gearbox, ratio, n = place
    model = arm(Case(gearbox))
    links, joints = list(model.links[: n + 1]), list(model.joints[:n])
    for k in range(len(joints), n):
        links.append(replace(links[-1], name=f"link{k + 1}"))
        joints.append(replace(joints[-1], name=f"joint{k + 1}", parent=links[-2].name, child=links[-1].name))
    servo = next(iter(model.servos.values()))  # the same in every joint
    servo = replace(servo, gearbox=replace(servo.gearbox, ratio=ratio))
    servos = dict.fromkeys((joint.name for joint in joints), servo)
    return replace(model, links=tuple(links), joints=tuple(joints), servos=servos)


def hold(place: Place, settings: RatioSettings, tilts: np.ndarray) -> Held:
    """Hold an arm upright from each of `tilts` (n, joints) [rad] in both ways."""
    model = robot(place)
    explicit, chatters = _errors(model, place, settings, tilts, EXPLICIT)
    controlled, _ = _errors(model, place, settings, tilts, CONTROLLED)
    return Held(explicit, controlled, chatters, growth(model, place[0], STEP), growth(model, place[0], SMALL_STEP))


def _errors(
    model: Model, place: Place, settings: RatioSettings, tilts: np.ndarray, integrator: IntegratorName
) -> tuple[np.ndarray, bool]:
    """Return the mean square of the lowest joint's angle for each tilt [rad^2], and whether a run chatters."""
    gearbox, _, n = place
    scene = compile_scene(model, gearbox=gearbox, integrator=integrator, timestep=STEP)
    rtol = settings.rtol if integrator == CONTROLLED else None
    states = [initial_state(scene, q[:n]) for q in tilts]
    upright = [Reference([0.0], np.zeros((1, n)))] * len(states)
    runs = simulate_batch(scene, settings.duration, states, upright, record=("q",), rtol=rtol, estimate_error=False)
    angles = np.stack([one["q"][:-1, 0] for one in runs])
    late = angles[:, angles.shape[1] // 2 :]
    return (late**2).mean(axis=1), any(one.status == "chatter" for one in runs)


# ---------------------------------------------------------------------------------------------- linear theory


def growth(model: Model, gearbox: GearboxKind, step: float) -> float:
    """Compute by how much a small disturbance of the upright arm grows from controller tick to tick.

    Parameters
    ----------
    model
        An arm whose joints all have the same servo, with proportional gain alone.
    gearbox
        "standard", "rotor" or "mipsd".
    step
        Of the paper's kind of program [s]; it divides the controller's period.

    Returns
    -------
    float
        Largest modulus of the eigenvalues of the map over one tick [-]; below 1 the arm comes to rest.
    """
    n, servo = len(model.joint_names), next(iter(model.servos.values()))
    tick = np.linalg.matrix_power(_step_map(model, gearbox, step), round(servo.controller.period / step))
    sees = np.eye(len(tick))
    sees[-n:] = 0.0
    sees[-n:, :n] = -servo.controller.Kp * np.eye(n)  # the voltage that is held until the next tick
    return float(np.abs(np.linalg.eigvals(tick @ sees)).max())


def _step_map(model: Model, gearbox: GearboxKind, step: float) -> np.ndarray:
    """Compute the matrix of a step on angles, speeds, filtered speeds, currents, rotors, their speeds and voltages.

    It is the order of updates of `simtwo`, without limits and without the friction's small constant part.
    """
    n, servo = len(model.joint_names), next(iter(model.servos.values()))
    gear, zero = servo.gearbox, np.zeros(len(model.joint_names))
    constant, rotor = gear.ratio * servo.motor_constant, gear.reflected_inertia
    mass, small = mass_matrix(model, zero), 1e-6
    weight = np.array([inverse_dynamics(model, small * e, zero, zero) / small for e in np.eye(n)]).T
    if gearbox == "rotor":
        mass = mass + rotor * np.eye(n)
    kept = math.exp(-step * servo.resistance / servo.inductance)  # of the current
    blend = -math.expm1(-step / servo.speed_filter)

    def after(x: np.ndarray) -> np.ndarray:
        q, v, f, current, turn, spin, voltage = x.reshape(7, n)
        f = f + blend * (v - f)
        motor = spin if gearbox == "mipsd" else v
        current = kept * current + (1.0 - kept) * (voltage - constant * motor) / servo.resistance
        torque = constant * current
        if gearbox == "mipsd":
            through = gear.stiffness * (turn - q) + gear.damping * (spin - f)
            spin = spin + step * (torque - through) / rotor
            turn, torque = turn + step * spin, through
        else:
            turn = spin = 0.0 * v  # there is no rotor of its own
        v = v + step * np.linalg.solve(mass, torque - servo.viscous_friction * f - weight @ q)
        return np.concatenate([q + step * v, v, f, current, turn, spin, voltage])

    return np.array([after(e) for e in np.eye(7 * n)]).T


# ---------------------------------------------------------------------------------------------- claims


def check(result: RatioResult) -> list[Claim]:
    """Return the paper's two causes and what they rest on; both are orders, which hold or do not."""
    return [_ratio(result), _joints(result), _rotor(result), _theory(result)]


def _ratio(result: RatioResult) -> Claim:
    settings = result.settings
    rows = [result.over_ratios("standard", n) for n in settings.joints]
    claim = "The standard model is unstable for high gear ratios"
    why = (
        "Rule: of the arms that stand by error control, with every number of joints those above a gear ratio chatter "
        "and those below do not, both sides are met, and with MIPSD none chatters. Where an arm falls by error "
        "control, the motor brakes too little for a controller of 10 ms, or gravity is stronger. Twice the ratio "
        "makes the motor's brake four times as strong, and an explicit step goes beyond it; the chatter is an error of "
        f"integration: without it at most {max(_squares(result.standing('standard'), 'controlled')):.2g} deg² are left."
    )
    found = _onset(settings.ratios, result.over_ratios("standard"), "at ratios of {:g} to {:g}")
    ours = f"{PAPER_JOINTS} joints: {found}"
    return Claim(claim, "no number", ours, _verdict(rows, result), why, "Section 3", order=True)


def _joints(result: RatioResult) -> Claim:
    settings = result.settings
    rows = [result.over_joints("standard", ratio) for ratio in settings.ratios]
    why = (
        "Rule: the same by the number of joints at every gear ratio. The least inertia of a chain falls with every "
        "joint, and behind the gear that of the motor is missing. The paper says that errors of the first joint "
        "travel to the others; here all joints are solved at once, and the chatter comes all the same."
    )
    found = _onset(settings.joints, result.over_joints("standard"), "with {:g} to {:g} joints")
    ours = f"ratio {PAPER_RATIO:g}: {found}"
    claim = "A robot with a high number of joints easily becomes unstable"
    return Claim(claim, "no number", ours, _verdict(rows, result), why, "Abstract", order=True)


def _rotor(result: RatioResult) -> Claim:
    found = result.standing("rotor")
    chatter = sum(one.chatters for one in found)
    why = (
        "Rule: yes if no arm that stands chatters with a rigid gear and the rotor's inertia. That inertia grows with "
        "the square of the gear ratio as the motor's brake does, so that no ratio is too high: the paper's own reason."
    )
    ours = f"{chatter} of {len(found)} arms chatter, at most {max(_squares(found, 'explicit')):.2g} deg²"
    return question("The rotor's inertia alone takes both causes away", ours, classify(chatter == 0), why)


def _theory(result: RatioResult) -> Claim:
    found = [one for gearbox in GEARBOXES for one in result.standing(gearbox)]
    right = sum(one.unstable == one.chatters for one in found)
    why = (
        "Rule: yes if those arms that stand chatter for which linear theory says that the program is unstable and the "
        "arm is not, and no others; in part for nine of ten. The theory knows no limits of voltage and current, which "
        "bound the chatter."
    )
    verdict = classify(right == len(found), right >= 0.9 * len(found))
    return question("Linear theory tells beforehand which arms chatter", f"{right} of {len(found)} arms", verdict, why)


def _verdict(rows: list[list[Held]], result: RatioResult) -> Verdict:
    """Judge rows of arms in the order of a cause."""
    chatter = [[one.chatters for one in row if one.stands] for row in rows]
    ordered = all(row == sorted(row) for row in chatter)
    both = any(len(set(row)) == 2 for row in chatter)
    return classify(ordered and both and not any(one.chatters for one in result.standing("mipsd")))


def _onset(values: Sequence[float], row: list[Held], where: str) -> str:
    """Return which values chatter, how much, and where linear theory begins to say so."""
    loud = [(value, one) for value, one in zip(values, row) if one.stands and one.chatters]
    if not loud:
        return "none chatters"
    theory = next((value for value, one in zip(values, row) if one.unstable), math.inf)
    errors = span(_squares([one for _, one in loud], "explicit"), ".2g")
    return f"{errors} deg² {where.format(loud[0][0], loud[-1][0])}; by linear theory from {theory:g} on"


def _squares(found: list[Held], of: str) -> list[float]:
    """Return the median errors of arms [deg^2]."""
    return [float(np.median(getattr(one, of))) * DEG2 for one in found]


# ---------------------------------------------------------------------------------------------- figures

FLOOR, CEILING = 1e-8, 1e5  # of what is shown [deg^2]


@look()
def plot(result: RatioResult) -> dict[str, Figure]:
    """Return the figures, by caption."""
    return {
        "The paper's two causes, gear ratio and number of joints: measured, and by linear theory": _lines(result),
        "All gear ratios and numbers of joints in the paper's kind of program": _maps(result),
    }


def _lines(result: RatioResult) -> Figure:
    figure, axes = subplots(11.0, 6.4, 2, 2, sharex="col", sharey="row")
    columns = (
        (result.settings.ratios, result.over_ratios, f"gear ratio, {PAPER_JOINTS} joints"),
        (result.settings.joints, result.over_joints, f"joints, gear ratio {PAPER_RATIO:g}"),
    )
    for (errors, theory), (x, over, label) in zip(axes.T, columns):
        for gearbox in GEARBOXES:
            _draw(errors, theory, x, over(gearbox), gearbox)
        theory.set(xlabel=label, ylim=(0.85, 1.25))
        theory.axhline(1.0, color="0.4", linewidth=1.0, linestyle=":")
        errors.set(yscale="log", ylim=(FLOOR, CEILING))
        errors.axhline(FALLEN**2 * DEG2, color="0.4", linewidth=1.0, linestyle=":")
    errors.text(x[0], 1.5 * FALLEN**2 * DEG2, "fallen", fontsize=8, color="0.4")
    axes[0, 0].set_ylabel("error of the lowest joint [deg²]")
    axes[1, 0].set_ylabel("growth in a controller tick [-]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return figure


def _draw(errors: Axes, theory: Axes, x: Sequence[float], held: list[Held], gearbox: str) -> None:
    color = SERVO_COLORS[gearbox]
    for of, line, name in (("explicit", "-", "paper's kind of program"), ("controlled", "--", "error control")):
        errors.plot(x, np.maximum(_squares(held, of), FLOOR), line, color=color, marker=".", label=f"{gearbox}, {name}")
    theory.plot(x, [min(one.growth, 2.0) for one in held], "-", color=color, marker=".")
    theory.plot(x, [one.physical for one in held], "--", color=color, marker=".")


def _maps(result: RatioResult) -> Figure:
    ratios, joints = result.settings.ratios, result.settings.joints
    figure, axes = subplots(13.0, 1.6 + 0.42 * len(joints), 1, 3, sharey=True)
    for panel, gearbox in zip(axes, GEARBOXES):
        grid = [result.over_ratios(gearbox, n) for n in joints]
        image = draw_errors(panel, grid, [f"{ratio:g}" for ratio in ratios], [f"{n}" for n in joints], 6)
        panel.set(title=gearbox, xlabel="gear ratio")
    axes[0].set_ylabel("joints")
    figure.colorbar(image, ax=axes, label="error [deg²]", pad=0.01)
    return figure
