"""Default postures: a keyframe in which the robot stands, or joints at zero, or as near as their limits allow."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from ..base.arguments import instance
from .links import Joint, leader_of
from .numpy_dynamics import at_joints
from .robot import Model

ROUNDING = 1e-12  # of a position [rad or m]
START = "qpos0"  # keyframe whose joints are those of the start of a run; of MJCF, the posture of `ref`
STANDING = ("stand", "standing", "home")  # keyframes in which a robot stands


def standing_keyframe(model: Model) -> np.ndarray | None:
    """Return the positions (nq,) of the first keyframe named in `STANDING`; None if there is none."""
    return next((np.array(model.keyframes[name]) for name in STANDING if name in model.keyframes), None)


def start_positions(model: Model) -> np.ndarray:
    """Return the positions (joints,) [rad or m] of the keyframe `START`, without one zeros."""
    if START not in model.keyframes:
        return np.zeros(len(model.joint_names))
    return model.single_positions(np.array(model.keyframes[START]))


def nearest_posture(model: Model) -> np.ndarray:
    """Return the posture within the joint limits that is nearest to zero.

    Joints whose range includes 0 are at 0, the others at the nearer limit, and coupled joints where their leaders put
    them.  A leader keeps its followers within their limits too, where that is possible.

    Parameters
    ----------
    model : Model
        The robot.

    Returns
    -------
    numpy.ndarray
        Positions q (nq,) [m, -, rad or m]; a floating base is at the origin and upright.
    """
    instance("model", model, Model, "give what load_robot returns")
    at = nearest_positions(model.degrees.joints, model.locked)
    return at_joints(model, [at[name] for name in model.joint_names])


def nearest_positions(joints: Iterable[Joint], locked: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return these positions by joint name, for all joints that are not fixed; locked ones [rad or m] stay."""
    by_name = {joint.name: joint for joint in joints}
    held = {name: 0.0 for name, joint in by_name.items() if joint.type == "fixed"} | dict(locked or {})
    ranges = {name: (joint.lower, joint.upper) for name, joint in by_name.items()}
    laws = {name: leader_of(joint, by_name) for name, joint in by_name.items()}
    for name, (leader, multiplier, offset) in laws.items():
        if leader.name != name and multiplier != 0.0:
            ends = [(limit - offset) / multiplier for limit in ranges[name]]
            lower, upper = max(min(ends), ranges[leader.name][0]), min(max(ends), ranges[leader.name][1])
            ranges[leader.name] = (lower, upper) if lower <= upper else ranges[leader.name]
    leaders = {name: held.get(name, min(max(0.0, ranges[name][0]), ranges[name][1])) for name in by_name}
    at = {name: multiplier * leaders[leader.name] + offset for name, (leader, multiplier, offset) in laws.items()}
    for name, joint in by_name.items():
        within = min(max(at[name], joint.lower), joint.upper)
        if math.isclose(within, at[name], rel_tol=ROUNDING, abs_tol=ROUNDING):  # only rounding has put it beyond
            at[name] = within
    return {name: held.get(name, at[name]) for name, joint in by_name.items() if joint.type != "fixed"}
