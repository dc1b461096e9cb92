"""Report inertias that no rigid body can have, and repair them on request."""

from __future__ import annotations

from dataclasses import replace
from xml.etree.ElementTree import Element

import numpy as np

from ..model import Link, inertia_matrix
from ..model.mass_checks import DEFINITE_TOLERANCE
from .report import Report

TRIANGLE_TOLERANCE = 1e-6  # relative; a flat plate meets A + B = C exactly, and files round to about seven digits


def note_inertia(link: Link, element: Element, report: Report) -> None:
    """Report an inertia that no distribution of the mass has; points and rods have a possible one."""
    what, inertia = f"link {link.name!r}", tuple(link.inertia)
    if link.mass == 0:
        if any(inertia):
            found = f"mass is 0 but inertia is {inertia!r}"
            report.assume(element, what, found, "taken as stated", "give a mass > 0, or set both to 0")
        return
    A, B, C = _moments(link)
    if A < -DEFINITE_TOLERANCE * max(C, -A):
        found = f"inertia {inertia!r} kg m^2 is not positive definite (principal moments {A:.6g}, {B:.6g}, {C:.6g})"
        remedy = "all must be > 0: correct the diagonal and the signs of the products, or load with repair_inertia=True"
        report.assume(element, what, found, "taken as stated", remedy)
    elif A + B < C * (1.0 - TRIANGLE_TOLERANCE):
        found = f"principal moments of inertia {A:.6g}, {B:.6g}, {C:.6g} kg m^2 break the triangle inequality"
        remedy = (
            f"no body has one above the sum of the others (relative tolerance {TRIANGLE_TOLERANCE:g}): "
            "compute the inertia about the center of mass again, or load with repair_inertia=True"
        )
        report.assume(element, what, found, "taken as stated", remedy)


def repaired(link: Link, report: Report) -> Link:
    """Return the link with an inertia that a rigid body can have.

    As in MuJoCo's compiler with `boundinertia` and `balanceinertia`: principal moments below zero are raised, here to
    DEFINITE_TOLERANCE of the largest, and if one is then above the sum of the others all three become their mean.
    Massless links, links without a positive moment, and possible inertias stay as they are.
    """
    A, B, C = _moments(link)
    possible = A >= -DEFINITE_TOLERANCE * max(C, -A) and A + B >= C * (1.0 - TRIANGLE_TOLERANCE)
    if link.mass == 0 or possible or not C > 0:
        return link
    moments, axes = np.linalg.eigh(inertia_matrix(link.inertia))
    moments = np.maximum(moments, DEFINITE_TOLERANCE * C)
    if moments[0] + moments[1] < moments[2] * (1.0 - TRIANGLE_TOLERANCE):
        moments = np.full(3, moments.mean())
    I = (axes * moments) @ axes.T
    change = f"{A:.6g}, {B:.6g}, {C:.6g} to {', '.join(f'{x:.6g}' for x in moments.tolist())}"
    report.remark(f"link {link.name!r}: principal moments of inertia repaired from {change} kg m^2")
    return replace(link, inertia=tuple(float(I[i, j]) for i, j in zip((0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2))))


def _moments(link: Link) -> list[float]:
    """Compute the principal moments of inertia, ascending [kg m^2]."""
    return np.linalg.eigvalsh(inertia_matrix(link.inertia)).tolist()
