"""The servos in NumPy, for another engine: controller, firmware, supply, motor, backlash, friction, energy meter.

Written from the equations, not from the kernels (`core/effects`), so that each checks the other.  The engine has the
rest: rotor, gearbox spring, viscous friction, and dry friction up to a given budget.  Between two steps
of the engine the motor turns at the speed of the step's start; its current is then exact, L dI/dt = V - K w - R I with
limits on the current and on its rate.  Backlash and friction budgets use the loads at the step's start too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from operator import attrgetter

import numpy as np
from scipy.optimize import brentq

from ..model import Servo, Supply, depends_on_load_or_speed
from ..scene.actuator import TOOTH_LOAD, stall_torque

BLEND = 0.5  # of |t_e| + |t_m|, within which the quadratic terms change over
AT_REST = 1e-3  # [rad/s]: the engine's joints creep where they stick
SLIDING = 0.95  # largest friction of a sliding joint, as a share of its load
GENTLE = 1e-5  # what dry friction's slope times the step may be here [kg m^2]: far below any inertia at a joint


def is_gentle(servo: Servo, h: float) -> bool:
    """Return whether dry friction grows from rest slowly enough for an explicit step h [s]; else the engine has it."""
    gentle = 0.0 < servo.coulomb_friction * h <= GENTLE * servo.stick_speed
    return gentle and not depends_on_load_or_speed(servo.gearbox)


class ServoChain:
    """The servos of all joints; arrays are (n,), one entry a joint.  After `step`, `meter` is the energy drawn [J].

    Joints without a servo (None) get no torque.
    """

    def __init__(self, servos: Sequence[Servo | None], h: float, supply: Supply | None = None) -> None:
        def column(of: Callable[[Servo], float], without: float = 0.0) -> np.ndarray:
            return np.array([without if servo is None else of(servo) for servo in servos], dtype=float)

        n, self.h = len(servos), h
        self.law = np.array(["state" if servo is None else servo.controller.law for servo in servos])
        self.Kp, self.Ki, self.Kd, self.Kf = (column(attrgetter(f"controller.{k}")) for k in ("Kp", "Ki", "Kd", "Kf"))
        self.K = column(lambda servo: servo.gearbox.ratio * servo.motor_constant)  # [N m/A]
        self.R = column(attrgetter("resistance"), 1.0)
        self.most_volts, self.most_amperes = column(attrgetter("voltage_limit")), column(attrgetter("current_limit"))
        self.most_change = h * column(attrgetter("current_slew"))  # of the current in a step [A]
        self.resolution = column(attrgetter("encoder_resolution"))
        self.exact = self.resolution <= 0.0
        z = h * self.R / np.maximum(column(attrgetter("inductance")), 1e-30)
        self.left = np.exp(-z)  # of a current after a step
        self.mean = -np.expm1(-z) / z
        self.filtering = np.exp(-h / np.maximum(column(attrgetter("speed_filter")), 1e-30))
        gentle = [servo is not None and is_gentle(servo, h) for servo in servos]
        self.dry = np.where(gentle, column(attrgetter("coulomb_friction")), 0.0)
        self.stick_speed = np.where(gentle, column(attrgetter("stick_speed")), 1.0)
        self.margin = column(attrgetter("controller.compliance_margin"))
        self.punch, self.counts = column(attrgetter("controller.punch")), column(attrgetter("controller.pwm_steps"))
        self.profile = column(attrgetter("controller.profile_speed"), math.inf)
        duty = column(attrgetter("controller.duty_limit"), 1.0)
        whole = np.floor(duty * self.counts + 1e-9) / np.maximum(self.counts, 1.0)
        self.most_duty = np.where(self.counts > 0.0, whole, duty)
        self.wraps = column(attrgetter("controller.wrap")) > 0.0
        self.delay = max((servo.controller.delay for servo in servos if servo is not None), default=0.0)
        self.supply, self.gears = supply, _Teeth(column)
        self.waiting: list[np.ndarray] = []  # voltages that are under way
        self.voltage, self.current, self.integral, self.last_error, self.filtered, self.meter = np.zeros((6, n))
        self.goal = np.zeros(n)

    def tick(
        self, reference: np.ndarray, rate: np.ndarray, angle: np.ndarray, motor_speed: np.ndarray, period: float
    ) -> None:
        """Compute voltages from references [rad], their rates [rad/s] and the joint angles [rad].

        They act at once, or at `arrive`.  motor_speed: at the output [rad/s].
        """
        counts = np.round(angle / np.where(self.exact, 1.0, self.resolution))
        seen = np.where(self.exact, angle, counts * self.resolution)
        gap = self._short(reference - self.goal)
        late = np.abs(gap) > self.profile * period
        speed = np.copysign(np.where(late, self.profile, 0.0), gap)
        self.goal, rate = np.where(late, self.goal + speed * period, reference), np.where(late, speed, rate)
        error, slower = self._short(self.goal - seen), rate - self.filtered
        e = np.where(self.law == "pid_speed", slower, error)
        e = np.sign(e) * np.maximum(np.abs(e) - self.margin, 0.0)
        integral = self.integral + e * period
        change = np.where(self.law == "state", slower, self._short(e - self.last_error) / period)
        u = self.Kp * e + self.Ki * integral + self.Kd * change + self.Kf * self.goal + self.punch * np.sign(e)
        most = self.most_volts * self.most_duty
        wound = (self.law != "state") & (np.abs(u) >= most)
        self.integral = np.where(wound, self.integral, integral)
        self.last_error = e
        u = _clamped(u, -most, most)
        step = np.where(self.counts > 0.0, self.most_volts / np.maximum(self.counts, 1.0), 0.0)
        u = np.where(step > 0.0, np.round(u / np.where(step > 0.0, step, 1.0)) * step, u)
        if self.delay:
            self.waiting.append(u)
        else:
            self._apply(u, motor_speed)

    def _short(self, angle: np.ndarray) -> np.ndarray:
        """Return angles the short way round, in (-pi, pi], where servos go it [rad]."""
        return np.where(self.wraps, math.pi - np.mod(math.pi - angle, 2.0 * math.pi), angle)

    def arrive(self, motor_speed: np.ndarray) -> None:
        """Apply the oldest delayed voltages; motor_speed: at the output [rad/s]."""
        self._apply(self.waiting.pop(0), motor_speed)

    def _apply(self, u: np.ndarray, motor_speed: np.ndarray) -> None:
        """Apply voltages u [V] of the nominal supply; the source yields V0 - R_s sum_j d_j I_j, steady currents."""
        self.voltage = u
        if self.supply is None:
            return
        duty = u / np.where(self.most_volts > 0.0, self.most_volts, 1.0)
        V0, resistance = self.supply.voltage, self.supply.resistance

        def missing(V: float) -> float:
            free = (duty * V - self.K * motor_speed) / self.R
            return V - V0 + resistance * float(duty @ _clamped(free, -self.most_amperes, self.most_amperes))

        reach = abs(missing(V0))  # the slope is 1 or more
        V = V0 if reach == 0.0 else brentq(missing, V0 - 1.01 * reach, V0 + 1.01 * reach, xtol=1e-13 * V0, rtol=1e-14)
        self.voltage = duty * max(V, 0.0)

    def step(self, motor_speed: np.ndarray) -> np.ndarray:
        """Advance the currents by h at the motors' speed, at the output [rad/s]; return their mean torque [N m]."""
        before = self.current
        steady = (self.voltage - self.K * motor_speed) / self.R
        free = steady + self.left * (before - steady)
        end = _clamped(free, before - self.most_change, before + self.most_change)
        end = _clamped(end, -self.most_amperes, self.most_amperes)
        steady = (end - self.left * before) / (1.0 - self.left)  # the same course, if nothing clips
        mean = steady + self.mean * (before - steady)
        self.current = end
        self.meter += self.h * np.maximum(0.0, self.voltage * mean)
        return self.K * mean

    def friction(self, speed: np.ndarray) -> np.ndarray:
        """Return the dry friction on the joints [N m] where it is gentle."""
        return -self.dry * _clamped(speed / self.stick_speed, -1.0, 1.0)

    def filter(self, speed: np.ndarray) -> None:
        """Advance the filtered speed to the step's end, where the joints have this speed."""
        self.filtered = speed + self.filtering * (self.filtered - speed)


