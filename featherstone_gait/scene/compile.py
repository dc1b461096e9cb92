"""Compile a model, its servos and the ground into a scene: the arrays that kernels read, and the step to take."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from ..base.arguments import instance, listed, shown
from ..base.brief import clipped, some
from ..base.flaws import quoted
from ..base.portable_math import sincos
from ..core.effects.gear_friction import GearFriction
from ..core.integrate import INTEGRATORS
from ..core.integrate.integrator import Integrator
from ..core.step import state
from ..core.step.context import Scene
from ..core.tree.loop import Loops
from ..model import Controller, Fluid, Ground, Loop, Model, Spring, Tendon
from ..model.pair_contact import PairContact, PairWord, pair_contact
from ..model.pair_friction import PairFriction
from ..model.placed import Placed, SceneModel, check_scene_loops, link_name
from ..model.sensor import RESERVED, WORLD, SampledSensor, Sensor
from ..model.tendon import ball_limit, spring_tendon
from .actuator import Drive, GearboxKind, build_decay, build_drive, controller_period, fold_springs
from .channels import Share, StateView
from .contact import bearing, build_contact, standing_posture
from .external import Push, build_lifts, build_pushes
from .firmware import build_firmware, build_supply
from .fluid import build_fluid, build_propellers
from .forest import (
    Member,
    joined_constants,
    joined_model,
    joined_preflight,
    joined_tree,
    members_of,
    shares,
    state_index,
)
from .friction import Friction, build_drag, build_friction, sticks
from .gearbox_kinds import IntegratorName
from .joint_spring import build_ball_springs, build_joint_springs, build_stiffening, fold_joint_springs
from .loop import Loops as LoopTables
from .loop import build_loops, joined_loops
from .options import SceneOptions, check_options
from .pairs import NOTHING, Touching, build_pairs, limited, no_pairs
from .preflight import STIFF, Preflight, implicit_reason, preflight
from .stop import build_stops
from .surface import build_commands, drives_of, joined_commands, scene_drives
from .tendon import build_tendons, fold_tendons, with_rows, with_stops
from .tree import GRAVITY, Tree, compile_tree
from .unused import unused

GIVE_LOOPS = "give a list of Loop between links 'name/link'"
NO_SERVO_TICK = 1e-2  # [s] between the checks of a scene without sampled controllers
# Tolerances where none is given, but the integrator's own where that is less:
FREE = 1e-4  # of all but servos of a floating robot over ground, whose feet hold what an arm passes on
SLOW, FINE = 0.03, 1e-7  # [m/s]; see `CompiledScene.atol`
JUMPING = 1e-6  # where a controller's law jumps by more than an error of `JUMP` [rad] asks for,
JUMP = 2e-3  # of which a joint takes a third before the next tick


@dataclass(frozen=True, eq=False)
class CompiledScene:
    """A scene ready to run; made by `compile_scene`.

    Attributes
    ----------
    model : Model
        The robot; of several members one of all, whose links and joints have their names before them.
    members : tuple of Member
        The robots and objects of a scene of several.
    obstacles : tuple of Placed
        Shapes that never move.
    excluded : tuple of (str, str)
        Links that do not touch each other.
    frictions : tuple of PairFriction
        Friction between shapes, in place of what follows from the two.
    touching : Touching
        Which bodies may touch each other, and what is left out.
    constants : Scene
        What the kernels read.
    options : SceneOptions
        The arguments of `compile_scene`, with the integrator and the step that were chosen.
    preflight : Preflight
        Limits of explicit steps, and why the integrator was chosen.
    tick_steps : int
        Steps between two samples of the controllers.
    lag : float
        Time from issuing a reference until the controllers see it [s].
    fall_height : float
        Height of the center of mass over the ground below which the robot has fallen [m].
    fall_upright : float
        Cosine of the tilt beyond which it has fallen.
    upright : tuple of float
        Direction (3,) that points up in the frame of a root that is not tilted.
    stiff : bool
        Whether something limits explicit steps to less than `STIFF`, or servos, dry friction or ground act
        discontinuously.
    """

    model: Model
    tree: Tree
    constants: Scene
    places: np.recarray  # (1,) STATE: where each part of the state starts
    method: Integrator
    options: SceneOptions  # with the integrator and the timestep chosen
    tick_steps: int  # steps of a controller tick
    lag: float  # [s]
    preflight: Preflight
    fall_height: float  # of the center of mass over the ground [m]
    fall_upright: float  # cosine
    upright: tuple[float, float, float]  # what points up in the frame of a root that is not tilted
    stiff: bool  # explicit steps are limited to less than `STIFF`, or forces are discontinuous
    compiled: Scene  # the constants as compiled, to tell which were put in by hand
    members: tuple[Member, ...] = ()
    obstacles: tuple[Placed, ...] = ()
    excluded: tuple[tuple[str, str], ...] = ()
    frictions: tuple[PairFriction, ...] = ()
    touching: Touching = NOTHING
    own_sensors: tuple[Sensor | SampledSensor, ...] = ()  # of a scene of several, those of no robot

    def __repr__(self) -> str:
        kind = f"{len(self.members)} members" if self.members else f"{self.model.base} base"
        name, joints = clipped(self.model.name), f"{kind}, {self.tree.n} joints"
        driven = f"{self.gearbox} servos" if self.gearbox else "no servos"
        under = "no ground" if self.ground is None else f"ground of friction {self.ground.friction:g}"
        step = self.integrator if self.adaptive else f"{self.integrator} at {self.timestep:g} s"
        between = f"{len(self.pairs)} pairs" if self.pairs else f"{len(self.springs)} springs"
        return f"<scene of {name}: {joints}, {driven}, {under}, {between}, {step}>"

    def recompiled(
        self, model: Model | None = None, places: Mapping[str, Mapping[str, Any]] | None = None, **changes: Any
    ) -> CompiledScene:
        """Compile the scene with another model or other arguments of `compile_scene`, and the same pushes.

        places: changes of `Placed` by the names of members.

        Raises ValueError if constants were replaced by hand: they are no arguments, and would be lost.
        """
        if self.by_hand:
            names = ", ".join(self.by_hand)
            raise ValueError(
                f"{self.model.name}: {names} of the scene's constants were put in by hand and cannot be "
                "compiled anew; compile with the integrator and step wanted and put them in again, without rtol and "
                "estimate_error"
            )
        scene = compile_scene(self._described(model, places or {}), **(self.options._asdict() | changes))
        check = scene.preflight
        if "integrator" not in changes:
            check = check._replace(reason=self.preflight.reason, named=self.preflight.named)
        constants = scene.constants._replace(push=self.constants.push)
        return replace(scene, preflight=check, constants=constants)

    def _described(self, model: Model | None, places: Mapping[str, Mapping[str, Any]]) -> Model | SceneModel:
        """Return what to compile anew, with the numbers of another model of the same parts."""
        if not self.members:
            return self.model if model is None else model
        models = [one.model for one in self.members] if model is None else members_of(self.members, model)
        both = zip(self.members, models)
        placed = [replace(one.placed, model=new, **places.get(one.name, {})) for one, new in both]
        return SceneModel(
            self.model.name, tuple(placed), self.obstacles, excluded=self.excluded, sensors=self.own_sensors,
            frictions=self.frictions,
        )  # fmt: skip

    @property
    def timestep(self) -> float:
        """Fixed step, or grid of ticks and records of an integrator that chooses its steps [s]."""
        return self.preflight.timestep

    @property
    def gearbox(self) -> GearboxKind | None:
        """Model of the gearboxes, None without servos."""
        return self.options.gearbox

    @property
    def ground(self) -> Ground | None:
        """Ground under the contact points."""
        return self.options.ground

    @property
    def springs(self) -> tuple[Spring, ...]:
        """Springs between links."""
        return tuple(self.options.springs)

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Links that may touch each other, once for each two of their shapes; the first of both can move."""
        return self.touching.names

    @property
    def notes(self) -> tuple[str, ...]:
        """Return what touches nothing in this scene, and numbers of servos without effect, one sentence each."""
        if not self.members:
            return unused(self.model, self.gearbox, self.method)
        return (*self.touching.notes, *(f"{one.name}: {note}" for one in self.members for note in one.scene.notes))

    @property
    def sensors(self) -> dict[str, Sensor | SampledSensor]:
        """The sensors of robots and scene, by the names under which they are observed and recorded."""
        if not self.members:
            return {one.name: one for one in self.model.sensors}
        found = {one.name: one for one in self.own_sensors}
        for member in self.members:
            for one in member.model.sensors:
                name = link_name(member.name, one.name)
                found[name] = _of_member(one, member.name, name)
        return found

    @property
    def by_hand(self) -> list[str]:
        """Names of the constants that were replaced after compiling, except pushes."""
        pairs = zip(Scene._fields, self.constants, self.compiled)
        return [name for name, now, then in pairs if now is not then and name != "push"]

    @property
    def rtol(self) -> float:
        """Default tolerance of error control.

        Measured by steps of a reference that end more than 1e-3 rad off with the status "ok":

        - Seven servos (`arm7`, mipsd): 10 of 40 steps at a tolerance of 1e-2, 2 at 1e-3, one at 3e-4, none at 1e-4,
          which takes 1.6 times as long as 1e-2.  With a supply that sags: 9 of 25 at 1e-2.
        - Ten servos on feet, with falls and flights: none of 40 motions at 1e-2.
        - A servo with an encoder step of 5 mrad, whose control law jumps, so that the smallest error may decide on
          which side: 32 of 60 steps at 1e-2, 21 at 1e-3; of 80 others one at 1e-5, none at 1e-6.
        """
        if self.largest_jump > JUMP:
            return min(self.method.rtol, JUMPING)
        holds = self.gearbox and self.ground and self.tree.floating and self.constants.supply is None
        return self.method.rtol if holds else min(self.method.rtol, FREE)

    def atol(self, rtol: float) -> float:
        """Return the absolute tolerance that goes with a relative one [rad, m, and their rates; A].

        Where bodies touch each other, slow ones count as much as fast ones, since the speed of a rebound is a share of
        that before: SLOW times rtol, down to FINE.  Of head-on collisions of two balls of 1 kg and 1 to 1000 kg at 0.05
        to 10 m/s the restitution is off by up to 7e-3 with atol = rtol = 1e-4, and by up to 7e-4 so.  A stack at rest
        takes 1.4 times as many steps, a ball that rolls twice as many.
        """
        slow = self.touching.table is not None and rtol <= FREE
        return max(SLOW * rtol, min(rtol, FINE)) if slow else rtol

    @cached_property
    def largest_jump(self) -> float:
        """Largest jump of a control law, as the error that would cause the same output [rad]."""
        if not self.sampled:
            return 0.0
        servos = [self.model.servos[name] for name in self.model.joint_names if name in self.model.servos]
        return max(max(servo.encoder_resolution, _punch(servo.controller)) for servo in servos)

    @property
    def counts(self) -> bool:
        """Return whether a control law jumps: it rounds angles or duty cycles to counts, or has a punch."""
        laws = [servo.controller for servo in self.model.servos.values()]
        return self.largest_jump > 0 or (self.sampled and any(law.pwm_steps > 0 for law in laws))

    @property
    def integrator(self) -> str:
        """Name of the integrator."""
        return self.method.name

    @property
    def adaptive(self) -> bool:
        """Return whether the integrator chooses its steps by their error."""
        return self.method.adaptive

    @property
    def gravity(self) -> np.ndarray:
        """Acceleration of gravity (3,) [m/s^2], world axes."""
        return self.constants.gravity

    @property
    def sampled(self) -> bool:
        """Return whether the servos have sampled controllers."""
        return self.constants.decay is not None

    @property
    def driven_tendons(self) -> tuple[Tendon, ...]:
        """Tendons that have a drive; the columns of references and torques are those of the joints, then theirs."""
        return tuple(one for one in self.model.tendons if one.driven)

    @property
    def inputs(self) -> int:
        """Number of columns of references and torques."""
        return self.tree.n + len(self.driven_tendons)

    @property
    def commanded(self) -> int:
        """Number of columns of what a `Session` is given: tendons are not among them where servos are sampled."""
        return self.tree.n if self.sampled else self.inputs

    @property
    def surface_drives(self) -> tuple[str, ...]:
        """Names of the drives of surfaces that move, in the order of the channels `surface_command` and `surface_work`.

        Of several members it is "name/drive".
        """
        if not self.members:
            return tuple(drives_of(self.model))
        return scene_drives([*(one.placed for one in self.members), *self.obstacles])

    @property
    def follows(self) -> bool:
        """Return whether something follows references: servos, or drives of tendons that are no mere motors."""
        return self.constants.actuator is not None or _follow(self.model)

    @cached_property
    def layout(self) -> dict[str, int]:
        """First index of each part of the state, and the state's "length"."""
        return dict(zip(state.STATE.names or (), self.places[0].tolist()))

    @cached_property
    def parts(self) -> dict[str, tuple[int, int]]:
        """First and past-the-last index of each part of the state."""
        return state.parts(self.layout)

    @cached_property
    def shares(self) -> dict[str, Share]:
        """Which numbers of the channels are each member's, by name."""
        return shares(self.members)

    def part(self, name: str) -> tuple[int, int]:
        """Return first and past-the-last index of a part of the state."""
        return self.parts[name]

    def member(self, name: str) -> Member:
        """Look up a robot or object of a scene of several by its name.

        Raises ValueError if there is none.
        """
        found = next((one for one in self.members if one.name == name), None)
        if found is None:
            known = ", ".join(one.name for one in self.members) or "none, for the scene has one robot alone"
            raise ValueError(f"scene: there is no robot or object {shown(name)}; there are {known}")
        return found

    def state_of(self, name: str, y: np.ndarray) -> np.ndarray:
        """Return a copy of the numbers of states (..., size) that are one member's: a state of its own scene."""
        return y[..., state_index(self, self.member(name))]

    def state_view(self, y: np.ndarray) -> StateView:
        """Return the channels of states (..., size) by name, as views: ``scene.state_view(y).q[0] = 0.1`` changes y.

        Raises ValueError for an array of another size.
        """
        if not isinstance(y, np.ndarray) or y.shape[-1:] != (self.layout["length"],):
            size = self.layout["length"]
            raise ValueError(f"y is {shown(y)}; give an array (..., {size}), such as initial_state(scene) returns")
        return StateView(y, self.parts)

    def pushed(self, pushes: Sequence[Push]) -> CompiledScene:
        """Return the scene with external forces.

        Parameters
        ----------
        pushes : sequence of Push
            Forces and moments on links.

        Returns
        -------
        CompiledScene
            The scene with these pushes.

        Raises
        ------
        ValueError
            For unknown links and numbers that are not finite.
        """
        table = build_pushes(self.tree, pushes)
        return self if table is None else replace(self, constants=self.constants._replace(push=table))


