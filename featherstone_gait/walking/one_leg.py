"""What it takes to stand on one leg: torques of a planned walk while one foot is down, against those of the servos.

Inverse dynamics of the plan gives the force F and moment N on the root [N; N m] that the ground has to supply.  While
one foot is down it comes through that leg, and a joint of it at p, with the axis a, bears a'(N - p x F) of it.
"""

from __future__ import annotations

import math

import numpy as np

from ..dynamics import inverse_dynamics
from ..identification.curve import torque_speed
from ..model import Model, Servo
from ..robot_file.servos import load_servo, servo_names
from .kinematics import joint_axes, link_poses, upright_states
from .limits import BY_NAME
from .plan import Plan
from .stance import soles_of

MOST = BY_NAME["torque"].bound  # share of the stall torque that a walk may ask for


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


def check_strength(model: Model, plan: Plan) -> None:
    """Raise ValueError where a servo is too weak for the robot to stand on one leg, with the least one that is not."""
    motors = {name: servo for name, servo in model.servos.items() if servo.resistance > 0.0}
    torques = dict(zip(model.joint_names, one_leg_torques(model, plan)))
    asked = {name: torques[name] / _stall(servo) for name, servo in motors.items() if torques.get(name, 0.0) > 0.0}
    weakest = max(asked, key=asked.__getitem__, default="")
    if not weakest or asked[weakest] <= MOST:
        return
    most = max(torque for name, torque in torques.items() if name in asked)
    enough = {name: stall for name in servo_names() if (stall := _stall(load_servo(name))) * MOST >= most}
    remedy = f"the least servo of the package that could is {min(enough, key=enough.__getitem__)}" if enough else (
        f"no servo of the package has the {most / MOST:.3g} N m that it takes"
    )  # fmt: skip
    raise ValueError(
        f"{model.name} is too heavy for these servos: on one leg {weakest} bears {torques[weakest]:.2f} N m, its servo "
        f"has {_stall(motors[weakest]):.2f} N m at stall, of which a walk may ask for {100.0 * MOST:.0f} %; {remedy}"
    )


def _stall(servo: Servo) -> float:
    return torque_speed(servo, points=2).stall_torque
