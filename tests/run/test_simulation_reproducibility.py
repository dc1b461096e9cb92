"""Whole runs to the last bit: alone or in a batch, on any thread, beside a run that fails, compiled or not."""

import hashlib
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from processors import PROCESSORS
from scenes import arm_scene, box_on, pendulum, thrown

from featherstone_gait.dynamics import energy, momentum
from featherstone_gait.model import Ground, Spring
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import Push, initial_state, simulate, simulate_batch
from featherstone_gait.scene.compile import compile_scene

COUNT = 11
RECORD = ("q", "qd", "energy", "voltage")


def arm_runs(count=COUNT, duration=0.1):
    """An arm, and as many starting states and references with equal knot times."""
    scene, rng = arm_scene(), np.random.default_rng(3)
    states = [initial_state(scene, q) for q in rng.normal(scale=0.3, size=(count, 7))]
    times = [0.0, 0.04, duration]
    return scene, states, [Reference(times, values) for values in rng.normal(scale=0.3, size=(count, 3, 7))]


def humanoid_runs(count=8):
    """A humanoid over the ground, let fall from various small heights."""
    scene, rng = (
        compile_scene(load_robot("humanoid"), "mipsd", Ground(), "implicit_euler", 1e-3),
        np.random.default_rng(4),
    )
    states = []
    for _ in range(count):
        state = initial_state(scene)
        state[2] += rng.uniform(0.0, 1e-3)
        states.append(state)
    return scene, states, [Reference([0.0], 0.1 * rng.normal(size=(1, scene.tree.n))) for _ in range(count)]


def bits(run):
    return (
        b"".join(run[name].tobytes() for name in run) + run.final.tobytes() + repr((run.status, run.message)).encode()
    )


@pytest.fixture(scope="module")
def arm():
    scene, states, references = arm_runs()
    alone = [
        bits(simulate(scene, 0.1, state, reference, record=RECORD)) for state, reference in zip(states, references)
    ]
    assert len(set(alone)) == COUNT
    return scene, states, references, alone


@pytest.mark.parametrize("size", [1, 3, 8, 11])
def test_a_run_alone_and_in_a_batch(arm, size):
    scene, states, references, alone = arm
    runs = simulate_batch(scene, 0.1, states[:size], references[:size], record=RECORD)
    assert [bits(run) for run in runs] == alone[:size]


def test_any_order(arm):
    scene, states, references, alone = arm
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(COUNT)
        runs = simulate_batch(scene, 0.1, [states[i] for i in order], [references[i] for i in order], record=RECORD)
        assert [bits(run) for run in runs] == [alone[i] for i in order]


@pytest.mark.parametrize("workers", [1, 2])
def test_any_executor(arm, workers):
    scene, states, references, alone = arm
    with ThreadPoolExecutor(workers) as executor:
        runs = simulate_batch(scene, 0.1, states * 2, references * 2, record=RECORD, executor=executor)
    assert [bits(run) for run in runs] == alone * 2


def test_other_processes(arm):
    scene, states, references, alone = arm
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        runs = simulate_batch(scene, 0.1, states[:4], references[:4], record=RECORD, executor=executor)
    assert [bits(run) for run in runs] == alone[:4]


def test_references_with_other_knot_times_in_one_batch(arm):
    scene, states, references, alone = arm
    other = Reference([0.0, 0.05], np.full((2, 7), 0.1))
    mixed = [references[0], other, references[2], None, *references[4:]]
    runs = simulate_batch(scene, 0.1, states, mixed, record=RECORD)
    for i, run in enumerate(runs):
        expected = alone[i] if i not in (1, 3) else bits(simulate(scene, 0.1, states[i], mixed[i], record=RECORD))
        assert bits(run) == expected


