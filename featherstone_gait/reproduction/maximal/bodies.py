"""Free bodies: where they are, what they carry, how they move on (semi-implicit Euler), and the angles of joints."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.compile.elementary import PI, sincos
from ...core.compile.jit import inline, kernel
from ...core.compile.lanes import sqrt
from ...core.tree.kinematics import quaternion_matrix, unit_quaternion
from ...core.tree.spatial import (
    add,
    compose,
    congruence,
    cross,
    dot,
    load3,
    load6,
    load9,
    rotate,
    rotate_back,
    scale,
    store3,
    store9,
    sub,
    symmetric,
)
from .layout import FORCE, INVERSE, MOMENT, PLACE, SPEED, SPIN, TURN, R

DAMPED = 0.01  # speed from which on damping acts [m/s and rad/s], ODE's default


@inline
def kept(x: float, single: int) -> float:
    """Round a number to single precision if the engine does."""
    if single:
        return float(np.float32(x))
    return x


@kernel
def refresh(w: Any, x: Any) -> None:
    """Update the rotations and inverse inertias of the bodies."""
    X = x.X
    for i in range(len(w.bodies)):
        E = quaternion_matrix(X[i])  # whose quaternion stands behind a place, as in a base's coordinates
        store9(X, i, R, E)
        J = congruence(E, w.bodies[i].inverse_inertia)
        for k in range(6):
            X[i, INVERSE + k] = J[k]


@kernel
def load(w: Any, x: Any, gravity: np.ndarray) -> None:
    """Set forces and moments of all bodies: the weight, gyroscopic moments, the torques of the axes."""
    X = x.X
    for i in range(len(w.bodies)):
        b, E = w.bodies[i], load9(X, i, R)
        spin = rotate_back(E, load3(X, i, SPIN))
        store3(X, i, FORCE, scale(gravity, b.mass))
        store3(X, i, MOMENT, rotate(E, cross(symmetric(b.inertia, spin), spin)))
    for k in range(len(w.joints)):
        j = w.joints[k]
        moment = scale(first_axis(X, j), x.torque[j.axis])
        if j.universal:
            moment = add(moment, scale(second_axis(X, j), x.torque[j.second_axis]))
        store3(X, j.b, MOMENT, add(load3(X, j.b, MOMENT), moment))
        store3(X, j.a, MOMENT, sub(load3(X, j.a, MOMENT), moment))


@kernel
def move(w: Any, x: Any, h: float) -> None:
    """Integrate velocities with the constraints' accelerations S, then positions."""
    X, S, e = x.X, x.S, w.engine[0]
    for i in range(len(w.bodies)):
        b = w.bodies[i]
        if b.inverse_mass > 0.0:
            a = add(load3(S, i, 0), scale(load3(X, i, FORCE), b.inverse_mass))
            alpha = add(load3(S, i, 3), symmetric(load6(X, i, INVERSE), load3(X, i, MOMENT)))
            v = add(load3(X, i, SPEED), scale(a, h))
            spin = add(load3(X, i, SPIN), scale(alpha, h))
            store3(X, i, PLACE, add(load3(X, i, PLACE), scale(v, h)))
            _turn(X, i, scale(spin, 0.5 * h))
            if dot(v, v) > DAMPED * DAMPED:
                v = scale(v, 1.0 - e.linear_damping)
            if dot(spin, spin) > DAMPED * DAMPED:
                spin = scale(spin, 1.0 - e.angular_damping)
            store3(X, i, SPEED, v)
            store3(X, i, SPIN, spin)
            for k in range(R):
                X[i, k] = kept(X[i, k], e.single)
    refresh(w, x)


@inline
def _turn(X: np.ndarray, i: int, half: Any) -> None:
    """Turn the quaternion by Euler's step, and normalize it; half: of the angle in the step [rad]."""
    a, b, c, d = X[i, TURN], X[i, TURN + 1], X[i, TURN + 2], X[i, TURN + 3]
    p, q, r = half
    X[i, TURN] = a - (p * b + q * c + r * d)
    X[i, TURN + 1] = b + (p * a + q * d - r * c)
    X[i, TURN + 2] = c + (q * a + r * b - p * d)
    X[i, TURN + 3] = d + (r * a + p * c - q * b)
    unit_quaternion(X[i], TURN)


@kernel
def angle_of(sine: float, cosine: float) -> float:
    """Return the angle of a vector of nonzero length, between -pi and pi [rad].

    A polynomial good to 1e-5 (Abramowitz and Stegun 4.4.49), then what the exact sine of the rest adds.
    """
    s, c = abs(sine), abs(cosine)
    z = min(s, c) / max(s, c)
    u = z * z
    t = z * (0.9998660 + u * (-0.3302995 + u * (0.1801410 + u * (-0.0851330 + u * 0.0208351))))
    if s > c:
        t = 0.5 * PI - t
    if cosine < 0.0:
        t = PI - t
    if sine < 0.0:
        t = -t
    near = sincos(t)
    rest = (sine * near[1] - cosine * near[0]) / sqrt(sine * sine + cosine * cosine)
    return t + rest * (1.0 + rest * rest * (1.0 / 6.0))


@inline
def _set_angle(q: np.ndarray, i: int, sine: float, cosine: float) -> None:
    """Set the angle of axis i, with the number of turns that brings it nearest to the last one."""
    angle = angle_of(sine, cosine)
    q[i] = angle + 2.0 * PI * np.floor((q[i] - angle) / (2.0 * PI) + 0.5)


@inline
def first_axis(X: np.ndarray, j: Any) -> Any:
    """Return the (first) axis of a joint, fixed in its body a."""
    return rotate(load9(X, j.a, R), (j.first[2], j.first[5], j.first[8]))


@inline
def second_axis(X: np.ndarray, j: Any) -> Any:
    """Return z of body b: the axis of a hinge, and the second axis of a universal joint."""
    return (X[j.b, R + 2], X[j.b, R + 5], X[j.b, R + 8])


@kernel
def measure(w: Any, x: Any) -> None:
    """Measure angles and rates of all axes."""
    X, q = x.X, x.q
    for k in range(len(w.joints)):
        j = w.joints[k]
        spin = sub(load3(X, j.b, SPIN), load3(X, j.a, SPIN))
        i, u, F = j.axis, first_axis(X, j), compose(load9(X, j.a, R), j.first)  # joint at zero -> world
        if j.universal:
            z, E = rotate_back(F, second_axis(X, j)), j.second
            _set_angle(q, i, z[1] * E[2] - z[0] * E[5], z[0] * E[2] + z[1] * E[5])
            x.qd[i] = dot(spin, u)
            s = sincos(q[i])
            turned = (s[1], -s[0], 0.0, s[0], s[1], 0.0, 0.0, 0.0, 1.0)
            i, u, F = j.second_axis, second_axis(X, j), compose(F, compose(turned, E))
        fx, fy = (F[0], F[3], F[6]), (F[1], F[4], F[7])
        bx, by = (X[j.b, R], X[j.b, R + 3], X[j.b, R + 6]), (X[j.b, R + 1], X[j.b, R + 4], X[j.b, R + 7])
        _set_angle(q, i, dot(fy, bx) - dot(fx, by), dot(fx, bx) + dot(fy, by))
        x.qd[i] = dot(spin, u)
