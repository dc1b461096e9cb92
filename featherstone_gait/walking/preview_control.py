"""Preview control of the zero-moment point (ZMP) of a cart-table, giving the motion of the center of mass.

The cart-table of height ``z_c``: state ``x = (c, c', c'')`` of the center of mass, input ``u = c'''`` held over a
sample of length ``T``, output the ZMP ``p = c - (z_c / g) c''``.  In error-augmented form the controller minimizes
``sum Q (p - p_ref)^2 + R (u_k - u_(k-1))^2`` and is

    u_k = -G_i sum_(i<=k) (p_i - p_ref_i) - G_x x_k - sum_(j=1..N) G_d(j) p_ref_(k+j).

The form of 2006, whose state holds the ZMP, is in `auxiliary_zmp`.

References: S. Kajita et al., "Biped walking pattern generation by using preview control of zero-moment point", ICRA
2003, eqs. (8)-(13); T. Katayama et al., "Design of an optimal controller for a discrete-time system subject to
previewable demand", Int. J. Control 41 (1985), for the gains, of which ``G_d(1) = -G_i``.  They come from the Riccati
equation by going back from the end in time (value iteration; D. Bertsekas, "Dynamic Programming and Optimal Control",
vol. I, 3rd ed., section 4.1), in a fixed order of operations.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, is_real, shown, whole
from ..base.brief import brief
from ..base.fixed_order import applied, product, total
from ..dynamics.tree import GRAVITY

# Digits of the gains.  Against a 50-digit solution of the Riccati equation our error is up to 1e-13, SciPy's 8e-11: to
# seven digits practically all gains are those of any solver.  The ZMP of a 0.3 m step moves by 2e-7 m.
GAIN_DIGITS = 7
HORIZON = 20.0  # least time to go, in units of sqrt(z_c / g): in it the unstable mode's energy grows by exp(40)
SETTLED = 1e-8  # relative change of the gains when the samples to go are doubled
MOST_SAMPLES = 2**18


@dataclass(frozen=True, eq=False)
class PreviewController:
    """Gains of the preview controller of a cart-table.

    Attributes
    ----------
    T : float
        Sample time [s].
    z_c : float
        Height of the center of mass [m].
    g : float
        Strength of gravity [m/s^2].
    integral_gain : float
        G_i [1/s^3].
    state_gain : ndarray, shape (3,)
        G_x [1/s^3, 1/s^2, 1/s].
    preview_gain : ndarray, shape (N,)
        G_d [1/s^3]; entry j-1 weighs the reference j samples ahead.
    """

    T: float
    z_c: float
    g: float
    integral_gain: float
    state_gain: np.ndarray
    preview_gain: np.ndarray

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class ComPlan:
    """Motion of the center of mass and its cart-table ZMP, each of the reference's shape.

    Attributes
    ----------
    position, velocity, acceleration : ndarray
        Of the center of mass [m, m/s, m/s^2].
    zmp : ndarray
        Zero-moment point [m].
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    zmp: np.ndarray

    __repr__ = brief


def preview_controller(
    T: float, z_c: float, *, N: int, Q: float = 1.0, R: float = 1e-6, g: float = -GRAVITY[2]
) -> PreviewController:
    """Solve for the gains of the preview controller of a cart-table.

    Kajita et al. (2003) use T = 5 ms, z_c = 0.814 m, N = 320, Q = 1, R = 1e-6.

    Parameters
    ----------
    T : float
        Sample time [s].
    z_c : float
        Height of the center of mass [m].
    N : int
        Samples of preview.
    Q, R : float
        Weights of the ZMP error [1/m^2] and of the change of jerk [s^6/m^2].
    g : float
        Strength of gravity [m/s^2].

    Returns
    -------
    PreviewController
        The gains.
    """
    N = check_settings(N, T=T, z_c=z_c, Q=Q, R=R, g=g)
    A, b, c = np.eye(4), np.array([T * T * T / 6, T * T / 2, T]), np.array([1.0, 0.0, -z_c / g])
    A[1:, 1:] = [[1.0, T, T * T / 2], [0.0, 1.0, T], [0.0, 0.0, 1.0]]  # of the state (p - p_ref, dx) with input du
    A[0, 1:] = applied(A[1:, 1:].T, c)
    b = np.concatenate([[total(c * b)], b])
    P = cost_to_go(A, b, Q, R, HORIZON * np.sqrt(z_c / g) / T)
    K, preview = gains(A, b, P, R, N, -P[:, 0])
    return PreviewController(T, z_c, g, float(K[0]), K[1:], preview)


def plan_com(
    zmp_ref: ArrayLike, T: float, z_c: float, *, N: int = 120, Q: float = 1.0, R: float = 1e-7, g: float = -GRAVITY[2]
) -> ComPlan:
    """Plan the motion of the center of mass whose zero-moment point (ZMP) follows a reference.

    The motion starts at rest over ``zmp_ref[0]``; the reference is assumed to stay at its last row.

    Parameters
    ----------
    zmp_ref : array_like, shape (n,) or (n, axes)
        Reference, a row every `T` [m]; the axes are independent.
    T, z_c, N, Q, R, g
        As of `preview_controller`.

    Returns
    -------
    ComPlan
        The motion.
    """
    controller = preview_controller(T, z_c, N=N, Q=Q, R=R, g=g)
    ref = zmp_reference(zmp_ref)
    state, zmp = _track(controller, ref.reshape(len(ref), -1))
    position, velocity, acceleration = (state[:, i].reshape(ref.shape) for i in range(3))
    return ComPlan(position, velocity, acceleration, zmp.reshape(ref.shape))


