"""Searches whose cost scatters as the paper's does: its 14 %, 13 %, 800 and 2600 (section 5, Fig. 16), by ten seeds.

The same gait costs 3.9 % more or less from run to run with MIPSD, and 14.62 % with the older model (Fig. 11).  A search
keeps the luckiest cost as its best.  So the costs of searches are multiplied by 1 + sigma n, n normal, which depends on
the gait alone; with MIPSD sigma is 3.9 %, with the standard model 14.62 %.  The paper's four states are read as those
of a stride, and as those of a step that the other leg mirrors.  A further study makes the same searches with the update
order of the paper's program (the integrator "simtwo"); in the paper's own kind of program (`reproduction.maximal`),
where each walk scatters by itself, both at the documented 1 ms; and by other readings of the search (`search_rules`).

The courses of all searches, one row for each improvement, are kept in a table, from which Fig. 16 is drawn, and
medians and quartiles in another:

    python -m featherstone_gait.reproduction.noisy_searches TABLE.csv SUMMARY.csv PICTURE.png --searches 10

It continues where it was interrupted, and keeps the searches that the table has.  `--only "bodies and sweeps; mipsd"`
makes those whose name has both texts, `--threads 1` takes one core.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass, field, fields
from functools import cache
from itertools import groupby, product
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.files import FilePath, Format, read_csv, write_csv
from ..base.progress import progress_bar
from ..core.compile.jit import source_hash
from ..scene.compile import GearboxKind
from ..search import minimize
from ..search.speculation import Speculation
from ..view.style import COLORS, look
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
from .search_rules import CORRECTED, RULES, visits
from .sources import PACKAGE, digest
from .tables import search_history, table_arguments
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
LEAST = 5  # searches of a condition that a verdict needs: their range holds the median with 94 %
REPEATS = 5  # walks of each gait in the paper's kind of program, whose mean is its cost
TABLE, SUMMARY = Format("search courses"), Format("search summary")


@dataclass(frozen=True)
class Condition:
    """A cost to search, and how."""

    program: str = OURS
    gearbox: GearboxKind = "mipsd"
    states: States = "stride"
    rule: str = field(default=CORRECTED, repr=False)  # a key of `RULES`; histories are kept of the default alone

    @property
    def noise(self) -> float:
        """Standard deviation over the cost that is put in [-]; the paper's kind of program scatters by itself."""
        return 0.0 if self.program == PAPERS else NOISE[self.gearbox]

    def __str__(self) -> str:
        return f"{self.program}, {self.gearbox}, states of a {self.states}, {self.rule}"


UPDATES = "reduced coordinates, explicit"  # a program: the update order of the paper's, without its constraints
READINGS: tuple[States, ...] = ("stride", "step")
PUT_IN, EXPLICITLY, ITS_OWN = (
    tuple(Condition(program, gearbox, states) for states, gearbox in product(READINGS, NOISE))
    for program in (OURS, UPDATES, PAPERS)
)
OTHERWISE = tuple(Condition(rule=rule) for rule in RULES if rule != CORRECTED)
STUDY = (*PUT_IN, *EXPLICITLY, *OTHERWISE, *ITS_OWN)


@dataclass(frozen=True)
class NoisySettings:
    """Numbers of iterations and searches."""

    iterations: int  # of each search
    searches: int  # of each condition, by different seeds
    conditions: tuple[Condition, ...] = PUT_IN  # what is searched; all are in `STUDY`
    folder: str = ""  # of the searches' histories, from which they go on when interrupted; none are kept if ""
    threads: int = 0  # 0: one for each core


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
    cost: float  # without the noise, or the mean of those of further walks that do not fall [J/m]; infinite if it falls
    step: float  # distance per step [m]
    rule: str = CORRECTED

    @property
    def condition(self) -> Condition:
        return Condition(*(getattr(self, one.name) for one in fields(Condition)))


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
    rule: str
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
    p_later: float | str  # rank-sum test of converging later than MIPSD does otherwise alike; "" for MIPSD itself


@dataclass(frozen=True, eq=False)
class NoisyResult:
    iterations: int
    courses: tuple[Course, ...]

    def of(self, *what: Any) -> list[Course]:
        """Return the courses of a condition, named by its fields."""
        return [course for course in self.courses if course.condition == Condition(*what)]