class _Teeth:
    """Gear trains: tooth forces across the backlash, and load-dependent friction."""

    def __init__(self, column: Callable[..., np.ndarray]) -> None:
        def of(name: str, without: float = 0.0) -> np.ndarray:
            return column(lambda servo: getattr(servo.gearbox, name), without)

        self.K, self.gap = of("stiffness"), 0.5 * of("backlash")
        self.loose = self.gap > 0.0
        stall = column(lambda servo: min(stall_torque(servo), 1e300), 1.0)
        self.d = of("damping") / (TOOTH_LOAD * stall)  # Hunt and Crossley's [s/rad]
        self.K_e, self.K_m, self.K_p = (of(f"{k}_friction") for k in ("external_load", "motor_load", "load_product"))
        self.K_cs, self.K_es, self.K_ms = (of(f"stribeck_{k}") for k in ("friction", "external_load", "motor_load"))
        self.K_eq, self.K_mq = of("quadratic_external_load"), of("quadratic_motor_load")
        self.v_s, self.alpha = of("stribeck_speed", 1.0), of("stribeck_exponent", 1.0)

    def torque(self, e: np.ndarray, de: np.ndarray) -> np.ndarray:
        """Return the tooth forces across the backlash as torques on the joints [N m]; e: rotor less joint [rad]."""
        depth = np.maximum(np.abs(e) - self.gap, 0.0)
        push = np.where(depth > 0.0, np.where(self.loose, self.K, 0.0), 0.0) * depth
        return np.sign(e) * push * np.maximum(1.0 + self.d * de * np.sign(e), 0.0)

    def budget(self, speed: np.ndarray, t_m: np.ndarray, t_e: np.ndarray) -> np.ndarray:
        """Return the largest dry friction beyond Coulomb's [N m], models M2 to M6 (core/effects/gear_friction.py).

        t_m drives the joints, t_e is the mechanism's load on them [N m].
        """
        S = np.exp(-((np.abs(speed) / self.v_s) ** self.alpha))
        share = np.minimum(1.0, SLIDING / np.maximum(self.K_e + S * self.K_es, SLIDING))
        share = np.where(np.abs(speed) < AT_REST, 1.0, share)
        size_e, size_m = np.abs(t_e), np.abs(t_m)
        w = np.clip(0.5 + (size_e - size_m) / (2.0 * BLEND * np.maximum(size_e + size_m, 1e-300)), 0.0, 1.0)
        square = np.where(t_e * t_m < 0.0, (1.0 - w) * self.K_eq * t_e**2 + w * self.K_mq * t_m**2, 0.0)
        slow = self.K_cs + np.abs(self.K_es * share * t_e - self.K_ms * t_m) + square
        return np.abs(self.K_e * share * t_e - self.K_m * t_m) + self.K_p * size_e * size_m + S * slow


def _clamped(x: np.ndarray, low: np.ndarray | float, high: np.ndarray | float) -> np.ndarray:
    """Clip like np.clip, in half its time for few numbers."""
    return np.minimum(np.maximum(x, low), high)
