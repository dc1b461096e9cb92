"""Read all trees, the shapes that never move, and the ground of an MJCF file.

Each body of the world begins a tree.  If the names of its bodies and joints all begin with "NAME/", as `save_scene` and
dm_control write them, NAME is its name and they are called by what follows; else it has the name of its first body.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from ...base.fixed_order import applied, product
from ...base.flaws import quoted
from ...base.rotation import rotation_from_quaternion, rpy_from_rotation
from ...geometry.contact_choice import thinned
from ...model import Controller, Fluid, Ground, Joint, Loop, Servo, Surface
from ...model.ground import HeightField
from ...model.pair_contact import GROUND, NONE, PairContact, PairWord
from ...model.pair_friction import PairFriction
from ...model.placed import SEPARATOR, link_name
from ...model.sensor import Sensor
from ...model.shapes import Box, Shape
from ..report import Report
from ..robot import Robot
from ..settings import Settings
from .actuators import read_actuators
from .causes import doubts, gravity_of, idle, notes, refusals
from .equalities import Line, couplings
from .fluids import fluid_of, read_immersed
from .frictions import (
    Numbers,
    friction_doubts,
    friction_of,
    friction_on_floor,
    own_frictions,
    pair_frictions,
    slack_notes,
    spinning_doubts,
)
from .loops import equality_names, joining_loops, read_loops
from .read import compiled, held_by, name_of, postures_of
from .sensors import read_sensors, unseen
from .sizes import documents_of
from .stated import Stated, as_stated
from .tendons import read_tendons, taken
from .touching import as_names, collisions, neighbors_that_touch, paired_geoms
from .tree import (
    FLOOR,
    FRICTIONS,
    GEOMS,
    HFIELD,
    MESH,
    PAIRS,
    PLANE,
    Tree,
    geometry_of,
    height_field,
    moving_trees,
    names_of,
    rounded,
    surface_of,
    top_bodies,
    tree_at,
    unused,
    vector,
)

NO_CONTACT = 1 << 4  # mjtDisableBit, of <flag>
ONE_CONTACT = 1 << 0  # mjtEnableBit
OBSTACLE = "body"  # the one link of an obstacle
WALL = 10.0  # thickness and half the width of a plane that is an obstacle [m]
STEEP = 1e-6  # cosine of the tilt of a plane that is a wall


class Part(NamedTuple):
    """A tree, or what never moves, at its place."""

    robot: Robot
    position: tuple[float, float, float]
    orientation: tuple[float, ...]  # quaternion w x y z
    touching: tuple[Shape, ...]  # of its shapes, those that touch the ground, with their friction there


class Content(NamedTuple):
    """The content of a file."""

    name: str
    members: list[Part]
    obstacles: list[Part]
    ground: Ground | None
    gravity: tuple[float, float, float]
    excluded: list[tuple[str, str]]  # links and shapes of the scene that do not touch each other
    pairs: PairWord | tuple[tuple[str, str], ...] | PairContact  # what does, if `save_scene` has written it
    loops: tuple[Loop, ...]  # between members
    fluid: Fluid | None
    frictions: tuple[PairFriction, ...]
    sensors: tuple[Sensor, ...]  # that stand in the world
    stated: dict[str, Any]  # table of the <text> of the scene


class Solids(NamedTuple):
    """The geoms that touch something."""

    shapes: dict[int, Shape]  # by geom, in the frame of its body, without a link
    friction: dict[int, tuple[float | None, float | None]]  # sliding, rolling on the ground; None is the ground's
    rows: list[int]  # in this order, of the geoms of trees that move
    collide: np.ndarray  # (rows, n) which they touch

    def by_tree(self, m: Any) -> dict[int, list[int]]:
        """Return the geoms of each tree, by the body of the world with which it begins; 0 for the world's own."""
        found: dict[int, list[int]] = {}
        for g in self.shapes:
            found.setdefault(int(m.body_rootid[m.geom_bodyid[g]]), []).append(g)
        return found