def run(settings: NoisySettings = QUICK, seed: int = 0, progress: bool = False) -> NoisyResult:
    """Make all searches, seeded by `seed` and the numbers that follow."""
    rows = [row for rows in _searches(settings, range(seed, seed + settings.searches), progress) for row in rows]
    return NoisyResult(settings.iterations, tuple(_courses(rows)))


def read(path: FilePath) -> NoisyResult:
    """Read the table of a study.

    Raises FileNotFoundError for a missing file and ValueError for one that is no such table.
    """
    rows = _rows(path)
    return NoisyResult(max(row.iterations for row in rows), tuple(_courses(rows)))


def _rows(path: FilePath) -> list[Improvement]:
    lines = [cells for _, cells in read_csv(path, TABLE)]
    kinds = [{"str": str, "int": int, "float": float}[one.type] for one in fields(Improvement)]  # type: ignore[index]
    return [Improvement(*(kind(cell) for kind, cell in zip(kinds, cells))) for cells in lines[1:]]


def _courses(rows: Sequence[Improvement]) -> Iterator[Course]:
    for (condition, _), each in groupby(rows, key=lambda row: (row.condition, row.seed)):
        mine = list(each)
        columns = [np.array([getattr(row, name) for row in mine]) for name in ("iteration", "seen", "cost", "step")]
        yield Course(condition, mine[0].iterations, *columns)


def _searches(
    settings: NoisySettings, seeds: range, progress: bool, known: Sequence[Improvement] = ()
) -> Iterator[list[Improvement]]:
    """Yield the improvements of each search that is not among those known."""
    there = {(row.condition, row.seed) for row in known if row.iterations == settings.iterations}
    todo = [one for one in product(settings.conditions, seeds) if one not in there]
    for condition, each in progress_bar(todo, "searches", progress=progress, unit="search"):
        yield search(settings, condition, each)


def search(settings: NoisySettings, condition: Condition, seed: int) -> list[Improvement]:
    """Make one search, and measure each of its improvements."""
    cost, rule, n = _first(condition), RULES[condition.rule], settings.iterations
    begin, limits = cost.gait.to_vector(), bounds(cost.scene.model, cost.gait)
    threads = settings.threads or os.cpu_count() or 1
    how: dict[str, Any] = {"max_iterations": n, "no_progress": n, "bounds": limits, "seed": seed, **rule.settings}

    def evaluated(candidates: Speculation) -> float:
        return evaluate(cost, condition.noise, candidates, threads)

    if condition.rule != CORRECTED:
        history = visits(rule.search(begin, **how), evaluated)
    elif condition.program != PAPERS:
        how |= _history(settings, condition, seed)
        history = finished(minimize(None, begin, evaluate=evaluated, **how)).history
    else:
        how |= {"batch": threads, **_history(settings, condition, seed)}
        with ThreadPoolExecutor(threads) as pool:
            history = finished(minimize(lambda x: swept(cost, x)[0], begin, map=pool.map, **how)).history
    kept = np.flatnonzero(history["accepted"])
    values = _measured(cost, condition, history["x"][kept])
    of = condition.program, condition.gearbox, condition.states, seed, n
    rows = zip(kept.tolist(), history["f"][kept].tolist(), *values.T.tolist())
    return [Improvement(*of, *row, condition.rule) for row in rows]  # type: ignore[call-arg]


@cache
def _first(condition: Condition) -> WalkingCost:
    """Return the first gait; the paper's kind of program simulates the scene of its update order."""
    program = OURS if condition.program == OURS else PAPERS
    return first_gait(Program(program, condition.gearbox, states=condition.states))


def _measured(cost: WalkingCost, condition: Condition, vectors: np.ndarray) -> np.ndarray:
    """Return cost [J/m] and distance per step [m] of gaits (n, 2) without what luck has added."""
    if condition.program != PAPERS:
        return measure(cost, vectors)
    jobs = [(x, k) for x in vectors for k in range(1, REPEATS + 1)]
    walks = np.array(in_threads(lambda job: swept(cost, *job), jobs)).reshape(len(vectors), REPEATS, 2)
    sound = np.isfinite(walks[..., 0])
    falls = sound.sum(axis=1) <= REPEATS // 2
    means = np.where(sound[..., None], walks, 0.0).sum(axis=1) / np.maximum(1, sound.sum(axis=1))[:, None]
    return np.where(falls[:, None], (math.inf, math.nan), means)


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
        of = one.program, one.gearbox, one.states, one.rule, one.noise
        p = "" if one.gearbox == "mipsd" else _later(result, one.program, one.states, one.rule)
        rows.append(Summary(*of, len(courses), result.iterations, *numbers, p))  # type: ignore[call-arg]
    return rows


