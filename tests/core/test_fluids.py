"""Fluids: buoyancy, drag, added mass and propellers against closed forms, MuJoCo's laws, energy, same bits."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import (
    Box,
    Capsule,
    Cylinder,
    Fluid,
    Hull,
    Immersed,
    Joint,
    Link,
    Model,
    Placed,
    Propeller,
    Sphere,
    body,
    compile_scene,
    initial_state,
    simulate,
    simulate_batch,
)
from featherstone_gait.base.records import records
from featherstone_gait.core.compile.jit import entry
from featherstone_gait.core.effects.fluid import IMMERSED
from featherstone_gait.core.shapes.immersion import CAPSULE, CYLINDER, POLYHEDRON, SPHERE, immersed
from featherstone_gait.scene.fluid import triangles_of

G, WATER = 9.81, 1000.0


def floating(shape, mass, **coefficients):
    """Return a free body that a fluid acts on, without contact points."""
    return replace(body(shape, mass), contacts=(), immersed=(Immersed("body", shape, **coefficients),))


def in_fluid(model, fluid=None, integrator="dop853", **how):
    """Compile a drone far over water, or a body in a fluid, to scenes of one kind if torques act on all shafts.

    A body gets a shaft whose propeller gives no thrust, and both a speck with next to no added mass.
    """
    if not model.propellers:
        shaft = Joint("shaft", "continuous", "body", "shaft", axis=(0.0, 0.0, 1.0))
        links = *model.links, Link("shaft", 1e-9, inertia=(1e-9, 0.0, 0.0, 1e-9, 0.0, 1e-9))
        model = replace(model, links=links, joints=(shaft,), propellers=(Propeller("shaft", 0.0, 0.0),))
    speck = Immersed(model.root, Sphere(1e-3), stokes=0.0, buoyant=False, added_mass=1e-9)
    model, fluid = replace(model, immersed=(*model.immersed, speck)), fluid or Fluid(WATER, level=-1e3)
    return compile_scene(model, fluid=fluid, integrator=integrator, **how)


def started(scene, z=0.0, velocity=(0.0, 0.0, 0.0), quaternion=(1.0, 0.0, 0.0, 0.0)):
    y = initial_state(scene)
    view = scene.state_view(y)
    view.base_q[:] = (0.0, 0.0, z, *quaternion)
    view.base_qd[:3] = velocity
    return y


def period_of(t, x):
    """Return the period of an oscillation about zero [s], from the times at which it rises through zero."""
    k = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    found = t[k] - x[k] * (t[k + 1] - t[k]) / (x[k + 1] - x[k])  # where it is straight
    return (found[-1] - found[0]) / (len(found) - 1)


# ---------------------------------------------------------------------------------------------- volumes below a plane


@entry
def part_below(table, triangles, d0, g, out):
    V, M = immersed(table[0], triangles, d0, (g[0], g[1], g[2]))
    out[0], out[1], out[2], out[3] = V, M[0], M[1], M[2]


def below(table, triangles, d0, g):
    out = np.zeros(4)
    part_below(table, triangles, d0, np.array(g), out)
    return out[0], out[1:]


def record(shape):
    table = records(1, IMMERSED)
    row = table[0]
    row.kind = {Sphere: SPHERE, Cylinder: CYLINDER, Capsule: CAPSULE}.get(type(shape), POLYHEDRON)
    row.radius, row.length = getattr(shape, "radius", 0.0), getattr(shape, "length", 0.0)
    row.end = len(triangles_of(Immersed("a", shape)))
    return table


SHAPES = {
    "sphere": Sphere(0.5),
    "cylinder": Cylinder(0.5, 1.2),
    "capsule": Capsule(0.5, 1.2),
    "box": Box((0.8, 0.6, 1.0)),
    "hull": Hull(((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.7, 0.7, 0.7))),
}


def planes(count=40):
    draw = np.random.default_rng(1)
    for _ in range(count):
        g = draw.normal(size=3) * [1.0, 1.0, 10.0 ** draw.uniform(-9, 3)]
        yield draw.uniform(-0.8, 0.8), tuple((g / np.linalg.norm(g)).tolist())


@pytest.mark.nojit
@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_volume_and_moment_grow_as_the_waterplane_says(shape):
    """The moment is the integral of V by the depth: int x.g dV = int (d - d0) dV, d int d+ dV / dd0 = V."""
    row, triangles = record(shape), triangles_of(Immersed("a", shape))
    for d0, g in planes(3):
        V, M = below(row, triangles, d0, g)
        depths = np.linspace(-1.6, d0, 1001)  # no part of a shape is farther from its origin
        volumes = np.array([below(row, triangles, d, g)[0] for d in depths])
        pressed = (d0 + 1.6) / 1000 * (volumes.sum() - 0.5 * (volumes[0] + volumes[-1]))  # int d+ dV
        assert np.dot(M, g) + d0 * V == pytest.approx(pressed, abs=2e-6)


@pytest.mark.nojit
@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_parts_above_and_below_make_the_whole(shape):
    row, triangles = record(shape), triangles_of(Immersed("a", shape))
    whole, moment = below(row, triangles, 10.0, (0.0, 0.0, 1.0))
    exact = 1e-7 if isinstance(shape, Capsule) else 1e-10
    for d0, g in planes():
        V, M = below(row, triangles, d0, g)
        W, N = below(row, triangles, -d0, tuple(-x for x in g))
        assert V + W == pytest.approx(whole, abs=exact)
        assert np.add(M, N) == pytest.approx(np.array(moment), abs=exact)


@pytest.mark.nojit
def test_a_cylinder_cut_at_any_tilt_is_exact():
    """An upright or tilted cylinder whose ends stay dry and wet has the volume of the slice up to its axis' depth."""
    R, L = 0.5, 6.0
    for d0, g in planes(200):
        if abs(g[2]) < 0.5:
            continue
        V, M = below(record(Cylinder(R, L)), np.zeros((0, 9)), d0, g)
        wet = 0.5 * L + d0 / abs(g[2])
        assert V == pytest.approx(math.pi * R * R * wet, rel=1e-12)
        k = math.pi * R**4 / (4.0 * abs(g[2]))  # the waterplane's second moment moves the center
        assert M[0] == pytest.approx(k * g[0], abs=1e-11)
        assert M[1] == pytest.approx(k * g[1], abs=1e-11)


