"""Figure 4: the step response of one servo.

The paper lays the model's response over that of a real AX-12 and finds that they agree; size of the step, load, supply
and gains are not stated, and the measured curve is a picture.  What the real servo must do is published, though: the
no-load speed bounds the slope of the step, the stall torque its start, and the compliance law of the controller its
end.  So the model's step is compared with these figures.

AX-12 figures: [manual] https://emanual.robotis.com/docs/en/dxl/ax/ax-12a (59 rpm and 1.5 N m, 1.5 A at 12 V; compliance
margin 1, slope 32, punch 32 of 1023; 300 deg in 1023 counts), [original] the first AX-12,
https://os.mbed.com/cookbook/Dynamixel-AX12-Servo (16.5 kgf cm, 0.9 A, up to 10 V).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..identification import changed
from ..model import Model
from ..robot_file import load_robot
from ..run.reference import Reference
from ..run.simulate import simulate
from ..run.trajectory import Trajectory
from ..scene.compile import GearboxKind, compile_scene
from ..scene.tree import GRAVITY
from ..view.style import COLORS as CYCLE
from ..view.style import look
from .claim import NO_CURVE, Claim, classify, plus_minus, question
from .common import ENCODER_STEP, RECORDING, SERVO_COLORS, subplots

MARGIN = 1 * ENCODER_STEP  # compliance margin: no output within it [rad], [manual]
SLOPE = 32 * ENCODER_STEP  # compliance slope: error over which the output rises to full [rad], [manual]
PUNCH = 32 / 1023  # smallest output, of full, [manual]
NO_LOAD = 59 * 2.0 * math.pi / 60 / 12  # no-load speed by supply [rad/(s V)], [manual]
STALL = {10.0: 16.5 * 0.0980665, 12.0: 1.5}  # stall torque at a supply [N m], [original], [manual]
CURRENT = {10.0: 0.9, 12.0: 1.5}  # largest current at a supply [A], [original], [manual]
DEGREES = math.degrees(1.0)
ERROR = "After ±: the change at half the step, where it shows in the last digit"
TOLERANCE = 0.1  # within which a figure counts as the same: catalogs give no-load speeds to about 10 %


@dataclass(frozen=True)
class ServoStepSettings:
    """Our choices for what the paper does not state."""

    step: float = math.radians(60.0)  # [rad] usual in catalogs of servos, and long enough to reach full speed
    duration: float = 1.5  # [s] five times the rise
    supplies: tuple[float, ...] = (9.6, 10.0, 12.0)  # [V] Bioloid's battery, limit of the first AX-12, of today's
    inertias: tuple[float, ...] = (5e-8, 1e-7, 3e-7)  # [kg m^2] rotors of servos of this size
    frictions: tuple[float, ...] = (1.71e-5, 4.34e-3, 0.03)  # [N m] Table 2 as printed; times the ratio; a worn servo's
    timestep: float = 5e-4  # [s] halved, it changes no angle by more than 0.1 deg


QUICK = ServoStepSettings()
FULL = ServoStepSettings(timestep=1e-4)


@dataclass(frozen=True, eq=False)
class Step:
    """One response and its characteristics."""

    label: str
    time: np.ndarray  # [s]
    angle: np.ndarray  # [rad]
    rise: float  # from 10 to 90 % [s]
    speed: float  # largest [rad/s]
    overshoot: float  # over the step [rad]
    error: float  # angle less reference at the end [rad]
    finer: Step | None = None  # at half the step

    def stated(self, name: str, scale: float, form: str) -> str:
        """Return one of the numbers, times `scale`, with its change at half the step."""
        return plus_minus(scale * getattr(self, name), scale * getattr(self.finer, name), form)


@dataclass(frozen=True, eq=False)
class ServoStepResult:
    """Responses by varied parameter, and the servo's limits by supply."""

    settings: ServoStepSettings
    gearboxes: dict[str, Step]  # "standard", "mipsd"; at 10 V
    supplies: dict[float, Step]
    inertias: dict[float, Step]
    frictions: dict[float, Step]
    no_load: dict[float, float]  # speed without load at a supply [rad/s]
    stall: dict[float, float]  # torque of the blocked servo at a supply [N m]
    load: float  # torque of gravity at the end of the step [N m]
    stiffness: float  # torque by error of the controller [N m/rad]


