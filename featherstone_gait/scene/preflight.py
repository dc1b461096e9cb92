"""What limits the step of a scene, worked out before anything runs.

The linearized scene M dv/dt = -C v - K x is stable under explicit steps (semi-implicit Euler) only while
h < 2 / lambda(M^-1 C) and h < 2 / sqrt(lambda(M^-1 K)), lambda the largest eigenvalue; M at zero posture.  For one
joint alone the inertia is what it feels when all others are free, 1 / (M^-1)_ii; together the joints allow less.

Springs between bodies enter with the length that changes along them in place of a joint's angle: of joints and springs
together, whose rates are J v, the mobility is J M^-1 J'.  Left out are that a stretched spring resists turning, and
springs whose points coincide at zero, where they have no direction.

Dry friction is a damper F / SOFT as long as a joint sticks, and none while it slides.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.arguments import one_of, real
from ..base.fixed_order import applied, product, solve
from ..base.rotation import cross, dot
from ..core.effects import contact, spring
from ..core.effects.friction import DRY
from ..core.integrate import INTEGRATORS
from ..dynamics import Wrench, coupling_matrix, forward_kinematics, inverse_dynamics, spring_vectors
from ..model import Model, Spring
from ..model.numpy_dynamics import mass_matrix_at_zero
from .actuator import Drive
from .friction import Friction, explicit_limits, sticks
from .options import SceneOptions

STIFF = 5e-3  # [s]; explicit limit below which a scene is for implicit steps
RESOLVED = 0.25  # share of the springs' limit that a chosen step takes: 12 steps a period
SHORTEST, LONGEST = 1e-9, 10.0  # steps that are taken [s]


class Limit(NamedTuple):
    """The largest explicit step of one joint or spring, and why.

    Attributes
    ----------
    joint : str
        Name of the joint or spring.
    step : float
        Largest stable explicit step [s]; inf if nothing limits it.
    cause : str
        What limits the step.
    """

    joint: str
    step: float
    cause: str


class Preflight(NamedTuple):
    """Step limits of a scene and the integrator that was chosen for it.

    Attributes
    ----------
    limits : tuple of Limit
        The limit of each joint, spring and contact alone.
    integrator : str
        Name of the integrator.
    timestep : float
        Step [s].
    reason : str
        Why these were chosen.
    named : bool
        Whether the integrator was given by the user.
    inertias : tuple of float
        Inertia that each joint feels [kg m^2 or kg].
    largest_explicit_step : float
        Limit of joints, springs and contacts together [s].
    folded_step : float
        The same without springs between bodies, which no implicit step includes [s].
    sliding_step : float
        The same while no dry friction sticks [s].
    spring_step : float
        Limit of the springs between bodies alone, for all integrators [s].
    """

    limits: tuple[Limit, ...]
    integrator: str
    timestep: float
    reason: str
    named: bool
    inertias: tuple[float, ...]
    largest_explicit_step: float
    folded_step: float
    sliding_step: float
    spring_step: float

    @property
    def worst(self) -> Limit | None:
        """The smallest limit, None if nothing limits an explicit step."""
        return worst(self.limits)


class _Acting(NamedTuple):
    """Dampers and springs of joints and springs, by name, each (n,) [N m s/rad, N m/rad or N s/m, N/m]."""

    names: list[str]
    dampers: dict[str, np.ndarray]
    springs: dict[str, np.ndarray]
    mobility: np.ndarray | float  # that rotors add to what acts through a gear [1/(kg m^2)]


class _Steps(NamedTuple):
    """The last four fields of `Preflight`."""

    largest: float
    folded: float
    sliding: float
    springs: float


def preflight(
    model: Model, drive: Drive, friction: Friction | None, springs: np.recarray | None, options: SceneOptions
) -> Preflight:
    """Compute the limits of explicit steps, and choose the integrator and the step where they are not given.

    springs: SPRING records of those between bodies.  Raises ValueError on names and steps that do not exist.
    """
    n = len(model.moving_joints)
    mobility = joint_mobility(model, drive.armature, options.springs)
    inertias = tuple(float(x) for x in 1.0 / np.diag(mobility)[:n])
    joints, ends = _on_joints(model, drive, friction), _between_bodies(options.springs, springs)
    limits = _each(joints, np.diag(mobility)[:n]) + _each(ends, np.diag(mobility)[n:])
    mobility[:n, :n] += np.diag(np.broadcast_to(joints.mobility, n))
    dampers = np.array([*_sum(joints.dampers, n), *_sum(ends.dampers, len(ends.names))])
    stiff = np.array([*_sum(joints.springs, n), *_sum(ends.springs, len(ends.names))])
    _check_size(model, [*joints.names, *ends.names], mobility, np.maximum(dampers, stiff))
    dry = np.zeros(len(dampers))  # what of the dampers is dry friction while it sticks
    dry[:n] = joints.dampers.get(DRY, 0.0)
    steps = _together(mobility, dampers, stiff, dry, n)
    if options.ground is not None:
        step = float(contact.explicit_limit(options.ground.penetration, options.g))
        limits.append(Limit("contact", step, "contact spring"))
        largest, folded, sliding = (min(step, limits[-1].step) for step in steps[:3])
        steps = _Steps(largest, folded, sliding, steps.springs)
    clipped = drive.actuator is not None or options.ground is not None or sticks(friction)
    integrator, step, reason = _choice(options, clipped, steps, limits)
    return Preflight(tuple(limits), integrator, step, reason, options.integrator is not None, inertias, *steps)


def _together(mobility: np.ndarray, dampers: np.ndarray, stiff: np.ndarray, dry: np.ndarray, n: int) -> _Steps:
    """Compute the limits of n joints and the springs together; eigenvalues are expensive and computed once."""
    largest = folded = coupled_limit(mobility, dampers, stiff)
    springs = math.inf
    if len(dampers) > n:
        folded = coupled_limit(mobility[:n, :n], dampers[:n], stiff[:n])
        springs = coupled_limit(mobility[n:, n:], dampers[n:], stiff[n:])
    sliding = coupled_limit(mobility, dampers - dry, stiff) if dry.any() else largest
    return _Steps(largest, folded, sliding, springs)


def worst(limits: Sequence[Limit]) -> Limit | None:
    """Return the smallest of the limits, None if nothing limits a step."""
    least = min(limits, key=lambda limit: limit.step, default=None)
    return least if least is not None and least.step < math.inf else None


def _check_size(model: Model, names: list[str], mobility: np.ndarray, acting: np.ndarray) -> None:
    """Raise ValueError for numbers whose product overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        bad = np.flatnonzero(~np.isfinite(mobility * acting).all(axis=0))
    if bad.size:
        k = bad[0]
        raise ValueError(
            f"{model.name}: {names[k]}: a stiffness or damping of {acting[k]:g} [SI] on an inertia of "
            f"{1.0 / mobility[k, k]:g} [SI] is beyond what can be computed; correct servo, gearbox or inertia, and "
            "mind their units"
        )


