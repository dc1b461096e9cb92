"""Environments of Gymnasium: its own checks, the same bits alone and in a vector, episodes that begin anew."""

import importlib
import sys
import warnings

import gymnasium
import numpy as np
import published
import pytest
from gymnasium.utils.env_checker import check_env

from featherstone_gait.envs import environment as gym
from featherstone_gait.model import Ground
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.worlds import Distribution, Worlds
from featherstone_gait.scene.compile import compile_scene
from featherstone_gait.walking import with_generic_servos


@pytest.fixture(scope="module")
def robot():
    return compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)


@pytest.mark.parametrize("kind", [gym.Stand, gym.Walk, gym.Push])
def test_gymnasium_finds_nothing_wrong(kind, robot):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(infinity|spec|render).*")
        check_env(kind(robot, duration=0.2), skip_render_check=True)


def test_pictures_show_the_robot_as_it_is(robot):
    """Gymnasium's own checks of each mode; a picture is that of a vector's robot in the same state, and it changes."""
    made = gymnasium.make("featherstone_gait/Stand-v0", robot=robot, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(infinity|spec|render).*")
        check_env(made.unwrapped)
    assert made.metadata["render_fps"] == pytest.approx(50.0)  # two ticks of 10 ms
    assert gym.Stand(robot, ticks=5).metadata["render_fps"] == pytest.approx(20.0)
    env, envs = gym.Stand(robot, render_mode="rgb_array"), gym.StandVector(robot, 2, render_mode="rgb_array")
    env.reset(seed=4)
    envs.reset(seed=3)
    first, both = env.render(), envs.render()
    assert (first.shape, first.dtype) == ((480, 640, 3), np.uint8)
    assert np.array_equal(both[1], first)
    assert not np.array_equal(both[0], first)
    for _ in range(5):
        env.step(np.ones(10))
    assert np.ptp(first, axis=(0, 1)).min() > 100
    assert not np.array_equal(env.render(), first)
    for one in (env, envs, made):
        one.close()


def test_what_cannot_be_drawn_is_warned_of(robot):
    """Without a render mode, or without a display, nothing is drawn and Gymnasium's warning is given."""
    env = gym.Stand(robot)
    with pytest.warns(UserWarning, match="render mode"):
        assert env.render() is None
    env = gym.Stand(robot, render_mode="human")
    with pytest.warns(UserWarning, match="rgb_array"):
        env.reset(seed=0)
    env.step(np.zeros(10))
    assert env.render() is None
    env.close()


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")
@pytest.mark.parametrize("file", ["solo_description/robots/solo12.urdf", "bolt_description/robots/bolt.urdf"])
def test_robots_of_others_are_environments_too(file):
    """Four legs and two, from URDF files that have no servos: the same checks, and a vector's first robot alone."""
    path = published.folder("example-robot-data") / file
    with pytest.raises(ValueError, match=r"it has no servos.*with_generic_servos"):
        gym.Stand(path)
    robot = with_generic_servos(load_robot(path, base="floating", contacts="feet"), leg=0.3, margin=2.0)
    for kind, many in ((gym.Stand, gym.StandVector), (gym.Walk, gym.WalkVector), (gym.Push, gym.PushVector)):
        env, envs = kind(robot, duration=0.2), many(robot, 9, duration=0.2)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*(infinity|spec|render).*")
            check_env(env, skip_render_check=True)
        assert np.array_equal(env.reset(seed=3)[0], envs.reset(seed=3)[0][0])
        for _ in range(9):
            one, every = env.step(np.zeros(env.action_space.shape)), envs.step(np.zeros(envs.action_space.shape))
            assert np.array_equal(one[0], every[0][0])
            assert one[1] > 0.9
        assert not one[2]


def actions_of(robot, count, seed=0):
    return np.random.default_rng(seed).uniform(-0.3, 0.3, size=(count, 9, robot.tree.n))


@pytest.mark.long
def test_a_robot_of_a_vector_has_the_bits_of_one_alone(robot):
    """Pushes, worlds and episodes that begin anew included."""
    worlds = Worlds(
        runs=9, servos={"resistance": Distribution("uniform", 0.1)}, ground={"friction": Distribution("uniform", 0.2)}
    )
    envs = gym.PushVector(robot, 9, duration=0.1, worlds=worlds)
    envs._robots.task = gym.Task(push=0.2, every=0.05)
    seen, _ = envs.reset(seed=5)
    actions = actions_of(robot, 13)
    own = worlds.scenes(robot)[4]
    env = gym.Push(own, duration=0.1)
    env._robots.task = envs._robots.task
    alone, _ = env.reset(seed=9)
    env.np_random.integers(9)  # the lot for its world
    alone = env._robots.observation(env._session.reset(state=None))[0]
    draw = gymnasium.utils.seeding.np_random(9)[0]
    draw.integers(9)
    alone = env._robots.observation(env._session.reset(state=env._robots.begin(draw)))[0]
    env._np_random = draw
    assert np.array_equal(seen[4], alone)
    pushed, done, ends = False, False, 0
    for action in actions:
        seen, reward, ended, late, _info = envs.step(action)
        if done:
            draw.integers(9)
            alone = env._robots.observation(env._session.reset(state=env._robots.begin(draw)))[0]
            assert reward[4] == 0.0
            done = False
        else:
            before = alone
            alone, gain, dead, over, _ = env.step(action[4])
            assert (gain, dead, over) == (reward[4], ended[4], late[4])
            done = dead or over
            ends += done
            pushed = pushed or abs(alone[-4] - before[-4]) > 0.05
        assert np.array_equal(seen[4], alone)
    assert pushed
    assert ends >= 2


def test_an_episode_depends_on_its_seed(robot):
    env, found = gym.Push(robot), []
    for seed in (1, 1, 2):
        first, _ = env.reset(seed=seed)
        for action in actions_of(robot, 5):
            last, *_ = env.step(action[0])
        found.append((first.tobytes(), last.tobytes()))
    assert found[0] == found[1]
    assert found[0][0] != found[2][0]


@pytest.mark.long
def test_worlds_without_end_take_no_memory_without_end(robot, monkeypatch):
    """An environment leaves worlds that it was in long ago; an episode in one is the same when it comes back."""
    monkeypatch.setattr(gym, "KEPT", 2)
    worlds = Worlds(runs=50, servos={"resistance": Distribution("uniform", 0.2)})
    env, found = gym.Stand(robot, worlds=worlds), {}
    for seed in (*range(12), *range(12)):
        env.reset(seed=seed)
        last = [env.step(action[0])[0] for action in actions_of(robot, 3)][-1].tobytes()
        assert found.setdefault(seed, last) == last
        assert len(env._sessions) <= 2
    assert len({*found.values()}) == 12


def test_standing_is_worth_one_and_falling_ends_it(robot):
    env = gym.Stand(robot, scale=1.0)
    env.reset(seed=0)
    rewards = [env.step(np.zeros(robot.tree.n))[1] for _ in range(10)]
    assert min(rewards) > 0.95
    ended = False
    for _ in range(300):
        _, reward, ended, late, info = env.step(-np.ones(robot.tree.n))
        if ended:
            break
    assert ended
    assert not late
    assert reward < 0.95
    assert {*info} == {"time", "x", "tilt"}


def test_gymnasium_makes_them(robot):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = gymnasium.make("featherstone_gait/Stand-v0", robot=robot)
        envs = gymnasium.make_vec("featherstone_gait/Walk-v0", 3, vectorization_mode="vector_entry_point", robot=robot)
    assert env.reset(seed=0)[0].shape == env.observation_space.shape
    assert envs.reset(seed=0)[0].shape == envs.observation_space.shape == (3, *env.observation_space.shape)
    assert envs.step(envs.action_space.sample())[1].shape == (3,)
    envs.close()


def test_misuse_is_refused(robot):
    arm = load_robot("ax12_arm")
    for wrong, message in (
        (lambda: gym.Stand(compile_scene(arm, "mipsd")), "floating base"),
        (lambda: gym.Stand(robot).step(np.zeros(10)), "call reset first"),
        (lambda: gym.StandVector(robot, 3).step(np.zeros((3, 10))), "call reset first"),
        (lambda: gym.Stand(robot, ticks=0), "ticks is 0"),
        (lambda: gym.Stand(robot, angles=np.zeros(3)), "angles must be 10"),
        (lambda: gym.Stand(robot, render_mode="ansi"), "render_mode is 'ansi'"),
        (lambda: gym.StandVector(robot, 3, render_mode="human"), "render_mode is 'human'"),
        (lambda: gym.Stand(robot, render_mode="rgb_array").render(), "call reset first"),
        (lambda: gym.StandVector(robot, 3).reset(seed=[1, 2]), "2 entries; there are 3"),
    ):
        with pytest.raises(ValueError, match=message):
            wrong()
    env = gym.Stand(robot)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action must be 10 finite numbers"):
        env.step(np.full(10, np.nan))


def test_a_step_of_a_vector_that_is_refused_does_nothing(robot):
    """No lot is drawn, nobody is pushed; actions beyond 1 are as 1, in the reward too."""
    envs, others = gym.PushVector(robot, 3), gym.PushVector(robot, 3)
    for one in (envs, others):
        one._robots.task = gym.Task(push=0.2, every=0.02)
        one.reset(seed=4)
    for wrong in (None, "left", 0.0, np.zeros(10), np.zeros((2, 10)), np.full((3, 10), np.inf), np.zeros((3, 10)) * 1j):
        with pytest.raises(ValueError, match="actions"):
            envs.step(wrong)
    with pytest.raises(ValueError, match=r"seed is 1\.5"):
        envs.reset(seed=1.5)
    (seen, reward, *_), (there, gain, *_) = envs.step(np.full((3, 10), 1e30)), others.step(np.ones((3, 10)))
    assert np.array_equal(seen, there)
    assert np.array_equal(reward, gain)


def test_without_gymnasium_its_extra_is_named(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("featherstone_gait.envs")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(ImportError, match=r"pip install featherstone-gait\[gym\]"):
        importlib.import_module("featherstone_gait.envs")
