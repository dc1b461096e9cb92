"""Measure how far an optimized gait also works on robots and ground other than those of its search.

The paper optimizes on one simulated robot and one floor.  Here gaits found in this way, and the planned gait from which
they start, walk on other floors and slopes, with other masses, supplies and backlash, and are pushed.  A gait vector is
not a parameter of a `study`, so this module runs batches: all gaits under one disturbance.

A second set of gaits is searched with backlash, to compare gaits found with and without it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from ..base.progress import progress_bar
from ..identification import changed
from ..model import Ground
from ..optimize.search import optimize_gait
from ..run.simulate import Push
from ..view.style import BLUE, ORANGE, look
from ..walking.cost import WalkingCost
from .claim import Claim, classify, question, span
from .common import draw_marks, in_threads, scale_masses, subplots
from .gait_optimization import measure
from .walks import finished, planned_walk, recompiled

PLANNED = "planned"
KINDS = {  # of disturbance -> what its axis says
    "friction": "friction of the ground [-]",
    "slope": "slope, up > 0 [deg]",
    "mass": "masses [times ours]",
    "supply": "supply [V]",
    "backlash": "backlash [deg]",
}
UNCERTAIN, PUSHED = "uncertain masses", "push"
DIRECTIONS = {"forward": (1.0, 0.0), "backward": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}


@dataclass(frozen=True)
class RobustnessSettings:
    """The searches, and the disturbances of the gaits."""

    iterations: int  # of each search
    searches: int  # by different seeds
    robots: int  # with each link's mass off by up to `uncertainty`
    friction: tuple[float, ...] = (0.4, 0.5, 0.6, 0.8, 0.95, 1.0)  # [-] the search has 0.95
    slope: tuple[float, ...] = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)  # [deg] along the way
    mass: tuple[float, ...] = (0.9, 0.95, 1.0, 1.05, 1.1)  # of all links alike, times ours
    uncertainty: float = 0.1  # of each link's mass
    supply: tuple[float, ...] = (9.0, 9.6, 10.0, 11.1, 12.0)  # [V] the search has 10; gain in proportion
    backlash: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0)  # [deg] whole gap; the AX-12's is not published
    known_backlash: float = 1.0  # [deg] of the searches that know of it
    push: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0)  # [N] on the trunk; the robot weighs 24 N
    pushed_for: float = 0.1  # [s]


QUICK = RobustnessSettings(iterations=100, searches=2, robots=8)
FULL = RobustnessSettings(iterations=800, searches=3, robots=64, push=(0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0))


@dataclass(frozen=True, eq=False)
class RobustnessResult:
    """Costs [J/m], infinite where a gait does not walk, of the planned gait and of those found.

    The keys of `costs` are (kind, value): of KINDS, (UNCERTAIN, number) and (PUSHED, (direction, force)).
    """

    settings: RobustnessSettings
    gaits: tuple[str, ...]
    vectors: np.ndarray  # (gaits, 40) [rad]
    nominal: np.ndarray  # (gaits,) costs undisturbed [J/m]
    finer: np.ndarray  # (gaits,) the same at a quarter of the step [J/m]
    costs: dict[tuple, np.ndarray]  # (gaits,)

    def of(self, kind: str) -> np.ndarray:
        """Return costs under all disturbances of a kind (disturbances, gaits)."""
        return np.array([cost for (name, _), cost in self.costs.items() if name == kind])

    @property
    def found(self) -> np.ndarray:
        """Indices of the gaits found without backlash."""
        return np.flatnonzero([name.startswith("found") for name in self.gaits])

    @property
    def knowing(self) -> np.ndarray:
        """Indices of the gaits found with backlash."""
        return np.flatnonzero([name.startswith("knew") for name in self.gaits])


def run(settings: RobustnessSettings = QUICK, seed: int = 0, progress: bool = False) -> RobustnessResult:
    """Search, seeded by `seed` and the numbers that follow, then disturb; `seed` also draws the uncertain masses."""
    planned = planned_walk()
    loose = _with(planned, "backlash", settings.known_backlash)
    gaits, vectors = [PLANNED], [planned.gait.to_vector()]
    total = 2 * settings.searches
    with progress_bar(total=total, progress=progress, unit="search") as bar:
        for (name, cost), k in product((("found", planned), ("knew", loose)), range(settings.searches)):
            n = settings.iterations
            gaits.append(f"{name} {k + 1}")
            vectors.append(finished(optimize_gait(cost, iterations=n, seed=seed + k, no_progress=n)).x)
            bar.update()
    keys = [(kind, value) for kind in KINDS for value in getattr(settings, kind)]
    keys += [(UNCERTAIN, k) for k in range(settings.robots)]
    keys += [(PUSHED, each) for each in product(DIRECTIONS, settings.push)]
    costs = in_threads(lambda key: _costs(settings, planned, vectors, key, seed), keys, "disturbances", progress)
    fine = recompiled(planned, timestep=0.25 * planned.scene.timestep)
    nominal, finer = (measure(cost, vectors)[:, 0] for cost in (planned, fine))
    return RobustnessResult(settings, tuple(gaits), np.array(vectors), nominal, finer, dict(zip(keys, costs)))


def _costs(
    settings: RobustnessSettings, planned: WalkingCost, vectors: Sequence[np.ndarray], key: tuple, seed: int
) -> np.ndarray:
    """Return costs of all gaits under one disturbance (gaits,)."""
    kind, value = key
    if kind == PUSHED:
        direction, force = value
        start = planned.mark + planned.gait.period  # after the first measured stride
        x, y = DIRECTIONS[direction]
        push = Push(planned.scene.model.links[0].name, (force * x, force * y, 0.0), (0.0,) * 3, (0.0,) * 3, start)
        return measure(planned, vectors, pushes=[push._replace(end=start + settings.pushed_for)])[:, 0]
    if kind == UNCERTAIN:
        links = len(planned.scene.model.links)
        times = 1.0 + settings.uncertainty * np.random.default_rng((seed, value)).uniform(-1.0, 1.0, links)
        return measure(recompiled(planned, scale_masses(planned.scene.model, times)), vectors)[:, 0]
    return measure(_with(planned, kind, value), vectors)[:, 0]


def _with(planned: WalkingCost, kind: str, value: float) -> WalkingCost:
    """Return the walk under a disturbance of `KINDS`."""
    model, ground = planned.scene.model, Ground()
    if kind == "friction":
        ground = Ground(friction=value)
    elif kind == "slope":
        ground = Ground(slope=math.radians(value))
    elif kind == "mass":
        model = scale_masses(model, value)
    elif kind == "supply":
        servo = next(iter(model.servos.values()))  # the same in every joint
        Kp = servo.controller.Kp * value / servo.voltage_limit
        model = changed(model, voltage_limit=value, Kp=Kp)
    else:
        model = changed(model, backlash=math.radians(value))
    return recompiled(planned, model, ground=ground)


# ---------------------------------------------------------------------------------------------- claims


def check(result: RobustnessResult) -> list[Claim]:
    """Return the claims about what remains of an optimum outside its search."""
    return [_walks(result), _cheaper(result), _pushed(result), _backlash(result), _known(result)]


def _walks(result: RobustnessResult) -> Claim:
    """Return the claim: reproduced if the median gait walks under at least as many disturbances as the planned one."""
    every = np.array([cost for (kind, _), cost in result.costs.items() if kind != PUSHED])
    shares = np.isfinite(every).mean(axis=0)
    found, planned = shares[result.found], shares[0]
    falls = {kind: 1.0 - np.isfinite(result.of(kind)[:, result.found]).mean() for kind in (*KINDS, UNCERTAIN)}
    return question(
        claim="An optimized gait walks under as many disturbances as the planned one",
        ours=f"found {span(found, '.0%')}, planned {planned:.0%} of {len(every)} floors, slopes and robots",
        verdict=classify(np.median(found) >= planned),
        why=f"Rule: the median of {len(found)} gaits walks under at least as many; walking is not falling, and more "
        "than "
        "5 mm/s. Share of failures by kind: " + ", ".join(f"{kind} {x:.0%}" for kind, x in falls.items()),
    )


def _cheaper(result: RobustnessResult) -> Claim:
    """Return the claim: reproduced if all gaits are cheaper wherever both walk; in direction at 90 %."""
    every = np.array([cost for (kind, _), cost in result.costs.items() if kind != PUSHED])
    ratios = _ratios(every, result.found)
    share = float((ratios < 1.0).mean()) if len(ratios) else 0.0
    gain = _change(result.nominal[result.found], result.nominal[0])
    finer = _change(result.finer, result.nominal)
    return question(
        claim="The gain survives: an optimized gait is cheaper than the planned one under disturbances too",
        ours=f"cheaper in {share:.0%} of {len(ratios)} cases in which both walk; change "
        f"{span(ratios - 1.0, '+.0%')}, undisturbed {span(gain, '+.0%')}",
        verdict=classify(share == 1.0, share >= 0.9),
        why="Rule: in all; in direction if in 90 %. Median change by kind: "
        + ", ".join(f"{kind} {_median_change(result, kind)}" for kind in (*KINDS, UNCERTAIN))
        + f". At a quarter of the step all gaits' undisturbed costs change by {span(finer, '+.1%')}",
    )


def _change(costs: np.ndarray, before: ArrayLike) -> np.ndarray:
    """Return the relative changes of costs (..., gaits), NaN where a gait falls before or after."""
    both = np.isfinite(costs) & np.isfinite(before)
    return np.divide(costs, before, out=np.full(costs.shape, np.nan), where=both) - 1.0


def _median_change(result: RobustnessResult, kind: str) -> str:
    ratios = _ratios(result.of(kind), result.found)
    return f"{np.median(ratios) - 1.0:+.0%}" if len(ratios) else "none walks"


def _ratios(costs: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return costs of the gaits found over that of the planned one, wherever both walk."""
    every, planned = np.broadcast_arrays(costs[:, found], costs[:, :1])
    both = np.isfinite(every) & np.isfinite(planned)
    return every[both] / planned[both]