def _nothing_moves(m: Any) -> str:
    still = f"its {m.ngeom} geoms are ground and obstacles alone" if m.ngeom else "it is empty"
    remedy = 'add what moves among them: <body><freejoint/><geom size="0.1"/></body>, or a <joint> to a body'
    return f"nothing in the file can move, {still}; a scene has one member or more: {remedy}"


@np.errstate(all="ignore")  # Link, Joint and the like refuse what is not finite
def read_scene(path: Path, report: Report) -> Content:
    """Read all trees of an MJCF file.

    What is ignored goes into the report.  Raises as `read_mjcf`.
    """
    documents = documents_of(path)
    m, remarks = compiled(path, documents)
    bodies, joints, mimics = names_of(m, "body", m.nbody), names_of(m, "joint", m.njnt), couplings(m)
    everything = Tree((), (), "fixed", 0, (), bodies, joints, several=True)
    moving = {*moving_trees(m)}
    for problem in (*refusals(m, everything), *_between_trees(m, mimics, joints)):
        report.refuse(None, problem)
    if not moving:
        report.refuse(None, _nothing_moves(m))
    for sentence in (*doubts(m, everything), *_switched_off(m)):
        report.doubt(sentence)
    report.raise_problems(path)
    texts = Stated(path, documents.values(), members=True, alone=len(moving) == 1)
    written = any(text.get("name") == FRICTIONS for root in documents.values() for text in root.iter("text"))
    floor = _floor(m, report, written)
    ground = None if floor is None else _ground(m, floor, report)
    if floor is not None and ground is not None and ground.field is not None:
        _note_edge(m, floor, ground.field, [bodies[top] for top in moving if _is_beyond(m, top, ground.field)], report)
    stated = any("friction" in pair.attrib for root in documents.values() for pair in root.iter("pair"))
    pairs, unranked = _pairs(documents.values()), own_frictions(documents.values())
    prefixes = _prefixes(m)
    solids = _solids(m, floor, stated, unranked, report, prefixes, texts.points())
    owners: dict[int, str] = {}  # link in the scene of each geom
    members, obstacles, taken, trees = [], [], set[str](), dict[int, tuple[str, Tree]]()
    geoms_of = solids.by_tree(m)
    for top in top_bodies(m):
        geoms = geoms_of.get(top, [])
        name = unused(prefixes.get(top, bodies[top].replace(SEPARATOR, "_")), taken)
        if top in moving:
            tree = _tree(m, top, prefixes.get(top, ""), bodies, joints, mimics)
            members.append(_member(m, tree, top, name, geoms, solids, report, prefixes.get(top, ""), texts))
            trees[top] = name, tree
            owners.update({g: link_name(name, tree.bodies[m.geom_bodyid[g]]) for g in geoms})
        elif geoms:
            obstacles.append(_obstacle(m, top, name, geoms, solids, texts, report))
            owners.update(dict.fromkeys(geoms, link_name(name, OBSTACLE)))
        else:
            continue
        taken.add(name)
    used = {*taken, *bodies}
    for g in (g for g in solids.shapes if m.geom_bodyid[g] == 0):
        name = unused((m.geom(g).name or f"geom{g}").replace(SEPARATOR, "_"), used)
        obstacles.append(_obstacle(m, 0, name, [g], solids, texts, report))
        used.add(name)
        owners[g] = link_name(name, OBSTACLE)
    sensors, said = read_sensors(m, lambda b: None)
    for sentence in unseen(m, solids.shapes, floor):
        report.doubt(sentence)
    for sentence in (*notes(m, everything), *said, *remarks, *idle(documents.values())):
        report.remark(sentence)
    if solids.collide.any() and pairs == NONE:
        report.remark('bodies touch the ground alone, unless compile_scene is given pairs="all"')
    obstructing = [link_name(part.robot.name, OBSTACLE) for part in obstacles]
    excluded = _excluded(solids, owners, obstructing)
    loops = joining_loops(m, trees, equality_names(m))
    return Content(
        name_of(m, path), members, obstacles, ground, gravity_of(m), excluded, pairs, loops, fluid_of(m),
        _frictions(m, solids, owners, floor, written, report), tuple(sensors), texts.table(),
    )  # fmt: skip