def run(settings: ServoStepSettings = QUICK) -> ServoStepResult:
    """Simulate all responses."""
    arm = load_robot("ax12_arm")
    ten = _supplied(arm, 10.0)
    servo, supplied = ten.servos["elbow"], {volts: _supplied(arm, volts) for volts in {*settings.supplies, *STALL}}
    gravity = -GRAVITY[2] * sum(link.mass * -link.center_of_mass[2] for link in arm.links)
    return ServoStepResult(
        settings=settings,
        gearboxes={kind: _step(settings, ten, kind, kind) for kind in ("standard", "mipsd")},
        supplies={volts: _step(settings, supplied[volts], f"{volts:g} V") for volts in settings.supplies},
        inertias={J: _step(settings, changed(ten, rotor_inertia=J), f"J = {J:g} kg m²") for J in settings.inertias},
        frictions={
            F: _step(settings, changed(ten, coulomb_friction=F), f"F = {F:.3g} N m") for F in settings.frictions
        },
        no_load={volts: _no_load(settings, supplied[volts]) for volts in settings.supplies},
        stall={volts: _stall(settings, supplied[volts]) for volts in STALL},
        load=gravity * math.sin(settings.step),
        stiffness=servo.controller.Kp * servo.gearbox.ratio * servo.motor_constant / servo.resistance,
    )


def _supplied(model: Model, volts: float) -> Model:
    """Return the servo on a supply: full voltage at the end of the compliance slope, and its current limit."""
    current = CURRENT[12.0] if volts > 10.0 else CURRENT[10.0]
    return changed(model, voltage_limit=volts, Kp=volts / SLOPE, current_limit=current)


def _step(settings: ServoStepSettings, model: Model, label: str, kind: GearboxKind = "mipsd") -> Step:
    """Simulate a response, and the same at half the step."""
    found, finer = (_response(settings, model, label, kind, h * settings.timestep) for h in (1.0, 0.5))
    return replace(found, finer=finer)


def _response(settings: ServoStepSettings, model: Model, label: str, kind: GearboxKind, timestep: float) -> Step:
    recording: Any = {"record": ("q", "qd"), "record_interval": timestep}
    run = driven(model, kind, step_to(settings.step), settings.duration, timestep, **recording)
    time, angle = run["time"], run["q"][:, 0]
    first, last = (_reached(time, angle, share * settings.step) for share in (0.1, 0.9))
    overshoot = max(0.0, float(angle.max()) - settings.step)
    return Step(label, time, angle, last - first, float(run["qd"].max()), overshoot, angle[-1] - settings.step)


def _reached(time: np.ndarray, angle: np.ndarray, level: float) -> float:
    """Return the time at which the angle first reaches `level` [s]."""
    k = int(np.argmax(angle >= level))
    return float(np.interp(level, angle[k - 1 : k + 1], time[k - 1 : k + 1]))


def _no_load(settings: ServoStepSettings, model: Model) -> float:
    """Return the speed at full voltage without gravity and stops [rad/s]."""
    turning = replace(model.joints[-1], lower=-100.0, upper=100.0)
    free = replace(model, joints=(*model.joints[:-1], turning))
    return float(driven(free, "rotor", step_to(99.0), 1.0, settings.timestep, (0, 0, 0), record=("qd",))["qd"][-1, 0])


def _stall(settings: ServoStepSettings, model: Model) -> float:
    """Return the torque at full voltage against the stop [N m]."""
    run = driven(model, "rotor", step_to(100.0), 2.0, settings.timestep, (0, 0, 0), record=("torque",))
    return float(run["torque"][-1, 0])


def driven(
    model: Model,
    kind: GearboxKind,
    reference: Reference,
    duration: float,
    timestep: float,
    gravity: Any = GRAVITY,
    **recording: Any,
) -> Trajectory:
    """Simulate a servo that follows a reference; recording: options of `simulate`."""
    scene = compile_scene(model, kind, integrator="implicit_euler", timestep=timestep, gravity=gravity)
    return simulate(scene, duration, reference=reference, estimate_error=False, **recording)


def step_to(angle: float) -> Reference:
    """Return the reference that is an angle [rad] from the start."""
    return Reference([0.0], [[angle]])


def check(result: ServoStepResult) -> list[Claim]:
    """Return the claims of section 2.2 and of section 3 about the step."""
    claims = (_step_claim, _torque_claim, _gearbox_claim, _no_load_claim, _speed_claim, _error_claim)
    return [claim(result) for claim in claims]


