"""Join scenes of one robot or object each to one: their tables one after the other, names with the robot's before.

Each member is compiled as it would be alone, so that its numbers are those of a scene of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from ..base.rotation import rotation_from_quaternion, rpy_from_rotation
from ..core.effects.contact import ROLLER, ROLLING, Contact
from ..core.effects.drag import DRAG
from ..core.effects.firmware import BAND, PWM, Firmware
from ..core.effects.friction import FRICTION
from ..core.effects.gear_friction import GEAR_FRICTION, GearFriction
from ..core.effects.joint_spring import JOINT_SPRING, STIFFENING
from ..core.effects.stop import STOP
from ..core.effects.surface import SURFACE
from ..core.effects.tendon import BEND, DRIVE, Tendons
from ..core.effects.tendon import WORLD as ANCHOR
from ..core.effects.touch import DISC, Discs, Spheres
from ..core.step.context import Scene
from ..core.step.state import IN_STATE
from ..core.tree.forest import TREE
from ..model import Joint, Link, Loop, Model, Placement, Tendon
from ..model.placed import Placed, link_name
from ..model.servo import ONE_KIND
from .actuator import Actuator, passive
from .channels import Share, owned
from .fluid import joined_fluid, joined_propellers
from .friction import Friction
from .preflight import SPRING, Preflight
from .records import records
from .tendon import number_drives
from .tree import Tree

if TYPE_CHECKING:
    from .compile import CompiledScene

WORLD = "world"  # root of the joined model
NO_STOP = 1e300
UNSTOPPED: dict[str, float] = {"lower": -NO_STOP, "upper": NO_STOP, "stiffness": 1.0}


class Member(NamedTuple):
    """A robot or object of a scene.

    Attributes
    ----------
    placed : Placed
        The model, its name and its place.
    scene : CompiledScene
        The scene of it alone.
    """

    placed: Placed
    scene: CompiledScene

    @property
    def name(self) -> str:
        """Name in the scene."""
        return self.placed.name

    @property
    def model(self) -> Model:
        """The model."""
        return self.placed.model


def joined_model(members: Sequence[Member], name: str, between: Sequence[Loop] = ()) -> Model:
    """Return one model of all members, with their names before those of their links and joints.

    Its root is the world, on which all roots are fixed at their places: it names links, joints and servos, and knows no
    coordinates of bases.
    """
    links, joints = [Link(WORLD)], []
    parts: dict[str, list[Any]] = {"contacts": [], "shapes": [], "tendons": [], "loops": []}
    parts |= {"immersed": [], "propellers": []}
    servos: dict[str, Any] = {}
    locked: dict[str, float] = {}
    for member in members:
        model, placed = member.model, member.placed
        xyz = cast(Any, (*placed.position, 0.0)[:3])
        root, turned = named(member, model.root), rpy_from_rotation(rotation_from_quaternion(placed.orientation))
        joints.append(Joint(f"/{member.name}", "fixed", WORLD, root, xyz=xyz, rpy=turned))  # no joint is called so
        links += [replace(link, name=named(member, link.name)) for link in model.links]
        joints += [_renamed(member, joint) for joint in model.joints]
        parts["contacts"] += [replace(one, link=named(member, one.link)) for one in _touching(member)]
        parts["shapes"] += [replace(one, link=named(member, one.link)) for one in model.shapes]
        parts["immersed"] += [replace(one, link=named(member, one.link)) for one in model.immersed]
        parts["propellers"] += [replace(one, joint=named(member, one.joint)) for one in model.propellers]
        parts["tendons"] += [_tendon_of(member, one) for one in model.tendons]
        parts["loops"] += [_loop_of(member, one) for one in model.loops]
        servos |= {named(member, joint): servo for joint, servo in model.servos.items()}
        locked |= {named(member, joint): at for joint, at in model.locked.items()}
    supply = next((one.model.supply for one in members if one.scene.constants.supply is not None), None)
    parts["loops"] += between
    every: dict[str, Any] = {kind: tuple(found) for kind, found in parts.items()}
    return Model(name, tuple(links), tuple(joints), locked=locked, servos=servos, supply=supply, **every)  # fmt: skip


def named(member: Member, name: str) -> str:
    """Return the name of a link or joint in the scene."""
    return link_name(member.name, name)


def _renamed(member: Member, joint: Joint) -> Joint:
    mimic = joint.mimic and replace(joint.mimic, joint=named(member, joint.mimic.joint))
    name, parent, child = (named(member, one) for one in (joint.name, joint.parent, joint.child))
    return replace(joint, name=name, parent=parent, child=child, mimic=mimic)


def _tendon_of(member: Member, tendon: Tendon) -> Tendon:
    joints = tuple((named(member, name), c) for name, c in tendon.joints)
    path = tuple(replace(via, link=_link_of(member, via.link)) for via in tendon.path)
    return replace(tendon, name=named(member, tendon.name), joints=joints, path=path)


def _loop_of(member: Member, loop: Loop) -> Loop:
    b = None if loop.b is None and loop.a == member.model.root else _link_of(member, loop.b)
    return replace(loop, name=named(member, loop.name), a=named(member, loop.a), b=b)


def _link_of(member: Member, link: str | None) -> str | None:
    """Return a link with its name in the scene; what a fixed robot calls the world, None, is its root's frame."""
    if link is None and member.model.base == "fixed":
        link = member.model.root
    return link and named(member, link)


