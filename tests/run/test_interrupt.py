"""Ctrl-C ends a native run at once, and leaves nothing half done."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from scenes import arm_scene, pendulum

from featherstone_gait.run import compiled_run, interrupt
from featherstone_gait.run.prepare import prepare
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import simulate
from featherstone_gait.scene.compile import compile_scene
from featherstone_gait.scene.external import Push

ROOT = Path(__file__).parents[2]

# Each run takes minutes to years; a thread interrupts the process as Ctrl-C does, once the runs are under way.
PROGRAM = """
    import os, signal, threading
    from scenes import arm_scene, pendulum
    from featherstone_gait.scene.compile import compile_scene
    from featherstone_gait.run.simulate import initial_state, simulate, simulate_batch

    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background jobs ignore
    sampled, free = arm_scene(), compile_scene(pendulum(damping=0.0), integrator="{integrator}")
    start = initial_state(free, [1.0])
    run = {call}
    run(0.02)
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.daemon = True
    timer.start()
    try:
        run({long})
    except KeyboardInterrupt:
        left = [t.name for t in threading.enumerate() if t is not threading.main_thread() and not t.daemon]
        print("interrupted", len(left))
    run(0.02)
    print("goes on")
"""
CALLS = {
    "one, fixed steps": ("midpoint", "lambda T: simulate(free, T, start, record_interval=T)", 4e5),
    "one, error control": ("dop853", "lambda T: simulate(free, T, start, rtol=1e-13, record_interval=T)", 4e5),
    "one, a step a tick": ("ars343", "lambda T: simulate(free, T, start, record_interval=1e-3)", 4e4),
    "a batch in lanes": ("rk4", "lambda T: simulate_batch(free, T, [start] * 20, record_interval=T)", 4e5),
    "a batch that is refilled": ("rk4", "lambda T: simulate_batch(sampled, T, [None] * 20, record=())", 5e3),
}


@pytest.mark.long
@pytest.mark.skipif(os.name == "nt", reason="SIGINT of another kind")
@pytest.mark.parametrize("case", CALLS)
def test_an_interrupted_run_ends_and_the_next_one_works(case):
    integrator, call, long = CALLS[case]
    program = textwrap.dedent(PROGRAM).format(integrator=integrator, call=call, long=long)
    environment = os.environ | {"PYTHONPATH": os.environ["PYTHONPATH"]}
    run = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=300)
    assert run.stdout.split() == ["interrupted", "0", "goes", "on"]
    assert all(line.startswith("compiling ") for line in run.stderr.splitlines()), run.stderr


@pytest.mark.quick("dop853")
@pytest.mark.nojit
@pytest.mark.parametrize("integrator", ["midpoint", "dop853"])
def test_another_thread_can_end_a_run(integrator):
    ready = prepare(compile_scene(pendulum(damping=0.0), integrator=integrator), 0.1)
    ready.stop[0] = 1
    with pytest.raises(KeyboardInterrupt):
        ready.run([ready.start()])


@pytest.fixture
def handed_over(monkeypatch):
    """Runs with error control go to the thread after their first step."""
    monkeypatch.setattr(compiled_run, "PAUSE", 0.0)


@pytest.mark.long
@pytest.mark.nojit
def test_a_run_in_a_thread_of_its_own_has_the_same_bits(handed_over):
    """Long runs of the main thread are; runs of other threads are not."""
    scene, runs = compile_scene(pendulum(damping=0.0), integrator="dop853"), []
    runs.append(simulate(scene, 0.05))
    thread = threading.Thread(target=lambda: runs.append(simulate(scene, 0.05)))
    thread.start()
    thread.join()
    assert runs[0].final.tobytes() == runs[1].final.tobytes()


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "ars343", "extrapolation"])
@pytest.mark.parametrize("sampled", [True, False])
def test_a_run_with_error_control_pauses_and_goes_on_to_the_same_bits(integrator, sampled):
    """Pushed, on ticks and at knots, with records within the steps and at their ends."""
    scene = arm_scene(integrator=integrator) if sampled else compile_scene(pendulum(damping=0.0), integrator=integrator)
    torque = Reference([0.0, 0.12, 0.3], [[0.3], [0.0], [0.1]])
    signals = {"reference": Reference([0.0], [[0.5] * 7])} if sampled else {"tau": torque}
    pushes = [Push(scene.model.links[-1].name, (0.0, 0.1, 0.2), start=0.1, end=0.15)]
    ready = prepare(scene, 0.3, record_interval=0.1, rtol=1e-5, pushes=pushes, driven=not sampled)
    run, y, out = ready.arguments(ready.start(**signals))
    whole = ready.kernel(run, y, out), y.copy(), out.copy()
    run, y, out = ready.arguments(ready.start(**signals))
    calls = 1
    while not ready.kernel(run._replace(plan=run.plan._replace(pause=0.0)), y, out):  # after each step
        calls += 1
    assert whole[0]
    assert calls > 2
    np.testing.assert_array_equal(y, whole[1])
    np.testing.assert_array_equal(out, whole[2])


@pytest.mark.nojit
def test_what_a_kernel_raises_is_raised():
    from featherstone_gait.run.interrupt import call_interruptibly

    ready = prepare(compile_scene(pendulum(damping=0.0), integrator="midpoint"), 0.1)

    def failing(run, y, out):
        if run.plan.steps > 0:
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        call_interruptibly(failing, *ready.arguments(ready.start()))


@pytest.mark.nojit
def test_one_thread_serves_all_runs(handed_over):
    scene = compile_scene(pendulum(damping=0.0), integrator="dop853")
    simulate(scene, 0.02)
    assert interrupt._jobs
    before = threading.active_count()
    for _ in range(3):
        simulate(scene, 0.02)
    assert threading.active_count() == before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_forked_program_simulates_too(handed_over):
    """It has not inherited the thread."""
    scene = compile_scene(pendulum(damping=0.0), integrator="dop853")
    simulate(scene, 0.02)
    child = os.fork()
    if child == 0:
        code = 1
        try:
            code = 0 if simulate(scene, 0.02).ok else 2
        finally:
            os._exit(code)
    end = time.monotonic() + 60.0
    done, status = 0, 0
    while not done and time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        time.sleep(0.01)
    if not done:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    assert done
    assert status == 0


@pytest.mark.nojit
def test_what_comes_before_the_kernel_begins_leaves_no_wait(handed_over):
    """Ctrl-C between two instructions may come before the thread has been given anything."""
    scene = compile_scene(pendulum(damping=0.0), integrator="dop853")
    simulate(scene, 0.02)

    class Interrupted:
        def put(self, job):
            interrupt._jobs[:] = [kept]
            raise KeyboardInterrupt

    kept = interrupt._jobs[0]
    interrupt._jobs[:] = [Interrupted()]
    with pytest.raises(KeyboardInterrupt):
        simulate(scene, 0.02)
    assert interrupt._jobs == [kept]
    assert simulate(scene, 0.02).ok