def compile_scene(
    model: Model | Placed | SceneModel | Sequence[Model | Placed],
    gearbox: GearboxKind | None = None,
    ground: Ground | None = None,
    integrator: IntegratorName | None = None,
    timestep: float | None = None,
    gravity: Sequence[float] | np.ndarray = GRAVITY,
    fall_height: float = 0.6,
    fall_tilt: float = math.radians(45),
    springs: Sequence[Spring] = (),
    pairs: PairWord | Sequence[tuple[str, str]] | PairContact | None = None,
    loops: Sequence[Loop] | None = None,
    fluid: Fluid | None = None,
) -> CompiledScene:
    """Compile models, their servos and the ground into a scene.

    Parameters
    ----------
    model : Model, Placed, SceneModel, or sequence of the first two
        The robot, or robots and free objects at their places.  Ground and gravity of a `SceneModel` are those of the
        scene where no others are given.
    gearbox : {"mipsd", "rotor", "standard"}, optional
        Model of the gearboxes: "mipsd" (motor inertia plus spring-damper), "rotor" (rigid, with the rotor's reflected
        inertia), "standard" (rigid, without it).  None: no servos; torques come from ``simulate(tau=...)``.
    ground : Ground, optional
        Ground under the contact points; its stiffness scales with the robot's weight.  None: the robot touches nothing.
    integrator : str, optional
        With fixed steps "implicit_euler", "midpoint" or "rk4"; with error control "ars343", "extrapolation" or, for
        scenes that are not stiff, "dop853".  None chooses "ars343" or "dop853" from the stiffness of the scene.
        "simtwo" is the order of updates of another program, for comparison.
    timestep : float, optional
        Step [s]; it must divide the controllers' period.  For integrators with error control it is the grid of
        controller ticks and records.  None chooses it.
    gravity : array_like, optional
        Acceleration of gravity (3,) in world axes [m/s^2].
    fall_height : float, optional
        A floating robot over ground has fallen when its center of mass is lower than this fraction of its standing
        height; negative: never.
    fall_tilt : float, optional
        It has also fallen when its root is tilted by more than this angle [rad]; pi: never.
    springs : sequence of Spring, optional
        Springs between points of two links.
    pairs : str, sequence of (str, str), or PairContact, optional
        Bodies that touch each other: "none", "all", pairs of names ("name/link", or "name" for all links of a member or
        obstacle), or a `PairContact` with numbers.  None: what a `SceneModel` says, else "none".  With pairs a single
        model is a scene of one member, whose links and joints are called "name/link" and "name/joint".
    loops : sequence of Loop, optional
        Constraints between links "name/link" of two members, or of one and the world, beside those of the models.
        None: those of a `SceneModel`.
    fluid : Fluid, optional
        Fluid around the shapes that `Model.immersed` lists.  None: that of a `SceneModel`, else none.

    Returns
    -------
    CompiledScene
        The scene, for `simulate`.

    Raises
    ------
    ValueError
        For servos that the model does not have, steps that do not fit, ground that gravity pulls away from, loops and
        pairs of names that are not in the scene, and pairs that cannot touch.

    Notes
    -----
    The standing height is that of the keyframe "stand", "standing" or "home", else of the zero posture.  There the
    root's z axis is upright, or the one axis of the root along which all contacts are below the center of mass.
    """
    given = model.pairs if pairs is None and isinstance(model, SceneModel) else pairs
    stated = model.loops if isinstance(model, SceneModel) else ()
    between = tuple(stated if loops is None else listed("loops", loops, GIVE_LOOPS))
    options = SceneOptions(
        gearbox,
        ground,
        integrator,
        timestep,
        gravity,
        fall_height,
        fall_tilt,
        springs,
        pair_contact(given),
        between,
        fluid,
    )
    if isinstance(model, Model):
        if options.pairs is not None or options.loops:
            return _compile_members([model], options)
        _check_immersed(model.name, [model], fluid)
        return _compile(model, options)
    if isinstance(model, SceneModel):
        own = GRAVITY if model.gravity is None else model.gravity
        options = options._replace(ground=ground or model.ground, gravity=own if gravity is GRAVITY else gravity)
        options = options._replace(fluid=fluid or model.fluid)
        scene = _compile_members(model.members, options, model.obstacles, model.excluded, model.frictions)
        return replace(scene, own_sensors=model.sensors) if model.sensors else scene
    return _compile_members(model, options)


