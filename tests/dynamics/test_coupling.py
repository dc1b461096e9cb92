"""Joints that follow others: closed forms, the projected equations, Pinocchio, conserved quantities, equal bits."""

import hashlib
import math
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import published
import pytest
from company import in_company, simulated
from random_tree import random_states, random_tree
from scipy.special import ellipj, ellipk

from featherstone_gait import (
    ContactPoint,
    Ground,
    Joint,
    Link,
    Loop,
    Model,
    Reference,
    Wrench,
    close_loops,
    compile_scene,
    contact_positions,
    coupling_matrix,
    energy,
    forward_dynamics,
    forward_kinematics,
    initial_state,
    inverse_dynamics,
    load_robot,
    load_servo,
    loop_gaps,
    loop_jacobian,
    mass_matrix,
    momentum,
    simulate,
    simulate_batch,
)
from featherstone_gait.core.effects import energies
from featherstone_gait.model import Mimic

G = 9.81  # [m/s^2]
BOB = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)  # [kg m^2]
BASE = Link("base", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6)
# Across branches, a chain, two followers of one leader, sliding with turning, a follower that carries its leader.
PAIRS = {
    "joint3": ("joint7", -1.5, 0.2),
    "joint5": ("joint3", 0.7, 0.0),
    "joint9": ("joint7", 2.0, 0.1),
    "joint2": ("joint6", 0.3, 0.0),
}


def coupled(model, pairs):
    """The model with joints that follow others: name -> (leader, multiplier, offset)."""
    joints = tuple(replace(j, mimic=Mimic(*pairs[j.name])) if j.name in pairs else j for j in model.joints)
    return replace(model, joints=joints)


def tree(base, seed=0, **how):
    return coupled(random_tree(9, seed, base=base, **how), PAIRS)


def consistent(model, seed):
    """A state q, qd whose followers go with their leaders."""
    q, qd, _ = (a[0] for a in random_states(model, 1, seed))
    (matrix, offset), n = coupling_matrix(model), len(model.moving_joints)
    free = [k for k, joint in enumerate(model.moving_joints) if joint.mimic is None]
    first, columns = model.nv - n, matrix.shape[1] - len(free)
    q[model.nq - n :] = matrix[first:, columns:] @ q[model.nq - n :][free] + offset
    qd[first:] = matrix[first:, columns:] @ qd[first:][free]
    return q, qd


def projected(matrix, M, force):
    """G (G' M G)^-1 G' force"""
    return matrix @ np.linalg.solve(matrix.T @ M @ matrix, matrix.T @ force)


def residual(model, q, qd):
    """How far followers are from where their leaders want them: positions and velocities (samples, joints)."""
    matrix, offset = coupling_matrix(model)
    n = len(model.moving_joints)
    free = [k for k, joint in enumerate(model.moving_joints) if joint.mimic is None]
    part = matrix[-n:, matrix.shape[1] - len(free) :]
    q, qd = q[..., -n:], qd[..., -n:]
    return q - (q[..., free] @ part.T + offset), qd - qd[..., free] @ part.T


# --- the equations ------------------------------------------------------------------------------------------------


@pytest.mark.quick("floating-*")
@pytest.mark.nojit
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_accelerations_are_those_of_the_projected_equations(base, seed):
    """At any position and velocity, those too that do not agree with the couplings."""
    model, rng = tree(base, seed), np.random.default_rng(seed)
    q, qd, tau = (a[0] for a in random_states(model, 1, seed))
    armature, wrench = rng.uniform(0.0, 1e-3, 9), {"body8": Wrench(*rng.normal(size=6).reshape(2, 3)[::-1])}
    M = mass_matrix(model, q, armature=armature)
    bias = inverse_dynamics(model, q, qd, 0.0 * qd, wrench=wrench)
    matrix, _ = coupling_matrix(model)
    expected = projected(matrix, M, tau - bias)
    found = forward_dynamics(model, q, qd, tau, wrench=wrench, armature=armature)
    assert np.abs(found - expected).max() < 1e-13 * np.abs(np.linalg.solve(M, tau - bias)).max()
    _, drift = residual(model, q, found)
    assert np.abs(drift).max() < 1e-14 * np.abs(np.linalg.solve(M, tau - bias)).max()


