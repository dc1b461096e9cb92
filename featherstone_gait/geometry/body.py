"""Make a model of one solid body."""

from __future__ import annotations

from collections.abc import Sequence

from ..base.arguments import instance, real
from ..model import LARGEST, Base, HeightField, Link, Model, Surface
from ..model.checks import check, choice_flaws, name_flaws, vector_flaws
from ..model.shapes import Box, Capsule, Cylinder, Geometry, Hull, Mesh, Shape, Sphere
from .contact_choice import with_contacts
from .solid import solid_of

LINK = "body"  # name of the one link


def body(
    shape: Geometry,
    mass: float = 0.0,
    name: str = "body",
    base: Base = "floating",
    *,
    inertia: Sequence[float] | None = None,
    center_of_mass: Sequence[float] | None = None,
    friction: float | None = None,
    torsional_friction: float | None = None,
    rolling_friction: float | None = None,
    surface: Surface | None = None,
) -> Model:
    """Make a free object, or an obstacle, of one shape.

    The model has one link, "body", whose frame is that of the shape.  Its mass is spread evenly over the solid shape,
    and contact points touch the ground: a box by its corners, a sphere and a capsule exactly, a cylinder by its end
    circles, a hull or mesh by at most 32 corners.

    Parameters
    ----------
    shape : Sphere, Capsule, Cylinder, Box, Hull, Mesh or HeightField
        The shape; a height field has a fixed base.
    mass : float
        Mass [kg]; above 0 for a floating base.
    name : str, optional
        Name of the model.
    base : {"floating", "fixed"}, optional
        "fixed" for an obstacle, which has no contact points.
    inertia : sequence of float, optional
        Inertia about the center of mass: ixx, ixy, ixz, iyy, iyz, izz [kg m^2].
    center_of_mass : sequence of float, optional
        Center of mass (3,) in the shape's frame [m].
    friction : float, optional
        Coefficient of friction [-]; None: with the ground that of the `Ground`, between bodies that of `PairContact`.
    torsional_friction, rolling_friction : float, optional
        Coefficients of the moments between bodies that resist spinning and rolling [m]; None: those of `PairContact`.
        On the ground the rolling one counts alone, and None is 0.
    surface : Surface, optional
        How its surface moves, as that of a belt or turntable; None: it rests.

    Returns
    -------
    Model
        The object; put it into a scene with `Placed`.

    Raises
    ------
    ValueError
        For a mass, inertia or center out of range, and for a shape without volume that is to move.
    ImportError
        For meshes whose reader is not installed.

    Examples
    --------
    >>> body(Box((0.1, 0.1, 0.1)), mass=0.2, name="cube")
    <robot cube: floating base, 0.2 kg, 8 contact points, 1 shapes>
    """
    kinds = (Sphere, Capsule, Cylinder, Box, Mesh, Hull, HeightField)
    instance("body: shape", shape, kinds, "give a Sphere, Capsule, Cylinder, Box, Mesh, Hull or HeightField")
    check(name_flaws("body", name), choice_flaws(f"body {name!r}", "base", base, ("floating", "fixed")))
    mass = real(f"body {name!r}: mass", mass, 0.0, LARGEST, "give its mass [kg]")
    if base == "floating" and not mass > 0:
        raise ValueError(f"body {name!r}: mass is {mass!r} kg; what moves has one > 0: give mass=, or base='fixed'")
    if base == "floating" and isinstance(shape, HeightField):
        raise ValueError(f"body {name!r}: a height field is an obstacle, and has no mass: give base='fixed'")
    solid = solid_of(shape)
    if base == "floating" and inertia is None and not solid.volume > 0:
        raise ValueError(
            f"body {name!r}: {shape!r} has no volume over which to spread its mass; give it an extent in all "
            "directions, or state inertia="
        )
    for field, value, size in (("inertia", inertia, 6), ("center_of_mass", center_of_mass, 3)):
        check(() if value is None else vector_flaws(f"body {name!r}", field, value, size))  # type: ignore[arg-type]
    link = Link(
        LINK,
        mass,
        solid.center if center_of_mass is None else tuple(center_of_mass),  # type: ignore[arg-type]
        tuple(mass * moment for moment in solid.moments) if inertia is None else tuple(inertia),
    )
    more = torsional_friction, rolling_friction
    one = Shape(LINK, shape, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "", friction, *more, surface)
    model = Model(name, (link,), (), base, shapes=(one,))
    return with_contacts(model, "all") if base == "floating" else model