def _of_member(sensor: Any, member: str, name: str) -> Any:
    """Return the sensor of a member as one of the scene."""
    if isinstance(sensor, SampledSensor):
        if isinstance(sensor.sensor, str):
            exact = sensor.sensor if sensor.sensor in RESERVED else link_name(member, sensor.sensor)
            return replace(sensor, sensor=exact, name=name)
        return replace(sensor, sensor=_of_member(sensor.sensor, member, name), name=name)
    return replace(sensor, link=sensor.link if sensor.link == WORLD else link_name(member, sensor.link), name=name)


def _compile(model: Model, given: SceneOptions) -> CompiledScene:
    """Compile one model."""
    options, ground = check_options(model, given), given.ground
    drive, g = build_drive(model, options.gearbox), np.asarray(options.gravity)
    _check_drives(model.name, [model], drive.sampled)
    lines = _lines(model, options.springs)
    tree = with_rows(compile_tree(model), lines)
    contact, tendons = build_contact(model, tree, options), build_tendons(model, tree, lines)
    friction, joint_springs = build_friction(model, drive), build_joint_springs(model)
    check = _closing(preflight(model, drive, friction, lines, options), model)
    method, h = _method(check.integrator, model, drive, friction), check.timestep
    period, lag = controller_period(model, drive, h, NO_SERVO_TICK)
    ticks = round(period / h)
    fold_springs(drive, method, h, check.inertias)
    fold_joint_springs(joint_springs, method, h, check.inertias)
    fold_tendons(tendons, method, h, check.tendon_inertias)
    if method.drives or method.soft:  # takes another friction than the one that limits steps
        friction = build_friction(model, drive, bool(method.drives), method.soft)
    constants = Scene(
        tree=tree.bodies,
        floating=True if tree.floating else None,
        gravity=g,
        actuator=drive.actuator,
        decay=build_decay(drive, h),
        armature=drive.armature,
        friction=friction,
        stops=build_stops(model, drive, check.inertias, options.g),
        contact=contact,
        push=None,
        coupling=tree.coupling,
        firmware=build_firmware(model, drive, h, ticks),
        supply=build_supply(model, drive),
        joint_springs=joint_springs,
        lifts=build_lifts(model, tree, g),
        balls=tree.balls,
        loops=_loops(build_loops(model) if model.loops else None, tree),
        stiffening=build_stiffening(model),
        drag=build_drag(model),
        ball_springs=build_ball_springs(model),
        tendons=with_stops(tendons, model, lines, check.tendon_inertias, options.g),
        fluid=build_fluid(model, tree, options.fluid, g, 0 if contact is None else len(contact.points)),
        propellers=build_propellers(model, tree),
        surfaces=build_commands(model),
    )
    lowest, upright_cosine, upright = _fall_limits(model, options)
    return CompiledScene(
        model=model,
        tree=tree,
        constants=constants,
        places=_places(tree, constants),
        method=method,
        options=options._replace(integrator=method.name, timestep=h),
        tick_steps=ticks,
        lag=lag,
        preflight=check,
        fall_height=lowest,
        fall_upright=upright_cosine,
        upright=upright,
        stiff=drive.switches or ground is not None or check.largest_explicit_step < STIFF or sticks(friction, tendons),
        compiled=constants,
    )


