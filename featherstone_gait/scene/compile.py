"""From a model, its servos and the ground to the numbers that kernels read, with a preflight of the step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..base.arguments import instance, listed, real, vector
from ..base.portable_math import sincos
from ..base.rotation import dot
from ..core.effects.gear_friction import GearFriction
from ..core.integrate import INTEGRATORS
from ..core.integrate.integrator import Integrator
from ..core.step import state
from ..core.step.context import Scene
from ..model import Controller, Ground, Model, Spring
from ..model.tree_checks import check_springs
from .actuator import Drive, ServoKind, build_decay, build_drive, controller_period, fold_springs
from .contact import build_contact, standing_posture
from .external import Push, build_pushes, build_springs
from .firmware import build_firmware, build_supply
from .friction import build_friction, sticks
from .preflight import STIFF, Preflight, preflight
from .stop import build_stops
from .tree import GRAVITY, Tree, compile_tree

NO_SERVO_TICK = 1e-2  # [s] between the checks of a scene without sampled controllers
# Tolerances where none is given, but the integrator's own where that is less:
FREE = 1e-4  # of all but servos of a floating robot over ground, whose feet hold what an arm passes on
JUMPING = 1e-6  # where a controller's law jumps by more than an error of `JUMP` [rad] asks for,
JUMP = 2e-3  # of which a joint takes a third before the next tick
LOW = 1e9  # standing heights, with which nothing falls


@dataclass(frozen=True, eq=False)
class CompiledScene:
    """A scene ready to run; made by `compile_scene`."""

    model: Model
    tree: Tree
    constants: Scene
    places: np.recarray  # (1,) STATE: where each part of the state starts
    method: Integrator
    timestep: float  # [s]
    tick_steps: int  # steps of a controller tick
    lag: float  # [s]
    servos: ServoKind | None
    ground: Ground | None
    springs: tuple[Spring, ...]
    preflight: Preflight
    fall_height: float  # of the center of mass over the ground [m]
    fall_upright: float  # cosine
    upright: tuple[float, float, float]  # what points up in the frame of a root that is not tilted
    stiff: bool  # something that an implicit step takes in limits explicit steps to less than `STIFF`
    arguments: dict  # of `compile_scene`, after the model
    compiled: Scene  # the constants as compiled, to tell which were put in by hand

    def __repr__(self) -> str:
        joints = f"{self.model.base} base, {self.tree.n} joints"
        driven = f"{self.servos} servos" if self.servos else "no servos"
        under = "no ground" if self.ground is None else f"ground of friction {self.ground.friction:g}"
        step = self.integrator if self.adaptive else f"{self.integrator} at {self.timestep:g} s"
        return f"<scene of {self.model.name}: {joints}, {driven}, {under}, {len(self.springs)} springs, {step}>"

    def recompiled(self, model: Model | None = None, **changes: Any) -> CompiledScene:
        """The scene with another model or other arguments of `compile_scene`, and the same pushes.

        Raises ValueError where constants were put in by hand: they are no arguments, and would be lost.
        """
        if self.by_hand:
            names = ", ".join(self.by_hand)
            raise ValueError(
                f"{self.model.name}: {names} of the scene's constants were put in by hand and cannot be "
                "compiled anew; compile with the integrator and step wanted and put them in again, without rtol and "
                "estimate_error"
            )
        scene = compile_scene(self.model if model is None else model, **(self.arguments | changes))
        check = scene.preflight
        if "integrator" not in changes:
            check = check._replace(reason=self.preflight.reason, named=self.preflight.named)
        return replace(scene, preflight=check, constants=scene.constants._replace(push=self.constants.push))

    def in_place(self, integrator: str, why: str) -> CompiledScene:
        """The scene with another integrator than the one compiled for, which its preflight's reason says."""
        scene = self.recompiled(integrator=integrator)
        reason = f"{integrator} in place of {self.integrator} ({self.preflight.reason}): {why}"
        return replace(scene, preflight=scene.preflight._replace(reason=reason))

    @property
    def by_hand(self) -> list[str]:
        """Names of the constants that were put in after compiling, pushes aside."""
        pairs = zip(Scene._fields, self.constants, self.compiled)
        return [name for name, now, then in pairs if now is not then and name != "push"]

    @property
    def rtol(self) -> float:
        """Tolerance of error control where none is given.

        Of 40 steps of seven servos (`arm7`, mipsd) 10 are wrong by more than 1e-3 rad and say ok at 1e-2, 2 at 1e-3,
        one at 3e-4, none at 1e-4, for 1.6 times the time of 1e-2; 9 of 25 at 1e-2 on a source that sags.  Of 40 motions
        of ten servos on feet, into falls and in the air none is at 1e-2.  Where a law jumps, the least error may decide
        on which side: of 60 steps of a servo that counts in 5 mrad 32 are silently wrong at 1e-2, 21 at 1e-3; of 80
        others one at 1e-5, none at 1e-6.
        """
        if self.largest_jump > JUMP:
            return min(self.method.rtol, JUMPING)
        holds = self.servos and self.ground and self.tree.floating and self.constants.supply is None
        return self.method.rtol if holds else min(self.method.rtol, FREE)

    @cached_property
    def largest_jump(self) -> float:
        """Of what the controllers ask for, by the error that would ask for as much without it [rad]."""
        if not self.sampled:
            return 0.0
        servos = [self.model.servos[name] for name in self.model.joint_names if name in self.model.servos]
        return max(max(servo.encoder_resolution, _punch(servo.controller)) for servo in servos)

    @property
    def integrator(self) -> str:
        """Name of the integrator."""
        return self.method.name

    @property
    def adaptive(self) -> bool:
        """Whether the integrator chooses its steps by their error."""
        return self.method.adaptive

    @property
    def gravity(self) -> np.ndarray:
        """(3,) [m/s^2], world axes."""
        return self.constants.gravity

    @property
    def sampled(self) -> bool:
        """Whether servos have controllers that act at ticks."""
        return self.constants.decay is not None

    @cached_property
    def layout(self) -> np.void:
        """Where each part of the state starts."""
        return self.places.view(state.STATE, np.ndarray)[0]  # a record's fields take ten times as long to read

    @cached_property
    def parts(self) -> dict[str, tuple[int, int]]:
        """First and past-the-last index of each part of the state."""
        return state.parts(self.layout)

    def part(self, name: str) -> tuple[int, int]:
        """First and past-the-last index of a part of the state."""
        return self.parts[name]

    def pushed(self, pushes: Sequence[Push]) -> CompiledScene:
        """The scene with external forces, a list of `Push`."""
        table = build_pushes(self.tree, pushes)
        return self if table is None else replace(self, constants=self.constants._replace(push=table))