def _pushed(result: RobustnessResult) -> Claim:
    """Return the claim: reproduced if the median gait withstands at least as many pushes as the planned one."""
    stood = np.isfinite(result.of(PUSHED))
    counts = stood.sum(axis=0)
    largest = {direction: _largest(result, direction) for direction in DIRECTIONS}
    lines = ", ".join(
        f"{direction} {np.median(each[result.found]):g} N (planned {each[0]:g} N)"
        for direction, each in largest.items()
    )
    return question(
        claim="An optimized gait withstands as many pushes as the planned one",
        ours=f"found {span(counts[result.found], 'd')}, planned {counts[0]} of {len(stood)}",
        verdict=classify(np.median(counts[result.found]) >= counts[0]),
        why=f"Rule: median at least as many. Pushes of {result.settings.pushed_for:g} s on the trunk; a gait "
        "withstands one if it walks to the end of the strides. Median of the largest force up to which a gait "
        f"withstands all pushes: {lines}",
    )


def _largest(result: RobustnessResult, direction: str) -> np.ndarray:
    """Return the largest force up to which each gait withstands all (gaits,) [N], 0 if none."""
    stood = np.array([np.isfinite(result.costs[PUSHED, (direction, force)]) for force in result.settings.push])
    counts = np.logical_and.accumulate(stood, axis=0).sum(axis=0)
    return np.array([0.0, *result.settings.push])[counts]