def test_many_states_in_lanes_have_the_bits_of_one_by_one():
    model = tree("floating")
    states = random_states(model, 11, 1)
    found = forward_dynamics(model, *states)
    for k, row in enumerate(found):
        assert np.array_equal(row, forward_dynamics(model, *(a[k] for a in states)))


def test_without_followers_the_matrix_is_the_identity():
    matrix, offset = coupling_matrix(random_tree(5, 0, base="floating"))
    assert np.array_equal(matrix, np.eye(11))
    assert np.array_equal(offset, np.zeros(5))


def test_chains_are_resolved():
    """joint5 = 0.7 joint3 = 0.7 (-1.5 joint7 + 0.2)."""
    model = tree("fixed")
    matrix, offset = coupling_matrix(model)
    free = [joint.name for joint in model.moving_joints if joint.mimic is None]
    assert free == ["joint1", "joint4", "joint6", "joint7", "joint8"]
    names = list(model.joint_names)
    assert matrix[names.index("joint5"), free.index("joint7")] == pytest.approx(-1.05, rel=1e-15)
    assert offset[names.index("joint5")] == pytest.approx(0.14, rel=1e-15)
    assert np.count_nonzero(matrix) == 9


# --- against Pinocchio --------------------------------------------------------------------------------------------


def stripped(source, path):
    """Write a URDF without couplings, and without what has no part in the dynamics; return the couplings."""
    root, found = ElementTree.parse(source).getroot(), {}
    keep(root, "link", "joint")
    for link in root.iter("link"):
        mass = link.find("inertial/mass")
        keep(link, *["inertial"] if mass is not None and float(mass.get("value")) > 0 else [])
    for joint in root.iter("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            numbers = (float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0")))
            found[joint.get("name")] = (mimic.get("joint"), *numbers)
        keep(joint, "origin", "parent", "child", "axis", "limit")
    ElementTree.ElementTree(root).write(path)
    return found


def keep(element, *tags):
    """Remove an element's other children."""
    for child in list(element):
        if child.tag not in tags:
            element.remove(child)


@pytest.mark.parametrize(
    ("urdf", "followers"),
    [
        ("panda_description/urdf/panda.urdf", 1),
        ("baxter_description/urdf/baxter.urdf", 2),
        ("talos_data/robots/talos_full_v2.urdf", 12),
        ("tiago_pro_description/robots/tiago_pro.urdf", 10),
    ],
)
def test_hands_of_real_robots_against_pinocchio(urdf, followers, tmp_path):
    """G (G' M G)^-1 G' (tau - c) of Pinocchio's M and c of the robot without couplings."""
    pin = pytest.importorskip("pinocchio")
    path = tmp_path / "robot.urdf"
    pairs = stripped(published.folder("example-robot-data") / urdf, path)
    model, theirs = coupled(load_robot(path), pairs), pin.buildModelFromUrdf(str(path))
    at, columns = theirs.createData(), [theirs.joints[theirs.getJointId(name)].idx_v for name in model.joint_names]
    q, qd, tau = np.random.default_rng(0).normal(size=(3, model.nv))

    def ordered(x):
        y = np.zeros(theirs.nv)
        y[columns] = x
        return y

    position = pin.integrate(theirs, pin.neutral(theirs), ordered(q))
    M = np.triu(pin.crba(theirs, at, position))
    M = (M + np.triu(M, 1).T)[np.ix_(columns, columns)]
    matrix, _ = coupling_matrix(model)
    assert matrix.shape == (model.nv, model.nv - followers)
    expected = projected(matrix, M, tau - pin.nonLinearEffects(theirs, at, position, ordered(qd))[columns])
    assert np.abs(forward_dynamics(model, q, qd, tau) - expected).max() < 1e-12 * np.abs(expected).max()


# --- closed forms -------------------------------------------------------------------------------------------------