def _touching(member: Member) -> tuple[Any, ...]:
    return member.model.contacts if member.scene.constants.contact is not None else ()


def members_of(members: Sequence[Member], model: Model) -> list[Model]:
    """Return the models of the members with the numbers of another joined model of the same names."""
    found, links, joints = [], iter(model.links[1:]), iter(model.joints)
    for member in members:
        own = member.model
        next(joints)  # the one that fixes the root
        new_links = [replace(next(links), name=link.name) for link in own.links]
        new_joints = [
            replace(next(joints), name=one.name, parent=one.parent, child=one.child, mimic=one.mimic)
            for one in own.joints
        ]
        servos = {name: model.servos[named(member, name)] for name in own.servos}
        supply = model.supply if member.scene.constants.supply is not None else None
        found.append(own.with_numbers(links=new_links, joints=new_joints, servos=servos, supply=supply))
    return found


# ------------------------------------------------------------------------------------------------ the tables


class Shift(NamedTuple):
    """Where the rows of a member stand among those of all."""

    body: int  # of its first body
    own: int  # bodies of its own
    row: int  # added to workspace rows that are no bodies
    joint: int
    point: int
    coupling: int
    ball: int
    tendon: int
    loop: int
    loop_row: int  # row of its first loop
    drive: int  # of surfaces

    def workspace(self, rows: np.ndarray) -> np.ndarray:
        """Return where workspace rows after the bodies, such as slots, stand."""
        return rows - self.own + self.row


def shifts(scenes: Sequence[CompiledScene]) -> list[Shift]:
    """Return where each member's rows stand: the bodies of all, then slots, contact rows and tendons."""
    trees, found = [scene.tree for scene in scenes], []
    body, row, joint, point = 0, sum(len(tree.bodies) for tree in trees), 0, 0
    coupling, ball, tendon, loop, loop_row, drive = 0, 0, 0, 0, 0, 0
    for scene, tree in zip(scenes, trees):
        found.append(Shift(body, len(tree.bodies), row, joint, point, coupling, ball, tendon, loop, loop_row, drive))
        body += len(tree.bodies)
        row += tree.rows - len(tree.bodies)
        joint += tree.n
        point += count(scene.constants.contact and scene.constants.contact.points)
        coupling += count(tree.coupling)
        ball += count(tree.balls)
        tendon += tree.tendons
        loop += len(scene.model.loops)
        loop_row += sum(one.rows for one in scene.model.loops)
        drive += count(scene.constants.surfaces)
    return found


def count(table: Any) -> int:
    """Return the rows of a table, 0 of none."""
    return 0 if table is None else len(table)


def largest_tree(constants: Scene) -> int:
    """Return the bodies of the largest tree of a scene."""
    trees = constants.trees
    return len(constants.tree) if trees is None else int(np.max(trees.end - trees.root))


