"""Compute Sobol's indices: the share of each varied parameter in the variance of a measure.

For N base samples A and B and p parameters, a study with the method "saltelli" has N (p + 2) runs: for each base sample
A, B, and for each parameter A with that parameter from B.  The share of parameter i in the variance V of a measure f is

    alone (first order)            S_i = mean(f_B (f_ABi - f_A)) / V
    with interactions (total)      T_i = mean((f_A - f_ABi)^2) / 2 V

(A. Saltelli et al., Computer Physics Communications 181 (2010), 259-270, table 2, b and f).  Base samples with a run
that has no value are left out.  Errors are standard errors of these means.  For `RATIOS`, f is the logarithm; otherwise
a few runs that hardly move would dominate the variance.
"""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.files import Format, complete, write_csv
from ..view.style import BLUE, look
from .measures import COLUMNS
from .settings import Study
from .table import read_columns

SENSITIVITY = Format("study sensitivity")
GREY = "0.7"
RATIOS = ("cost_J_m", "cost_of_transport")  # to a distance that may be next to nothing: of these the logarithm
PLOTTED = {  # of other experiments the first measure
    "hold": ("offset_deg", "variance_deg2", "energy_J"),
    "walk": ("cost_J_m", "speed_m_s", "walks"),
}


class Index(NamedTuple):
    """The share of a parameter in the variance of a measure [-]."""

    first: float  # alone
    first_error: float
    total: float  # with all that it acts with
    total_error: float


def indices(values: np.ndarray) -> list[Index]:
    """Compute the indices of p parameters from values (N, p + 2) of a measure, in the order A, B, AB_1 ... AB_p.

    Values may be NaN.  The indices are NaN if fewer than two base samples are complete or the measure does not vary.
    """
    found = values[np.isfinite(values).all(axis=1)]
    p, n = values.shape[1] - 2, len(found)
    if n < 2:
        return [Index(*[math.nan] * 4)] * p
    mean = math.fsum(found[:, :2].ravel().tolist()) / (2 * n)
    a, b, *others = (found - mean).T
    variance = math.fsum((np.concatenate([a, b]) ** 2).tolist()) / (2 * n - 1)
    if not variance > 0.0:
        return [Index(*[math.nan] * 4)] * p
    parts = [(b * (c - a) / variance, (a - c) ** 2 / (2.0 * variance)) for c in others]
    return [Index(*_mean(first), *_mean(total)) for first, total in parts]


def _mean(x: np.ndarray) -> tuple[float, float]:
    """Compute a mean and its standard error by exact sums."""
    mean = math.fsum(x.tolist()) / len(x)
    return mean, math.sqrt(math.fsum(((x - mean) ** 2).tolist()) / (len(x) * (len(x) - 1)))


def write_sensitivity(study: Study, table: Path) -> Path:
    """Write NAME_sensitivity.csv and .png beside the table of a study with the method "saltelli"; return the former."""
    path = table.with_name(f"{table.stem}_sensitivity.csv")
    measures, names = COLUMNS[study.setup.experiment], study.names
    columns = read_columns(table, [*measures])
    found, spread = {}, []
    for measure in measures:
        values = np.array([float(text) if text else math.nan for text in columns[measure]])
        known = values[np.isfinite(values)]
        if len(known):
            low, middle, high = np.quantile(known, (0.05, 0.5, 0.95)).tolist()
            spread.append(f"{measure}: {len(known)} values, mean {known.mean():.6g}, 5 % below {low:.6g}, "
                          f"median {middle:.6g}, 5 % above {high:.6g}")  # fmt: skip
        values = (np.log(values) if measure in RATIOS else values).reshape(-1, len(names) + 2)
        whole = int(np.isfinite(values).all(axis=1).sum())
        spread.append(f"{measure}: indices of the {whole} of {len(values)} base samples all of whose runs have a value")
        found[measure] = indices(values)
    cells = ((m, name, *index) for m, each in found.items() for name, index in zip(names, each))
    shown = ([x if isinstance(x, str) or math.isfinite(x) else "" for x in row] for row in cells)
    write_csv(path, SENSITIVITY, ["measure", "parameter", *Index._fields], shown, "\n".join(spread), end="\n")
    shown_measures = PLOTTED.get(study.setup.experiment, tuple(measures)[:1])
    _plot(study, {measures[name]: found[name] for name in shown_measures}, path.with_suffix(".png"))
    return path


@look()
def _plot(study: Study, found: dict[str, list[Index]], path: Path) -> None:
    """Draw bars for some measures by their labels, with the parameter of the largest first total index on top."""
    from matplotlib.figure import Figure

    totals = [index.total for index in next(iter(found.values()))]
    order = sorted(range(len(totals)), key=lambda k: (math.isfinite(totals[k]), totals[k]))
    width = 7.0 if len(found) == 1 else 1.8 + 2.1 * len(found)  # readable in a column of text
    figure = Figure(figsize=(width, 1.6 + 0.4 * len(order)), layout="constrained")
    panels = figure.subplots(1, len(found), sharey=True, squeeze=False).ravel()
    for axes, (says, each) in zip(panels, found.items()):
        for shift, color, kind, label in ((0.2, BLUE, 0, "alone"), (-0.2, GREY, 2, "with interactions")):
            lengths, errors = ([each[k][kind + part] for k in order] for part in (0, 1))
            places = [place + shift for place in range(len(order))]
            axes.barh(places, lengths, 0.36, xerr=errors, color=color, label=label, error_kw={"linewidth": 1})
        axes.set_xlabel(textwrap.fill(f"share of the variance of {says}", 60 if len(found) == 1 else 26))
    panels[0].set_yticks(range(len(order)), [study.names[k].removeprefix("worlds.") for k in order])
    panels[-1].legend(loc="lower right")
    title = f"{study.name}: {study.setup.model.name}, {study.setup.experiment}, {len(study)} runs"
    figure.suptitle(title, fontsize=11, parse_math=False)
    with complete(path) as temporary:
        figure.savefig(temporary, dpi=130)
