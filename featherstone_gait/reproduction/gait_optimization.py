"""The gait optimized by adaptive simulated annealing (Lima et al. 2013, section 5, Figs. 14 to 16).

Forty joint angles, four poses of ten joints, start from a walk planned by preview control of the zero moment point.
The search minimizes the energy per distance.  The paper reports one search of 3000 iterations: 14 % less energy per
distance, steps 13 % longer, converged after 800 iterations, where an older model needed more than 2600: that of another
paper, its reference [17], of which only this number is known; the standard model stands in for it.

One run of a random method proves little, so there are several searches of each kind.  The two models of the paper
differ in more than their gearbox: the older one chatters, so its cost is noisy.  The kinds of searches are

- `mipsd` (motor inertia plus spring-damper) and `standard`, both integrated implicitly and without noise;
- `standard, explicit`: in the update order of the paper's program, in which it chatters.  The same gait always costs
  the same, but neighboring gaits differ at random, and a search that evaluates no gait twice sees only this;
- `mipsd, 3.9 % noise` and `standard, 14.62 % noise`: the implicit costs times 1 + sigma n with n normal, sigma being
  the repeatability that the paper gives for the two models.  n depends on the gait alone.

The paper does not state the width of the perturbations, the number of measured strides and the treatment of falls;
these are those of `featherstone_gait.optimize`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..base.progress import progress_bar
from ..core.compile.jit import source_hash
from ..core.effects.energies import METER
from ..model import Ground, Model
from ..optimize.search import AMPLITUDE, MAX_MISS
from ..run.reference import Reference
from ..run.simulate import Push, simulate_stream, standing_state
from ..run.trajectory import Trajectory
from ..scene.compile import GearboxKind
from ..search import minimize
from ..search.speculation import Candidate, Speculation
from ..view.page import page_html
from ..view.plotting import plot_motion
from ..view.recorded import Seen
from ..view.style import BLUE, ORANGE, look
from ..view.style import COLORS as STYLE
from ..walking.cost import LEAST_SPEED, WalkingCost
from ..walking.gait import TICK, bounds
from .claim import Claim, classify, question, within
from .common import EXPLICIT, draw_band, draw_marks, subplots
from .tables import search_history
from .walks import finished, planned_walk, recompiled

PAPER_CONVERGED, PAPER_OLD, PAPER_COST, PAPER_STEP = 800, 2600, -0.14, 0.13
SHOWN = 3  # strides that are played
FACTOR, POINTS = 1.5, 0.05  # within which iterations and changes count as the same
PAPER_ITERATIONS = 3000


@dataclass(frozen=True)
class Condition:
    """A cost to search."""

    gearbox: GearboxKind = "mipsd"
    integrator: str = "midpoint"
    noise: float = 0.0  # standard deviation over the cost

    def __str__(self) -> str:
        noise = f", {100.0 * self.noise:g} % noise" if self.noise else ""
        return self.gearbox + (", explicit" if self.integrator == EXPLICIT else "") + noise


MIPSD, STANDARD, CHATTER = Condition(), Condition("standard"), Condition("standard", EXPLICIT)
MIPSD_NOISY, STANDARD_NOISY = Condition(noise=0.039), Condition("standard", noise=0.1462)
CONDITIONS = (MIPSD, STANDARD, CHATTER, MIPSD_NOISY, STANDARD_NOISY)


@dataclass(frozen=True)
class GaitSearchSettings:
    """Numbers of iterations and searches."""

    iterations: int  # of each search; the paper's 3000 at full size
    searches: int  # with mipsd and with standard; within the range of six lies the median with 97 %
    noisy_searches: int  # of each of the other three kinds
    points: int = 50  # iterations at which the best so far is measured again
    amplitude: float = AMPLITUDE  # of the perturbations [rad]
    rtol: float = 0.0  # of the reference, with error control; 0: a quarter of the step, which is 0.3 % off at the start
    folder: str = ""  # of the searches' histories, from which they go on when interrupted; none are kept if ""


QUICK = GaitSearchSettings(iterations=100, searches=2, noisy_searches=1, points=11)
FULL = GaitSearchSettings(
    PAPER_ITERATIONS, searches=6, noisy_searches=2, rtol=1e-6, folder="gait_optimization_searches"
)

DEFINITIONS = {  # of convergence: the first iteration from which on the best is within this of the last best
    "1 % of the final cost": lambda best: 0.01 * best[-1],
    "5 % of the final cost": lambda best: 0.05 * best[-1],
    "1 % of the gain": lambda best: 0.01 * (best[0] - best[-1]),
    "10 % of the gain": lambda best: 0.1 * (best[0] - best[-1]),
    "last improvement": lambda _: 0.0,
}
DEFINITION = "1 % of the final cost"


@dataclass(frozen=True, eq=False)
class GaitSearch:
    """A search; its arrays are over iterations, all or those `at`, starting with the planned gait."""

    condition: Condition
    seed: int
    best: np.ndarray  # (iterations + 1,) least cost so far, as the search sees it [J/m]
    at: np.ndarray  # (points,) iterations
    cost: np.ndarray  # (points,) cost of the best so far without the noise put in [J/m]
    step: np.ndarray  # (points,) its distance per step [m]
    x: np.ndarray  # (40,) the gait found [rad]

    def converged(self, definition: str = DEFINITION) -> int:
        """Return the iteration of convergence, see `DEFINITIONS`."""
        return int(np.argmax(self.best - self.best[-1] <= DEFINITIONS[definition](self.best)))

    @property
    def gain(self) -> float:
        """Change of the energy per distance."""
        return self.cost[-1] / self.cost[0] - 1.0

    @property
    def longer(self) -> float:
        """Change of the distance per step."""
        return self.step[-1] / self.step[0] - 1.0


@dataclass(frozen=True, eq=False)
class GaitSearchResult:
    """Searches, and the costs [J/m] of the planned gait and of the gaits found under each of `EVALUATIONS`."""

    settings: GaitSearchSettings
    searches: tuple[GaitSearch, ...]
    first: dict[str, float]
    found: dict[str, np.ndarray]  # (searches,); infinite where it falls
    model: Model
    strides: tuple[Trajectory, Trajectory]  # with MIPSD: `SHOWN` of the planned gait, and of the cheapest one found

    def of(self, condition: Condition) -> list[GaitSearch]:
        return [search for search in self.searches if search.condition == condition]

    def converged(self, condition: Condition, definition: str = DEFINITION) -> np.ndarray:
        return np.array([search.converged(definition) for search in self.of(condition)])

    def gains(self, condition: Condition, evaluation: str) -> np.ndarray:
        """Return the change of cost of the gaits found with a condition under an evaluation; infinite if they fall."""
        mine = [search.condition == condition for search in self.searches]
        return self.found[evaluation][mine] / self.first[evaluation] - 1.0


EVALUATIONS = {  # what is simulated, and whether as the reference is
    "mipsd": (MIPSD, False),
    "standard": (STANDARD, False),
    "standard, explicit": (CHATTER, False),
    "mipsd, reference": (MIPSD, True),
    "standard, reference": (STANDARD, True),
}


def run(settings: GaitSearchSettings = QUICK, seed: int = 0, progress: bool = False) -> GaitSearchResult:
    """Make all searches, seeded by `seed` and the numbers that follow, and evaluate the gaits found."""
    counts = [settings.searches if c in (MIPSD, STANDARD) else settings.noisy_searches for c in CONDITIONS]
    todo = [(condition, seed + k) for condition, count in zip(CONDITIONS, counts) for k in range(count)]
    bar = progress_bar(todo, "searches", progress=progress, unit="search")
    planned = planned_walk()
    searches = tuple(_search(settings, planned, condition, each) for condition, each in bar)
    first, found = {}, {}
    for name, (condition, reference) in EVALUATIONS.items():
        fine = reference and not settings.rtol
        cost = cost_of(planned, condition, 2.5e-4 if fine else 1e-3)
        rtol = settings.rtol if reference and settings.rtol else None
        measured = measure(cost, [cost.gait.to_vector(), *(search.x for search in searches)], rtol)
        first[name], found[name] = measured[0, 0], measured[1:, 0]
    best = min((search for search in searches if search.condition == MIPSD), key=lambda search: search.best[-1])
    before, after = planned.simulate([planned.gait.to_vector(), best.x, best.x])[:2]
    strides = _strides(planned, before), _strides(planned, after)
    return GaitSearchResult(settings, searches, first, found, planned.scene.model, strides)


def _strides(cost: WalkingCost, run: Trajectory) -> Trajectory:
    """Return the first measured strides of a run."""
    time = run["time"]
    rows = (time > cost.mark - 1e-9) & (time < cost.mark + SHOWN * cost.gait.period + 1e-9)
    return _rows(run, rows)


def _rows(run: Trajectory, rows: Any) -> Trajectory:
    return replace(run, channels={name: run[name][rows] for name in ("time", "base_q", "q", "contact_force")})


def cost_of(planned: WalkingCost, condition: Condition, timestep: float = 1e-3) -> WalkingCost:
    """Return the cost of a gait under a condition, without the noise."""
    return recompiled(planned, gearbox=condition.gearbox, integrator=condition.integrator, timestep=timestep)


def measure(
    cost: WalkingCost, vectors: Iterable[np.ndarray], rtol: float | None = None, pushes: Sequence[Push] = ()
) -> np.ndarray:
    """Return energy per distance [J/m] and distance per step [m] of gaits (n, 2); infinite and NaN if they fall.

    Unlike `WalkingCost.measure` it takes a run that chatters as it is.
    """
    runs = cost.simulate(vectors, record_interval=TICK, record=("base_q", "energy"), pushes=pushes, rtol=rtol)
    return np.array([measured(cost, run) for run in runs])


def measured(cost: WalkingCost, run: Trajectory) -> tuple[float, float]:
    """Return energy per distance [J/m] and distance per step [m] of a run; infinite and NaN if it falls."""
    first, last = (round(t / TICK) for t in (cost.mark, cost.end))
    before, after = run["energy"][[first, last], :, METER].sum(axis=1)
    start, end = run["base_q"][[first, last], 0]
    if run.status not in ("ok", "chatter") or end - start < LEAST_SPEED * (last - first) * TICK:
        return math.inf, math.nan
    return (after - before) / (end - start), (end - start) / (2.0 * cost.strides)


def _search(settings: GaitSearchSettings, planned: WalkingCost, condition: Condition, seed: int) -> GaitSearch:
    cost = cost_of(planned, condition)
    n = settings.iterations
    result = finished(minimize(
        None, cost.gait.to_vector(), amplitude=settings.amplitude, max_miss=MAX_MISS, max_iterations=n, no_progress=n,
        bounds=bounds(cost.scene.model, cost.gait), seed=seed, **_history(settings, cost, condition, seed),
        evaluate=lambda candidates: evaluate(cost, condition.noise, candidates),
    ))  # fmt: skip
    accepted = np.flatnonzero(result.history["accepted"])
    latest = accepted[np.cumsum(result.history["accepted"]) - 1]
    at = np.unique(np.linspace(0, n, settings.points).round().astype(int))
    kept, places = np.unique(latest[at], return_inverse=True)
    found, steps = measure(cost, result.history["x"][kept])[places].T
    return GaitSearch(condition, seed, result.history["f"][latest], at, found, steps, result.x)


def evaluate(cost: WalkingCost, noise: float, candidates: Speculation, threads: int | None = None) -> float:
    """Evaluate the candidates of a search, with noise that depends on the final state of a run."""
    state = standing_state(cost.scene, cost.start[0])

    def begin(candidate: Candidate) -> tuple[np.ndarray, Reference]:
        return state, cost.reference(candidate.x, cost.warm_up + cost.strides)

    def end(run: Trajectory) -> tuple[float, str]:
        seed = int.from_bytes(hashlib.sha256(run.final.tobytes()).digest()[:8], "little")
        factor = 1.0 + noise * np.random.default_rng(seed).standard_normal()
        return float(measured(cost, run)[0] * factor), run.status

    return simulate_stream(cost.scene, cost.end, candidates, begin, end, ("base_q", "energy"), TICK, threads)


def _history(settings: GaitSearchSettings, cost: WalkingCost, condition: Condition, seed: int) -> dict:
    """Return where the search is stored; another program or robot has other files."""
    model = replace(cost.scene.model, notes=(), source="")
    what = f"{model!r}\n{condition!r}\n{settings.amplitude}\n{cost.mark} {cost.strides}\n{source_hash()}"
    return search_history(settings.folder, what, seed)


# ---------------------------------------------------------------------------------------------- claims


def check(result: GaitSearchResult) -> list[Claim]:
    """Return the claims of section 5 of the paper, and how far its conclusions hold."""
    claims = (_converged, _faster, _signs, _cost, _step, _noise, _survives)
    return [claim(result) for claim in claims]


def _converged(result: GaitSearchResult) -> Claim:
    """Return the claim: reproduced if the median lies within the factor of the paper's."""
    ours = result.converged(MIPSD)
    sensitivity = "; ".join(f"{name}: {_quartiles(result.converged(MIPSD, name))}" for name in DEFINITIONS)
    near = PAPER_CONVERGED / FACTOR < np.median(ours) < PAPER_CONVERGED * FACTOR
    enough = result.settings.iterations >= PAPER_OLD
    early = min(PAPER_CONVERGED, result.settings.iterations)
    share = [(s.best[0] - s.best[early]) / (s.best[0] - s.best[-1]) for s in result.of(MIPSD)]
    return Claim(
        claim="With MIPSD the search converges by about 800 iterations",
        item="Fig. 16",
        factor=float(np.median(ours)) / PAPER_CONVERGED if enough else None,
        accepted=within(FACTOR) if enough else None,
        paper=f"{PAPER_CONVERGED} of {PAPER_ITERATIONS}, one search",
        ours=f"{_quartiles(ours)} of {result.settings.iterations}, median and quartiles of {len(ours)} searches",
        verdict=classify(bool(near), enough=enough),
        why=f"Rule: median within a factor {FACTOR:g}. Converged means: the first iteration whose best is within "
        f"{DEFINITION} of the last. The number depends on this definition: {sensitivity}. At iteration {early} "
        f"{np.median(share):.0%} of the gain has been reached{_short(result)}",
    )


