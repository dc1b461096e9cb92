"""Write a scene of several models as one MJCF file.

Each model is written by itself, its names get "NAME/" in front, and it is put at its place.  Contact bits: the ground
has affinity 1; shapes have type and affinity 2, and type 1 too if they touch the ground; contact points have type 1.
Shapes of bodies that touch partly have type 4, 8, ... instead of 2, and the affinity of what they touch.
"""

from __future__ import annotations

import functools
import json
import math
import operator
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, fields, replace
from itertools import combinations
from typing import Any, NamedTuple
from xml.etree.ElementTree import Comment, Element, SubElement, TreeBuilder, XMLParser, fromstring, indent, tostring

import numpy as np

from ...base.fixed_order import applied
from ...base.rotation import rotation_from_quaternion
from ...dynamics import forward_kinematics
from ...geometry.contact_choice import contact_points, lowest_levels
from ...geometry.distance import mark, named_shapes, neighbors, rows_by_name
from ...model import ContactPoint, Ground, Loop, Model, rigid_bodies
from ...model.numpy_dynamics import zero_position
from ...model.pair_contact import GROUND, PairContact, pair_contact
from ...model.pair_friction import Frictions, shape_names
from ...model.placed import OF_SCENE, SEPARATOR, Placed, SceneModel, link_name
from ...model.rest_posture import START, nearest_posture, standing_keyframe
from ...model.shapes import Shape
from ..write_toml import sensor_lines as carried_sensors
from ..write_toml import table_lines
from .fluids import is_mujocos
from .loops import loop_lines, rod_lines, site_lines
from .sensors import lost_of_sensors, measures, sensor_lines, sensor_site_lines
from .stated import OF_SCENE as STATED_OF_SCENE
from .stated import STATED
from .tree import FRICTIONS, PAIRS, WORLD, unused
from .write import mjcf_text
from .write_frictions import Geom, contact_of, friction_pairs, geoms_of, unranked, write_friction
from .write_geoms import FLOOR, field_lines, floor_lines, pair_lines

# Attributes with a name of the model's:
REFERENCES = (
    "name", "joint", "joint1", "joint2", "mesh", "hfield", "geom1", "geom2", "body1", "body2", "site", "site1", "site2",
    "tendon", "tendon1", "geom", "sidesite",
)  # fmt: skip
SECTIONS = ("asset", "worldbody", "tendon", "equality", "contact", "actuator", "sensor")
GIVING = ("penetration", "damping_ratio", "steps", "lines")  # of a Ground, what its geom does not state
KINDS = 30  # of shapes, each with a bit of its own
BITS = {True: ("3", "2"), False: ("2", "2")}  # contype and conaffinity of shapes that touch the ground and do not


class Written(NamedTuple):
    """A model as it is written."""

    model: Model  # its shapes all named; its contact points are those that no shape has
    root: Element  # of the file of this model alone
    touching: tuple[Shape, ...]  # the shapes that touch the ground, with their friction there
    body: Element  # the first body, at its place
    lost: list[str]  # what the file lacks
    beside: list[Element]  # what a floating model has in the world: ends of tendons and loops


def scene_text(scene: SceneModel) -> tuple[str, list[str]]:
    """Write the scene, and return what the file lacks; raise ValueError for a model that MJCF cannot state."""
    root, sections = Element("mujoco", model=scene.name), {tag: Element(tag) for tag in SECTIONS}
    fluid = scene.fluid is not None and scene.fluid.level is None and all(is_mujocos(at.model) for at in scene.members)
    parts = [_written(placed, scene, _on_ground(placed, scene), fluid) for placed in scene.all]
    for placed, part in zip(scene.all, parts):
        root.extend(_comments(placed.name, part.root))
    lost = [f"{placed.name}: {one}" for placed, part in zip(scene.all, parts) for one in part.lost]
    of_scene = _lost(scene, fluid)
    root.extend(Comment(f" {one} ") for one in of_scene)
    SubElement(root, "compiler", angle="radian", eulerseq="XYZ", autolimits="true")
    SubElement(root, "option", _options(scene, fluid))
    if scene.ground is not None:
        steps = _ground(scene, scene.ground, sections)
        root.extend(Comment(f" {one} ") for one in steps)
        lost += steps
    for placed, part in zip(scene.all, parts):
        pairs = _pairs(part, placed, scene.ground)
        for tag in SECTIONS:
            found = [*part.beside, part.body] if tag == "worldbody" else [*part.root.iterfind(f"{tag}/*")]
            for element in (each for one in found for each in one.iter()):
                _rename(element, placed.name, REFERENCES)
            sections[tag].extend(found)
        sections["contact"].extend(pairs)
    geoms = [geom for placed, part in zip(scene.all, parts) for geom in geoms_of(placed, part.model.shapes)]
    written = [name for geom in sections["worldbody"].iter("geom") if (name := geom.get("name", FLOOR)) != FLOOR]
    sections["contact"].extend(friction_pairs(scene, geoms, written))
    of_scene += _write_touching(scene, geoms, sections)
    _write_beside(scene, sections)
    custom = SubElement(root, "custom")
    if pair_contact(scene.pairs) is not None:
        SubElement(custom, "text", name=PAIRS, data=_stated(scene.pairs))
    SubElement(custom, "text", name=FRICTIONS, data=unranked(geoms, written))
    if own := _own_text(scene, fluid):
        SubElement(custom, "text", name=STATED_OF_SCENE, data=own)
    for placed, part in zip(scene.all, parts):
        for text in part.root.iterfind("custom/text"):
            SubElement(custom, "text", name=link_name(STATED, placed.name), data=text.attrib["data"])
    root.extend(section for section in sections.values() if len(section))
    _write_keys(root, scene.members, parts)
    indent(root)
    return tostring(root, encoding="unicode") + "\n", [*lost, *of_scene]


