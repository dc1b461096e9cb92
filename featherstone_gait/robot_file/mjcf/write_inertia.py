"""Inertias that MuJoCo takes: of each link, or together of links that move as one.

MuJoCo refuses a `fullinertia` with a principal moment below 1e-14 kg m^2, any inertia with A + B < C to the last bit,
and a body that moves with a mass or a moment below 1e-15.  Where rounding would decide, the principal moments are
written in their place.
"""

from __future__ import annotations

import numpy as np

from ...fixed_order import applied, product
from ...model import Link, Model, Placement, RigidBody, inertia_matrix, rigid_bodies
from ...rotation import rpy_from_rotation
from .element import element, number, numbers

LEAST = 1e-15  # mass and moment of inertia of what moves [kg, kg m^2]
PLAIN = 1e-13  # smallest moment of a `fullinertia` [kg m^2]
MARGIN = 1e-9  # relative, of a `fullinertia` from what is refused
ROUNDING = 1e-13  # relative, by which moments may miss what is asked


def inertials(model: Model) -> tuple[dict[str, str], list[str]]:
    """The inertial of each link that has one, and the links of a fixed base whose inertia MuJoCo would refuse.

    Raises ValueError for what moves with an inertia that no body has.
    """
    links = {link.name: link for link in model.links}
    bodies, placements = rigid_bodies(model)
    lines: dict[str, str] = {}
    left: list[str] = []
    for row, body in enumerate(bodies):
        heavy = [links[name] for name in body.links if links[name].mass or any(links[name].inertia)]
        found = _each(heavy)
        if found is None:
            found = _together(body, placements[body.links[0]])
        if found is None and (row or model.base == "floating"):
            raise ValueError(_refusal(body, heavy))
        lines |= found or {}
        left += [] if found is not None else [link.name for link in heavy]
    return lines, left


def _each(links: list[Link]) -> dict[str, str] | None:
    """An inertial for every link; None if there is none for one of them."""
    lines = {link.name: _inertial(link.mass, link.center_of_mass, inertia_matrix(link.inertia)) for link in links}
    return None if None in lines.values() else {name: line for name, line in lines.items() if line}


def _together(body: RigidBody, first: Placement) -> dict[str, str] | None:
    """One inertial for all links of a body, at the first of them."""
    back = first.E.T
    center = applied(back, body.center - first.r)
    line = _inertial(body.mass, tuple(center.tolist()), product(product(back, body.inertia), first.E))
    return {body.links[0]: line} if line else None


def _inertial(mass: float, center: tuple[float, ...], J: np.ndarray) -> str | None:
    """The element, or None for an inertia that MuJoCo refuses."""
    (A, B, C), axes = np.linalg.eigh(J)
    if mass < LEAST or A < -ROUNDING * C or A + B < C * (1.0 - ROUNDING):
        return None
    attributes: dict[str, str | None] = {"pos": numbers(center), "mass": number(mass)}
    if A > max(PLAIN, MARGIN * C) and A + B > C * (1.0 + MARGIN):
        stated = J[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
        return element("inertial", {**attributes, "fullinertia": numbers(stated.tolist())})
    A, B = max(A, LEAST), max(B, LEAST)
    axes = axes * (1.0, 1.0, np.sign(np.linalg.det(axes)))
    moments = (A, B, max(min(C, A + B), LEAST))
    turned = {"euler": numbers(rpy_from_rotation(axes)), "diaginertia": numbers(moments)}
    return element("inertial", {**attributes, **turned})


def _refusal(body: RigidBody, links: list[Link]) -> str:
    """Why a body cannot be written, named by the first of its links that could not be by itself."""
    name = next((link.name for link in links if _each([link]) is None), body.links[0])
    A, B, C = np.linalg.eigvalsh(body.inertia).tolist()
    return (
        f"link {name!r}: what moves as one with it has the mass {body.mass:.6g} kg and the principal moments of "
        f"inertia {A:.6g}, {B:.6g}, {C:.6g} kg m^2, which no body has and MuJoCo refuses; correct them, or load the "
        "robot with repair_inertia=True"
    )