def _faster(result: GaitSearchResult) -> Claim:
    """Return the claim: reproduced if quartiles do not overlap and the ratio is within the factor."""
    new, old = result.converged(MIPSD), result.converged(STANDARD)
    ratio, paper = float(np.median(old) / np.median(new)), PAPER_OLD / PAPER_CONVERGED
    apart = bool(np.quantile(new, 0.75) < np.quantile(old, 0.25))
    near, enough = paper / FACTOR < ratio < paper * FACTOR, result.settings.iterations >= PAPER_OLD
    others = "; ".join(
        f"{name}: {_median(result.converged(STANDARD, name))} against {_median(result.converged(MIPSD, name))}"
        for name in DEFINITIONS
    )
    return Claim(
        claim="The older model needs more iterations",
        item="Fig. 16",
        factor=ratio / paper if enough else None,
        accepted=within(FACTOR) if enough else None,
        order=True,
        paper=f"more than {PAPER_OLD} against {PAPER_CONVERGED}, {paper:.2f} times",
        ours=f"{_quartiles(old)} against {_quartiles(new)}, {ratio:.2f} times",
        verdict=classify(apart and near, apart, enough),
        why=f"Rule: quartiles do not overlap and the ratio is within a factor {FACTOR:g}; in direction if they do not "
        "overlap. Both models are integrated implicitly, without noise. Medians of standard against MIPSD by "
        f"definition: {others}{_short(result)}",
    )