def _frictions(
    m: Any, solids: Solids, owners: Mapping[int, str], floor: int | None, written: bool, report: Report
) -> tuple[PairFriction, ...]:
    """Return the frictions of two shapes that do not follow from theirs; report what of their contact is not read."""
    touched = {*np.flatnonzero(np.any(solids.collide, axis=0)).tolist()}
    bodies = [g for k, g in enumerate(solids.shapes) if k in touched]
    low = [*solids.friction, *([] if floor is None else [floor])]
    for sentence in friction_doubts(m, [*bodies, *low]):
        report.doubt(sentence)
    if not written:  # what this package has written, it has read
        for sentence in spinning_doubts(m, solids.friction, floor):
            report.doubt(sentence)
    for sentence in slack_notes(m, [*bodies, *low]):
        report.remark(sentence)
    names = {g: link_name(owners[g], shape.name) for g, shape in solids.shapes.items()}
    return tuple(pair_frictions(m, solids.shapes, solids.rows, solids.collide, names))


def _pairs(documents: Iterable[Element]) -> PairWord | tuple[tuple[str, str], ...] | PairContact:
    """Return what `save_scene` has written about bodies that touch each other, else "none"."""
    for text in (each for root in documents for each in root.iter("text") if each.get("name") == PAIRS):
        try:
            stated = json.loads(text.get("data", ""))
            found = PairContact(**stated)
        except (TypeError, ValueError) as error:
            raise ValueError(f"<text name={PAIRS!r}> states no PairContact: {error}; remove it") from error
        return found.select if [*stated] == ["select"] else found
    return NONE


def _between_trees(m: Any, mimics: Mapping[int, Line], names: list[str]) -> Iterator[str]:
    """Yield why equalities of joints of two trees are refused."""
    root = m.body_rootid[m.jnt_bodyid]
    for j, line in mimics.items():
        if root[j] != root[line.leader]:
            yield (
                f"joint {names[j]!r} follows joint {names[line.leader]!r} of another tree; a joint can follow one of "
                "its own tree: remove the equality, or set active='false'"
            )


def _switched_off(m: Any) -> Iterator[str]:
    if m.opt.enableflags & ONE_CONTACT:
        yield "ignored the <flag> that overrides the numbers of all contacts: they keep those of geoms and pairs"
    if m.opt.disableflags & NO_CONTACT:
        yield "ignored the <flag> that switches off contacts: they stay active"
    mocap = [m.body(b).name or str(b) for b in range(m.nbody) if m.body_mocapid[b] >= 0]
    if mocap:
        yield f"mocap bodies {quoted(mocap)} stand still where the file puts them: nothing drives them"


# ---------------------------------------------------------------------------------------------- trees


def _prefixes(m: Any) -> dict[int, str]:
    """Return the NAME of each tree whose names all begin with NAME/, if no other tree has it."""
    starts: dict[int, set[str]] = {top: set() for top in top_bodies(m)}
    named = [(b, m.body(b).name) for b in range(1, m.nbody)]
    named += [(b, m.joint(j).name) for j, b in enumerate(m.jnt_bodyid.tolist())]
    for b, name in named:
        if name:
            starts[int(m.body_rootid[b])].add(name.partition(SEPARATOR)[0] if SEPARATOR in name else "")
    found = {top: one.pop() for top, one in starts.items() if len(one) == 1}
    times = Counter(found.values())
    return {top: name for top, name in found.items() if name and times[name] == 1}


def _tree(m: Any, top: int, prefix: str, bodies: list[str], joints: list[str], mimics: dict[int, Line]) -> Tree:
    """Read a tree, whose names are given without its prefix."""
    start = f"{prefix}{SEPARATOR}"
    if prefix:
        bodies, joints = [*bodies], [*joints]
        for names, own in ((bodies, m.body_rootid == top), (joints, m.body_rootid[m.jnt_bodyid] == top)):
            for k in np.flatnonzero(own).tolist():
                names[k] = names[k].removeprefix(start)
        for kind, names in (("body", bodies), ("joint", joints)):
            for k in (k for k, name in enumerate(names) if not name):
                names[k] = unused(f"{kind}{k}", names)
    return tree_at(m, top, bodies, joints, mimics)