def _step_claim(result: ServoStepResult) -> Claim:
    """Return the claim; the paper shows the measured curve as a picture only, so that none can be compared with."""
    rises = (result.gearboxes[kind].stated("rise", 1e3, ".0f") for kind in ("standard", "mipsd"))
    return Claim(
        claim="Model and real servo agree in a step",
        item="Fig. 4",
        paper="curves coincide",
        ours="rise {} ms standard, {} ms MIPSD".format(*rises),
        verdict=NO_CURVE,
        why="The measured curve is a picture without its numbers; size of the step, load, supply and gains are not "
        f"stated. {RECORDING} What the manual of the AX-12 bounds is asked below, as questions of our own",
    )


def _no_load_claim(result: ServoStepResult) -> Claim:
    """Return the answer: yes if the no-load speed is the manual's within the tolerance at every supply."""
    off = {volts: speed / (NO_LOAD * volts) - 1.0 for volts, speed in result.no_load.items()}
    return question(
        claim="The model turns as fast as the AX-12's manual says, without load",
        ours=f"{result.no_load[12.0]:.2f} rad/s at 12 V, the manual {12 * NO_LOAD:.2f} ({off[12.0]:+.1%})",
        verdict=classify(max(map(abs, off.values())) < TOLERANCE),
        why=f"Rule: within {TOLERANCE:.0%} of the manual's, which is taken in proportion to the supply, at "
        f"{', '.join(f'{volts:g}' for volts in off)} V: off by {min(off.values()):+.1%} to {max(off.values()):+.1%}",
    )


def _speed_claim(result: ServoStepResult) -> Claim:
    """Return the answer: yes if no gearbox exceeds the manual's no-load speed by more than the tolerance in a step."""
    limit, steps = 10.0 * NO_LOAD, [result.gearboxes[kind] for kind in ("standard", "mipsd")]
    standard, mipsd = (step.stated("speed", 1.0, ".2f") for step in steps)
    return question(
        claim="In a step the model keeps to the speed that the AX-12's manual allows",
        ours=f"at most {standard} rad/s standard, {mipsd} rad/s MIPSD, the manual {limit:.2f} at 10 V",
        verdict=classify(all(step.speed < (1.0 + TOLERANCE) * limit for step in steps)),
        why=f"Rule: with neither gearbox more than {TOLERANCE:.0%} above the manual's no-load speed. Without rotor "
        "inertia the speed overshoots this limit for some milliseconds: the "
        f"time constants of current and forearm on the back-EMF are 0.6 and 0.7 ms. {ERROR}",
    )


def _torque_claim(result: ServoStepResult) -> Claim:
    """Return the claim: reproduced if the stall torque is right at both supplies."""
    stall = result.stall
    off = {volts: torque / STALL[volts] - 1.0 for volts, torque in stall.items()}
    return Claim(
        claim="With these constants the servo is as strong as the real one",
        item="Table 2",
        factor=stall[12.0] / STALL[12.0],
        paper=f"published stall torque: {STALL[10.0]:.2f} N m at 10 V, 0.9 A; {STALL[12.0]:.2f} N m at 12 V, 1.5 A",
        ours=", ".join(f"{torque:.2f} N m at {volts:g} V ({off[volts]:+.0%})" for volts, torque in stall.items()),
        accepted=(1.0 - TOLERANCE, 1.0 + TOLERANCE),
        verdict=classify(max(map(abs, off.values())) < TOLERANCE),
        why=f"Rule: within {TOLERANCE:.0%} at both supplies. At 10 V the current limit of 0.9 A "
        "bounds the torque. Table 2 gives 1.73 N m/A at the output, the manual's figures for 12 V give 1.00 N m/A: the "
        "model lacks the losses of the gearbox under load (efficiency 0.58). A step of a light arm does not show them",
    )


def _error_claim(result: ServoStepResult) -> Claim:
    """Return the answer: yes if the final error is that of the compliance law within an encoder count."""
    ours = result.gearboxes["standard"].error
    standard, mipsd = (result.gearboxes[kind].stated("error", DEGREES, ".3f") for kind in ("standard", "mipsd"))
    linear = -result.load / result.stiffness
    real = -_compliance_error(result)
    same = abs(ours - real) < ENCODER_STEP
    return question(
        claim="A step ends where the compliance law of the AX-12's manual lets it",
        ours=f"{standard} deg (MIPSD {mipsd} deg); load by stiffness {math.degrees(linear):.3f} deg; the manual's law "
        f"up to {math.degrees(real):.2f} deg",
        verdict=classify(same),
        why=f"Rule: the difference is less than one count of the encoder. It is {math.degrees(abs(ours - real)):.2f} "
        f"deg, one count {math.degrees(ENCODER_STEP):.2f} deg. The paper's controller is linear; the real one outputs "
        "nothing within a margin of one count and at least 3 % beyond it, which holds this arm at the edge of the "
        "margin"
        if same
        else "the linear controller of the paper has neither margin nor punch",
    )