def joined_tree(members: Sequence[Member]) -> Tree:
    """Return the bodies of all members, one tree after the other."""
    places: dict[str, Placement] = {}
    scenes = [member.scene for member in members]
    bodies, couplings, names, balls = [], [], [], []
    trees, moved = records(len(members), TREE), shifts(scenes)
    for row, member, scene, at in zip(trees, members, scenes, moved):
        tree = scene.tree
        table = tree.bodies.copy()
        table.parent += at.body
        table.carrier += at.body
        table.ball += at.ball
        table.dof += at.joint
        table.slot = at.workspace(table.slot)
        table.contact = np.where(table.contact > 0, at.workspace(table.contact), 0)
        bodies.append(table)
        if tree.coupling is not None:
            coupling = tree.coupling.copy()
            coupling.body, coupling.leader = coupling.body + at.body, coupling.leader + at.body
            coupling.dof, coupling.leader_dof = coupling.dof + at.joint, coupling.leader_dof + at.joint
            couplings.append(coupling)
        if tree.balls is not None:
            balls.append(tree.balls + at.joint)
        names += [named(member, name) for name in tree.names]
        places |= {named(member, k): Placement(p.row + at.body, p.E, p.r) for k, p in tree.placements.items()}
        _fill_tree(row, scene, at)
    trees.number = np.arange(len(members))
    end = moved[-1].row + scenes[-1].tree.rows - len(scenes[-1].tree.bodies)
    joined = np.concatenate(bodies).view(np.recarray)
    first = np.concatenate(balls) if balls else None
    own = moved[-1].tendon + scenes[-1].tree.tendons
    return Tree(joined, True, tuple(names), places, end, _concatenated(couplings), trees, first, own)


def _fill_tree(row: Any, scene: CompiledScene, at: Shift) -> None:
    tree = scene.tree
    row.root, row.end, row.fixed = at.body, at.body + at.own, not tree.floating
    row.joint, row.end_joint = at.joint, at.joint + tree.n
    points = count(scene.constants.contact and scene.constants.contact.points)
    row.point, row.end_point = at.point, at.point + points
    row.coupling, row.end_coupling = at.coupling, at.coupling + count(tree.coupling)
    row.ball, row.end_ball = at.ball, at.ball + count(tree.balls)
    row.tendon, row.end_tendon = at.tendon, at.tendon + tree.tendons
    row.loop, row.end_loop = at.loop, at.loop + len(scene.model.loops)
    row.row = at.coupling + at.tendon + at.loop_row
    row.falls = tree.floating and tree.n > 0 and points > 0
    row.min_height, row.min_upright = max(scene.fall_height, -1e308), scene.fall_upright
    row.upright = scene.upright


def _concatenated(tables: Sequence[np.ndarray]) -> Any:
    return np.concatenate(tables).view(np.recarray) if tables else None


def joined_constants(members: Sequence[Member], tree: Tree) -> Scene:
    """Return the constants of all members in one; raise ValueError for kinds that cannot act in one scene."""
    scenes = [member.scene for member in members]
    all_of = [scene.constants for scene in scenes]
    joints, moved = [scene.tree.n for scene in scenes], shifts(scenes)

    contacts = sum(count(one.contact and one.contact.points) for one in all_of)

    def stack(name: str, dtype: Any, **neutral: float) -> Any:
        return _stacked([getattr(one, name) for one in all_of], joints, dtype, **neutral)

    return Scene(
        tree=tree.bodies,
        floating=True,
        gravity=all_of[0].gravity,
        actuator=_actuator(members),
        decay=_rows([one.decay for one in all_of], joints),
        armature=_rows([one.armature for one in all_of], joints),
        friction=_friction([one.friction for one in all_of], joints),
        stops=stack("stops", STOP, **UNSTOPPED),
        contact=_contact([one.contact for one in all_of], moved),
        push=None,
        coupling=tree.coupling,
        firmware=_firmware(members, joints),
        supply=_supply(members),
        joint_springs=stack("joint_springs", JOINT_SPRING),
        stiffening=stack("stiffening", STIFFENING),
        drag=stack("drag", DRAG),
        ball_springs=_rows([one.ball_springs for one in all_of], joints),
        lifts=_on_bodies([one.lifts for one in all_of], moved, ("body",)),
        trees=tree.trees,
        balls=tree.balls,
        tendons=_tendons(members, tree, moved),
        fluid=joined_fluid([one.fluid for one in all_of], moved, contacts),
        propellers=joined_propellers([one.propellers for one in all_of], moved, joints),
    )


