"""Make the searches that notebook 04 reads and that take hours (Lima et al. 2013, section 5, Fig. 16).

    python notebooks/searches.py courses --searches 10 --only "reduced coordinates, mipsd"
    python notebooks/searches.py ends --searches 2

`courses` searches with the scatter that the paper reports of its cost, and varies how the search is read; it stores
every improvement in docs/reproduction/noisy_courses.csv, and medians and quartiles in noisy_searches.csv.  `ends`
varies the first gait, what the four states are, and the floors, without scatter, and stores the outcome of each search
in searches.csv.  A table is written after each search, and a search that it has is not made again.

The paper leaves out what is a `Condition` here:

- the program: ours; ours in the paper's order of updates ("simtwo"); or the paper's kind of program of bodies and
  sweeps (`reproduction.maximal`), which orders its rows at random, so that each walk scatters by itself;
- whether its four states are those of a stride, or of a step that the other leg mirrors;
- how its search is to be read, and its width: a key of `RULES`;
- the masses, the first gait (the plain plan, or the cheapest of many), and whether a gait must walk on eight floors.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass, fields, replace
from functools import cache
from itertools import groupby, product
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import mannwhitneyu
from setups import COLORS, planned_walk, recompiled, scale_masses

from featherstone_gait.base.files import Format, read_csv, write_csv
from featherstone_gait.base.progress import progress_bar
from featherstone_gait.core.effects.energies import METER
from featherstone_gait.optimize.search import AMPLITUDE, MAX_MISS
from featherstone_gait.reproduction.maximal import simulate as simulate_bodies
from featherstone_gait.run.simulate import simulate_stream, standing_state
from featherstone_gait.run.trajectory import Trajectory
from featherstone_gait.search import AdaptiveSimulatedAnnealing
from featherstone_gait.search.annealing import REHEATED
from featherstone_gait.search.speculation import Candidate, Speculation
from featherstone_gait.walking.cost import LEAST_SPEED, WalkingCost
from featherstone_gait.walking.cost_in_worlds import in_worlds
from featherstone_gait.walking.gait import TICK, bounds

STORED = Path(__file__).parents[1] / "docs" / "reproduction"
PROGRAMS = OURS, UPDATES, PAPERS = "reduced coordinates", "reduced coordinates, explicit", "bodies and sweeps"
SCATTER = {"mipsd": 0.039, "standard": 0.1462}  # of the cost, standard deviation over the cost; Fig. 11
CORRECTED, CLEAN = "as corrected", "no scatter"
GAIN_LEFT = 0.1  # of the whole gain, when a search has converged


class LiteralTest(AdaptiveSimulatedAnnealing):
    """The search that widens only where the count of misses equals MAXMISS, as Fig. 14 prints.

    The count 0.1, 1.1, 2.1, ... after it has widened never does, so that it widens once before the next improvement.
    """

    def after(self, iteration: int, miss: float, since_progress: int, better: bool) -> tuple[int, float, int]:
        """Return iteration, miss and misses since progress after a candidate that is the new best or not."""
        place, _, since = super().after(iteration, miss, since_progress, better)
        count = 1.0 if since == 0 else miss + 1.0
        return place, REHEATED if count == self.max_miss else count, since


class FewerAngles(AdaptiveSimulatedAnnealing):
    """The search that perturbs D / miss of D angles: "the random vector size depends on the missed iterations"."""

    def candidate(self, iteration: int, best_x: np.ndarray, miss: float) -> np.ndarray:
        """Return the candidate (D,) of an iteration around `best_x`; which angles differ is drawn by the seed."""
        if iteration == 0:
            return self.x0.copy()
        n = len(best_x)
        chance = np.random.Philox(key=self.seed, counter=[0, iteration, 1, 0]).random_raw(n)
        chosen = chance.argsort(kind="stable")[: int(np.ceil(n / max(miss, 1.0)))]
        x = best_x.copy()
        x[chosen] = super().candidate(iteration, best_x, 1.0)[chosen]
        return x


class Rule(NamedTuple):
    """How a search perturbs, and what it sees."""

    search: type[AdaptiveSimulatedAnnealing] = AdaptiveSimulatedAnnealing
    amplitude: float = AMPLITUDE  # [rad]
    max_miss: int = MAX_MISS
    masses: float = 1.0  # over the robot's
    scatter: float = 1.0  # over the paper's


RULES = {
    CORRECTED: Rule(),
    "literal test": Rule(LiteralTest),
    "fewer angles": Rule(FewerAngles),
    "amplitude halved": Rule(amplitude=0.5 * AMPLITUDE),
    "amplitude doubled": Rule(amplitude=2.0 * AMPLITUDE),
    "MAXMISS halved": Rule(max_miss=MAX_MISS // 2),
    "MAXMISS doubled": Rule(max_miss=2 * MAX_MISS),
    "masses x 0.81": Rule(masses=0.81),  # of the lighter of the authors' humanoids; ours is the heavier
    CLEAN: Rule(scatter=0.0),
}


@dataclass(frozen=True)
class Condition:
    """Hold the settings of a search."""

    program: str = OURS
    gearbox: Any = "mipsd"
    states: Any = "stride"
    rule: str = CORRECTED
    plan: Any = "plain"
    floors: int = 1
    step: float = 1e-3  # of time [s]

    @property
    def scatter(self) -> float:
        """Standard deviation over the cost that is put in [-]; the paper's kind of program scatters by itself."""
        return 0.0 if self.program == PAPERS else RULES[self.rule].scatter * SCATTER[self.gearbox]

    def __str__(self) -> str:
        special = {
            self.rule: self.rule != CORRECTED,
            f"{self.plan} plan": self.plan != "plain",
            f"{self.floors} floors": self.floors > 1,
            f"{1e3 * self.step:g} ms": self.step != 1e-3,
        }
        return ", ".join([self.program, self.gearbox, self.states, *(name for name, so in special.items() if so)])


