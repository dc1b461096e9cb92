"""Times that pages quote and no benchmark prints, in processor time of this machine; seconds to a minute each.

    python docs/timings.py                  all
    python docs/timings.py worlds feedback  by name

Medians of so many turns, with their quartiles; kernels are compiled before.
"""

from __future__ import annotations

import argparse
import functools
import statistics
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from featherstone_gait import Ground, compile_scene, load_robot, simulate, simulate_batch
from featherstone_gait.benchmark.machine import machine
from featherstone_gait.build.scene import CompiledScene
from featherstone_gait.model import Model


def _humanoid() -> tuple[Model, CompiledScene]:
    robot = load_robot("humanoid", locked="simplified")
    return robot, compile_scene(robot, "mipsd", Ground(), "midpoint", 1e-3)


def _once(do: Callable[[], object]) -> float:
    start = time.process_time()
    do()
    return time.process_time() - start


def _told(times: list[float], scale: float = 1e3, unit: str = "ms") -> str:
    low, middle, high = (scale * x for x in statistics.quantiles(times, n=4))
    return f"{middle:.3g} {unit} ({low:.3g} to {high:.3g}, {len(times)} turns)"


def worlds() -> Iterable[str]:
    """A world's scene, by what differs (docs/worlds.md)."""
    from featherstone_gait import Spread, Worlds

    _, scene = _humanoid()
    tenth = Spread("uniform", 0.1)
    differing = {"ground": {"friction": tenth}, "servos": {"resistance": tenth}, "links": {"mass": tenth}}
    for section, numbers in differing.items():
        drawn = Worlds(runs=41, **{section: numbers})
        drawn.scenes(scene, [0])
        yield f"other {section}: " + _told([_once(functools.partial(drawn.scenes, scene, [k])) for k in range(1, 41)])


def feedback() -> Iterable[str]:
    """A walk with feedback by one without, alone and sixteen in lanes (docs/feedback.md)."""
    from featherstone_gait.run.start import standing_state
    from featherstone_gait.walking import read_walk

    robot, scene = _humanoid()
    walk = read_walk(Path(robot.source).parent / "balanced_gait.npz", scene.model.joint_names)
    signal, act, end = walk.reference(4), walk.controller(scene), walk.begin(4)
    state = standing_state(scene, signal.values[0])

    def alone(act: object) -> None:
        simulate(scene, end, state, signal, controller=act, estimate_error=False)

    def lanes(act: object) -> None:
        acts = [act] * 16 if act else None
        simulate_batch(scene, end, [state] * 16, [signal] * 16, controller=acts, estimate_error=False)

    for name, run in (("alone", alone), ("sixteen in lanes", lanes)):
        run(None), run(act)
        ratios = [_once(functools.partial(run, act)) / _once(functools.partial(run, None)) for _ in range(11)]
        yield f"{name}, by that without: " + _told(ratios, 1.0, "times")


def candidates() -> Iterable[str]:
    """A candidate of a search on one floor and in eight worlds, by servo (docs/optimize.md, docs/servos.md)."""
    import numpy as np

    from featherstone_gait.optimize import AMPLITUDE, walking_cost
    from featherstone_gait.robot_file.servos import with_servo
    from featherstone_gait.walking.cost_in_worlds import in_worlds

    robot = load_robot("humanoid", locked="simplified")
    for servo in ("ax12", "ax12a"):
        for count in (0, 8):
            cost = walking_cost(with_servo(robot, servo), states="step" if count else "stride")
            x = cost.gait.to_vector()
            tried = list(x + AMPLITUDE * np.random.default_rng(0).normal(size=(16, len(x))))
            searched = in_worlds(cost, count) if count else cost
            searched.costs(tried)
            times = [_once(functools.partial(searched.costs, tried)) / len(tried) for _ in range(5)]
            yield f"{servo}, {f'{count} worlds' if count else 'one floor'}: " + _told(times)


def plans() -> Iterable[str]:
    """The plain plan, and the cheapest of many (docs/walking.md)."""
    from featherstone_gait.walking import first_gait

    _, scene = _humanoid()
    first_gait(scene, "plain", "step")
    yield f"plain plan: {_once(lambda: first_gait(scene, 'plain', 'step')):.2g} s"
    yield f"cheapest plan: {_once(lambda: first_gait(scene, 'cheapest', 'step')):.3g} s"


def solver() -> Iterable[str]:
    """Two hundred walks in the paper's kind of program (docs/maximal.md)."""
    from featherstone_gait.experiments.solver_scatter import FULL, SERVOS, Setting, walk
    from featherstone_gait.optimize import walking_cost

    planned = walking_cost(load_robot("humanoid", locked="simplified"))
    walk(FULL, planned, Setting(SERVOS[0], 1e-3), 2)
    yield f"200 walks: {_once(lambda: walk(FULL, planned, Setting(SERVOS[0], 1e-3), 200)):.3g} s"


TIMINGS = {each.__name__: each for each in (worlds, feedback, candidates, plans, solver)}


def main() -> None:
    parser = argparse.ArgumentParser(description="times that pages quote and no benchmark prints")
    parser.add_argument("names", metavar="NAME", nargs="*", choices=[*TIMINGS, []], help=", ".join(TIMINGS))
    args = parser.parse_args()
    print(machine())
    for name in args.names or TIMINGS:
        print(f"{name}: {TIMINGS[name].__doc__}")
        for line in TIMINGS[name]():
            print(f"  {line}", flush=True)


if __name__ == "__main__":
    main()