def swings(pairs, lengths=(1.0, 1.0)):
    """Pendulums side by side, 1 kg each; some follow others."""
    bobs = [Link(f"bob{k}", 1.0, (0.0, 0.0, -length), BOB) for k, length in enumerate(lengths)]
    joints = [
        Joint(f"hinge{k}", "continuous", "base", f"bob{k}", (0.0, float(k), 0.0), axis=(0.0, 1.0, 0.0))
        for k in range(len(lengths))
    ]
    return coupled(Model("swings", (BASE, *bobs), tuple(joints)), pairs)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "extrapolation"])
def test_two_pendulums_that_go_together_are_one(integrator):
    """1 m and 0.5 m long: a compound pendulum, sin(q/2) = k sn(K - w t), for ten seconds."""
    scene = compile_scene(swings({"hinge1": ("hinge0",)}, (1.0, 0.5)), integrator=integrator)
    run = simulate(scene, 10.0, initial_state(scene, [math.pi / 2] * 2), rtol=1e-13, record_interval=0.1)
    w, k = math.sqrt(1.5 * G / (1.0 + 0.25 + 0.02)), math.sin(math.pi / 4)
    sn = ellipj(ellipk(k * k) - w * run["time"], k * k)[0]
    assert np.abs(run["q"][:, 0] - 2.0 * np.arcsin(k * sn)).max() < 2e-11
    assert np.array_equal(run["q"][:, 0], run["q"][:, 1])


@pytest.mark.long
def test_a_pendulum_that_turns_the_other_way_around_needs_no_force():
    """Two alike, one the mirror image of the other: as each would swing alone."""
    alone, pair = compile_scene(swings({}, (1.0,))), compile_scene(swings({"hinge1": ("hinge0", -1.0)}))
    one = simulate(alone, 1.0, initial_state(alone, [1.0]), rtol=1e-12)["q"]
    two = simulate(pair, 1.0, initial_state(pair, [1.0, -1.0]), rtol=1e-12)["q"]
    assert np.abs(two - one * [1.0, -1.0]).max() < 1e-10


def atwood(heavy=2.0, light=0.5, **changes):
    """Two weights that slide up and down: one rises as the other sinks."""
    links = [Link(name, m, (0.0, 0.0, 0.0), BOB) for name, m in (("heavy", heavy), ("light", light))]
    joints = [
        Joint(f"{link.name} slides", "prismatic", "base", link.name, (0.0, y, 0.0), axis=(0.0, 0.0, 1.0))
        for y, link in enumerate(links)
    ]
    model = coupled(Model("Atwood's machine", (BASE, *links), tuple(joints)), {"light slides": ("heavy slides", -1.0)})
    return replace(model, **changes)


@pytest.mark.bounds
@pytest.mark.nojit
def test_atwood_machine():
    a = -G * (2.0 - 0.5) / (2.0 + 0.5)
    np.testing.assert_allclose(forward_dynamics(atwood(), [0.3, -0.1], [0.0, 0.0], [0.0, 0.0]), [a, -a], rtol=1e-15)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["midpoint", "rk4", "extrapolation"])
def test_ground_under_one_weight_carries_what_the_other_does_not(integrator):
    model = atwood(contacts=(ContactPoint("heavy", (0.0, 0.0, 0.0)),))
    scene = compile_scene(model, ground=Ground(), integrator=integrator, timestep=1e-3)
    run = simulate(scene, 2.0, record=("contact_force", "q"))
    assert run.ok, run.message
    assert run["contact_force"][-1, 0, 0] == pytest.approx(G * (2.0 - 0.5), rel=1e-6)
    assert np.array_equal(run["q"][:, 0], -run["q"][:, 1])


@pytest.mark.long
@pytest.mark.parametrize("stopped", ["heavy slides", "light slides"])
def test_the_stop_of_either_joint_holds_both(stopped):
    model = atwood()
    limits = {"lower": -0.05, "upper": 0.05, "effort": 50.0}
    joints = tuple(replace(j, **limits) if j.name == stopped else j for j in model.joints)
    scene = compile_scene(replace(model, joints=joints), integrator="implicit_euler", timestep=1e-3)
    q = simulate(scene, 5.0)["q"]
    stiffness = scene.constants.stops[model.joint_names.index(stopped)].stiffness
    assert q[-1, 0] == pytest.approx(-0.05 - G * (2.0 - 0.5) / stiffness, abs=1e-7)