def _write_touching(scene: SceneModel, geoms: list[Geom], sections: dict[str, Element]) -> list[str]:
    """Write what touches: <exclude> of bodies, <pair> of neighbors, and bits of the geoms of bodies that touch partly.

    Return what the file lacks.
    """
    contact, n = sections["contact"], len(geoms)
    rows, links = rows_by_name(geom.names[1:] for geom in geoms), [geom.names[1] for geom in geoms]
    apart, start = np.zeros((n, n), bool), 0
    own = ((link_name(at.name, a), link_name(at.name, b)) for at in scene.members for a, b in at.model.excluded)
    for one, two in (*scene.excluded, *own):
        mark(apart, rows.get(one, []), rows.get(two, []))
    for model in (placed.model for placed in scene.all):
        (_, near), included, end = neighbors(model), named_shapes(model, model.included), start + len(model.shapes)
        places = rigid_bodies(model)[1]
        still = np.array([model.base == "fixed" and places[shape.link].row == 0 for shape in model.shapes], bool)
        touch = near & (still | still[:, None])  # in MuJoCo
        apart[start:end, start:end] |= touch & ~included
        for a, b in start + np.argwhere(np.triu(near & included & ~touch)):
            names = {geoms[a].name, geoms[b].name}
            if not any({each.get("geom1"), each.get("geom2")} == names for each in contact.iter("pair")):
                SubElement(contact, "pair", geom1=geoms[a].name, geom2=geoms[b].name)
        start = end
    bodies = {body.get("name", "") for body in sections["worldbody"].iter("body")}
    whole = [pair for pair in scene.excluded if {*pair} <= bodies]
    for one, two in combinations(dict.fromkeys(links), 2):
        block = np.ix_(rows[one], rows[two])
        if {one, two} <= bodies and apart[block].all():
            apart[block] = apart[block[::-1]] = False
            whole.append((one, two))
    written = {frozenset((each.get("body1"), each.get("body2"))) for each in contact.iter("exclude")}
    for one, two in whole:
        if frozenset((one, two)) not in written:
            SubElement(contact, "exclude", body1=one, body2=two)
            written.add(frozenset((one, two)))
    closed = [row.tobytes() for row in apart | np.eye(n, dtype=bool)]
    counts = Counter(closed)  # shapes share a bit that touch the same, and each other or, by their own bit, not
    alike = [own if counts[own] > 1 else row.tobytes() for own, row in zip(closed, apart)]
    kinds = {kind: k for k, kind in enumerate(dict.fromkeys([bytes(n), *alike]))}
    if len(kinds) > KINDS:
        return [
            f"left out which shapes of bodies touch: {len(kinds)} kinds of them are more than {KINDS} bits tell apart"
        ]
    bits = [2 << kinds[kind] for kind in alike]
    every = functools.reduce(operator.or_, bits, 2)
    found = {geom.get("name"): geom for geom in sections["worldbody"].iter("geom")}
    for k, geom in enumerate(geoms):
        if geom.name in found and len(kinds) > 1:
            met = every & ~functools.reduce(operator.or_, (bits[i] for i in np.flatnonzero(apart[k])), 0)
            ground = int(found[geom.name].attrib["contype"]) & 1
            found[geom.name].attrib.update(contype=str(bits[k] | ground), conaffinity=str(met))
    return []


