"""The error that a companion tells of each run with error control, and what is said of a run that it shows wrong."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import (
    Ground,
    Reference,
    Trajectory,
    compile_scene,
    initial_state,
    load_robot,
)
from featherstone_gait import simulate as simulated
from featherstone_gait import simulate_batch as simulated_batch
from featherstone_gait.benchmark.precision import unlimited

simulate, simulate_batch = (functools.partial(run, estimate_error=None) for run in (simulated, simulated_batch))

ARM = unlimited(load_robot("arm7_spatial"))


def thrown(scene, angle):
    return initial_state(scene, np.full(7, angle))


@pytest.fixture(scope="module")
def free():
    return compile_scene(ARM, integrator="ars343")


def test_the_true_error_lies_near_the_one_that_is_told(free):
    exact = simulate(compile_scene(ARM), 0.5, thrown(free, 0.5), rtol=1e-11)
    for rtol in (1e-2, 1e-3, 1e-4):
        run = simulate(free, 0.5, thrown(free, 0.5), rtol=rtol)
        for name in ("q", "qd"):
            true, told = (np.abs(x).max() for x in (run[name] - exact[name], run.error[name]))
            assert true < 3.0 * told
            assert told < 10.0 * true


def test_a_run_beyond_prediction_says_so_and_since_when(free):
    run = simulate(free, 6.0, thrown(free, 1.5))
    assert run.status == "inaccurate"
    assert "uncertain" in run.message
    since = float(run.message.split("from ")[1].split(" s")[0])
    sound = run["time"] < since
    assert (run.error["q"][sound] <= 1e-3).all()
    assert run.error["q"].max() > 1e-3
    assert simulate(free, 6.0, thrown(free, 1.5), estimate_error=False).status == "ok"


def test_only_what_is_asked_for_is_kept(free):
    run = simulate(free, 0.05, thrown(free, 0.1), record=("torque",))
    assert set(run) == {"time", "torque"}
    assert set(run.error) == {"torque"}
    assert simulate(free, 0.05, thrown(free, 0.1), estimate_error=False).error is None


def test_pieces_alone_and_in_a_batch_have_the_same_error_to_the_bit():
    scene = compile_scene(load_robot("ax12_arm"), "mipsd", integrator="ars343")
    step = Reference([0.0], [[0.5]])
    whole, other = simulate_batch(scene, 0.06, references=[step, Reference([0.0], [[0.1]])])
    first = simulate(scene, 0.02, reference=step)
    rest = simulate(scene, 0.04, first, reference=step)
    assert rest.final.tobytes() == whole.final.tobytes()
    assert rest.companion.tobytes() == whole.companion.tobytes()
    assert rest.error["q"].tobytes() == whole.error["q"][2:].tobytes()
    assert other["q"][-1] != whole["q"][-1]


def test_a_companion_is_kept_in_the_file(free, tmp_path):
    run = simulate(free, 0.05, thrown(free, 0.1))
    run.save(tmp_path / "run")
    again = Trajectory.load(tmp_path / "run")
    assert again.companion.tobytes() == run.companion.tobytes()
    assert again.error["q"].tobytes() == run.error["q"].tobytes()


def test_a_run_that_has_fallen_at_the_start_ends_there():
    humanoid = load_robot("humanoid")
    scene = compile_scene(humanoid, "mipsd", Ground(), integrator="ars343")
    half = math.sin(math.pi / 4)
    q = np.concatenate([[0.0, 0.0, 0.5, half, half, 0.0, 0.0], np.zeros(scene.tree.n)])
    run = simulate(scene, 0.1, initial_state(scene, q, beyond_limits=True))
    assert (run.status, run.end_time) == ("fell", 0.0)


def test_noise_is_the_same_for_both():
    scene = compile_scene(load_robot("ax12_arm"), "mipsd", integrator="ars343")
    noise = np.random.default_rng(0).normal(size=(5, 1, 2)) * (1e-3, 0.1)
    run = simulate(scene, 0.05, reference=Reference([0.0], [[0.2]]), noise=noise)
    assert run.ok
    assert 0.0 < run.error["q"].max() < 1e-4


def test_a_companion_that_ends_otherwise_makes_a_run_inaccurate(free):
    from featherstone_gait.run.companion import accounted

    run = simulate(free, 0.1, thrown(free, 0.5), estimate_error=False)
    fell = replace(run, status="fell", end_time=0.05)
    assert accounted(run, fell, 0.25, ("q",)).status == "inaccurate"
