"""Servos that pull tendons: a drum on their joint winds a length up, of joints or along a path."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import (
    Joint,
    Link,
    Model,
    Reference,
    Tendon,
    Via,
    compile_scene,
    energy,
    forward_dynamics,
    load_robot,
    load_servo,
    save_robot,
    simulate,
    tendon_jacobian,
    tendon_lengths,
)
from featherstone_gait.dynamics import tendon_energy
from featherstone_gait.run.simulate import initial_state

QUIET = {"estimate_error": False}
STILL = (0.0, 0.0, 0.0)
BODY = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
RADIUS, INERTIA, MASS = 0.02, 2e-5, 0.4
ALL = ("q", "qd", "energy", "tendon_work", "current")


def winch(tendon, **servo):
    """A mass that slides upwards, and a drum with a servo, without mass but for its inertia."""
    links = Link("wall"), Link("block", MASS, STILL, BODY), Link("drum")
    up = Joint("z", "prismatic", "wall", "block", axis=(0.0, 0.0, 1.0), lower=-9.0, upper=9.0)
    turn = Joint("turn", "continuous", "wall", "drum", axis=(0.0, 1.0, 0.0), armature=INERTIA)
    own = replace(load_servo("xl330"), **servo)
    return Model("winch", links, (up, turn), servos={"turn": own}, tendons=[tendon])


def cable(stiffness, damping, **more):
    """A cable from a point above the mass over the drum, 1 m long at the start."""
    path = Via("wall", (0.0, 0.0, 1.0)), Via("block")
    return Tendon("cable", [("turn", RADIUS)], path, stiffness, damping, 1.0, **more)


@pytest.mark.long
@pytest.mark.parametrize("along", ["joints", "path"])
@pytest.mark.parametrize("gearbox", ["rotor", "mipsd"])
def test_a_stiff_cable_makes_the_load_an_inertia_of_the_servo(gearbox, along):
    """With J + m r^2 at the servo's joint the same servo does the same, electrically and mechanically."""
    servo = {} if gearbox == "rotor" else {"gearbox": replace(load_servo("xl330").gearbox, stiffness=5.0, damping=0.02)}
    tendon = cable(1e6, 1e2) if along == "path" else Tendon("t", [("turn", RADIUS), ("z", -1.0)], (), 1e6, 1e2)
    pulled = winch(tendon, **servo)
    hub = Joint("turn", "continuous", "wall", "drum", axis=(0.0, 1.0, 0.0), armature=INERTIA)
    J = MASS * RADIUS**2
    load = Link("drum", MASS, STILL, (J, 0.0, 0.0, J, 0.0, J))
    direct = Model("direct", (Link("wall"), load), (hub,), servos=pulled.servos)
    runs = []
    for model in (pulled, direct):
        scene = compile_scene(model, gearbox, integrator="implicit_euler", timestep=2e-4, gravity=STILL)
        n = scene.tree.n
        goal = Reference([0.0, 0.2], np.outer([0.0, 1.5], np.arange(n) == n - 1), "linear")
        runs.append(simulate(scene, 0.3, None, goal, record=ALL, **QUIET))
        assert runs[-1].ok
    loaded, servo_of = runs
    assert servo_of["q"][-1, 0] > 0.5
    np.testing.assert_allclose(loaded["q"][:, 1], servo_of["q"][:, 0], rtol=0, atol=2e-5)
    np.testing.assert_allclose(loaded["q"][:, 0], RADIUS * servo_of["q"][:, 0], rtol=0, atol=2e-5)
    np.testing.assert_allclose(loaded["energy"][:, 1], servo_of["energy"][:, 0], rtol=0, atol=1e-4)
    assert np.abs(servo_of["energy"][-1, 0]).max() > 0.05
    weight = 0.5 * MASS * loaded["qd"][:, 0] ** 2
    assert weight.max() > 1e-3


@pytest.mark.long
def test_a_winch_lifts_and_the_balance_of_energy_closes():
    """What the servo does is kinetic and potential energy, that of the cable, and what damper and friction take."""
    model = winch(cable(2e4, 20.0), coulomb_friction=0.0, viscous_friction=1e-3)
    scene = compile_scene(model, "rotor", integrator="extrapolation")
    start = initial_state(scene, [-MASS * 9.81 / 2e4, 0.0])
    run = simulate(scene, 0.4, start, Reference([0.0, 0.3], [[0.0, 0.0], [0.0, 2.0]], "linear"), record=ALL,
                   rtol=1e-9, **QUIET)  # fmt: skip
    rotor = model.servos["turn"].gearbox
    inertia = [0.0, INERTIA + rotor.ratio**2 * rotor.rotor_inertia]
    held = energy(model, run["q"], run["qd"], armature=inertia).total
    own, work = run["energy"][:, 1], run["tendon_work"]
    balance = held - own[:, 7] + own[:, 4] - work[:, 0, 1:].sum(axis=1)
    assert run["q"][-1, 0] > 0.02
    assert own[-1, 7] > 0.05
    assert work[-1, 0, 1] < -1e-6
    np.testing.assert_allclose(balance, balance[0], rtol=0, atol=1e-8)
    assert work[-1, 0, 0] == pytest.approx(tendon_energy(model, run["q"][0])[0] - tendon_energy(model, run["q"][-1])[0])


def test_lengths_and_forces_of_joints_and_path_add(tmp_path):
    model = winch(cable(50.0, 0.0, armature=0.3))
    q, qd = np.array([0.1, 2.0]), np.array([0.3, -1.0])
    assert tendon_lengths(model, q)[0] == pytest.approx(0.9 + RADIUS * 2.0)
    np.testing.assert_allclose(tendon_jacobian(model, q), [[-1.0, RADIUS]], rtol=0, atol=1e-15)
    J, f = np.array([-1.0, RADIUS]), 50.0 * (1.0 - 0.9 - 0.04)
    M = np.diag([MASS, INERTIA]) + 0.3 * np.outer(J, J)
    found = forward_dynamics(model, q, qd, np.zeros(2), gravity=STILL)
    np.testing.assert_allclose(found, np.linalg.solve(M, J * f), rtol=1e-9)
    save_robot(model, tmp_path / "winch.urdf")
    assert load_robot(tmp_path / "winch.urdf").tendons == model.tendons
    drum = Link("drum", 0.01, STILL, (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6))  # MJCF has no bodies without mass
    save_robot(replace(model, links=[*model.links[:2], drum]), tmp_path / "other.xml")
    text = (tmp_path / "other.xml").read_text()
    assert "left out the tendons of joints and a path: cable" in text
    assert load_robot(tmp_path / "other.xml").tendons == model.tendons
