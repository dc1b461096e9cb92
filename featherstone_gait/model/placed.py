"""Describe a scene: robots and objects at their places, obstacles, ground and gravity."""

from __future__ import annotations

import difflib
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sized
from dataclasses import dataclass, replace
from typing import Literal

from ..base.arguments import instance, listed, shown, texts, truth
from ..base.brief import brief, clipped
from ..base.flaws import quoted
from .checks import check, freeze, name_flaws, vector_flaws
from .fluid import Fluid
from .ground import Ground
from .links import Vector
from .loop import Loop
from .pair_contact import GROUND, NONE, PAIR_REMEDY, PairContact, PairWord, name_pairs, pair_contact
from .pair_friction import PairFriction, shape_names
from .robot import Model
from .sensor import SampledSensor, Sensor, check_sensors

SEPARATOR = "/"  # between the names of a model and of its link or joint
PlacedGearbox = Literal["scene", "mipsd", "rotor", "standard"]
OF_SCENE: Literal["scene"] = "scene"  # the gearbox that is given to compile_scene


@dataclass(frozen=True, eq=False)
class Placed:
    """A model at its place in a scene.

    Links and joints are called "name/link" and "name/joint" there.

    Attributes
    ----------
    model : Model
        The robot, or an object without joints (see `body`).
    name : str
        Name in the scene, without "/"; empty: that of the model.
    position : tuple of float
        Origin of the root link's frame in the world [m]: of a fixed base for good, of a floating one where it starts.
        Of two numbers, x and y, a floating model starts standing on the ground there.
    orientation : tuple of float
        Orientation of the root link in the world, a quaternion w x y z of any length above 0; it is kept normalized.
    gearbox : str or None
        Model of its gearboxes, None for no servos; "scene": that given to `compile_scene`.
    ground_contact : bool
        Whether its contact points touch the ground of the scene.

    Raises
    ------
    ValueError
        For a name, place or orientation out of range.
    TypeError
        For a model, gearbox or ground_contact of another type.
    """

    model: Model
    name: str = ""
    position: tuple[float, ...] = (0.0, 0.0)
    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    gearbox: PlacedGearbox | None = OF_SCENE
    ground_contact: bool = True

    __repr__ = brief

    def __post_init__(self) -> None:
        instance("placed: model", self.model, Model, "give a Model, as load_robot and body return it")
        instance("placed: name", self.name, str, "give a text")
        if not self.name:
            object.__setattr__(self, "name", self.model.name)
        what = f"placed model {self.name!r}"
        check(name_flaws("placed model's", self.name))
        if SEPARATOR in self.name:
            raise ValueError(f"{what}: its name has {SEPARATOR!r}, which divides it from its links': give another name")
        is_list = isinstance(self.position, Sized) and getattr(self.position, "ndim", 1) > 0
        size = 2 if is_list and len(self.position) == 2 else 3
        check(
            vector_flaws(what, "position", self.position, size),
            vector_flaws(what, "orientation", self.orientation, 4),
        )
        if self.gearbox is not None:
            instance(f"{what}: gearbox", self.gearbox, str, "give a kind of gearbox, None, or 'scene'")
        truth(f"{what}: ground_contact", self.ground_contact)
        object.__setattr__(self, "position", tuple(map(float, self.position)))
        self._normalize(what)

    def _normalize(self, what: str) -> None:
        """Scale the orientation to unit length; a unit one keeps its bits."""
        object.__setattr__(self, "orientation", tuple(map(float, self.orientation)))
        size = max(map(abs, self.orientation))
        if not size > 0:
            raise ValueError(f"{what}: orientation {self.orientation!r} has no length; give (1, 0, 0, 0) for none")
        w, x, y, z = (part / size for part in self.orientation)
        length = math.sqrt(w * w + x * x + y * y + z * z)
        if size * length != 1.0:
            object.__setattr__(self, "orientation", (w / length, x / length, y / length, z / length))


