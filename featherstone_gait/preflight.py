"""What limits the step of a scene, worked out before anything runs.

The linearised scene M dv/dt = -C v - K x is stable under explicit steps (semi-implicit Euler) while
h < 2 / (lambda_damping) and h < 2 / omega: single-joint limits with the inertia that each joint feels when all others
are free, 1 / (M^-1)_ii, at the given posture.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Limit(NamedTuple):
    """The largest explicit step of one joint, and why."""

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

    @property
    def largest_explicit_step(self) -> float:
        """The smallest of the limits [s]."""
        return min((limit.step for limit in self.limits), default=np.inf)


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
