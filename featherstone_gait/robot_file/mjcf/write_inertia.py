"""Write inertias that MuJoCo accepts: of each link, or together of links that move as one.

MuJoCo refuses an inertia with A + B < C to the last bit, and a moving body unless it, or one fixed to it, has a mass
and moments of at least 1e-15.  Principal moments are written, since those of a `fullinertia` depend on rounding.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ...base.fixed_order import applied, product
from ...base.rotation import rpy_from_rotation
from ...model import Link, Model, Placement, RigidBody, inertia_matrix, rigid_bodies
from ..markup import element
from ..urdf import TRIANGLE_TOLERANCE

Inertials: TypeAlias = dict[str, list[str]]  # lines by link

LEAST = 1e-15  # mass and moments of inertia of what moves [kg, kg m^2]
ROUNDING = 1e-13  # of the largest moment, by which moments may miss what is asked


def inertials(model: Model) -> tuple[Inertials, list[str]]:
    """Write the inertial of each link that has one, and return how the file deviates from the model.

    Raises ValueError for moving bodies with an inertia that no rigid body has.
    """
    links = {link.name: link for link in model.links}
    bodies, placements = rigid_bodies(model)
    lines: Inertials = {}
    remarks: dict[str, list[str]] = {}
    for row, body in enumerate(bodies):
        heavy = [links[name] for name in body.links if links[name].mass or any(links[name].inertia)]
        found = _each(heavy)
        if found is None:
            found = _together(body, placements[body.links[0]])
            if found is None and (row or model.base == "floating"):
                raise ValueError(_refusal(body, heavy))
            if found is None:
                remark = "left out the inertia of what never moves, for no body has it"
            elif np.linalg.eigvalsh(body.inertia)[0] < LEAST:
                remark = f"moments of inertia raised to {LEAST} kg m^2"
            else:
                remark = "one inertia for all that moves as one with"
            remarks.setdefault(remark, []).append(body.links[0])
        lines |= found or {}
    return lines, [f"{what}: {', '.join(names)}" for what, names in remarks.items()]


def _each(links: list[Link]) -> Inertials | None:
    """Write an inertial for every link; None if one is impossible, or none is large enough to move."""
    inertias = [inertia_matrix(link.inertia) for link in links]
    if links and max(np.linalg.eigvalsh(J)[0] for J in inertias) < LEAST:
        return None
    lines = {link.name: _inertial(link.mass, link.center_of_mass, J) for link, J in zip(links, inertias)}
    return lines if all(lines.values()) else None


def _together(body: RigidBody, first: Placement) -> Inertials | None:
    """Write one inertial for all links of a body, at the first of them."""
    back = first.E.T
    center = applied(back, body.center - first.r)
    line = _inertial(body.mass, center, product(product(back, body.inertia), first.E), LEAST)
    return {body.links[0]: line} if line else None


def _inertial(mass: float, center: ArrayLike, J: np.ndarray, least: float = 0.0) -> list[str]:
    """Write the element with moments of at least `least`; none for an inertia that no rigid body has."""
    (A, B, C), axes = np.linalg.eigh(J)
    slack = max(ROUNDING * C, LEAST)
    if mass < LEAST or A < -slack or A + B < C - slack:
        return []
    A, B = max(A, least), max(B, least)
    axes = axes * (1.0, 1.0, np.sign(np.linalg.det(axes)))
    moments = (A, B, max(min(C, A + B), least))
    attributes = {"pos": center, "euler": rpy_from_rotation(axes), "mass": mass, "diaginertia": moments}
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
