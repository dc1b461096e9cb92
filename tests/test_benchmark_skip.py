"""Counting instructions: exact, and as many as the work has."""

import math
from dataclasses import replace

import pytest

from featherstone_gait.benchmark.skip import (
    Work,
    _compiled,
    _rollout,
    code,
    executed,
    free_arm,
    instructions_at,
    shared_array,
)
from featherstone_gait.core.compile.jit import JIT, entry

pytestmark = pytest.mark.skipif(not JIT, reason="counts compiled code")


@entry
def recurrence(steps, rounds, seen):
    """So many rounds a step of a chain of operations that no compiler shortens: each needs the one before."""
    x = 0.5
    for k in range(steps + 1):
        if k == 0 or k == steps:
            seen[k // steps] = x
        for _ in range(rounds):
            x = x * x - 1.5


def work(rounds):
    def prepare(steps):
        seen = shared_array(2)
        return (steps, rounds, seen), seen

    found = Work(recurrence, prepare)
    found.kernel(*found.prepare(1)[0])
    return found


def counted(*arguments):
    count = executed(*arguments)
    if math.isnan(count):  # containers without the right to ptrace: there is nothing else to count instructions with
        pytest.skip("this system lets no process be traced")
    return count


def test_the_count_grows_by_the_same_instructions_with_every_round_of_a_loop():
    """A loop may be unrolled, by a power of two: from 64 rounds to 128 and to 192 is exactly as far."""
    counts = [counted(work(rounds), 4) for rounds in (64, 128, 192)]
    assert counts[2] - counts[1] == counts[1] - counts[0]
    assert counts[1] - counts[0] >= 2 * 64  # a multiplication and a subtraction each


def test_the_count_is_the_same_each_time():
    assert counted(work(96), 3) == counted(work(96), 3)


def test_a_call_that_ends_before_its_marks_are_set_counts_nothing():
    assert instructions_at(lambda: None, shared_array(1)) is None


@pytest.mark.long
def test_a_fixed_joint_is_lumped_with_nothing_left_of_it():
    """Of the arm's seven joints one is fixed, or the link behind it was never there: as many instructions.

    But for branches on values, as of the chatter watch, a few of 8000 instructions; a joint is a seventh of them.
    """
    arm = free_arm()
    fixed = replace(arm, joints=(*arm.joints[:-1], replace(arm.joints[-1], type="fixed")))
    shorter = replace(arm, links=arm.links[:-1], joints=arm.joints[:-1])
    costs = [counted(_rollout(_compiled(model)), 2) for model in (fixed, shorter, arm)]
    assert costs[0] == pytest.approx(costs[1], rel=0.01)
    assert costs[2] > 1.1 * costs[0]


def test_code_is_counted_in_instructions():
    """A loop of two operations: its own instructions and those that unpack its arguments."""
    assert 50 < code(work(8)) < 5000