def test_friction_of_the_follower_brakes_the_leader():
    """At 3 N s/m and 1 N: a terminal speed of (weight - 1 N) / (3 N s/m)."""
    model = atwood()
    joints = (model.joints[0], replace(model.joints[1], damping=3.0, friction=1.0))
    run = simulated(in_company(replace(model, joints=joints), "implicit_euler", 1e-3), 20.0)
    assert run["qd"][-1] == pytest.approx(np.array([-1.0, 1.0]) * (G * 1.5 - 1.0) / 3.0, rel=1e-6)


def test_a_joint_feels_the_inertia_of_what_goes_with_it():
    """Leader: m1 + k^2 m2; follower: m2 + m1 / k^2."""
    model = coupled(atwood(), {"light slides": ("heavy slides", -3.0)})
    inertias = compile_scene(model).preflight.inertias
    assert inertias == pytest.approx((2.0 + 9.0 * 0.5, 0.5 + 2.0 / 9.0), rel=1e-14)


# --- conserved, and of what order ---------------------------------------------------------------------------------


def falling(integrator, timestep=1e-3, seed=3):
    """A free tree whose joints turn, some of them together, at a few rad/s."""
    model = tree("floating", seed, prismatic=0.2)
    joints = tuple(replace(j, lower=-math.inf, upper=math.inf) for j in model.joints)
    scene = compile_scene(replace(model, joints=joints), None, None, integrator, timestep)
    return scene, initial_state(scene, *consistent(scene.model, seed))


@pytest.mark.long
def test_a_free_fall_keeps_energy_and_momentum():
    scene, state = falling("dop853")
    run = simulate(scene, 0.3, state, rtol=1e-12, record=("base_q", "q", "base_qd", "qd"), record_interval=0.01)
    q, qd = np.hstack([run["base_q"], run["q"]]), np.hstack([run["base_qd"], run["qd"]])
    E, p = energy(scene.model, q, qd), momentum(scene.model, q, qd)
    assert np.ptp(E.sum(axis=1)) < 1e-10 * E[:, 0].max()
    weight = scene.model.mass * np.array([0.0, 0.0, -G]) * run["time"][:, None]
    p[:, 3:] -= weight
    assert np.abs(p - p[0]).max() < 1e-11 * np.abs(p[0]).max()


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "order"), [("implicit_euler", 1), ("midpoint", 2), ("rk4", 4)])
def test_order_of_convergence(integrator, order):
    scene, state = falling("dop853")
    exact = simulate(scene, 0.08, state, rtol=1e-13, record_interval=0.08)["q"][-1]
    sizes, errors = (2e-3, 1e-3, 5e-4), []
    for h in sizes:
        scene, state = falling(integrator, h)
        run = simulate(scene, 0.08, state, record_interval=0.08)
        errors.append(np.abs(run["q"][-1] - exact).max())
        assert np.abs(residual(scene.model, run["q"], run["qd"])).max() < 1e-14 * 10.0
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(order, abs=0.25), errors


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "lag"), [("implicit_euler", 1), ("dop853", 0)])
def test_on_the_ground_every_acceleration_is_that_of_the_projected_equations(integrator, lag):
    """A free tree on its base and a tip; implicit Euler takes the forces at the end of the step, the bias at its start.

    Here the contacts are folded into the inertias of base and tip, on which the couplings act.
    """
    scene, _ = falling(integrator, 5e-4)
    q, qd = consistent(scene.model, 3)
    poses = forward_kinematics(scene.model, q)
    q[2] = 0.25 - 1e-4  # feet straight down to as far under the ground
    feet = {k: poses.rotation[k].T @ [0.0, 0.0, poses.position[0, 2] - 0.25 - poses.position[k, 2]] for k in (0, 8)}
    points = tuple(ContactPoint(f"body{k}", tuple(foot)) for k, foot in feet.items())
    model = replace(scene.model, contacts=points)
    scene = compile_scene(model, None, Ground(), integrator, 5e-4, fall_height=-1e6, fall_tilt=3.2)
    names = ("base_q", "q", "base_qd", "qd", "base_qdd", "qdd", "contact_force")
    run = simulate(
        scene, 0.01, initial_state(scene, q, 0.1 * qd), record=names, record_interval=5e-4, **tolerance(integrator)
    )
    q, qd, qdd = (np.hstack([run["base_" + name], run[name]]) for name in ("q", "qd", "qdd"))
    matrix, _ = coupling_matrix(model)
    loads = run["contact_force"][:, :, [1, 2, 0]]
    assert ((loads[2:, :, 2] > 0).sum(axis=0) > 5).all()  # samples in touch, of both
    for k in range(2, len(q) - lag):
        arms = contact_positions(model, q[k]) - forward_kinematics(model, q[k]).position[list(feet)]
        wrench = {p.link: Wrench(f, np.cross(arm, f)) for p, arm, f in zip(points, arms, loads[k + lag])}
        bias = inverse_dynamics(model, q[k], qd[k], 0.0 * qd[k], wrench=wrench)
        expected = projected(matrix, mass_matrix(model, q[k]), -bias)
        assert np.abs(qdd[k + lag] - expected).max() < 1e-7 * np.abs(expected).max(), k


