"""Build the firmware of the servos and the supply that feeds them; None of what no servo has."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..base.records import filled
from ..core.effects.actuator import motor_of
from ..core.effects.firmware import BAND, PWM, Delay, Firmware
from ..core.effects.supply import SUPPLY
from ..model import Controller, Model
from .actuator import Drive, wraps

MOST_WAITING = 1000  # voltages of a servo
COUNT = 1e-9  # of a count or a step, that rounding may leave


def build_firmware(model: Model, drive: Drive, h: float, tick_steps: int) -> Firmware:
    """Build the firmware for steps h [s] and sampling periods of `tick_steps` steps.

    Raises ValueError for delays that differ between servos or do not fit the steps.
    """
    if not drive.sampled:
        return Firmware()
    laws = [(servo.controller,) if servo else None for servo in drive.servos]
    stated = [law[0] for law in laws if law]
    profile = np.array([law[0].profile_speed if law else math.inf for law in laws])
    return Firmware(
        band=filled(BAND, laws) if any(law.compliance_margin or law.punch for law in stated) else None,
        pwm=_pwm(laws) if any(law.pwm_steps or law.duty_limit < 1.0 for law in stated) else None,
        profile=profile if np.isfinite(profile).any() else None,
        delay=_delay(model, {law.delay for law in stated}, h, tick_steps),
        wrap=wraps(model, drive.servos),
    )


def _pwm(laws: Sequence[tuple[Controller] | None]) -> np.recarray:
    """Round the largest duty cycle down to a whole number of counts, where there are counts."""
    table = filled(PWM, laws)
    for row in table:
        if row.pwm_steps:
            row.duty_limit = math.floor(row.duty_limit * row.pwm_steps + COUNT) / row.pwm_steps
    return table


def _delay(model: Model, delays: set[float], h: float, tick_steps: int) -> Delay | None:
    if len(delays) > 1:
        raise ValueError(f"{model.name}: controllers differ in delay: {sorted(delays)}; give them the same")
    (delay,) = delays
    steps = round(delay / h)
    if abs(steps * h - delay) > COUNT * delay or (delay and not steps):
        raise ValueError(
            f"timestep {h:g} s does not divide the controllers' delay of {delay:g} s; voltages change between steps: "
            "give compile_scene a timestep that divides it"
        )
    slots, shift = -(-steps // tick_steps), steps % tick_steps
    if slots > MOST_WAITING:
        raise ValueError(
            f"{model.name}: a delay of {delay:g} s lets {slots} voltages wait; at most {MOST_WAITING}: shorten it"
        )
    return Delay(slots, shift) if steps else None


def build_supply(model: Model, drive: Drive) -> np.recarray | None:
    """Build the supply (1,), None without servos or supply.  Raises ValueError for servos without a motor."""
    if model.supply is None or drive.actuator is None:
        return None
    if motor_of(drive.actuator) is None:
        raise ValueError(
            f"{model.name}: a supply feeds motors, and pd servos have none: leave it out, or use a sampled law"
        )
    return filled(SUPPLY, [(model.supply,)])
