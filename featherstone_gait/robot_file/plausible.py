"""Find inertias that no part of the robot can have, such as those in kg mm^2 or 1 kg m^2 for a few grams."""

from __future__ import annotations

import math

import numpy as np

from ..model import Joint, inertia_matrix
from ..model.shapes import Box, Capsule, Cylinder, Hull, Shape, Sphere
from .report import Report
from .robot import Robot

FACTOR = 3.0  # of the robot's size, beyond which a radius of gyration is doubted
OWN = 10.0  # the same of the link's own size, if the radius is beyond the robot's size as well
LIGHT = 1e-5  # of the robot's mass, of which a link is not compared with its own size: sensors and frames
SMALLEST, UNKNOWN = 0.1, 1.0  # [m] least sizes taken for a robot, with shapes of known size in its file and without


def doubt_inertias(robot: Robot, report: Report) -> None:
    """Report each link whose radius of gyration, sqrt(I / m), is far beyond its own size or that of the robot.

    The root of a fixed robot may have any inertia, which never acts.  What stands in place of a link that is refused is
    not looked at.
    """
    if report.problems:
        return
    led = {joint.child for joint in robot.joints}
    size = max(_size(robot), SMALLEST if any(map(_radius, robot.shapes)) else UNKNOWN)
    light, own = LIGHT * sum(link.mass for link in robot.links), _own_sizes(robot)
    for link in robot.links:
        most = FACTOR * size
        if link.name in own and link.mass > light:
            most = min(most, max(OWN * own[link.name], size))
        largest = float(np.linalg.eigvalsh(inertia_matrix(link.inertia))[-1])
        acts = robot.base == "floating" or link.name in led
        if acts and largest > link.mass * most**2 > 0.0:
            radius = math.sqrt(largest / link.mass)
            report.assume_at(
                f"link {link.name!r}",
                f"inertia of {largest:.3g} kg m^2 with {link.mass:.3g} kg has a radius of gyration of {radius:.3g} m; "
                f"expected up to {most:.2g} m",
                "taken as stated (1 kg mm^2 is 1e-6 kg m^2)",
                "give it in kg m^2, about the center of mass (1 kg mm^2 is 1e-6 kg m^2)",
            )


def _own_sizes(robot: Robot) -> dict[str, float]:
    """Compute how far links extend from their centers of mass [m], of those whose shapes are all of known size."""
    centers = {link.name: link.center_of_mass for link in robot.links}
    far = {name: math.hypot(*center) for name, center in centers.items()}
    ends = [(joint.parent, joint.xyz, 0.0) for joint in robot.joints if joint.parent in far]
    for name, place, radius in (*ends, *((shape.link, shape.xyz, _radius(shape)) for shape in robot.shapes)):
        far[name] = max(far[name], math.dist(place, centers[name]) + radius)
    unknown = {shape.link for shape in robot.shapes if not _radius(shape)}
    return {shape.link: far[shape.link] for shape in robot.shapes if shape.link not in unknown}


def _size(robot: Robot) -> float:
    """Compute how far the robot can reach from its root [m]: joints from place to place, then what a link holds."""
    children: dict[str, list[Joint]] = {}
    for joint in robot.joints:
        children.setdefault(joint.parent, []).append(joint)
    led = {joint.child for joint in robot.joints}
    far = {link.name: 0.0 for link in robot.links if link.name not in led}
    waiting = list(far)
    while waiting:
        name = waiting.pop()
        for joint in children.get(name, []):
            if joint.child not in far:
                far[joint.child] = far[name] + math.hypot(*joint.xyz) + _travel(joint)
                waiting.append(joint.child)
    ends = [far.get(link.name, 0.0) + math.hypot(*link.center_of_mass) for link in robot.links]
    tips = [far.get(shape.link, 0.0) + math.hypot(*shape.xyz) + _radius(shape) for shape in robot.shapes]
    return max([*ends, *tips], default=0.0)


def _travel(joint: Joint) -> float:
    """Return how far a joint slides from its zero [m], 0 without stops."""
    far = max(abs(joint.lower), abs(joint.upper))
    return far if joint.type == "prismatic" and far < math.inf else 0.0


def _radius(shape: Shape) -> float:
    """Return how far a shape extends from its origin [m]; 0 of a mesh, which is not opened."""
    match shape.geometry:
        case Box(size):
            return 0.5 * math.hypot(*size)
        case Sphere(radius):
            return radius
        case Cylinder(radius, length) | Capsule(radius, length):
            return radius + 0.5 * length
        case Hull(points):
            return max(math.hypot(*point) for point in points)
    return 0.0