def _noise(result: GaitSearchResult) -> Claim:
    """Return the claim: reproduced if both kinds of noise worsen the standard model's searches."""
    clean = [search.gain for search in result.of(STANDARD)]
    lines, worse = [], []
    for condition in (CHATTER, MIPSD_NOISY, STANDARD_NOISY):
        searches = result.of(condition)
        gains = [search.gain for search in searches]
        seen = np.median([search.best[-1] / search.cost[0] - 1.0 for search in searches])
        evaluation = "mipsd" if condition.gearbox == "mipsd" else "standard"
        true = np.median(result.gains(condition, evaluation))
        lines.append(
            f"{condition}: converged {_median(result.converged(condition))}, gain {np.median(gains):+.0%} (as the "
            f"search saw it {seen:+.0%}; with the implicit {evaluation} model {true:+.0%})"
        )
        if condition != MIPSD_NOISY:
            worse.append(min(result.gains(condition, "standard")) > max(clean))
    return question(
        claim="A noisy cost makes the older model's search slow or poor",
        ours="; ".join(lines),
        verdict=classify(all(worse), any(worse)),
        why="Rule: every gait found with chatter, and with the noise of the paper's 14.62 %, is worse under the "
        f"noise-free standard model than every one found without noise ({min(clean):+.0%} to {max(clean):+.0%}); in "
        "direction if one kind is. The search keeps the luckiest cost as its best, and every later candidate is "
        f"compared with it{_short(result)}",
    )