def _stacked(tables: Sequence[Any], counts: Sequence[int], dtype: np.dtype, **neutral: float) -> Any:
    """Return the records of all members, neutral ones for members without; None if none has any."""
    if all(table is None for table in tables):
        return None
    parts = []
    for table, n in zip(tables, counts):
        if table is None:
            table = records(n, dtype)
            for name, value in neutral.items():
                table[name] = value
        parts.append(table)
    return _concatenated(parts)


def _rows(arrays: Sequence[np.ndarray | None], counts: Sequence[int], neutral: float = 0.0) -> np.ndarray | None:
    """Return the numbers of all members' joints; None if none has any."""
    given = [array for array in arrays if array is not None]
    if not given:
        return None
    shape = given[0].shape[1:]
    return np.concatenate([np.full((n, *shape), neutral) if a is None else a for a, n in zip(arrays, counts)])


def _actuator(members: Sequence[Member]) -> Actuator | None:
    """Return the servos of all members, of which all must be of one kind."""
    kinds: dict[type, str] = {}
    for member in members:
        if member.scene.constants.actuator is not None:
            kinds.setdefault(type(member.scene.constants.actuator), member.name)
    if not kinds:
        return None
    if len(kinds) > 1:
        each = ", ".join(f"{name!r} has {kind.__name__}" for kind, name in kinds.items())
        raise ValueError(
            f"scene: servos of several kinds do not act in one scene: {each}; give all robots gearbox='rotor', and "
            f"where laws differ {ONE_KIND}"
        )
    kind = next(iter(kinds))
    found = [(member.scene.constants.actuator, member.scene.tree.n) for member in members]
    parts = [passive(kind, n) if actuator is None else actuator for actuator, n in found]
    tables: list[Any] = []
    for field, columns in zip(kind._fields, zip(*parts)):  # type: ignore[attr-defined]
        if all(column is None for column in columns):
            tables.append(None)
        elif field == "wrap":
            tables.append(_rows(columns, [n for _, n in found]))
        else:
            tables.append(_concatenated(columns))
    return kind(*tables)


def _friction(frictions: Sequence[Friction | None], counts: Sequence[int]) -> Friction | None:
    """Return the friction of all members; where one's depends on load or speed, all are rows of that kind."""
    if any(isinstance(one, GearFriction) for one in frictions):
        tables = []
        for one, n in zip(frictions, counts):
            table = one.table if isinstance(one, GearFriction) else records(n, GEAR_FRICTION)
            if not isinstance(one, GearFriction):
                table.stribeck_speed = table.stribeck_exponent = table.steepness = 1.0
                if one is not None:
                    for name in one.dtype.names or ():
                        table[name] = one[name]
            tables.append(table)
        return GearFriction(_concatenated(tables))
    return _stacked(frictions, counts, FRICTION, steepness=1.0)


def _contact(contacts: Sequence[Contact | None], moved: Sequence[Shift]) -> Contact | None:
    """Return the contact points of all members, as points, spheres or discs."""
    given = [(one, at) for one, at in zip(contacts, moved) if one is not None]
    if not given:
        return None
    tables = []
    for one, at in given:
        table = one.points.copy()
        table.body += at.body
        tables.append(table)
    rollers = _stacked([one.rollers for one, _ in given], [len(one.points) for one, _ in given], ROLLER)
    neutral = {"friction": 0.0, "tangential_stiffness": 1.0, "tangential_damping": 1.0}
    rolling = _stacked([one.rolling for one, _ in given], [len(one.points) for one, _ in given], ROLLING, **neutral)
    first = given[0][0]
    return Contact(
        _concatenated(tables), first.ground, _geometry([one for one, _ in given]), first.motion, rollers,
        _surfaces(given), rolling,
    )  # fmt: skip


