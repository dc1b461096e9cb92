"""What a step reads: the constants of a scene.  What a scene lacks is None, and costs nothing."""

from typing import NamedTuple

import numpy as np

from .jit import inline


class Scene(NamedTuple):
    """Columns of the parameter arrays: layout.py."""

    tree: np.ndarray  # (n + 1,) BODY
    floating: bool | None  # True or None
    gravity: np.ndarray  # (3,) [m/s^2]
    servo: np.ndarray | None  # (n, SERVO_COLUMNS)
    gear: np.ndarray | None  # (n, GEAR_COLUMNS), of the spring-damper gearbox
    pd: np.ndarray | None  # (n, PD_COLUMNS)
    law: np.ndarray | None  # (n,) controller of each servo
    armature: np.ndarray | None  # (n,) inertia added to each joint [kg m^2]
    friction: np.ndarray | None  # (n, FRICTION_COLUMNS)
    stops: np.ndarray | None  # (n, STOP_COLUMNS)
    points: np.ndarray | None  # (points, CONTACT_COLUMNS)
    point_bodies: np.ndarray | None  # (points,) row of the body, points of a body together
    ground: np.ndarray | None  # (1 + steps, GROUND_COLUMNS)
    push: np.ndarray | None  # (pushes, PUSH_COLUMNS)
    push_rows: np.ndarray | None  # (pushes,) row of the body
    springs: np.ndarray | None  # (springs, SPRING_COLUMNS)
    spring_rows: np.ndarray | None  # (springs, 2) rows of both bodies


@inline
def driven(scene, servo, gear, pd, law):
    """The scene with other drives."""
    return Scene(
        scene.tree,
        scene.floating,
        scene.gravity,
        servo,
        gear,
        pd,
        law,
        scene.armature,
        scene.friction,
        scene.stops,
        scene.points,
        scene.point_bodies,
        scene.ground,
        scene.push,
        scene.push_rows,
        scene.springs,
        scene.spring_rows,
    )