def _signs(result: GaitSearchResult) -> Claim:
    """Return the claim: reproduced if both signs are the paper's in every search."""
    found = result.of(MIPSD)
    both = [search.gain < 0.0 < search.longer for search in found]
    return Claim(
        claim="The optimized gait needs less energy per distance and takes longer steps",
        item="Section 5",
        paper="less, longer",
        ours=f"both in {sum(both)} of {len(both)} searches",
        order=True,
        verdict=classify(all(both)),
        why="Rule: both in every search. By how much is the matter of the next two statements",
    )


def _cost(result: GaitSearchResult) -> Claim:
    """Return the claim: reproduced if the median gain is within the points."""
    gains = np.array([search.gain for search in result.of(MIPSD)])
    near = abs(np.median(gains) - PAPER_COST) < POINTS
    reached = [int(np.argmax(s.best <= (1.0 + PAPER_COST) * s.best[0])) for s in result.of(MIPSD)]
    costs = [search.cost[-1] for search in result.of(MIPSD)]
    mine = [search.condition == MIPSD for search in result.searches]
    exact, coarse = (np.append(result.first[e], result.found[e][mine]) for e in ("mipsd, reference", "mipsd"))
    off = exact / coarse - 1.0
    return Claim(
        claim="How much energy per distance the search saves",
        item="Section 5",
        factor=float(np.median(gains)) / PAPER_COST,
        accepted=points(PAPER_COST),
        paper=f"{PAPER_COST:.0%}",
        ours=f"{_percents(gains)} over {len(gains)} searches, from {result.first['mipsd']:.1f} to "
        f"{min(costs):.1f} ... {max(costs):.1f} J/m; standard {_percents([s.gain for s in result.of(STANDARD)])}",
        verdict=classify(near),
        why=f"Rule: median within {100 * POINTS:g} points. The paper's 14 % are "
        f"reached after {_median(reached)} iterations. The possible gain depends on the first gait; the paper only "
        f"says that it comes from a pattern generator. Error of the costs: the reference gives {min(off):+.1%} to "
        f"{max(off):+.1%}",
    )


