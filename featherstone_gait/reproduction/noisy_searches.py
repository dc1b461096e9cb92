"""Searches whose cost scatters as the paper's does: its 14 %, 13 %, 800 and 2600 (section 5, Fig. 16), by ten seeds.

The same gait costs 3.9 % more or less from run to run with MIPSD, and 14.62 % with the older model (Fig. 11).  A search
keeps the luckiest cost as its best.  So the costs of searches are multiplied by 1 + sigma n, n normal, which depends on
the gait alone; with MIPSD sigma is 3.9 %, with the standard model 14.62 %.  The paper's four states are read as those
of a stride, and as those of a step that the other leg mirrors.  A further study searches in the paper's own kind of
program (`reproduction.maximal`) at its documented 1 ms, where each walk scatters by itself.

The courses of all searches, one row for each improvement, are kept in a table, from which Fig. 16 is drawn, and
medians and quartiles in another:

    python -m featherstone_gait.reproduction.noisy_searches TABLE.csv SUMMARY.csv PICTURE.png --searches 10

It continues where it was interrupted.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import cache
from itertools import groupby, product
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.files import FilePath, Format, read_csv
from ..base.progress import progress_bar
from ..core.compile.jit import source_hash
from ..optimize.search import AMPLITUDE, MAX_MISS
from ..scene.compile import GearboxKind
from ..search import minimize
from ..view.style import look
from ..walking.cheapest_plan import States
from ..walking.cost import WalkingCost
from ..walking.gait import bounds
from .claim import Claim, classify, within
from .common import SERVO_COLORS, in_threads, subplots
from .gait_optimization import (
    PAPER_CONVERGED,
    PAPER_COST,
    PAPER_ITERATIONS,
    PAPER_OLD,
    PAPER_STEP,
    evaluate,
    measure,
    points,
)
from .sources import PACKAGE, digest
from .tables import search_history, table_arguments, write_rows
from .walks import finished
from .what_stops import OURS, PAPERS, first_gait, swept
from .what_stops import Condition as Program

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NOISE: dict[GearboxKind, float] = {"mipsd": 0.039, "standard": 0.1462}  # Fig. 11
FACTOR = 1.5  # within which our median is the paper's number of iterations; of changes `points` says so
GAIN_LEFT = 0.1  # of the whole gain, below which a search has converged
SIGNIFICANT = 0.05  # p of the rank-sum test
REPEATS = 5  # walks of each gait in the paper's kind of program, whose mean is its cost
TABLE, SUMMARY = Format("search courses"), Format("search summary")


@dataclass(frozen=True)
class Condition:
    """A cost to search."""

    program: str = OURS
    gearbox: GearboxKind = "mipsd"
    states: States = "stride"

    @property
    def noise(self) -> float:
        """Standard deviation over the cost that is put in [-]; the paper's kind of program scatters by itself."""
        return NOISE[self.gearbox] if self.program == OURS else 0.0

    def __str__(self) -> str:
        added = f" with {100.0 * self.noise:g} %" if self.noise else ", its own scatter"
        return f"{self.gearbox}{added}, states of a {self.states}"


READINGS: tuple[States, ...] = ("stride", "step")
PUT_IN = tuple(Condition(OURS, gearbox, states) for states, gearbox in product(READINGS, NOISE))
ITS_OWN = tuple(Condition(PAPERS, gearbox) for gearbox in NOISE)


@dataclass(frozen=True)
class NoisySettings:
    """Numbers of iterations and searches."""

    iterations: int  # of each search
    searches: int  # of each condition, by different seeds
    conditions: tuple[Condition, ...] = PUT_IN  # what is searched; the study has the paper's kind of program too
    folder: str = ""  # of the searches' histories, from which they go on when interrupted; none are kept if ""


QUICK = NoisySettings(iterations=60, searches=2, conditions=PUT_IN[:2])
FULL = NoisySettings(PAPER_ITERATIONS, searches=10, folder="noisy_searches")


@dataclass(frozen=True)
class Improvement:
    """A candidate that became the best of its search."""

    program: str
    gearbox: str
    states: str
    seed: int
    iterations: int  # of the whole search
    iteration: int
    seen: float  # its cost as the search saw it [J/m]
    cost: float  # without the noise, or the mean of further walks [J/m]; infinite if it falls there
    step: float  # distance per step [m]

    @property
    def condition(self) -> Condition:
        return Condition(*(getattr(self, field.name) for field in fields(Condition)))