def _closing(check: Preflight, model: Model) -> Preflight:
    """Say in the reason that loops are closed, if there are any."""
    if not model.loops:
        return check
    names = quoted([loop.name for loop in model.loops])
    return check._replace(reason=f"{check.reason}; loops {names} are closed after each step")


def _lines(model: Model, springs: Iterable[Spring]) -> tuple[Tendon, ...]:
    """Return what acts along a length: tendons, springs between links, and limits of ball joints."""
    return (
        *(one for one in model.tendons if one.acts),
        *(spring_tendon(spring) for spring in springs),
        *(ball_limit(joint) for joint in model.ball_joints if joint.upper < math.inf),
    )


def _compile_members(
    models: Any,
    options: SceneOptions,
    obstacles: tuple[Placed, ...] = (),
    excluded: tuple[tuple[str, str], ...] = (),
    frictions: tuple[PairFriction, ...] = (),
) -> CompiledScene:
    """Compile several models: each alone, then all tables one after the other."""
    given, options = options, _implicit(options)
    members = _members(models, options)
    _check_immersed("scene", [member.model for member in members], options.fluid)
    checks = [member.scene.preflight for member in members]
    first = next((one for one in checks if INTEGRATORS[one.integrator].name == "ars343"), checks[0])
    step = min(one.timestep for one in checks)
    if any(one.integrator != first.integrator or one.timestep != step for one in checks):
        chosen = options._replace(integrator=first.integrator, timestep=step)
        members = [Member(one.placed, _compile(one.model, _own(one.placed, chosen))) for one in members]
    decisive = next((one.scene for one in members if one.scene.sampled), members[0].scene)
    _check_ticks(members)
    _check_drives("scene", [one.model for one in members], decisive.sampled)
    options = options._replace(gravity=members[0].scene.options.gravity)
    touching, tree = build_pairs(members, obstacles, excluded, joined_tree(members), options, frictions)
    model = joined_model(members, some((member.name for member in members), 4, " and "), options.loops)
    loops = _loops(joined_loops(members, tree, options.loops), tree)
    pairs = no_pairs(tree) if touching.table is None and options.loops else touching.table  # joined trees are an island
    commands = joined_commands([*(one.placed for one in members), *obstacles])
    constants = joined_constants(members, tree)
    contact = bearing(constants.contact, touching.loads, tree.trees)
    constants = constants._replace(contact=contact, pairs=pairs, loops=loops, surfaces=commands)
    first = first._replace(timestep=step, named=given.integrator is not None)
    check = joined_preflight(members, first, touching.loads)
    check = limited(check, touching, tree)
    if given.integrator != options.integrator:
        check = check._replace(reason=implicit_reason(check))
    gearboxes = [member.scene.gearbox for member in members if member.scene.gearbox is not None]
    scenes = [member.scene for member in members]
    return CompiledScene(
        model=model,
        tree=tree,
        constants=constants,
        places=_places(tree, constants),
        method=decisive.method,
        options=options._replace(
            gearbox=gearboxes[0] if gearboxes else None, integrator=decisive.method.name, timestep=step
        ),
        tick_steps=decisive.tick_steps,
        lag=decisive.lag,
        preflight=check,
        fall_height=-math.inf,
        fall_upright=-2.0,
        upright=(0.0, 0.0, 1.0),
        stiff=any(scene.stiff for scene in scenes) or touching.table is not None,
        compiled=constants,
        members=tuple(members),
        obstacles=obstacles,
        excluded=excluded,
        frictions=frictions,
        touching=touching,
    )  # fmt: skip