@pytest.mark.nojit
def test_forces_have_continuous_slopes():
    for shape in SHAPES.values():
        row, triangles = record(shape), triangles_of(Immersed("a", shape))
        d = np.linspace(-1.7, 1.7, 3401)
        V = np.array([below(row, triangles, x, (0.48, 0.6, 0.64))[0] for x in d])
        assert np.abs(np.diff(V, 2)).max() < 4e-5 * np.abs(np.diff(V)).max() / 1e-3


# ---------------------------------------------------------------------------------------------- motion


@pytest.mark.long
def test_a_sphere_falls_at_the_terminal_speed_of_its_drag():
    r, m, C = 0.03, 0.2, 0.47
    scene = compile_scene(floating(Sphere(r), m, drag=C), fluid=Fluid(WATER))
    volume = 4 / 3 * math.pi * r**3
    speed = math.sqrt((m - WATER * volume) * G / (0.5 * WATER * C * math.pi * r * r))
    run = simulate(scene, 3.0, record=("base_q", "base_qd", "fluid_work"))
    assert run.success
    assert run["base_qd"][-1, 2] == pytest.approx(-speed, rel=1e-9)
    # on the way the closed form v = vt tanh(t / tau): m dv/dt = weight - drag
    tau = m * speed / ((m - WATER * volume) * G)
    assert run["base_qd"][:, 2] == pytest.approx(-speed * np.tanh(run["time"] / tau), abs=1e-5 * speed)
    energy = 0.5 * m * run["base_qd"][:, 2] ** 2 + m * G * run["base_q"][:, 2] - run["fluid_work"][:, 0].sum(axis=1)
    assert np.ptp(energy) < 1e-5


