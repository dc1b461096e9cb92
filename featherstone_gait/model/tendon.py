"""Tendons: lengths that joints or points of links make, with springs, dampers, limits and drives along them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias, get_args

from ..base.arguments import is_real, listed, shown
from ..base.brief import brief
from ..base.flaws import quoted
from .checks import (
    LARGEST,
    allowed,
    check,
    choice_flaws,
    freeze,
    name_flaws,
    number_flaws,
    quantity,
    quantity_flaws,
    refuse,
    vector_flaws,
)
from .links import Joint, Link, Spring, Vector
from .servo import TORQUE_LAWS, Controller

Moment: TypeAlias = tuple[str, float]
WrapShape = Literal["sphere", "cylinder"]


def _link_flaws(link: str | None) -> Iterable[str]:
    return () if link is None else name_flaws("link", link)


@dataclass(frozen=True)
class Via:
    """A point of a link through which a tendon runs.

    Attributes
    ----------
    link : str or None
        Name of the link; None for the world.
    point : tuple of float
        The point (3,) in the frame of the link, or in the world [m].
    share : float
        Share of the distance from the point before in the tendon's length; 0 begins a new piece.  That of the first
        point plays no part.
    """

    link: str | None = None
    point: Vector = (0.0, 0.0, 0.0)
    share: float = quantity(">= 0", "-", 1.0, "0 begins a new piece of the tendon")

    __repr__ = brief

    def __post_init__(self) -> None:
        what = f"via point on link {self.link!r}"
        check(_link_flaws(self.link), vector_flaws(what, "point", self.point, 3), quantity_flaws(what, self))
        freeze(self, "point")


@dataclass(frozen=True)
class Wrap:
    """A sphere or a cylinder around which a tendon runs on its way from the point before to the point after.

    Attributes
    ----------
    link : str or None
        Name of the link; None for the world.
    shape : {"sphere", "cylinder"}
        Kind of shape; a cylinder has no ends.
    radius : float
        Radius [m].
    point : tuple of float
        The center (3,), or a point of the axis, in the frame of the link [m].
    axis : tuple of float
        Axis (3,) of a cylinder there, of any length.
    side : tuple of float or None
        A point (3,) in the frame of the link [m].  Outside of the shape, the tendon runs round on its side; within, the
        tendon runs through the shape as through a ring.  None: the tendon takes the shorter way.
    """

    link: str | None
    shape: WrapShape
    radius: float = field(metadata=allowed("> 0", "m"))
    point: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (0.0, 0.0, 1.0)
    side: Vector | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        what = f"wrap on link {self.link!r}"
        vectors = {"point": self.point, "axis": self.axis} | ({} if self.side is None else {"side": self.side})
        check(
            _link_flaws(self.link),
            choice_flaws(what, "shape", self.shape, get_args(WrapShape)),
            number_flaws(what, "radius", self.radius, "> 0", "m", "correct it"),
            *(vector_flaws(what, name, value, 3) for name, value in vectors.items()),
        )
        freeze(self, *vectors)
        if not math.hypot(*self.axis) > 0.0:
            raise ValueError(f"{what}: axis {self.axis!r} has no length; give a direction such as (0, 0, 1)")
        if self.shape == "sphere" and self.axis != (0.0, 0.0, 1.0):
            raise ValueError(f"{what}: axis is {self.axis!r}, and a sphere has none: leave it out, or use 'cylinder'")


@dataclass(frozen=True)
class Tendon:
    """A tendon, whose length depends on several joints, with what acts along it: a spring, friction, limits, a drive.

    The length is the sum of joint positions times coefficients (a fixed tendon), of the distances of points that
    follow each other (a spatial one), or of both: a joint with the coefficient r is a drum of the radius r that winds
    up what the path leaves, and a servo on that joint pulls it.  A force f along it, positive where it lengthens, turns
    each joint with the torque coefficient * f, and pulls the points apart.

    Attributes
    ----------
    name : str
        Name, unique among the tendons of a robot.
    joints : tuple of (str, float)
        Joints and their coefficients [-, or m/rad where the length is one].
    path : tuple of Via or Wrap
        Points in their order, and between two of them shapes around which it runs.
    stiffness : float
        Stiffness K of the spring: f = K (rest - length) [N/m, or N m/rad where the length is an angle].
    damping : float
        Damping C: f = -C dl/dt [N s/m or N m s/rad].
    rest : float or tuple of float
        Length at which the spring is slack, or the two ends of a range in which it is [m or rad].
    lower, upper : float
        Limits of the length [m or rad], with stops like those of joints.
    friction : float
        Coulomb friction along the length [N or N m]: it holds the length, or opposes its change.
    armature : float
        Inertia m along the length, such as that of what it turns, with the energy m (dl/dt)^2 / 2 [kg or kg m^2]; not
        of a tendon around shapes.
    controller : Controller, optional
        Torque law ("pd" or "pd_clamped") of a drive that pulls along the tendon, with the length l in place of an
        angle: f = Kp (reference - l) - Kd dl/dt, within `torque_limit` [N or N m].  The columns of `reference` and
        `tau` in `simulate` are the joints, then the tendons that have a controller.  With gains of zero it is a motor,
        whose force is what `tau` says.

    Raises
    ------
    ValueError
        For values out of range; all problems of the tendon are listed.
    """

    name: str
    joints: tuple[Moment, ...] = ()
    path: tuple[Via | Wrap, ...] = ()
    stiffness: float = quantity(">= 0", "N/m or N m/rad", 0.0, "0 is no spring")
    damping: float = quantity(">= 0", "N s/m or N m s/rad", 0.0, "0 is no damper")
    rest: float | tuple[float, float] = (0.0, 0.0)
    lower: float = -math.inf
    upper: float = math.inf
    controller: Controller | None = None
    friction: float = quantity(">= 0", "N or N m", 0.0, "0 is no friction")
    armature: float = quantity(">= 0", "kg or kg m^2", 0.0, "0 is no inertia")

    __repr__ = brief

    def __post_init__(self) -> None:
        what = f"tendon {self.name!r}"
        object.__setattr__(self, "joints", tuple(listed(f"{what}: joints", self.joints, "give (name, coefficient)")))
        object.__setattr__(self, "path", tuple(listed(f"{what}: path", self.path, "give a list of Via")))
        if is_real(self.rest):
            object.__setattr__(self, "rest", (float(self.rest), float(self.rest)))  # type: ignore[arg-type]
        refuse(what, self._flaws(what))
        object.__setattr__(self, "joints", tuple((name, float(c)) for name, c in self.joints))
        freeze(self, "rest")

    @property
    def slack(self) -> tuple[float, float]:
        """Range of lengths in which the spring is slack [m or rad]."""
        return self.rest  # type: ignore[return-value]

    @property
    def acts(self) -> bool:
        """Return whether the tendon has a spring, a damper, friction, inertia, a limit or a drive."""
        numbers = self.stiffness, self.damping, self.friction, self.armature
        return any(numbers) or self.limited or self.driven

    @property
    def driven(self) -> bool:
        """Return whether the tendon has a drive."""
        return self.controller is not None

    @property
    def limited(self) -> bool:
        """Return whether the length has a limit."""
        return self.lower > -math.inf or self.upper < math.inf

    def _flaws(self, what: str) -> Iterator[str]:
        yield from name_flaws("tendon", self.name)
        if not (self.joints or self.path):
            remedy = "give one of them, joints=[('elbow', 0.02)] or path=[Via(...)]"
            yield f"{what}: has neither joints nor a path; {remedy}"
        yield from self._joint_flaws(what)
        if self.path and not all(isinstance(one, Via | Wrap) for one in self.path):
            yield f"{what}: path is {shown(self.path)}; expected points: give a list of Via"
        elif any(isinstance(one, Wrap) and not self._joins(k) for k, one in enumerate(self.path)):
            yield f"{what}: a Wrap of path stands between no two points; put it between two Via that have a distance"
        elif self.path and not any(isinstance(one, Via) and one.share > 0 for one in self.path[1:]):
            yield f"{what}: path has no length; give two points or more, with a share above 0 of the second"
        elif self.path and isinstance(self.path[0], Via) and self.path[0].share not in (0.0, 1.0):
            yield f"{what}: share of the first point is {self.path[0].share!r}; no point is before it: leave it out"
        yield from quantity_flaws(what, self)
        unfit = list(vector_flaws(what, "rest", self.rest, 2))  # type: ignore[arg-type]
        yield from unfit
        if not unfit and not self.slack[0] <= self.slack[1]:
            yield f"{what}: rest is {self.rest!r}; expected a length, or a range that rises: swap the two"
        if not (is_real(self.lower) and is_real(self.upper)):
            yield f"{what}: limits lower {shown(self.lower)}, upper {shown(self.upper)}; expected numbers: correct them"
        elif not self.lower < self.upper or self.lower == math.inf or self.upper == -math.inf:
            yield f"{what}: limits lower {self.lower!r}, upper {self.upper!r}; lower must be below upper: correct them"
        if self.armature and any(isinstance(one, Wrap) for one in self.path):
            yield f"{what}: armature is {self.armature!r}, and its path has a Wrap; leave one of them out"
        if self.controller is not None:
            yield from self._controller_flaws(what)

    def _controller_flaws(self, what: str) -> Iterator[str]:
        law = self.controller
        if not isinstance(law, Controller):
            yield f"{what}: controller is {shown(law)}; expected a Controller: give Controller('pd', Kp, Kd=Kd)"
        elif law.law not in TORQUE_LAWS:
            yield f"{what}: its controller has the law {law.law!r}; expected one of {quoted(TORQUE_LAWS)}: use one"
        elif law.wrap:
            yield f"{what}: its controller has wrap=True, and a length is no angle that turns: leave wrap out"

    def _joins(self, k: int) -> bool:
        """Return whether the element before and the one after are points with a distance that counts."""
        around = (self.path[k - 1], self.path[k + 1]) if 0 < k < len(self.path) - 1 else ()
        return len(around) == 2 and all(isinstance(one, Via) for one in around) and around[1].share > 0  # type: ignore[union-attr]

    def _joint_flaws(self, what: str) -> Iterator[str]:
        for one in self.joints:
            pair: Any = one
            listing = isinstance(pair, tuple | list) and len(pair) == 2
            if not (listing and isinstance(pair[0], str) and is_real(pair[1])):
                yield f"{what}: joints has {shown(pair)}; expected a name and a coefficient: write ('elbow', 0.02)"
            elif not 1.0 / LARGEST <= abs(pair[1]) <= LARGEST:
                given = f"coefficient of joint {pair[0]!r} is {pair[1]!r}"
                yield f"{what}: {given}; expected a number other than 0: correct it"
        names = Counter(one[0] for one in self.joints if isinstance(one, tuple | list) and one)
        for name, count in names.items():
            if count > 1:
                yield f"{what}: joint {name!r} is given {count} times; add its coefficients to one"


def check_tendons(links: Iterable[Link], joints: Iterable[Joint], tendons: Iterable[Tendon]) -> None:
    """Raise ValueError unless links and joints of all tendons exist, and no two tendons have one name.

    joints: of one degree of freedom each.
    """
    names, tendons = [link.name for link in links], list(tendons)
    single = {joint.name: joint.type for joint in joints}
    movable = [name for name, kind in single.items() if kind not in ("fixed", "ball")]
    for name, count in Counter(tendon.name for tendon in tendons).items():
        if count > 1:
            raise ValueError(f"tendon name {name!r} is used {count} times; give every tendon its own name")
    for tendon in tendons:
        for name, _ in tendon.joints:
            if name not in movable:
                what = f"is of type {single[name]!r}" if name in single else "does not exist"
                raise ValueError(
                    f"tendon {tendon.name!r}: joint {name!r} {what}; joints of one degree of freedom that move are "
                    f"{quoted(movable)}: use one of them"
                )
        for via in tendon.path:
            if via.link is not None and via.link not in names:
                raise ValueError(
                    f"tendon {tendon.name!r}: there is no link {via.link!r}; links are {quoted(names)}: use one of them"
                )


def ball_limit(joint: Joint) -> Tendon:
    """Return the limit of a ball joint as a tendon, whose length is the angle by which the joint is turned."""
    return Tendon(joint.name, ((joint.name, 1.0),), upper=joint.upper)


def spring_tendon(spring: Spring) -> Tendon:
    """Return a spring between two links as a tendon."""
    path = (Via(spring.a, spring.point_a), Via(spring.b, spring.point_b))
    return Tendon(
        f"{spring.a} - {spring.b}", (), path, spring.stiffness, spring.damping, (spring.length, spring.length)
    )
