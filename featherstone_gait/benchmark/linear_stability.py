"""Compute the stable step by linear theory: servos with sampled proportional control, about rest at zero.

Without clipping, friction that sticks, inductance and speed filter the equations of motion are

    M dv/dt = -D v - (K + G) x + B u,      u = -Kp q, held from tick to tick,

x the joint angles q and, with a spring-damper gearbox, the rotors' at the output; G the stiffness of gravity, K that of
the gearbox.  A step of an integrator is then a matrix, and so is a controller period of some steps; it is stable if no
eigenvalue of the latter lies outside the unit circle.  Of the explicit step of 2012 with a rigid gearbox and small Kp
this is h < 2 / lambda(M^-1 D), lambda the largest eigenvalue and D = (G K)^2 / R + B_v.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from ..dynamics import inverse_dynamics, mass_matrix
from ..model import Model, Servo

SMALL_ANGLE = 1e-4  # [rad] for the stiffness of gravity: central difference, its own error some 1e-8


class Linear(NamedTuple):
    """The matrices of the equations of motion; N velocities, n servos."""

    M: np.ndarray  # (N, N) [kg m^2]
    D: np.ndarray  # (N, N) [N m s/rad]
    G: np.ndarray  # (N, N) [N m/rad]
    K: np.ndarray  # (N, N) [N m/rad]
    B: np.ndarray  # (N, n) [N m/V]


def linearized(model: Model, servo: Servo, kind: str) -> Linear:
    """Linearize a robot on a fixed base whose joints all have the servo; kind "standard", "rotor" or "mipsd".

    Raises ValueError for a robot with joints that follow others: they have no motion of their own.
    """
    if model.couplings:
        followers = ", ".join(coupling[0] for coupling in model.couplings)
        raise ValueError(f"{model.name}: joints {followers} follow others; load it with mimic='free' or 'locked'")
    n, g = model.nv, servo.gearbox
    M, one, q, rest = mass_matrix(model, np.zeros(n)), np.eye(n), SMALL_ANGLE * np.eye(n), np.zeros((n, n))
    G = (inverse_dynamics(model, q, rest, rest) - inverse_dynamics(model, -q, rest, rest)).T / (2 * SMALL_ANGLE)
    torque = g.ratio * servo.motor_constant / servo.resistance  # [N m/V]
    motor, own = torque * g.ratio * servo.motor_constant + g.reflected_damping, servo.viscous_friction
    rotor = g.reflected_inertia
    if kind != "mipsd":
        inertia = M + rotor * one if kind == "rotor" else M
        return Linear(inertia, (motor + own) * one, G, 0.0 * one, torque * one)
    between = np.block([[one, -one], [-one, one]])
    return Linear(
        block_diag(M, rotor * one),
        block_diag(own * one, motor * one) + g.damping * between,
        block_diag(G, 0.0 * one),
        g.stiffness * between,
        np.vstack([0.0 * one, torque * one]),
    )


def step_matrix(integrator: str, linear: Linear, h: float) -> np.ndarray:
    """Return the matrix of a step of h [s] on (x, v, a, u), a the last step's acceleration, as the integrators do it.

    The midpoint rule takes gravity where v and a lead; the others have no use for a.
    """
    M, D, G, K, B = linear
    N, n = B.shape
    x, v, a, u = np.split(np.eye(3 * N + n), [N, 2 * N, 3 * N])
    force = B @ u - D @ v - (K + G) @ x
    if integrator == "rk4":
        change = h * np.vstack([v, np.linalg.solve(M, force), 0.0 * a, 0.0 * u])
        powers = [np.linalg.matrix_power(change, k) / math.factorial(k) for k in range(5)]
        whole = sum(powers[1:], powers[0])
        return np.vstack([whole[: 2 * N], 0.0 * a, u])
    if integrator == "simtwo":
        end = v + h * np.linalg.solve(M, force)
        return np.vstack([x + h * end, end, 0.0 * a, u])
    if integrator == "midpoint":
        s = 0.5 * h
        middle = np.linalg.solve(M + s * D + s * s * K, M @ v + s * (B @ u - K @ x - G @ (x + s * (v + s * a))))
        return np.vstack([x + h * middle, 2.0 * middle - v, (middle - v) / s, u])
    if integrator != "implicit_euler":
        raise ValueError(f"integrator {integrator!r}: its linear theory is not written down here; add its step matrix")
    end = np.linalg.solve(M + h * D + h * h * K, M @ v + h * (B @ u - (K + G) @ x))
    return np.vstack([x + h * end, end, 0.0 * a, u])


def growth(integrator: str, linear: Linear, Kp: float, h: float, period: float) -> float:
    """Return the largest growth of a deviation from rest in a controller period, a whole number of steps."""
    N, n = linear.B.shape
    feedback = np.eye(3 * N + n)[:, : 3 * N]
    feedback[3 * N :, :n] = -Kp * np.eye(n)
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.linalg.matrix_power(step_matrix(integrator, linear, h), max(1, round(period / h)))
        whole = (steps @ feedback)[: 3 * N]
    return float(np.abs(np.linalg.eigvals(whole)).max()) if np.isfinite(whole).all() else math.inf