def _surfaces(given: Sequence[tuple[Contact, Shift]]) -> Any:
    """Return the surfaces of all members' links at their contact points."""
    tables = [(one.surfaces, at) for one, at in given]
    found = _stacked([one for one, _ in tables], [len(one.points) for one, _ in given], SURFACE, drive=-1)
    if found is not None:
        first = np.repeat([at.drive for _, at in given], [len(one.points) for one, _ in given])
        found.drive += np.where(found.drive >= 0, first, 0)
    return found


def _geometry(contacts: Sequence[Contact]) -> Any:
    kinds = {type(one.contact_geometry) for one in contacts}
    if kinds == {type(None)}:
        return None
    if Discs not in kinds:
        radii = [getattr(one.contact_geometry, "radius", np.zeros(len(one.points))) for one in contacts]
        return Spheres(np.concatenate(radii))
    tables = []
    for one in contacts:
        table = records(len(one.points), DISC)
        if isinstance(one.contact_geometry, Discs):
            table = one.contact_geometry.disc
        else:
            table.axis = (0.0, 0.0, 1.0)
            table.radius = getattr(one.contact_geometry, "radius", 0.0)
        tables.append(table)
    return Discs(_concatenated(tables))


def _on_bodies(tables: Sequence[Any], moved: Sequence[Shift], rows: Iterable[str]) -> Any:
    """Return forces on bodies of all members; rows: fields that name bodies."""
    found = []
    for table, at in zip(tables, moved):
        if table is not None:
            own = table.copy()
            for name in rows:
                own[name] += at.body
            found.append(own)
    return _concatenated(found)


def _tendons(members: Sequence[Member], tree: Tree, moved: Sequence[Shift]) -> Tendons | None:
    """Return the tendons of all members."""
    tables, parts, wraps, first, bends = [], [], [], 0, 0
    found = [one.scene.constants.tendons for one in members]
    for own, at in zip(found, moved):
        if own is not None:
            table, pieces = own.table.copy(), own.parts.copy()
            table.row = at.workspace(table.row)
            table.first, table.end = table.first + first, table.end + first
            pieces.body = np.where(pieces.body == ANCHOR, ANCHOR, pieces.body + at.body)
            pieces.dof += np.where(pieces.kind == BEND, bends, at.joint)
            if own.wraps is not None:
                wraps.append(own.wraps)
                bends += len(own.wraps)
            tables.append(table)
            parts.append(pieces)
            first += len(pieces)
    if not tables:
        return None
    counts = [count(one and one.table) for one in found]
    stops = _stacked([one and one.stops for one in found], counts, STOP, **UNSTOPPED)
    drives = _stacked([one and one.drives for one in found], counts, DRIVE, input=-1)
    if drives is not None:
        number_drives(drives, drives.input >= 0, tree.n)
    tied = None
    if any(one is not None and one.tied is not None for one in found):
        each = [None if one is None else one.tied for one in found]
        tied = np.concatenate([np.zeros(n, int) if one is None else one for n, one in zip(counts, each)])
    around = _concatenated(wraps) if wraps else None
    rubs = _stacked([one and one.friction for one in found], counts, FRICTION)
    armature = _rows([one and one.armature for one in found], counts)
    return Tendons(_concatenated(tables), _concatenated(parts), stops, drives, around, tied, rubs, armature)


def _firmware(members: Sequence[Member], counts: Sequence[int]) -> Firmware:
    """Return the firmware of all servos; raise ValueError where delays differ."""
    all_of = [member.scene.constants.firmware for member in members]
    driven = [k for k, member in enumerate(members) if member.scene.constants.actuator is not None]
    delays = {all_of[k].delay for k in driven}
    if len(delays) > 1:
        names = ", ".join(members[k].name for k in driven)
        raise ValueError(f"scene: the controllers of {names} differ in delay: give them the same")
    return Firmware(
        band=_stacked([one.band for one in all_of], counts, BAND),
        pwm=_stacked([one.pwm for one in all_of], counts, PWM),
        profile=_rows([one.profile for one in all_of], counts, math.inf),
        delay=delays.pop() if delays else None,
        wrap=_rows([one.wrap for one in all_of], counts),
    )


