"""Seven joints in a row held upright: causes of stability (Lima et al. 2013, section 3, Figs. 7 to 10).

The paper's arm holds all joints at 0, and the error of the lowest one is measured.  Its "standard error deviation"
falls from 8.14 to 0.0022 rad^2 with the gearbox model of motor inertia plus spring-damper (MIPSD).  This changes two
properties at once, and a third could have been changed instead.  Here they are separate:

- rotor inertia: gearbox "rotor" against "standard", both rigid;
- compliance: gearbox "mipsd" against "rotor";
- integration of the torque: "simtwo", the paper's program, computes it at the start of the step and holds it;
  "implicit_euler" solves for the torque at the end of the step.

The paper gives neither masses, lengths, gains, step, duration nor disturbance, so each of them is varied.  The error is
the mean square of the lowest joint's angle over the second part of the run; the unit of the paper's "deviation" is that
of a square.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..dynamics import inverse_dynamics
from ..model import Gearbox, Model
from ..robot_file import gearbox_presets, load_robot
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate_batch
from ..scene.compile import GearboxKind, IntegratorName, compile_scene
from ..view.style import look
from .claim import Claim, classify, question, within
from .common import ENCODER_STEP, EXPLICIT, IMPLICIT, INTEGRATOR_NAMES, LINE_STYLES, SERVO_COLORS, in_threads, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

GEARBOXES: tuple[GearboxKind, ...] = ("standard", "rotor", "mipsd")
INTEGRATORS: tuple[IntegratorName, ...] = (EXPLICIT, IMPLICIT)
READINGS = ("paper_literal", "code_2012", "paper_rotor_side", "physical")
LARGE = (0.1, 0.1)  # mass [kg] and length [m] of a link: `robots/arm7`, about an AX-12 with its bracket
SMALL = (0.07, 0.067)  # a bare AX-12 with a light bracket, the smallest that is plausible
CHECKED_STEPS = (1e-4, 5e-4, 1e-3)  # [s] at the default gain, whatever the settings: a tenth, a half, and the default
NO_ROTOR = 1e-10  # [kg m^2]; reflected 6e-6, a quarter of the arm's least modal inertia: as good as none
ALONE: dict[str, Any] = {"gearbox": "mipsd", "rotor_inertia": NO_ROTOR}  # compliance without the rotor
FALLEN = math.radians(10.0)  # rms angle beyond which the arm does not stand [rad]: no held arm comes near it
PAPER_STANDARD, PAPER_MIPSD = 8.14, 0.0022  # printed as rad^2
FACTOR = 3.0  # within which a median counts as the same: so much the standard model varies over gains
DEG2 = math.degrees(1.0) ** 2  # deg^2 in a rad^2


@dataclass(frozen=True)
class Case:
    """An arm with a servo model; the defaults are our choices for what the paper does not state."""

    gearbox: GearboxKind = "standard"
    integrator: IntegratorName = EXPLICIT  # the paper's program of 2012
    step: float = 1e-3  # [s] its default
    Kp: float = 61.0  # [V/rad] the AX-12's as delivered, robots/servos/ax12.toml
    link: tuple[float, float] = LARGE
    preset: str = "physical"  # the printed constants hold no arm; see `check`
    rotor_inertia: float = 1e-7  # [kg m^2] robots/servos/ax12.toml: plausible are 5e-8 to 3e-7
    tilt: float = 0.01  # [rad] standard deviation of the joints at the start: 0.6 deg, an arm that is put up by hand
    resolution: float = 0.0  # of the encoder [rad]; the paper's program reads the exact angle


@dataclass(frozen=True)
class ArmHoldSettings:
    """Varied parameters, and the duration of each case."""

    gains: tuple[float, ...]  # [V/rad] 8: the authors' scene of 2008; 61: AX-12; 120: twice that
    steps: tuple[float, ...]  # [s] 1 ms is the program's default; all divide the controllers' 10 ms
    links: tuple[tuple[float, float], ...]  # mass [kg], length [m], besides `LARGE` and `SMALL`
    rotor_inertias: tuple[float, ...]  # [kg m^2]
    tilts: tuple[float, ...]  # [rad]
    disturbances: int  # random initial tilts of each case; eight fill a vector
    duration: float = 20.0  # [s]
    dropped: float = 10.0  # [s] of the start, not measured
    resolution: float = ENCODER_STEP  # [rad] what the AX-12's encoder resolves

    def __post_init__(self) -> None:
        whole = self.duration == round(self.duration) and self.dropped == round(self.dropped)
        if not (whole and 0 <= self.dropped < self.duration and self.duration >= 4):
            raise ValueError(
                f"duration is {self.duration} s, dropped {self.dropped} s; give whole seconds, at least 4, and drop "
                "less than the whole run"
            )
        if self.disturbances < 1:
            raise ValueError(f"disturbances is {self.disturbances}; at least 1 is needed")


QUICK = ArmHoldSettings(
    gains=(20.0, 40.0, 61.0, 80.0, 120.0),
    steps=(2.5e-4, 5e-4, 1e-3, 2e-3, 1e-2),
    links=((0.095, 0.095), (0.09, 0.09)),
    rotor_inertias=(5e-8, 1e-7, 3e-7),
    tilts=(1e-4, 1e-2, 5e-2),
    disturbances=8,
)
FULL = ArmHoldSettings(
    gains=(8.0, 20.0, 25.0, 30.0, 40.0, 50.0, 61.0, 70.0, 80.0, 90.0, 100.0, 120.0),
    steps=(1e-4, 2.5e-4, 5e-4, 1e-3, 2e-3, 2.5e-3, 5e-3, 1e-2),
    links=((0.095, 0.095), (0.09, 0.09), (0.085, 0.085), (0.08, 0.08)),
    rotor_inertias=(2e-8, 5e-8, 1e-7, 3e-7, 1e-6),
    tilts=(1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 2e-2, 5e-2),
    disturbances=32,
)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Errors of the lowest joint, for each disturbance."""

    error: np.ndarray  # (n,) mean square angle after `dropped` [rad^2]
    variance: np.ndarray  # (n,) the same about its mean [rad^2]
    history: np.ndarray  # (n, seconds) mean square angle in each second [rad^2]
    statuses: tuple[str, ...]  # (n,) of the trajectories
    angle: np.ndarray  # (ticks,) of the first disturbance [rad]

    @property
    def typical(self) -> float:
        """Median error [rad^2]."""
        return float(np.median(self.error))

    @property
    def sound(self) -> bool:
        """Return whether every run has the status ok."""
        return set(self.statuses) == {"ok"}

    @property
    def stands(self) -> bool:
        return bool(self.error.max() < FALLEN**2)

    @property
    def swings(self) -> bool:
        """Return whether the error no longer decays in the last quarter of the run: a limit cycle."""
        third, last = np.array_split(np.median(self.history, axis=0), 4)[2:]
        return bool(last.mean() > 0.7 * third.mean() > 1e-10)

    @property
    def word(self) -> str:
        if self.sound:
            return ("swings" if self.swings else "holds") if self.stands else "falls"
        return "chatters" if self.stands else "fails"