@pytest.mark.parametrize("bad", [0, 3, 7])
def test_a_run_that_diverges_beside_others(arm, bad):
    scene, states, references, alone = arm
    states = list(states)
    states[bad] = initial_state(scene, np.full(7, 0.1), [9e7, 5e3, -8e6, 0.0, 1e7, -9e6, 1.0])
    runs = simulate_batch(scene, 0.1, states[:8], references[:8], record=RECORD)
    assert runs[bad].status == "diverged"
    assert np.array_equal(runs[bad]["q"], np.full((11, 7), 0.1))  # the last sound state is the first
    assert np.isfinite(runs[bad].final).all()
    for i in range(8):
        if i != bad:
            assert bits(runs[i]) == alone[i]
    assert bits(runs[bad]) == bits(simulate(scene, 0.1, states[bad], references[bad], record=RECORD))


@pytest.mark.long
def test_a_robot_that_falls_beside_others_that_stand():
    scene, states, references = humanoid_runs()
    states[2] = states[2].copy()
    states[2][scene.layout["base_qd"] + 1] = 2.5
    runs = simulate_batch(scene, 1.0, states, references, record=("base_q", "contact_force"))
    assert runs[2].status == "fell"
    assert sum(run.status == "fell" for run in runs) < 8
    for run, state, reference in zip(runs, states, references):
        assert bits(run) == bits(simulate(scene, 1.0, state, reference, record=("base_q", "contact_force")))


@pytest.mark.parametrize("order", [1, -1])
def test_runs_with_error_control_of_robots_with_other_joints_in_one_batch(order):
    models = [pendulum(damping=0.0), load_robot("arm7_spatial")][::order]
    scenes = [compile_scene(model, integrator="dop853") for model in models]
    together = simulate_batch(scenes, 0.1)
    for run, scene in zip(together, scenes):
        np.testing.assert_array_equal(run["q"], simulate(scene, 0.1)["q"])


def test_an_empty_batch():
    assert simulate_batch(arm_scene(), 0.1, []) == []


def digest():
    """Hash of short runs with servos and on the ground, one alone and eight in lanes."""
    results = []
    for (scene, states, references), duration in [(arm_runs(9), 0.02), (humanoid_runs(9), 0.01)]:
        record = ("q", "qd", "base_q", "energy", "contact_force")
        results.append(simulate(scene, duration, states[0], references[0], record=record, record_interval=1e-3))
        results.extend(simulate_batch(scene, duration, states[1:], references[1:], record=record, record_interval=1e-3))
    for integrator in ("midpoint", "rk4"):
        scene = box_on(Ground(), integrator)
        results.append(
            simulate(scene, 0.02, thrown(scene, 0.0, 0.2, (1.0, 0.0, -0.5)), record=("base_q", "tangential_deflection"))
        )
    return hashlib.sha256(b"".join(bits(run) for run in results)).hexdigest()


def elsewhere(function, **settings):
    """What a function of this file prints in another process with these environment variables."""
    command = [sys.executable, "-c", f"import test_simulation_reproducibility as t; print(t.{function}())"]
    environment = os.environ | settings | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return run.stdout.strip()


@pytest.mark.long
def test_compiled_or_not():
    assert elsewhere("digest", NUMBA_DISABLE_JIT="1") == digest()


@pytest.mark.long
@pytest.mark.parametrize("processor", PROCESSORS)
def test_whole_runs_whatever_processor_the_linear_algebra_is_for(processor):
    assert elsewhere("digest", OPENBLAS_CORETYPE=processor) == digest()


def digest_of_constants():
    """Hash of all that kernels read of scenes whose axes, stops, springs, slopes and pushes lie askew."""
    walker = load_robot("humanoid", locked="simplified")
    skew = replace(
        walker, joints=tuple(replace(j, axis=(0.36, 0.48, 0.8), rpy=(0.3, -0.2, 0.7)) for j in walker.joints)
    )
    springs = [Spring(skew.links[0].name, skew.links[-1].name, (0.3, -0.1, 0.2), (0.1, 0.7, 0.3), 3.0, 0.1, 0.2)]
    ground = Ground(slope=0.1, height=0.3, steps=((0.1, 0.02),))
    robots = [(robot, kind, ground) for robot in (walker, skew) for kind in (None, "standard", "rotor", "mipsd")]
    found = hashlib.sha256()
    for model, kind, under in robots:
        scene = compile_scene(model, kind, under, springs=springs if kind is None else ())
        scene = scene.pushed([Push(model.links[-1].name, (1.0, 2.0, 3.0), point=(0.1, 0.3, 0.2), end=1.0)])
        for array in flat(scene.constants):
            found.update(array.tobytes())
        turned = np.linspace(0.1, 1.0, model.nq)  # the base's quaternion is not of unit length
        for state in (initial_state(scene), initial_state(scene, turned, allow_limit_violation=True)):
            found.update(state.tobytes())
    return found.hexdigest()