def _step(result: GaitSearchResult) -> Claim:
    """Return the claim: reproduced if the median change is within the points."""
    longer = np.array([search.longer for search in result.of(MIPSD)])
    near = abs(np.median(longer) - PAPER_STEP) < POINTS
    steps = 1e3 * np.array([search.step[[0, -1]] for search in result.of(MIPSD)])
    return Claim(
        claim="How much longer the steps of the optimized gait are",
        item="Section 5",
        factor=float(np.median(longer)) / PAPER_STEP,
        accepted=points(PAPER_STEP),
        paper=f"{PAPER_STEP:+.0%}",
        ours=f"{_percents(longer)}, from {steps[0, 0]:.1f} to {steps[:, 1].min():.1f} ... {steps[:, 1].max():.1f} mm; "
        f"standard {_percents([s.longer for s in result.of(STANDARD)])}",
        verdict=classify(near),
        why=f"Rule: median within {100 * POINTS:g} points",
    )


def points(paper: float) -> tuple[float, float]:
    """Return the factors of a change between which it is accepted: `POINTS` on either side."""
    return 1.0 - POINTS / abs(paper), 1.0 + POINTS / abs(paper)


def _survives(result: GaitSearchResult) -> Claim:
    """Return the claim: reproduced if every gait keeps half its gain under the other model and the reference."""
    rtol = result.settings.rtol
    accuracy = f"error control, {rtol:g} a step" if rtol else "a quarter of the step"
    kept, lines = [], []
    for condition, other in ((MIPSD, "standard"), (STANDARD, "mipsd")):
        own = result.gains(condition, str(condition))
        for evaluation in (other, f"{condition}, reference"):
            gains = result.gains(condition, evaluation)
            kept += list(gains <= 0.5 * own)
            lines.append(f"found with {condition} ({_percents(own)}), under {evaluation}: {_percents(gains)}")
    return question(
        claim="A gain under one model is also a gain under the other, and at higher accuracy",
        ours=f"{sum(kept)} of {len(kept)} evaluations keep half the gain",
        verdict=classify(all(kept), np.mean(kept) > 0.5),
        why="Rule: all keep half; in direction if most do. " + "; ".join(lines) + f". Reference: {accuracy}",
    )


