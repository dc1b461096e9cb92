"""Limits of the step of a scene, computed before anything runs.

The linearized scene M dv/dt = -C v - K x is stable under explicit steps (semi-implicit Euler) only while
h < 2 / lambda(M^-1 C) and h < 2 / sqrt(lambda(M^-1 K)), lambda the largest eigenvalue; M at zero posture, or in
another if it is singular there.  For one joint alone the inertia is what it feels when all others are free,
1 / (M^-1)_ii; together the joints allow less.

Tendons and springs between bodies enter with their length in place of a joint's angle: of joints and lengths together,
whose rates are J v, the mobility is J M^-1 J'.  Left out are that a stretched spring resists turning, and springs whose
points coincide at zero, where they have no direction.

Dry friction is a damper F / SOFT as long as a joint sticks, and none while it slides.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from ..base.arguments import one_of, real
from ..base.fixed_order import product, solve, total
from ..base.flaws import quoted
from ..core.effects import contact, drag, joint_spring, tendon
from ..core.effects.friction import DRY, SOFT
from ..core.integrate import INTEGRATORS
from ..dynamics import coupling_matrix
from ..dynamics.tendons import rows_of
from ..model import Controller, Model, Tendon
from ..model.numpy_dynamics import mass_matrix_at, regular_posture, sampled_postures
from .actuator import Drive
from .fluid import fluid_limits
from .friction import Friction, explicit_limits, fastest_damping, sticks
from .joint_spring import stiffest
from .options import SceneOptions

SPRING = "contact spring"  # cause of a limit
STIFF = 5e-3  # [s]; explicit limit below which a scene is for implicit steps
AT_LIMITS = 100.0  # so that the stop at a limit is at most ten times as strongly damped as critically; see `stop.py`
LARGEST = 1e50  # inertia of a length that nothing changes [kg m^2 or kg]
SHORTEST, LONGEST = 1e-9, 10.0  # steps that are taken [s]


class Limit(NamedTuple):
    """The largest explicit step of one joint, tendon or spring, and why.

    Attributes
    ----------
    joint : str
        Name of the joint, tendon or spring.
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
        The limit of each joint, tendon, spring and contact alone.
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
        Limit of joints, tendons, springs and contacts together [s].
    sliding_step : float
        The same while no dry friction sticks [s].
    tendon_inertias : tuple of float
        Inertia that each tendon and spring feels along its length [kg m^2 or kg], of limited ones at most `AT_LIMITS`
        times the least of several postures.
    """

    limits: tuple[Limit, ...]
    integrator: str
    timestep: float
    reason: str
    named: bool
    inertias: tuple[float, ...]
    largest_explicit_step: float
    sliding_step: float
    tendon_inertias: tuple[float, ...] = ()

    @property
    def worst(self) -> Limit | None:
        """The smallest limit, None if nothing limits an explicit step."""
        least = min(self.limits, key=lambda limit: limit.step, default=None)
        return least if least is not None and least.step < math.inf else None


def preflight(
    model: Model,
    drive: Drive,
    friction: Friction | None,
    tendons: Sequence[Tendon],
    options: SceneOptions,
) -> Preflight:
    """Compute the limits of explicit steps, and choose the integrator and the step where they are not given.

    Raises ValueError on names and steps that do not exist.
    """
    n, mobility = len(model.moving_joints), joint_mobility(model, drive.armature, tendons)
    names, own = [*model.joint_names, *(one.name for one in tendons)], mobility.diagonal()
    inertias = tuple(1.0 / float(x) if x > 0 else LARGEST for x in own)
    if any(one.limited for one in tendons):
        inertias = (*inertias[:n], *_felt_at_limits(model, drive.armature, tendons, inertias[n:]))
    dampers, stiff, rotors = _acting(model, drive, friction, tendons)
    limits = []
    for k, (name, share) in enumerate(zip(names, own)):
        each = ({cause: c[k] for cause, c in acting.items()} for acting in (dampers, stiff))
        limits.append(joint_limit(name, 1.0 / share if share > 0 else math.inf, *each))
    mobility = mobility.with_rotors(np.broadcast_to(rotors, n))
    damping, stiffness = (sum(acting.values(), np.zeros(len(names))) for acting in (dampers, stiff))
    _check_size(model, names, mobility, np.maximum(damping, stiffness))
    steps: tuple[float, ...] = _together(mobility, damping, stiffness, dampers.get(DRY))
    if options.ground is not None:
        step = float(contact.explicit_limit(options.ground.penetration, options.pressing))
        limits.append(Limit("contact", step, SPRING))
        steps = tuple(min(one, step) for one in steps)
    for name, step, cause in fluid_limits(model, options.fluid, options.g):
        limits.append(Limit(name, step, cause))
        steps = tuple(min(one, step) for one in steps)
    named = options.integrator is not None
    check = Preflight(tuple(limits), "", 0.0, "", named, inertias[:n], steps[0], steps[1], inertias[n:])
    rubs = sticks(friction) or any(one.friction for one in tendons)
    clipped = drive.actuator is not None or options.ground is not None or rubs
    integrator, step, reason = _choice(options, clipped, check)
    if options.timestep is None and drive.sampled:
        laws = [servo.controller for servo in drive.servos if servo]
        step = _dividing(min(law.period for law in laws), max(law.delay for law in laws), step)
    return check._replace(integrator=integrator, timestep=step, reason=reason)


def _dividing(period: float, delay: float, step: float) -> float:
    """Return the step, or the next shorter one that divides period and delay of the controllers [s].

    Of a delay that no step down to a hundredth divides, only the period is divided.
    """
    if _divides(step, period) and _divides(step, delay):
        return step
    count = math.ceil(period / step * (1.0 - 1e-9))
    return next((period / k for k in range(count, 100 * count) if _divides(period / k, delay)), period / count)


def _divides(step: float, time: float) -> bool:
    return abs(round(time / step) * step - time) <= 1e-9 * time


Acting: TypeAlias = dict[str, np.ndarray]  # dampers or springs of each joint and each tendon, by cause


def _acting(
    model: Model, drive: Drive, friction: Friction | None, tendons: Sequence[Tendon]
) -> tuple[Acting, Acting, np.ndarray | float]:
    """Return dampers [N m s/rad or N s/m], springs [N m/rad or N/m], and the mobility of rotors behind gears."""
    acting, rotors = explicit_limits(friction, drive), 0.0
    if drive.actuator is not None:
        *more, rotors = drive.actuator.explicit_limits()
        acting = acting[0] | more[0], acting[1] | more[1]
    stiffness = stiffest(model)
    if stiffness.any():
        acting = acting[0], acting[1] | joint_spring.explicit_limits(stiffness)[1]
    fastest = fastest_damping(model)
    if fastest.any():
        acting = acting[0] | drag.explicit_limits(fastest)[0], acting[1]
    if not tendons:
        return *acting, rotors
    own, ends = np.zeros(len(drive.servos)), np.zeros(len(tendons))
    of_joints = ({cause: np.concatenate([c, ends]) for cause, c in one.items()} for one in acting)
    laws = [one.controller or Controller("pd") for one in tendons]
    numbers = (
        [one.damping + law.Kd for one, law in zip(tendons, laws)],
        [one.stiffness + law.Kp for one, law in zip(tendons, laws)],
    )
    along = ({cause: np.concatenate([own, each])} for cause, each in zip(tendon.CAUSES, numbers))
    dampers, stiff = (a | b for a, b in zip(of_joints, along))
    if any(one.friction for one in tendons):
        dry = np.concatenate([own, [one.friction / SOFT for one in tendons]])
        dampers[DRY] = dampers.get(DRY, 0.0) + dry
    return dampers, stiff, rotors


def _together(mobility: Mobility, dampers: np.ndarray, stiff: np.ndarray, dry: np.ndarray | None) -> tuple[float, ...]:
    """Compute the largest explicit step and the sliding one; eigenvalues are expensive and computed once.

    dry: what of the dampers is dry friction while it sticks.
    """
    largest = coupled_limit(mobility, dampers, stiff)
    sliding = largest if dry is None or not dry.any() else coupled_limit(mobility, dampers - dry, stiff)
    return largest, sliding


def _check_size(model: Model, names: list[str], mobility: Mobility, acting: np.ndarray) -> None:
    """Raise ValueError for numbers whose product overflows."""
    own = mobility.diagonal()
    with np.errstate(over="ignore", invalid="ignore"):
        bad = np.flatnonzero(~np.isfinite(np.sqrt(own) * np.sqrt(own).max(initial=0.0) * acting))
    if bad.size:
        k = bad[0]
        raise ValueError(
            f"{model.name}: {names[k]}: a stiffness or damping of {acting[k]:g} [SI] on an inertia of "
            f"{1.0 / own[k]:g} [SI] is beyond what can be computed; correct servo, gearbox or inertia, and "
            "mind their units"
        )


def _choice(options: SceneOptions, clipped: bool, check: Preflight) -> tuple[str, float, str]:
    """Choose integrator and step [s], and say why; clipped: servos, ground or dry friction cause discontinuities."""
    chosen, timestep, reason = options.integrator, options.timestep, "as asked for"
    if timestep is not None:
        timestep = real("timestep", timestep, SHORTEST, LONGEST, "give seconds, 1e-3 is usual")
    if chosen is None:
        chosen, reason = _integrator(clipped, check)
    else:
        one_of("integrator", chosen, INTEGRATORS)
    return chosen, (1e-3 if clipped else 5e-4) if timestep is None else timestep, reason


def _integrator(clipped: bool, check: Preflight) -> tuple[str, str]:
    """Choose the integrator from the scene alone, whatever step is given, and say why."""
    if clipped or check.largest_explicit_step < STIFF:
        return "ars343", implicit_reason(check)
    return "dop853", "nothing is stiff: order 8"


def implicit_reason(check: Preflight) -> str:
    """Say why steps are implicit."""
    limit = f"{check.largest_explicit_step:.2g} s{_by(check)}"
    return f"an explicit step is limited to {limit}, or forces are not smooth: implicit"


def _by(check: Preflight) -> str:
    least = check.worst
    return f" ({least.joint}: {least.cause})" if least else ""


class Mobility(NamedTuple):
    """The accelerations of joints and lengths by forces on them, J M^-1 J' (rows, rows) [1/(kg m^2), 1/kg].

    Rows are the joints, then the lengths.  There may be many more of these than coordinates, so that it is kept as the
    product of two matrices.
    """

    left: np.ndarray  # J (rows, k)
    right: np.ndarray  # M^-1 J' (k, rows)

    def diagonal(self) -> np.ndarray:
        """Return the diagonal (rows,)."""
        return total(self.left * self.right.T)

    def with_rotors(self, rotors: np.ndarray) -> Mobility:
        """Return it with the mobility (joints,) of rotors behind the gears of joints."""
        if not rotors.any():
            return self
        own = np.eye(len(self.left), len(rotors))
        return Mobility(np.hstack([self.left, own * rotors]), np.vstack([self.right, own.T]))

    def largest(self, acting: np.ndarray) -> float:
        """Return the largest eigenvalue of its product with dampers or springs (rows,)."""
        if len(self.left) > len(self.right):  # the same, of the factors in the other order
            return max(np.linalg.eigvals(product(self.right * acting, self.left)).real, default=0.0)
        root = np.sqrt(np.maximum(acting, 0.0))  # a symmetric matrix of the same eigenvalues takes a tenth of the time
        return max(np.linalg.eigvalsh(product(self.left, self.right) * root * root[:, None]), default=0.0)


def coupled_limit(mobility: Mobility, dampings: np.ndarray, springs: np.ndarray) -> float:
    """Compute the limit of all joints and lengths together [s]; dampings, springs: (rows,), one for each."""
    largest = [mobility.largest(x) for x in (dampings, springs)]
    damped = 2.0 / largest[0] if largest[0] > 0 else np.inf
    return float(min(damped, 2.0 / np.sqrt(largest[1]) if largest[1] > 0 else np.inf))


def joint_limit(name: str, inertia: float, dampings: dict[str, float], springs: dict[str, float]) -> Limit:
    """Compute the limit of one joint of effective inertia [kg m^2] with dampers [N m s/rad] and springs [N m/rad]."""
    limits = [Limit(name, math.inf, "nothing stiff")]
    limits += [Limit(name, float(2.0 * inertia / c), cause) for cause, c in dampings.items() if c > 0]
    limits += [Limit(name, 2.0 * float(np.sqrt(inertia / k)), cause) for cause, k in springs.items() if k > 0]
    return min(limits, key=lambda limit: limit.step)


def joint_mobility(model: Model, armature: np.ndarray | None, tendons: Sequence[Tendon]) -> Mobility:
    """Compute the accelerations of joints and tendons' lengths by forces on them.

    It is that of the `regular_posture`.  J holds the joints' own directions, then how fast each tendon lengthens.  With
    couplings M^-1 is G (G' M G)^-1 G', G of `coupling_matrix`.
    """
    return _mobility(model.skeleton, None if armature is None else armature.tobytes(), tuple(tendons))


def _felt_at_limits(
    model: Model, armature: np.ndarray | None, tendons: Sequence[Tendon], inertias: Sequence[float]
) -> list[float]:
    """Return the inertias of tendons, of those with limits at most `AT_LIMITS` times the least of sampled postures.

    A tendon at rest may have no moment arm, and meets its limit in another posture.  inertias: in the
    `regular_posture`; of a limited one that has no moment arm anywhere it is the robot's mass.
    """
    postures, n = sampled_postures(model), len(model.moving_joints)
    moves = rows_of(model, postures, tendons)
    with np.errstate(all="ignore"):
        each = [_factors(model, q, J, armature, tendons).diagonal()[n:] for q, J in zip(postures, moves)]
    most = np.nan_to_num(each, nan=0.0, posinf=0.0).max(axis=0)
    least = [1.0 / x if x > 1.0 / LARGEST else model.mass for x in most.tolist()]
    return [min(J, AT_LIMITS * x) if one.limited else J for one, J, x in zip(tendons, inertias, least)]


@functools.lru_cache(maxsize=8)
def _mobility(model: Model, rotors: bytes | None, tendons: tuple[Tendon, ...]) -> Mobility:
    armature, q = None if rotors is None else np.frombuffer(rotors), regular_posture(model)
    return _factors(model, q, rows_of(model, q, tendons), armature, tendons)


def _factors(
    model: Model, q: np.ndarray, moves: np.ndarray, armature: np.ndarray | None, tendons: Sequence[Tendon]
) -> Mobility:
    """Return the mobility at q (nq,); moves (tendons, nv): the Jacobian of the tendons there."""
    n = len(model.moving_joints)
    J = np.zeros((n + len(tendons), model.nv))
    J[:n, model.nv - n :], J[n:] = np.eye(n), moves
    M, G = mass_matrix_at(model, q, armature), coupling_matrix(model).matrix
    heavy = [one.armature for one in tendons]
    if any(heavy):
        M = M + product(J[n:].T * heavy, J[n:])
    if len(G) > len(G.T):
        M, J = product(product(G.T, M), G), product(J, G)
    return Mobility(J, solve(M, J.T))


def closing(check: Preflight, model: Model) -> Preflight:
    """Say in the reason that loops are closed, if there are any."""
    if not model.loops:
        return check
    names = quoted([loop.name for loop in model.loops])
    return check._replace(reason=f"{check.reason}; loops {names} are closed after each step")