# ---------------------------------------------------------------------------------------------- walks


@cache
def _planned(plan: Any, states: Any) -> WalkingCost:
    return planned_walk(plan=plan, states=states)


@cache
def first_gait(condition: Condition) -> WalkingCost:
    """Return the planned gait of a condition, on its own floor and without scatter."""
    planned = _planned(condition.plan, condition.states)
    how: dict[str, Any] = {} if condition.program == OURS else {"integrator": "simtwo", "timestep": condition.step}
    model = scale_masses(planned.scene.model, RULES[condition.rule].masses)
    return recompiled(planned, model, gearbox=condition.gearbox, **how)


def measured(cost: WalkingCost, run: Trajectory) -> tuple[float, float]:
    """Return energy per distance [J/m] and distance per step [m] of a run; infinite and NaN if it falls.

    Unlike `WalkingCost.measured` it takes a run that chatters as it is.
    """
    first, last = (round(t / TICK) for t in (cost.mark, cost.end))
    before, after = run["energy"][[first, last], :, METER].sum(axis=1)
    start, end = run["base_q"][[first, last], 0]
    if run.status not in ("ok", "chatter") or end - start < LEAST_SPEED * (last - first) * TICK:
        return math.inf, math.nan
    return (after - before) / (end - start), (end - start) / (2.0 * cost.strides)


def measure(cost: WalkingCost, vectors: Iterable[np.ndarray]) -> np.ndarray:
    """Return energy per distance [J/m] and distance per step [m] of gaits (n, 2); infinite and NaN if they fall."""
    runs = cost.simulate(vectors, record_interval=TICK, record=("base_q", "energy"))
    return np.array([measured(cost, run) for run in runs])


def swept(cost: WalkingCost, x: np.ndarray, again: int = 0) -> tuple[float, float]:
    """Measure a gait in the paper's kind of program.

    The order of its rows begins at a seed that depends on the gait, and on how often that was asked for before.
    """
    state, reference = cost.beginning(x)
    seed = int.from_bytes(hashlib.sha256(x.tobytes() + again.to_bytes(4, "little")).digest()[:6], "little")
    record = ("base_q", "energy")
    run = simulate_bodies(cost.scene, cost.end, state, reference, seed=seed, record=record, record_interval=TICK)
    return measured(cost, run)