def test_a_slow_sphere_falls_as_stokes_says():
    r, m, mu = 0.01, 0.01, 1.5
    scene = in_fluid(floating(Sphere(r), m), Fluid(900.0, viscosity=mu, level=1e3))
    speed = (m - 900.0 * 4 / 3 * math.pi * r**3) * G / (6 * math.pi * mu * r)
    assert simulate(scene, 1.0, tau=[0.0], record=("base_qd",))["base_qd"][-1, 2] == pytest.approx(-speed, rel=1e-5)


@pytest.mark.long
def test_a_current_carries_what_it_holds():
    scene = compile_scene(
        floating(Sphere(0.05), 0.5, drag=1.0, added_mass=0.5), fluid=Fluid(WATER, current=(0.3, -0.2, 0.0))
    )
    run = simulate(scene, 60.0, record=("base_qd",))
    assert run["base_qd"][-1, :2] == pytest.approx([0.3, -0.2], abs=5e-3)


FLOATS = {
    # shape, mass, depth of the origin at rest over which nothing is known but m = density V, waterplane
    "sphere": (Sphere(0.1), 0.5 * WATER * 4 / 3 * math.pi * 1e-3, 0.0, math.pi * 0.01),
    "box": (Box((0.4, 0.3, 0.2)), 0.6 * WATER * 0.024, 0.02, 0.12),
    "cylinder": (Cylinder(0.2, 0.3), 0.7 * WATER * math.pi * 0.04 * 0.3, 0.06, math.pi * 0.04),
    "capsule": (Capsule(0.1, 0.2), 0.5 * WATER * (math.pi * 0.01 * 0.2 + 4 / 3 * math.pi * 1e-3), None, 0.0),
}


@pytest.mark.long
@pytest.mark.parametrize("added", [0.0, 0.5])
@pytest.mark.parametrize("name", ["sphere", "box", "cylinder"])
def test_bodies_float_and_bob_as_their_waterplane_says(name, added):
    shape, mass, depth, area = FLOATS[name]
    scene = compile_scene(floating(shape, mass, added_mass=added), fluid=Fluid(WATER, level=0.5))
    size = 1e-4
    run = simulate(scene, 4.0, started(scene, 0.5 - depth + size), record=("base_q",), record_interval=1e-3, rtol=1e-9)
    z = run["base_q"][:, 2] - (0.5 - depth)
    # the added mass is the share of it that is immersed, which is `added` times the mass that floats
    exact = 2 * math.pi * math.sqrt(mass * (1 + added) / (WATER * G * area))
    assert period_of(run["time"], z) == pytest.approx(exact, rel=1e-5)
    assert z.max() == pytest.approx(size, rel=1e-3)
    assert z.min() == pytest.approx(-size, rel=1e-2)  # about the depth at which it floats


@pytest.mark.long
def test_a_body_comes_to_rest_at_its_depth():
    shape, mass, depth, _ = FLOATS["box"]
    model = floating(shape, mass, linear_damping=200.0, turning_damping=1.0)
    scene = compile_scene(model, fluid=Fluid(WATER, level=0.5))
    run = simulate(scene, 8.0, started(scene, 0.7), record=("base_q", "immersed_share"))
    assert run.success
    assert run["base_q"][-1, 2] == pytest.approx(0.5 - depth, abs=1e-5 * 0.2)
    assert run["immersed_share"][-1, 0] == pytest.approx(0.6, abs=1e-5)


def test_a_box_rolls_with_the_period_of_its_metacenter():
    shape, mass, depth, _ = FLOATS["box"]
    length, beam, height = shape.size
    scene = in_fluid(floating(shape, mass), Fluid(WATER, level=0.0))
    angle = 1e-4
    start = started(scene, -depth, quaternion=(math.cos(0.5 * angle), math.sin(0.5 * angle), 0.0, 0.0))
    run = simulate(scene, 6.0, start, tau=[0.0], record=("base_q",), record_interval=1e-3, rtol=1e-9)
    roll = 2.0 * run["base_q"][:, 4]
    draft, volume = 0.6 * height, mass / WATER
    metacentric = length * beam**3 / 12 / volume + 0.5 * draft - 0.5 * height  # over the center of mass
    inertia = mass * (beam**2 + height**2) / 12
    exact = 2 * math.pi * math.sqrt(inertia / (mass * G * metacentric))
    assert period_of(run["time"], -roll) == pytest.approx(exact, rel=1e-5)


