"""Servos for a robot whose own are not known: a known servo, scaled to the robot's size.

    robot = load_robot("solo12.urdf", base="floating", contacts="feet")
    robot = with_generic_servos(robot, leg=0.32)

Robots that differ in length l and mass m alone move alike if times scale as sqrt(l) and torques as m l (dynamic
similarity; R. Alexander, "Optimization and gaits in the locomotion of vertebrates", Physiological Reviews 69 (1989)).
The servo is scaled in the same way from a robot that it fits.
"""

from __future__ import annotations

import math
from dataclasses import replace

from ..base.arguments import instance, real
from ..dynamics import check_model
from ..model import Model, Servo
from ..robot_file.servos import load_servo, without_actuators

MASS, LEG = 2.423, 0.203  # of the Bioloid, which AX-12 servos carry: `robots/humanoid` [kg, m]
HEIGHT = 0.2226  # of its center of mass, standing [m]


def scaled_servo(servo: Servo, torque: float, speed: float) -> Servo:
    """Return the servo with `torque` times its stall torque and `speed` times its no-load speed, at the same voltage.

    Control gains, ticks, gear ratio, backlash and load-dependent friction stay.  Raises ValueError unless both factors
    are > 0, and for a servo without a motor.
    """
    instance("servo", servo, Servo, "give what load_servo returns")
    if not servo.motor_constant > 0.0:
        raise ValueError("servo: without a motor there is nothing to scale; give one with motor_constant > 0")
    f, s = real("torque", torque, 1e-6, 1e9, "a factor"), real("speed", speed, 1e-6, 1e6, "a factor")
    gear = servo.gearbox
    return replace(
        servo,
        motor_constant=servo.motor_constant / s,
        resistance=servo.resistance / (f * s),
        inductance=servo.inductance / (f * s * s),
        current_limit=servo.current_limit * f * s,
        current_slew=servo.current_slew * f * s * s,
        viscous_friction=servo.viscous_friction * f / s,
        coulomb_friction=servo.coulomb_friction * f,
        gearbox=replace(
            gear,
            stiffness=gear.stiffness * f,
            damping=gear.damping * f / s,
            rotor_inertia=gear.rotor_inertia * f / (s * s),
        ),
    )


def with_generic_servos(model: Model, leg: float, servo: Servo | None = None, margin: float = 1.0) -> Model:
    """Give each joint that turns the same servo, as strong for the robot's weight as an AX-12 is for a Bioloid.

    Parameters
    ----------
    model : Model
        The robot.
    leg : float
        Length of a leg, from its first joint to the ground [m].
    servo : Servo, optional
        Servo to scale, by default "ax12".
    margin : float
        How many times as strong.

    Returns
    -------
    Model
        The robot with these servos.
    """
    check_model(model)
    leg = real("leg", leg, 1e-3, 1e3, "give its length [m]")
    margin = real("margin", margin, 1e-3, 1e3, "a factor")
    known = load_servo("ax12") if servo is None else servo
    own = scaled_servo(known, margin * model.mass * leg / (MASS * LEG), math.sqrt(LEG / leg))
    turning = [joint.name for joint in model.moving_joints if joint.type in ("revolute", "continuous")]
    servos = {**model.servos, **dict.fromkeys(turning, own)}
    return replace(without_actuators(model, servos), servos=servos)