def _supply(members: Sequence[Member]) -> Any:
    """Return the supply that feeds all servos; raise ValueError where others have servos too."""
    fed = [member for member in members if member.scene.constants.supply is not None]
    if not fed:
        return None
    driven = [member.name for member in members if member.scene.constants.actuator is not None]
    if len(driven) > 1:
        raise ValueError(
            f"scene: {fed[0].name!r} has a supply of its own, and {', '.join(driven)} have servos; one supply "
            "feeds all servos of a scene: leave it out of the models, dataclasses.replace(model, supply=None)"
        )
    return fed[0].scene.constants.supply


def joined_preflight(members: Sequence[Member], first: Preflight, loads: np.ndarray | None) -> Preflight:
    """Return the limits of all members; first: that of the member which decides integrator and step.

    loads (members,): mass that the ground bears under each, by its own; None: their own alone.
    """
    checks, loads = [member.scene.preflight for member in members], np.ones(len(members)) if loads is None else loads
    limits = [
        limit._replace(joint=named(member, limit.joint), step=limit.step / (root if limit.cause == SPRING else 1.0))
        for member, check, root in zip(members, checks, np.sqrt(loads).tolist())
        for limit in check.limits
    ]
    names = [name for name in Preflight._fields if name.endswith("_step")]
    on_ground = min((limit.step for limit in limits if limit.cause == SPRING), default=math.inf)
    steps: dict[str, Any] = {name: min(on_ground, *(getattr(check, name) for check in checks)) for name in names}
    inertias = tuple(inertia for check in checks for inertia in check.inertias)
    return first._replace(limits=tuple(limits), inertias=inertias, **steps)


def shares(members: Sequence[Member]) -> dict[str, Share]:
    """Return which numbers of the channels are each member's, by name."""
    found: dict[str, Share] = {}
    at_q, row, immersed, positions = 0, 0, 0, sum(len(member.model.position_names) for member in members)
    joints = sum(member.scene.tree.n for member in members)
    for k, (member, at) in enumerate(zip(members, shifts([member.scene for member in members]))):
        points = count(member.scene.constants.contact and member.scene.constants.contact.points)
        shapes = count(member.scene.constants.fluid and member.scene.constants.fluid.table)
        found[member.name] = {
            "base": k, "fixed": not member.scene.tree.floating, "joints": [at.joint, at.joint + member.scene.tree.n],
            "points": [at.point, at.point + points], "of_joints": joints,
            "tendons": [at.tendon, at.tendon + member.scene.tree.tendons],
            "immersed": [immersed, immersed + shapes],
            "surfaces": [at.drive, at.drive + count(member.scene.constants.surfaces)],
        }  # fmt: skip
        immersed = found[member.name]["immersed"][1]
        if member.model.loops:
            rows = sum(loop.rows for loop in member.model.loops)
            found[member.name] |= {"loops": [at.loop, at.loop + len(member.model.loops)], "rows": [row, row + rows]}
            row += rows
        if positions > joints:
            own = len(member.model.position_names)
            balls = [at.ball, at.ball + count(member.scene.tree.balls)]
            found[member.name] |= {"balls": balls, "positions": [at_q, at_q + own], "of_positions": positions}
            at_q += own
    return found


def state_index(scene: CompiledScene, member: Member) -> np.ndarray:
    """Return where each number of the state of one member alone stands in that of the scene.

    Bases that the member alone has no coordinates for are left out.
    """
    alone, share = member.scene, scene.shares[member.name]
    index = np.zeros(alone.layout["length"], np.int64)
    for channel in IN_STATE:
        (start, end), (first, past) = alone.part(channel.name), scene.part(channel.name)
        if end > start:
            index[start:end] = first + owned(channel, share, past - first)
    return index
