"""Derivatives of a run at fixed steps: the adjoint from its end to its start, and tangents from its start to its end.

Let y[k] be the state after the ticks at step k.  A run is y[k] = F(y[k-1], p), F one step and what happens at its end;
a result has the derivative g[k] by y[k] where it is recorded.  Then its derivatives are

    l[N] = g[N],    l[k-1] = dF/dy' l[k] + g[k-1],    dJ/dp = sum over k of dF/dp' l[k],

at the cost of a few steps each, however many parameters there are; and of few parameters in the directions D

    t[k] = dF/dy t[k-1] + dF/dp D,

which gives the derivatives of all that is recorded.  Both products come from the tape of one step (taped.py).
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import entry, entry_of_process, inline, kernel
from ..compile.optional import any_present
from ..compile.structure import structure
from ..compile.taped import (
    ADJOINT,
    COLUMNS,
    EXTERNAL,
    SIZE,
    add_adjoint,
    as_input,
    as_taped,
    begin,
    entry_of,
    input_at,
    on_tape,
    on_the_tape,
    place_of,
    push_on,
    sweep,
    used,
    value_of,
)
from ..step.pool import renew_pool
from ..step.program import kept_count, kept_number, recall, recall_torques, writes_torques
from ..step.signals import time_of
from ..tree.coupling import follow
from ..tree.residual import solve_in_factors
from .integrator import hold_solution, take_step, thetas
from .rollout import between_ticks, tick


@structure
class Noted(NamedTuple):
    """The tape of a step, the states between steps, and what goes along."""

    numbers: np.ndarray  # (entries, 4) of `Tape`
    links: np.ndarray
    words: np.ndarray
    first: int  # entry after those of the inputs
    start: np.ndarray  # (length,) state before the ticks at the start
    past: np.ndarray  # (steps + 1, length) states after the ticks at each step
    state: np.ndarray  # (length,) scratch
    given: np.ndarray  # (joints + 6,) of a solution in factors
    found: np.ndarray
    room: np.ndarray  # (bodies, ROOM)
    kept: np.ndarray  # (ticks + 1, kept numbers) of a controller before the first tick, and after each: see program.py


def pull(run, y, plain, noted, seeds, adjoint):
    """Take the adjoint (length + kept numbers,) from the end of a run to its start.

    run, y: with memory of taped numbers (..., 2); plain: the run with its own memory, which solves each step before it
    is noted; seeds (records, channels): derivatives of the result by what is recorded.  Returns how many entries the
    longest step took, at least as many as the tape has if it was too small.
    """
    return _pull(on_tape(run), as_taped(y), plain, noted, seeds, adjoint)


@kernel
def _pull(run, y, plain, noted, seeds, adjoint):
    plan, program, most = run.plan, run.signals.program, 0
    for k in range(plan.steps, -1, -1):
        if k % plan.per_sample == 0:
            for j in range(len(run.channels)):
                adjoint[run.channels[j]] += seeds[k // plan.per_sample, j]
        note(run, y, plain, noted, k)
        for i in range(len(y)):
            add_adjoint(noted.numbers, y[i], adjoint[i])
        for i in range(kept_count(program)):
            add_adjoint(noted.numbers, on_the_tape(kept_number(program, i)), adjoint[len(y) + i])
        _sweep_back(run, plain, noted)
        most = max(most, used(noted.words))
        for i in range(len(adjoint)):
            adjoint[i] = noted.numbers[noted.first + i, ADJOINT]
    return most


def push(run, y, plain, noted, directions, tangents, room, out):
    """Take tangents (length + kept numbers, count) from the start of a run to its end; count: a multiple of COLUMNS.

    directions (inputs, count): those of the other inputs, a row for each entry before that of the state; room (entries,
    COLUMNS): scratch; out (records, channels, count): tangents of what is recorded.  The others and the returned number
    are those of `pull`.
    """
    return _push(on_tape(run), as_taped(y), plain, noted, directions, tangents, room, out)


@kernel
def _push(run, y, plain, noted, directions, tangents, room, out):
    plan, first, program = run.plan, noted.first, run.signals.program
    most = first
    for k in range(plan.steps + 1):
        note(run, y, plain, noted, k)
        most = max(most, used(noted.words))
        for column in range(0, tangents.shape[1], COLUMNS):
            for c in range(COLUMNS):
                for i in range(first):
                    room[i, c] = directions[i, column + c]
                for i in range(len(tangents)):
                    room[first + i, c] = tangents[i, column + c]
            _push_on(plain, noted, first + len(tangents), room)
            for i in range(len(y)):
                at = place_of(entry_of(y[i]))
                for c in range(COLUMNS):
                    tangents[i, column + c] = room[at, c]
            for i in range(kept_count(program)):
                at = place_of(entry_of(on_the_tape(kept_number(program, i))))
                for c in range(COLUMNS):
                    tangents[len(y) + i, column + c] = room[at, c]
        if k % plan.per_sample == 0:
            for j in range(len(run.channels)):
                for c in range(tangents.shape[1]):
                    out[k // plan.per_sample, j, c] = tangents[run.channels[j], c]
    return most


pull_back, push_forward = entry(pull), entry(push)
# A controller's function is compiled into these, and is of this process.
pull_back_controlled, push_forward_controlled = entry_of_process(pull), entry_of_process(push)


@inline
def _sweep_back(run, plain, noted):
    """Sweep over the whole tape; the external function in it is a solution in the factors that the step has left."""
    numbers, links, words = noted.numbers, noted.links, noted.words
    at, count, end = place_of(words[1, EXTERNAL]), words[1, SIZE], used(words)
    if at > 0:
        sweep(numbers, links, at + 2 * count, end)
        for i in range(count):
            noted.given[i], noted.found[i] = numbers[at + count + i, ADJOINT], 0.0
        _through_factors(plain, noted)
        for i in range(count):
            numbers[at + i, ADJOINT] += noted.found[i]
        end = at + count
    sweep(numbers, links, noted.first, end)


@inline
def _push_on(plain, noted, first, directions):
    numbers, links, words = noted.numbers, noted.links, noted.words
    at, count, end = place_of(words[1, EXTERNAL]), words[1, SIZE], used(words)
    if at > 0:
        push_on(numbers, links, first, at + count, directions)
        for c in range(COLUMNS):
            for i in range(count):
                noted.given[i], noted.found[i] = directions[at + i, c], 0.0
            _through_factors(plain, noted)
            for i in range(count):
                directions[at + count + i, c] = noted.found[i]
        first = at + 2 * count
    push_on(numbers, links, first, end, directions)


@inline
def _through_factors(plain, noted):
    scene, scratch = plain.scene, plain.work.scratch
    _solve(scene.floating, any_present(scene.contact, scene.fluid), scene.tree, scratch.W, noted)


@inline
def _solve(floating, contact, tree, W, noted):
    solve_in_factors(tree, None, floating, contact, noted.room, W, noted.given, 0, noted.found)


@kernel
def note(run, y, plain, noted, k):
    """Note the step to the grid step k and the ticks there, from the state before, whose entries come first."""
    plan, before = run.plan, noted.past[max(k - 1, 0)]
    if k == 0:
        before = noted.start
    begin(noted.words, noted.first)
    for i in range(len(y)):
        y[i] = as_input(noted.words, before[i])
        noted.state[i] = before[i]
    for i in range(kept_count(run.signals.program)):
        number = noted.kept[(k + plan.per_tick - 1) // plan.per_tick, i]
        recall(run.signals.program, i, as_input(noted.words, number))
        recall(plain.signals.program, i, number)
    recall_torques(writes_torques(run.signals.program), run.signals)
    recall_torques(writes_torques(run.signals.program), plain.signals)
    if k > 0:
        first_theta, theta = thetas(plain.work, plan.theta, noted.start[run.offsets[0].end_time])
        if k == 1:
            theta = first_theta
        t = time_of(plan, k - 1)
        _renew(plain.scene.pairs, y, plain, noted, before)
        take_step(plain.work, plain, noted.state, t, theta)
        for i in range(len(y)):
            noted.state[i] = value_of(y[i])
        hold_solution(run.work, run, plain, noted.state, t, theta)
        take_step(run.work, run, y, t, theta)
        follow(run.scene.coupling, run.offsets[0], y)
    if k < plan.steps:
        _ticks(run, y, k)


@inline
def _renew(pairs, y, plain, noted, before):
    """Deal out the slots of pairs as a run does that begins here, and move what is noted of them."""
    if pairs is not None:
        o, state = plain.offsets[0], noted.state
        renew_pool(pairs, plain, state, plain.plan.h, True)
        for i in range(o.pair_budget, o.pair_budget + 1):
            y[i] = state[i]
        for new in range(len(plain.renewal.kept)):
            old = _slot_before(o, new, state, before)
            ones, threes = (o.pair, 1), (o.pair_force, 3)
            for first, count in (ones, (o.pair_feature, 1), (o.pair_gap, 1), threes, (o.pair_position, 3)):
                for i in range(first + count * new, first + count * (new + 1)):
                    y[i] = state[i]
            _move(noted, y, o.pair_normal_force, 1, old, new)
            _move(noted, y, o.pair_deflection, 3, old, new)
            if pairs.turning is not None:
                _move(noted, y, o.pair_turning, 4, old, new)


@inline
def _slot_before(o, new, state, before):
    """Return the slot in which what is in the slot `new` was before, -1 of nothing."""
    pair, first, old = state[o.pair + new], new, 0
    if pair == 0.0:
        return -1
    while first > 0 and state[o.pair + first - 1] == pair:
        first -= 1
    while o.pair + old < o.pair_feature and before[o.pair + old] != pair:
        old += 1
    if o.pair + old == o.pair_feature:
        return -1
    return old + new - first


@inline
def _move(noted, y, at, count, old, new):
    for i in range(count):
        to = at + count * new + i
        y[to] = noted.state[to]
        if old >= 0:
            y[to] = input_at(noted.words, noted.first + at + count * old + i, noted.state[to])


@inline
def _ticks(run, y, k):
    if k % run.plan.per_tick == 0:
        tick(run, k, time_of(run.plan, k), y)
    else:
        between_ticks(run.scene.firmware.delay, run, k, y)