def _short(result: GaitSearchResult) -> str:
    n = result.settings.iterations
    return (
        f". Undecided at this size: {n} iterations are fewer than the paper's {PAPER_OLD}; run with --full"
        if n < PAPER_OLD
        else ""
    )


def _median(values: Sequence[float] | np.ndarray) -> str:
    return f"{np.median(values):.0f}"


def _quartiles(values: Sequence[float] | np.ndarray) -> str:
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
    return f"{middle:.0f} ({low:.0f} to {high:.0f})"


def _percents(values: Collection[float]) -> str:
    """Return median and range; a fall counts as an infinite cost."""
    finite = [x for x in values if math.isfinite(x)]
    falls = len(values) - len(finite)
    if falls > len(finite):
        return f"{falls} of {len(values)} fall"
    text = f"{np.median(finite):+.0%} ({min(finite):+.0%} to {max(finite):+.0%})"
    return text + (f", {falls} of {len(values)} fall" if falls else "")


# ---------------------------------------------------------------------------------------------- figures

COLORS = dict(zip(CONDITIONS, (BLUE, ORANGE, STYLE[3], STYLE[4], STYLE[5])))


@look()
def plot(result: GaitSearchResult) -> dict[str, Figure]:
    """Draw Figs. 15 and 16 with their spread, convergence by definition, and costs under other models."""
    return {
        "A stride of the planned gait and of the cheapest found with MIPSD, dark to light, as in Fig. 15.":
            _snapshots(result),
        "Energy per distance of the best gait so far, and its distance per step, as in Fig. 16: median and range of "
        "the searches (without the added noise). Dotted: the paper's 14 % and 13 %.": _progress(result),
        "Iterations until convergence, by definition; each mark is a search. Dotted: the paper's 800 and 2600.":
            _convergence(result),
        "Energy per distance of the gaits found with one model under the others, over that of the planned gait there; "
        "marks at the top edge fall.": _cross(result),
    }  # fmt: skip


def animate(result: GaitSearchResult) -> dict[str, str]:
    """Return pages that play the same strides, by caption."""
    runs = {}
    for run, name in zip(result.strides, ("planned", "found")):
        way = np.array(run["base_q"])
        way[:, 0] -= way[0, 0]
        still = replace(run, channels={**run.channels, "base_q": way, "time": run["time"] - run["time"][0]})
        runs[name] = Seen(result.model, still, Ground())
    caption = f"{SHOWN} strides of the planned gait and of the cheapest found with MIPSD."
    return {caption: page_html(runs, "planned and found")}