def flat(x):
    """The arrays of nested tuples."""
    if isinstance(x, tuple):
        return [array for part in x for array in flat(part)]
    return [x] if isinstance(x, np.ndarray) else []


@pytest.mark.quick(PROCESSORS[0])
@pytest.mark.parametrize("processor", PROCESSORS)
def test_constants_whatever_processor_the_linear_algebra_is_for(processor):
    assert elsewhere("digest_of_constants", OPENBLAS_CORETYPE=processor) == digest_of_constants()


# A humanoid in the air: nothing but its own inertia, and its weight.


def free_humanoid(integrator, timestep, gravity):
    robot = load_robot("humanoid")
    joints = tuple(replaced(joint) for joint in robot.joints)
    return compile_scene(
        type(robot)("free", robot.links, joints, "floating"), None, None, integrator, timestep, gravity=gravity
    )


def replaced(joint):
    """The joint without limits, damping and friction."""
    kind = "continuous" if joint.type == "revolute" else joint.type
    return type(joint)(joint.name, kind, joint.parent, joint.child, joint.xyz, joint.rpy, joint.axis)


def drift(integrator, timestep, gravity):
    """Largest errors of energy, and of linear and angular momentum about the origin, relative to their sizes."""
    scene = free_humanoid(integrator, timestep, gravity)
    model, rng = scene.model, np.random.default_rng(5)
    q = np.concatenate([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], 0.3 * rng.normal(size=scene.tree.n)])
    qd = np.concatenate([[0.3, -0.2, 0.5], rng.normal(size=3), 2.0 * rng.normal(size=scene.tree.n)])
    run = simulate(scene, 0.2, initial_state(scene, q, qd), record=("base_q", "base_qd", "q", "qd"))
    assert run.ok
    q, qd = np.hstack([run["base_q"], run["q"]]), np.hstack([run["base_qd"], run["qd"]])
    E = energy(model, q, qd, gravity=gravity).sum(axis=1)
    p = momentum(model, q, qd)
    weight = model.mass * np.asarray(gravity) * run["time"][:, None]
    kinetic = energy(model, q[:1], qd[:1])[0, 0]
    size = np.linalg.norm(p[0, 3:])
    return [
        np.abs(E - E[0]).max() / kinetic,
        np.abs(p[:, 3:] - p[0, 3:] - weight).max() / size,
        np.abs(p[:, :3] - p[0, :3]).max() / np.linalg.norm(p[0, :3]),
    ]


@pytest.mark.long
@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), (0.0, 0.0, -9.81)], ids=["weightless", "falling"])
@pytest.mark.parametrize(
    ("integrator", "order", "steps"), [("midpoint", 2, (1e-3, 5e-4, 2.5e-4)), ("rk4", 4, (2e-3, 1e-3, 5e-4))]
)
def test_energy_and_momentum_of_a_free_humanoid_are_kept_with_the_order_of_the_step(integrator, order, steps, gravity):
    errors = np.array([drift(integrator, h, gravity) for h in steps])
    for quantity, name in enumerate(("energy", "linear momentum", "angular momentum")):
        values = errors[:, quantity]
        if values.max() < 1e-11:
            continue  # kept to rounding
        slope = np.polyfit(np.log(steps), np.log(values), 1)[0]
        assert slope > order - 0.3, (name, values)
    assert errors[-1].max() < {"midpoint": 1e-3, "rk4": 1e-6}[integrator]