@dataclass(frozen=True, eq=False)
class Course:
    """The improvements of a search; its arrays are over them, the first gait included."""

    condition: Condition
    iterations: int
    at: np.ndarray  # (n,)
    seen: np.ndarray  # (n,) [J/m]
    cost: np.ndarray  # (n,) [J/m]
    step: np.ndarray  # (n,) [m]

    @property
    def gain(self) -> float:
        """Change of the energy per distance, without the noise."""
        return float(self.cost[-1] / self.cost[0] - 1.0)

    @property
    def longer(self) -> float:
        """Change of the distance per step."""
        return float(self.step[-1] / self.step[0] - 1.0)

    @property
    def converged(self) -> int:
        """Iteration from which on at most a tenth of the gain, as the search saw it, was left."""
        left = self.seen - self.seen[-1] <= GAIN_LEFT * (self.seen[0] - self.seen[-1])
        return int(self.at[np.argmax(left)])


@dataclass(frozen=True)
class Summary:
    """The searches of a condition: median and quartiles."""

    program: str
    gearbox: str
    states: str
    noise: float  # put in [-]
    searches: int
    iterations: int
    gain: float  # change of the energy per distance
    gain_low: float
    gain_high: float
    longer: float  # change of the distance per step
    longer_low: float
    longer_high: float
    converged: float  # iteration
    converged_low: float
    converged_high: float


@dataclass(frozen=True, eq=False)
class NoisyResult:
    iterations: int
    courses: tuple[Course, ...]

    def of(self, *what: Any) -> list[Course]:
        """Return the courses of a condition, named by its fields."""
        return [course for course in self.courses if course.condition == Condition(*what)]


def run(settings: NoisySettings = QUICK, seed: int = 0, progress: bool = False) -> NoisyResult:
    """Make all searches, seeded by `seed` and the numbers that follow."""
    rows = [row for rows in _searches(settings, seed, progress) for row in rows]
    return NoisyResult(settings.iterations, tuple(_courses(rows)))


def read(path: FilePath) -> NoisyResult:
    """Read the table of a study.

    Raises FileNotFoundError for a missing file and ValueError for one that is no such table.
    """
    lines = [cells for _, cells in read_csv(path, TABLE)]
    kinds = [{"str": str, "int": int, "float": float}[field.type] for field in fields(Improvement)]  # type: ignore[index]
    rows = [Improvement(*(kind(cell) for kind, cell in zip(kinds, cells))) for cells in lines[1:]]
    return NoisyResult(max(row.iterations for row in rows), tuple(_courses(rows)))


def _courses(rows: Sequence[Improvement]) -> Iterator[Course]:
    for (condition, _), each in groupby(rows, key=lambda row: (row.condition, row.seed)):
        mine = list(each)
        columns = [np.array([getattr(row, name) for row in mine]) for name in ("iteration", "seen", "cost", "step")]
        yield Course(condition, mine[0].iterations, *columns)


def _searches(settings: NoisySettings, seed: int, progress: bool) -> Iterator[list[Improvement]]:
    todo = [*product(range(seed, seed + settings.searches), settings.conditions)]
    todo.sort(key=lambda one: one[1].program == PAPERS)  # which take ten times as long
    for each, condition in progress_bar(todo, "searches", progress=progress, unit="search"):
        yield search(settings, condition, each)


def search(settings: NoisySettings, condition: Condition, seed: int) -> list[Improvement]:
    """Make one search, and measure each of its improvements."""
    cost = _first(condition)
    n, how = settings.iterations, _history(settings, condition, seed)
    how |= {"seed": seed, "amplitude": AMPLITUDE, "max_miss": MAX_MISS, "max_iterations": n, "no_progress": n}
    begin, limits = cost.gait.to_vector(), bounds(cost.scene.model, cost.gait)
    if condition.program == OURS:
        found = minimize(None, begin, bounds=limits, evaluate=lambda x: evaluate(cost, condition.noise, x), **how)
    else:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            how |= {"map": pool.map, "batch": os.cpu_count() or 1}
            found = minimize(lambda x: swept(cost, x)[0], begin, bounds=limits, **how)
    history = finished(found).history
    kept = np.flatnonzero(history["accepted"])
    values = _measured(cost, condition, history["x"][kept])
    of = condition.program, condition.gearbox, condition.states, seed, n
    rows = zip(kept.tolist(), history["f"][kept].tolist(), *values.T.tolist())
    return [Improvement(*of, *row) for row in rows]


@cache
def _first(condition: Condition) -> WalkingCost:
    return first_gait(Program(condition.program, condition.gearbox, states=condition.states))


def _measured(cost: WalkingCost, condition: Condition, vectors: np.ndarray) -> np.ndarray:
    """Return cost [J/m] and distance per step [m] of gaits (n, 2) without what luck has added."""
    if condition.program == OURS:
        return measure(cost, vectors)
    jobs = [(x, k) for x in vectors for k in range(1, REPEATS + 1)]
    walks = np.array(in_threads(lambda job: swept(cost, *job), jobs)).reshape(len(vectors), REPEATS, 2)
    return walks.mean(axis=1)


