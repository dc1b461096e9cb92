"""Robots that are stepped by hand: forces that change from tick to tick, and runs repeated from their inputs."""

import numpy as np
import pytest
from scenes import G

from featherstone_gait import Box, Push, Session, Trajectory, body, compile_scene, load_robot, replay, simulate
from featherstone_gait.run.driven import PUSH, Driven
from featherstone_gait.view.shown import in_posture


@pytest.fixture(scope="module")
def scene():
    return compile_scene(load_robot("ax12_arm"), "mipsd", integrator="midpoint", timestep=1e-3)


@pytest.fixture(scope="module")
def block():
    """A free block of 2 kg in space."""
    return compile_scene(body(Box((0.1, 0.2, 0.3)), mass=2.0, name="block"), integrator="rk4", timestep=1e-3)


def driven_by_hand(scene, ticks=30, **how):
    driven = Driven(scene, pushable=True, record=("qd", "voltage"), **how)
    for k in range(ticks):
        push = np.array([1.0, 0.01, 0.0, 0.1, 0.3, 0.1 * k, -0.2]) if 5 < k < 20 else None
        driven.step(np.array([1.0 if k < 15 else -0.5]), push)
    return driven


def test_a_force_on_a_free_body_accelerates_it_by_force_over_mass(block):
    with Session(block, pushes=[Push("body")], record=("base_qd",)) as session:
        session.step(ticks=10)
        fallen = session.state_view.base_qd[0].copy()
        session.set_push(0, Push("body", force=(3.0, 0.0, 4.0)))
        session.step(ticks=10)
        after = session.state_view.base_qd[0].copy()
        session.set_push(0, Push("body"))
        session.step(ticks=10)
        free = session.state_view.base_qd[0].copy()
    span = 10 * session.tick
    assert (after - fallen)[:3] / span == pytest.approx([1.5, 0.0, 2.0 - G], rel=1e-12)
    assert (free - after)[:3] / span == pytest.approx([0.0, 0.0, -G], rel=1e-12)
    assert free[3:].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.long
def test_a_held_force_is_that_of_one_run_with_the_push(block):
    push = Push("body", force=(3.0, 1.0, 4.0), point=(0.0, 0.05, 0.1))
    with Session(block, pushes=[Push("body")]) as session:
        session.set_push(0, push)
        session.step(ticks=20)
        run = simulate(block, 20 * session.tick, pushes=[push], estimate_error=False)
        assert session.state[0].tobytes() == run.final.tobytes()


def test_pushes_are_kept_and_refused_where_there_is_none(block, scene, tmp_path):
    push = Push("body", force=(3.0, 0.0, 0.0))
    with Session(block, pushes=[Push("body")]) as session, Session(block, pushes=[Push("body")]) as other:
        session.save(tmp_path / "first.npz")
        session.set_push(0, push)
        session.step()
        session.save(tmp_path / "pushed.npz")
        copied = session.copy()
        session.step(ticks=3)
        other.restore(tmp_path / "pushed.npz")
        for one in (other, copied):
            one.step(ticks=3)
            assert one.state.tobytes() == session.state.tobytes()
        other.restore(tmp_path / "first.npz")
        other.step()
        assert other.state_view.base_qd[0, 0] == 0.0
        with pytest.raises(ValueError, match="number"):
            session.set_push(1, push)
        with pytest.raises(ValueError, match="no link"):
            session.set_push(0, Push("nothing"))
        copied.close()
    with Session(scene) as session, pytest.raises(ValueError, match="it has none"):
        session.set_push(0, Push(scene.model.links[-1].name))


def test_pushes_of_each_tick_are_repeated_to_the_same_bits(block):
    driven = Driven(block, pushable=True)
    driven.warm_up()
    for k in range(20):
        driven.step(np.zeros(0), np.array([0.0, 0.05, 0.0, 0.1, 0.1 * k, 1.0, -0.2]) if k % 3 else None)
    run = driven.trajectory()
    assert np.abs(run["base_q"][-1, 3:] - [1.0, 0.0, 0.0, 0.0]).max() > 1e-3
    again = replay(block, run)
    assert again.final.tobytes() == run.final.tobytes()
    assert all(np.array_equal(again[name], run[name]) for name in run)


@pytest.mark.long
def test_a_run_is_repeated_to_its_bits_from_its_file(scene, tmp_path):
    run = driven_by_hand(scene).trajectory()
    run.save(tmp_path / "run")
    again = replay(scene, Trajectory.load(tmp_path / "run"))
    assert again.final.tobytes() == run.final.tobytes()
    assert {*again} == {*run}
    for name in run:
        assert np.array_equal(again[name], run[name]), name
    assert again.info["inputs"] == run.info["inputs"]
    assert run["push"].shape == (31, len(PUSH))
    assert not run["push"][20:].any()


@pytest.mark.long
def test_servos_follow_speeds_up_to_the_limits_of_their_joints(scene):
    driven = Driven(scene, pushable=True)
    for _ in range(60):
        driven.step(np.array([1.0]))
    assert driven.seen["qd"][0, 0] == pytest.approx(1.0, rel=0.05)
    upper = scene.model.moving_joints[0].upper
    for _ in range(600):
        driven.step(np.array([1.0]))
    assert driven.seen["q"][0, 0] == pytest.approx(upper, abs=0.05)
    for _ in range(60):
        driven.step(np.array([-1.0]))
    assert driven.seen["qd"][0, 0] == pytest.approx(-1.0, rel=0.05)  # at once, for the goal did not run away


def test_inputs_of_another_scene_or_of_none_are_refused(scene, block):
    driven = Driven(block, pushable=True)
    driven.step(np.zeros(0))
    run = driven.trajectory()
    with pytest.raises(ValueError, match="no inputs"):
        replay(block, in_posture(block.model))
    with pytest.raises(ValueError, match="give its scene"):
        replay(scene, run)
    with pytest.raises(ValueError, match="command has the shape"):
        driven.step(np.zeros(2))
    with pytest.raises(ValueError, match="action"):
        Driven(scene, "force")
    with pytest.raises(ValueError, match="no servos"):
        Driven(block, "speed")