def walked(condition: Condition, vectors: Sequence[np.ndarray], again: Sequence[int], least: int) -> np.ndarray:
    """Return cost [J/m] and distance per step [m] of gaits, and how many of their walks fall (n, 3).

    again, least: where walks scatter by themselves, which are made, and how many must not fall to have a mean.
    """
    cost = first_gait(condition)
    if condition.program != PAPERS:
        found = measure(cost, vectors)
        return np.c_[found, ~np.isfinite(found[:, 0])]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        walks = np.array(list(pool.map(lambda job: swept(cost, *job), product(vectors, again))))
    walks = walks.reshape(len(vectors), len(again), 2)
    sound = np.isfinite(walks[..., 0])
    n = sound.sum(axis=1)
    means = np.where(sound[..., None], walks, 0.0).sum(axis=1) / np.maximum(1, n)[:, None]
    means[n < least] = math.inf, math.nan
    return np.c_[means, len(again) - n]


# ---------------------------------------------------------------------------------------------- searches


def search(condition: Condition, seed: int, iterations: int) -> tuple[list[int], list[float], list[np.ndarray]]:
    """Search; return iteration, cost as seen [J/m] and angles [rad] of the first gait and of each improvement."""
    cost, rule, n = first_gait(condition), RULES[condition.rule], iterations
    one = rule.search(
        cost.gait.to_vector(), amplitude=rule.amplitude, max_miss=rule.max_miss, max_iterations=n, no_progress=n,
        bounds=bounds(cost.scene.model, cost.gait), seed=seed,
    )  # fmt: skip
    candidates = Speculation(one)
    if condition.floors > 1:
        in_worlds(cost, condition.floors).evaluate(candidates)
    elif condition.program == PAPERS:
        with ThreadPoolExecutor() as pool:
            list(pool.map(lambda _: _sweep(cost, candidates), range(os.cpu_count() or 1)))
    else:
        _stream(cost, candidates, condition.scatter)
    for _, (f, _) in candidates.visits(wait=False):
        one.tell(one.ask(), f)
    best = [visit for visit in one.visited if visit.accepted]
    return [v.iteration for v in best], [v.f for v in best], [v.x for v in best]


def _sweep(cost: WalkingCost, candidates: Speculation) -> None:
    while (candidate := candidates.take()) is not None:
        candidates.give(candidate, swept(cost, candidate.x)[0])


def _stream(cost: WalkingCost, candidates: Speculation, scatter: float) -> None:
    """Evaluate candidates with a scatter that depends on the final state of the run alone."""
    state = standing_state(cost.scene, cost.start[0])

    def begin(candidate: Candidate) -> Any:
        return state, cost.reference(candidate.x, cost.warm_up + cost.strides)

    def end(run: Trajectory) -> tuple[float, str]:
        seed = int.from_bytes(hashlib.sha256(run.final.tobytes()).digest()[:8], "little")
        factor = 1.0 + scatter * np.random.default_rng(seed).standard_normal()
        return float(measured(cost, run)[0] * factor), run.status

    simulate_stream(cost.scene, cost.end, candidates, begin, end, ("base_q", "energy"), TICK)


def converged(at: Sequence[int], seen: Sequence[float]) -> int:
    """Return the candidate after which a tenth of the gain is left, as the search saw it.

    at, seen: candidate and cost of each improvement.  A share of the gain, unlike one of the cost, means the same for
    a search that saves 2 % and for one that saves 70 %.
    """
    left = np.asarray(seen) - seen[-1]
    return int(at[int(np.argmax(left <= GAIN_LEFT * left[0]))])


def interval(values: Sequence[float], draws: int = 10_000) -> tuple[float, float]:
    """Return the 95 % interval of a median, by bootstrap over the searches."""
    again = np.random.default_rng(0).choice(np.asarray(values, dtype=float), (draws, len(values)))
    low, high = np.quantile(np.median(again, axis=1), (0.025, 0.975))
    return float(low), float(high)


def later(old: Sequence[float], new: Sequence[float]) -> float:
    """Return p of the one-sided rank-sum test that the old searches do not converge later than the new ones."""
    return float(mannwhitneyu(old, new, alternative="greater").pvalue)


# ---------------------------------------------------------------------------------------------- tables


