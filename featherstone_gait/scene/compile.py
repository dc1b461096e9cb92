"""Compile a model, its servos and the ground into a scene: the arrays that kernels read, and the step to take."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from ..base.arguments import instance, listed, shown
from ..base.brief import clipped, some
from ..core.integrate import INTEGRATORS
from ..core.integrate.integrator import Integrator
from ..core.step import state
from ..core.step.context import Scene
from ..dynamics.loop_table import build_loops
from ..dynamics.tree import GRAVITY, Tree, build_lifts, compile_tree
from ..model import Fluid, Ground, Loop, Model, Spring, Tendon
from ..model.pair_contact import PairContact, PairWord, pair_contact
from ..model.pair_friction import PairFriction
from ..model.placed import Placed, SceneModel, check_scene_loops, link_name
from ..model.sensor import SampledSensor, Sensor
from .actuator import GearboxKind, build_decay, build_drive, controller_period, fold_springs
from .channels import Share, StateView, places_of
from .checks import check_closes, check_drives, check_immersed, check_ticks, follows_references, method_of
from .contact import bearing, build_contact, fall_limits
from .external import Push, build_pushes
from .firmware import build_firmware, build_supply
from .fluid import build_fluid, build_propellers
from .forest import (
    Member,
    joined_constants,
    joined_model,
    joined_preflight,
    joined_tree,
    members_of,
    sensor_of_scene,
    shares,
    state_index,
)
from .friction import build_drag, build_friction, sticks
from .gearbox_kinds import IntegratorName
from .joint_spring import build_ball_springs, build_joint_springs, build_stiffening, fold_joint_springs
from .loop import joined_loops, loops_of_kernels
from .options import SceneOptions, check_options, implicit_where_stiff
from .pairs import NOTHING, Touching, build_pairs, limited, no_pairs
from .preflight import STIFF, Preflight, closing, implicit_reason, preflight
from .stop import build_stops
from .surface import build_commands, drives_of, joined_commands, scene_drives
from .tendon import build_tendons, fold_tendons, lines_of, with_rows, with_stops
from .tolerances import largest_jump, usual_atol, usual_rtol
from .unused import unused

GIVE_LOOPS = "give a list of Loop between links 'name/link'"
NO_SERVO_TICK = 1e-2  # [s] between the checks of a scene without sampled controllers


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
                found[name] = sensor_of_scene(one, member.name, name)
        return found

    @property
    def by_hand(self) -> list[str]:
        """Names of the constants that were replaced after compiling, except pushes."""
        pairs = zip(Scene._fields, self.constants, self.compiled)
        return [name for name, now, then in pairs if now is not then and name != "push"]

    @property
    def rtol(self) -> float:
        """Default tolerance of error control: see `usual_rtol`."""
        holds = self.gearbox and self.ground and self.tree.floating and self.constants.supply is None
        return usual_rtol(self.method, self.largest_jump, bool(holds))

    def atol(self, rtol: float) -> float:
        """Return the absolute tolerance that goes with a relative one [rad, m, and their rates; A]."""
        return usual_atol(rtol, self.touching.table is not None)

    @cached_property
    def largest_jump(self) -> float:
        """Largest jump of a control law, as the error that would cause the same output [rad]."""
        servos = [self.model.servos[name] for name in self.model.joint_names if name in self.model.servos]
        return largest_jump(servos) if self.sampled else 0.0

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
        return self.constants.actuator is not None or follows_references(self.model)

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
        gearbox, ground, integrator, timestep, gravity, fall_height, fall_tilt, springs, pair_contact(given), between,
        fluid,
    )  # fmt: skip
    if isinstance(model, Model):
        if options.pairs is not None or options.loops:
            return _compile_members([model], options)
        check_immersed(model.name, [model], fluid)
        return _compile(model, options)
    if isinstance(model, SceneModel):
        own = GRAVITY if model.gravity is None else model.gravity
        options = options._replace(ground=ground or model.ground, gravity=own if gravity is GRAVITY else gravity)
        options = options._replace(fluid=fluid or model.fluid)
        scene = _compile_members(model.members, options, model.obstacles, model.excluded, model.frictions)
        return replace(scene, own_sensors=model.sensors) if model.sensors else scene
    return _compile_members(model, options)


def _compile(model: Model, given: SceneOptions) -> CompiledScene:
    """Compile one model."""
    options, ground = check_options(model, given), given.ground
    drive, g = build_drive(model, options.gearbox), np.asarray(options.gravity)
    check_drives(model.name, [model], drive.sampled)
    lines = lines_of(model, options.springs)
    tree = with_rows(compile_tree(model), lines)
    contact, tendons = build_contact(model, tree, options), build_tendons(model, tree, lines)
    friction, joint_springs = build_friction(model, drive), build_joint_springs(model)
    check = closing(preflight(model, drive, friction, lines, options), model)
    method, h = method_of(check.integrator, model, drive, friction), check.timestep
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
        loops=loops_of_kernels(build_loops(model) if model.loops else None, tree),
        stiffening=build_stiffening(model),
        drag=build_drag(model),
        ball_springs=build_ball_springs(model),
        tendons=with_stops(tendons, model, lines, check.tendon_inertias, options.g),
        fluid=build_fluid(model, tree, options.fluid, g, 0 if contact is None else len(contact.points)),
        propellers=build_propellers(model, tree),
        surfaces=build_commands(model),
    )
    lowest, upright_cosine, upright = fall_limits(model, options)
    return CompiledScene(
        model=model,
        tree=tree,
        constants=constants,
        places=places_of(tree, constants),
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


def _compile_members(
    models: Any,
    options: SceneOptions,
    obstacles: tuple[Placed, ...] = (),
    excluded: tuple[tuple[str, str], ...] = (),
    frictions: tuple[PairFriction, ...] = (),
) -> CompiledScene:
    """Compile several models: each alone, then all tables one after the other."""
    given, options = options, implicit_where_stiff(options)
    members = _members(models, options)
    check_immersed("scene", [member.model for member in members], options.fluid)
    checks = [member.scene.preflight for member in members]
    first = next((one for one in checks if INTEGRATORS[one.integrator].name == "ars343"), checks[0])
    step = min(one.timestep for one in checks)
    if any(one.integrator != first.integrator or one.timestep != step for one in checks):
        chosen = options._replace(integrator=first.integrator, timestep=step)
        members = [Member(one.placed, _compile(one.model, _own(one.placed, chosen))) for one in members]
    decisive = next((one.scene for one in members if one.scene.sampled), members[0].scene)
    check_ticks(members)
    check_drives("scene", [one.model for one in members], decisive.sampled)
    options = options._replace(gravity=members[0].scene.options.gravity)
    touching, tree = build_pairs(members, obstacles, excluded, joined_tree(members), options, frictions)
    model = joined_model(members, some((member.name for member in members), 4, " and "), options.loops)
    loops = loops_of_kernels(joined_loops(members, tree, options.loops), tree)
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
        places=places_of(tree, constants),
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
        check_closes(members[0].scene.method, "scene", options.loops, "leave them out")
    return members


def _own(placed: Placed, options: SceneOptions) -> SceneOptions:
    """Return the options of one member: its gearbox, and ground if its contact points meet any."""
    model = placed.model
    gearbox = options.gearbox if placed.gearbox == "scene" else cast(Any, placed.gearbox)
    if placed.gearbox == "scene" and not any(name in model.servos for name in model.joint_names):
        gearbox = None
    ground = options.ground if placed.ground_contact and model.contacts else None
    return options._replace(gearbox=gearbox, ground=ground, pairs=None, loops=())
