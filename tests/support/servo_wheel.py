"""A wheel on a servo that drives it with full voltage against constant loads, eight to a vector."""

from dataclasses import replace

import numpy as np

from featherstone_gait.model import Joint, Link, Model
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import initial_state, simulate_batch
from featherstone_gait.scene.compile import compile_scene

STILL = (0.0, 0.0, 0.0)
FAR = 1e6  # rad, a goal that asks for all the voltage there is


def driven(servo, voltage, loads, speeds=None, kind="rotor", duration=1.0):
    """Runs of the wheel, each against one load [N m] and driven against it, from a speed [rad/s] or from rest."""
    body = (1e-5, 0.0, 0.0, 1e-5, 0.0, 1e-5)
    links = Link("stand", 1.0, STILL, body), Link("wheel", 0.01, STILL, body)
    joint = Joint("turn", "continuous", "stand", "wheel", axis=(0.0, 0.0, 1.0))
    servo = replace(servo, voltage_limit=voltage, controller=replace(servo.controller, Kp=1.0))
    model = Model("bench", links, (joint,), servos={"turn": servo})
    scene = compile_scene(model, kind, integrator="implicit_euler", timestep=1e-3, gravity=STILL)
    held = [np.array([[x], [x]]) for x in np.asarray(loads, dtype=float)]
    ends = np.array([0.0, duration])
    states = [initial_state(scene, [0.0], [v]) for v in (speeds if speeds is not None else np.zeros(len(held)))]
    goals = [Reference(ends, np.full((2, 1), -np.copysign(FAR, x[0, 0])), "hold") for x in held]
    taus = [Reference(ends, x, "linear") for x in held]
    record = ("q", "qd", "current", "voltage")
    return simulate_batch(
        scene, duration, states, goals, taus, record=record, record_interval=0.1, estimate_error=False
    )