@dataclass(frozen=True)
class Improvement:
    """A row of noisy_courses.csv: the first gait, or a candidate that became the best of its search."""

    program: str
    gearbox: str
    states: str
    seed: int
    iterations: int  # of the whole search
    iteration: int
    seen: float  # its cost as the search saw it [J/m]
    cost: float  # without the scatter, or the mean of five further walks [J/m]; infinite if most fall
    step: float  # distance per step [m]
    rule: str

    file: ClassVar = "noisy_courses.csv"
    form: ClassVar = Format("search courses")
    cases: ClassVar = (
        *(Condition(p, g, s) for p, s, g in product((OURS, UPDATES), ("stride", "step"), SCATTER)),
        *(Condition(rule=rule) for rule in RULES if rule not in (CORRECTED, CLEAN)),
        *(Condition(PAPERS, g, s) for s, g in product(("stride", "step"), SCATTER)),
    )

    @property
    def condition(self) -> Condition:
        return Condition(self.program, self.gearbox, self.states, self.rule)

    @classmethod
    def make(cls, c: Condition, seed: int, n: int) -> list[Improvement]:
        """Search, and measure each improvement without what luck has added."""
        at, seen, gaits = search(c, seed, n)
        truly = walked(c, gaits, range(1, 6), 3).tolist()
        of = c.program, c.gearbox, c.states, seed, n
        return [cls(*of, k, f, *both[:2], c.rule) for k, f, both in zip(at, seen, truly)]


@dataclass(frozen=True)
class End:
    """A row of searches.csv: what a search came to."""

    program: str
    gearbox: str
    step: float  # [s]
    plan: str
    states: str
    floors: int
    seed: int
    iterations: int
    first: float  # cost of the first gait as the search saw it [J/m]
    best: float  # of the last best as it saw it [J/m]
    cost: float  # change of the cost, on the own floor; where walks scatter, of the mean of 20 [-]
    longer: float  # change of the distance per step there [-]
    fell: int  # of these walks of the gait found
    passed: int  # candidate that passed the paper's -14 %, as the search saw it; -1: none did
    longer_then: float  # change of the distance per step at that moment [-]
    converged: int

    file: ClassVar = "searches.csv"
    form: ClassVar = Format("search table")
    cases: ClassVar = (
        *(Condition(gearbox="standard", states=s, rule=CLEAN) for s in ("stride", "step")),
        *(Condition(OURS, "mipsd", s, CLEAN, p, f)
          for f, p, s in product((1, 8), ("plain", "cheapest"), ("stride", "step"))),
        *(Condition(PAPERS, g, step=step) for step, g in product((1e-3, 2e-3), ("standard", "mipsd"))),
    )  # fmt: skip

    @property
    def condition(self) -> Condition:
        rule = CORRECTED if self.program == PAPERS else CLEAN
        return Condition(self.program, self.gearbox, self.states, rule, self.plan, self.floors, self.step)

    @classmethod
    def make(cls, c: Condition, seed: int, n: int) -> list[End]:
        """Search, and measure the gait found against the first one."""
        at, seen, gaits = search(c, seed, n)
        steps = walked(c, gaits, [0], 1)[:, 1]
        before, after = walked(c, [gaits[0], gaits[-1]], range(1, 21), 1)
        passed = [k for k, f in enumerate(seen) if f <= 0.86 * seen[0]][:1]
        then = (at[passed[0]], float(steps[passed[0]] / steps[0] - 1.0)) if passed else (-1, math.nan)
        gain, longer = (after[:2] / before[:2] - 1.0).tolist()
        of = c.program, c.gearbox, c.step, c.plan, c.states, c.floors, seed, n
        return [cls(*of, seen[0], seen[-1], gain, longer, int(after[2]), *then, converged(at, seen))]


def read(kind: type, folder: Path = STORED) -> list[Any]:
    """Read the rows of a table; none if there is no file."""
    path = folder / kind.file
    lines = [cells for _, cells in read_csv(path, kind.form)] if path.exists() else [[]]
    kinds = [{"str": str, "int": int, "float": float}[one.type] for one in fields(kind)]
    return [kind(*(make(cell) for make, cell in zip(kinds, cells, strict=True))) for cells in lines[1:]]


def courses(rows: Iterable[Improvement] = ()) -> dict[Condition, list[np.ndarray]]:
    """Return the searches of noisy_courses.csv, or of rows of it, by condition.

    Each is an array (improvements, 4): candidate, cost as seen and without scatter [J/m], distance per step [m].
    """
    found: dict[Condition, list[np.ndarray]] = {}
    for (condition, _), each in groupby(rows or read(Improvement), key=lambda row: (row.condition, row.seed)):
        course = np.array([(row.iteration, row.seen, row.cost, row.step) for row in each])
        found.setdefault(condition, []).append(course)
    return found


