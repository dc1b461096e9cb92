"""States from which a simulation can begin."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..build.contact import standing_height
from ..build.coupling import check_followers, followed
from ..build.scene import CompiledScene
from ..core.step import pace
from ..fixed_order import total

FIRST_STEP, FIRST_COLUMNS = 1e-3, 5  # where error control begins [s]


def initial_state(scene: CompiledScene, q: ArrayLike | None = None, qd: ArrayLike | None = None) -> np.ndarray:
    """The whole state (size,) of a robot at positions q and velocities qd; zero where None.

    A floating robot over ground whose q is None stands with its lowest contact point sunk in by the ground's
    `sinking`.  Rotors turn with their joints, currents and bristles are zero.  Joints that follow others do so where
    q or qd is None; where they are given and do not agree with their leaders, ValueError says what they should be.
    """
    model, o, n = scene.model, scene.layout, scene.tree.n
    y = np.zeros(int(o["length"]))
    y[o["pace"] + np.array([pace.STEP, pace.COLUMNS, pace.LAST])] = FIRST_STEP, FIRST_COLUMNS, 1e-4
    default = np.zeros(model.nq)
    default[model.nq - n :] = followed(scene.tree.coupling, np.zeros(n))
    if model.base == "floating":
        default[3] = 1.0
        if scene.ground is not None and q is None:
            default[2] = standing_height(model, scene.ground, default)
    q = checked_vector("q", default if q is None else q, model.nq)
    qd = checked_vector("qd", np.zeros(model.nv) if qd is None else qd, model.nv)
    if model.base == "floating" and not np.linalg.norm(q[3:7]) > 1e-6:
        raise ValueError(f"{model.name}: the base's quaternion q[3:7] is {q[3:7]}; [1, 0, 0, 0] is no rotation")
    joints, rates = (a[len(a) - n :] for a in (q, qd))
    check_followers(model, scene.tree.coupling, joints, rates)
    given = {"q": joints, "qd": rates, "filtered": rates, "rotor": joints, "rotor_speed": rates}
    for name, values in given.items():
        first, end = scene.part(name)
        if end > first:
            y[first:end] = values
    if model.base == "floating":
        y[o["base_q"] : o["base_q"] + 7], y[o["base_qd"] : o["base_qd"] + 6] = q[:7], qd[:6]
        y[o["base_q"] + 3 : o["base_q"] + 7] /= math.sqrt(total(q[3:7] * q[3:7]))
    return y


def restarted(scene: CompiledScene, state: ArrayLike) -> np.ndarray:
    """A state (size,) that a run has come to, with its time at zero.

    References, torques and pushes count from there: a new run, in which controllers forget their last error.
    """
    y = checked_vector("state", state, int(scene.layout["length"])).copy()
    y[scene.layout["end"]] = 0.0
    return y


def standing_state(scene: CompiledScene, angles: ArrayLike) -> np.ndarray:
    """The whole state of a floating robot at rest over the origin: base upright, joints at `angles`, on the ground.

    Raises ValueError for a fixed base, without ground and for angles that do not fit.
    """
    model = scene.model
    if model.base != "floating" or scene.ground is None:
        raise ValueError(f"{model.name}: only a floating robot over ground stands; its base is {model.base}")
    q = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, *checked_vector("angles", angles, scene.tree.n)])
    q[2] = standing_height(model, scene.ground, q)
    return initial_state(scene, q)


def checked_vector(name: str, value: ArrayLike, width: int) -> np.ndarray:
    """A vector of `width` finite numbers, or ValueError."""
    a = np.array(value, dtype=float)
    if a.shape != (width,) or not np.isfinite(a).all():
        shown = np.array2string(a, threshold=20)
        raise ValueError(f"{name} must be {width} finite numbers; its shape is {a.shape}: {shown}")
    return a
