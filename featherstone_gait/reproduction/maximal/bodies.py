"""Free bodies: where they are, what they carry, how they move on (semi-implicit Euler)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.compile.elementary import sincos
from ...core.compile.jit import inline, kernel
from ...core.compile.lanes import sqrt
from ...core.tree.kinematics import quaternion_matrix
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
from .layout import FORCE, INVERSE, MOMENT, PLACE, SPEED, SPIN, TURN, UNIVERSAL, WELD, R

PI = 3.141592653589793


@inline
def kept(x: float, single: int) -> float:
    """Round a number to single precision if the engine does."""
    if single:
        return float(np.float32(x))
    return x


@inline
def _keep3(X: np.ndarray, i: int, k: int, a: Any, single: int) -> None:
    X[i, k] = kept(a[0], single)
    X[i, k + 1] = kept(a[1], single)
    X[i, k + 2] = kept(a[2], single)


@kernel
def refresh(w: Any, x: Any) -> None:
    """Update the rotations and inverse inertias of the bodies."""
    X = x.X
    for i in range(len(w.bodies)):
        b = w.bodies[i]
        E = quaternion_matrix(X[i])  # whose quaternion stands behind a place, as in a base's coordinates
        store9(X, i, R, E)
        J = congruence(E, b.inverse_inertia)
        for k in range(6):
            X[i, INVERSE + k] = J[k]


@kernel
def load(w: Any, x: Any, gravity: np.ndarray) -> None:
    """Set the forces of all bodies to the weight, the moments to the gyroscopic ones."""
    X = x.X
    for i in range(len(w.bodies)):
        b = w.bodies[i]
        store3(X, i, FORCE, (b.mass * gravity[0], b.mass * gravity[1], b.mass * gravity[2]))
        moment = (0.0, 0.0, 0.0)
        if w.engine[0].gyroscopic:
            E = load9(X, i, R)
            spin = rotate_back(E, load3(X, i, SPIN))
            moment = rotate(E, cross(symmetric(b.inertia, spin), spin))
        store3(X, i, MOMENT, moment)


@inline
def twist(X: np.ndarray, i: int, moment: Any) -> None:
    """Add a moment [N m]."""
    store3(X, i, MOMENT, add(load3(X, i, MOMENT), moment))


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
            _keep3(X, i, PLACE, add(load3(X, i, PLACE), scale(v, h)), e.single)
            _turn(X, i, spin, h, e.single)
            _keep3(X, i, SPEED, _damped(v, e.linear_damping, e.damping_threshold), e.single)
            _keep3(X, i, SPIN, _damped(spin, e.angular_damping, e.damping_threshold), e.single)


@inline
def _damped(v: Any, share: float, threshold: float) -> Any:
    if dot(v, v) > threshold * threshold:
        return scale(v, 1.0 - share)
    return scale(v, 1.0)


@inline
def _turn(X: np.ndarray, i: int, spin: Any, h: float, single: int) -> None:
    """Integrate the quaternion by Euler's step, and normalize it."""
    a, b, c, d = X[i, TURN], X[i, TURN + 1], X[i, TURN + 2], X[i, TURN + 3]
    p, q, r = 0.5 * h * spin[0], 0.5 * h * spin[1], 0.5 * h * spin[2]
    w = a - (p * b + q * c + r * d)
    i1 = b + (p * a + q * d - r * c)
    i2 = c + (q * a + r * b - p * d)
    i3 = d + (r * a + p * c - q * b)
    s = 1.0 / sqrt(w * w + i1 * i1 + i2 * i2 + i3 * i3)
    X[i, TURN] = kept(w * s, single)
    X[i, TURN + 1] = kept(i1 * s, single)
    X[i, TURN + 2] = kept(i2 * s, single)
    X[i, TURN + 3] = kept(i3 * s, single)


# ---------------------------------------------------------------------------------------------- joints' coordinates


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
def _unwound(angle: float, last: float) -> float:
    """Return the angle plus the number of turns that brings it nearest to the last one."""
    return angle + 2.0 * PI * np.floor((last - angle) / (2.0 * PI) + 0.5)


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
    X, T = x.X, x.angles
    for k in range(len(w.joints)):
        j = w.joints[k]
        spin = sub(load3(X, j.b, SPIN), load3(X, j.a, SPIN))
        E = load9(X, j.a, R)
        F = compose(E, j.first)  # joint at zero -> world
        i = j.axis
        if j.kind == UNIVERSAL:
            z = rotate_back(F, second_axis(X, j))
            sine = z[1] * j.phase_cosine - z[0] * j.phase_sine
            cosine = z[0] * j.phase_cosine + z[1] * j.phase_sine
            T[i, 0] = _unwound(angle_of(sine, cosine), T[i, 0])
            s = sincos(T[i, 0])
            turned = (s[1], -s[0], 0.0, s[0], s[1], 0.0, 0.0, 0.0, 1.0)
            G = compose(F, compose(turned, j.second))
            _measure_about_z(X, T, j.b, G, i + 1)
            T[i, 1] = dot(spin, first_axis(X, j))
            T[i + 1, 1] = dot(spin, second_axis(X, j))
        else:
            _measure_about_z(X, T, j.b, F, i)
            T[i, 1] = dot(spin, first_axis(X, j))
            if j.kind == WELD:
                T[i, 1] = 0.0


@inline
def _measure_about_z(X: np.ndarray, T: np.ndarray, b: int, F: Any, i: int) -> None:
    """Measure the angle of body b about z from the axes F."""
    fx, fy = (F[0], F[3], F[6]), (F[1], F[4], F[7])
    bx, by = (X[b, R], X[b, R + 3], X[b, R + 6]), (X[b, R + 1], X[b, R + 4], X[b, R + 7])
    sine, cosine = dot(fy, bx) - dot(fx, by), dot(fx, bx) + dot(fy, by)
    T[i, 0] = _unwound(angle_of(sine, cosine), T[i, 0])


@kernel
def apply_torques(w: Any, x: Any) -> None:
    """Add the torques of the axes to the moments on both bodies."""
    X, T = x.X, x.angles
    for k in range(len(w.joints)):
        j = w.joints[k]
        moment = scale(first_axis(X, j), T[j.axis, 2])
        if j.kind == UNIVERSAL:
            moment = add(moment, scale(second_axis(X, j), T[j.axis + 1, 2]))
        if j.kind != WELD:
            twist(X, j.b, moment)
            twist(X, j.a, scale(moment, -1.0))
