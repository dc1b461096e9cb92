"""Measure the times that pages quote and no benchmark prints: `python docs/timings.py [NAME...]`.

They are processor times of this machine, with compiled kernels: medians, with their quartiles in brackets.  Each takes
seconds to a minute.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np

from featherstone_gait import (
    Distribution,
    Ground,
    Worlds,
    compile_scene,
    load_robot,
    simulate,
    simulate_batch,
    standing_state,
)
from featherstone_gait.benchmark.table import machine
from featherstone_gait.optimize import AMPLITUDE, walking_cost
from featherstone_gait.robot_file.servos import with_servo
from featherstone_gait.walking import read_walk
from featherstone_gait.walking.cost_in_worlds import in_worlds

ROBOT = load_robot("humanoid", locked="simplified")


def seconds(run: Callable[[], object]) -> float:
    start = time.process_time()
    run()
    return time.process_time() - start


def summary(times: list[float], scale: float = 1e3, unit: str = "ms") -> str:
    low, middle, high = (scale * x for x in statistics.quantiles(times, n=4))
    return f"{middle:.3g} {unit} ({low:.3g} to {high:.3g}, {len(times)} runs)"


def worlds() -> Iterable[str]:
    """The scene of a world, by what differs (docs/worlds.md)."""
    scene = compile_scene(ROBOT, "mipsd", Ground(), "midpoint", 1e-3)
    tenth = Distribution("uniform", 0.1)
    differing = {"ground": {"friction": tenth}, "servos": {"resistance": tenth}, "links": {"mass": tenth}}
    for section, numbers in differing.items():
        drawn = Worlds(runs=41, **{section: numbers})
        drawn.scenes(scene, [0])
        yield f"other {section}: " + summary([seconds(partial(drawn.scenes, scene, [k])) for k in range(1, 41)])


def feedback() -> Iterable[str]:
    """A walk with feedback over one without, alone and sixteen in lanes (docs/feedback.md)."""
    scene = compile_scene(ROBOT, "mipsd", Ground(), "midpoint", 1e-3)
    walk = read_walk(Path(ROBOT.source).parent / "balanced_gait.npz", scene.model.joint_names)
    signal, act, end = walk.reference(4), walk.controller(scene), walk.begin(4)
    state = standing_state(scene, signal.values[0])

    def alone(act: object) -> None:
        simulate(scene, end, state, signal, controller=act, estimate_error=False)

    def lanes(act: object) -> None:
        acts = [act] * 16 if act else None
        simulate_batch(scene, end, [state] * 16, [signal] * 16, controller=acts, estimate_error=False)

    for name, run in (("alone", alone), ("sixteen in lanes", lanes)):
        run(None), run(act)
        ratios = [seconds(partial(run, act)) / seconds(partial(run, None)) for _ in range(11)]
        yield f"{name}: " + summary(ratios, 1.0, "times")


def candidates() -> Iterable[str]:
    """A candidate of a search on one floor and in eight worlds, by servo (docs/servos.md)."""
    for servo in ("ax12", "ax12a"):
        for count in (0, 8):
            cost = walking_cost(with_servo(ROBOT, servo), states="step" if count else "stride")
            x = cost.gait.to_vector()
            tried = list(x + AMPLITUDE * np.random.default_rng(0).normal(size=(16, len(x))))
            searched = in_worlds(cost, count) if count else cost
            searched.costs(tried)
            times = [seconds(partial(searched.costs, tried)) / len(tried) for _ in range(5)]
            yield f"{servo}, {f'{count} worlds' if count else 'one floor'}: " + summary(times)


TIMINGS = {each.__name__: each for each in (worlds, feedback, candidates)}


def main() -> None:
    parser = argparse.ArgumentParser(description="measure the times that pages quote and no benchmark prints")
    parser.add_argument("names", metavar="NAME", nargs="*", choices=[*TIMINGS, []], help=", ".join(TIMINGS))
    print(machine())
    for name in parser.parse_args().names or TIMINGS:
        print(f"{name}: {TIMINGS[name].__doc__}")
        for line in TIMINGS[name]():
            print(f"  {line}", flush=True)


if __name__ == "__main__":
    main()
