"""Small scenes for tests of contact and simulation: a free box, a pendulum, and what to read from their runs."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from featherstone_gait.dynamics import energy
from featherstone_gait.model import ContactPoint, Ground, Joint, Link, Model
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

G = 9.81  # [m/s^2]
NEVER_FALLEN = {"fall_height": -1e6, "fall_tilt": math.pi}


def box(mass=1.0, size=(0.4, 0.4, 0.1)):
    """A free uniform box whose four lower corners can touch the ground."""
    x, y, z = size
    inertia = (mass * (y * y + z * z) / 12, 0.0, 0.0, mass * (x * x + z * z) / 12, 0.0, mass * (x * x + y * y) / 12)
    corners = [(sx * x / 2, sy * y / 2, -z / 2) for sx in (-1, 1) for sy in (-1, 1)]
    contacts = tuple(ContactPoint("box", corner) for corner in corners)
    return Model("box", (Link("box", mass, (0.0, 0.0, 0.0), inertia),), (), "floating", contacts=contacts)


def box_on(ground, integrator="implicit_euler", timestep=1e-3, model=None):
    """A box over the ground, never said to have fallen."""
    return compile_scene(model or box(), ground=ground, integrator=integrator, timestep=timestep, **NEVER_FALLEN)


def resting(scene, velocity=(0.0, 0.0, 0.0)):
    """State of a box that lies flat on a plane of any slope, sunk in as its weight needs, moving at `velocity`
    (along the first tangent, the second, the normal) [m/s]."""
    ground, height = scene.ground, -scene.model.contacts[0].position[2]
    c, s = math.cos(ground.slope), math.sin(ground.slope)
    normal, tangent = np.array([-s, 0.0, c]), np.array([c, 0.0, s])
    x = ground.height * c * normal + (height - ground.penetration * c) * normal
    v = velocity[0] * tangent + velocity[1] * np.array([0.0, 1.0, 0.0]) + velocity[2] * normal
    q = [*x, math.cos(ground.slope / 2), 0.0, -math.sin(ground.slope / 2), 0.0]
    return initial_state(scene, q, [*v, 0.0, 0.0, 0.0])


def thrown(scene, clearance, tilt=0.0, velocity=(0.0, 0.0, 0.0)):
    """State of a tilted box whose lowest corner is `clearance` [m] over the plane z = 0, moving at `velocity` [m/s]."""
    q = np.array([0.0, 0.0, 0.0, math.cos(tilt / 2), math.sin(tilt / 2) * 0.96, math.sin(tilt / 2) * 0.28, 0.0])
    q[2] = clearance - corners(scene.model, q[None])[0, :, 2].min()
    return initial_state(scene, q, [*velocity, 0.0, 0.0, 0.0])


def standing_humanoid(integrator, duration, record=("q", "base_q", "contact_force")):
    """Scene and run of the humanoid that holds its zero posture on its soles, steps of 1 ms."""
    scene = compile_scene(load_robot("humanoid"), "mipsd", Ground(), integrator, 1e-3)
    return scene, simulate(scene, duration, record=record)


def along(scene, positions):
    """Coordinate along the first tangent [m]."""
    return positions[..., 0] * math.cos(scene.ground.slope) + positions[..., 2] * math.sin(scene.ground.slope)


def normal_to(scene, positions):
    """Height over the plane through the origin, along its normal [m]."""
    return positions[..., 2] * math.cos(scene.ground.slope) - positions[..., 0] * math.sin(scene.ground.slope)


def corners(model, q):
    """Positions (samples, points, 3) of the contact points of a box [m]."""
    return np.array([p.position for p in model.contacts]) @ rotations(q[:, 3:7]).transpose(0, 2, 1) + q[:, None, :3]


def rotations(quaternions):
    """(samples, 3, 3) from w x y z."""
    w, x, y, z = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def elastic_energy(scene, run):
    """Energy in the contacts' springs, normal and tangential [J]."""
    depth = np.maximum(-normal_to(scene, corners(scene.model, run["base_q"])) + scene.ground.height, 0.0)
    bristle = np.sum(run["tangential_deflection"] ** 2, axis=2)
    k, kt = scene.constants.contact.points.stiffness, scene.constants.contact.points.tangential_stiffness
    return 0.5 * (depth**2 @ k + bristle @ kt)


def total_energy(scene, run):
    """Kinetic, potential and contact energy of a box [J]."""
    return energy(scene.model, run["base_q"], run["base_qd"]).sum(axis=1) + elastic_energy(scene, run)


def with_controller(model, **changes):
    """The robot with other settings in all its controllers."""
    servos = {
        name: replace(servo, controller=replace(servo.controller, **changes)) for name, servo in model.servos.items()
    }
    return replace(model, servos=servos)


def arm_scene(model=None, gearbox="mipsd", integrator="implicit_euler", timestep=1e-3):
    """The planar arm of seven servos."""
    return compile_scene(model or load_robot("arm7"), gearbox, integrator=integrator, timestep=timestep)


def pendulum(length=0.5, mass=1.0, damping=0.05, friction=0.0, lower=-100.0, upper=100.0, effort=20.0):
    """A rod that turns about y at its upper end and hangs down at zero."""
    inertia = mass * length**2 / 12
    rod = Link("rod", mass, (0.0, 0.0, -length / 2), (inertia, 0.0, 0.0, inertia, 0.0, 0.01 * inertia))
    base = Link("base", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6)
    limits = {"lower": lower, "upper": upper, "damping": damping, "friction": friction, "effort": effort}
    joint = Joint("hinge", "revolute", "base", "rod", axis=(0.0, 1.0, 0.0), **limits)
    return Model("pendulum", (base, rod), (joint,))


def gimbal(axes="zxz", inertia=(3e-3, 0.0, 0.0, 3e-3, 0.0, 1e-3), **more):
    """A body on three hinges that meet in a point, with massless links between; center of mass 0.2 m off, along z."""
    names, hinges = ("base", "outer", "inner", "body"), ("yaw", "pitch", "roll")
    links = (*(Link(name) for name in names[:3]), Link("body", 1.0, (0.0, 0.0, 0.2), inertia))
    joints = tuple(
        Joint(hinge, "continuous", *ends, axis=tuple(float(one == axis) for one in "xyz"))
        for hinge, ends, axis in zip(hinges, pairwise(names), axes)
    )
    return Model("gimbal", links, joints, **more)
