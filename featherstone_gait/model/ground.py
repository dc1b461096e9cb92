"""The ground, and the points of a robot that can touch it."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from ..base.arguments import floats, instance, is_real, listed, whole
from ..base.brief import brief
from .checks import (
    FRICTION,
    LARGEST,
    angle_flaws,
    check,
    freeze,
    friction_flaws,
    name_flaws,
    number_flaws,
    quantity,
    quantity_flaws,
    vector_flaws,
)
from .links import AXIS_TOLERANCE, Vector
from .surface import Surface

MOST_STAIRS = 10**6


@dataclass(frozen=True)
class ContactPoint:
    """A part of a link that can touch the ground: a point, or the lowest point of a sphere or of a circle.

    A capsule is two spheres, a cylinder two circles; boxes and hulls are their corners.

    Attributes
    ----------
    link : str
        Name of the link.
    position : tuple of float
        The point, or the center of the sphere or circle, in the link's frame [m].
    radius : float
        Radius of the sphere; 0 for a point [m].
    circle_radius : float
        Radius of the circle, which is the rim of a disc a fiftieth of it thick; 0 for a point [m].
    axis : tuple of float
        Axis of the circle, of unit length, in the link's frame.
    load_bearing : bool
        Whether the point carries weight at rest; the stiffness of the ground follows from the weight on those that do.
    friction : float or None
        Coefficient of friction with the ground [-]; None: that of the `Ground`.
    roller_angle : float or None
        Of a wheel with rollers about its rim: the angle from the axis of the wheel to that of the roller on the ground,
        about the ground's normal [rad]: pi/2 of an omni wheel, pi/4 or -pi/4 of a mecanum wheel.  None: no rollers.
    roller_friction : float
        Coefficient of friction across the roller's axis, where the roller turns [-]; `friction` is that along it, and
        between both the largest force is an ellipse.
    surface : Surface or None
        How the surface of the link moves there, as that of a track; None: it rests.
    rolling_friction : float
        Of a sphere or circle: coefficient of the moment that resists rolling, by the normal force [m].
    """

    link: str
    position: Vector
    radius: float = quantity(">= 0", "m", 0.0, "it is the radius of a sphere")
    circle_radius: float = quantity(">= 0", "m", 0.0, "it is the radius of a circle about the axis")
    axis: Vector = (0.0, 0.0, 1.0)
    load_bearing: bool = True
    friction: float | None = None
    roller_angle: float | None = None
    roller_friction: float = quantity(">= 0", "-", 0.0, "0 is rollers that turn freely")
    surface: Surface | None = None
    rolling_friction: float = quantity(">= 0", "m", 0.0, "give the largest moment by the normal force, 0 for none")

    __repr__ = brief

    def __post_init__(self) -> None:
        what = f"contact point on link {self.link!r}"
        check(name_flaws("link", self.link))
        check(vector_flaws(what, "position", self.position, 3), vector_flaws(what, "axis", self.axis, 3))
        instance(f"{what}: load_bearing", self.load_bearing, (bool, np.bool_), "give True or False")
        freeze(self, "position", "axis")
        check(quantity_flaws(what, self), friction_flaws(what, self.friction))
        if self.surface is not None:
            instance(f"{what}: surface", self.surface, Surface, "give Surface(velocity=...), or None")
        if self.roller_angle is not None:
            remedy = "pi/2 is an omni wheel, pi/4 a mecanum wheel"
            check(number_flaws(what, "roller_angle", self.roller_angle, "finite", "rad", remedy))
            check(angle_flaws(what, "roller_angle", (self.roller_angle,)))
        elif self.roller_friction:
            given = f"roller_friction is {self.roller_friction!r}, and roller_angle None"
            raise ValueError(f"{what}: {given}: there are no rollers; give their angle, or leave it out")
        if self.rolling_friction > 0 and not (self.radius > 0 or self.circle_radius > 0):
            given = f"rolling_friction is {self.rolling_friction!r} m"
            raise ValueError(f"{what}: {given}, and a point does not roll; give its radius or circle_radius, or 0")
        round_ = self.circle_radius > 0 or self.roller_angle is not None
        if round_ and abs(math.hypot(*self.axis) - 1.0) > AXIS_TOLERANCE:
            raise ValueError(f"{what}: axis {self.axis!r} is not of unit length; divide it by its length")


@dataclass(frozen=True, eq=False)
class HeightField:
    """Heights over a grid, as a ground or as the shape of an obstacle.

    Under contact points it is bilinear between the nodes and level beyond the edge.  Between bodies each cell is two
    triangles, and the field ends at its edge.

    Attributes
    ----------
    heights : numpy.ndarray
        Heights (nx, ny) at x = origin[0] + i spacing[0], y = origin[1] + j spacing[1] [m].
    spacing : tuple of float
        Distance of the nodes along x and y [m].
    origin : tuple of float
        Place of heights[0, 0] in world axes, or in the frame of the shape [m].
    """

    heights: np.ndarray
    spacing: tuple[float, float]
    origin: tuple[float, float] = (0.0, 0.0)

    __repr__ = brief

    def __post_init__(self) -> None:
        heights = np.array(floats("height field: heights", self.heights, "give an array (nx, ny) [m]"))
        if heights.ndim != 2 or min(heights.shape) < 2 or not (np.abs(heights) <= LARGEST).all():
            raise ValueError(
                f"height field: heights have shape {heights.shape}; expected finite ones of 2 x 2 nodes or more: "
                "give an array (nx, ny) [m]"
            )
        heights.setflags(write=False)
        object.__setattr__(self, "heights", heights)
        for name in ("spacing", "origin"):
            check(vector_flaws("height field", name, getattr(self, name), 2))
            freeze(self, name)
        if not min(self.spacing) > 0:
            raise ValueError(f"height field: spacing is {self.spacing!r} m; expected > 0: give the distance of nodes")


@dataclass(frozen=True)
class FloorLine:
    """A dark line on the ground, which a `LineSensor` sees and nothing feels.

    Its corners are sharp, those of more than a right angle cut off; its ends are straight.

    Attributes
    ----------
    points : tuple of (float, float)
        x and y of the points that straight pieces of its middle join, seen from above [m].  A line whose last point is
        its first is closed.
    width : float
        Its width [m].

    Raises
    ------
    ValueError
        For fewer than two points, points that follow themselves, and numbers out of range.
    """

    points: tuple[tuple[float, float], ...]
    width: float = quantity("> 0", "m", 0.02, "0.02 is adhesive tape")

    __repr__ = brief

    def __post_init__(self) -> None:
        check(quantity_flaws("floor line", self))
        points = listed("floor line: points", self.points, "give x and y of each [m]")
        check(*(vector_flaws("floor line", "point", point, 2) for point in points))
        points = [tuple(float(x) for x in point) for point in points]
        if len(points) < 2:
            raise ValueError(f"floor line: points has {len(points)}; expected 2 or more: give both ends")
        for k, (one, other) in enumerate(itertools.pairwise(points)):
            if one == other:
                raise ValueError(f"floor line: points {k} and {k + 1} are both {one}; leave one of them out")
        object.__setattr__(self, "points", tuple(points))


@dataclass(frozen=True)
class Ground:
    """Ground under the contact points, described by quantities that can be measured.

    `compile_scene` derives stiffness and damping from them.  The ground is a plane that may be tilted and have steps,
    or a height field.  Steps are vertical rises that begin at a given distance along the slope, in the direction
    `heading`; their faces exert no force.

    Attributes
    ----------
    friction : float
        Coefficient of friction [-]; the default is SimTwo's.
    penetration : float
        Depth to which a robot that stands on all its load-bearing contact points sinks in [m]; without gravity under
        its weight on Earth, so that this is how to state the stiffness there.
    damping_ratio : float
        Damping ratio of small motions about rest; 1 is critical [-].
    height : float
        Height at the world's origin [m].
    slope : float
        Angle at which the ground rises along `heading` [rad].
    steps : tuple of (float, float)
        Distance along the slope and rise of each step [m].
    heading : float
        Direction of slope and steps, about z from x [rad].
    field : HeightField or None
        Heights above a level plane without steps.
    velocity : tuple of float
        Velocity of the surface, as of a belt, along the slope in the direction `heading` and across it, to the left
        [m/s].  The ground stays where it is.
    turning : float
        Angular velocity of the surface, as of a turntable, about the normal through `center` [rad/s].
    center : tuple of float
        x and y of the point about which it turns, where its velocity is `velocity` [m].
    lines : tuple of FloorLine
        Dark lines for sensors; they stay where they are, also on a surface that moves.

    Raises
    ------
    ValueError
        For numbers out of range, and for a height field together with slope, steps or heading.
    """

    friction: float = quantity(">= 0", "-", 0.95, FRICTION)
    penetration: float = quantity("> 0", "m", 5e-4, "0.0005 suits a small robot")
    damping_ratio: float = quantity(">= 0", "-", 0.7, "0.7 hardly bounces")
    height: float = quantity("finite", "m", 0.0, "0 is the world's origin")
    slope: float = 0.0
    steps: tuple[tuple[float, float], ...] = ()
    heading: float = quantity("finite", "rad", 0.0, "0 is along x")
    field: HeightField | None = None
    velocity: tuple[float, float] = (0.0, 0.0)
    turning: float = quantity("finite", "rad/s", 0.0, "0 is no turntable")
    center: tuple[float, float] = (0.0, 0.0)
    lines: tuple[FloorLine, ...] = ()

    __repr__ = brief

    @property
    def moves(self) -> bool:
        """Return whether the surface moves."""
        return any(self.velocity) or self.turning != 0.0

    def __post_init__(self) -> None:
        check(quantity_flaws("ground", self))
        for name in ("velocity", "center"):
            check(vector_flaws("ground", name, getattr(self, name), 2))
            freeze(self, name)
        if not (is_real(self.slope) and abs(self.slope) < 0.5 * math.pi):
            raise ValueError(
                f"ground: slope {self.slope!r} rad; it must lie between -pi/2 and pi/2: give it in radians"
            )
        check(angle_flaws("ground", "heading", (self.heading,)))
        steps = listed("ground: steps", self.steps, "give (distance, rise) of each [m]")
        check(*(vector_flaws("ground", "step", step, 2) for step in steps))
        object.__setattr__(self, "steps", tuple(tuple(float(x) for x in step) for step in steps))
        lines = listed("ground: lines", self.lines, "give a list of FloorLine")
        for line in lines:
            instance("ground: lines", line, FloorLine, "give FloorLine(points, width) of each")
        object.__setattr__(self, "lines", tuple(lines))
        if self.field is not None and not isinstance(self.field, HeightField):
            raise ValueError(
                f"ground: field is {type(self.field).__name__}; expected a HeightField: make one of the array"
            )
        if self.field is not None and (self.slope or self.steps or self.heading):
            raise ValueError("ground: a height field has no slope, steps or heading besides; put them into its heights")
        if self.field is not None and self.moves:
            raise ValueError("ground: the surface of a height field does not move; leave out velocity and turning")


def stairs(count: int, depth: float, rise: float, start: float = 0.0) -> tuple[tuple[float, float], ...]:
    """Return the steps of a `Ground` that make stairs.

    Parameters
    ----------
    count : int
        Number of steps.
    depth : float
        Distance between two rises [m].
    rise : float
        Height of each step [m].
    start : float, optional
        Distance at which the first step rises [m].

    Returns
    -------
    tuple of (float, float)
        Distance and rise of each step, for ``Ground(steps=...)``.

    Raises
    ------
    ValueError
        For a negative count, a depth that is not above zero and numbers that are not finite.
    """
    count = whole("stairs: count", count, 0, "give the number of steps", MOST_STAIRS)
    check(number_flaws("stairs", "depth", depth, "> 0", "m", "give the distance of two rises"))
    check(*(number_flaws("stairs", *item, "finite", "m", "correct it") for item in (("rise", rise), ("start", start))))
    return tuple((start + k * depth, rise) for k in range(count))
