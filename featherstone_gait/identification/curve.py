"""Torque, current and efficiency of a servo against speed, in steady state under full voltage and with friction.

    curve = torque_speed(load_servo("ax12a"), 12.0)
    print(curve.stall_torque, curve.no_load_speed, curve.peak_efficiency)

At the speed v the current is I = (V - k v) / R within its limit, k = G K at the output, and drives the joint with
t_m = k I - G^2 B v (B: the rotor's damping, which acts where the gear has a spring).  The load gets

    T = t_m - K_v v - tau_f(t_m, t_e, v),   t_e = -T,

tau_f the budget of dry friction of core/effects/gear_friction.py.  Where it grows with the load, T is on both sides of
a scalar equation with monotonic sides.  At rest, T is the load that the servo still lifts; it holds more than that, by
twice its friction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..base.arguments import instance, real, whole
from ..base.brief import brief
from ..core.effects.gear_friction import BLEND, JAMMING_SHARE
from ..model import TORQUE_LAWS, Servo
from ..view.style import COLORS, look

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..robot_file.servos import ManualPoint

POINTS = 201  # of a curve
MOST_POINTS = 10**6
TIGHT = 1e-14  # relative, of the scalar equations


@dataclass(frozen=True, eq=False)
class TorqueSpeed:
    """A servo from rest to its no-load speed, under a constant voltage.

    Attributes
    ----------
    voltage : float
        [V]
    speed : (n,) ndarray
        Of the joint, rising from 0 [rad/s].
    torque : (n,) ndarray
        On the load [N m]; 0 at the last speed.
    current : (n,) ndarray
        [A]
    efficiency : (n,) ndarray
        Torque times speed over voltage times current [-].
    peak_efficiency : float
        Largest efficiency, also between the points [-].
    """

    voltage: float
    speed: np.ndarray
    torque: np.ndarray
    current: np.ndarray
    efficiency: np.ndarray
    peak_efficiency: float

    __repr__ = brief

    @property
    def stall_torque(self) -> float:
        """Largest load that the servo still lifts [N m]."""
        return float(self.torque[0])

    @property
    def stall_current(self) -> float:
        """Current at rest [A]."""
        return float(self.current[0])

    @property
    def no_load_speed(self) -> float:
        """Speed without load [rad/s]; 0 if friction holds the joint."""
        return float(self.speed[-1])

    @property
    def no_load_current(self) -> float:
        """Current without load [A]."""
        return float(self.current[-1])


def torque_speed(servo: Servo, voltage: float | None = None, points: int = POINTS) -> TorqueSpeed:
    """Compute the torque-speed curve of a servo.

    Parameters
    ----------
    servo : Servo
    voltage : float, optional
        [V]; by default its `voltage_limit`.
    points : int
        Number of speeds.

    Returns
    -------
    TorqueSpeed

    Raises
    ------
    ValueError
        For a servo with a torque law, which has no motor, and for a voltage that is not positive.
    """
    instance("servo", servo, Servo, "give a Servo, as load_servo(name)")
    if servo.controller.law in TORQUE_LAWS:
        raise ValueError(
            f"servo: its law {servo.controller.law!r} has no motor and no such curve; give a servo with a sampled law"
        )
    V = real("voltage", servo.voltage_limit if voltage is None else voltage, 1e-6, 1e6, "give volts")
    points = whole("points", points, 2, "it is a number of speeds", MOST_POINTS)
    top = _no_load_speed(servo, V)
    speed = np.linspace(0.0, top, points)
    torque = np.array([_torque(servo, V, v) for v in speed])
    torque[-1] = torque[-1] if top == 0.0 else 0.0
    current = np.array([_current(servo, V, v) for v in speed])
    efficiency = np.divide(torque * speed, V * current, out=np.zeros(points), where=current > 0.0)
    best = int(np.argmax(efficiency))
    span = speed[max(best - 1, 0)], speed[min(best + 1, points - 1)]
    peak = 0.0
    if span[1] > span[0]:
        from scipy.optimize import minimize_scalar  # slow to import

        power = lambda v: -_torque(servo, V, v) * v / (V * _current(servo, V, v))  # noqa: E731
        peak = -float(minimize_scalar(power, bounds=span, method="bounded", options={"xatol": 1e-9 * span[1]}).fun)
    return TorqueSpeed(V, speed, torque, current, efficiency, max(peak, float(efficiency[best])))


def _current(servo: Servo, V: float, v: float) -> float:
    return min((V - servo.gearbox.ratio * servo.motor_constant * v) / servo.resistance, servo.current_limit)


def _drive(servo: Servo, V: float, v: float) -> float:
    """Return t_m [N m]."""
    G = servo.gearbox.ratio
    return G * servo.motor_constant * _current(servo, V, v) - G * G * servo.gearbox.rotor_damping * v


def _torque(servo: Servo, V: float, v: float) -> float:
    """Return T [N m]; 0 where friction takes the whole drive torque."""
    t_m = _drive(servo, V, v)
    left = t_m - servo.viscous_friction * v
    return _root(lambda T: T + _budget(servo, t_m, -T, v) - left, 0.0, left)


def _no_load_speed(servo: Servo, V: float) -> float:
    """Return the highest speed at which drive torque and friction balance [rad/s]."""

    def excess(v: float) -> float:
        t_m = _drive(servo, V, v)
        return t_m - servo.viscous_friction * v - _budget(servo, t_m, 0.0, v)

    top = V / (servo.gearbox.ratio * servo.motor_constant)
    speeds = np.linspace(top, 0.0, POINTS)
    turns = [excess(v) > 0.0 for v in speeds]
    if not any(turns):
        return 0.0
    k = turns.index(True)
    return _root(lambda v: -excess(v), float(speeds[k]), float(speeds[k - 1])) if k else top


def _root(f: Callable[[float], float], low: float, high: float) -> float:
    """Return the zero of a rising function; `low` if it is not negative there."""
    if f(low) >= 0.0:
        return low
    from scipy.optimize import brentq  # slow to import

    return float(brentq(f, low, high, xtol=1e-300, rtol=TIGHT))


def _budget(servo: Servo, t_m: float, t_e: float, v: float) -> float:
    """Return tau_f [N m] of a joint that turns forwards."""
    g = servo.gearbox
    S = math.exp(-((v / g.stribeck_speed) ** g.stribeck_exponent)) if v > 0.0 else 1.0
    grows = g.external_load_friction + S * g.stribeck_external_load
    seen = t_e * min(1.0, JAMMING_SHARE / grows) if grows > 0.0 else t_e
    square = 0.0
    if t_e * t_m < 0.0:
        w = min(max(0.5 + 0.5 * (abs(t_e) - abs(t_m)) / (BLEND * (abs(t_e) + abs(t_m))), 0.0), 1.0)
        square = (1.0 - w) * g.quadratic_external_load * t_e**2 + w * g.quadratic_motor_load * t_m**2
    load = abs(g.external_load_friction * seen - g.motor_load_friction * t_m) + g.load_product_friction * abs(t_e * t_m)
    slow = g.stribeck_friction + abs(g.stribeck_external_load * seen - g.stribeck_motor_load * t_m) + square
    return servo.coulomb_friction + load + S * slow


@look()
def plot_curves(curves: Mapping[str, TorqueSpeed], manual: Mapping[str, Sequence[ManualPoint]] | None = None) -> Figure:
    """Draw torque, current and efficiency against speed, and the points that manuals state as dots.

    Parameters
    ----------
    curves : mapping of str to TorqueSpeed
        By the names to show.
    manual : mapping of str to sequence of ManualPoint, optional
        Points at stall and without load, by the same names; those at a curve's voltage are drawn.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 8.0), layout="constrained")
    panels = figure.subplots(3, sharex=True)
    for k, (name, curve) in enumerate(curves.items()):
        color = COLORS[k % len(COLORS)]
        for panel, values in zip(panels, (curve.torque, curve.current, 100.0 * curve.efficiency)):
            panel.plot(curve.speed, values, color=color, linestyle=("-", "--", ":")[k // len(COLORS) % 3], label=name)
        for point in (manual or {}).get(name, ()):
            if point.voltage == curve.voltage:
                panels[0].plot([0.0, point.no_load_speed], [point.stall_torque, 0.0], "o", color=color, clip_on=False)
                currents = [point.stall_current, point.no_load_current]
                panels[1].plot([0.0, point.no_load_speed], currents, "o", color=color, clip_on=False)
    for panel, label in zip(panels, ("torque [N m]", "current [A]", "efficiency [%]")):
        panel.set(ylabel=label, xlim=(0.0, None), ylim=(0.0, None))
    panels[-1].set_xlabel("speed of the joint [rad/s]")
    figure.suptitle("lines: simulated; dots: what the manual states")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper")
    return figure