def _options(scene: SceneModel, fluid: bool) -> dict[str, str]:
    """Return the attributes of <option>; fluid: whether that of the scene is one of MuJoCo's."""
    options = {} if scene.gravity is None else {"gravity": _numbers(scene.gravity)}
    if fluid and scene.fluid is not None:
        medium = {"density": (scene.fluid.density,), "viscosity": (scene.fluid.viscosity,), "wind": scene.fluid.current}
        options |= {name: _numbers(values) for name, values in medium.items()}
    return options | ({"cone": "elliptic"} if scene.ground else {})


def _lost(scene: SceneModel, fluid: bool) -> list[str]:
    """Return what MuJoCo does not find of the scene as a whole."""
    lost = lost_of_sensors(scene.sensors)
    if scene.fluid is not None and not fluid:
        lost.append(
            f"left out the fluid of density {scene.fluid.density!r}, and what it acts on: MuJoCo's has no surface and "
            "lifts nothing, and acts on all bodies as boxes of their inertia or as ellipsoids"
        )
    if scene.ground is not None and scene.ground.lines:
        lost.append("left out the lines on the ground")
    if high := [at.name for at in scene.members if not at.ground_contact and at.model.contacts]:
        lost.append(f"left out the contact points, which touch no ground, of {', '.join(high)}")
    if geared := [at.name for at in scene.members if at.gearbox not in (None, OF_SCENE)]:
        lost.append(f"left out which model the gearboxes have of {', '.join(geared)}")
    if hinges := [loop.name for loop in scene.loops if loop.kind == "hinge"]:
        lost.append(f"MJCF has no hinge among its loops; wrote two points of the axis of {', '.join(hinges)}")
    return lost


def _own_text(scene: SceneModel, fluid: bool) -> str:
    """Write what MJCF has no element for of ground, fluid and sensors, as TOML."""
    tables = {} if scene.fluid is None or fluid else {"fluid": asdict(scene.fluid)}
    if scene.ground is not None:
        plain = Ground()
        stated = {name: x for name in GIVING if (x := getattr(scene.ground, name)) != getattr(plain, name)}
        if "lines" in stated:
            stated["lines"] = tuple(map(asdict, scene.ground.lines))
        if "steps" in stated or "lines" in stated:
            stated["heading"] = scene.ground.heading
        tables |= {"ground": stated} if stated else {}
    return "\n".join([*table_lines(tables), *carried_sensors(scene.sensors)]).strip()


def _write_beside(scene: SceneModel, sections: dict[str, Element]) -> None:
    """Write the loops between members and the sensors of the scene.

    Raises ValueError for a loop on the root of a fixed robot, which is no body.
    """
    bodies = {body.get("name", ""): body for body in sections["worldbody"].iter("body")}
    bodies[""] = bodies[WORLD] = sections["worldbody"]
    for link in dict.fromkeys(end or "" for loop in scene.loops for end in (loop.a, loop.b)):
        if link not in bodies:
            raise ValueError(f"scene: a loop is on {link!r}, which MJCF has no body for: put it on the world, b=None")
        bodies[link].extend(_elements(site_lines(scene.loops, link or None)))
    for link in dict.fromkeys(inner.link for one in scene.sensors if (inner := measures(one))):
        if link not in bodies:
            raise ValueError(f"scene: a sensor is on {link!r}, which MJCF has no body for: put it on another link")
        bodies[link].extend(_elements(sensor_site_lines(scene.sensors, link)))
    sections["sensor"].extend(_elements(sensor_lines(scene.sensors)))
    sections["tendon"].extend(_elements(rod_lines(scene.loops)))
    sections["equality"].extend(_elements(loop_lines(scene.loops, lambda loop: _length_at_start(scene, loop))))


def _elements(lines: Iterable[str]) -> list[Element]:
    return [*fromstring(f"<lines>{''.join(lines)}</lines>")]


def _length_at_start(scene: SceneModel, loop: Loop) -> float:
    """Return the distance of a loop's points with all joints at zero and all members at their places [m]."""
    ends = []
    for link, point in ((loop.a, loop.point_a), (loop.b, loop.point_b)):
        at = np.array(point)
        if link is not None:
            name, _, own = link.partition(SEPARATOR)
            placed = scene.member(name)
            poses, turn = forward_kinematics(placed.model, zero_position(placed.model)), placed.orientation
            row = placed.model.link_index(own)
            at = poses.position[row] + applied(poses.rotation[row], at)
            at = np.array(_position(placed, scene.ground)) + applied(rotation_from_quaternion(np.array(turn)), at)
        ends.append(at)
    return float(np.linalg.norm(ends[0] - ends[1]))


