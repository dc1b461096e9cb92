"""Links, joints and springs of a robot, as its file states them."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

from ..base.arguments import is_real, shown
from ..base.brief import brief
from ..base.flaws import quoted
from .checks import (
    angle_flaws,
    check,
    choice_flaws,
    freeze,
    name_flaws,
    quantity,
    quantity_flaws,
    refuse,
    vector_flaws,
)

JointType = Literal[
    "revolute", "continuous", "prismatic", "fixed", "screw", "ball", "universal", "cylindrical", "planar", "free"
]
COMPOSITE = ("ball", "universal", "cylindrical", "planar", "free")  # joints of several degrees of freedom
SINGLE = {  # their degrees that turn about one axis or slide: see degrees.py
    "universal": ("r1", "r2"), "cylindrical": ("z", "rz"), "planar": ("x", "y", "rz"), "free": ("x", "y", "z"),
}  # fmt: skip
OF_DEGREES = (
    "lower", "upper", "effort", "velocity", "damping", "friction", "armature", "stiffness", "spring_reference",
    "quadratic_stiffness", "cubic_stiffness", "quadratic_damping", "cubic_damping",
)  # fmt: skip
Vector = tuple[float, float, float]

GIVES_WAY = 3.0 * (1.0 + 1e-12)  # by which a spring may miss the limit through rounding
AXIS_TOLERANCE = 1e-9  # how far from 1 the length of a joint axis may be


@dataclass(frozen=True)
class Link:
    """A rigid body of a robot.

    An inertia that no rigid body can have is accepted: a `Model` only requires a positive definite mass matrix.

    Attributes
    ----------
    name : str
        Name, unique among the links of a robot.
    mass : float
        Mass [kg]; 0, the default, for a frame without mass.
    center_of_mass : tuple of float
        Center of mass (3,) in the link's frame [m].
    inertia : tuple of float
        Inertia about the center of mass, in link axes: ixx, ixy, ixz, iyy, iyz, izz [kg m^2].
    gravity_compensation : float
        Share of its weight that a force at its center of mass bears: 1 lets it float.

    Raises
    ------
    ValueError
        For a mass, vector or name out of range; all problems of the link are listed.
    """

    name: str
    mass: float = quantity(">= 0", "kg", 0.0, "a link without mass is one without <inertial>")
    center_of_mass: Vector = (0.0, 0.0, 0.0)
    inertia: tuple[float, ...] = (0.0,) * 6
    gravity_compensation: float = quantity("finite", "-", 0.0, "1 bears the whole weight, 0 nothing")

    __repr__ = brief

    def __post_init__(self) -> None:
        refuse(f"link {self.name!r}", self._flaws(f"link {self.name!r}"))
        freeze(self, "center_of_mass", "inertia")

    def _flaws(self, what: str) -> Iterator[str]:
        yield from name_flaws("link", self.name)
        yield from quantity_flaws(what, self)
        yield from vector_flaws(what, "center_of_mass", self.center_of_mass, 3)
        yield from vector_flaws(what, "inertia", self.inertia, 6)


@dataclass(frozen=True)
class Mimic:
    """A coupling of a joint to another one: position = multiplier * (position of the other joint) + offset.

    The coupled joint keeps its coordinate, and its own stops, friction and servo act on both joints.  A locked joint
    ignores its coupling.

    Attributes
    ----------
    joint : str
        Name of the joint that is followed.
    multiplier : float
        Ratio of the two velocities [-, m/rad or rad/m].
    offset : float
        Position of the coupled joint where the other one is at zero [rad or m].
    """

    joint: str
    multiplier: float = quantity("finite", "-", 1.0)
    offset: float = quantity("finite", "rad or m", 0.0)

    __repr__ = brief

    def __post_init__(self) -> None:
        check(name_flaws("joint", self.joint), quantity_flaws(f"mimic of joint {self.joint!r}", self))


def weakens(b1: float, b2: float, b3: float) -> bool:
    """Return whether the force (b1 + b2 |v| + b3 v^2) v falls somewhere as the speed v grows."""
    return min(b1, b3) < 0 or (b2 < 0 and not b2**2 <= GIVES_WAY * b1 * b3)


@dataclass(frozen=True)
class Joint:
    """A joint from a parent link to a child link, whose frame sits at the joint.

    Attributes
    ----------
    name : str
        Name, unique among the joints of a robot.
    type : {"revolute", "continuous", "prismatic", "fixed", "screw", "ball", "universal", "cylindrical", "planar", ...}
        Kind of motion; the last is "free".  From "ball" on they have several degrees of freedom, which
        `Model.moving_joints` lists one by one.
    parent, child : str
        Names of the links.
    xyz : tuple of float
        Origin of the child frame in the parent frame, with the joint at zero [m].
    rpy : tuple of float
        Orientation of the child frame there: roll, pitch and yaw about fixed axes [rad].
    axis : tuple of float
        Axis of motion in the child frame, of unit length unless the joint is fixed; of a planar joint the normal of the
        plane.  Ball and free joints have none.
    lower, upper : float
        Limits of the position [rad or m]; of a ball joint `upper` limits the angle by which it is turned from its zero
        orientation, about whatever axis, below pi.
    effort, velocity : float
        Limits of the torque or force [N m or N] and of the velocity [rad/s or m/s].
    damping, friction : float
        Viscous damping [N m s/rad or N s/m] and Coulomb friction [N m or N].
    armature : float
        Inertia of what turns with the joint alone, such as a rotor [kg m^2 or kg].
    stiffness, spring_reference : float
        Stiffness of a spring at the joint [N m/rad or N/m], and the position at which it is slack [rad or m].  That of
        a ball joint turns it back about its rotation vector, and is slack in the zero orientation.
    quadratic_stiffness, cubic_stiffness : float
        Numbers b and c of a spring with the torque -(stiffness x + b x^2 + c x^3), x from the position at which it is
        slack [N m/rad^2 or N/m^2, N m/rad^3 or N/m^3].  It never gives way: b^2 <= 3 stiffness c.
    quadratic_damping, cubic_damping : float
        Numbers b and c of a damper with the torque -(damping + b |v| + c v^2) v [N m s^2/rad^2 or N s^2/m^2,
        N m s^3/rad^3 or N s^3/m^3].  It never weakens as the speed grows: b >= 0 or b^2 <= 3 damping c.
    mimic : Mimic or None
        Coupling to another joint.
    pitch : float
        How far a screw joint slides along its axis as it turns [m/rad].
    axis2 : tuple of float or None
        Second axis of a universal joint, in the child frame; None for one across the first.
    degrees : Mapping of str to Mapping of str to float
        What single degrees of a universal, cylindrical, planar or free joint have instead, such as limits and a spring:
        ``{"r1": {"lower": -0.5, "upper": 0.5, "stiffness": 2.0}}``.  It is kept as a tuple of pairs.

    Raises
    ------
    ValueError
        For values out of range; all problems of the joint are listed.
    """

    name: str
    type: JointType
    parent: str
    child: str
    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (1.0, 0.0, 0.0)
    lower: float = -math.inf
    upper: float = math.inf
    effort: float = quantity(">= 0 or inf", "SI", math.inf, "correct the value")
    velocity: float = quantity(">= 0 or inf", "SI", math.inf, "correct the value")
    damping: float = quantity(">= 0", "SI", 0.0, "correct the value")
    friction: float = quantity(">= 0", "SI", 0.0, "correct the value")
    armature: float = quantity(">= 0", "SI", 0.0, "correct the value")
    mimic: Mimic | None = None
    stiffness: float = quantity(">= 0", "SI", 0.0, "0 is no spring")
    spring_reference: float = quantity("finite", "rad or m", 0.0, "it is the position at which the spring is slack")
    pitch: float = quantity("finite", "m/rad", 0.0, "only a screw joint has one")
    axis2: Vector | None = None
    quadratic_stiffness: float = quantity("finite", "SI", 0.0, "0 is a linear spring")
    cubic_stiffness: float = quantity(">= 0", "SI", 0.0, "0 is a linear spring")
    quadratic_damping: float = quantity("finite", "SI", 0.0, "0 is a linear damper")
    cubic_damping: float = quantity(">= 0", "SI", 0.0, "0 is a linear damper")
    degrees: Mapping[str, Mapping[str, float]] | tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = ()

    __repr__ = brief

    def __post_init__(self) -> None:
        refuse(f"joint {self.name!r}", self._flaws(f"joint {self.name!r}"))
        freeze(self, "xyz", "rpy", "axis")
        if self.axis2 is not None:
            freeze(self, "axis2")
        each = ((name, dict(own).items()) for name, own in self._by_degree().items())
        object.__setattr__(self, "degrees", tuple((name, tuple((k, float(x)) for k, x in own)) for name, own in each))

    def _by_degree(self) -> dict[str, Any]:
        return dict(self.degrees)

    def _flaws_of_degrees(self, what: str) -> Iterator[str]:
        """Find what single degrees cannot have; their numbers are checked where the degrees are made."""
        give = "give {'r1': {'lower': -0.5, 'upper': 0.5}}"
        try:
            found = {name: dict(own) for name, own in self._by_degree().items()}
        except (TypeError, ValueError):
            yield f"{what}: degrees is {shown(self.degrees)}; expected numbers by degree and name: {give}"
            return
        known = SINGLE.get(self.type, ())
        for name, own in found.items():
            if name not in known:
                may = f"its single degrees are {quoted(known)}" if known else "it has no single degrees"
                yield f"{what}: degrees has {shown(name)}, and type {self.type!r}: {may}: correct it"
            for key, value in own.items():
                if key not in OF_DEGREES:
                    yield f"{what}: degree {name!r} has {shown(key)}; expected one of {quoted(OF_DEGREES)}: correct it"
                elif not is_real(value):
                    yield f"{what}: degree {name!r} has {key} {shown(value)}; expected a number: correct it"

    def _flaws(self, what: str) -> Iterator[str]:
        yield from name_flaws("joint", self.name)
        yield from choice_flaws(what, "type", self.type, get_args(JointType))
        for name in ("parent", "child"):
            if not isinstance(getattr(self, name), str):
                given = shown(getattr(self, name))
                yield f"{what}: {name} is {given}; expected the name of a link: write it in quotes"
        if self.mimic is not None and not isinstance(self.mimic, Mimic):
            yield f"{what}: mimic is {shown(self.mimic)}; expected a Mimic or None: give Mimic(joint)"
        if isinstance(self.parent, str) and isinstance(self.child, str) and self.parent == self.child:
            yield f"{what}: parent and child are both {self.child!r}; connect two different links"
        yield from vector_flaws(what, "xyz", self.xyz, 3)
        turned = list(vector_flaws(what, "rpy", self.rpy, 3))
        yield from turned or angle_flaws(what, "rpy", self.rpy)
        yield from vector_flaws(what, "axis", self.axis, 3)
        if not isinstance(self.type, str):
            return
        yield from self._flaws_of_several(what)
        yield from self._flaws_of_degrees(what)
        if self.type == "fixed":
            return
        if (
            self.type not in ("ball", "free")
            and not any(vector_flaws(what, "axis", self.axis, 3))
            and abs(math.hypot(*self.axis) - 1.0) > AXIS_TOLERANCE
        ):
            yield f"{what}: axis {self.axis!r} is not of unit length; divide it by its length"
        if not (is_real(self.lower) and is_real(self.upper)):
            yield f"{what}: limits lower {shown(self.lower)}, upper {shown(self.upper)}; expected numbers: correct them"
        elif not self.lower <= self.upper or self.lower == math.inf or self.upper == -math.inf:
            yield f"{what}: limits lower {self.lower!r}, upper {self.upper!r}; lower must be below upper: swap them"
        if self.type == "continuous" and (self.lower, self.upper) != (-math.inf, math.inf):
            yield f"{what}: type 'continuous' has limits {self.lower!r} to {self.upper!r}; use type 'revolute'"
        flaws = list(quantity_flaws(what, self))
        yield from flaws
        if not flaws and not self.quadratic_stiffness**2 <= GIVES_WAY * self.stiffness * self.cubic_stiffness:
            yield (
                f"{what}: its spring gives way somewhere: quadratic_stiffness is {self.quadratic_stiffness!r}, whose "
                f"square may be at most 3 stiffness cubic_stiffness, {3.0 * self.stiffness * self.cubic_stiffness!r}: "
                "lower it, or raise the others"
            )
        if not flaws and weakens(self.damping, self.quadratic_damping, self.cubic_damping):
            yield (
                f"{what}: its damper weakens as the speed grows: quadratic_damping is {self.quadratic_damping!r}; its "
                f"square may be at most 3 damping cubic_damping, {3.0 * self.damping * self.cubic_damping!r}, where it "
                "is negative: raise it, or the others"
            )

    def _flaws_of_several(self, what: str) -> Iterator[str]:
        """Find what a joint of several degrees of freedom, or one of one, cannot have."""
        if self.axis2 is not None:
            if self.type != "universal":
                yield f"{what}: axis2 is {shown(self.axis2)}; only a universal joint has one: leave it out"
            wrong = [*vector_flaws(what, "axis2", self.axis2, 3)]
            yield from wrong
            if not wrong and abs(math.hypot(*self.axis2) - 1.0) > AXIS_TOLERANCE:
                yield f"{what}: axis2 {self.axis2!r} is not of unit length; divide it by its length"
            elif not wrong and not any(vector_flaws(what, "axis", self.axis, 3)):
                across = sum(a * b for a, b in zip(self.axis, self.axis2))
                if abs(across) > 1.0 - AXIS_TOLERANCE:
                    yield f"{what}: axis and axis2 are parallel; give two axes of different direction"
        if self.type != "screw" and is_real(self.pitch) and self.pitch != 0.0:
            yield f"{what}: pitch is {shown(self.pitch)}; only a screw joint has one: use type 'screw', or 0"
        if self.type not in COMPOSITE:
            return
        real = is_real(self.lower) and is_real(self.upper)
        if self.type == "ball":
            if real and not (self.lower == -math.inf and (0.0 < self.upper < math.pi or self.upper == math.inf)):
                yield (
                    f"{what}: type 'ball' has limits {shown(self.lower)} to {shown(self.upper)}; expected no lower "
                    "one, and one of its angle above 0 and below pi: correct them"
                )
            if is_real(self.spring_reference) and self.spring_reference != 0.0:
                yield f"{what}: type 'ball' has spring_reference {shown(self.spring_reference)}; expected 0: remove it"
        elif real and (self.lower, self.upper) != (-math.inf, math.inf):
            yield (
                f"{what}: type {self.type!r} has limits {shown(self.lower)} to {shown(self.upper)}; expected none: "
                "give those of its single degrees in `degrees`"
            )
        if self.mimic is not None:
            yield f"{what}: type {self.type!r} follows a joint; only joints of one degree of freedom do: remove mimic"
        powers = self.quadratic_stiffness, self.cubic_stiffness
        if any(is_real(x) and x != 0.0 for x in powers):
            yield f"{what}: type {self.type!r} has a nonlinear spring; expected none: leave its numbers out"
        if self.type != "ball" and is_real(self.stiffness) and self.stiffness != 0.0:
            yield f"{what}: type {self.type!r} has stiffness {shown(self.stiffness)}; give it in `degrees`"


@dataclass(frozen=True)
class Spring:
    """A spring with a damper between points of two links: it pulls them together with K (l - l0) + C dl/dt.

    One of the links may be the root of a robot with a fixed base.  Implicit steps take its force at their end, so that
    a stiff spring does not limit them.

    Attributes
    ----------
    a, b : str
        Names of the links.
    point_a, point_b : tuple of float
        Where the spring is attached, in the frames of the links [m].
    stiffness : float
        Stiffness K [N/m].
    damping : float
        Damping C [N s/m].
    length : float
        Length l0 at which the spring is slack [m].
    """

    a: str
    b: str
    point_a: Vector = (0.0, 0.0, 0.0)
    point_b: Vector = (0.0, 0.0, 0.0)
    stiffness: float = quantity(">= 0", "N/m", 0.0, "0 is a damper alone")
    damping: float = quantity(">= 0", "N s/m", 0.0, "0 is a spring alone")
    length: float = quantity(">= 0", "m", 0.0, "it is the distance at which the spring is slack")

    __repr__ = brief

    def __post_init__(self) -> None:
        what = f"spring from link {self.a!r} to {self.b!r}"
        check(name_flaws("link", self.a), name_flaws("link", self.b))
        if self.a == self.b:
            raise ValueError(f"{what}: both points are on one link, which does not stretch; give two links")
        check(vector_flaws(what, "point_a", self.point_a, 3), vector_flaws(what, "point_b", self.point_b, 3))
        check(quantity_flaws(what, self))
        freeze(self, "point_a", "point_b")


class Leader(NamedTuple):
    """The joint that a coupled joint follows in the end: position = multiplier * (that of the leader) + offset."""

    joint: Joint
    multiplier: float  # [-, m/rad or rad/m]
    offset: float  # [rad or m]


def leader_of(joint: Joint, joints: Mapping[str, Joint], locked: Container[str] = ()) -> Leader:
    """Follow a chain of couplings to a joint that is free, fixed or locked; it may be the joint itself."""
    k, offset = 1.0, 0.0
    for _ in joints:  # no longer than a chain can be, even where it is a circle
        if joint.mimic is None or joint.type == "fixed" or joint.name in locked:
            break
        offset += k * joint.mimic.offset
        k *= joint.mimic.multiplier
        joint = joints[joint.mimic.joint]
    return Leader(joint, k, offset)