def compile_scene(
    model: Model,
    servos: ServoKind | None = None,
    ground: Ground | None = None,
    integrator: str | None = None,
    timestep: float | None = None,
    gravity: Sequence[float] | np.ndarray = GRAVITY,
    fall_height: float = 0.6,
    fall_tilt: float = math.radians(45),
    springs: Sequence[Spring] = (),
) -> CompiledScene:
    """Lay a model, its servos and the ground out for the kernels.

    Parameters
    ----------
    servos : "mipsd" (spring-damper gearbox with rotor), "rotor" (rigid, with the rotor's reflected inertia),
        "standard" (rigid, none), or None: no servos, torques from `simulate(tau=...)`
    ground : None where the robot touches nothing
    integrator : "implicit_euler", "midpoint" or "rk4" of fixed steps; "ars343", "extrapolation", or for what is not
        stiff "dop853", which choose their steps by the error that `simulate` allows; None chooses from the preflight
        "ars343" or "dop853".  `import featherstone_gait.reproduction` adds "simtwo", the paper's order of updates
    timestep : [s]; must divide the controllers' period; None chooses.  Of the latter three the grid of ticks, records
    gravity : (3,) [m/s^2], world axes.  Ground is as stiff as the robot's weight under it asks for
    springs : between points of two links.  All integrators take them explicitly: stiff ones are for "dop853"
    fall_height, fall_tilt : a floating robot over ground has fallen when its center of mass is lower than this fraction
        of its standing height (negative: never), or its root tilted by more than this [rad] (pi: never).  It stands as
        in its keyframe "stand", "standing" or "home", or else at zero, with the root's z, or the one axis of the root
        along which all contacts are below the center of mass, upright

    Raises ValueError on servos that the model does not have, on steps that do not fit, and on ground without gravity.
    """
    instance("model", model, Model, "give what load_robot returns")
    if not model.nv:
        raise ValueError(
            f"{model.name}: its base is fixed and no joint moves; load it with base='floating', or lock fewer joints"
        )
    if ground is not None and not isinstance(ground, Ground):
        raise ValueError(f"{model.name}: ground is {ground!r}; expected a Ground or None: write ground=Ground()")
    fall_tilt = real("fall_tilt", fall_tilt, 0.0, 2.0 * math.pi, "give radians, as math.radians(45); pi is no fall")
    fall_height = real("fall_height", fall_height, -LOW, 1.0, "it is a fraction of the standing height; 0 is no fall")
    gravity = vector("gravity", gravity, 3, f"[m/s^2], on Earth {GRAVITY}")
    tree, g = compile_tree(model), math.sqrt(dot(gravity, gravity))
    drive = build_drive(model, servos)
    contact = build_contact(model, tree, ground, gravity)
    springs = listed("springs", springs, "give a list of Spring")
    check_springs(model.links, springs)
    between = build_springs(tree, springs)
    rubbing = build_friction(model, drive)
    check = preflight(model, drive, rubbing, (ground, g), (springs, between), (integrator, timestep))
    method, h = INTEGRATORS[check.integrator], check.timestep
    if method.drives and not isinstance(drive.actuator, method.drives):
        raise ValueError(f"{method.name} is the update order of sampled servos; use implicit_euler for other scenes")
    if method.drives and isinstance(rubbing, GearFriction):
        raise ValueError(f"{method.name} knows no friction that depends on load or speed; use another integrator")
    period, lag = controller_period(model, drive, h, NO_SERVO_TICK)
    fold_springs(drive, method, h, check.inertias)
    other = method.drives or method.soft  # than the friction that limits steps
    constants = Scene(
        tree=tree.bodies,
        floating=True if tree.floating else None,
        gravity=gravity,
        actuator=drive.actuator,
        decay=build_decay(drive, h),
        armature=drive.armature,
        friction=rubbing if not other else build_friction(model, drive, bool(method.drives), method.soft),
        stops=build_stops(model, drive, check.inertias, g),
        contact=contact,
        push=None,
        springs=between,
        coupling=tree.coupling,
        firmware=build_firmware(model, drive, h, round(period / h)),
        supply=build_supply(model, drive),
    )
    falls = tree.floating and ground is not None
    height, upright = standing_posture(model) if falls else (0.0, (0.0, 0.0, 1.0))
    limited = check.folded_step < STIFF or sticks(constants.friction)
    return CompiledScene(
        model=model,
        tree=tree,
        constants=constants,
        places=_places(tree, drive, constants),
        method=method,
        timestep=h,
        tick_steps=round(period / h),
        lag=lag,
        servos=servos,
        ground=ground,
        springs=tuple(springs),
        preflight=check,
        fall_height=fall_height * height if falls and fall_height >= 0.0 else -math.inf,
        fall_upright=sincos(fall_tilt)[1] if falls and fall_tilt < math.pi else -2.0,
        upright=upright,
        stiff=drive.sampled or ground is not None or limited,
        arguments={
            "servos": servos,
            "ground": ground,
            "integrator": method.name,
            "timestep": h,
            "gravity": gravity,
            "fall_height": fall_height,
            "fall_tilt": fall_tilt,
            "springs": tuple(springs),
        },
        compiled=constants,
    )


def _punch(law: Controller) -> float:
    """By the error that would ask for as much [rad]."""
    return law.punch / law.Kp if law.Kp else math.inf if law.punch else 0.0


def _places(tree: Tree, drive: Drive, constants: Scene) -> np.recarray:
    """Give each part of the state its place."""
    has = () if drive.actuator is None else drive.actuator.PARTS
    contact, firmware, fed = constants.contact, constants.firmware, constants.supply is not None
    return state.lay_out(
        {
            "base": int(tree.floating),
            "joint": tree.n,
            "servo": tree.n * ("servo" in has),
            "rotor": tree.n * ("rotor" in has),
            "point": 0 if contact is None else len(contact.points),
            "run": 1,
            "profile": tree.n * (firmware.profile is not None),
            "delay": 0 if firmware.delay is None else tree.n * firmware.delay.slots,
            "fed": tree.n * fed,
            "source": int(fed),
        }
    )
