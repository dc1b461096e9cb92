"""Compare stepping robots from Python, and running with a custom controller, with a run in one call.

The humanoid of ten joints holds itself on the ground, with elastic gearboxes, midpoint steps of 1 ms and ticks of
10 ms.  All calls are timed in turn in one process.  Ratios are of the same turn, so other load affects both alike; the
table has their median and quartiles.  `simulate_batch` and sessions record nothing and estimate no error; sessions are
observed at each tick (positions and velocities).  Overhead is CPU time of a step of one robot less that of its kernel.

Gymnasium's vector of standing robots, with small random actions, is compared with MuJoCo's threaded rollout of the same
robot, with servos of the same stiffness and steps of the same length (`walk.py` says what its model lacks), called once
an action as a learner would.  Observations, rewards and new episodes are made on our side alone.

    featherstone-gait benchmark session        two minutes
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..model import Ground
from ..robot_file import load_robot
from ..run.program import controller
from ..run.reference import Reference
from ..run.session import Session
from ..run.simulate import simulate_batch
from ..scene.compile import CompiledScene, compile_scene
from .engines import humanoid_of, mujoco, quick_mujoco, rollout, standing_on
from .table import in_turn, installed, machine, tabulate

ROBOTS, TICKS = 64, 100
ACTIONS = 50  # of an environment, for each robot
LONG = 1_000_000  # steps of the long run, in which memory must not grow


class Row(NamedTuple):
    """One line of the table."""

    what: Annotated[str, "", "<64"]
    value: Annotated[float, "median", "10.3g"]
    low: Annotated[float, "from", "10.3g"]  # first quartile
    high: Annotated[float, "to", "10.3g"]  # third
    unit: Annotated[str, "", "<4"]


@controller(memory=3)
def upright(t: float, state: Any, reference: np.ndarray, command: np.ndarray, memory: np.ndarray) -> None:
    """Turn the ankles against the trunk's tilt: an example of a compiled controller."""
    memory[0], memory[1] = state.base_qd[3], state.base_qd[4]
    for i in range(len(state.q)):
        command[i, 0] = reference[i, 0] - 0.001 * memory[1] * (state.q[i] - reference[i, 0])


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write session.csv into `out_dir`.  full: more turns, and a million steps of one robot."""
    model = load_robot("humanoid", locked="simplified")
    scene = compile_scene(model, gearbox="mipsd", ground=Ground(), integrator="midpoint", timestep=1e-3)
    turns = 41 if full else 15
    rows = [*_rates(scene, turns), _overhead(scene, turns), *_controllers(scene, turns)]
    rows += [*_environments(scene, turns), *([_growth(scene, LONG)] if full else [])]
    return tabulate(out_dir / "session.csv", Row, rows, machine())


def _rates(scene: CompiledScene, turns: int) -> Iterator[Row]:
    """Compare the rate of a session with that of one call, by wall time and by CPU time on one core."""
    action = np.zeros((ROBOTS, scene.tree.n))
    for threads, name, clock in ((None, "session", time.perf_counter), (1, "session, by CPU time", time.process_time)):
        with Session(scene, ROBOTS, threads=threads) as session:

            def stepped(session: Session = session) -> None:
                session.reset()
                for _ in range(TICKS):
                    session.step(action)

            times = in_turn([_batch(scene, ROBOTS), stepped], turns, clock, warm=1).T
        yield _row(f"rate of {ROBOTS} in a {name}, over that of simulate_batch", times[0] / times[1], "-")


def _batch(scene: CompiledScene, count: int, **how: Any) -> Callable[[], object]:
    """Prepare one call that simulates some robots for as long as the sessions run."""
    still = [Reference([0.0], np.zeros((1, scene.tree.n)))] * count
    duration = TICKS * scene.tick_steps * scene.timestep
    return partial(simulate_batch, scene, duration, references=still, record=(), estimate_error=False, **how)


def _overhead(scene: CompiledScene, turns: int) -> Row:
    with Session(scene, 1) as session:
        action = np.zeros((1, scene.tree.n))
        session.step(action)
        vector = session._fleets[0].groups[0].vectors[0]

        def stepped() -> None:
            for _ in range(TICKS):
                session.step(action)

        def ticked() -> None:
            for _ in range(TICKS):
                vector.kernel(vector.run, vector.y, vector.out)

        whole, kernel = in_turn([stepped, ticked], turns).T
        return _row("overhead of a tick of one robot", 1e6 * (whole - kernel) / TICKS, "us")


def _controllers(scene: CompiledScene, turns: int) -> Iterator[Row]:
    for count in (1, ROBOTS):
        calls = [_batch(scene, count), _batch(scene, count, controller=upright)]
        times = in_turn(calls, turns, time.process_time, warm=1).T
        yield _row(f"CPU time of {count} with a compiled controller, by that without", times[1] / times[0], "-")


def _environments(scene: CompiledScene, turns: int) -> list[Row]:
    """Measure actions a second of Gymnasium's vector, and compare with MuJoCo's, by wall time on all cores."""
    if not installed("gymnasium"):
        print("no Gymnasium: install it with pip install featherstone-gait[gym]")
        return []
    from ..envs.environment import StandVector

    envs = StandVector(scene, num_envs=ROBOTS)
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, (ACTIONS, ROBOTS, scene.tree.n))

    def ours() -> None:
        envs.reset(seed=0)
        for action in actions:
            envs.step(action)

    what, each = f"actions a second of {ROBOTS} standing in Gymnasium", ROBOTS * ACTIONS
    try:
        if not installed("mujoco"):
            print("no MuJoCo: install it with pip install featherstone-gait[mjcf]")
            return [_row(what, each / in_turn([ours], turns, time.perf_counter, warm=1).T[0], "1/s")]
        with quick_mujoco():
            theirs = _mujoco_environments(scene, envs, actions)
            times = in_turn([ours, theirs], turns, time.perf_counter, warm=1).T
    finally:
        envs.close()
    return [_row(what, each / times[0], "1/s"), _row("that rate, over MuJoCo's rollout's", times[1] / times[0], "-")]


def _mujoco_environments(scene: CompiledScene, envs: Any, actions: np.ndarray) -> Callable[[], None]:
    """Prepare the same robots in MuJoCo; each rollout holds an action."""
    m = humanoid_of(scene.model)
    m.opt.timestep = scene.timestep
    data = [mujoco.MjData(m) for _ in range(os.cpu_count() or 1)]
    robots = envs._robots
    begin = np.repeat(standing_on(m, data[0], robots.angles)[None], ROBOTS, axis=0)
    steps = robots.ticks * scene.tick_steps

    def call() -> None:
        states = begin
        with rollout.Rollout(nthread=len(data)) as pool:
            for action in actions:
                control = np.repeat(robots.reference(action)[:, None], steps, axis=1)
                found, _ = pool.rollout(m, data, initial_state=states, control=control)
                states = found[:, -1]

    return call


def _growth(scene: CompiledScene, steps: int) -> Row:
    """Measure how memory grows while one robot is stepped."""
    import resource

    with Session(scene, 1) as session:
        action = np.zeros((1, scene.tree.n))
        for _ in range(2000):
            session.step(action)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for _ in range(steps):
            session.step(action)
        grown = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    return Row(f"memory that {steps} steps need beyond the first 2000", grown, grown, grown, "KiB")


def _row(what: str, values: np.ndarray, unit: str) -> Row:
    low, middle, high = np.percentile(values, [25, 50, 75])
    return Row(what, float(middle), float(low), float(high), unit)