def _stated(pairs: Any) -> str:
    """Write which bodies touch each other, which MJCF has no element for, as JSON."""
    given = pairs if isinstance(pairs, PairContact) else PairContact(pairs)
    stated = {f.name: getattr(given, f.name) for f in fields(given)} if given is pairs else {"select": given.select}
    return json.dumps({key: value for key, value in stated.items() if value is not None})


def _parsed(text: str) -> Element:
    return fromstring(text, XMLParser(target=TreeBuilder(insert_comments=True)))


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _rename(element: Element, prefix: str, names: Iterable[str]) -> None:
    for name in names:
        if element.get(name):
            element.set(name, link_name(prefix, element.attrib[name]))


def _comments(name: str, root: Element) -> list[Any]:
    return [Comment(f" {name}: {(part.text or '').strip()} ") for part in root if part.tag is Comment]


def _on_ground(placed: Placed, scene: SceneModel) -> set[str]:
    """Return the links without contact points whose shapes touch the ground all the same."""
    if not placed.ground_contact or placed in scene.obstacles or pair_contact(scene.pairs) is None:
        return set()
    high = {name for pair in scene.excluded if GROUND in pair for name in pair}
    pointed = {point.link for point in placed.model.contacts}
    return {
        link.name
        for link in placed.model.links
        if link.name not in pointed and link_name(placed.name, link.name) not in high
    }


def _written(placed: Placed, scene: SceneModel, on_ground: set[str], fluid: bool) -> Written:
    """Write a model by itself and put it at its place; on_ground: links that touch the ground with their shapes."""
    model = placed.model
    names: list[str] = []
    for k, shape in enumerate(model.shapes):
        names.append(unused(shape.name or f"shape{k}", [FLOOR, *names]))
    shapes = tuple(replace(shape, name=name) for shape, name in zip(model.shapes, names))
    contacts = model.contacts if placed.ground_contact and placed not in scene.obstacles else ()
    found = _on_points(shapes, contacts)
    touching = tuple(
        found.get(shape.name) or _with_friction(shape, placed, scene)
        for shape in shapes
        if shape.name in found or shape.link in on_ground
    )
    covered = {_place(point) for shape in touching for point in contact_points([shape])}
    left = tuple(point for point in contacts if _place(point) not in covered)
    model = replace(model, shapes=shapes, contacts=left)
    if placed.gearbox is None:
        model = replace(model, servos={})
    text, lost = mjcf_text(model, fluid=fluid, bare=False)
    root, place = _parsed(text), _position(placed, scene.ground)
    body, beside = _body(root, replace(placed, position=place), model, touching)
    own = {shape.name: shape for shape in shapes}
    for geom in (geom for geom in body.iter("geom") if geom.get("name") in own):
        write_friction(geom, own[geom.attrib["name"]], contact_of(scene))
    return Written(model, root, touching, body, lost, beside)


def _position(placed: Placed, ground: Ground | None) -> tuple[float, float, float]:
    """Return where a model is put [m]: one whose height is not given stands on the ground."""
    x, y, *height = placed.position
    model = placed.model
    if height or model.base == "fixed" or ground is None or not model.contacts:
        return x, y, height[0] if height else 0.0
    q = standing_keyframe(model)
    q = nearest_posture(model) if q is None else q.copy()
    q[:7] = (0.0, 0.0, 0.0, *placed.orientation)
    level = ground.height + math.tan(ground.slope) * (x * math.cos(ground.heading) + y * math.sin(ground.heading))
    if ground.field is not None:
        at = zip((x, y), ground.field.origin, ground.field.spacing, ground.field.heights.shape)
        i, j = (min(max(round((place - start) / step), 0), count - 1) for place, start, step, count in at)
        level += float(ground.field.heights[i, j])
    return x, y, level - float(lowest_levels(model, model.contacts, forward_kinematics(model, q)).min())


def _place(point: ContactPoint) -> ContactPoint:
    return replace(point, load_bearing=True, friction=None, rolling_friction=0.0)