@dataclass(frozen=True, eq=False)
class ArmHoldResult:
    settings: ArmHoldSettings
    outcomes: dict[Case, Outcome]

    def of(self, **changes: Any) -> Outcome:
        """Return the outcome of `Case()` with some fields changed."""
        return self.outcomes[Case(**changes)]


def run(settings: ArmHoldSettings = QUICK, seed: int = 0, progress: bool = False) -> ArmHoldResult:
    """Hold the arm in every case; seed: of the initial tilts, which all cases share."""
    cases = all_cases(settings)
    tilts = np.random.default_rng(seed).standard_normal((settings.disturbances, 7))
    outcomes = in_threads(lambda case: hold(case, settings, tilts), cases, "seven-joint arm", progress)
    return ArmHoldResult(settings, dict(zip(cases, outcomes)))


def all_cases(settings: ArmHoldSettings) -> list[Case]:
    """Return the cases: every combination of gain and step, then one varied parameter at a time."""
    models = [Case(gearbox, integrator) for gearbox, integrator in product(GEARBOXES, INTEGRATORS)]
    gains, inertias = (Case.Kp, *settings.gains), (NO_ROTOR, Case.rotor_inertia, *settings.rotor_inertias)
    cases = [replace(m, Kp=Kp, step=h) for m in models for Kp, h in product(gains, (Case.step, *settings.steps))]
    cases += [replace(m, step=h) for m in models for h in CHECKED_STEPS]
    cases += [replace(m, Kp=Kp, link=SMALL) for m in models for Kp in gains]
    cases += [replace(m, Kp=Kp, link=link) for m in models[::2] for Kp, link in product(gains, settings.links)]
    cases += [replace(m, tilt=tilt) for m in models for tilt in settings.tilts]
    cases += [replace(m, resolution=settings.resolution) for m in models]
    springs = [replace(m, rotor_inertia=J) for m in models[-2:] for J in inertias]
    cases += springs + [replace(m, preset=g) for m in springs for g in READINGS if m.rotor_inertia > NO_ROTOR]
    return list(dict.fromkeys(cases))