def _follow(model: Model) -> bool:
    """Return whether drives of tendons follow references."""
    return any(one.controller is not None and one.controller.Kp > 0 for one in model.tendons)


def _check_drives(name: str, models: Iterable[Model], sampled: bool) -> None:
    """Raise ValueError where drives of tendons follow references that sampled servos see at ticks only."""
    if sampled and any(_follow(model) for model in models):
        raise ValueError(
            f"{name}: controllers of tendons follow their references at every instant, and the servos of joints are "
            "sampled; give the joints torque laws ('pd', 'pd_clamped'), or the tendons Kp=0 and their forces as tau"
        )


def _check_immersed(name: str, models: Iterable[Model], fluid: Any) -> None:
    """Raise ValueError for a fluid in which nothing is immersed."""
    if fluid is not None and not any(model.immersed for model in models):
        raise ValueError(
            f"{name}: the fluid acts on nothing, since no robot has immersed shapes; give Model.immersed, or "
            "[[immersed]] in the file beside the robot, or leave the fluid out"
        )


def _implicit(options: SceneOptions) -> SceneOptions:
    """Return the options of a scene whose bodies touch each other, which is stiff, with the integrator that is."""
    chosen = options.pairs is not None and options.integrator is None
    return options._replace(integrator="ars343") if chosen else options