@dataclass(frozen=True, eq=False)
class SceneModel:
    """The description of a scene, which `compile_scene` compiles.

    Attributes
    ----------
    name : str
        Name of the scene.
    members : tuple of Placed
        Robots and free objects: all that can move.
    obstacles : tuple of Placed
        Shapes that never move: models of one link with a fixed base.
    ground : Ground or None
        The ground.
    gravity : tuple of float or None
        Gravity (3,) in world axes [m/s^2]; None: the default of `compile_scene`.
    excluded : tuple of (str, str)
        Pairs of links, "name/link", or shapes, "name/link/shape", that do not touch each other; one of both may be
        "ground".
    notes : tuple of str
        What the reader of the file skipped or assumed, one sentence each; notes on a member are in its model.
    source : str
        File from which the scene was read.
    pairs : str, tuple of (str, str), or PairContact
        Bodies that touch each other, unless `compile_scene` is told otherwise: "none", "all", pairs of names, or a
        `PairContact` with the numbers of the contact.
    loops : tuple of Loop
        Constraints between links "name/link" of two members, or of a member and the world.
    fluid : Fluid or None
        The fluid around the members.
    sensors : tuple of sensors
        Sensors on links "name/link" of members, or of the "world".
    frictions : tuple of PairFriction
        Friction between shapes, in place of what follows from the two; of several that fit, the last one counts.

    Raises
    ------
    ValueError
        If the parts do not fit together; the message names the element, its value, what is allowed and a remedy.
    TypeError
        For parts of another type.
    """

    name: str
    members: tuple[Placed, ...]
    obstacles: tuple[Placed, ...] = ()
    ground: Ground | None = None
    gravity: Vector | None = None
    excluded: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    source: str = ""
    pairs: PairWord | tuple[tuple[str, str], ...] | PairContact = NONE
    loops: tuple[Loop, ...] = ()
    fluid: Fluid | None = None
    sensors: tuple[Sensor | SampledSensor, ...] = ()
    frictions: tuple[PairFriction, ...] = ()

    def __repr__(self) -> str:
        named = [f"{len(self.members)} members ({quoted(m.name for m in self.members)})"] if self.members else []
        named += [f"{len(self.obstacles)} obstacles"] if self.obstacles else []
        ground = "no ground" if self.ground is None else f"ground of friction {self.ground.friction:g}"
        return f"<scene model {clipped(self.name)}: {', '.join([*named, ground])}>"

    def __post_init__(self) -> None:
        check(name_flaws("scene", self.name))
        for field, remedy in (("members", "give a list of Placed"), ("obstacles", "give a list of Placed")):
            parts = tuple(listed(f"scene: {field}", getattr(self, field), remedy))
            for part in parts:
                instance(f"scene: {field}", part, Placed, "put the model at its place: Placed(model, position=...)")
            object.__setattr__(self, field, parts)
        if self.ground is not None:
            instance("scene: ground", self.ground, Ground, "write ground=Ground(), or None")
        if self.fluid is not None:
            instance("scene: fluid", self.fluid, Fluid, "write fluid=Fluid(), or None")
        if self.gravity is not None:
            check(vector_flaws("scene", "gravity", self.gravity, 3))
            freeze(self, "gravity")
        object.__setattr__(self, "notes", tuple(texts("scene: notes", self.notes, "give a list of sentences")))
        instance("scene: source", self.source, str, "give the path of a file, or an empty text")
        check(self._name_flaws(), *map(_obstacle_flaws, self.obstacles))
        self._check_excluded()
        object.__setattr__(self, "loops", tuple(listed("scene: loops", self.loops, "give a list of Loop")))
        check_scene_loops(self.members, self.loops)
        links = [link_name(placed.name, link.name) for placed in self.members for link in placed.model.links]
        others = [replace(one, name=link_name(at.name, one.name)) for at in self.members for one in at.model.sensors]
        object.__setattr__(self, "sensors", check_sensors("scene", self.sensors, links, others))

    def _name_flaws(self) -> Iterator[str]:
        if not self.members:
            yield "scene: members is empty; expected one model that can move, or more: add a Placed"
        for name, count in Counter(placed.name for placed in (*self.members, *self.obstacles)).items():
            if count > 1:
                yield f"scene: {count} models are named {name!r}; names are unique: give Placed(..., name=...)"

    def _check_excluded(self) -> None:
        links = {link_name(placed.name, link.name) for placed in self.all for link in placed.model.links}
        remedy = 'give pairs such as ("name/link", "name/link")'
        pairs = name_pairs("scene: excluded", self.excluded, remedy)
        shaped = {name for at in self.all for one in at.model.shapes for name in shape_names(at.name, one)[2:]}
        _check_names("excluded", pairs, {*links, *shaped, GROUND})
        object.__setattr__(self, "excluded", pairs)
        if not isinstance(self.pairs, (str, PairContact)):
            object.__setattr__(self, "pairs", name_pairs("scene: pairs", self.pairs, PAIR_REMEDY))
        wanted = pair_contact(self.pairs)
        if wanted is not None and not isinstance(wanted.select, str):
            _check_names("pairs", wanted.select, {*links, *(placed.name for placed in self.all), GROUND})
        self._check_frictions()

    def _check_frictions(self) -> None:
        frictions = tuple(listed("scene: frictions", self.frictions, "give a list of PairFriction"))
        for one in frictions:
            instance("scene: frictions", one, PairFriction, 'give PairFriction("cup", "table", friction=0.3)')
        if frictions:
            known = {name for at in self.all for one in at.model.shapes for name in shape_names(at.name, one)}
            _check_names("frictions", ((one.a, one.b) for one in frictions), {*known, GROUND})
        object.__setattr__(self, "frictions", frictions)

    @property
    def all(self) -> tuple[Placed, ...]:
        """Members, then obstacles."""
        return (*self.members, *self.obstacles)

    def member(self, name: str) -> Placed:
        """Return a member or obstacle by name.

        Parameters
        ----------
        name : str
            Its name in the scene.

        Returns
        -------
        Placed
            The model and its place.

        Raises
        ------
        ValueError
            If there is no such one.
        """
        found = next((placed for placed in self.all if placed.name == name), None)
        if found is None:
            raise ValueError(
                f"scene {self.name!r} has no member {shown(name)}; expected one of "
                f"{quoted(placed.name for placed in self.all)}: use one of these"
            )
        return found


