"""Compare the torques of a planned walk, while one foot is on the ground, with the stall torques of the servos.

Inverse dynamics of the plan gives the force F and moment N on the root [N; N m] that the ground has to supply.  While
one foot is down it comes through that leg, and a joint of it at p, with the axis a, bears a'(N - p x F) of it.
"""

from __future__ import annotations

import math

import numpy as np

from ..dynamics import inverse_dynamics
from ..model import Model
from ..robot_file.servos import load_servo, servo_names
from .kinematics import joint_axes, link_poses, upright_states
from .limits import BY_NAME, net_stall_torque
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
    """Raise ValueError if a servo is too weak for the robot to stand on one leg; name the weakest servo that is not."""
    motors = {name: servo for name, servo in model.servos.items() if servo.resistance > 0.0}
    torques = dict(zip(model.joint_names, one_leg_torques(model, plan)))
    asked = {name: torques[name] / net_stall_torque(motors[name]) for name in motors if torques.get(name, 0.0) > 0.0}
    weakest = max(asked, key=asked.__getitem__, default="")
    if not weakest or asked[weakest] <= MOST:
        return
    most = max(torques[name] for name in asked)
    known = {name: net_stall_torque(load_servo(name)) for name in servo_names()}
    enough = [name for name in known if most <= MOST * known[name]]
    remedy = f"no servo of the package has the {most / MOST:.3g} N m that it takes"
    if enough:
        remedy = f"the least servo of the package that could is {min(enough, key=known.__getitem__)}"
    raise ValueError(
        f"{model.name} is too heavy for these servos: on one leg {weakest} bears {torques[weakest]:.2f} N m, its servo "
        f"has {net_stall_torque(motors[weakest]):.2f} N m at stall, of which a walk may ask for {MOST:.0%}; {remedy}"
    )