def _history(settings: NoisySettings, condition: Condition, seed: int) -> dict[str, Any]:
    """Return where a search is stored; another program has other files."""
    program = (
        source_hash(),
        digest(PACKAGE / "reproduction/maximal/__init__.py"),
        digest(PACKAGE / "search/annealing.py"),
    )
    return search_history(settings.folder, f"{condition!r}\n{settings.iterations}\n{program}", seed)


def summarized(result: NoisyResult) -> list[Summary]:
    """Return a row for each condition that was searched, in their order."""
    rows = []
    for one in dict.fromkeys(course.condition for course in result.courses):
        courses = [course for course in result.courses if course.condition == one]
        values = [(course.gain, course.longer, course.converged) for course in courses]
        numbers = np.quantile(values, (0.5, 0.25, 0.75), axis=0).T.ravel().tolist()
        of = one.program, one.gearbox, one.states, one.noise
        rows.append(Summary(*of, len(courses), result.iterations, *numbers))
    return rows


# ---------------------------------------------------------------------------------------------- claims


def check(result: NoisyResult) -> list[Claim]:
    """Return the paper's four numbers, each by the rule that stands with it; a number has no lesser verdict."""
    return [_energy(result), _steps(result), _converged(result), _faster(result)]


def _energy(result: NoisyResult) -> Claim:
    gains = np.array([course.gain for course in result.of()])
    claim = "The search cuts the energy per distance, with the paper's scatter in its cost"
    return _number(result, claim, "Section 5", PAPER_COST, gains, [one.gain for one in result.of(*_STEP)], "+.0%")


def _steps(result: NoisyResult) -> Claim:
    longer = np.array([course.longer for course in result.of()])
    claim = "The optimized gait takes longer steps, with the paper's scatter in the cost"
    return _number(result, claim, "Section 5", PAPER_STEP, longer, [one.longer for one in result.of(*_STEP)], "+.0%")


def _converged(result: NoisyResult) -> Claim:
    ours = np.array([float(course.converged) for course in result.of()])
    claim = "With MIPSD the search converges by about 800 iterations, with the paper's scatter in the cost"
    other = [float(course.converged) for course in result.of(*_STEP)]
    return _number(result, claim, "Fig. 16", float(PAPER_CONVERGED), ours, other, ".0f")


_STEP = (OURS, "mipsd", "step")


def _number(
    result: NoisyResult, claim: str, item: str, paper: float, ours: np.ndarray, other: list[float], form: str
) -> Claim:
    """Judge a number of the paper with MIPSD and states of a stride; other: the same with states of a step."""
    factor, same = float(np.median(ours)) / paper, bool(ours.min() <= paper <= ours.max())
    low, high = accepted = points(paper) if abs(paper) < 1.0 else within(FACTOR)  # a change, or a count
    why = (
        "Rule: the paper's number lies within the range of our searches and our median within "
        f"{low:.2g} to {high:.2g} times it; {PAPER_ITERATIONS} iterations are needed. States of a stride; with those "
        f"of a step {_spread(other, form)}. The noise is {100.0 * NOISE['mipsd']:g} % of the cost; figures are of the "
        "gaits themselves, without it."
    )
    verdict = classify(same and low < factor < high, enough=_enough(result))
    return Claim(claim, f"{paper:{form}}", _spread(ours, form), verdict, why, item, factor, accepted)


def _faster(result: NoisyResult) -> Claim:
    """Return the claim by the rank-sum test, in each program."""
    tests = {str(program): _rank_sum(result, program) for program in (OURS, PAPERS)}
    words = "; ".join(f"{program}: {one}" for program, one in tests.items() if one)
    old, new = (float(np.median([c.converged for c in result.of(OURS, g)])) for g in ("standard", "mipsd"))
    why = (
        f"Rule: the standard model, with {100.0 * NOISE['standard']:g} % in its cost, needs more iterations by the "
        f"rank-sum test (p < {SIGNIFICANT:g}), and the ratio of the medians is within a factor {FACTOR:g} of the "
        f"paper's; in direction if the test alone says so. {words}."
    )
    paper = PAPER_OLD / PAPER_CONVERGED
    later = _later(result, OURS) < SIGNIFICANT
    verdict = classify(later and paper / FACTOR < old / new < paper * FACTOR, later, _enough(result))
    claim = "The older model needs more iterations, with the paper's scatter in the costs"
    number, ours, factor = f"{paper:.2f} times", f"{old / new:.2f} times", old / new / paper
    return Claim(claim, number, ours, verdict, why, "Fig. 16", factor, within(FACTOR), order=True)