def _member(
    m: Any, tree: Tree, top: int, name: str, own: list[int], solids: Solids, report: Report, prefix: str, texts: Stated
) -> Part:
    """Read a tree; own: its geoms."""
    joints: tuple[Joint, ...] = tree.joints
    servos, drives, stated = dict[str, Servo](), dict[int, Controller](), Settings()
    with report.blaming():
        stated = texts.of(name, tree.links, tree.joints, report)
        actuators = read_actuators(m, tree, tree.joints, taken(m, tree), stated.servos)
        joints, servos, drives = actuators.joints, actuators.servos, actuators.drives
        for sentence in actuators.doubts:
            report.doubt(sentence)
        for sentence in actuators.remarks:
            report.remark(sentence)
    found = (replace(solids.shapes[g], link=tree.bodies[m.geom_bodyid[g]]) for g in own)
    shapes = dict(zip(own, as_stated(found, stated.shapes)))
    near, columns = neighbors_that_touch(m, own), np.array([k for k, g in enumerate(solids.shapes) if g in shapes], int)
    meeting = solids.collide[np.ix_(np.searchsorted(solids.rows, columns), columns)]
    links = [shape.link for shape in shapes.values()]
    shaped = [f"{shape.link}/{shape.name}" for shape in shapes.values()]
    sensors, said = read_sensors(
        m, lambda b: tree.bodies[b] if b and m.body_rootid[b] == top else None, f"{prefix}{SEPARATOR}", world=False
    )
    for sentence in said:
        report.remark(sentence)
    loops = read_loops(m, tree, [x.removeprefix(f"{prefix}{SEPARATOR}") for x in equality_names(m)], top)
    robot = Robot(
        name, tree.links, joints, tuple(shapes.values()), tree.base, held_by(m, tree), servos, postures_of(m, tree),
        loops=loops, tendons=read_tendons(m, tree, drives, top, f"{prefix}{SEPARATOR}"),
        immersed=read_immersed(m, tree, top), sensors=tuple(sensors),
        included=tuple(as_names(links, shaped, [*range(len(own))], near & meeting)),
        stated=stated._replace(shapes={}),
    )  # fmt: skip
    touching = tuple(_on_ground(shape, *solids.friction[g]) for g, shape in shapes.items() if g in solids.friction)
    return Part(robot, vector(m.body_pos[top]), tuple(m.body_quat[top].tolist()), touching)


def _obstacle(m: Any, top: int, name: str, geoms: list[int], solids: Solids, texts: Stated, report: Report) -> Part:
    """Gather shapes that never move in the frame of a body of the world, or in that of a single geom of the world."""
    shapes = []
    for g in geoms:
        shape, b = solids.shapes[g], int(m.geom_bodyid[g])
        E, r = rotation_from_quaternion(m.geom_quat[g]), m.geom_pos[g]
        while b not in (top, 0):
            turn = rotation_from_quaternion(m.body_quat[b])
            E, r, b = product(turn, E), m.body_pos[b] + applied(turn, r), int(m.body_parentid[b])
        r, E = (r, E) if top else (np.zeros(3), np.eye(3))
        r = r - 0.5 * WALL * E[:, 2] if m.geom_type[g] == PLANE else r
        surface = shape.surface and _in_frame(m, g, shape.surface, E, r)
        shapes.append(replace(shape, link=OBSTACLE, xyz=vector(r), rpy=rpy_from_rotation(E), surface=surface))
    position, quaternion = (m.body_pos[top], m.body_quat[top]) if top else (m.geom_pos[geoms[0]], m.geom_quat[geoms[0]])
    robot = Robot(name, (), (), as_stated(shapes, texts.of(name, (), (), report).shapes), "fixed")
    return Part(robot, vector(position), tuple(quaternion.tolist()), ())


def _in_frame(m: Any, g: int, surface: Surface, E: np.ndarray, r: np.ndarray) -> Surface:
    """Return a geom's surface, of the frame of its body, in that in which the geom has the rotation E and place r."""
    turn = product(E, rotation_from_quaternion(m.geom_quat[g]).T)
    velocity, turning = (vector(applied(turn, np.array(x))) for x in (surface.velocity, surface.turning))
    return replace(surface, velocity=velocity, turning=turning, center=vector(r))


