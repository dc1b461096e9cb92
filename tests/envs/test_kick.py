"""The environment with an object: Gymnasium's checks, a controller that scores, an agent that does not, bits."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from featherstone_gait.envs import Kick, Stand, kick_scene
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.session import Session
from featherstone_gait.run.simulate import simulate

TIMES = np.cumsum([0.0, 0.4, 0.18, 0.16])  # standing, leaning to the left, leg lifted back, kicked [s]


@pytest.fixture(scope="module")
def scene():
    return kick_scene(load_robot("humanoid", locked="simplified"))


def postures(names):
    """Joint positions (times, joints) of a kick with the right foot [rad]."""
    lean = {f"{side}_hip_lateral": 0.22 for side in ("left", "right")}
    lean |= {f"{side}_ankle_lateral": -0.22 for side in ("left", "right")}
    leg = ("right_hip_front", "right_knee", "right_ankle_front")
    poses = {}, lean, lean | dict(zip(leg, (0.52, 0.5, -1.02))), lean | dict(zip(leg, (0.4, -0.42, -0.28)))
    return np.array([[pose.get(name, 0.0) for name in names] for pose in poses])


def kicked(env, seed):
    """Rewards without the effort, way of the ball to the goal [m], and last info, of an episode of the kick."""
    table, total = postures(env._robots.alone.model.joint_names), 0.0
    seen, info = env.reset(seed=seed)
    start = np.hypot(*seen[-2:])
    ended = late = False
    while not (ended or late):
        action = [np.interp(info["time"] + 0.02, TIMES, column) for column in table.T]
        seen, reward, ended, late, info = env.step(np.array(action))
        total += reward + 0.01 * np.mean(np.square(action))
    return total, start - np.hypot(*seen[-2:]), info


@pytest.mark.long
def test_gymnasium_finds_nothing_wrong(scene):
    made = gymnasium.make("featherstone_gait/Kick-v0", robot=scene, duration=0.2, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(infinity|spec|render).*")
        check_env(made.unwrapped)
    made.close()


@pytest.mark.long
def test_a_kick_scores_and_chance_does_not(scene):
    """What is rewarded besides goal and effort is the way of the ball, whose speed is taken at the end of each step."""
    env = Kick(scene, scale=1.0, duration=3.0)
    found = [kicked(env, seed) for seed in range(10)]
    assert sum(info["goal"] for *_, info in found) >= 9
    for total, way, info in found:
        if info["goal"]:
            assert info["tilt"] < 0.2
            assert total == pytest.approx(1.0 + way, abs=0.04)  # the way in a step of 20 ms at 2 m/s
    draw, goals, rewards = np.random.default_rng(0), 0.0, []
    for seed in range(10):
        env.reset(seed=seed)
        ended = late = False
        while not (ended or late):
            _, reward, ended, late, info = env.step(draw.uniform(-0.3, 0.3, 10))
            rewards.append(reward)
        goals += info["goal"]
    assert goals == 0.0
    assert sum(rewards) / 10 < 0.5
    env.close()


@pytest.mark.long
def test_pictures_show_the_ball(scene):
    """A picture changes where the ball alone has moved."""
    env = Kick(scene, render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    states = env._session.state
    base = scene.state_view(states).base_q.copy()
    base[0, 1, :2] += 0.1
    env._session.set_state("base_q", base.reshape(1, -1))
    assert not np.array_equal(env.render(), first)
    env.close()


def test_what_cannot_kick_is_an_error_that_names_it(scene):
    for robot, says in ((load_robot("arm7"), "arm7"), (scene.member("robot").scene, "kick_scene")):
        with pytest.raises(ValueError, match=says):
            Kick(robot)
    with pytest.raises(ValueError, match="mass"):
        kick_scene("humanoid", mass=0.0)
    with pytest.raises(ValueError, match="one robot alone"):
        Stand(scene)


@pytest.mark.long
def test_a_session_has_the_bits_of_one_run_and_sees_bodies_that_are_moved_by_hand(scene):
    """A ball that is put against the foot is pushed, one that is put away is not and forgets its bristle."""
    table = postures(scene.member("robot").model.joint_names)
    actions = [[np.interp(0.01 * (k + 1), TIMES, column) for column in table.T] for k in range(80)]
    session = Session(scene, 1, observe=("base_q", "base_qd", "pair_deflection"))
    for action in actions:
        seen = session.step(action)
    hold = Reference(0.01 * np.arange(80), actions, kind="hold")
    record = ("base_q", "pair", "pair_force", "pair_normal_force", "pair_gap")
    run = simulate(scene, 0.8, reference=hold, record=record, estimate_error=False)
    first, end = scene.part("pair_budget")  # a session looks for pairs that are near at each of its ticks
    assert np.delete(session.state[0], np.s_[first:end]).tobytes() == np.delete(run.final, np.s_[first:end]).tobytes()
    assert run.contact("ball", "robot").touching.any()
    assert run.touched() == (("ball/body", "robot/right_foot"),)
    place = seen["base_q"].copy()
    start = session.reset()["base_q"].copy()
    speed = 0.0
    for way, pushed in ((-0.034, True), (0.2, False)):
        place[:] = start
        place[0, 1, 0] += way
        session.set_state("base_q", place.reshape(1, -1))
        seen = session.step()
        faster, speed = seen["base_qd"][0, 1, 0] > speed + 0.01, seen["base_qd"][0, 1, 0]
        assert faster == pushed
        assert seen["pair_deflection"].any() == pushed
    session.close()