def _later(result: NoisyResult, program: str) -> float:
    """Return p of the hypothesis that the standard model does not need more iterations."""
    from scipy.stats import mannwhitneyu

    old, new = ([course.converged for course in result.of(program, gearbox)] for gearbox in ("standard", "mipsd"))
    return float(mannwhitneyu(old, new, alternative="greater").pvalue) if old and new else math.nan


def _rank_sum(result: NoisyResult, program: str) -> str:
    p = _later(result, program)
    if math.isnan(p):
        return ""
    old, new = (np.median([one.converged for one in result.of(program, gearbox)]) for gearbox in ("standard", "mipsd"))
    return f"{old:.0f} against {new:.0f}, p = {p:.2g}"


def _enough(result: NoisyResult) -> bool:
    return result.iterations >= PAPER_ITERATIONS


def _spread(values: Sequence[float] | np.ndarray, form: str) -> str:
    """Return the median and the range of finite values, and how many are not finite."""
    finite = [x for x in values if math.isfinite(x)]
    if not finite:
        return "none" if not len(values) else "all fall"
    text = f"{np.median(finite):{form}} ({min(finite):{form}} to {max(finite):{form}}; {len(finite)} searches)"
    return text + (f", {len(values) - len(finite)} fall" if len(finite) < len(values) else "")


# ---------------------------------------------------------------------------------------------- figures


@look()
def plot(result: NoisyResult) -> dict[str, Figure]:
    """Draw Fig. 16: median and spread of the best gait so far."""
    return {
        "Fig. 16 with ten seeds: energy per distance of the best gait so far, and its distance per step, over those of "
        "the first gait; median and quartiles, without the noise. Dotted: the paper's numbers.": _figure(result),
    }


def _figure(result: NoisyResult) -> Figure:
    shown = [condition for condition in (*PUT_IN, *ITS_OWN) if any(c.condition == condition for c in result.courses)]
    rows = list(dict.fromkeys((condition.program, condition.states) for condition in shown))
    figure, axes = subplots(9.0, 2.6 * len(rows), len(rows), 2, sharex=True, squeeze=False)
    for pair, (program, states) in zip(axes, rows):
        for gearbox in NOISE:
            courses = [c for c in result.courses if c.condition == Condition(program, gearbox, states)]
            if courses:
                _band(pair[0], result, [100.0 * (c.cost / c.cost[0] - 1.0) for c in courses], courses, gearbox)
                _band(pair[1], result, [100.0 * (c.step / c.step[0] - 1.0) for c in courses], courses, gearbox)
        pair[0].set_title(f"{program}, states of a {states}", fontsize=9)
        for panel, change, name in zip(pair, (PAPER_COST, PAPER_STEP), ("energy per distance", "distance per step")):
            panel.axhline(100.0 * change, color="0.3", linestyle=":")
            panel.set_ylabel(f"{name} [%]")
            for gearbox, at in (("mipsd", PAPER_CONVERGED), ("standard", PAPER_OLD)):
                if at <= result.iterations:
                    panel.axvline(at, color=SERVO_COLORS[gearbox], linestyle=":")
    for panel in axes[-1]:
        panel.set(xlabel="iteration", xlim=(0, result.iterations))
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _band(panel: Axes, result: NoisyResult, curves: list[np.ndarray], courses: list[Course], gearbox: str) -> None:
    """Draw median and quartiles of curves that stay until the next improvement."""
    k = np.unique(np.linspace(0, result.iterations, 301).round().astype(int))
    values = [curve[np.searchsorted(one.at, k, side="right") - 1] for curve, one in zip(curves, courses)]
    low, middle, high = np.quantile(np.array(values), (0.25, 0.5, 0.75), axis=0)
    panel.fill_between(k, low, high, color=SERVO_COLORS[gearbox], alpha=0.15)
    panel.plot(k, middle, color=SERVO_COLORS[gearbox], label=gearbox)


# ---------------------------------------------------------------------------------------------- the study


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the searches one after the other, and write the table after each."""
    title, n = "search with costs that scatter", PAPER_ITERATIONS
    args = table_arguments(title, arguments, "SUMMARY.csv", "PICTURE.png", iterations=n, searches=10)
    folder = str(args.table.with_suffix("")) + "_searches"
    settings = NoisySettings(args.iterations, args.searches, (*PUT_IN, *ITS_OWN), folder)
    rows: list[Improvement] = []
    for each in _searches(settings, 0, progress=True):
        rows += each
        write_rows(args.table, TABLE, rows, __file__)
        result = NoisyResult(args.iterations, tuple(_courses(rows)))
        write_rows(args.summary, SUMMARY, summarized(result), __file__)
    for figure in plot(result).values():
        figure.savefig(args.picture, dpi=130)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