def _choice(
    options: SceneOptions, clipped: bool, steps: _Steps, limits: Sequence[Limit]
) -> tuple[str, float, str]:
    """Choose integrator and step [s], and say why; clipped: servos, ground or dry friction cause discontinuities."""
    name, timestep = options.integrator, options.timestep
    if timestep is not None:
        timestep = real("timestep", timestep, SHORTEST, LONGEST, "give seconds, 1e-3 is usual")
    if name is not None:
        if name == "simtwo" and name not in INTEGRATORS:
            raise ValueError("integrator 'simtwo' is the paper's: import featherstone_gait.reproduction first")
        one_of("integrator", name, INTEGRATORS)
    chosen, reason = (name, "as asked for") if name is not None else _integrator(clipped, steps, limits)
    if timestep is not None:
        return chosen, timestep, reason
    step = 1e-3 if clipped else 5e-4
    parts = 1 if INTEGRATORS[chosen].adaptive else math.ceil(step / (RESOLVED * steps.springs))
    if parts > 1:
        reason += f"; springs between bodies limit any fixed step to {steps.springs:.2g} s: {step / parts:.2g} s chosen"
    return chosen, step / max(1, parts), reason


def _integrator(clipped: bool, steps: _Steps, limits: Sequence[Limit]) -> tuple[str, str]:
    """Choose the integrator from the scene alone, whatever step is given, and say why."""
    least = worst(limits)
    by = f" ({least.joint}: {least.cause})" if least else ""
    if clipped or steps.folded < STIFF:
        return "ars343", f"an explicit step is limited to {steps.largest:.2g} s{by}, or forces are not smooth: implicit"
    if steps.largest < STIFF:
        return "dop853", f"springs between bodies limit any step to {steps.springs:.2g} s{by}: order 8 finds its own"
    return "dop853", "nothing is stiff: order 8"


def _on_joints(model: Model, drive: Drive, friction: Friction | None) -> _Acting:
    dampers, springs = explicit_limits(friction, drive)
    mobility: np.ndarray | float = 0.0
    if drive.actuator is not None:
        more, stiff, mobility = drive.actuator.explicit_limits()
        dampers, springs = dampers | more, springs | stiff
    return _Acting(list(model.joint_names), dampers, springs, mobility)