def _backlash(result: RobustnessResult) -> Claim:
    """Return the claim: reproduced if all gaits walk with backlash and cost less than 10 % more."""
    costs = result.of("backlash")[:, result.found]
    change = _change(costs, result.nominal[result.found])
    sizes = result.settings.backlash
    by_size = ", ".join(f"{size:g} deg {span(each, '+.0%')}" for size, each in zip(sizes, change))
    return question(
        claim=f"An optimum found without backlash tolerates up to {max(sizes):g} deg of backlash",
        ours=f"{np.isfinite(costs).sum()} of {costs.size} walk; change of the cost {by_size}",
        verdict=classify(np.max(change) < 0.1),
        why="Rule: all walk and none costs 10 % more. The planned gait: "
        + ", ".join(
            f"{size:g} deg {span(each, '+.0%')}"
            for size, each in zip(sizes, _change(result.of("backlash")[:, :1], result.nominal[0]))
        ),
    )


def _known(result: RobustnessResult) -> Claim:
    """Return the claim: reproduced if a search with backlash has the lower median cost with it."""
    size = result.settings.known_backlash
    both = {"found": result.found, "knowing": result.knowing}
    cost = {name: result.costs["backlash", size][rows] for name, rows in both.items()}
    clean = {name: result.nominal[rows] for name, rows in both.items()}
    distance = np.degrees(np.abs(result.vectors[result.knowing] - result.vectors[result.found])).mean()
    return question(
        claim=f"A search with {size:g} deg of backlash finds better gaits for a robot with this backlash",
        ours=f"with backlash {span(cost['knowing'], '.1f')} J/m against {span(cost['found'], '.1f')} J/m",
        verdict=classify(np.median(cost["knowing"]) < np.median(cost["found"])),
        why=f"Rule: lower median; a fall is infinite. Without backlash they cost {span(clean['knowing'], '.1f')} and "
        f"{span(clean['found'], '.1f')} J/m. With the same seeds the gaits found with and without it are "
        f"{distance:.1f} deg apart on average over their angles",
    )


