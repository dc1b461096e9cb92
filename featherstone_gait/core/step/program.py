"""A controller from elsewhere that acts within a run: at ticks it writes what servos follow, or torques on the joints.

Its function is called by its address, lane by lane, with copies of what the lane has.
"""

from typing import NamedTuple

import numpy as np

from ..compile.by_type import overridable
from ..compile.jit import inline, kernel
from ..compile.lanes import flat, width_of
from ..compile.outside import call_outside
from ..compile.structure import structure
from ..compile.taped import noting, value_of

DONE, FIRST, OFFSET = 0, 1, 2  # of the clock: steps since the controller's start, steps before that, time before [s]
# Of its failure: one of the two below, at the time [s], at this index of the command, in this lane.
FAILED, WHEN, WHERE, LANE = 0, 1, 2, 3
RAISED, NOT_FINITE = 1.0, 2.0  # an exception; a number beyond `LARGEST`
LARGEST = 1e50  # number of a command


@structure
class Program(NamedTuple):
    """The controller of a run, and what it has."""

    function: int  # address
    every: int  # ticks from one call to the next
    replaces: bool | None  # True: its command is zero where it writes nothing; None: it is the reference
    torques: bool | None  # True: its command is torques on the joints [N m or N], of which the rates mean nothing
    command: np.ndarray  # (n, 2) what servos follow, and its rate
    memory: np.ndarray  # (K,)
    clock: np.ndarray  # (3,)
    # Of the lane whose turn it is:
    state: np.ndarray  # (length,)
    offsets: np.ndarray  # sizes, and where the parts of the state begin
    reference: np.ndarray  # (2 n,)
    own_command: np.ndarray  # (2 n,), and then of drives of surfaces
    own_memory: np.ndarray  # (K,)
    failure: np.ndarray  # (4,)
    surfaces: int  # where the commands of surfaces begin in the state

    SHARED = (
        "function", "every", "replaces", "torques", "state", "offsets", "reference", "own_command", "own_memory",
        "failure", "surfaces",
    )  # fmt: skip


@overridable
def writes_torques(program):
    """Return True, None where there is no program or servos follow it."""


writes_torques.of(Program)(lambda program: program.torques)


@overridable
def commanded(program, plan, k, y, reference):
    """Return what controllers follow at the step k (n, 2); the reference without a program."""
    return reference


@commanded.of(Program)
def _its_command(program, plan, k, y, reference):
    _act(noting(y), program, plan, k, y, reference)
    return program.command


@inline
def _act(noted, program, plan, k, y, reference):
    if noted is None:
        act(program.replaces, program, plan, k, y, reference)
    else:
        act_noted(program.replaces, program, plan, k, y, reference)


@kernel
def act_noted(replaces, program, plan, k, y, reference):
    """Call the controller with taped numbers; its function is then compiled into what calls it."""
    done = int(value_of(program.clock[DONE])) + k
    if (done // plan.per_tick) % program.every == 0:
        for i in range(len(program.command)):
            for column in range(2):
                program.command[i, column] = 0.0
                if replaces is None:
                    program.command[i, column] = reference[i, column]
        t = value_of(program.clock[OFFSET]) + (value_of(program.clock[FIRST]) + done) * plan.h
        program.function(t, y, program.offsets, reference, program.command, program.memory)


@overridable
def kept_count(program):
    """Return how many numbers a controller keeps from step to step besides the state: its memory, then its command."""
    return 0


kept_count.of(Program)(lambda program: len(program.memory) + 2 * len(program.command))


@overridable
def kept_number(program, i):
    """Return one of these numbers."""
    return 0.0


@kept_number.of(Program)
def _kept(program, i):
    if i < len(program.memory):
        return program.memory[i]
    at = i - len(program.memory)
    return program.command[at // 2, at % 2]


@overridable
def recall(program, i, x):
    """Set one of these numbers."""


@recall.of(Program)
def _recall(program, i, x):
    at = i - len(program.memory)
    if at < 0:
        program.memory[i] = x
    else:
        program.command[at // 2, at % 2] = x


@inline
def recall_torques(present, signals):
    """Set the torques that stand until the next tick to those that a controller has commanded."""
    if present is not None:
        for i in range(len(signals.program.command)):
            signals.torques.cubics[0, i, 0] = signals.program.command[i, 0]


@kernel
def act(replaces, program, plan, k, y, reference):
    """Call the controller of each lane whose turn it is."""
    width, clock, memory, command = width_of(y), flat(program.clock), flat(program.memory), flat(program.command)
    given, numbers = flat(reference), flat(y)
    for lane in range(width):
        done = int(clock[DONE * width + lane]) + k
        if (done // plan.per_tick) % program.every == 0 and program.failure[FAILED] == 0.0:
            t = clock[OFFSET * width + lane] + (clock[FIRST * width + lane] + done) * plan.h
            program.failure[WHEN], program.failure[LANE] = t, lane
            for i in range(len(program.state)):
                program.state[i] = numbers[i * width + lane]
            for i in range(len(program.reference)):
                program.reference[i] = given[i * width + lane]
                program.own_command[i] = 0.0
                if replaces is None:
                    program.own_command[i] = program.reference[i]
            for i in range(len(program.reference), len(program.own_command)):
                program.own_command[i] = 0.0
            first = len(program.reference) // 2
            for i in range(first, len(program.own_command) // 2):
                program.own_command[2 * i] = numbers[(program.surfaces + i - first) * width + lane]
            for i in range(len(program.own_memory)):
                program.own_memory[i] = memory[i * width + lane]
            arrays = (
                program.state, program.offsets, program.reference, program.own_command, program.own_memory,
                program.failure,
            )  # fmt: skip
            call_outside(program.function, t, arrays)
            look_for_failure(program)
            if program.failure[FAILED] == 0.0:
                for i in range(len(program.reference)):
                    command[i * width + lane] = program.own_command[i]
                for i in range(first, len(program.own_command) // 2):
                    numbers[(program.surfaces + i - first) * width + lane] = program.own_command[2 * i]
                for i in range(len(program.own_memory)):
                    memory[i * width + lane] = program.own_memory[i]


@kernel
def look_for_failure(program):
    """Note a number of the command that is not finite, or beyond all bounds."""
    for i in range(len(program.own_command)):
        if program.failure[FAILED] == 0.0 and not abs(program.own_command[i]) <= LARGEST:
            program.failure[FAILED], program.failure[WHERE] = NOT_FINITE, i