def tolerance(integrator):
    return {"rtol": 1e-8} if integrator == "dop853" else {}


# --- servos -------------------------------------------------------------------------------------------------------


def gripper(kind, integrator="implicit_euler", timestep=1e-3):
    """Four links one after the other, on AX-12; of the last two one turns as the one before, a rod slides along."""
    links = [Link(f"link{k}", 0.1, (0.03, 0.0, 0.0), (2e-5, 0.0, 0.0, 3e-5, 0.0, 3e-5)) for k in range(5)]
    axis = (0.0, 1.0, 0.0)
    joints = [
        Joint(f"joint{k}", "revolute", f"link{k - 1}" if k else "base", f"link{k}", (0.06, 0.0, 0.0), axis=axis,
              lower=-0.8, upper=0.8, friction=0.01)
        for k in range(4)
    ]  # fmt: skip
    joints.append(Joint("rod", "prismatic", "link1", "link4", (0.06, 0.02, 0.0), lower=-0.1, upper=0.1, damping=1.0))
    model = Model("gripper", (BASE, *links), tuple(joints))
    model = coupled(model, {"joint3": ("joint2", -0.8, 0.1), "rod": ("joint3", 0.02, 0.005)})
    servos = {f"joint{k}": load_servo("ax12") for k in range(3)}
    return compile_scene(replace(model, servos=servos), kind, None, integrator, timestep)


def grips(scene, count=1):
    """Starts and references of a gripper whose motors clip and whose joints meet their stops."""
    rng = np.random.default_rng(2)
    states = []
    for _ in range(count):
        q = np.zeros(5)
        q[:3] = rng.uniform(-0.5, 0.5, 3)
        q[3] = -0.8 * q[2] + 0.1
        q[4] = 0.02 * q[3] + 0.005
        states.append(initial_state(scene, q))
    references = [Reference([0.0, 0.1], rng.uniform(-1.5, 1.5, (2, 5))) for _ in range(count)]
    return states, references


@pytest.mark.long
@pytest.mark.parametrize("kind", ["rotor", "mipsd"])
def test_driven_steps_converge_to_the_extrapolated_motion(kind):
    scene = gripper(kind)
    (state,), (reference,) = grips(scene)
    exact = simulate(scene, 0.1, state, reference, record_interval=0.1, rtol=1e-9)
    assert exact.ok, exact.message
    errors = []
    for h in (1e-3, 5e-4, 2.5e-4):
        run = simulate(gripper(kind, timestep=h), 0.1, state, reference, record_interval=0.1, record=("q", "qd"))
        assert run.ok, run.message
        assert np.abs(residual(scene.model, run["q"], run["qd"])).max() < 1e-14 * 10.0
        errors.append(np.abs(run["q"][-1] - exact["q"][-1]).max())
    assert errors[2] < 0.6 * errors[1] < 0.36 * errors[0], errors