def _check_names(field: str, pairs: Iterable[tuple[str, str]], known: set[str]) -> None:
    """Raise ValueError for a name that is not of the scene."""
    for name in (name for pair in pairs for name in pair):
        if name not in known:
            near = difflib.get_close_matches(name, sorted(known))
            raise ValueError(
                f"scene: {field} names {name!r}, which is not in the scene; expected one of "
                f"{quoted([*near, *sorted(known - {*near})])}: correct it"
            )


def check_scene_loops(members: Iterable[Placed], loops: Iterable[Loop]) -> None:
    """Raise ValueError unless loops of a scene are between links of its members; TypeError for others than Loop."""
    members, loops = list(members), list(loops)
    for loop in loops:
        instance("scene: loops", loop, Loop, "give a list of Loop")
    known = {link_name(placed.name, link.name) for placed in members for link in placed.model.links}
    _check_names("loops", ((loop.a, loop.a if loop.b is None else loop.b) for loop in loops), known)
    own = [link_name(placed.name, loop.name) for placed in members for loop in placed.model.loops]
    for name, count in Counter([*own, *(loop.name for loop in loops)]).items():
        if count > 1:
            raise ValueError(f"scene: {count} loops are named {name!r}; give every loop its own name")


def link_name(placed: str, link: str) -> str:
    """Return the name in a scene of a link or joint of a placed model."""
    return f"{placed}{SEPARATOR}{link}"


def _obstacle_flaws(placed: Placed) -> Iterable[str]:
    model = placed.model
    if model.base != "fixed" or model.joints:
        yield (
            f"obstacle {placed.name!r} has a {model.base} base and {len(model.joints)} joints; expected a fixed one "
            "and none: list it under members, or make it with body(..., base='fixed')"
        )