def _loops(found: LoopTables | None, tree: Tree) -> Loops | None:
    """Return the loops for kernels, None without."""
    if found is None:
        return None
    joined = True if tree.trees is not None and len(found.table) > tree.trees.end_loop[-1] else None
    return Loops(found.table, np.array([found.rows]), joined)


def _members(models: Any, options: SceneOptions) -> list[Member]:
    """Compile each of the models alone; raise ValueError for names given twice."""
    models = [models] if isinstance(models, Placed) else listed("model", models, "give a list of Model and Placed")
    if not models:
        raise ValueError("model: the list is empty; give at least one Model or Placed")
    placed = [Placed(one) if isinstance(one, Model) else one for one in models]
    for one in placed:
        instance("model", one, Placed, "give a Model, or Placed(model, position=(x, y))")
    repeated = [name for name, times in Counter(one.name for one in placed).items() if times > 1]
    if repeated:
        raise ValueError(
            f"model: {repeated[0]!r} is the name of several robots or objects; give each its own, as "
            "Placed(model, name='left')"
        )
    if listed("springs", options.springs, "give a list of Spring"):
        raise ValueError("springs: they join links of one model, and this scene has several, or pairs; leave them out")
    check_scene_loops(placed, options.loops)
    members = [Member(one, _compile(one.model, _own(one, options))) for one in placed]
    if options.loops:
        _check_closes(members[0].scene.method, "scene", options.loops, "leave them out")
    return members


