"""The adjoint of a run at fixed steps: the derivative of a result by all inputs, from the end of the run to its start.

Let y[k] be the state after the ticks at step k.  A run is y[k] = F(y[k-1], p), F one step and what happens at its end,
and a result has the derivative g[k] by y[k] where it is recorded.  Then

    l[N] = g[N],    l[k-1] = dF/dy' l[k] + g[k-1],    dJ/dp = sum over k of dF/dp' l[k],

and the tape of one step (taped.py) gives both products at the cost of a few steps, however many parameters there are.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import entry, kernel
from ..compile.structure import structure
from ..compile.taped import add_adjoint, as_input, as_taped, begin, on_tape, sweep
from ..compile.taped import ADJOINT, ENTRY, SPAN
from ..step.signals import time_of
from ..tree.coupling import follow
from .integrator import hold_solution, take_step, thetas
from .rollout import between_ticks, tick


@structure
class Noted(NamedTuple):
    """The tape and what goes back along it."""

    numbers: np.ndarray  # (entries, 4) of `Tape`
    links: np.ndarray
    words: np.ndarray
    first: int  # entry after those of the inputs
    past: np.ndarray  # (steps + 1, length) states after the ticks at each step
    seeds: np.ndarray  # (records, channels) derivatives of the result by what was recorded
    adjoint: np.ndarray  # (length,) derivatives by the state: at the end, and then at the start
    state: np.ndarray  # (length,) scratch


@entry
def pull_back(run, y, plain, noted, start):
    """Take the adjoint from the end of a run to its start, the state `start` (length,) before the first ticks.

    run, y: with memory of taped numbers (..., 2); plain: the run with its own memory, which solves each step before it
    is noted.  Returns how much of the tape the longest step took, more than it holds if it was too small.
    """
    return _pull_back(on_tape(run), as_taped(y), plain, noted, start)


@kernel
def _pull_back(run, y, plain, noted, start):
    plan, words, most = run.plan, noted.words, 0
    end = start[run.offsets[0].end_time]
    first_theta, theta = thetas(run.work, plan.theta, end)
    for k in range(plan.steps, -1, -1):
        if k % plan.per_sample == 0:
            for j in range(len(run.channels)):
                noted.adjoint[run.channels[j]] += noted.seeds[k // plan.per_sample, j]
        begin(words, noted.first)
        before = noted.past[max(k - 1, 0)]
        if k == 0:
            before = start
        for i in range(len(y)):
            y[i] = as_input(words, before[i])
        if k > 0:
            t, th = time_of(plan, k - 1), theta
            if k == 1:
                th = first_theta
            for i in range(len(y)):
                noted.state[i] = before[i]
            take_step(plain.work, plain, noted.state, t, th)
            hold_solution(run.work, plain.work)
            take_step(run.work, run, y, t, th)
            follow(run.scene.coupling, run.offsets[0], y)
        if k < plan.steps:
            if k % plan.per_tick == 0:
                tick(run, k, time_of(plan, k), y)
            else:
                between_ticks(run.scene.firmware.delay, run, k, y)
        for i in range(len(y)):
            add_adjoint(noted.numbers, y[i], noted.adjoint[i])
        sweep(noted.numbers, noted.links, words, noted.first)
        most = max(most, (words[0, 0] & (SPAN - 1)) // ENTRY)
        for i in range(len(y)):
            noted.adjoint[i] = noted.numbers[noted.first + i, ADJOINT]
    return most
