"""Counting instructions: exact, and as many as the work has."""

import math
import platform
import sys
from dataclasses import replace

import numpy as np
import pytest
from scenes import box

from featherstone_gait.benchmark.instructions import instructions, records
from featherstone_gait.benchmark.skip import Work, executed, free_arm, rollout
from featherstone_gait.core.compile.jit import JIT, entry
from featherstone_gait.model import Ground

pytestmark = pytest.mark.skipif(not JIT, reason="counts compiled code")


@entry
def recurrence(steps, rounds, out):
    """So many rounds a step of a chain of operations that no compiler shortens: each needs the one before."""
    x = 0.5
    for k in range(steps + 1):
        out[k] = x
        for _ in range(rounds):
            x = x * x - 1.5


def work(rounds):
    return Work(recurrence, lambda steps: (steps, rounds, records(steps + 1)))


def counted(work):
    count = executed(work)
    if math.isnan(count):
        assert (sys.platform, platform.machine()) != ("linux", "x86_64"), "the counter works there"
        pytest.skip("the counter is x86-64 machine code for Linux; elsewhere the benchmark leaves its cells empty")
    return count


def test_the_count_grows_by_the_same_instructions_with_every_round_of_a_loop():
    """A loop may be unrolled, by a power of two: from 64 rounds to 128 and to 192 is exactly as far."""
    counts = [counted(work(rounds)) for rounds in (64, 128, 192)]
    assert counts[2] - counts[1] == counts[1] - counts[0]
    assert counts[1] - counts[0] >= 2 * 64  # a multiplication and a subtraction each


def test_the_count_is_the_same_each_time():
    assert counted(work(96)) == counted(work(96))


def test_a_call_that_writes_nothing_counts_nothing_and_its_records_can_be_read_again():
    out = records(3)
    assert math.isnan(instructions(lambda: None, out, 1))
    assert np.isnan(out).all()


@pytest.mark.long
def test_a_fixed_joint_is_lumped_with_nothing_left_of_it():
    """Of the arm's seven joints one is fixed, or the link behind it was never there: as many instructions.

    But for branches on values, as of the chatter watch, a few of 8000 instructions; a joint is a seventh of them.
    """
    arm = free_arm()
    fixed = replace(arm, joints=(*arm.joints[:-1], replace(arm.joints[-1], type="fixed")))
    shorter = replace(arm, links=arm.links[:-1], joints=arm.joints[:-1])
    costs = [counted(rollout(model)) for model in (fixed, shorter, arm)]
    assert costs[0] == pytest.approx(costs[1], rel=0.01)
    assert costs[2] > 1.1 * costs[0]


def test_a_run_makes_the_steps_that_are_counted_and_no_more():
    run, _, out = rollout(box(), ground=Ground()).prepare(4)
    assert (run.plan.steps, run.plan.per_sample) == (4, 2)
    assert out.shape == (3, 1)
