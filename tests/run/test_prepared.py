"""Runs made ready by hand: the bits of `simulate`, and a word where runs do not fit together."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import arm_scene

from featherstone_gait.benchmark.scenes import unlimited
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.prepare import prepare
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import simulate
from featherstone_gait.scene.compile import compile_scene


@pytest.fixture(scope="module")
def scene():
    return arm_scene()


def started(ready, count, times=(0.0, 0.02)):
    values = np.random.default_rng(0).normal(scale=0.2, size=(count, len(times), 7))
    return [ready.start(None, Reference(list(times), v)) for v in values]


@pytest.mark.quick("1")
@pytest.mark.parametrize("count", [1, 3, 8])
def test_a_run_made_ready_by_hand_has_the_bits_of_simulate(scene, count):
    ready = prepare(scene, 0.03, ("q", "power"))
    values = np.random.default_rng(0).normal(scale=0.2, size=(count, 2, 7))
    for (y, out), v in zip(ready.run(started(ready, count)), values):
        run = simulate(scene, 0.03, reference=Reference([0.0, 0.02], v), record=("q", "power"))
        assert y.tobytes() == run.final.tobytes()
        assert ready.named(out)["power"].tobytes() == run["power"].tobytes()


def test_runs_that_cannot_go_in_step_are_refused(scene):
    ready = prepare(scene, 0.03)
    starts = started(ready, 2)
    with pytest.raises(ValueError, match="arm7: 0 runs at once; 1 to 8 go in step"):
        ready.run([])
    with pytest.raises(ValueError, match="arm7: 9 runs at once; 1 to 8 go in step"):
        ready.run(started(ready, 9))
    with pytest.raises(ValueError, match="arm7: signals of other knot times do not go in step"):
        ready.run([*starts, *started(ready, 1, (0.0, 0.01))])
    noisy = ready.start(None, None, None, np.zeros((3, 7, 2)))
    with pytest.raises(ValueError, match="arm7: some runs have noise and some have none"):
        ready.run([starts[0], noisy])


@pytest.mark.long
def test_torques_from_outside_of_error_controlled_runs_are_announced():
    """Of a limp arm energies are integrated only where something does work."""
    arm = unlimited(load_robot("arm7"))
    free = compile_scene(replace(arm, servos={}), integrator="dop853")
    with pytest.raises(ValueError, match=r"arm7: torques from outside need prepare\(..., driven=True\)"):
        prepare(free, 0.02).start(tau=np.ones(7))
    ready = prepare(free, 0.02, driven=True)
    ((y, _),) = ready.run([ready.start(tau=np.ones(7))])
    run = simulate(free, 0.02, tau=np.ones(7), record=("energy",))
    assert y.tobytes() == run.final.tobytes()
    assert run["energy"][-1].sum() > 1e-3


def test_a_trajectory_of_another_robot_is_refused():
    run = simulate(arm_scene(), 0.02)
    other = arm_scene(load_robot("arm7_spatial"))
    with pytest.raises(ValueError, match=r"trajectory is of arm7 .*this scene is of arm7_spatial .*give its `final`"):
        simulate(other, 0.02, run)
    assert simulate(other, 0.02, run.final).status in ("ok", "chatter")