# ---------------------------------------------------------------------------------------------- shapes


def _on_ground(shape: Shape, friction: float | None, rolling: float | None) -> Shape:
    return replace(shape, friction=friction, rolling_friction=rolling)


def _solids(
    m: Any, floor: int | None, stated: bool, own: Mapping[str, Numbers], report: Report, prefixes: Mapping[int, str],
    points: set[str],
) -> Solids:  # fmt: skip
    """Find the geoms that touch something, which touch the ground, and which each other.

    stated: whether the file states a friction of a <pair>; own: the friction that `save_scene` has written; prefixes:
    of names, by the body of the world; points: geoms that stand for contact points.
    """
    paired = paired_geoms(m)
    alone = {g for pair in paired for g in pair}
    names = names_of(m, "geom", m.ngeom)
    shapes: dict[int, Shape] = {}
    left: dict[str, list[str]] = {}
    walls: list[str] = []
    for g in range(m.ngeom):
        if g == floor or names[g] in points or not (m.geom_contype[g] or m.geom_conaffinity[g] or g in alone):
            continue
        geometry, at = geometry_of(m, g), m.geom_pos[g]
        if m.geom_type[g] == PLANE:
            walls.append(names[g])
            geometry = Box((2.0 * WALL, 2.0 * WALL, WALL))
            at = at - 0.5 * WALL * rotation_from_quaternion(m.geom_quat[g])[:, 2]
        if geometry is None:
            left.setdefault(GEOMS[m.geom_type[g]], []).append(names[g])
            continue
        rpy = rpy_from_rotation(rotation_from_quaternion(m.geom_quat[g]))
        numbers, priority = friction_of(m, g, own)
        surface = surface_of(m, g, names[g])
        name = names[g].removeprefix(f"{prefixes.get(int(m.body_rootid[m.geom_bodyid[g]]), '')}{SEPARATOR}")
        shapes[g] = Shape(OBSTACLE, geometry, vector(at), rpy, name, *numbers, surface, priority)
    meshes = (replace(shape, name=names[g]) for g, shape in shapes.items() if m.geom_type[g] == MESH)
    for sentence in (*rounded(m, shapes, names), *thinned(meshes)):
        report.doubt(sentence)
    if walls:
        report.doubt(
            f"took planes {quoted(walls)}, which are not the ground, as boxes of {2 * WALL:g} x {2 * WALL:g} x "
            f"{WALL:g} m behind them, since a scene has one plane: write boxes of the size that is needed"
        )
    for kind, geoms in left.items():
        report.doubt(f"ignored geoms {quoted(geoms)} of type {kind}, which no shape is")
    moving = [g for g in shapes if m.body_weldid[m.geom_bodyid[g]]]
    friction = {g: mu for g in moving for mu in friction_on_floor(m, g, floor, stated)}
    trees = {*moving_trees(m)}
    rows = [k for k, g in enumerate(shapes) if int(m.body_rootid[m.geom_bodyid[g]]) in trees]
    return Solids(shapes, friction, rows, collisions(m, [*shapes], rows, paired))


def _excluded(solids: Solids, owners: Mapping[int, str], still: list[str]) -> list[tuple[str, str]]:
    """Return what never touches, links or shapes, without pairs of two obstacles, and links that touch no ground."""
    shaped = [link_name(owners[g], shape.name) for g, shape in solids.shapes.items()]
    links = [owners[g] for g in solids.shapes]
    at_rest = np.array([link in still for link in links], bool)
    apart = as_names(links, shaped, solids.rows, ~(solids.collide | (at_rest[solids.rows, None] & at_rest)))
    without = {*still, *(owners[g] for g in solids.friction)}
    high = [link for link in dict.fromkeys(links) if link not in without]
    return [*apart, *((link, GROUND) for link in high)]


# ---------------------------------------------------------------------------------------------- ground