def _compliance_error(result: ServoStepResult) -> float:
    """Return the error at which the manual's law carries the load [rad]."""
    full = result.stiffness * SLOPE  # torque at full voltage without current limit [N m]
    share = result.load / full
    return MARGIN if share < PUNCH else MARGIN + (share - PUNCH) / (1.0 - PUNCH) * SLOPE


def _gearbox_claim(result: ServoStepResult) -> Claim:
    """Return the claim: reproduced if rise time and overshoot are the same within the tolerance."""
    standard, mipsd = result.gearboxes["standard"], result.gearboxes["mipsd"]
    percent = 100.0 / result.settings.step
    longer, over = mipsd.rise / standard.rise - 1.0, mipsd.overshoot / result.settings.step
    same = abs(longer) < TOLERANCE and over < TOLERANCE
    by_inertia = ", ".join(
        f"{J:g} kg m²: {step.stated('rise', 1e3, '.0f')} ms, {step.stated('overshoot', percent, '.1f')} %"
        for J, step in result.inertias.items()
    )
    return Claim(
        claim="The improved gearbox keeps the servomotor unchanged: a step",
        item="Section 3",
        paper="servomotor model and controller unchanged",
        ours=f"rise {standard.stated('rise', 1e3, '.0f')} ms standard, {mipsd.stated('rise', 1e3, '.0f')} ms MIPSD "
        f"({longer:+.0%}); overshoot {standard.stated('overshoot', percent, '.1f')} and "
        f"{mipsd.stated('overshoot', percent, '.1f')} %",
        holds=True,
        verdict=classify(same),
        why=f"Rule: rise time and overshoot within {TOLERANCE:.0%}. Both depend on the rotor inertia, which the paper "
        f"does not give (rise, overshoot): {by_inertia}. {ERROR}",
    )


@look()
def plot(result: ServoStepResult) -> dict[str, Figure]:
    """Draw the step as in Fig. 4, and its dependence on parameters."""
    return {
        "Step response of one AX-12 that carries the forearm, as in Fig. 4, with what the servo's manual allows: the "
        "dashed slope is the no-load speed, the gray band the compliance margin. Right: enlarged.": _main(result),
        "What the step depends on and the paper does not state: supply, rotor inertia and the reading of the Coulomb "
        "friction (all MIPSD).": _dependence(result),
    }


def _main(result: ServoStepResult) -> Figure:
    figure, (whole, detail) = subplots(9.0, 3.6, 1, 2, sharey=True)
    target = math.degrees(result.settings.step)
    for axes in (whole, detail):
        for kind, step in result.gearboxes.items():
            axes.plot(step.time, np.degrees(step.angle), color=SERVO_COLORS[kind], linewidth=1.6, label=step.label)
        axes.axhspan(*(target + math.degrees(MARGIN) * side for side in (-1, 1)), color="0.85", zorder=0)
        axes.axhline(target, color="0.4", linestyle=":", linewidth=1.0)
        axes.set_xlabel("time [s]")
    time = np.array([0.0, result.settings.step / (10 * NO_LOAD)])
    slope = np.degrees(10 * NO_LOAD * time)
    detail.plot(time + 0.02, slope, color="0.5", linestyle="--", label="no-load speed, manual")
    detail.set_xlim(0.0, 2.0 * result.gearboxes["standard"].rise)
    whole.set_ylabel("angle [deg]")
    detail.legend(loc="lower right")
    return figure


def _dependence(result: ServoStepResult) -> Figure:
    figure, panels = subplots(9.0, 3.4, 1, 3, sharey=True)
    for axes, steps, title in zip(
        panels, (result.supplies, result.inertias, result.frictions), ("supply", "rotor inertia", "Coulomb friction")
    ):
        for k, step in enumerate(steps.values()):
            axes.plot(step.time, np.degrees(step.angle), ("-", "--", ":")[k], color=CYCLE[k], label=step.label)
        axes.set(xlabel="time [s]", xlim=(0.0, 0.5), title=title)
        axes.legend(loc="lower right", fontsize=8)
    panels[0].set_ylabel("angle [deg]")
    return figure