def _own(placed: Placed, options: SceneOptions) -> SceneOptions:
    """Return the options of one member: its gearbox, and ground if its contact points meet any."""
    model = placed.model
    gearbox = options.gearbox if placed.gearbox == "scene" else cast(Any, placed.gearbox)
    if placed.gearbox == "scene" and not any(name in model.servos for name in model.joint_names):
        gearbox = None
    ground = options.ground if placed.ground_contact and model.contacts else None
    return options._replace(gearbox=gearbox, ground=ground, pairs=None, loops=())


def _check_ticks(members: Sequence[Member]) -> None:
    """Raise ValueError unless all sampled controllers have one period and lag."""
    found = {(m.scene.tick_steps * m.scene.timestep, m.scene.lag): m.name for m in members if m.scene.sampled}
    if len(found) > 1:
        each = ", ".join(f"{name!r} {period:g} s and {lag:g} s" for (period, lag), name in found.items())
        raise ValueError(f"scene: controllers differ in period and lag: {each}; give them the same")


def _method(name: str, model: Model, drive: Drive, friction: Friction | None) -> Integrator:
    """Look up an integrator; raise ValueError if it does not suit the loops, the servos or their friction."""
    method = INTEGRATORS[name]
    open_tree = "simulate the open tree with dataclasses.replace(model, loops=())"
    _check_closes(method, model.name, model.loops, open_tree)
    if method.drives and not isinstance(drive.actuator, method.drives):
        raise ValueError(f"{name} is the update order of sampled servos; use implicit_euler for other scenes")
    if method.drives and isinstance(friction, GearFriction):
        raise ValueError(f"{name} knows no friction that depends on load or speed; use another integrator")
    slow = drive.slow_current if method.soft else None
    if slow is not None:
        raise ValueError(
            f"{name} takes a current without inductance as being there at once, so a current_slew of {slow:g} A/s "
            "would have no effect; give the servo an inductance, or use ars343"
        )
    return method