def arm(case: Case) -> Model:
    """Return the robot `arm7` with the case's links, scaled in all dimensions, and servos."""
    model = _arm7()
    mass, length = case.link[0] / LARGE[0], case.link[1] / LARGE[1]
    links = tuple(
        replace(
            link,
            mass=mass * link.mass,
            center_of_mass=_scaled(length, link.center_of_mass),
            inertia=tuple(mass * length**2 * x for x in link.inertia),
        )
        for link in model.links
    )
    joints = tuple(replace(joint, xyz=_scaled(length, joint.xyz)) for joint in model.joints)
    gearbox = replace(_gearboxes()[case.preset], rotor_inertia=case.rotor_inertia)
    servo = next(iter(model.servos.values()))  # the same in every joint
    controller = replace(servo.controller, Kp=case.Kp)
    servo = replace(servo, controller=controller, gearbox=gearbox, encoder_resolution=case.resolution)
    return replace(model, links=links, joints=joints, servos=dict.fromkeys(model.joint_names, servo))


def _scaled(factor: float, vector: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = vector
    return factor * x, factor * y, factor * z


@functools.cache
def _arm7() -> Model:
    return load_robot("arm7")


@functools.cache
def _gearboxes() -> dict[str, Gearbox]:
    return gearbox_presets("ax12")


def hold(case: Case, settings: ArmHoldSettings, tilts: np.ndarray) -> Outcome:
    """Hold the arm upright from each of `tilts` (n, 7), in units of the case's."""
    scene = compile_scene(arm(case), gearbox=case.gearbox, integrator=case.integrator, timestep=case.step)
    states = [initial_state(scene, case.tilt * q) for q in tilts]
    upright = [Reference([0.0], np.zeros((1, 7)))] * len(states)
    runs = simulate_batch(scene, settings.duration, states, upright, record=("q",), estimate_error=False)
    angle = np.stack([run["q"][:-1, 0] for run in runs])
    seconds = (angle**2).reshape(len(runs), round(settings.duration), -1).mean(axis=2)
    late = angle[:, len(angle[0]) * round(settings.dropped) // round(settings.duration) :]
    statuses = tuple(run.status for run in runs)
    return Outcome((late**2).mean(axis=1), late.var(axis=1), seconds, statuses, angle[0])


def least_gain(model: Model) -> float:
    """Return the gain [V/rad] below which the upright arm buckles: gravity's stiffness over G K / R."""
    n, small = len(model.joint_names), 1e-6
    torques = [inverse_dynamics(model, small * q, np.zeros(n), np.zeros(n)) / small for q in np.eye(n)]
    servo = next(iter(model.servos.values()))
    per_volt = servo.gearbox.ratio * servo.motor_constant / servo.resistance
    return float(np.linalg.eigvalsh(-np.array(torques)).max() / per_volt)


# ---------------------------------------------------------------------------------------------- claims


def check(result: ArmHoldResult) -> list[Claim]:
    """Return the paper's claims about this arm.

    Squares are compared in deg^2, see the claim about the unit.
    """
    claims = (_standard, _mipsd, _improvement, _unit, _rotor, _compliance, _printed)
    return [claim(result) for claim in claims]


def _standard(result: ArmHoldResult) -> Claim:
    found, half, fine = result.of(), result.of(step=5e-4), result.of(step=1e-4)
    standing = [o for o in _over_gains(result, gearbox="standard") if o.stands]
    n = len(found.statuses)
    verdict = classify(_near(PAPER_STANDARD, found))
    why = (
        f"Rule: median within a factor {FACTOR:g}. A bounded chatter never ends; "
        f"{found.statuses.count('chatter')} of {n} runs have it, whatever the disturbance. It is an integration error: "
        f"{_squares(half)} at half the step, {_squares(fine)} at a tenth. Its size depends on what the paper does not "
        f"give: {_squares(*standing)} over the gains at which the arm stands, {_squares(result.of(link=SMALL))} with "
        f"links of 0.07 kg and 0.067 m."
    )
    claim, factor = "How far the lowest joint is from 0 with the standard model", found.typical * DEG2 / PAPER_STANDARD
    return Claim(claim, f"{PAPER_STANDARD} rad²", _both(found), verdict, why, "Fig. 9", factor, within(FACTOR))


def _mipsd(result: ArmHoldResult) -> Claim:
    found, fine = result.of(gearbox="mipsd"), result.of(gearbox="mipsd", step=1e-4)
    tilts = result.settings.tilts
    tilted = [result.of(gearbox="mipsd", tilt=tilt) for tilt in tilts]
    standing = [o for o in _over_gains(result, gearbox="mipsd") if o.stands]
    verdict = classify(_near(PAPER_MIPSD, found))
    left = math.sqrt(np.median(found.history[:, -1]) / np.median(found.history[:, 0]))
    why = (
        f"Rule: median within a factor {FACTOR:g}. The arm {found.word}. The number mostly measures how the initial "
        f"tilt dies away, to {left:.1g} of it in the last second. Tilts from {min(tilts):g} to {max(tilts):g} rad "
        f"give {_squares(*tilted)}; gains at which the arm stands give {_squares(*standing)} (the largest is a limit "
        f"cycle of controllers that act every 10 ms). Discretization error: with a tenth of the step {_squares(fine)}."
    )
    factor = found.typical * DEG2 / PAPER_MIPSD
    claim = "How far the lowest joint is from 0 with MIPSD"
    return Claim(claim, f"{PAPER_MIPSD} rad²", _both(found), verdict, why, "Fig. 10", factor, within(FACTOR))


def _improvement(result: ArmHoldResult) -> Claim:
    ratio = result.of().error / result.of(gearbox="mipsd").error
    gains = result.settings.gains
    pairs = zip(gains, _over_gains(result, gearbox="standard"), _over_gains(result, gearbox="mipsd"))
    ratios = [f"{a.typical / b.typical:.2g} at {Kp:g}" for Kp, a, b in pairs if a.stands and b.stands]
    why = (
        f"Rule: the median within a factor {FACTOR:g} of the paper's; in direction if over tenfold for every "
        f"disturbance. Median ratio by gain: {', '.join(ratios)} V/rad. Below "
        f"{least_gain(arm(Case())):.3g} V/rad the servos are weaker than gravity and every arm falls; at "
        "high gains the arm with the compliant gearbox oscillates, where the rigid one is still."
    )
    factor = float(np.median(ratio)) * PAPER_MIPSD / PAPER_STANDARD
    verdict = classify(1.0 / FACTOR < factor < FACTOR, ratio.min() > 10.0)
    paper = f"{PAPER_STANDARD / PAPER_MIPSD:.0f} times less"
    ours = f"{ratio.min():.2g} to {ratio.max():.2g} times less"
    claim = "MIPSD is more stable than the standard model"
    return Claim(claim, paper, ours, verdict, why, "Section 3", factor, within(FACTOR), order=True)


def _unit(result: ArmHoldResult) -> Claim:
    """Return the claim about the unit, from pairs of runs with both printed values in which MIPSD holds."""
    cases = [case for case in result.outcomes if (case.gearbox, case.integrator) == ("standard", EXPLICIT)]
    pairs = {case: (result.outcomes[case], result.outcomes[replace(case, gearbox="mipsd")]) for case in cases}
    still = {case: pair for case, pair in pairs.items() if pair[1].word == "holds"}
    fits = {
        unit: [c for c, (a, b) in still.items() if _near(PAPER_STANDARD, a, unit) and _near(PAPER_MIPSD, b, unit)]
        for unit in ("rad²", "deg²")
    }
    found = ", ".join(f"{c.Kp:g} V/rad with links of {c.link[0]:g} kg, {c.link[1]:g} m" for c in fits["deg²"])
    angles = [math.sqrt(square) for square in (PAPER_STANDARD, PAPER_MIPSD)]
    why = (
        "Rule: yes if more pairs of runs give both numbers as rad². As rad² the rms angles are "
        f"{math.degrees(angles[0]):.0f} and {math.degrees(angles[1]):.1f} deg: an arm that lies down or turns over, "
        f"and a MIPSD fifty times worse than the ±0.05 deg of the paper's Table 3. As deg² they are {angles[0]:.2g} "
        f"and {angles[1]:.2g} deg. Of {len(still)} pairs of explicit runs (gain, step, links, tilt, encoder) in which "
        f"MIPSD holds, {len(fits['rad²'])} give both numbers as rad², {len(fits['deg²'])} as "
        f"deg²{f' ({found})' if found else ''}. Comparisons here are in deg²."
    )
    more = len(fits["deg²"]) - len(fits["rad²"])  # "reproduced" if more as rad²
    ours = "deg² fits better" if more > 0 else "rad² fits better" if more < 0 else "undecided"
    verdict = classify(more < 0)
    return question("The printed 8.14 and 0.0022 rad² are in rad²", ours, verdict, why)


def _rotor(result: ArmHoldResult) -> Claim:
    standard, rotor, implicit = result.of(), result.of(gearbox="rotor"), result.of(integrator=IMPLICIT)
    why = (
        "Rule: with the rotor, a rigid gearbox leaves less than a tenth of the error in the paper's update order. It "
        f"leaves {_decades(standard, rotor):.1f} decades less, and the arm holds at steps up to "
        f"{_longest_step(result, 'rotor')}. The arm without rotor also holds if the torque is integrated implicitly "
        f"({_squares(implicit)}). Either is enough: the explicit step is unstable, not the standard model. "
        f"Discretization error: with a tenth of the step {_squares(result.of(gearbox='rotor', step=1e-4))} with the "
        f"rotor, {_squares(result.of(integrator=IMPLICIT, step=1e-4))} implicitly."
    )
    ratio = standard.error / rotor.error
    verdict = classify(ratio.min() > 10.0 and rotor.sound)
    ours = f"{_squares(standard)} without, {_squares(rotor)} with the rotor"
    return question("The instability comes from the missing rotor inertia", ours, verdict, why)


def _compliance(result: ArmHoldResult) -> Claim:
    rotor, mipsd, alone = result.of(gearbox="rotor"), result.of(gearbox="mipsd"), result.of(**ALONE)
    why = (
        "Rule: the compliant gearbox leaves a smaller error than the rigid one with the same rotor. It leaves "
        f"{_decades(mipsd, rotor):.1f} decades more, because a spring between motor and joint reduces the "
        f"controller's stability margin. The explicit order holds up to steps of {_longest_step(result, 'mipsd')} "
        f"instead of {_longest_step(result, 'rotor')}, because a light link on that spring has a high frequency. "
        f"Without the rotor's inertia a compliant gearbox {alone.word}. The rotor is what helps in MIPSD. "
        f"Discretization error: with a tenth of the step rigid {_squares(result.of(gearbox='rotor', step=1e-4))}, "
        f"compliant {_squares(result.of(gearbox='mipsd', step=1e-4))}."
    )
    verdict = classify(mipsd.typical < rotor.typical)
    ours = f"rigid {_squares(rotor)}, compliant {_squares(mipsd)}"
    return question("The spring-damper gearbox makes the simulation more stable", ours, verdict, why)


def _printed(result: ArmHoldResult) -> Claim:
    words = {(g, i): result.of(gearbox="mipsd", integrator=i, preset=g).word for g in READINGS[:3] for i in INTEGRATORS}
    model = arm(Case(preset="paper_literal"))
    servo = next(iter(model.servos.values()))
    speed = servo.voltage_limit / (servo.gearbox.ratio * servo.motor_constant)  # without load or friction [rad/s]
    torque = math.pi * servo.gearbox.stiffness + servo.gearbox.damping * speed
    limit = servo.gearbox.ratio * 0.2 * servo.gearbox.rotor_inertia / Case.step
    weight = -inverse_dynamics(model, np.radians(1.0) * np.eye(7)[0], np.zeros(7), np.zeros(7))[0]
    why = (
        "Rule: yes if the arm holds with the constants as printed. At the output they transmit at most "
        f"{1e3 * torque:.1g} mN m (half a turn of the spring, damper at no-load speed), but at one degree the lowest "
        f"joint carries {1e3 * weight:.0f} mN m. Scaled to the output as in the program of 2012 (G K, G² B), or both "
        "by G², the damper of 6.45 N m s/rad holds the arm like thick oil; that program limits it to "
        f"{1e3 * limit:.1g} mN m at steps of 1 ms: "
        + ", ".join(f"{g} {i} {word}" for (g, i), word in words.items())
        + ". None of these is a gearbox, hence our `physical`."
    )
    word = words["paper_literal", EXPLICIT]
    paper = "1e-5 N m/rad, 1e-4 N m s/rad"
    verdict = classify(word == "holds")
    claim = "The printed constants K_s and K_B of the gearbox hold the arm"
    return Claim(claim, paper, f"it {word}", verdict, why, "Eq. 4", holds=True)


def _over_gains(result: ArmHoldResult, **model: Any) -> list[Outcome]:
    return [result.of(**model, Kp=Kp) for Kp in result.settings.gains]


def _longest_step(result: ArmHoldResult, gearbox: str) -> str:
    """Return the longest step up to which the explicit order holds the arm, at the default gain."""
    held = 0.0
    for step in sorted({*result.settings.steps, *CHECKED_STEPS}):
        outcome = result.of(gearbox=gearbox, step=step)
        if not (outcome.sound and outcome.stands):
            break
        held = step
    return f"{1e3 * held:g} ms"


def _near(paper: float, outcome: Outcome, unit: str = "deg²") -> bool:
    """Return whether the median is the paper's value within `FACTOR`."""
    return abs(math.log(outcome.typical * (DEG2 if unit == "deg²" else 1.0) / paper)) < math.log(FACTOR)


def _decades(more: Outcome, less: Outcome) -> float:
    return math.log10(more.typical / less.typical)


def _squares(*outcomes: Outcome) -> str:
    """Return the range of the errors over all disturbances."""
    errors = DEG2 * np.concatenate([outcome.error for outcome in outcomes])
    return f"{errors.min():.2g} to {errors.max():.2g} deg²"


def _both(outcome: Outcome) -> str:
    error = outcome.error
    return f"{_squares(outcome)} ({error.min():.2g} to {error.max():.2g} rad²) over {len(error)} disturbances"


# ---------------------------------------------------------------------------------------------- figures

FLOOR, CEILING = 1e-10, 1e5  # of what is shown [deg^2]


class Judged(Protocol):
    """An arm that was held: its median error [rad^2], and how it ended in a word."""

    @property
    def typical(self) -> float: ...

    @property
    def word(self) -> str: ...


@look()
def plot(result: ArmHoldResult) -> dict[str, Figure]:
    """Return the figures, by caption."""
    return {
        "The lowest joint over time (the paper's Figs. 9 and 10), and its error by the second": _over_time(result),
        "Which of three causes holds the arm: rotor inertia, compliance, integration": _factorial(result),
        "Error over gain and step, for every servo model and integrator": _maps(result),
        "What the paper leaves unsaid: disturbance, gain and links, encoder": _dependence(result),
        "The printed gearbox constants, in every reading": _readings(result),
    }


def _over_time(result: ArmHoldResult) -> Figure:
    figure, axes = subplots(11.0, 3.8, 1, 3)
    for panel, gearbox in zip(axes, ("standard", "mipsd")):
        angle = np.degrees(result.of(gearbox=gearbox).angle)
        panel.plot(np.arange(len(angle)) * 0.01, angle, color=SERVO_COLORS[gearbox], linewidth=0.8)
        panel.set(xlabel="time [s]", ylabel="angle of the lowest joint [deg]", title=f"{gearbox}, explicit, 1 ms")
    panel = axes[2]
    for gearbox, integrator in product(GEARBOXES, INTEGRATORS):
        seconds = np.median(result.of(gearbox=gearbox, integrator=integrator).history, axis=0) * DEG2
        times = np.arange(len(seconds)) + 0.5
        label = f"{gearbox}, {INTEGRATOR_NAMES[integrator]}"
        panel.semilogy(times, seconds, LINE_STYLES[integrator], color=SERVO_COLORS[gearbox], label=label)
    _paper_lines(panel)
    panel.set(xlabel="time [s]", ylabel="mean square in a second [deg²]", title="all models, median")
    figure.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return figure


def _paper_lines(panel: Axes, labels: bool = True) -> None:
    for value in (PAPER_STANDARD, PAPER_MIPSD):
        panel.axhline(value, color="0.4", linestyle=":", linewidth=1.0)
        if labels:
            where: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom"}
            panel.annotate(f"paper {value:g}", (0.99, value), fontsize=7, **where)


def factorial(result: ArmHoldResult) -> dict[tuple[bool, bool, bool], Outcome]:
    """Return the outcomes by (rotor inertia, compliance, implicit integration)."""
    cases: dict[tuple[bool, bool], dict[str, Any]] = {
        (False, False): {"gearbox": "standard"},
        (True, False): {"gearbox": "rotor"},
        (False, True): ALONE,
        (True, True): {"gearbox": "mipsd"},
    }
    return {
        (*cause, integrator == IMPLICIT): result.of(integrator=integrator, **case)
        for cause, case in cases.items()
        for integrator in INTEGRATORS
    }


def _factorial(result: ArmHoldResult) -> Figure:
    figure, axes = subplots(8.0, 3.0)
    found, columns = factorial(result), ((False, False), (True, False), (False, True), (True, True))
    grid = [[found[*cause, implicit] for cause in columns] for implicit in (False, True)]
    names = ("neither\n(standard)", "rotor inertia\n(rotor)", "compliance\nwithout rotor", "both\n(mipsd)")
    image = draw_errors(axes, grid, names, tuple(INTEGRATOR_NAMES.values()), 9)
    figure.colorbar(image, ax=axes, label="error [deg²]")
    return figure


def draw_errors(
    panel: Axes, grid: Sequence[Sequence[Judged]], columns: Sequence[str], rows: Sequence[str], size: int
) -> AxesImage:
    """Draw median errors as colors and numbers, with a word where the arm does not hold."""
    from matplotlib.colors import LogNorm

    values = DEG2 * np.array([[outcome.typical for outcome in row] for row in grid])
    panel.grid(False)
    image = panel.imshow(np.clip(values, FLOOR, CEILING), norm=LogNorm(FLOOR, CEILING), cmap="viridis", aspect="auto")
    panel.set_xticks(range(len(columns)), columns)
    panel.set_yticks(range(len(rows)), rows)
    for (k, row), j in product(enumerate(grid), range(len(columns))):
        word = row[j].word
        text = _short(values[k, j]) + ("" if word == "holds" else f"\n{word}")
        color = "black" if values[k, j] > 1e-1 else "white"
        panel.text(j, k, text, ha="center", va="center", fontsize=size, color=color)
    return image


def _short(value: float) -> str:
    if value < FLOOR:
        return f"< {FLOOR:.0e}"
    if 1e-2 <= value < 1e3:
        return f"{float(f'{value:.2g}'):g}"
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def _maps(result: ArmHoldResult) -> Figure:
    figure, axes = subplots(13.0, 2.2 + 0.72 * len(result.settings.gains), 2, 3, sharex=True, sharey=True)
    steps, gains = result.settings.steps, result.settings.gains
    for (k, integrator), (j, gearbox) in product(enumerate(INTEGRATORS), enumerate(GEARBOXES)):
        panel = axes[k, j]
        grid = [[result.of(gearbox=gearbox, integrator=integrator, Kp=Kp, step=h) for h in steps] for Kp in gains]
        image = draw_errors(panel, grid, [f"{1e3 * h:g}" for h in steps], [f"{Kp:g}" for Kp in gains], 7)
        panel.set_title(f"{gearbox}, {INTEGRATOR_NAMES[integrator]}", fontsize=10)
    for panel in axes[-1]:
        panel.set_xlabel("step [ms]")
    for panel in axes[:, 0]:
        panel.set_ylabel("gain [V/rad]")
    figure.colorbar(image, ax=axes, label="median error [deg²]", pad=0.01)
    return figure


def _dependence(result: ArmHoldResult) -> Figure:
    figure, axes = subplots(12.0, 4.2, 1, 3, sharey=True)
    tilt, gain, encoder = axes
    settings = result.settings
    for gearbox, integrator in product(GEARBOXES, INTEGRATORS):
        model = {"gearbox": gearbox, "integrator": integrator}
        style = {"color": SERVO_COLORS[gearbox], "linestyle": LINE_STYLES[integrator], "marker": ".", "linewidth": 1.2}
        label = f"{gearbox}, {INTEGRATOR_NAMES[integrator]}"
        tilted = [result.of(**model, tilt=x) for x in settings.tilts]
        tilt.loglog(settings.tilts, _medians(tilted), label=label, **style)
        gain.semilogy(settings.gains, _medians(_over_gains(result, **model)), **style)
        style |= {"marker": "s", "markersize": 4, "markerfacecolor": "white", "linewidth": 0.8}
        gain.semilogy(settings.gains, _medians(_over_gains(result, **model, link=SMALL)), **style)
    models = list(product(INTEGRATORS, GEARBOXES))
    for exact in (True, False):
        resolution = 0.0 if exact else settings.resolution
        found = [result.of(gearbox=s, integrator=i, resolution=resolution) for i, s in models]
        places = np.arange(len(models)) + (-0.2 if exact else 0.2)
        colors = [SERVO_COLORS[s] for _, s in models]
        inside = colors if exact else "white"
        encoder.scatter(places, _medians(found), 45, c=inside, edgecolors=colors, linewidths=1.5, zorder=3)
    encoder.set_xticks(range(len(models)), [f"{s}\n{'explicit' if i == EXPLICIT else 'implicit'}" for i, s in models])
    encoder.tick_params(axis="x", labelsize=7)
    encoder.set_title("encoder: exact, or the AX-12's (open)", fontsize=10)
    tilt.set(xlabel="initial tilt, standard deviation [rad]", ylabel="error [deg²]")
    tilt.set_title(f"disturbance (values below {FLOOR:g} are drawn there)", fontsize=10)
    gain.set(xlabel="gain [V/rad]", ylim=(FLOOR, CEILING))
    gain.set_title("gain; links of 0.1 kg (dots), 0.07 kg (squares)", fontsize=10)
    for panel in axes:
        _paper_lines(panel, labels=panel is tilt)
    figure.legend(*tilt.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return figure


def _medians(outcomes: list[Outcome]) -> np.ndarray:
    return np.maximum(DEG2 * np.array([outcome.typical for outcome in outcomes]), FLOOR)


def _readings(result: ArmHoldResult) -> Figure:
    figure, axes = subplots(10.0, 3.6, 1, 2, sharey=True)
    inertias = result.settings.rotor_inertias
    for panel, integrator in zip(axes, INTEGRATORS):
        model = {"gearbox": "mipsd", "integrator": integrator}
        grid = [[result.of(**model, preset=g, rotor_inertia=J) for J in inertias] for g in READINGS]
        image = draw_errors(panel, grid, [f"{J:g}" for J in inertias], READINGS, 8)
        panel.set_title(f"mipsd, {INTEGRATOR_NAMES[integrator]}, 1 ms", fontsize=10)
        panel.set_xlabel("rotor inertia [kg m²]")
    figure.colorbar(image, ax=axes, label="median error [deg²]", pad=0.01)
    return figure