def drone(k=2e-5, q=4e-7, inertia=1e-4):
    """Return a mast that carries two propellers one over the other, which turn opposite ways."""
    links, joints = [Link("mast", 0.5, (0.0, 0.0, 0.0), (1e-2, 0.0, 0.0, 1e-2, 0.0, 1e-2))], []
    moments = inertia, 0.0, 0.0, inertia, 0.0, inertia
    for name, z in (("upper", 0.1), ("lower", 0.05)):
        links.append(Link(name, 0.05, (0.0, 0.0, 0.0), moments))
        axis = (0.0, 0.0, 1.0)
        joints.append(Joint(f"{name} shaft", "continuous", "mast", name, xyz=(0.0, 0.0, z), axis=axis))
    propellers = Propeller("upper shaft", k, q), Propeller("lower shaft", -k, q)
    return Model("drone", tuple(links), tuple(joints), "floating", propellers=propellers)


def test_a_drone_whose_thrust_is_its_weight_hovers():
    k, q = 2e-5, 4e-7
    scene = in_fluid(drone(k, q))
    speed = math.sqrt(0.5 * 0.6 * G / k)
    y = initial_state(scene)
    scene.state_view(y).qd[:] = speed, -speed
    torque = q * speed * speed
    run = simulate(scene, 5.0, y, tau=[torque, -torque], record=("base_q", "base_qd", "qd", "fluid_work", "energy"))
    assert run.success
    assert np.abs(run["base_qd"]).max() < 1e-6
    assert run["qd"][-1] == pytest.approx([speed, -speed], rel=1e-9)
    # all work on the shafts goes to the medium
    assert run["energy"][-1, :, 7].sum() == pytest.approx(-run["fluid_work"][-1, 0, 3], rel=1e-6)
    assert run["fluid_work"][-1, 0, 3] == pytest.approx(-2.0 * torque * speed * 5.0, rel=1e-6)


def test_a_shaft_comes_to_the_speed_at_which_torque_is_drag():
    """The mast is free, so that opposite torques on both shafts leave it at rest; w = ws tanh(t / ts)."""
    k, q, inertia, torque = 2e-5, 4e-7, 1e-4, 0.04
    scene = in_fluid(drone(k, q, inertia), gravity=(0.0, 0.0, 0.0))
    speed = math.sqrt(torque / q)
    run = simulate(scene, 1.0, tau=[torque, -torque], record=("base_qd", "qd"))
    assert run.success
    exact = speed * np.tanh(run["time"] * torque / (inertia * speed))
    assert run["qd"][:, 0] == pytest.approx(exact, rel=1e-5, abs=1e-5 * speed)
    # thrust is k w^2 on both: its integral is that of the closed form
    reached = 2.0 * k / 0.6 * np.trapezoid(exact**2, run["time"])
    assert run["base_qd"][-1, 2] == pytest.approx(reached, rel=1e-4)


def test_thrust_by_the_speed_itself_works_beside_that_by_its_square():
    """Shafts without drag keep their speed w: dv/dt = 2 (k w^2 + l w) / m, and the medium's work is kinetic energy."""
    k, linear, speed = 2e-5, 4e-3, 100.0
    model = drone(k, 0.0)
    upper, lower = model.propellers
    both = replace(upper, linear_thrust=linear), replace(lower, linear_thrust=-linear)
    scene = in_fluid(replace(model, propellers=both), gravity=(0.0, 0.0, 0.0))
    y = initial_state(scene)
    scene.state_view(y).qd[:] = speed, -speed
    run = simulate(scene, 1.0, y, tau=[0.0, 0.0], record=("base_qd", "fluid_work"), rtol=1e-8)
    thrust = k * speed**2 + linear * speed  # the lower one turns backward: -k w |w| = k speed^2, -l w = l speed
    reached = 2.0 * thrust / 0.6
    assert run["base_qd"][-1, 2] == pytest.approx(reached, rel=1e-6)
    assert run["fluid_work"][-1, 0, 3] == pytest.approx(0.5 * 0.6 * reached**2, rel=1e-6)