def _check_closes(method: Integrator, what: str, loops: Sequence[Loop], remedy: str) -> None:
    """Raise ValueError for an integrator that does not keep loops closed."""
    if loops and not method.closes:
        others = quoted([one.name for one in INTEGRATORS.values() if one.closes])
        raise ValueError(
            f"{what}: integrator {method.name!r} does not keep loops {quoted([loop.name for loop in loops])} closed; "
            f"use one of {others}, or {remedy}"
        )


def _fall_limits(model: Model, options: SceneOptions) -> tuple[float, float, tuple[float, float, float]]:
    """Compute at which height [m] and cosine of its tilt a robot has fallen, and which axis of its root points up."""
    cosine = sincos(options.fall_tilt)[1] if options.fall_tilt < math.pi else -2.0
    if model.base == "fixed" or options.ground is None:
        return -math.inf, cosine, (0.0, 0.0, 1.0)
    height, upright = standing_posture(model)
    return options.fall_height * height if options.fall_height >= 0.0 else -math.inf, cosine, upright


def _punch(law: Controller) -> float:
    """Return the error that would cause the same voltage as the punch [rad]."""
    return law.punch / law.Kp if law.Kp else math.inf if law.punch else 0.0


def _places(tree: Tree, constants: Scene) -> np.recarray:
    """Lay the parts of the state out."""
    has = () if constants.actuator is None else cast(Any, constants.actuator).PARTS
    contact, firmware, fed, pairs = constants.contact, constants.firmware, constants.supply is not None, constants.pairs
    return state.lay_out(
        {
            "base": tree.bases,
            "ball": 0 if tree.balls is None else len(tree.balls),
            "joint": tree.n,
            "servo": tree.n * ("servo" in has),
            "rotor": tree.n * ("rotor" in has),
            "point": 0 if contact is None else len(contact.points),
            "tree": 1 if tree.trees is None else len(tree.trees),
            "run": 1,
            "profile": tree.n * (firmware.profile is not None),
            "delay": 0 if firmware.delay is None else tree.n * firmware.delay.slots,
            "fed": tree.n * fed,
            "source": int(fed),
            "slot": 0 if pairs is None else int(pairs.slots[0]),
            "turning": 0 if pairs is None or pairs.turning is None else int(pairs.slots[0]),
            "pairs": int(pairs is not None),
            "tendon": 0 if constants.tendons is None else len(constants.tendons.table),
            "fluid": (constants.fluid is not None or constants.propellers is not None)
            * (1 if tree.trees is None else len(tree.trees)),
            "immersed": 0 if constants.fluid is None else len(constants.fluid.table),
            "loop": 0 if constants.loops is None else len(constants.loops.table),
            "row": 0 if constants.loops is None else int(constants.loops.rows[0]),
            "surface": 0 if constants.surfaces is None else len(constants.surfaces),
            "rolling": 0 if contact is None or contact.rolling is None else len(contact.points),
        }
    )
