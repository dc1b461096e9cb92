"""Bodies that touch each other, and the same law of contact written down a second time, in the plane, for SciPy."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from featherstone_gait.dynamics import energy
from featherstone_gait.geometry.body import body
from featherstone_gait.model.pair_contact import PairContact
from featherstone_gait.model.placed import Placed, SceneModel
from featherstone_gait.model.shapes import Box, Cylinder, Sphere
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

G = 9.81  # [m/s^2]
NOWHERE = (0.0, 0.0, 0.0)
CHANNELS = ("base_q", "base_qd", "pair_work")
FIXED_STEPS = ("implicit_euler", "midpoint", "rk4")


def placed(shape, mass, name, position=NOWHERE, orientation=(1.0, 0.0, 0.0, 0.0), **options):
    """A free body at its place."""
    return Placed(body(shape, mass, name=name, **options), position=position, orientation=orientation)


def obstacle(shape, name, position=NOWHERE, orientation=(1.0, 0.0, 0.0, 0.0), friction=None):
    """A shape that never moves."""
    model = body(shape, name=name, base="fixed", friction=friction)
    return Placed(model, position=position, orientation=orientation)


def far():
    """A box and a cylinder far away, so that all scenes with them have the same code."""
    unit = Sphere(0.1), Box((0.1, 0.1, 0.1)), Cylinder(0.1, 0.1)
    return [obstacle(shape, f"far{k}", (0.0, 0.0, 1e3 + k)) for k, shape in enumerate(unit)]


def touching(members, obstacles=(), integrator="extrapolation", timestep=None, gravity=NOWHERE, **law):
    """A scene in which all touch all, without a ground."""
    if integrator in FIXED_STEPS and timestep is None:
        timestep = 1e-3
    return compile_scene(SceneModel("touching", list(members), [*obstacles, *far()]), None, None, integrator, timestep,
                         gravity=gravity, pairs=PairContact(**law))  # fmt: skip


def run_of(scene, duration, velocities=None, rtol=1e-10, record=CHANNELS, **options):
    """Simulate from the members' places, with error control if the integrator has it; ask that the run is ok."""
    if scene.integrator not in FIXED_STEPS:
        options["rtol"] = rtol
    size = {member.name: member.model.nv for member in scene.members}
    given = {name: [*v, *[0.0] * (size[name] - len(v))] for name, v in (velocities or {}).items()}
    state = initial_state(scene, None, given)
    run = simulate(scene, duration, state, record=record, estimate_error=False, **options)
    assert run.status == "ok", run.message
    return run


def law_of(scene, *links):
    """Stiffness, damping, friction, tangential stiffness and damping of the points of two bodies, else of the first."""
    pairs = [(one.partition("/")[0], two.partition("/")[0]) for one, two in scene.pairs]
    near = (k for k, pair in enumerate(pairs) if pair[1][:3] != "far" and (not links or set(pair) == set(links)))
    row = scene.touching.table.pairs[next(near)]
    names = "stiffness", "damping", "friction", "tangential_stiffness", "tangential_damping"
    return tuple(float(row[name]) for name in names)


def normal(x, rate, k, d):
    """Hunt and Crossley's force for a penetration x [m] and its rate [m/s]."""
    return max(k * x * (1.0 + d * rate), 0.0) if x > 0.0 else 0.0


@dataclass
class Disc:
    """A round body in the plane x, z."""

    radius: float
    mass: float  # inf: its center does not move
    inertia: float  # about y; inf: it does not turn
    x: tuple[float, float] = (0.0, 0.0)
    v: tuple[float, float] = (0.0, 0.0)
    spin: float = 0.0  # [rad/s] about y


def planar(a, b, law, duration, g=(0.0, 0.0), rtol=1e-12):
    """Two discs that touch by the law, from SciPy: x, z, spin of a, then of b, at the end; rows of positions, rates.

    a has the force, b the opposite one.
    """
    k, d, mu, kt, dt = law
    ga, gb = (np.array(g) if math.isfinite(one.mass) else np.zeros(2) for one in (a, b))

    def rates(_, y):
        xa, va, wa, xb, vb, wb, z = y[0:2], y[2:4], y[4], y[5:7], y[7:9], y[9], y[10]
        c = xa - xb
        far = math.hypot(*c)
        n = c / far
        t = np.array([n[1], -n[0]])
        depth = a.radius + b.radius - far
        ra, rb = -(a.radius - depth / 2) * n, (b.radius - depth / 2) * n
        # a spin about y turns z into x
        u = va + wa * np.array([ra[1], -ra[0]]) - vb - wb * np.array([rb[1], -rb[0]])
        fn = normal(depth, -(n @ u), k, d)
        ut = t @ u
        ft = -kt * z - dt * ut
        if fn == 0.0:
            ft, dz = 0.0, 0.0
        elif abs(ft) > mu * fn:
            ft = math.copysign(mu * fn, ft)
            dz = -(ft + kt * z) / dt
        else:
            dz = ut
        f = fn * n + ft * t
        moment_a, moment_b = ra[1] * f[0] - ra[0] * f[1], -(rb[1] * f[0] - rb[0] * f[1])
        return [*va, *(f / a.mass + ga), moment_a / a.inertia, *vb, *(-f / b.mass + gb), moment_b / b.inertia, dz]

    start = [*a.x, *a.v, a.spin, *b.x, *b.v, b.spin, 0.0]
    found = solve_ivp(rates, (0.0, duration), start, "DOP853", rtol=rtol, atol=1e-14, max_step=duration / 100)
    assert found.success
    return found.y[:, -1]


def energy_of(scene, run):
    """Kinetic and potential energy of all members over the records [J]."""
    of, gravity = run.of, scene.options.gravity
    return sum(
        energy(one.model, of(one.name)["base_q"], of(one.name)["base_qd"], gravity=gravity).total
        for one in scene.members
    )


def ball(radius, mass, name, position=NOWHERE, **options):
    """A free ball."""
    return placed(Sphere(radius), mass, name, position, **options)