# ---------------------------------------------------------------------------------------------- claims


SCATTERS = {  # of each program, in the words of a claim
    OURS: "with the paper's scatter in the cost",
    UPDATES: "with that scatter and the paper's order of updates",
    PAPERS: "in the paper's kind of program, which scatters by itself",
}
Measure = Callable[["Course"], float]


def check(result: NoisyResult) -> list[Claim]:
    """Return the paper's four numbers in each program, by the rule that stands with it."""
    there = {course.condition.program for course in result.courses}
    judges = _energy, _steps, _converged, _faster
    return [judge(result, program) for program in SCATTERS if program in there for judge in judges]


def _energy(result: NoisyResult, program: str) -> Claim:
    claim = f"The search cuts the energy per distance, {SCATTERS[program]}"
    return _number(result, program, claim, "Section 5", PAPER_COST, lambda one: one.gain, "+.0%")


def _steps(result: NoisyResult, program: str) -> Claim:
    claim = f"The optimized gait takes longer steps, {SCATTERS[program]}"
    return _number(result, program, claim, "Section 5", PAPER_STEP, lambda one: one.longer, "+.0%")


def _converged(result: NoisyResult, program: str) -> Claim:
    claim = f"With MIPSD the search converges by about {PAPER_CONVERGED} iterations, {SCATTERS[program]}"
    return _number(result, program, claim, "Fig. 16", float(PAPER_CONVERGED), lambda one: float(one.converged), ".0f")


def _number(result: NoisyResult, program: str, claim: str, item: str, paper: float, of: Measure, form: str) -> Claim:
    """Judge a number of the paper with MIPSD and states of a stride; a number has no lesser verdict."""
    ours, other = ([of(one) for one in result.of(program, "mipsd", states)] for states in READINGS)
    factor, same = float(np.median(ours)) / paper, min(ours) <= paper <= max(ours)
    low, high = accepted = points(paper) if abs(paper) < 1.0 else within(FACTOR)  # a change, or a count
    put_in = f"The noise is {100.0 * NOISE['mipsd']:g} % of the cost; figures are of the gaits themselves, without it."
    means = f"Figures are means of {REPEATS} walks that the search did not see."
    why = (
        "Rule: the paper's number lies within the range of our searches and our median within "
        f"{low:.2g} to {high:.2g} times it; {PAPER_ITERATIONS} iterations of {LEAST} searches are needed. States of a "
        f"stride; with those of a step {_spread(other, form)}. {means if program == PAPERS else put_in}"
    )
    verdict = classify(same and low < factor < high, enough=_enough(result, len(ours)))
    return Claim(claim, f"{paper:{form}}", _spread(ours, form), verdict, why, item, factor, accepted)


def _faster(result: NoisyResult, program: str) -> Claim:
    """Judge "converges faster" by the rank-sum test."""
    old, new = ([one.converged for one in result.of(program, gearbox)] for gearbox in ("standard", "mipsd"))
    ratio, paper = float(np.median(old) / np.median(new)) if old else math.nan, PAPER_OLD / PAPER_CONVERGED
    p = _later(result, program)
    put_in = "" if program == PAPERS else f", with {100.0 * NOISE['standard']:g} % in its cost,"
    why = (
        f"Rule: the standard model{put_in} needs more iterations by the rank-sum test (p < {SIGNIFICANT:g}), and the "
        f"ratio of the medians is within a factor {FACTOR:g} of the paper's; in direction if the test alone says so. "
        f"{_spread(old, '.0f')} against {_spread(new, '.0f')}, p = {p:.2g}"
    )
    later, near = p < SIGNIFICANT, paper / FACTOR < ratio < paper * FACTOR
    verdict = classify(later and near, later, _enough(result, len(old), len(new)))
    claim = f"The older model needs more iterations, {SCATTERS[program]}"
    number, ours = f"{paper:.2f} times", f"{ratio:.2f} times"
    return Claim(claim, number, ours, verdict, why, "Fig. 16", ratio / paper, within(FACTOR), order=True)


