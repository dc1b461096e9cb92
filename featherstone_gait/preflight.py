"""What limits the step of a scene, worked out before anything runs.

The linearised scene M dv/dt = -C v - K x is stable under explicit steps (semi-implicit Euler) only while
h < 2 / lambda(M^-1 C) and h < 2 / sqrt(lambda(M^-1 K)), lambda the largest eigenvalue; M at zero posture.  For one
joint alone the inertia is what it feels when all others are free, 1 / (M^-1)_ii; together the joints allow less.

Springs between bodies enter with the length that changes along them in place of a joint's angle: of joints and springs
together, whose rates are J v, the mobility is J M^-1 J'.  Left out are that a stretched spring resists turning, and
springs whose points coincide at zero, where they have no direction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Limit(NamedTuple):
    """The largest explicit step of one joint or spring, and why."""

    joint: str
    step: float  # [s]; inf where nothing limits it
    cause: str


class Preflight(NamedTuple):
    """Step limits of a scene and the integrator that was chosen for it."""

    limits: tuple[Limit, ...]
    integrator: str
    timestep: float  # [s]
    reason: str
    inertias: tuple[float, ...]  # that each joint feels [kg m^2 or kg]
    largest_explicit_step: float  # of all joints, springs and contacts together [s]
    folded_step: float  # without the springs, which no implicit step takes in [s]


def coupled_limit(mobility: np.ndarray, dampings: np.ndarray, springs: np.ndarray) -> float:
    """The limit of all joints together [s]; mobility (n, n) = M^-1 [1/(kg m^2)], one damper and spring a joint.

    With springs between bodies mobility = J M^-1 J' has a row for each of them too [1/kg].
    """
    largest = [max(np.linalg.eigvals(mobility * x).real, default=0.0) for x in (dampings, springs)]
    damped = 2.0 / largest[0] if largest[0] > 0 else np.inf
    return float(min(damped, 2.0 / np.sqrt(largest[1]) if largest[1] > 0 else np.inf))


def joint_limit(name: str, inertia: float, dampings: dict[str, float], springs: dict[str, float]) -> Limit:
    """The limit of one joint of effective inertia [kg m^2] with dampers [N m s/rad] and springs [N m/rad]."""
    limit = Limit(name, np.inf, "nothing stiff")
    for cause, c in dampings.items():
        if c > 0 and 2.0 * inertia / c < limit.step:
            limit = Limit(name, 2.0 * inertia / c, cause)
    for cause, k in springs.items():
        if k > 0 and 2.0 * np.sqrt(inertia / k) < limit.step:
            limit = Limit(name, 2.0 * float(np.sqrt(inertia / k)), cause)
    return limit
