"""The model of a robot: frozen dataclasses in SI units, as read from its files, checked when they are made.

A `Model` holds the links and joints exactly as the files state them; `rigid_bodies` merges those that move as one.
`scene/` compiles a model into the arrays that the kernels read.

Coordinates of a state, the same as those of MuJoCo's free joint:

- fixed base: ``q (nq,)`` are the joint positions in file order, ``qd (nv,)`` their velocities;
- floating base: ``q = [x y z, qw qx qy qz, joints]``, ``qd = [v (world axes), omega (body axes), joint velocities]``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from ..base.arguments import instance, listed, shown, texts
from ..base.brief import clipped
from ..base.flaws import FlawError, quoted
from .checks import check, choice_flaws, name_flaws, vector_flaws
from .degrees import Degrees, ball_name, degrees_of, widths
from .fluid import Immersed, Propeller, check_propellers
from .ground import ContactPoint
from .links import Joint, Link, leader_of
from .loop import Loop, check_loops
from .mass_checks import by_body, indefinite_flaws
from .pair_contact import name_pairs
from .rigid_bodies import Frame, Placement, RigidBody, depth_first_joints, lay_out, merge
from .sensor import SampledSensor, Sensor, check_sensors
from .servo import Servo, Supply
from .shapes import Shape
from .tendon import Tendon, check_tendons
from .tree_checks import (
    check_can_move,
    check_links,
    check_locked,
    check_mimics,
    check_references,
    check_servos,
    check_tree,
    links_of_pairs,
)

Base = Literal["fixed", "floating"]


@dataclass(frozen=True, eq=False)
class Model:
    """A robot.

    Models are compared and hashed by identity; compare `links` and `joints` to compare robots.

    Attributes
    ----------
    name : str
        Name of the robot.
    links : tuple of Link
        Links, in file order.
    joints : tuple of Joint
        Joints, in file order; they connect the links to one tree.
    base : {"fixed", "floating"}
        Whether the root link is fixed to the world or moves freely.
    locked : Mapping of str to float
        Joints that are locked, and their positions [rad or m].
    servos : Mapping of str to Servo
        Servos by joint name.
    contacts : tuple of ContactPoint
        Points that can touch the ground.
    shapes : tuple of Shape
        Collision shapes.
    keyframes : Mapping of str to tuple of float
        Named postures q (nq,) [m, -, rad or m]; joints begin as in "qpos0", if there is one.
    notes : tuple of str
        What the reader of the file skipped or assumed, one sentence each.
    source : str
        File from which the robot was read.
    supply : Supply or None
        Source that feeds all servos; None if each servo has its own `voltage_limit`, whatever the others draw.
    package_dirs : tuple of str
        Folders with the packages of the robot's files, besides the usual places.
    excluded : tuple of (str, str)
        Pairs of links, or of shapes "link/shape", that do not touch each other in a scene with contact between bodies.
    loops : tuple of Loop
        Constraints that close loops of the tree.
    tendons : tuple of Tendon
        Springs, dampers, limits and drives along lengths that several joints make.
    immersed : tuple of Immersed
        Shapes on which a fluid acts.
    propellers : tuple of Propeller
        Joints that push what carries them.
    sensors : tuple of sensors
        Sensors on links, which runs record and sessions observe by their names; those of a scene by "robot/name".
    included : tuple of (str, str)
        Pairs of links, or of shapes "link/shape", that touch each other although one joint connects them.
    references : Mapping of str to (float, float)
        Range in which the engine of the robot's file keeps the reference of a joint's servo [rad or m]; `judge` does
        too, other runs follow references as they are.

    Raises
    ------
    ValueError
        If the parts do not fit together; the message names the element, its value, what is allowed and a remedy.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    base: Base = "fixed"
    locked: Mapping[str, float] = field(default_factory=dict)
    servos: Mapping[str, Servo] = field(default_factory=dict)
    contacts: tuple[ContactPoint, ...] = ()
    shapes: tuple[Shape, ...] = ()
    keyframes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    source: str = ""
    supply: Supply | None = None
    package_dirs: tuple[str, ...] = ()
    excluded: tuple[tuple[str, str], ...] = ()
    loops: tuple[Loop, ...] = ()
    tendons: tuple[Tendon, ...] = ()
    immersed: tuple[Immersed, ...] = ()
    propellers: tuple[Propeller, ...] = ()
    sensors: tuple[Sensor | SampledSensor, ...] = ()
    included: tuple[tuple[str, str], ...] = ()
    references: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __repr__(self) -> str:
        counts = {
            "moving joints": self.joint_names, "locked": self.locked, "servos": self.servos,
            "contact points": self.contacts, "shapes": self.shapes, "keyframes": self.keyframes,
            "loops": self.loops, "tendons": self.tendons, "immersed shapes": self.immersed,
            "propellers": self.propellers, "sensors": self.sensors,
        }  # fmt: skip
        found = ", ".join(f"{len(parts)} {what}" for what, parts in counts.items() if parts)
        return f"<robot {clipped(self.name)}: {self.base} base, {self.mass:.4g} kg, {found}>"

    def __post_init__(self) -> None:
        what = f"robot {self.name!r}"
        check(name_flaws("robot", self.name), choice_flaws(what, "base", self.base, ("fixed", "floating")))
        self._freeze(what)
        check_tree(self.links, self.joints)
        if self.degrees.between:  # whose names may be taken
            check_tree(self.links + self.degrees.between, self.degrees.joints)
        check_locked(self.degrees.joints, self.locked)
        check_mimics(self.degrees.joints)
        check_servos(self.degrees.joints, self.servos)
        for name, servo in self.servos.items():
            instance(f"servos: that of joint {name!r}", servo, Servo, "give a Servo, as load_servo does")
        if self.supply is not None:
            instance(f"{what}: supply", self.supply, Supply, "give Supply(voltage, resistance), or None")
        check_links("contacts", self.links, (point.link for point in self.contacts))
        check_links("shapes", self.links, (shape.link for shape in self.shapes))
        for name in ("excluded", "included"):
            check_links(name, self.links, links_of_pairs(self.links, getattr(self, name)))
        check_loops(self.links, self.loops)
        check_tendons(self.links, self.degrees.joints, self.tendons)
        check_links("immersed", self.links, (shape.link for shape in self.immersed))
        check_propellers(self.joints, self.propellers)
        object.__setattr__(self, "sensors", check_sensors(what, self.sensors, [link.name for link in self.links]))
        check_can_move(self.joints, self.held)
        check_references(self.degrees.joints, self.references)
        for name, q in self.keyframes.items():
            check(vector_flaws(f"keyframe {name!r}", "q", q, self.nq))
            for ball, whole in zip(self.balls, self.ball_names):
                if not any(q[self.position_slices[ball]]):
                    raise ValueError(
                        f"keyframe {name!r}: the quaternion of ball joint {whole!r} is zero; give w x y z, "
                        "[1, 0, 0, 0] is no rotation"
                    )
        self._check_mass_matrix()

    def _freeze(self, what: str) -> None:
        """Keep copies that cannot be changed: compiling a scene relies on what is checked here."""
        for name, kind in _PARTS.items():
            remedy = f"give a list of {kind.__name__}"
            parts = tuple(listed(f"{what}: {name}", getattr(self, name), remedy))
            for part in parts:
                instance(f"{what}: {name}", part, kind, remedy)
            object.__setattr__(self, name, parts)
        object.__setattr__(self, "notes", tuple(texts("notes", self.notes, "give a list of sentences")))
        instance("source", self.source, str, "give the path of a file, or an empty text")
        folders = tuple(texts("package_dirs", self.package_dirs, "give a list of folders"))
        object.__setattr__(self, "package_dirs", folders)
        for name in ("excluded", "included"):
            pairs = name_pairs(f"{what}: {name}", getattr(self, name), "give pairs of links")
            object.__setattr__(self, name, pairs)
        for name in _TABLES:
            table = getattr(self, name)
            instance(f"{what}: {name}", table, Mapping, "give a dictionary, by name")
            object.__setattr__(self, name, MappingProxyType(dict(table)))

    def _check_mass_matrix(self) -> None:
        """Raise FlawError, a ValueError, unless the mass matrix is positive definite in some posture."""
        bodies, floating = self._merged[0], self.base == "floating"
        keyframes = (by_body(bodies, self.joint_rows, self.single_positions(q)) for q in self.keyframes.values())
        flaws = indefinite_flaws(self.name, bodies, floating, lambda: self.couplings, keyframes)
        if flaws:
            raise FlawError(flaws)

    def __getstate__(self) -> dict[str, Any]:
        return {name: dict(value) if name in _TABLES else value for name, value in self.__dict__.items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {name: MappingProxyType(state[name]) for name in _TABLES})

    def with_numbers(
        self,
        links: Sequence[Link] | None = None,
        joints: Sequence[Joint] | None = None,
        servos: Mapping[str, Servo] | None = None,
        supply: Supply | None = None,
    ) -> Model:
        """Return the robot with other numbers in its links, joints, servos or supply.

        The tree and the place of every joint must stay the same; they are not checked again.

        Parameters
        ----------
        links, joints, servos, supply : optional
            Replacements of the same names, in the same order; None keeps those of this model.

        Returns
        -------
        Model
            The robot with these numbers.

        Raises
        ------
        ValueError
            As for a new model, if limits and masses make no sense.
        """
        made = object.__new__(Model)
        made.__dict__.update({f.name: getattr(self, f.name) for f in fields(Model)})
        if servos is not None:
            made.__dict__["servos"] = MappingProxyType(dict(servos))
        if supply is not None:
            made.__dict__["supply"] = supply
        if links is None and joints is None:
            made.__dict__.update({name: getattr(self, name) for name in ("moving_joints", "held", "joint_names")})
            made.__dict__["skeleton"] = self.skeleton
        else:
            made.__dict__.update(links=tuple(links or self.links), joints=tuple(joints or self.joints))
            check_locked(made.degrees.joints, made.locked)
            check_can_move(made.joints, made.held)
            made.__dict__["_laid_out"] = self._laid_out
            made._check_mass_matrix()
        return made

    @cached_property
    def skeleton(self) -> Model:
        """A model with the same links and joints, the same object for all that differ in their servos alone."""
        return self

    @cached_property
    def _laid_out(self) -> tuple[list[Frame], dict[str, Placement]]:
        return lay_out(self.root, self.degrees.joints, self.joint_names, self.held)

    @cached_property
    def _merged(self) -> tuple[list[RigidBody], dict[str, Placement]]:
        return merge(self.links + self.degrees.between, self.degrees.joints, *self._laid_out)

    @property
    def root(self) -> str:
        """Name of the link that is no joint's child."""
        return ({link.name for link in self.links} - {joint.child for joint in self.joints}).pop()

    @cached_property
    def moving_joints(self) -> tuple[Joint, ...]:
        """Joints that have a coordinate, in file order, coupled ones included; of one degree of freedom each.

        A joint of several degrees is listed as its degrees: see `degrees`.
        """
        held = self.held
        return tuple(j for j in self.degrees.joints if j.type != "fixed" and j.name not in held)

    @cached_property
    def degrees(self) -> Degrees:
        """The joints, those of several degrees of freedom as chains of joints of one (`model/degrees.py`)."""
        return degrees_of(self.joints)

    @cached_property
    def position_slices(self) -> tuple[slice, ...]:
        """Where the position of each of `moving_joints` stands in q: four numbers of a ball joint's first degree."""
        first, found = self.base_positions, []
        for width in widths(self.moving_joints):
            found.append(slice(first, first + width))
            first += width
        return tuple(found)

    @cached_property
    def position_names(self) -> tuple[str, ...]:
        """Names of the joints' numbers in q: of a joint, or `joint.qw` to `joint.qz` of a ball joint's quaternion."""
        names: list[str] = []
        for joint, place in zip(self.moving_joints, self.position_slices):
            several = [f"{ball_name(joint)}.q{label}" for label in "wxyz"]
            names += {1: [joint.name], 4: several}.get(place.stop - place.start, [])
        return tuple(names)

    def single_positions(self, q: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return the position of each of `moving_joints` (..., n) [rad or m] in q (..., nq), 0 of ball joints."""
        q = np.array(q, dtype=float)
        if not self.balls:
            return q[..., self.base_positions :]
        single = np.zeros((*q.shape[:-1], len(self.moving_joints)))
        for k, (joint, place) in enumerate(zip(self.moving_joints, self.position_slices)):
            if joint.type != "ball":
                single[..., k] = q[..., place.start]
        return single

    @property
    def base_positions(self) -> int:
        """Number of position coordinates of the base: 7 if it floats, else 0."""
        return 7 if self.base == "floating" else 0

    @property
    def ball_joints(self) -> tuple[Joint, ...]:
        """The ball joints that move, in the order of `balls`; of a free joint that turns, that joint."""
        found = {joint.name: joint for joint in self.joints}
        return tuple(found[name] for name in self.ball_names)

    @cached_property
    def balls(self) -> tuple[int, ...]:
        """Index in `moving_joints` of the first degree of each ball joint."""
        return tuple(k for k, width in enumerate(widths(self.moving_joints)) if width == 4)

    @property
    def ball_names(self) -> tuple[str, ...]:
        """Name of each ball joint, in the order of `balls`; of a free joint that turns, its name."""
        return tuple(ball_name(self.moving_joints[k]) for k in self.balls)

    @cached_property
    def held(self) -> dict[str, float]:
        """Joints that could move but are held, and their positions [rad or m].

        These are the locked joints, and joints coupled to a locked or fixed one or with the multiplier 0.
        """
        held, by_name = dict(self.locked), {joint.name: joint for joint in self.degrees.joints}
        for joint in self.degrees.joints:
            if joint.mimic is not None and joint.type != "fixed" and joint.name not in held:
                head, k, offset = leader_of(joint, by_name, self.locked)
                if k == 0 or head.type == "fixed" or head.name in self.locked:
                    held[joint.name] = k * self.locked.get(head.name, 0.0) + offset
        return held

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints that have a coordinate, in file order."""
        return tuple(j.name for j in self.moving_joints)

    @property
    def nq(self) -> int:
        """Number of position coordinates."""
        return self.base_positions + sum(widths(self.moving_joints))

    @property
    def nv(self) -> int:
        """Number of velocity coordinates."""
        return len(self.moving_joints) + (6 if self.base == "floating" else 0)

    @cached_property
    def couplings(self) -> tuple[tuple[str, str, float, float], ...]:
        """Coupled joints in file order: (follower, leader, multiplier, offset [rad or m])."""
        by_name = {joint.name: joint for joint in self.degrees.joints}
        followers = [joint for joint in self.moving_joints if joint.mimic]
        leaders = [leader_of(joint, by_name, self.locked) for joint in followers]
        return tuple((joint.name, head.name, k, offset) for joint, (head, k, offset) in zip(followers, leaders))

    @property
    def mass(self) -> float:
        """Total mass [kg], a fixed base included."""
        return math.fsum(link.mass for link in self.links)

    @cached_property
    def link_rows(self) -> Mapping[str, int]:
        """Position of each link in `links`, by name."""
        return {link.name: k for k, link in enumerate(self.links)}

    @cached_property
    def joint_rows(self) -> Mapping[str, int]:
        """Position of each joint that has a coordinate in `joint_names`, by name."""
        return {name: k for k, name in enumerate(self.joint_names)}

    def link(self, name: str) -> Link:
        """Look up a link by name.

        Parameters
        ----------
        name : str
            Name of the link.

        Returns
        -------
        Link
            The link.

        Raises
        ------
        ValueError
            If there is no such link.
        """
        return self.links[self._row(name, self.link_rows, "link")]

    def joint(self, name: str) -> Joint:
        """Look up a joint by name, fixed and locked ones included.

        Parameters
        ----------
        name : str
            Name of the joint.

        Returns
        -------
        Joint
            The joint.

        Raises
        ------
        ValueError
            If there is no such joint.
        """
        return self.joints[self._row(name, {joint.name: k for k, joint in enumerate(self.joints)}, "joint")]

    def link_index(self, name: str) -> int:
        """Return the position of a link in `links`.

        Parameters
        ----------
        name : str
            Name of the link.

        Returns
        -------
        int
            Index into `links`, and into the poses of `forward_kinematics`.

        Raises
        ------
        ValueError
            If there is no such link.
        """
        return self._row(name, self.link_rows, "link")

    def q_index(self, joint: str) -> int:
        """Return the index of a joint's position in q.

        Parameters
        ----------
        joint : str
            Name of a joint that has a coordinate.

        Returns
        -------
        int
            Index into q (nq,).

        Raises
        ------
        ValueError
            If there is no such joint, it is fixed or held, or a further degree of a ball joint, which has no position.
        """
        place = self.position_slices[self._row(joint, self.joint_rows, "moving joint")]
        if place.stop == place.start:
            raise ValueError(
                f"model {self.name!r}: joint {joint!r} has no position of its own; the quaternion of its ball joint "
                f"begins at q_index({joint[:-1] + 'x'!r})"
            )
        return place.start

    def qd_index(self, joint: str) -> int:
        """Return the index of a joint's velocity in qd.

        Parameters
        ----------
        joint : str
            Name of a joint that has a coordinate.

        Returns
        -------
        int
            Index into qd (nv,).

        Raises
        ------
        ValueError
            If there is no such joint, or it is fixed or held.
        """
        return self.nv - len(self.joint_names) + self._row(joint, self.joint_rows, "moving joint")

    def _row(self, name: str, rows: Mapping[str, int], kind: str) -> int:
        if not isinstance(name, str) or name not in rows:
            raise ValueError(f"model {self.name!r} has no {kind} {shown(name)}; its {kind}s are {quoted(rows)}")
        return rows[name]


_PARTS = {
    "links": Link, "joints": Joint, "contacts": ContactPoint, "shapes": Shape, "loops": Loop, "tendons": Tendon,
    "immersed": Immersed, "propellers": Propeller,
}  # fmt: skip
_TABLES = ("locked", "servos", "keyframes", "references")


def rigid_bodies(model: Model) -> tuple[list[RigidBody], dict[str, Placement]]:
    """Merge links that fixed and held joints connect.

    Parameters
    ----------
    model : Model
        The robot.

    Returns
    -------
    bodies : list of RigidBody
        First the root's body, then one for each moving joint, depth first: parents before children, chains in one
        piece.
    placements : dict of str to Placement
        The place of every link, by name.
    """
    return model._merged


def depth_first(model: Model) -> list[Joint]:
    """Order the joints depth first: a parent's before its children's, each chain in one piece.

    Parameters
    ----------
    model : Model
        The robot.

    Returns
    -------
    list of Joint
        The joints; children of a link in file order.
    """
    return depth_first_joints(model.root, model.joints)