def _later(result: NoisyResult, program: str, states: str = "stride", rule: str = CORRECTED) -> float:
    """Return p of the hypothesis that the standard model does not need more iterations."""
    from scipy.stats import mannwhitneyu

    old, new = (
        [course.converged for course in result.of(program, gearbox, states, rule)] for gearbox in ("standard", "mipsd")
    )
    return float(mannwhitneyu(old, new, alternative="greater").pvalue) if old and new else math.nan


def _enough(result: NoisyResult, *searches: int) -> bool:
    return result.iterations >= PAPER_ITERATIONS and min(searches) >= LEAST


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
        "Fig. 16 by several seeds: energy per distance of the best gait so far, and its distance per step, over those "
        "of the first gait; median and quartiles, without the noise. Dotted: the paper's -14 and +13 %, and its 800 "
        "and 2600 iterations.": _figure(result),
    }


def _figure(result: NoisyResult) -> Figure:
    lines: dict[str, dict[str, tuple[str, list[Course]]]] = {}  # title -> name -> color, searches
    for one in dict.fromkeys(course.condition for course in result.courses):
        other = one.rule != CORRECTED
        title = "other readings of the search, mipsd" if other else f"{one.program}, states of a {one.states}"
        name, color = (one.rule, COLORS[OTHERWISE.index(one)]) if other else (one.gearbox, SERVO_COLORS[one.gearbox])
        lines.setdefault(title, {})[name] = color, result.of(*astuple(one))
    figure, axes = subplots(10.0, 2.4 * len(lines), len(lines), 2, sharex=True, squeeze=False)
    for pair, (title, searches) in zip(axes, lines.items()):
        for name, (color, courses) in searches.items():
            label = f"{name}, {len(courses)} searches"
            _band(pair[0], result, [100.0 * (c.cost / c.cost[0] - 1.0) for c in courses], courses, color, label)
            _band(pair[1], result, [100.0 * (c.step / c.step[0] - 1.0) for c in courses], courses, color, label)
        pair[0].set_title(title, fontsize=9)
        pair[1].legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        for panel, change, name in zip(pair, (PAPER_COST, PAPER_STEP), ("energy per distance", "distance per step")):
            panel.axhline(100.0 * change, color="0.3", linestyle=":")
            panel.set_ylabel(f"{name} [%]")
            for gearbox, at in (("mipsd", PAPER_CONVERGED), ("standard", PAPER_OLD)):
                if at <= result.iterations:
                    panel.axvline(at, color=SERVO_COLORS[gearbox], linestyle=":")
    for panel in axes[-1]:
        panel.set(xlabel="iteration", xlim=(0, result.iterations))
    return figure


def _band(
    panel: Axes, result: NoisyResult, curves: list[np.ndarray], courses: list[Course], color: str, label: str
) -> None:
    """Draw median and quartiles of curves that stay until the next improvement."""
    k = np.unique(np.linspace(0, result.iterations, 301).round().astype(int))
    values = [curve[np.searchsorted(one.at, k, side="right") - 1] for curve, one in zip(curves, courses)]
    with np.errstate(invalid="ignore"):  # a gait that falls has no number, and leaves a gap
        low, middle, high = np.quantile(np.array(values), (0.25, 0.5, 0.75), axis=0)
    panel.fill_between(k, low, high, color=color, alpha=0.15)
    panel.plot(k, middle, color=color, label=label)


# ---------------------------------------------------------------------------------------------- the study


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the searches that the table does not have, one after the other, and write both tables after each."""
    title, n = "search with costs that scatter", PAPER_ITERATIONS
    how: dict[str, Any] = {"iterations": n, "searches": 10, "threads": os.cpu_count() or 1, "only": ""}
    args = table_arguments(title, arguments, "SUMMARY.csv", "PICTURE.png", **how)
    folder = str(args.table.with_suffix("")) + "_searches"
    chosen = tuple(one for one in STUDY if all(word.strip() in str(one) for word in args.only.split(";")))
    settings = NoisySettings(args.iterations, args.searches, chosen, folder, args.threads)
    rows = _rows(args.table) if args.table.exists() else []
    for each in _searches(settings, range(args.searches), True, rows):
        rows += each
        rows.sort(key=lambda row: (STUDY.index(row.condition), row.seed, row.iteration))
        write_csv(args.table, TABLE, [one.name for one in fields(Improvement)], map(astuple, rows))
    result = read(args.table)
    write_csv(args.summary, SUMMARY, [one.name for one in fields(Summary)], map(astuple, summarized(result)))
    for figure in plot(result).values():
        figure.savefig(args.picture, dpi=130)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
