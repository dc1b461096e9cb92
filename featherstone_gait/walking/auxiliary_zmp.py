"""Preview control whose state holds the zero-moment point (ZMP) and whose input is its speed, open to an auxiliary ZMP.

An inverted pendulum of height ``z_c``, ``w^2 = g / z_c``, whose center of mass ``c`` the ZMP drives away from itself:

    c'' = w^2 (c - p - p_a),    p' = u,

with the planned ZMP ``p``, its speed ``u``, held over a sample of length ``T``, and an auxiliary ZMP ``p_a`` that is
added without being foreseen.  The controller minimizes ``sum Q (p - p_ref)^2 + R u^2`` among the motions in which
the center of mass stays near the feet, and is

    u_k = -K (p, c, c')_k + sum_(j=1..N) f(j) p_ref_(k+j),
    K = s^-1 b' P A,   f(j) = s^-1 b' ((A - b K)')^(j-1) (Q, 0, 0),   s = R + b' P b.

This is the form of S. Kajita et al., "Biped walking pattern generator allowing auxiliary ZMP control", IROS 2006; here
A and b are exact for a ZMP that moves evenly over a sample, where a forward difference would do for small T.  Beyond
the preview the reference is assumed to stay at its last sample: ``f(N)`` holds the gains of all later ones.

Unlike in the form of 2003 (`preview_control`) the cost does not depend on the center of mass: of
the solutions of the Riccati equation the largest is needed, which stabilizes it.  The recursion back in time from a
future in which the center of mass costs something too converges to it (D. Bertsekas, "Dynamic Programming and
Optimal Control", vol. I, 3rd ed., section 4.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, floats
from ..base.fixed_order import applied, total
from ..base.portable_math import exp
from ..dynamics.tree import GRAVITY
from .preview_control import HORIZON, ComPlan, check_settings, cost_to_go, gains, preview_sum, zmp_reference


@dataclass(frozen=True, eq=False)
class AuxiliaryZmpController:
    """Gains of a preview controller with the ZMP's speed as its input."""

    T: float  # sample time [s]
    A: np.ndarray  # (3, 3) of the state (ZMP [m], center of mass [m], its velocity [m/s]) over a sample
    b: np.ndarray  # (3,) [s, s, -]
    state_gain: np.ndarray  # K (3,) [1/s, 1/s, -]
    preview_gain: np.ndarray  # f (N,) [1/s]; entry j-1 weighs the reference j samples ahead


def auxiliary_zmp_controller(
    T: float, z_c: float, *, N: int, Q: float = 1.0, R: float = 1e-7, g: float = -GRAVITY[2]
) -> AuxiliaryZmpController:
    """Solve for the gains of a pendulum sampled every `T` [s], `z_c` [m] high, with `N` samples of preview.

    Q: weight of the ZMP error [1/m^2]; R: of the ZMP's speed [s^2/m^2]: the ZMP follows its reference within some
    sqrt(R / Q) seconds.  Raises ValueError unless all are > 0.
    """
    N = check_settings(N, T=T, z_c=z_c, Q=Q, R=R, g=g)
    w = np.sqrt(g / z_c)
    grown, shrunk = exp(np.array([w * T, -w * T]))
    cosh, sinh = 0.5 * (grown + shrunk), 0.5 * (grown - shrunk)
    A = np.array([[1.0, 0.0, 0.0], [1.0 - cosh, cosh, sinh / w], [-w * sinh, w * sinh, cosh]])
    b = np.array([T, T - sinh / w, 1.0 - cosh])
    P = cost_to_go(A, b, Q, R, HORIZON * np.sqrt(z_c / g) / T, np.diag([Q, Q, Q * z_c / g]))
    K, preview = gains(A, b, P, R, N, np.array([Q, 0.0, 0.0]))
    preview[-1] += K[0] + K[1] - total(preview)
    return AuxiliaryZmpController(T, A, b, K, preview)


def plan_com_auxiliary(
    zmp_ref: ArrayLike,
    T: float,
    z_c: float,
    *,
    auxiliary: ArrayLike = 0.0,
    N: int = 120,
    Q: float = 1.0,
    R: float = 1e-7,
    g: float = -GRAVITY[2],
) -> ComPlan:
    """Plan the motion of the center of mass whose ZMP follows `zmp_ref`; arguments and result as of `plan_com`.

    auxiliary: ZMP (n,) or (n, axes) [m] that is added without being foreseen; `ComPlan.zmp` holds it too.
    """
    controller = auxiliary_zmp_controller(T, z_c, N=N, Q=Q, R=R, g=g)
    ref = zmp_reference(zmp_ref)
    added = finite("auxiliary", np.broadcast_to(floats("auxiliary", auxiliary), ref.shape), ref.shape, "[m]")
    columns = ref.reshape(len(ref), -1)
    states = _track(controller, columns, added.reshape(columns.shape))
    planned, position, velocity = (states[:, i].reshape(ref.shape) for i in range(3))
    zmp = planned + added
    return ComPlan(position, velocity, g / z_c * (position - zmp), zmp)


def _track(controller: AuxiliaryZmpController, ref: np.ndarray, added: np.ndarray) -> np.ndarray:
    """Run the controller along `ref` (n, axes), the ZMP off by `added` (n, axes); return the states (n, 3, axes)."""
    K, preview = controller.state_gain, preview_sum(controller.preview_gain, ref)
    states = np.empty((len(ref), 3, ref.shape[1]))
    x = np.stack([ref[0], ref[0], np.zeros_like(ref[0])])
    push = controller.A[:, 0] - np.array([1.0, 0.0, 0.0])  # of a ZMP that stays off over a sample
    for k in range(len(ref)):
        states[k] = x
        u = preview[k] - total(K[:, None] * x, axis=0)
        x = applied(controller.A, x.T).T + controller.b[:, None] * u + push[:, None] * added[k]
    return states
