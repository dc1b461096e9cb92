"""A fluid around a robot, and what of the robot it acts on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from ..base.arguments import floats, instance, is_real, shown, truth, vector
from ..base.brief import brief
from ..base.flaws import quoted
from .checks import (
    LARGEST,
    check,
    choice_flaws,
    freeze,
    name_flaws,
    number_flaws,
    quantity,
    quantity_flaws,
    vector_flaws,
)
from .links import Joint, Vector
from .shapes import Box, Capsule, Cylinder, Geometry, Hull, Mesh, Sphere

FluidLaw = Literal["smooth", "box", "ellipsoid"]
LAWS = get_args(FluidLaw)
COEFFICIENTS = ("drag", "turning_drag", "linear_damping", "turning_damping", "added_mass", "added_inertia")
MUJOCO_COEFFICIENTS = (0.5, 0.25, 1.5, 1.0, 1.0)  # MuJoCo's default `fluidcoef`


@dataclass(frozen=True)
class Fluid:
    """A fluid at rest or in even motion: water with a surface, or air.

    It acts on what `Model.immersed` lists.

    Attributes
    ----------
    density : float
        Density [kg/m^3].
    viscosity : float
        Dynamic viscosity [Pa s].
    level : float or None
        Height of the surface over the world's origin, against gravity [m]; None: the fluid is everywhere.
    current : tuple of float
        Velocity (3,) of the fluid, as of a current or of wind [m/s].

    Raises
    ------
    ValueError
        For numbers out of range.
    """

    density: float = quantity(">= 0", "kg/m^3", 1000.0, "1000 is water, 1.2 air")
    viscosity: float = quantity(">= 0", "Pa s", 0.0, "1e-3 is water, 1.8e-5 air")
    level: float | None = None
    current: Vector = (0.0, 0.0, 0.0)

    __repr__ = brief

    def __post_init__(self) -> None:
        check(quantity_flaws("fluid", self), vector_flaws("fluid", "current", self.current, 3))
        if self.level is not None:
            check(number_flaws("fluid", "level", self.level, "finite", "m", "give a height, or None"))
        freeze(self, "current")


@dataclass(frozen=True)
class Immersed:
    """A shape of a link on which a fluid acts: by buoyancy, drag and added mass.

    Coefficients are numbers, or three along the shape's axes.  With the law "smooth" the drag along an axis i is
    1/2 density drag_i A_i u_i |u_i|, A_i the shape's outline seen along it, and between the axes a smooth function of
    the direction; "box" and "ellipsoid" are MuJoCo's laws, which know no buoyancy and read no other coefficients.

    Attributes
    ----------
    link : str
        Name of the link.
    geometry : Sphere, Box, Cylinder, Capsule, Hull or Mesh
        The shape; a mesh is its convex hull.  Of the law "ellipsoid" a box, whose edges are the ellipsoid's axes.
    xyz : tuple of float
        Center in the link's frame [m].
    rpy : tuple of float
        Orientation in the link's frame: roll, pitch and yaw about fixed axes [rad].
    name : str
        Name; may be empty.
    drag : float or tuple of float
        Coefficients of drag C [-]: 0.47 of a sphere, 1.05 of a cube.
    turning_drag : float or tuple of float
        The same of the moment 1/2 density C r^5 w |w|, r the radius of the ball of the shape's volume [-].
    stokes : float
        Factor of the viscous drag 6 pi viscosity r u and moment 8 pi viscosity r^3 w, 1 of a sphere [-].
    linear_damping, turning_damping : float or tuple of float
        Drag by speed [N s/m] and moment by angular velocity [N m s], whatever the fluid.
    added_mass : float or tuple of float
        Added mass by the mass of fluid in the shape's volume [-]: 0.5 of a sphere.
    added_inertia : float or tuple of float
        Added inertia by that mass times r^2 [-].
    added_matrix : tuple of tuple of float or None
        Added mass (6, 6) in place of both, of forces along and moments about the shape's axes, symmetric
        [kg, kg m, kg m^2].
    buoyant : bool
        Whether buoyancy acts.
    law : {"smooth", "box", "ellipsoid"}
        Law of the drag.
    fluidcoef : tuple of float
        Coefficients (5,) of MuJoCo's ellipsoids: blunt drag, slender drag, angular drag, Kutta lift, Magnus lift [-].

    Raises
    ------
    ValueError
        For values out of range.
    """

    link: str
    geometry: Geometry
    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    name: str = ""
    drag: float | Vector = 0.0
    turning_drag: float | Vector = 0.0
    stokes: float = quantity(">= 0", "-", 1.0, "1 is that of a sphere")
    linear_damping: float | Vector = 0.0
    turning_damping: float | Vector = 0.0
    added_mass: float | Vector = 0.0
    added_inertia: float | Vector = 0.0
    added_matrix: tuple[tuple[float, ...], ...] | None = None
    buoyant: bool = True
    law: FluidLaw = "smooth"
    fluidcoef: tuple[float, ...] = MUJOCO_COEFFICIENTS

    __repr__ = brief

    def __post_init__(self) -> None:
        instance("immersed: link", self.link, str, "give the name of its link")
        what = f"immersed shape on link {self.link!r}"
        kinds = (Sphere, Box, Cylinder, Capsule, Hull, Mesh)
        instance(f"{what}: geometry", self.geometry, kinds, "give a Sphere, Box, Cylinder, Capsule, Hull or Mesh")
        instance(f"{what}: name", self.name, str, "give a text")
        truth(f"{what}: buoyant", self.buoyant)
        check(choice_flaws(what, "law", self.law, LAWS), quantity_flaws(what, self), self._coefficient_flaws(what))
        for name, size in (("xyz", 3), ("rpy", 3), ("fluidcoef", 5)):
            check(vector_flaws(what, name, getattr(self, name), size))
        if min(self.fluidcoef) < 0:
            raise ValueError(f"{what}: fluidcoef is {self.fluidcoef!r} [-]; expected numbers >= 0: correct them")
        freeze(self, "xyz", "rpy", "fluidcoef")
        self._check_law(what)
        if self.added_matrix is not None:
            object.__setattr__(self, "added_matrix", _added_matrix(what, self.added_matrix))

    def _coefficient_flaws(self, what: str) -> Iterator[str]:
        for name in COEFFICIENTS:
            value: Any = getattr(self, name)
            numbers = [value] * 3 if is_real(value) else vector(f"{what}: {name}", value, 3).tolist()
            unit = {"linear_damping": "N s/m", "turning_damping": "N m s"}.get(name, "-")
            for number in dict.fromkeys(numbers):
                yield from number_flaws(what, name, number, ">= 0", unit, "give a number, or three for the axes")
            object.__setattr__(self, name, float(value) if is_real(value) else tuple(map(float, value)))

    def _check_law(self, what: str) -> None:
        given = [name for name in COEFFICIENTS if self.along_axes(name) != (0.0, 0.0, 0.0)]
        given += ["added_matrix"] * (self.added_matrix is not None)
        if self.law != "smooth" and given:
            raise ValueError(f"{what}: the law {self.law!r} does not read {quoted(given)}: leave them out")
        if self.law != "smooth" and (self.buoyant or not isinstance(self.geometry, Box)):
            raise ValueError(f"{what}: the law {self.law!r} takes a Box, and buoyant=False: write these")
        if self.law != "smooth" and self.stokes != 1.0:
            raise ValueError(f"{what}: the law {self.law!r} does not read stokes, here {self.stokes!r}: leave it out")
        if self.law != "ellipsoid" and self.fluidcoef != MUJOCO_COEFFICIENTS:
            raise ValueError(f"{what}: fluidcoef is of the law 'ellipsoid', and its law is {self.law!r}: leave it out")

    def along_axes(self, name: str) -> tuple[float, float, float]:
        """Return a coefficient along the three axes."""
        value: Any = getattr(self, name)
        return (value, value, value) if is_real(value) else value


def _added_matrix(what: str, given: Any) -> tuple[tuple[float, ...], ...]:
    """Return the matrix as tuples; raise ValueError unless it is one of inertia."""
    matrix = floats(f"{what}: added_matrix", given)
    if matrix.shape != (6, 6) or not (np.abs(matrix) <= LARGEST).all():
        raise ValueError(f"{what}: added_matrix has the shape {matrix.shape}; expected finite numbers (6, 6)")
    size = np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > 1e-9 * size or np.linalg.eigvalsh(matrix).min() < -1e-9 * size:
        raise ValueError(
            f"{what}: added_matrix {shown(matrix.tolist())} is no inertia; expected a symmetric matrix without "
            "negative eigenvalues: correct it"
        )
    return tuple(map(tuple, (0.5 * (matrix + matrix.T)).tolist()))


@dataclass(frozen=True)
class Propeller:
    """A propeller, wheel of paddles or fan that a joint turns: thrust along the joint's axis, and a moment about it.

    At the joint speed w the medium pushes the joint's child with thrust w |w| + linear_thrust w along the axis, at the
    joint, and holds it with torque w |w|.  The joint's servo, or a torque from outside, commands the propeller.

    Attributes
    ----------
    joint : str
        Name of the joint, which turns.
    thrust : float
        Thrust by the square of the speed [N s^2/rad^2]; negative where turning forward pushes backward.
    torque : float
        Moment by the square of the speed [N m s^2/rad^2].
    linear_thrust : float
        Thrust by the speed itself, as SimTwo's propellers have it [N s/rad].

    Raises
    ------
    ValueError
        For values out of range.
    """

    joint: str
    thrust: float
    torque: float = quantity(">= 0", "N m s^2/rad^2", 0.0, "it opposes the turning")
    linear_thrust: float = quantity("finite", "N s/rad", 0.0, "give the thrust by the speed, 0 for the square alone")

    __repr__ = brief

    def __post_init__(self) -> None:
        check(name_flaws("joint", self.joint))
        what = f"propeller of joint {self.joint!r}"
        remedy = "give the thrust by the square of the speed"
        check(number_flaws(what, "thrust", self.thrust, "finite", "N s^2/rad^2", remedy), quantity_flaws(what, self))


def check_propellers(joints: Iterable[Joint], propellers: Iterable[Propeller]) -> None:
    """Raise ValueError unless all propellers have joints that turn, each its own."""
    kinds, seen = {joint.name: joint.type for joint in joints}, set[str]()
    turning = [name for name, kind in kinds.items() if kind in ("revolute", "continuous")]
    for one in propellers:
        if one.joint not in turning:
            what = f"is of type {kinds[one.joint]!r}" if one.joint in kinds else "does not exist"
            raise ValueError(f"propeller: joint {one.joint!r} {what}; joints that turn are {quoted(turning)}: use one")
        if one.joint in seen:
            raise ValueError(f"propeller: joint {one.joint!r} has two; add their numbers in one")
        seen.add(one.joint)
