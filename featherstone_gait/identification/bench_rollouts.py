"""Simulate recordings of a servo bench with several sets of values at once."""

from __future__ import annotations

import math
import os
from collections.abc import Hashable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..core.compile.lanes import WIDTH
from ..core.step.signals import Signals
from ..model import Controller, Gearbox, Joint, Link, Model, Servo
from ..run.batch import family, over_threads
from ..run.compiled_run import CompiledRun, RunInput, Vector, lane_zeros
from ..run.lane_engine import sampled
from ..run.prepare import each_once, prepare
from ..run.reference import Reference
from ..run.simulate import initial_state
from ..run.worlds import Worlds, servo_with
from ..scene.compile import CompiledScene, GearboxKind, compile_scene
from .recording import EARLY

if TYPE_CHECKING:
    from .bench import Bench, BenchRecording

# Of simulation and firmware [s].  Steps of 1 and 0.5 ms change the error of a recording of the XL330 by at most 0.5 and
# 0.8 mrad, and the mean of the twelve by 0.05; a firmware at 1 kHz by 0.9 and 0.02 (model m4p, fitted to all).
STEP = 2e-3
OPEN = 1e-9  # current limit of a bridge that has let go [A]
BASE = ("torque_constant", "torque_per_volt", "armature", "rod_mass", "zero", "coulomb_friction", "viscous_friction")
TIMES = ("angle_age",)
SHARED = {  # numbers of M3 and M4 that are two of `Gearbox`
    "load_friction": ("external_load_friction", "motor_load_friction"),
    "stribeck_load": ("stribeck_external_load", "stribeck_motor_load"),
}


class BenchWorld(NamedTuple):
    """Numbers of one simulation, by the names of `Worlds`."""

    servos: dict[str, float]
    mass: float  # of the rod with its weight [kg]
    center: float  # below the axis [m]
    inertia: float  # about its center of mass [kg m^2]


def numbers_of(bench: Bench, recording: BenchRecording, values: dict[str, float]) -> BenchWorld:
    """Return the numbers of a recording's simulation with these values of the parameters."""
    k, g = values["torque_constant"], values["torque_per_volt"]
    own = {name: x for name, x in values.items() if name not in (*BASE, *TIMES)}
    for name, both in SHARED.items():
        if name in own:
            own |= dict.fromkeys(both, own.pop(name))
    servos = {
        "motor_constant": k,
        "resistance": k / g,
        "voltage_limit": bench.largest_duty * recording.supply,
        "Kp": bench.duty * recording.gain * recording.supply,
        "rotor_inertia": values["armature"],
        "coulomb_friction": values["coulomb_friction"],
        "viscous_friction": values["viscous_friction"],
        **own,
    }
    rod, m, l = values["rod_mass"], recording.mass, recording.length
    mass = m + rod
    center = (m * l + 0.5 * rod * l) / mass
    return BenchWorld(servos, mass, center, m * l * l + rod * l * l / 3.0 - mass * center * center)


BLANK_SERVO = Servo(
    Controller("state", period=STEP, lag=0.0), Gearbox(1.0), resistance=1.0, motor_constant=1.0, voltage_limit=1.0
)  # what a world's numbers go into