def _on_points(shapes: Iterable[Shape], contacts: tuple[ContactPoint, ...]) -> dict[str, Shape]:
    """Return the shapes, by name, whose contact points are there with one friction, which they get."""
    rubs: dict[ContactPoint, set[tuple[float | None, float]]] = {}
    for point in contacts:
        rubs.setdefault(_place(point), set()).add((point.friction, point.rolling_friction))
    found = {}
    for shape in shapes if contacts else ():
        try:
            own = {*map(_place, contact_points([shape]))}
        except (ValueError, ImportError):  # a mesh that cannot be read
            continue
        numbers = {each for point in own for each in rubs.get(point, ())}
        if own <= rubs.keys() and len(numbers) == 1:
            mu, rolling = numbers.pop()
            found[shape.name] = replace(shape, friction=mu, rolling_friction=rolling or None)
    return found


def _with_friction(shape: Shape, placed: Placed, scene: SceneModel) -> Shape:
    """Return a shape that touches the ground without contact points, with its friction there."""
    names = shape_names(placed.name, shape)
    if scene.ground is None or (shape.priority is None and not scene.frictions):
        return shape
    mu, _, rolling = Frictions(scene.frictions, contact_of(scene)).on_ground(names, shape, scene.ground.friction)
    return replace(shape, friction=mu, rolling_friction=rolling or None)


def _body(root: Element, placed: Placed, model: Model, touching: tuple[Shape, ...]) -> tuple[Element, list[Element]]:
    """Return the model's first body at its place, and what stands beside it in the world.

    A floating model's world is that of the scene.  What a fixed model has in the world moves with its place, so a body
    holds it together with the links of a root that is MuJoCo's world.
    """
    world = root.find("worldbody")
    inside = [] if world is None else [*world]
    whole = [element for element in inside if element.tag == "body"]
    beside: list[Element] = []
    if model.base == "floating" or (len(inside) == 1 and whole and whole[0].get("name") == model.root):
        (body,) = whole
        beside = [element for element in inside if element is not body]
    else:
        body = Element("body", name=WORLD)
        body.extend(inside)
    body.set("pos", _numbers(placed.position))
    body.set("quat", _numbers(placed.orientation))
    on_ground = {shape.name for shape in touching}
    shapes = {shape.name for shape in model.shapes}
    for geom in body.iter("geom"):
        if geom.get("name") in shapes:
            kind, affinity = BITS[geom.get("name") in on_ground]
            geom.attrib.update(contype=kind, conaffinity=affinity)
    return body, beside


def _ground(scene: SceneModel, ground: Ground, sections: dict[str, Element]) -> list[str]:
    """Write the ground, which gives way as under the heaviest member; return what is left out of it.

    Its priority is above that of all shapes: those with a friction of their own there get a <pair>.
    """
    lines, left = floor_lines(max(scene.members, key=lambda placed: placed.model.mass).model, ground)
    ranks = [shape.priority or 0 for placed in scene.all for shape in placed.model.shapes]
    (floor,) = _parsed("\n".join(["<floor>", *lines, "</floor>"]))
    floor.attrib.update(contype="0", conaffinity="1", priority=str(1 + max([0, *ranks])))
    sections["worldbody"].append(floor)
    sections["asset"].extend(_parsed("\n".join(["<assets>", *field_lines(ground), "</assets>"])))
    return left


def _pairs(part: Written, placed: Placed, ground: Ground | None) -> list[Element]:
    """Write what touches the ground with a friction of its own."""
    models = (replace(part.model, contacts=(), shapes=part.touching), part.model)
    lines = [*pair_lines(models[0], ground), *(pair_lines(models[1], ground) if part.model.contacts else ())]
    pairs = [*_parsed("\n".join(["<pairs>", *lines, "</pairs>"]))]
    for pair in pairs:
        _rename(pair, placed.name, ("geom2",))
    return pairs


def _write_keys(root: Element, members: tuple[Placed, ...], parts: list[Written]) -> None:
    """Write the keyframes of all members together: one that lacks a keyframe stays where it starts."""
    found = [{key.get("name", ""): key.get("qpos", "") for key in part.root.iterfind("keyframe/key")} for part in parts]
    names = list(dict.fromkeys(name for keys in found for name in keys))
    section = SubElement(root, "keyframe") if names else root
    for name in names:
        states = []
        for placed, part, keys in zip(members, parts, found):
            floating = placed.model.base == "floating"
            start = f"{part.body.attrib['pos']} {part.body.attrib['quat']} " if floating else ""
            zeros = _numbers([0.0] * len(placed.model.joint_names))
            joints = " ".join(keys[START].split()[7 * floating :]) if START in keys else zeros
            states.append(keys.get(name) or (start + joints).strip())
        SubElement(section, "key", name=name, qpos=" ".join(filter(None, states)))