def check_settings(N: int, **settings: float) -> int:
    """Return N; raise ValueError unless it and the settings are numbers > 0."""
    for name, value in {"N": N, **settings}.items():
        if not (is_real(value) and 1e-12 < value < 1e12):
            raise ValueError(f"preview control: {name} = {shown(value)} must be finite and > 0")
    return whole("preview control: N", N, 1, "give the samples of preview", MOST_SAMPLES)


def zmp_reference(zmp_ref: ArrayLike) -> np.ndarray:
    """Return a ZMP reference (n,) or (n, axes) [m] as an array; raise ValueError for any other."""
    ref = floats("zmp_ref", zmp_ref)
    if ref.ndim not in (1, 2) or len(ref) == 0 or not np.isfinite(ref).all():
        raise ValueError(f"zmp_ref must be a finite (n,) or (n, axes) array with n > 0, got shape {ref.shape}")
    return ref


def cost_to_go(
    A: np.ndarray, b: np.ndarray, Q: float, R: float, least: float, end: np.ndarray | None = None
) -> np.ndarray:
    """Return the matrix P (n, n) of the least cost over an infinite horizon, in which the first state is penalized.

    The recursion goes back in time from a cost `end` (n, n), by default that of the first state, over `least` samples
    or more; twice as many samples square the error.
    """
    P = np.zeros(A.shape)
    P[0, 0] = Q
    P = P if end is None else end
    before, K, samples = np.full(len(A), np.inf), np.zeros(len(A)), 0
    while samples < least or not (np.abs(K - before) <= SETTLED * np.abs(K)).all():
        if samples == MOST_SAMPLES:
            raise ValueError(f"preview control: no gains after {samples} samples; take a larger T or a smaller R")
        before = K
        for _ in range(max(1, samples)):
            K, _ = feedback(A, b, P, R)
            closed = A - b[:, None] * K
            P = product(closed.T, product(P, closed)) + R * (K[:, None] * K)
            P[0, 0] += Q
            samples += 1
    return P


def feedback(A: np.ndarray, b: np.ndarray, P: np.ndarray, R: float) -> tuple[np.ndarray, float]:
    """Return the gains K (n,) before a future that costs x' P x, and s = R + b' P b."""
    Pb = applied(P, b)
    s = R + float(total(b * Pb))
    return applied(A.T, Pb) / s, s


def gains(
    A: np.ndarray, b: np.ndarray, P: np.ndarray, R: float, N: int, X: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the state gains K (n,) and the gains (N,) of the previewed references, s^-1 b' ((A - b K)')^(j-1) X."""
    K, s = feedback(A, b, P, R)
    closed, preview = A - b[:, None] * K, np.empty(N)
    for j in range(N):
        preview[j] = total(b * X) / s
        X = applied(closed.T, X)
    # The small late preview gains come out of the same recursion as the largest and carry its error.
    return np.array([_rounded(k, abs(k)) for k in K]), _rounded(preview, np.abs(preview).max())


def _rounded(gain: np.ndarray, size: float) -> np.ndarray:
    """Round `gain` to `GAIN_DIGITS` significant digits of a number of the given size."""
    return np.round(gain, GAIN_DIGITS - 1 - Decimal(float(size)).adjusted())


def preview_sum(gain: np.ndarray, ref: np.ndarray) -> np.ndarray:
    """Sum ``gain(j) ref(k + j)`` over j for every k, in a fixed order, unlike a BLAS product."""
    n = len(ref)
    padded = np.concatenate([ref, np.repeat(ref[-1:], len(gain), axis=0)])
    out = np.zeros_like(ref)
    for j, g_j in enumerate(gain, start=1):
        out += g_j * padded[j : j + n]
    return out


def _track(controller: PreviewController, ref: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Run the controller along `ref` (n, axes); return the states (n, 3, axes) and the ZMP (n, axes)."""
    T, (k_c, k_v, k_a) = controller.T, controller.state_gain
    preview = preview_sum(controller.preview_gain, ref)
    states, zmp = np.empty((len(ref), 3, ref.shape[1])), np.empty_like(ref)
    c, v, a = ref[0].copy(), np.zeros_like(ref[0]), np.zeros_like(ref[0])
    # The integral that holds the table at rest over the first reference.
    error_sum = -(k_c * c + total(controller.preview_gain) * ref[0]) / controller.integral_gain
    for k in range(len(ref)):
        p = c - controller.z_c / controller.g * a
        states[k], zmp[k] = (c, v, a), p
        error_sum = error_sum + (p - ref[k])
        u = -controller.integral_gain * error_sum - (k_c * c + k_v * v + k_a * a) - preview[k]
        c = c + T * v + T * T / 2 * a + T * T * T / 6 * u
        v = v + T * a + T * T / 2 * u
        a = a + T * u
    return states, zmp