def pendulum(name: str, servo: Servo, mass: float, length: float, inertia: float = 0.0) -> Model:
    """Return a robot whose only joint, `turn`, is the servo, with a rod that hangs down at zero.

    Parameters
    ----------
    name : str
    servo : Servo
    mass : float
        Of rod and weight [kg].
    length : float
        From the axis to their center of mass [m].
    inertia : float
        About that [kg m^2]; 0 of a weight alone.

    Returns
    -------
    Model
    """
    links = (
        Link("stand", 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
        Link("rod", mass, (0.0, 0.0, -length), (inertia, 0.0, 0.0, inertia, 0.0, inertia)),
    )
    joint = Joint("turn", "continuous", "stand", "rod", axis=(0.0, -1.0, 0.0))
    return Model(name, links, (joint,), servos={"turn": servo})


def _scene(bench: Bench, world: BenchWorld) -> CompiledScene:
    """Compile the bench."""
    servo = servo_with(BLANK_SERVO, world.servos)
    model = pendulum(f"{bench.name}_bench", servo, world.mass, world.center, world.inertia)
    kind: GearboxKind = "rotor" if servo.gearbox.stiffness == math.inf else "mipsd"
    return compile_scene(model, kind, integrator="implicit_euler", timestep=STEP)


class Rollouts:
    """Simulations of all recordings with several sets of values at once, eight to a vector."""

    def __init__(self, bench: Bench, recordings: Sequence[BenchRecording]) -> None:
        self.bench, self.recordings, self.count = bench, list(recordings), 0
        self.steps = max(map(_steps, self.recordings))
        self.held = [_held(r, self.steps) for r in self.recordings]
        self.scene: CompiledScene | None = None  # of the first call

    def __call__(self, sets: Sequence[dict[str, float]]) -> list[list[np.ndarray]]:
        """Return the angles of each recording at its times [rad], for each set of values."""
        n = len(self.recordings)
        pairs = [(values, k) for values in sets for k in range(n)]
        self.count += len(pairs)
        worlds = [numbers_of(self.bench, self.recordings[k], values) for values, k in pairs]
        servos, *others = worlds[0]  # one more world, so that in every batch the same numbers differ: for one kernel
        worlds.append(BenchWorld({k: 1.01 * x + 1e-6 for k, x in servos.items()}, *(1.01 * x + 1e-6 for x in others)))
        self.scene = self.scene or _scene(self.bench, worlds[0])
        scenes = scenes_of(self.scene, worlds)
        runs = each_once(lambda scene: prepare(scene, self.steps * STEP, ("q",), STEP), scenes)
        begun: dict[tuple[int, float], tuple[RunInput, np.ndarray]] = {}
        for values, k in pairs:
            if (k, values["zero"]) not in begun:
                begun[k, values["zero"]] = self._begin(runs[k], self.recordings[k], values["zero"])
        alike: dict[Hashable, list[int]] = {}  # several where a value at its bound leaves a part of the servo out
        for i, key in enumerate(each_once(family, runs)):
            alike.setdefault(key, []).append(i)
        parts: list[tuple[CompiledRun, list[int]]] = []
        for members in alike.values():
            own = list({id(runs[i]): runs[i] for i in members}.values())
            lanes = own[0].among([*own, _released(own[0])])
            order = sorted(set(members) - {len(pairs)}, key=lambda i: self.held[pairs[i][1]])  # those released together
            parts.extend((lanes, order[i : i + WIDTH]) for i in range(0, len(order), WIDTH))

        def advance(job: tuple[CompiledRun, list[int]]) -> np.ndarray:
            lanes, part = job
            found = [begun[k, values["zero"]] for values, k in (pairs[i] for i in part)]
            starts = [start._replace(compiled=runs[i]) for i, (start, _) in zip(part, found)]
            held = [self.held[pairs[i][1]] for i in part]
            return self._advance(lanes, starts, [ticks for _, ticks in found], held)

        angles: list[np.ndarray] = [np.empty(0)] * len(pairs)
        for (_, part), paths in zip(parts, over_threads(runs[0], advance, parts, os.cpu_count() or 1)):
            for i, path in zip(part, paths.T):
                (values, k), times = pairs[i], STEP * np.arange(len(path))
                time = self.recordings[k].time - values["angle_age"] - self.recordings[k].time[0]
                angles[i] = np.interp(time, times, path) + values["zero"]
        return [angles[k : k + n] for k in range(0, len(angles), n)]

    def _begin(self, run: CompiledRun, r: BenchRecording, zero: float) -> tuple[RunInput, np.ndarray]:
        """Return what a recording starts from, and what its controller sees at each tick (ticks, 1, 2)."""
        times = r.time - r.time[0] - self.bench.goal_lead - EARLY
        goal = Reference(times, r.goal[:, None] - zero, "hold")
        start = run.start(initial_state(run.scene, [r.angle[0] - zero]), goal)
        return start, sampled(start, run.schedule(start.y), 0, self.steps)

    def _advance(
        self, lanes: CompiledRun, starts: list[RunInput], ticks: list[np.ndarray], held: list[int]
    ) -> np.ndarray:
        """Simulate up to eight runs, whose bridges let go after `held` steps; return their angles (steps + 1, runs)."""
        idle, count = WIDTH - len(starts), len(starts)
        signals = Signals(None, lane_zeros((1, 2)), None, None, None, None, None, None)
        vector = Vector(lanes, signals, out=lane_zeros((self.steps + 1, 1)))
        for lane, start in enumerate([*starts, *[starts[-1]] * idle]):
            vector.put(lane, start)
        seen = lane_zeros((self.steps, 1, 2))
        seen[...] = np.stack([*ticks, *[ticks[-1]] * idle], axis=-1)
        limits, at = vector.run.scene.actuator.motor.values["current_limit"], 0
        for end in sorted({*held, self.steps}):
            plan = vector.run.plan._replace(steps=end - at)
            vector.step(vector.out[at : end + 1], plan=plan, signals=signals._replace(samples=seen[at:end]))
            limits[:, [lane for lane, last in enumerate(held) if last == end]] = OPEN
            at = end
        return vector.out[:, 0, :count]


def _steps(r: BenchRecording) -> int:
    """Return the steps of a recording, some more than it lasts: the angle's age may be negative."""
    return math.ceil((r.time[-1] - r.time[0]) / STEP) + 40


def _held(r: BenchRecording, steps: int) -> int:
    """Return the steps of a recording until the servo switches off, all if it never does."""
    return steps if r.release == math.inf else round((r.release - r.time[0]) / STEP)


def _released(run: CompiledRun) -> CompiledRun:
    """Return the run with a bridge that has let go."""
    constants = run.scene.constants
    motor = constants.actuator.motor.copy()
    motor["current_limit"] = OPEN
    constants = constants._replace(actuator=constants.actuator._replace(motor=motor))
    return replace(run, scene=replace(run.scene, constants=constants))


def scenes_of(scene: CompiledScene, worlds: list[BenchWorld]) -> list[CompiledScene]:
    """Return the scene of each world; equal worlds, such as those of one gain, share one."""
    keys = [(*world.servos.values(), *world[1:]) for world in worlds]
    places = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    others = list(dict(zip(keys, worlds)).values())
    zero, J = np.zeros(len(others)), np.array([world.inertia for world in others])
    links = {
        "rod.mass": np.array([world.mass for world in others]),
        "rod.center_of_mass": np.column_stack([zero, zero, [-world.center for world in others]])[:, None, :],
        "rod.inertia": np.column_stack([J, zero, zero, J, zero, J])[:, None, :],
    }
    servos = {name: np.array([world.servos[name] for world in others]) for name in others[0].servos}
    made = Worlds(servos=servos, links=links).scenes(scene)
    return [made[places[key]] for key in keys]