@pytest.mark.long
def test_couplings_do_no_work():
    """What the servos give the joints is in their motion, in friction or in the stops."""
    scene = gripper("rotor")
    (state,), (reference,) = grips(scene)
    run = simulate(scene, 0.1, state, reference, record=("q", "qd", "energy"), record_interval=0.1, rtol=1e-9)
    E = energy(scene.model, run["q"], run["qd"], armature=scene.constants.armature).sum(axis=1)
    books = run["energy"][-1].sum(axis=0)
    spent = books[energies.FRICTION] + books[energies.STOPS]
    assert abs(books[energies.WORK] - spent - (E[-1] - E[0])) < 1e-7 * books[energies.METER]


# --- drift and bits -----------------------------------------------------------------------------------------------


def test_without_correction_the_couplings_drift_by_rounding_alone():
    """A thousand steps of solving and advancing, without what follows a step."""
    from featherstone_gait.benchmark.skip import solve_loop
    from featherstone_gait.run.prepare import prepare

    scene, state = falling("implicit_euler")
    ready = prepare(scene, 1.0)
    run, y, _ = ready.arguments(ready.start(state))
    solve_loop(1000, run, True, 1e-3, y, np.zeros(1001))
    first, n = scene.layout["q"], scene.tree.n
    drift = residual(scene.model, y[first : first + n], y[scene.layout["qd"] : scene.layout["qd"] + n])
    assert 0 < np.abs(drift).max() < 1e-12


def bits(run):
    return b"".join(run[name].tobytes() for name in run) + run.final.tobytes() + run.status.encode()


RUNS = [("mipsd", "implicit_euler"), ("rotor", "midpoint"), ("standard", "simtwo")]


@pytest.mark.long
@pytest.mark.parametrize(("kind", "integrator"), RUNS)
def test_the_same_bits_alone_and_in_a_batch(kind, integrator):
    scene = gripper(kind, integrator)
    states, references = grips(scene, 9)
    runs = simulate_batch(scene, 0.05, states, references, record=("q", "qd", "energy"))
    assert len({bits(run) for run in runs}) == 9
    for run, state, reference in zip(runs, states, references):
        assert bits(run) == bits(simulate(scene, 0.05, state, reference, record=("q", "qd", "energy")))


@pytest.mark.long
@pytest.mark.nojit
def test_the_bits_are_these_compiled_or_not():
    """With servos, alone and in lanes, and in free fall."""
    results = []
    for kind, integrator in RUNS[:2]:
        scene = gripper(kind, integrator)
        states, references = grips(scene, 2)
        results.append(simulate(scene, 0.02, states[0], references[0]))
        results += simulate_batch(scene, 0.02, states, references)
    scene, state = falling("dop853")
    results.append(simulate(scene, 0.02, state, rtol=1e-6))
    assert hashlib.sha256(b"".join(bits(run) for run in results)).hexdigest()[:16] == "e9a6f5b899551025"


# --- held joints --------------------------------------------------------------------------------------------------


def test_what_follows_a_locked_joint_is_held_with_it():
    model = replace(tree("fixed"), locked={"joint7": 0.4})
    assert model.held == pytest.approx({"joint7": 0.4, "joint3": -0.4, "joint5": -0.28, "joint9": 0.9})
    by_hand = replace(random_tree(9, 0), locked=dict(model.held))
    assert model.joint_names == by_hand.joint_names
    q = coupled(by_hand, {"joint2": PAIRS["joint2"]})
    state = [a[0] for a in random_states(q, 1, 5)]
    assert np.array_equal(forward_dynamics(model, *state), forward_dynamics(q, *state))


def test_what_follows_a_fixed_joint_or_none_at_all_is_held_at_its_offset():
    model = swings({"hinge1": ("hinge0", 2.0, 0.3)})
    fixed = replace(model, joints=(replace(model.joints[0], type="fixed"), model.joints[1]))
    assert fixed.held == {"hinge1": 0.3}
    assert swings({"hinge1": ("hinge0", 0.0, 0.3)}).held == {"hinge1": 0.3}


