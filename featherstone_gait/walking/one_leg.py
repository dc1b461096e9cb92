"""Compare the torques of a planned walk, while one foot is on the ground, with the stall torques of the servos.

Inverse dynamics of the plan gives the force F and moment N on the root [N; N m] that the ground has to supply.  While
one foot is down it comes through that leg, and a joint of it at p, with the axis a, bears a'(N - p x F) of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..dynamics import inverse_dynamics
from ..identification.curve import torque_speed
from ..model import Model
from ..robot_file.servos import load_servo, servo_names
from .kinematics import joint_axes, link_poses, upright_states
from .limits import BY_NAME, net_stall_torque
from .plan import Plan
from .stance import soles_of

TORQUE_SHARE = BY_NAME["torque"].bound  # share of the stall torque that a walk may ask for


def one_leg_torques(model: Model, plan: Plan) -> np.ndarray:
    """Compute the median torque of each joint (nj,) [N m or N] while its leg stands alone; NaN of other joints."""
    step, zero = plan.times[1] - plan.times[0], np.zeros((len(plan.times), 3))
    q = upright_states(model, plan.angles)
    base = np.gradient(plan.base_position, step, axis=0)
    qd = np.hstack([base, zero, np.gradient(plan.angles, step, axis=0)])
    forces = inverse_dynamics(model, q, qd, np.gradient(qd, step, axis=0))
    poses = link_poses(model, plan.angles)
    axes = joint_axes(model, poses)
    force, moment, torques = forces[:, :3], forces[:, 3:6], np.full(len(model.joint_names), math.nan)
    for side, sole in enumerate(soles_of(model)):
        alone = plan.contact[:, side] & ~plan.contact[:, 1 - side]
        for k in sole.joints if alone.any() else ():
            joint = model.moving_joints[k]
            at = poses.position[:, model.link_index(joint.child)]
            borne = force if joint.type == "prismatic" else moment - np.cross(at, force)
            torques[k] = np.median(np.abs(forces[:, 6 + k] - (axes[:, k] * borne).sum(axis=1))[alone])
    return torques


class Load(NamedTuple):
    """The joint that bears most of its servo's stall torque while its leg stands alone."""

    joint: str
    torque: float  # [N m]
    stall: float  # torque of its servo [N m]
    largest: float  # torque of any joint [N m]

    @property
    def share(self) -> float:
        """Torque over stall torque [-]."""
        return self.torque / self.stall

    def __str__(self) -> str:
        return f"on one leg {self.joint} bears {self.torque:.2f} N m, its servo has {self.stall:.2f} N m at stall"


def load_on_one_leg(model: Model, plan: Plan) -> Load | None:
    """Find the joint that bears most for its servo; return None if no joint with a motor bears anything."""
    motors = {name: servo for name, servo in model.servos.items() if servo.resistance > 0.0}
    torques = dict(zip(model.joint_names, one_leg_torques(model, plan)))
    stall = {name: net_stall_torque(motors[name]) for name in motors if torques.get(name, 0.0) > 0.0}
    if not stall:
        return None
    joint = max(stall, key=lambda name: torques[name] / stall[name])
    return Load(joint, float(torques[joint]), stall[joint], float(max(torques[name] for name in stall)))


def check_strength(model: Model, plan: Plan) -> None:
    """Raise ValueError if a servo is too weak for the robot to stand on one leg; name the weakest servo that is not."""
    load = load_on_one_leg(model, plan)
    if load is not None and load.share > TORQUE_SHARE:
        raise ValueError(
            f"{model.name} is too heavy for these servos: {load}, of which a walk may ask for {TORQUE_SHARE:.0%}; "
            f"{least_servo(load.largest / TORQUE_SHARE)}"
        )


def least_servo(torque: float, speed: float = 0.0) -> str:
    """Name the weakest servo of the package with a stall torque [N m] and a speed without load [rad/s]."""
    known = {name: load_servo(name) for name in servo_names()}
    torques = {name: net_stall_torque(servo) for name, servo in known.items()}
    strong = [name for name in known if torques[name] >= torque]
    enough = [name for name in strong if not speed or torque_speed(known[name], points=2).no_load_speed >= speed]
    asked = f"{torque:.3g} N m" + (f" and {speed:.2g} rad/s" if speed else "")
    if not enough:
        return f"no servo of the package has {asked}"
    return f"the least servo of the package with {asked} is {min(enough, key=torques.__getitem__)}"