# ---------------------------------------------------------------------------------------------- figures

COLORS = {PLANNED: "0.35", "found": BLUE, "knew": ORANGE}


@look()
def plot(result: RobustnessResult) -> dict[str, Figure]:
    """Draw the costs by disturbance, and the pushes that were withstood."""
    return {
        "Energy per distance of the planned gait and of the gaits found under disturbances; crosses at the top: "
        "the gait does not walk. Last panel: robots with each link's mass off by up to 10 %.": _curves(result),
        "Largest push on the trunk up to which every one is withstood; each mark is a gait, the line their median.":
            _pushes(result),
    }  # fmt: skip


def _curves(result: RobustnessResult) -> Figure:
    figure, panels = subplots(11.0, 6.0, 2, 3, sharey=True)
    finite = [x for cost in result.costs.values() for x in cost if math.isfinite(x)]
    top = 1.1 * max(finite)
    for axes, kind in zip(panels.flat, (*KINDS, UNCERTAIN)):
        costs = result.of(kind)
        places = np.array(getattr(result.settings, kind) if kind in KINDS else np.arange(1, len(costs) + 1))
        for k, name in enumerate(result.gaits):
            color, walks = COLORS[name.split()[0]], np.isfinite(costs[:, k])
            style = "o-" if kind in KINDS else "o"
            axes.plot(places, np.where(walks, costs[:, k], math.nan), style, ms=3, color=color, alpha=0.7)
            shift = 0.012 * (k - len(result.gaits) / 2) * np.ptp(places)
            axes.plot(places[~walks] + shift, np.full(np.sum(~walks), top), "x", ms=5, color=color)
        axes.set(xlabel=KINDS.get(kind, "robot"), ylim=(0.0, 1.05 * top))
    for axes in panels[:, 0]:
        axes.set_ylabel("energy per distance [J/m]")
    for name, label in zip(COLORS, ("planned gait", "found without backlash", "found with backlash")):
        panels[0, 0].plot([], [], "o-", ms=3, color=COLORS[name], label=label)
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _pushes(result: RobustnessResult) -> Figure:
    figure, axes = subplots(7.5, 3.8)
    groups = {PLANNED: np.array([0]), "found": result.found, "knew": result.knowing}
    for j, direction in enumerate(DIRECTIONS):
        largest = _largest(result, direction)
        for k, (name, rows) in enumerate(groups.items()):
            draw_marks(axes, j + 0.22 * (k - 1), largest[rows], COLORS[name], 0.09)
    for name, label in zip(COLORS, ("planned gait", "found without backlash", "found with backlash")):
        axes.plot([], [], "o", color=COLORS[name], label=label)
    axes.set_xticks(range(len(DIRECTIONS)), DIRECTIONS)
    axes.set(ylabel=f"push for {result.settings.pushed_for:g} s [N]")
    axes.set_ylim(bottom=0.0)
    figure.legend(loc="outside upper center", ncols=3)
    return figure
