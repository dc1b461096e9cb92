"""Times that pages quote and no benchmark prints, in processor time of this machine; seconds to a minute each.

    python docs/timings.py                  all
    python docs/timings.py worlds feedback  by name

Medians of so many turns, with their quartiles; kernels are compiled before.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import queue
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from featherstone_gait import Ground, compile_scene, load_robot, simulate, simulate_batch, standing_state
from featherstone_gait.benchmark.machine import machine
from featherstone_gait.model import Model
from featherstone_gait.scene.compile import CompiledScene


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
    from featherstone_gait.optimize import walking_cost
    from featherstone_gait.reproduction.solver_scatter import FULL, SERVOS, Setting, walk

    planned = walking_cost(load_robot("humanoid", locked="simplified"))
    walk(FULL, planned, Setting(SERVOS[0], 1e-3), 2)
    yield f"200 walks: {_once(lambda: walk(FULL, planned, Setting(SERVOS[0], 1e-3), 200)):.3g} s"


FIRST_VERSION = "02eaa39"  # the last commit of version 0.1
CALLS = """
import json, math, statistics, sys, time, warnings
from dataclasses import replace
from featherstone_gait import Ground, Reference, compile_scene, initial_state, load_robot, simulate

def free(joint):
    kind = "continuous" if joint.type == "revolute" else joint.type
    return joint if joint.type == "fixed" else replace(joint, type=kind, lower=-math.inf, upper=math.inf)

warnings.simplefilter("ignore")
told = []
for robot, locked, servos, ground, stops, q, target in json.load(sys.stdin):
    try:
        model = load_robot(robot, locked=locked)
        model = model if stops else replace(model, joints=tuple(map(free, model.joints)))
        scene = compile_scene(model, servos, Ground() if ground else None)
        state = initial_state(scene, q)
    except Exception:  # another version's errors
        told.append(None)
        continue
    reference = None if target is None else Reference([0.0], [target])
    if not simulate(scene, 1.0, state, reference).ok:
        told.append(None)
        continue
    times = []
    while len(times) < 9 and sum(times) < 0.5:
        start = time.process_time()
        simulate(scene, 1.0, state, reference)
        times.append(time.process_time() - start)
    told.append(statistics.median(times))
print(json.dumps(told))
"""


def first_version() -> Iterable[str]:
    """Calls that name nothing, by those of version 0.1, which told no error; of what both read (docs/accuracy.md)."""
    import numpy as np

    from featherstone_gait.benchmark.default_scenes import posture
    from featherstone_gait.benchmark.robots import folders, published

    published_robots: list[tuple] = []
    for _, model in published(folders(), []):
        try:
            q = posture(compile_scene(model), model.name).tolist()
        except ValueError:
            continue
        base = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0] if model.base == "floating" else []
        published_robots += [(str(model.source), None, None, False, stops, base + q, None) for stops in (True, False)]
    rng = np.random.default_rng(0)
    servos: list[tuple] = [("humanoid", "simplified", "mipsd", True, True, None, None)]
    for kind in ("mipsd", "rotor", "standard"):
        for robot, n in (("ax12_arm", 1), ("arm7", 7)):
            targets = rng.uniform(-0.8, 0.8, (4, n)).tolist()
            servos += [(robot, None, kind, False, True, [0.0] * n, target) for target in targets]
    root = Path(__file__).parents[1]
    with tempfile.TemporaryDirectory() as old:
        archive = subprocess.run(["git", "archive", FIRST_VERSION], cwd=root, capture_output=True)
        if archive.returncode:
            raise SystemExit(f"first_version: {root} has no commit {FIRST_VERSION}; clone the repository whole")
        subprocess.run(["tar", "-x", "-C", old], input=archive.stdout, check=True)
        for name, calls in (("published robots", published_robots), ("servos and the humanoid standing", servos)):
            before, now = (_timed_calls(calls, path) for path in (Path(old), root))
            ratios = [b / a for a, b in zip(before, now) if a and b]
            yield f"{name}: " + _told(ratios, 1.0, "times")


def _timed_calls(calls: list[tuple], package: Path) -> list[float | None]:
    """Of each call in a process of its own version [s]; None where it does not read the robot."""
    environment = os.environ | {"PYTHONPATH": str(package)}
    run = subprocess.run([sys.executable, "-c", CALLS], input=json.dumps(calls), env=environment, cwd=package,
                         capture_output=True, text=True, check=True)  # fmt: skip
    return json.loads(run.stdout)


FRAMES = """<script>addEventListener("load", () => {
  const gaps = [];
  let last = 0;
  viewer.view.span = 10;
  if (!viewer.state.playing) document.getElementById("play").click();
  const tick = now => {
    if (last) gaps.push(now - last);
    last = now;
    if (gaps.length < 240) requestAnimationFrame(tick);
    else fetch("told", { method: "POST", body: JSON.stringify([gaps, viewer.frames]) });
  };
  requestAnimationFrame(tick);
});</script></body>"""


def view() -> Iterable[str]:
    """Frames of two humanoids at a span of 10 m, 1280 x 720, in a headless Chromium, by the clock (docs/viewer.md)."""
    from featherstone_gait.view.animation import page_html
    from featherstone_gait.view.recorded import Seen
    from featherstone_gait.walking import read_walk

    robot, scene = _humanoid()
    reference = read_walk(Path(robot.source).parent / "optimized_gait.npz", scene.model.joint_names).reference(4)
    channels = ("base_q", "q", "contact_force")
    run = simulate(scene, 4.0, standing_state(scene, reference.values[0], beyond_limits=True), reference,
                   record=channels, sample=0.01, estimate_error=False)  # fmt: skip
    page = page_html({name: Seen(robot, run, scene.ground) for name in ("one", "other")}, "two")
    gaps, drawn = _told_by_chromium(page.replace("</body>", FRAMES))
    yield "from frame to frame: " + _told(gaps, 1.0)
    yield "drawing one: " + _told(drawn, 1.0)


def _told_by_chromium(page: str) -> list[list[float]]:
    """What a page posts back."""
    told: queue.Queue[list[list[float]]] = queue.Queue()

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write(page.encode())

        def do_POST(self) -> None:
            told.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
    if browser is None:
        raise SystemExit("view: no Chromium is installed; install one, or name other timings")
    with ThreadingHTTPServer(("127.0.0.1", 0), Page) as server, tempfile.TemporaryDirectory() as profile:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        command = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1280,720",
                   f"--user-data-dir={profile}", f"http://127.0.0.1:{server.server_port}/"]  # fmt: skip
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            return told.get(timeout=120.0)
        finally:
            process.terminate()
            process.wait()
            server.shutdown()


TIMINGS = {each.__name__: each for each in (worlds, feedback, candidates, plans, solver, view, first_version)}


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