def outcome(course: np.ndarray) -> tuple[float, float, int]:
    """Return the changes of cost and step by a search, and after which candidate it had converged."""
    gain, longer = course[-1, 2:] / course[0, 2:] - 1.0
    return float(gain), float(longer), converged(course[:, 0], course[:, 1])


def outcomes() -> dict[Condition, np.ndarray]:
    """Return the outcomes (searches, 3) of all stored searches by condition; of noisy_courses.csv if both have it."""
    found: dict[Condition, Any] = {}
    for row in read(End):
        found.setdefault(row.condition, []).append((row.cost, row.longer, row.converged))
    found |= {condition: [*map(outcome, each)] for condition, each in courses().items()}
    rules = [*RULES]
    order = sorted(found, key=lambda c: (PROGRAMS.index(c.program), rules.index(c.rule), c.floors, c.plan != "plain",
                                         c.step, c.states == "step", c.gearbox))  # fmt: skip
    return {condition: np.array(found[condition]) for condition in order}


def draw_convergence(found: Mapping[Condition, np.ndarray]) -> None:
    """Draw when each search of each condition had converged, medians with their 95 %, and the paper's 800 and 2600."""
    _, axes = plt.subplots(figsize=(10, 0.27 * len(found) + 0.8), layout="constrained")
    for place, (condition, values) in enumerate(found.items()):
        reached, color = values[:, 2], COLORS[condition.gearbox]
        axes.plot(reached, np.full(len(reached), place), "o", ms=4, color=color, alpha=0.35, mec="none")
        axes.plot(interval(reached), [place] * 2, color=color, lw=1)
        axes.plot(np.median(reached), place, "|", color=color, ms=11, mew=2.5)
    axes.axvline(800, color=COLORS["mipsd"], ls=":")
    axes.axvline(2600, color=COLORS["standard"], ls=":")
    axes.set_yticks(range(len(found)), map(str, found), fontsize=8)
    axes.set(xlabel="candidate after which a tenth of the gain is left", xlim=(0, 3000), ylim=(len(found) - 0.5, -0.5))


def summarize(rows: Sequence[Improvement], path: Path) -> None:
    """Write noisy_searches.csv: median and quartiles of each condition."""
    names = [name + end for name in ("gain", "longer", "converged") for end in ("", "_low", "_high")]
    header = ["program", "gearbox", "states", "rule", "noise", "searches", "iterations", *names, "p_later"]
    found = {condition: np.array([*map(outcome, each)]) for condition, each in courses(rows).items()}
    lines = []
    for c, values in found.items():
        numbers = np.quantile(values, (0.5, 0.25, 0.75), axis=0).T.ravel().tolist()
        new = found.get(replace(c, gearbox="mipsd"))
        p = "" if c.gearbox == "mipsd" or new is None else later(values[:, 2], new[:, 2])
        of = c.program, c.gearbox, c.states, c.rule, c.scatter
        lines.append((*of, len(values), rows[0].iterations, *numbers, p))
    write_csv(path, Format("search summary"), header, lines)


def main(arguments: Sequence[str] | None = None, folder: Path = STORED) -> None:
    """Make the searches that a table lacks, and write it after each."""
    tables: dict[str, Any] = {"courses": Improvement, "ends": End}
    parser = argparse.ArgumentParser(description="make the stored searches; continues where it was interrupted")
    parser.add_argument("table", choices=tables)
    parser.add_argument("--searches", type=int, default=2, help="of each condition, by the seeds 0, 1, ...")
    parser.add_argument("--iterations", type=int, default=3000)
    parser.add_argument("--only", default="", help="a regular expression: conditions whose name has it")
    args = parser.parse_args(arguments)
    kind = tables[args.table]
    rows, cases = read(kind, folder), [case for case in kind.cases if re.search(args.only, str(case))]
    there = {(row.seed, row.condition) for row in rows}
    todo = [one for one in product(range(args.searches), cases) if one not in there]
    for seed, condition in progress_bar(todo, "searches", unit="search"):
        rows += kind.make(condition, seed, args.iterations)
        rows.sort(key=lambda row: (kind.cases.index(row.condition), row.seed))
        write_csv(folder / kind.file, kind.form, [one.name for one in fields(kind)], map(astuple, rows))
    if kind is Improvement:
        summarize(rows, folder / "noisy_searches.csv")


if __name__ == "__main__":
    main()
