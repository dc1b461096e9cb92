"""The cost of walking in other worlds: energy per distance against the share of unseen worlds in which a gait walks.

A gait is searched on the robot's own floor, as in the paper, and in one, two, four and eight worlds at once
(`walking.in_worlds`), with the paper's search and with CMA-ES.  All searches start from the plain plan with the poses
of a step, minimize energy alone, and evaluate the same number of candidates.  A candidate in eight worlds takes eight
walks, so at an equal number of walks a search in one world would have eight times the candidates.  Each gait found then
walks in 200 worlds that no search has seen, over 20 strides at a quarter of the step (`optimize.quality`).  The seed of
a search also draws its worlds.

    python -m featherstone_gait.reproduction.what_worlds_cost TABLE.csv PICTURE.png

writes table and picture after each search, and resumes with the searches that are not in `TABLE_searches`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.files import Format
from ..base.progress import progress_bar
from ..optimize.quality import TEST_WORLDS, measure_in_test_worlds
from ..optimize.search import AMPLITUDE, optimize_gait
from ..search import cma_es
from ..search import run as run_search
from ..view.style import BLUE, GREY, ORANGE, look
from ..walking.cost import WalkingCost
from ..walking.cost_in_worlds import CostInWorlds, in_worlds
from ..walking.gait import bounds
from .common import subplots
from .sources import PACKAGE, digest
from .tables import kept, table_arguments, write_rows
from .walks import finished, planned_walk

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIRST, PAPERS, CMA = "first gait", "annealing", "CMA-ES"
METHODS = {PAPERS: BLUE, CMA: ORANGE}
WORLDS = (0, 1, 2, 4, 8)  # 0: the robot's own floor
CANDIDATES, SEARCHES = 800, 1  # of each search; of each method and number of worlds
TABLE, SEARCH = Format("worlds table"), Format("search in worlds")
SEARCHED_WITH = ("optimize/quality.py", "search/annealing.py", "search/cma_es.py")


@dataclass(frozen=True)
class WorldsRow:
    """A search and the measures of its gait; NaN where it falls."""

    method: str
    worlds: int  # that it searched in; 0: the robot's own floor
    seed: int
    candidates: int
    searched: float  # cost as the search saw it [J/m]
    own: float  # on the robot's own floor [J/m]
    own_speed: float  # [m/s]
    unseen: int  # worlds that tell what it is worth
    walks: float  # share of these that it gets through [-]
    cost_5: float  # percentiles of its cost where it does [J/m]
    cost_50: float
    cost_95: float


@cache
def planned() -> WalkingCost:
    """Return the first gait of all searches."""
    return planned_walk(states="step")


def search(method: str, worlds: int, seed: int, candidates: int = CANDIDATES) -> tuple[np.ndarray, float]:
    """Return the gait vector (D,) that a search finds [rad], and its cost in the search [J/m]."""
    first = planned()
    cost: WalkingCost | CostInWorlds = in_worlds(first, worlds, seed) if worlds else first
    if method == PAPERS:
        result = optimize_gait(cost, iterations=candidates - 1, seed=seed, no_progress=candidates)
    else:
        x0, limits = first.gait.to_vector(), bounds(first.scene.model, first.gait)
        asks = cma_es(x0, amplitude=AMPLITUDE, bounds=limits, seed=seed)
        result = run_search(asks, cost, evaluations=candidates, map=type(cost).costs, batch=candidates)
    return finished(result).x, float(result.fun)


def worth(
    method: str, worlds: int, seed: int, candidates: int, found: tuple[np.ndarray, float], unseen: int
) -> WorldsRow:
    """Measure a gait in a number of unseen worlds."""
    x, searched = found
    own = planned().measure([x])[0]
    (there,) = measure_in_test_worlds(planned(), [x], unseen)
    return WorldsRow(
        method, worlds, seed, candidates, searched, own.cost, own.speed, unseen, there["walks"],
        *(there["cost"] or [math.nan] * 3),
    )  # fmt: skip


# ---------------------------------------------------------------------------------------------- the study


def study(
    folder: Path, searches: int = SEARCHES, candidates: int = CANDIDATES, unseen: int = TEST_WORLDS
) -> Iterable[list[WorldsRow]]:
    """Yield all rows so far, after each; finished rows are read from the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    todo = [(FIRST, 0, 0), *((method, worlds, seed) for seed, worlds, method in
                             product(range(searches), WORLDS, METHODS))]  # fmt: skip
    program, rows = digest(*(PACKAGE / file for file in SEARCHED_WITH)), []
    for what in progress_bar(todo, unit="search"):
        key = hashlib.sha256(f"{what} {candidates} {unseen} {AMPLITUDE} {program}".encode()).hexdigest()[:12]
        name = "_".join(map(str, what)).replace(" ", "_")
        content = kept(folder / f"{name}_{key}.json", SEARCH, partial(_searched, what, candidates, unseen))
        rows.append(WorldsRow(**{field.name: content[field.name] for field in fields(WorldsRow)}))
        yield rows