def _snapshots(result: GaitSearchResult) -> Figure:
    figure, panels = subplots(9.0, 4.6, 1, 2)
    for axes, run, name in zip(panels, result.strides, ("planned", "found")):
        stride = _rows(run, slice(len(run["time"]) // SHOWN + 1))
        from_start = stride["base_q"] - np.eye(7)[0] * stride["base_q"][0, 0]
        plot_motion(result.model, replace(stride, channels={**stride.channels, "base_q": from_start}), axes, count=5)
        axes.locator_params(axis="x", nbins=5)
        axes.set_title(f"{name}, {1e3 * from_start[-1, 0]:.0f} mm")
    return figure


def _progress(result: GaitSearchResult) -> Figure:
    figure, panels = subplots(10.0, 4.2, 1, 2)
    for condition in CONDITIONS:
        searches = result.of(condition)
        for axes, curves in zip(panels, ([s.cost for s in searches], [1e3 * s.step for s in searches])):
            k = searches[0].at
            draw_band(axes, k, curves, COLORS[condition], str(condition))
    first = result.of(MIPSD)[0]
    papers = {PAPER_COST: first.cost[0], PAPER_STEP: 1e3 * first.step[0]}
    for axes, (change, planned), end in zip(panels, papers.items(), ("right", "left")):  # where no curve is near
        value = planned * (1 + change)
        axes.axhline(value, color=COLORS[MIPSD], linestyle=":", linewidth=1.2)
        axes.annotate(
            f"paper {100 * change:+.0f} %", (float(end == "right"), value), ha=end, color=COLORS[MIPSD], fontsize=7.5,
            xycoords=axes.get_yaxis_transform(), xytext=(0, 2), textcoords="offset points",
        )  # fmt: skip
        axes.set(xlabel="iteration", xlim=(0, len(first.best) - 1))
    panels[0].set_ylabel("energy per distance [J/m]")
    panels[0].set_ylim(bottom=0.0)
    panels[1].set_ylabel("distance per step [mm]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def _convergence(result: GaitSearchResult) -> Figure:
    figure, axes = subplots(9.0, 4.0)
    for k, condition in enumerate(CONDITIONS):
        for j, name in enumerate(DEFINITIONS):
            draw_marks(axes, j + 0.15 * (k - 2), result.converged(condition, name), COLORS[condition], 0.06)
        axes.plot([], [], "o", color=COLORS[condition], label=str(condition))
    if result.settings.iterations > PAPER_CONVERGED:
        for value in (PAPER_CONVERGED, PAPER_OLD):
            axes.axhline(value, color="0.4", linestyle=":")
    axes.set_xticks(range(len(DEFINITIONS)), DEFINITIONS)
    axes.set(ylabel="iterations", ylim=(0, 1.03 * result.settings.iterations))
    figure.legend(loc="outside upper center", ncols=5)
    return figure


def _cross(result: GaitSearchResult) -> Figure:
    figure, axes = subplots(9.0, 4.0)
    for k, condition in enumerate(CONDITIONS):
        for j, name in enumerate(EVALUATIONS):
            gains = 1.0 + result.gains(condition, name)
            label = str(condition) if j == 0 else None
            places = np.full(len(gains), j + 0.15 * (k - 2))
            axes.plot(places, np.minimum(gains, 1.2), "o", ms=5, color=COLORS[condition], alpha=0.7, label=label)
    axes.axhline(1.0, color="0.4", linewidth=1.0)
    axes.set_xticks(range(len(EVALUATIONS)), [name.replace(", ", ",\n") for name in EVALUATIONS])
    axes.set(ylabel="energy per distance over that\nof the planned gait", ylim=(0.0, 1.2), xlabel="evaluated under")
    figure.legend(loc="outside upper center", ncols=5)
    return figure
