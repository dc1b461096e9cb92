"""Give a robot on a fixed base company: a branch with one passive part of each kind, so that their tests share a kind.

It hangs on the same base, rests, and moves nothing else.  Its joints and tendons come last, and `simulated` returns the
run without them.
"""

from dataclasses import replace

import numpy as np

from featherstone_gait import Controller, Joint, Link, Reference, Tendon, Via, Wrap, compile_scene, initial_state
from featherstone_gait.model import Mimic, Servo
from featherstone_gait.run.simulate import simulate

AT_REST = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
JOINTS = 5  # degrees of freedom
LAST = {"q": 6, "qd": JOINTS, "qdd": JOINTS, "energy": JOINTS, "tendon_force": 2, "tendon_length": 2, "tendon_work": 2}


def beside(model):
    """Return the robot with its company."""
    root, own, axis = model.root, ("company", "company follower", "company ball"), (0.0, 1.0, 0.0)
    brakes = {"damping": 1e-4, "quadratic_damping": -1e-4, "cubic_damping": 1e-4, "friction": 1e-6, "armature": 1e-4}
    springs = {"stiffness": 1e-3, "quadratic_stiffness": -1e-3, "cubic_stiffness": 1e-3}
    ends = {"lower": -1.0, "upper": 1.0, "effort": 0.1}
    joints = (
        Joint(own[0], "revolute", root, own[0], axis=axis, **brakes, **springs, **ends),
        Joint(own[1], "continuous", root, own[1], axis=axis, mimic=Mimic(own[0])),
        Joint(own[2], "ball", root, own[2], stiffness=1e-3),
    )
    drum = Wrap(root, "cylinder", 0.1, (0.2, 0.0, -0.2), axis, (0.6, 0.0, -0.2))
    path = Via(root, (0.3, 0.0, 0.2)), drum, Via(own[0], (0.0, 0.0, -0.5))
    cord = Tendon("company cord", (), path, upper=9.0, friction=1e-6, controller=Controller("pd", 1e-6))
    rotor = Tendon("company rotor", [(own[0], 1.0)], armature=1e-4)
    return replace(
        model,
        links=[*model.links, *(Link(name, 1e-3, inertia=(1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3)) for name in own)],
        joints=[*model.joints, *joints],
        tendons=[*model.tendons, cord, rotor],
        servos={**model.servos, own[1]: Servo(Controller("pd", wrap=True))},
        keyframes={},
    )


def in_company(model, integrator, timestep, **how):
    """Compile the robot with its company, but alone by "extrapolation", whose kernel would be too large."""
    if integrator == "extrapolation":
        return compile_scene(model, integrator=integrator, timestep=timestep, **how)
    return compile_scene(beside(model), "rotor", integrator=integrator, timestep=timestep, **how)


def begun(scene, q=None, qd=None):
    """Return the state in which the robot has these positions and velocities, within its limits or beyond."""
    q = np.zeros(scene.model.nq - len(AT_REST)) if q is None else q
    qd = np.zeros(scene.model.nv - JOINTS) if qd is None else qd
    return initial_state(scene, [*q, *AT_REST], [*qd, *np.zeros(JOINTS)], allow_limit_violation=True)


def simulated(scene, duration, q=None, qd=None, reference=None, tau=None, **how):
    """Simulate a robot in company; reference and tau are of its own joints and drives."""
    how = {"estimate_error": False} | how
    if "company" not in scene.model.joint_names:
        return simulate(scene, duration, initial_state(scene, q, qd), reference, tau, **how)
    own = scene.tree.n - JOINTS
    tau = np.zeros(scene.inputs - JOINTS - 1) if tau is None else tau
    tau = tau if isinstance(tau, Reference) else Reference([0.0], [tau])
    signals = [
        one and replace(one, values=np.insert(one.values, [own] * JOINTS + [one.values.shape[1]], 0.0, axis=1))
        for one in (reference, tau)
    ]
    return Alone(simulate(scene, duration, begun(scene, q, qd), *signals, **how))


class Alone:
    """A run of a robot without that of its company."""

    def __init__(self, run):
        self.run = run

    def __getattr__(self, name):
        return getattr(self.run, name)

    def __getitem__(self, name):
        x = self.run[name]
        return x[:, : -LAST[name]] if name in LAST else x