def _searched(what: tuple[str, int, int], candidates: int, unseen: int) -> dict[str, Any]:
    """Return the gait that a search finds, and its row, as they are stored."""
    n = 1 if what[0] == FIRST else candidates
    found = (planned().gait.to_vector(), math.nan) if what[0] == FIRST else search(*what, n)
    return {"x": found[0].tolist()} | asdict(worth(*what, n, found, unseen))


# ---------------------------------------------------------------------------------------------- the picture


@look()
def plot(rows: Sequence[WorldsRow]) -> Figure:
    """Draw the energy per distance of gaits that walk against the share of unseen worlds in which they walk.

    A mark a search, with the number of its worlds in it, and the means of each number joined.
    """
    figure, panel = subplots(6.5, 4.4)
    searched = [row for row in rows if row.method != FIRST]
    for method, color in METHODS.items():
        own = [row for row in searched if row.method == method]
        for row in own:
            _mark(panel, row, color)
        _join(panel, [[row for row in own if row.worlds == worlds] for worlds in WORLDS[1:]], color)
    low, high = (f([row.cost_50 for row in searched]) for f in (np.nanmin, np.nanmax))
    left = min(row.walks for row in searched)
    panel.set(
        xlabel=f"share of {rows[0].unseen} unseen worlds in which the gait walks [%]", xlim=(100.0 * left - 4.0, 102.5),
        ylabel="median energy per distance there [J/m]", ylim=(0.93 * low, 1.1 * high),
    )  # fmt: skip
    _legend(panel, next(row for row in rows if row.method == FIRST))
    return figure


def _mark(panel: Axes, row: WorldsRow, color: str) -> None:
    """Draw the number of worlds in a disc; hollow for the robot's own floor."""
    face, text = (color, "white") if row.worlds else ("white", color)
    x, y = 100.0 * row.walks, row.cost_50
    panel.plot(x, y, "o", ms=11, color=face, markeredgecolor=color, markeredgewidth=1.2, zorder=3)
    name = str(row.worlds) if row.worlds else "f"
    panel.text(x, y, name, color=text, ha="center", va="center_baseline", fontsize=7.5, zorder=4)


def _join(panel: Axes, each: Sequence[Sequence[WorldsRow]], color: str) -> None:
    means = np.array([[np.mean([100.0 * r.walks for r in rows]), np.nanmean([r.cost_50 for r in rows])]
                      for rows in each if rows])  # fmt: skip
    panel.plot(*means.T, color=color, alpha=0.45, linewidth=2.5, zorder=1)


def _legend(panel: Axes, first: WorldsRow) -> None:
    """Explain the marks in the empty corner of the panel."""
    lines = [(f"{method}, in as many worlds", color) for method, color in METHODS.items()]
    lines += [("f: on the robot's own floor", GREY), ("lines: means of each number of worlds", GREY),
              (f"first gait: {first.cost_50:.0f} J/m, {100.0 * first.walks:.1f} %", GREY)]  # fmt: skip
    for k, (text, color) in enumerate(lines):
        panel.annotate(text, (0.02, 0.98), xycoords="axes fraction", xytext=(0, -12 * k), textcoords="offset points",
                       color=color, fontsize=8.5, va="top")  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the searches one after the other; write table and picture after each."""
    args = table_arguments("what it costs to walk in other worlds", arguments, "PICTURE.png", searches=SEARCHES)
    for rows in study(Path(str(args.table.with_suffix("")) + "_searches"), args.searches):
        write_rows(args.table, TABLE, rows, __file__)
        if len(rows) > 1:
            plot(rows).savefig(args.picture, dpi=130)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
