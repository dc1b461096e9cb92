"""Equation 2 and figure 3: the effect of rotor damping and of the speed feedback.

Rotor damping, T_Bv = B_vr w: the paper gives no B_vr.  Its Table 2 has a viscous constant B_v without saying on which
side of the gear.  So the same arm falls with B_v at the output, with the equivalent damping at the rotor (B_v / G^2),
and with the number of Table 2 as B_vr itself.

State feedback, u = Kp e + Kd (w'_ref - w): the paper gives no gain for the speed error.  So the step of figure 4 and a
sine are simulated for several Kd, with the filter and the sampling of the servo.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from ..base.portable_math import sincos
from ..identification import changed
from ..model import Model
from ..robot_file import load_robot
from ..run.reference import Reference
from ..view.style import look
from .arm_fall import released
from .claim import Claim, classify, span
from .common import ENCODER_STEP, subplots
from .servo_step import driven, step_to

OUTPUT, ROTOR, PRINTED = "B_v at the output", "B_v / G² at the rotor", "B_vr = 0.01278 N m s/rad"


@dataclass(frozen=True)
class ServoTermsSettings:
    """Our choices for what the paper does not state."""

    start: float = 0.5 * math.pi  # [rad] of the fall, horizontal
    fall: float = 2.0  # [s] until the arm hangs
    step: float = math.radians(60.0)  # [rad] as in servo_step
    gains: tuple[float, ...] = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)  # [V s/rad] Kd; the back-EMF's, G K, is 1.73
    amplitude: float = 0.5  # [rad] of the sine, within the servo's speed and current
    frequency: float = 1.0  # [Hz]
    timestep: float = 5e-4  # [s] halved, it changes no angle by more than 0.1 deg


QUICK = ServoTermsSettings()
FULL = ServoTermsSettings(timestep=1e-4)


@dataclass(frozen=True, eq=False)
class ServoTermsResult:
    """Falls by damping, and steps and sines by Kd; angles [rad] of the joint."""

    settings: ServoTermsSettings
    falls: dict[str, np.ndarray]  # (k,)
    fall_time: np.ndarray  # (k,) [s]
    no_load: dict[str, float]  # [rad/s] at 10 V
    steps: dict[float, np.ndarray]  # (m,)
    step_time: np.ndarray  # (m,) [s]
    rms: dict[float, float]  # of reference less angle over the sine's second period [rad]

    def overshoot(self, Kd: float) -> float:
        """Return the overshoot over the size of the step."""
        return max(0.0, float(self.steps[Kd].max()) / self.settings.step - 1.0)

    def rattle(self, Kd: float) -> float:
        """Return the range of the angle over the last fifth of the step [rad]."""
        return float(np.ptp(self.steps[Kd][-len(self.steps[Kd]) // 5 :]))


def run(settings: ServoTermsSettings = QUICK) -> ServoTermsResult:
    """Simulate falls, steps and sines with the spring-damper gearbox."""
    arm = load_robot("ax12_arm")
    (servo,) = arm.servos.values()
    B, G = servo.viscous_friction, servo.gearbox.ratio
    models = {
        OUTPUT: arm,
        ROTOR: changed(arm, viscous_friction=0.0, rotor_damping=B / G**2),
        PRINTED: changed(arm, viscous_friction=0.0, rotor_damping=B),
    }
    h, start = settings.timestep, [settings.start]
    falls = {name: released(model, "mipsd", start, settings.fall, h) for name, model in models.items()}
    steps = {Kd: _following(changed(arm, Kd=Kd), step_to(settings.step), 1.0, h) for Kd in settings.gains}
    K = G * servo.motor_constant
    drive = K * servo.voltage_limit / servo.resistance
    return ServoTermsResult(
        settings=settings,
        falls={name: angles[0] for name, (_, angles) in falls.items()},
        fall_time=falls[OUTPUT][0],
        no_load={  # K V / R = (K² / R + B) w, all at the output
            name: drive / (K * K / servo.resistance + _damping(model)) for name, model in models.items()
        },
        steps={Kd: angle for Kd, (_, angle) in steps.items()},
        step_time=steps[settings.gains[0]][0],
        rms={Kd: _lag(settings, changed(arm, Kd=Kd)) for Kd in settings.gains},
    )


def _damping(model: Model) -> float:
    """Return the viscous damping of a servo with that of its rotor, at the output [N m s/rad]."""
    (servo,) = model.servos.values()
    return servo.viscous_friction + servo.gearbox.reflected_damping


def _lag(settings: ServoTermsSettings, model: Model) -> float:
    """Return the rms error while following a sine, with the reference one lag late."""
    (servo,) = model.servos.values()
    period, w = 1.0 / settings.frequency, 2.0 * math.pi * settings.frequency
    knots = np.arange(0.0, 2.0 * period + 0.02, 0.01)
    reference = Reference(knots, settings.amplitude * sincos(w * knots)[0][:, None])
    time, angle = _following(model, reference, 2.0 * period, settings.timestep)
    asked = settings.amplitude * sincos(w * np.maximum(time - servo.controller.lag, 0.0))[0]
    return float(np.sqrt(np.mean((asked - angle)[time >= period] ** 2)))


def _following(model: Model, reference: Reference, duration: float, h: float) -> tuple[np.ndarray, np.ndarray]:
    run = driven(model, "mipsd", reference, duration, h, record=("q",), record_interval=0.002)
    return run["time"], run["q"][:, 0]


def check(result: ServoTermsResult) -> list[Claim]:
    """Return the claims about equation 2 and figure 3."""
    return [_damping_claim(result), _speed_claim(result)]


def _damping_claim(result: ServoTermsResult) -> Claim:
    """Return the claim: reproduced if damping at the rotor gives the same fall within an encoder count."""
    apart = float(np.abs(result.falls[ROTOR] - result.falls[OUTPUT]).max())
    stuck = math.degrees(result.settings.start - float(result.falls[PRINTED].min()))
    speeds = "; ".join(f"{name} {speed:.3g}" for name, speed in result.no_load.items())
    return Claim(
        claim="Damping at the rotor acts like damping at the output that is G² as large",
        item="Eq. 2",
        paper="no value for B_vr",
        ours=f"the two falls of an arm differ by at most {math.degrees(apart):.2f} deg",
        holds=True,
        verdict=classify(apart < ENCODER_STEP),
        why=f"Rule: within a count of the encoder ({math.degrees(ENCODER_STEP):.2f} deg). The rest is due to the "
        "gearbox's spring. Table 2's B_v cannot be meant as B_vr: the arm would sink only by "
        f"{stuck:.2g} deg in {result.settings.fall:g} s. Speed without load at 10 V [rad/s]: {speeds}",
    )


def _speed_claim(result: ServoTermsResult) -> Claim:
    """Return the claim: reproduced if a gain halves the overshoot without rattling, and following is no worse."""
    gains = result.settings.gains[1:]
    before = result.overshoot(0.0)
    quiet = [Kd for Kd in gains if result.rattle(Kd) < ENCODER_STEP]
    best = min(quiet, key=result.overshoot, default=0.0)
    follows = [Kd for Kd in quiet if result.rms[Kd] <= result.rms[0.0]]
    by_gain = "; ".join(
        f"Kd {Kd:g} V s/rad: {result.overshoot(Kd):.1%}, rms {math.degrees(result.rms[Kd]):.2f} deg"
        + ("" if Kd in (0.0, *quiet) else ", rattles")
        for Kd in result.settings.gains
    )
    return Claim(
        claim="The speed error in the state feedback damps the motion",
        item="Fig. 3",
        order=True,
        paper="in the block diagram, no gain",
        ours=f"overshoot of a {math.degrees(result.settings.step):.0f} deg step {before:.1%} without, "
        f"{result.overshoot(best):.1%} with Kd = {best:g} V s/rad",
        verdict=classify(
            bool(quiet) and result.overshoot(best) < 0.5 * before and bool(follows),
            bool(quiet) and result.overshoot(best) < before,
        ),
        why="Rule: a gain halves the overshoot without rattling, and a gain that does not rattle follows a sine of "
        f"{result.settings.frequency:g} Hz no worse; in direction if it only lowers the overshoot. The filter of "
        "19.5 ms and the sampling at 10 ms limit the gain: "
        f"{by_gain}. Error while following: rms {span([math.degrees(x) for x in result.rms.values()], '.2f')} deg",
    )


@look()
def plot(result: ServoTermsResult) -> dict[str, Figure]:
    """Draw falls by damping, and steps by Kd."""
    figure, (left, right) = subplots(9.0, 3.4, 1, 2)
    for (name, angle), style, color in zip(result.falls.items(), ("-", "--", "-"), ("C0", "C1", "C3")):
        left.plot(result.fall_time, np.degrees(angle), style, color=color, label=name)
    left.set(xlabel="time [s]", ylabel="angle [deg]", title="free fall")
    shades = np.linspace(0.25, 1.0, len(result.steps))
    for shade, (Kd, angle) in zip(shades, result.steps.items()):
        right.plot(result.step_time, np.degrees(angle), color="C0", alpha=shade, label=f"Kd = {Kd:g} V s/rad")
    right.axhline(math.degrees(result.settings.step), color="0.4", linestyle=":", linewidth=1.0)
    right.set(xlabel="time [s]", title="step", xlim=(0.0, 0.6))
    for axes in (left, right):
        axes.legend(fontsize=8)
    return {
        "Left: the forearm falls with viscous friction at the output, as much at the rotor, and Table 2's number taken "
        "for the rotor's (Eq. 2). Right: a step with the speed error in the state feedback (Fig. 3).": figure
    }