def test_a_follower_that_is_locked_is_held_and_its_leader_goes_free():
    model = replace(swings({"hinge1": ("hinge0",)}), locked={"hinge1": 0.5})
    assert model.held == {"hinge1": 0.5}
    assert model.joint_names == ("hinge0",)
    position = forward_kinematics(model, [0.0]).rotation[2]
    assert position[0, 0] == pytest.approx(math.cos(0.5), rel=1e-15)


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ({"hinge1": ("knee",)}, "'hinge1': it follows 'knee', and there is no such joint"),
        ({"hinge1": ("hinge1",)}, "'hinge1' follow each other in a circle"),
        ({"hinge0": ("hinge1",), "hinge1": ("hinge0",)}, "'hinge0', 'hinge1' follow each other in a circle"),
    ],
)
def test_couplings_that_lead_nowhere_are_refused(pairs, message):
    with pytest.raises(ValueError, match=message):
        swings(pairs)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["midpoint", "rk4"])
def test_couplings_hold_beside_loops_on_the_same_joints(integrator):
    """To rounding at each record, while a rod to the world and one between links of followers stay closed."""
    model = coupled(random_tree(7, 3), {"joint5": ("joint2", 0.5, 0.1), "joint7": ("joint3", -1.7, 0.0)})
    links = [link.name for link in model.links]
    rods = (
        Loop("rod", "distance", links[-1], None, (0.1, 0.0, 0.0), (1.0, 0.5, 0.3), distance=2.0),
        Loop("between", "distance", links[5], links[2], (0.1, 0.0, 0.0), (0.0, 0.1, 0.3), distance=0.4),
    )
    model = replace(model, loops=rods)
    q = close_loops(model, random_states(model, 1, 2)[0][0])
    scene = compile_scene(model, integrator=integrator, timestep=1e-3)
    run = simulate(scene, 0.3, initial_state(scene, q), record=("q", "qd"), estimate_error=False)
    assert np.abs(run["qd"]).max() > 3.0
    for x, at in ((run["q"], 0.1), (run["qd"], 0.0)):
        np.testing.assert_allclose(x[:, 4], 0.5 * x[:, 1] + at, rtol=0, atol=1e-15)
        np.testing.assert_allclose(x[:, 6], -1.7 * x[:, 2], rtol=0, atol=1e-15)
    assert np.abs(loop_gaps(model, run["q"])).max() < 1e-12
    rates = (loop_jacobian(model, run["q"]) @ run["qd"][..., None])[..., 0]
    assert np.abs(rates).max() < 1e-10


# --- the start ----------------------------------------------------------------------------------------------------


def test_a_start_that_is_not_given_follows():
    scene = compile_scene(swings({"hinge1": ("hinge0", 2.0, 0.3)}))
    first = scene.layout["q"]
    assert initial_state(scene)[first : first + 2].tolist() == [0.0, 0.3]


def test_a_state_that_disagrees_is_refused():
    scene = compile_scene(swings({"hinge1": ("hinge0", 2.0, 0.3)}))
    state = initial_state(scene)
    state[scene.layout["q"]] = 1.0
    with pytest.raises(ValueError, match=r"q of joint hinge1 is 0\.3.* give 2\.3"):
        simulate(scene, 0.1, state)


def test_a_start_that_disagrees_is_refused():
    scene = compile_scene(swings({"hinge1": ("hinge0", 2.0, 0.3)}))
    assert initial_state(scene, [0.1, 0.5 + 1e-10], [1.0, 2.0]) is not None
    with pytest.raises(ValueError, match=r"q of joint hinge1 is 0\.4.* it follows hinge0: give 0\.5"):
        initial_state(scene, [0.1, 0.4])
    with pytest.raises(ValueError, match=r"qd of joint hinge1 is 0\.0 rad/s, but it follows hinge0: give 2\.0"):
        initial_state(scene, None, [1.0, 0.0])