def test_thrust_turns_round_with_the_speed():
    scene = in_fluid(drone(), gravity=(0.0, 0.0, 0.0))
    ends = []
    for sign in (1.0, -1.0):
        y = initial_state(scene)
        scene.state_view(y).qd[:] = sign * 300.0, -sign * 300.0
        ends.append(simulate(scene, 0.2, y, tau=[0.0, 0.0], record=("base_qd",))["base_qd"][-1, 2])
    assert ends[0] > 0.1
    assert ends[1] == -ends[0]


@pytest.mark.quick("dop853")
@pytest.mark.parametrize("integrator", ["ars343", "dop853", "rk4"])
def test_work_of_the_medium_is_the_change_of_energy(integrator):
    """A tilted box falls into water with added mass and drag, and rocks: its energy is what the medium gave."""
    shape = Box((0.4, 0.3, 0.2))
    model = floating(shape, 15.0, drag=(1.0, 1.2, 0.8), turning_drag=0.5, added_mass=(0.2, 0.4, 0.9), added_inertia=0.1)
    scene = in_fluid(model, Fluid(WATER, 1e-3, 0.0, (0.2, 0.0, 0.0)), integrator)
    start = started(scene, 0.3, (0.5, 0.0, 0.0), (0.9, 0.3, 0.2, 0.1))
    how = {"rtol": None if integrator == "rk4" else 1e-6, "estimate_error": False}
    run = simulate(scene, 2.0, start, tau=[0.0], record=("base_q", "base_qd", "fluid_work"), **how)
    I = np.array(model.links[0].inertia)[[0, 3, 5]]
    v = run["base_qd"]
    kinetic = 0.5 * 15.0 * (v[:, :3] ** 2).sum(axis=1) + 0.5 * (I * v[:, 3:] ** 2).sum(axis=1)
    given = run["fluid_work"][:, 0].sum(axis=1)
    assert np.abs(run["fluid_work"][-1, 0, :3]).min() > 1e-2
    assert np.ptp(kinetic + 15.0 * G * run["base_q"][:, 2] - given) < 2e-3 * np.ptp(kinetic)


@pytest.mark.long
def test_runs_in_a_fluid_have_the_same_bits_in_lanes_as_alone():
    model = floating(Cylinder(0.2, 0.3), 20.0, drag=1.0, added_mass=0.3)
    for integrator in ("implicit_euler", "midpoint"):
        scene = compile_scene(model, fluid=Fluid(WATER, level=0.0), integrator=integrator)
        starts = [started(scene, 0.01 * k, (0.1 * k, 0.0, 0.0), (1.0, 0.1 * k, 0.0, 0.0)) for k in range(9)]
        together = simulate_batch(scene, 0.5, starts, estimate_error=False)
        for start, run in zip(starts, together):
            assert simulate(scene, 0.5, start, estimate_error=False).final.tobytes() == run.final.tobytes()


@pytest.mark.long
def test_a_body_moves_in_company_to_the_bits_of_one_alone():
    model = floating(Cylinder(0.2, 0.3), 20.0, drag=1.0, added_mass=0.3)
    other = replace(floating(Box((0.2, 0.2, 0.2)), 5.0, drag=1.0), name="box")
    fluid, found = Fluid(WATER, level=0.0), []
    for members in ([Placed(model, "it")], [Placed(other, "other"), Placed(model, "it")]):
        scene = compile_scene(members, fluid=fluid, integrator="implicit_euler")
        y = initial_state(scene)
        scene.state_view(y).base_q.reshape(-1, 7)[-1] = (0.0, 0.0, 0.1, 0.9, 0.3, 0.2, 0.1)
        run = simulate(scene, 0.5, y, estimate_error=False, record=("base_q", "immersed_share"))
        found.append((run["base_q"].reshape(-1, len(members), 7)[:, -1], run["immersed_share"][:, -1]))
    (alone, share), (together, its) = found
    assert alone.tobytes() == together.tobytes()
    assert share.tobytes() == its.tobytes()
