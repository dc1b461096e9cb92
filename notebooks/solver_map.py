"""Walk one gait many times in the paper's kind of program, and map how much its energy scatters.

    python solver_map.py ../docs/reproduction/solver_map.csv

SimTwo ran ODE's QuickStep: free bodies, constraints, and ten sweeps over their rows in a random order.  Runs of one
gait differ by the seed of this order alone; no noise is added.  The paper gives neither step nor sweeps nor masses: its
program's own are 1 ms and ten sweeps, and those of `robots/humanoid` are the masses of its authors' scene.  The map has
settings around these, and takes some five minutes of two cores.
"""

from __future__ import annotations

import functools
import itertools
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from setups import planned_walk, recompiled, scale_masses

from featherstone_gait import standing_state
from featherstone_gait.base.files import Format, read_csv, write_csv
from featherstone_gait.reproduction.maximal import Engine, simulate_seeds
from featherstone_gait.run.trajectory import Trajectory
from featherstone_gait.walking import WalkingCost
from featherstone_gait.walking.gait import TICK

STEPS = (5e-4, 1e-3, 1.25e-3, 1e-2 / 6, 2e-3)  # [s]; all divide the controllers' 10 ms
SWEEPS = (5, 10, 20)
MASSES = (0.6, 0.8, 1.0, 1.2)  # times those of robots/humanoid; 0.81: the mass of the authors' other humanoid
RUNS = 40  # of each setting, which give a deviation to 11 %, one sigma
STORED = Path(__file__).parents[1] / "docs" / "reproduction" / "solver_map.csv"
FORMAT = Format("solver map")


class Row(NamedTuple):
    """How much the energy of one gait scatters at a setting."""

    gearbox: str
    step: float  # [s]
    iterations: int  # sweeps; 0: the step is solved
    mass: float  # times those of robots/humanoid
    runs: int
    fell: int  # of them, and left out
    energy: float  # mean of a gait cycle [J]
    distance: float  # mean of a run [m]
    cycle: float  # standard deviation over mean, of all cycles of all runs
    repeat: float  # the same of one cycle from run to run, root mean square over the cycles
    run: float  # the same of the sums of a run


@functools.cache
def planned() -> WalkingCost:
    """Plan the walk of the ten-joint humanoid: a cycle to warm up and four that are measured."""
    return replace(planned_walk(), warm_up=1, strides=4)


def walk(gearbox: str, step: float = 1e-3, mass: float = 1.0, integrator: str = "simtwo") -> WalkingCost:
    """Return the planned walk with another gear model, step [s], masses [times] and integrator."""
    model = scale_masses(planned().scene.model, mass)
    return recompiled(planned(), model, gearbox=gearbox, integrator=integrator, timestep=step)


def energies(cost: WalkingCost, runs: Sequence[Trajectory]) -> np.ndarray:
    """Return the energy of each run, recorded every `TICK`, and cycle (runs, cycles) [J]; NaN of runs that fell."""
    marks = np.round((cost.mark + np.arange(cost.strides + 1) * cost.gait.period) / TICK).astype(int)
    drawn = [run.column("energy", "electrical_no_regeneration").sum(axis=1) for run in runs]
    found = np.array([np.diff(one[marks]) for one in drawn])
    found[[run.status in ("fell", "diverged") for run in runs]] = np.nan
    return found


def noisy(cost: WalkingCost, posture: float, encoder: float, supply: float, runs: int = 40) -> np.ndarray:
    """Walk with noise, the same draws for every walk; return the energies (runs, cycles) [J].

    posture: standard deviation of the first angles [rad]; encoder, supply: largest error of the angles that the servos
    read [rad] and of the voltage, which is that of all servos [V], drawn anew at each tick of the controllers.
    """
    start, rng = cost.reference(cost.gait.to_vector(), 0).values[0], np.random.default_rng(0)
    ticks, joints = math.ceil(cost.end / 0.01 - 1e-9), len(start)
    states = [standing_state(cost.scene, start + posture * off) for off in rng.standard_normal((runs, joints))]
    read, volts = rng.uniform(-1, 1, (runs, ticks, joints)), rng.uniform(-1, 1, (runs, ticks, 1))
    noises = np.stack(np.broadcast_arrays(encoder * read, supply * volts), axis=-1)
    how = {"states": states, "noises": [*noises], "record": ("energy",), "record_interval": TICK}
    return energies(cost, cost.simulate([cost.gait.to_vector()] * runs, **how))


def deviations(E: np.ndarray) -> tuple[float, float, float]:
    """Return standard deviations over the mean of energies (runs, cycles) as in `Row`: cycle, repeat, run."""
    E = E[np.isfinite(E).all(axis=1)]
    if len(E) < 2:
        return math.nan, math.nan, math.nan
    sums, repeat = E.sum(axis=1), math.sqrt(E.var(axis=0, ddof=1).mean())
    return float(E.std(ddof=1) / E.mean()), float(repeat / E.mean()), float(sums.std(ddof=1) / sums.mean())


def swept(
    gearbox: str, step: float, sweeps: int, mass: float, runs: int, engine: Engine | None = None
) -> tuple[np.ndarray, Row]:
    """Walk with bodies and sweeps; return the energies (runs, cycles) [J], NaN of runs that fell, and their row."""
    cost = walk(gearbox, step, mass)
    done = simulate_seeds(
        cost.scene, cost.end, *cost.beginning(cost.gait.to_vector()), seeds=range(runs),
        engine=engine or Engine(iterations=sweeps), record=("base_q", "energy"), record_interval=TICK,
    )  # fmt: skip
    E, mark = energies(cost, done), round(cost.mark / TICK)
    sound = np.isfinite(E).all(axis=1)
    ways = [run["base_q"][-1, 0] - run["base_q"][mark, 0] for run, walks in zip(done, sound) if walks]
    means = (float(E[sound].mean()), float(np.mean(ways))) if len(ways) > 1 else (math.nan, math.nan)
    return E, Row(gearbox, step, sweeps, mass, runs, int((~sound).sum()), *means, *deviations(E))


def read(path: str | Path = STORED) -> list[Row]:
    """Read a map."""
    _, *lines = [cells for _, cells in read_csv(path, FORMAT)]
    return [Row(c[0], float(c[1]), int(c[2]), float(c[3]), int(c[4]), int(c[5]), *map(float, c[6:])) for c in lines]


def write(path: str | Path, rows: Iterable[Row]) -> None:
    """Write a map."""
    write_csv(path, FORMAT, Row._fields, rows, end="\n")


def main(arguments: Sequence[str]) -> int:
    """Compute the map into a CSV."""
    if len(arguments) != 1:
        print("usage: python solver_map.py MAP.csv", file=sys.stderr)
        return 2
    rows = []
    for mass, sweeps, step, gearbox in itertools.product(MASSES, SWEEPS, STEPS, ("standard", "mipsd")):
        rows.append(swept(gearbox, step, sweeps, mass, RUNS)[1])
        print(*(f"{x:.4g}" if isinstance(x, float) else x for x in rows[-1]), flush=True)
        write(arguments[0], rows)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
