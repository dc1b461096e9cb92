"""The servos once more, in NumPy and for another engine: sampled controller, motor current, dry friction, meter.

Written from the equations, not from the kernels (`core/effects`), so that one is a check on the other.  The engine has
the rest: rotor, gearbox spring, viscous friction.  Between two steps of the engine the motor turns at the speed of the
step's start; its current is then exact, L dI/dt = V - K w - R I with limits on the current and on its rate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..model import Servo

GENTLE = 1e-5  # what dry friction's slope times the step may be here [kg m^2]: far below any inertia at a joint


def is_gentle(servo: Servo, h: float) -> bool:
    """Whether dry friction grows from rest so slowly that an explicit step h [s] sees it; else it is the engine's."""
    return 0.0 < servo.coulomb_friction * h <= GENTLE * servo.stick_speed


class ServoChain:
    """The servos of all joints; arrays are (n,), one entry a joint.  After `step`, `meter` is the energy drawn [J].

    Joints without a servo (None) get no torque.
    """

    def __init__(self, servos: Sequence[Servo | None], h: float) -> None:
        def column(of: Callable[[Servo], float], without: float = 0.0) -> np.ndarray:
            return np.array([without if servo is None else of(servo) for servo in servos], dtype=float)

        n, self.h = len(servos), h
        self.law = np.array(["state" if servo is None else servo.controller.law for servo in servos])
        self.Kp = column(lambda servo: servo.controller.Kp)
        self.Ki = column(lambda servo: servo.controller.Ki)
        self.Kd = column(lambda servo: servo.controller.Kd)
        self.Kf = column(lambda servo: servo.controller.Kf)
        self.K = column(lambda servo: servo.gearbox.ratio * servo.motor_constant)  # [N m/A]
        self.R = column(lambda servo: servo.resistance, 1.0)
        self.most_volts = column(lambda servo: servo.voltage_limit)
        self.most_amperes = column(lambda servo: servo.current_limit)
        self.most_change = h * column(lambda servo: servo.current_slew)  # of the current in a step [A]
        self.resolution = column(lambda servo: servo.encoder_resolution)
        self.exact = self.resolution <= 0.0
        z = h * self.R / np.maximum(column(lambda servo: servo.inductance), 1e-30)
        self.left = np.exp(-z)  # of a current after a step
        self.mean = -np.expm1(-z) / z
        self.filtering = np.exp(-h / np.maximum(column(lambda servo: servo.speed_filter), 1e-30))
        gentle = [servo is not None and is_gentle(servo, h) for servo in servos]
        self.dry = np.where(gentle, column(lambda servo: servo.coulomb_friction), 0.0)
        self.stick_speed = np.where(gentle, column(lambda servo: servo.stick_speed), 1.0)
        self.voltage, self.current, self.integral, self.last_error, self.filtered, self.meter = np.zeros((6, n))

    def tick(self, reference: np.ndarray, rate: np.ndarray, angle: np.ndarray, period: float) -> None:
        """Set the voltages from references [rad], their rates [rad/s] and the joints' angles [rad]."""
        counts = np.round(angle / np.where(self.exact, 1.0, self.resolution))
        seen = np.where(self.exact, angle, counts * self.resolution)
        error, slower = reference - seen, rate - self.filtered
        e = np.where(self.law == "pid_speed", slower, error)
        integral = self.integral + e * period
        change = np.where(self.law == "state", slower, (e - self.last_error) / period)
        u = self.Kp * e + self.Ki * integral + self.Kd * change + self.Kf * reference
        wound = (self.law != "state") & (np.abs(u) >= self.most_volts)
        self.integral = np.where(wound, self.integral, integral)
        self.last_error = e
        self.voltage = _clamped(u, -self.most_volts, self.most_volts)

    def step(self, motor_speed: np.ndarray) -> np.ndarray:
        """Move the currents on by h at the motors' speed, at the output [rad/s]; their mean torque [N m]."""
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
        """Dry friction on the joints at their speed [N m], of those where it is gentle."""
        return -self.dry * _clamped(speed / self.stick_speed, -1.0, 1.0)

    def filter(self, speed: np.ndarray) -> None:
        """Move the filtered speed to the step's end, where the joints have this speed."""
        self.filtered = speed + self.filtering * (self.filtered - speed)


def _clamped(x: np.ndarray, low: np.ndarray | float, high: np.ndarray | float) -> np.ndarray:
    """As np.clip, in half its time for few numbers."""
    return np.minimum(np.maximum(x, low), high)
