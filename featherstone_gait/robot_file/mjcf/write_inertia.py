"""Write inertias that MuJoCo accepts: of each link, or together of links that move as one.

MuJoCo refuses an inertia with A + B < C to the last bit, and a moving body unless it, or one fixed to it, has a mass
and moments of at least 1e-15.  Principal moments are written, since those of a `fullinertia` depend on rounding.
"""

from __future__ import annotations

import numpy as np

from ...base.fixed_order import applied, product
from ...base.rotation import rpy_from_rotation
from ...model import Link, Model, Placement, RigidBody, inertia_matrix, rigid_bodies
from ..inertia import TRIANGLE_TOLERANCE
from .element import element, number, numbers

LEAST = 1e-15  # mass and moments of inertia of what moves [kg, kg m^2]
ROUNDING = 1e-13  # of the largest moment, by which moments may miss what is asked


def inertials(model: Model) -> tuple[dict[str, str], list[str]]:
    """Write the inertial of each link that has one, and return how the file deviates from the model.

    Raises ValueError for moving bodies with an inertia that no rigid body has.
    """
    links = {link.name: link for link in model.links}
    bodies, placements = rigid_bodies(model)
    lines: dict[str, str] = {}
    remarks: dict[str, list[str]] = {}
    for row, body in enumerate(bodies):
        heavy = [links[name] for name in body.links if links[name].mass or any(links[name].inertia)]
        found = _each(heavy)
        if found is None:
            found = _together(body, placements[body.links[0]])
            if found is None and (row or model.base == "floating"):
                raise ValueError(_refusal(body, heavy))
            remarks.setdefault(_remark(body, found), []).append(body.links[0])
        lines |= found or {}
    return lines, [f"{what}: {', '.join(names)}" for what, names in remarks.items()]


def _remark(body: RigidBody, found: dict[str, str] | None) -> str:
    """Describe what happens to a body whose links cannot have an inertial each."""
    if found is None:
        return "left out the inertia of what never moves, for no body has it"
    if np.linalg.eigvalsh(body.inertia)[0] < LEAST:
        return f"moments of inertia raised to {LEAST} kg m^2"
    return "one inertia for all that moves as one with"


def _each(links: list[Link]) -> dict[str, str] | None:
    """Write an inertial for every link; None if one is impossible, or none is large enough to move."""
    inertias = [inertia_matrix(link.inertia) for link in links]
    if links and max(np.linalg.eigvalsh(J)[0] for J in inertias) < LEAST:
        return None
    lines = {link.name: _inertial(link.mass, link.center_of_mass, J) for link, J in zip(links, inertias)}
    return None if None in lines.values() else {name: line for name, line in lines.items() if line}


def _together(body: RigidBody, first: Placement) -> dict[str, str] | None:
    """Write one inertial for all links of a body, at the first of them."""
    back = first.E.T
    center = applied(back, body.center - first.r)
    J = product(product(back, body.inertia), first.E)
    line = _inertial(body.mass, tuple(center.tolist()), J, LEAST)
    return {body.links[0]: line} if line else None


def _inertial(mass: float, center: tuple[float, ...], J: np.ndarray, least: float = 0.0) -> str | None:
    """Write the element with moments of at least `least`; None for an inertia that no rigid body has."""
    (A, B, C), axes = np.linalg.eigh(J)
    slack = max(ROUNDING * C, LEAST)
    if mass < LEAST or A < -slack or A + B < C - slack:
        return None
    A, B = max(A, least), max(B, least)
    axes = axes * (1.0, 1.0, np.sign(np.linalg.det(axes)))
    attributes = {
        "pos": numbers(center),
        "euler": numbers(rpy_from_rotation(axes)),
        "mass": number(mass),
        "diaginertia": numbers((A, B, max(min(C, A + B), least))),
    }
    return element("inertial", attributes)


def _refusal(body: RigidBody, links: list[Link]) -> str:
    """Say why a body cannot be written, naming the first link that could not be written by itself."""
    name = next((link.name for link in links if _each([link]) is None), body.links[0])
    A, B, C = np.linalg.eigvalsh(body.inertia).tolist()
    return (
        f"link {name!r}: what moves as one with it has the mass {body.mass:.6g} kg and the principal moments of "
        f"inertia {A:.6g}, {B:.6g}, {C:.6g} kg m^2, which no body has and MuJoCo refuses; correct them to the last "
        f"digit, or load the robot with repair_inertia=True, which mends what is off by {TRIANGLE_TOLERANCE:g} or more"
    )