def _floor(m: Any, report: Report, own: bool) -> int | None:
    """Return the geom that is the ground: the first plane that is no wall, or level height field, that never moves.

    own: whether `save_scene` has written the file, which calls the ground by its name.
    """
    planes = [g for g in range(m.ngeom) if m.geom_type[g] in (PLANE, HFIELD) and not m.body_weldid[m.geom_bodyid[g]]]
    touched = [g for g in planes if m.geom_contype[g] or m.geom_conaffinity[g] or g in {*m.pair_geom1, *m.pair_geom2}]
    good = []
    for g in touched:
        if own and m.geom(g).name != FLOOR:
            continue
        E, _ = _in_world(m, g)
        good += [g] if E[2, 2] > STEEP and (m.geom_type[g] == PLANE or np.array_equal(E, np.eye(3))) else []
    if good and not gravity_of(m)[2] < 0:
        report.doubt(
            f"left out the ground: gravity {gravity_of(m)} m/s^2 presses nothing on it; touching is not simulated"
        )
        return None
    return good[0] if good else None


def _in_world(m: Any, g: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute rotation (3, 3) and place (3,) [m] of a geom that never moves in the world."""
    E, r, b = rotation_from_quaternion(m.geom_quat[g]), m.geom_pos[g], int(m.geom_bodyid[g])
    while b:
        turn = rotation_from_quaternion(m.body_quat[b])
        E, r, b = product(turn, E), m.body_pos[b] + applied(turn, r), int(m.body_parentid[b])
    return E, r


def _is_beyond(m: Any, top: int, field: HeightField) -> bool:
    """Return whether a body of the world starts beyond the edge of a height field."""
    spans = ((n - 1) * d for n, d in zip(field.heights.shape, field.spacing))
    return any(not 0.0 <= float(x) - low <= span for x, low, span in zip(m.body_pos[top], field.origin, spans))


def _note_edge(m: Any, g: int, field: HeightField, beyond: list[str], report: Report) -> None:
    """Report that the ground goes on beyond the edge of a height field; it is a doubt if bodies start there."""
    (x, y), (a, b) = field.origin, ((n - 1) * d for n, d in zip(field.heights.shape, field.spacing))
    text = (
        f"height field {m.geom(g).name or f'geom{g}'!r} is the ground, which goes on level beyond its edge "
        f"(x {x:.6g} to {x + a:.6g} m, y {y:.6g} to {y + b:.6g} m), where MuJoCo has nothing"
    )
    if beyond:
        report.doubt(f"{text}; bodies {quoted(beyond)} start there: place them within it, or make it larger")
    else:
        report.remark(text)


def _ground(m: Any, g: int, report: Report) -> Ground:
    """Return the ground that a plane or height field is; how it gives way is that of `Ground`, not of the file."""
    (E, r), friction = _in_world(m, g), float(m.geom_friction[g, 0])
    if m.geom_type[g] == HFIELD:
        field = height_field(m, int(m.geom_dataid[g]))
        x, y = field.origin
        field = replace(field, origin=(float(r[0]) + x, float(r[1]) + y))
        if getattr(m, "geom_surfacevel", np.zeros((g + 1, 6)))[g].any():
            report.doubt(f"ignored surfacevel of height field {m.geom(g).name or f'geom{g}'!r}, the ground: it rests")
        return Ground(friction, height=float(r[2]), field=field)
    x, y, z = E[:, 2].tolist()  # the normal
    height = (x * float(r[0]) + y * float(r[1]) + z * float(r[2])) / z
    slope = math.atan2(math.hypot(x, y), z)
    heading = math.atan2(-y, -x) if slope else 0.0
    stated = getattr(m, "geom_surfacevel", np.zeros((g + 1, 6)))[g]
    v, turning = applied(E, stated[:3]), float(stated[5])
    ahead, across = (math.cos(heading), math.sin(heading)), (-math.sin(heading), math.cos(heading))
    along = z * (ahead[0] * float(v[0]) + ahead[1] * float(v[1])) + math.sin(slope) * float(v[2])
    aside, center = across[0] * float(v[0]) + across[1] * float(v[1]), (float(r[0]), float(r[1]))
    moving: dict[str, Any] = {}
    if stated.any():
        moving = {"velocity": (along, aside), "turning": turning, "center": center}
    return Ground(friction, height=height, slope=slope, heading=heading, **moving)