def _between_bodies(springs: Sequence[Spring], table: np.recarray | None) -> _Acting:
    if table is None:
        return _Acting([], {}, {}, 0.0)
    dampers, stiff = spring.explicit_limits(table)
    return _Acting([f"{s.a} - {s.b}" for s in springs], dampers, stiff, 0.0)


def _sum(acting: dict[str, np.ndarray], count: int) -> np.ndarray:
    return sum(acting.values(), np.zeros(count))


def _each(acting: _Acting, mobility: np.ndarray) -> list[Limit]:
    """Compute the limit of each joint or spring alone."""
    return [
        joint_limit(
            name,
            1.0 / mobility[k] if mobility[k] > 0 else math.inf,
            {cause: c[k] for cause, c in acting.dampers.items()},
            {cause: c[k] for cause, c in acting.springs.items()},
        )
        for k, name in enumerate(acting.names)
    ]


def coupled_limit(mobility: np.ndarray, dampings: np.ndarray, springs: np.ndarray) -> float:
    """Compute the limit of all joints together [s].

    mobility (n, n) = M^-1 [1/(kg m^2)], one damper and spring for each joint.  With springs between bodies, mobility =
    J M^-1 J' has a row for each of them too [1/kg].
    """
    largest = [max(np.linalg.eigvals(mobility * x).real, default=0.0) for x in (dampings, springs)]
    damped = 2.0 / largest[0] if largest[0] > 0 else np.inf
    return float(min(damped, 2.0 / np.sqrt(largest[1]) if largest[1] > 0 else np.inf))


def joint_limit(name: str, inertia: float, dampings: dict[str, float], springs: dict[str, float]) -> Limit:
    """Compute the limit of one joint of effective inertia [kg m^2] with dampers [N m s/rad] and springs [N m/rad]."""
    limit = Limit(name, np.inf, "nothing stiff")
    for cause, c in dampings.items():
        if c > 0 and 2.0 * inertia / c < limit.step:
            limit = Limit(name, float(2.0 * inertia / c), cause)
    for cause, k in springs.items():
        if k > 0 and 2.0 * np.sqrt(inertia / k) < limit.step:
            limit = Limit(name, 2.0 * float(np.sqrt(inertia / k)), cause)
    return limit


def joint_mobility(model: Model, armature: np.ndarray | None, springs: Sequence[Spring]) -> np.ndarray:
    """Compute J M^-1 J' at zero (n + springs, ...), the accelerations of joints and springs' lengths by forces on them.

    J holds the joints' own directions, then how fast each spring lengthens.  With couplings M^-1 is G (G' M G)^-1 G', G
    of `coupling_matrix`.
    """
    found = _mobility(model.skeleton, None if armature is None else armature.tobytes(), tuple(springs))
    return found.copy()


@functools.lru_cache(maxsize=8)
def _mobility(model: Model, rotors: bytes | None, springs: tuple[Spring, ...]) -> np.ndarray:
    armature = None if rotors is None else np.frombuffer(rotors)
    q = np.zeros(model.nq)
    if model.base == "floating":
        q[3] = 1.0
    n = len(model.moving_joints)
    J = np.zeros((n + len(springs), model.nv))
    J[:n, model.nv - n :] = np.eye(n)
    if springs:
        J[n:] = _lengthening(model, springs, q)
    M, G = mass_matrix_at_zero(model, armature), coupling_matrix(model).matrix
    if len(G) > len(G.T):
        M, J = product(product(G.T, M), G), product(J, G)
    return product(J, solve(M, J.T))


def _lengthening(model: Model, springs: Sequence[Spring], q: np.ndarray) -> np.ndarray:
    """Compute dl/dt of each spring by velocity (springs, nv).

    It is the generalized force that holds the robot against a pull of 1 N of the spring.
    """
    still, rotation = np.zeros(model.nv), forward_kinematics(model, q).rotation
    rows = []
    for s, d in zip(springs, spring_vectors(model, springs, q)):
        length = math.sqrt(dot(d, d))
        pull = d / length if length > 0 else d
        wrench = {
            link: Wrench(force, cross(applied(rotation[model.link_index(link)], np.array(point)), force))
            for link, point, force in ((s.a, s.point_a, pull), (s.b, s.point_b, -pull))
        }
        rows.append(inverse_dynamics(model, q, still, still, wrench=wrench, gravity=(0.0, 0.0, 0.0)))
    return np.array(rows)
