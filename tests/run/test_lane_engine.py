"""Lanes that take the next run when theirs has ended: same bits, fewer idle lanes, bounded memory."""

from collections import Counter

import numpy as np
import pytest

from featherstone_gait.core.step.context import Plan
from featherstone_gait.model import Ground
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.lane_engine import Queue, run_lanes, segment_steps
from featherstone_gait.run.prepare import prepare
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import simulate, simulate_batch, simulate_stream, standing_state
from featherstone_gait.scene.compile import compile_scene

RECORD = ("base_q", "voltage", "energy", "contact_force")
TIMES = np.linspace(0.0, 1.2, 31)


@pytest.fixture(scope="module")
def scene():
    return compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)


@pytest.fixture(scope="module")
def references(scene):
    """Every third stays upright, the others are thrown about and most of them fall, at different times."""
    rng = np.random.default_rng(3)
    sizes = [0.01 if i % 3 == 0 else 1.2 for i in range(21)]
    return [
        Reference(TIMES[: 31 - i % 4], size * rng.uniform(-1, 1, (31 - i % 4, scene.tree.n)))
        for i, size in enumerate(sizes)
    ]


@pytest.fixture(scope="module")
def alone(scene, references):
    state = standing_state(scene, np.zeros(scene.tree.n))
    return [
        simulate(scene, 1.2, state, r, record=RECORD, record_interval=5e-3, estimate_error=False) for r in references
    ]


def test_some_fall_and_some_do_not(alone):
    """The comparison below means nothing if no lane changes hands early."""
    fallen = [run.end_time for run in alone if run.status == "fell"]
    assert len(fallen) >= 5
    assert len(set(fallen)) >= 4
    assert sum(run.status == "ok" for run in alone) >= 5


@pytest.mark.long
@pytest.mark.parametrize("order", ["forward", "backward"])
def test_refilled_lanes_have_the_bits_of_single_runs(scene, references, alone, order):
    indices = list(range(len(references)))[:: 1 if order == "forward" else -1]
    state = standing_state(scene, np.zeros(scene.tree.n))
    states = [state] * len(indices)
    signals, once = [references[i] for i in indices], {"record_interval": 5e-3, "estimate_error": False}
    batch = simulate_batch(scene, 1.2, states, signals, record=RECORD, **once)
    for i, run in zip(indices, batch):
        assert (run.status, run.message, run.end_time) == (alone[i].status, alone[i].message, alone[i].end_time)
        assert run.final.tobytes() == alone[i].final.tobytes()
        for name in ("time", *RECORD):
            assert run[name].tobytes() == alone[i][name].tobytes(), name


@pytest.mark.long
def test_noise_is_an_input_and_its_runs_have_the_same_bits(scene, references):
    """Encoder and supply noise, seeded outside: it changes the motion, and the same array gives the same bits."""
    state = standing_state(scene, np.zeros(scene.tree.n))
    rng = np.random.default_rng(11)
    noises = [rng.normal(size=(120, scene.tree.n, 2)) * [1e-3, 0.1] for _ in references]
    count = len(references)
    batch = simulate_batch(scene, 1.2, [state] * count, references, record=RECORD, noises=noises)
    for k in (0, 1, 3, 20):
        run = simulate(scene, 1.2, state, references[k], record=RECORD, noise=noises[k])
        assert run.final.tobytes() == batch[k].final.tobytes()
        assert run["voltage"].tobytes() == batch[k]["voltage"].tobytes()
        assert run.final.tobytes() != simulate(scene, 1.2, state, references[k], record=RECORD).final.tobytes()


@pytest.mark.long
def test_noise_moves_what_the_encoder_reads_and_the_voltage(scene):
    state = standing_state(scene, np.zeros(scene.tree.n))
    noise = np.zeros((1, scene.tree.n, 2))
    quiet = simulate(scene, 0.01, state, record=("voltage",), noise=noise)["voltage"][0]
    noise[0, 2] = 0.01, 0.25
    loud = simulate(scene, 0.01, state, record=("voltage",), noise=noise)["voltage"][0]
    expected = np.zeros(scene.tree.n)
    expected[2] = -61.0 * 0.01 + 0.25  # Kp times the angle read too large, and what is added to the voltage
    assert np.allclose(loud - quiet, expected, atol=1e-12)


@pytest.mark.long
def test_lanes_are_mostly_at_work(scene, references):
    """Used lane-steps over all: without refilling it would be the mean life of a run over the longest."""
    state = standing_state(scene, np.zeros(scene.tree.n))
    falling = [r for i, r in enumerate(references) if i % 3]
    ready, queue = prepare(scene, 1.2, record=()), Queue(64)
    starts = [ready.start(state, falling[i % len(falling)]) for i in range(64)]
    used, there = run_lanes(ready, queue, starts.__getitem__, lambda start, y, out: y[scene.layout["end_time"]])
    without = np.mean(queue.answers) / 1.2
    assert used / there > 0.8 > without


@pytest.mark.parametrize(
    ("tick", "sample", "total", "expected"), [(10, 10, 4000, 250), (10, 4, 4000, 240), (1, 7, 5, 5)]
)
def test_segments_are_whole_ticks_and_samples(tick, sample, total, expected):
    course = Plan(1e-3, 1.0, total, tick, sample, 0.01, 0.0, -2.0)
    assert segment_steps(course) == expected


def test_queue_hands_out_each_index_once():
    queue = Queue(3)
    assert [queue.take() for _ in range(5)] == [0, 1, 2, None, None]


class Changing(Queue):
    """Gives up every fifth run, when it has been asked about it twice."""

    def __init__(self, count):
        super().__init__(count)
        self.asked = Counter()

    def wanted(self, key):
        self.asked[key] += 1
        return key % 5 or self.asked[key] < 3


@pytest.mark.long
def test_runs_given_up_leave_their_lanes_to_others_and_those_their_bits(scene, references, alone):
    state = standing_state(scene, np.zeros(scene.tree.n))
    source, upright = Changing(len(references)), [i for i, run in enumerate(alone) if run.ok]
    share = simulate_stream(
        scene, 1.2, source, lambda i: (state, references[i]), lambda run: run, RECORD, record_interval=5e-3, threads=2
    )
    assert 0.0 < share <= 1.0
    assert any(source.answers[i] is None for i in upright)
    for i, run in enumerate(source.answers):
        if run is None:
            assert i % 5 == 0
        else:
            assert run.final.tobytes() == alone[i].final.tobytes()
            assert all(run[name].tobytes() == alone[i][name].tobytes() for name in RECORD)


@pytest.mark.long
def test_a_failure_in_one_thread_ends_all_of_them(scene, references):
    state = standing_state(scene, np.zeros(scene.tree.n))
    queue = Queue(1000)

    def begin(index):
        if index == 17:
            raise ValueError("no such run")
        return state, references[0]

    with pytest.raises(ValueError, match="no such run"):
        simulate_stream(scene, 0.1, queue, begin, lambda run: run, threads=2)
    assert queue.answers.count(None) > 900


def test_a_stream_needs_sampled_servos(scene):
    with pytest.raises(ValueError, match="needs sampled servos"):
        simulate_stream(compile_scene(scene.model, None, Ground()), 1.0, Queue(1), None, None)
