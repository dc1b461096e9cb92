"""Test numerical stability under stress, and whether a run that is wrong says so.

Each case runs with each integrator and each step.  The reference is `extrapolation` at a tolerance of 1e-9, as long as
it agrees with itself at 1e-8 to 1e-5 (rad or m): where motion is chaotic the comparison ends there.  A run is

    held      its positions are within 1e-3 of the reference, or within ten times its own error estimate, status ok
    flagged   they are not, or the reference is not known to the end, and its status says so
    silent    they are not, and its status is ok
    alarm     its status is not ok although they are within 1e-3 to the end

No run should be silent, and at most one in twenty an alarm.

    featherstone-gait benchmark stress        five minutes
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from ..base.progress import progress_bar
from ..core.integrate import INTEGRATORS
from ..view.style import look, subplots
from .case import Case, agreed, distances, estimate_of, positions
from .scenes import stressed
from .table import machine, save_figure, tabulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WRONG = 1e-3  # error that counts [rad or m]
COVERED = 10.0  # times the run's own estimate that it may reach
COLORS = {"held": "#0072B2", "flagged": "#56B4E9", "silent": "#D55E00", "alarm": "#E69F00", "": "white"}


class Row(NamedTuple):
    """One line of the table."""

    case: Annotated[str, "case", "<32"]
    integrator: Annotated[str, "integrator", "<14"]
    step: Annotated[float, "step [s]", "8g"]  # [s], NaN with error control
    verdict: Annotated[str, "", "<8"]
    status: Annotated[str, "status", "<14"]
    error: Annotated[float, "error", "8.1e"]  # largest before `until` [rad or m]
    estimate: Annotated[float, "estimate", "8.1e"]  # the run's own
    until: Annotated[float, "until s", "8.3g"]  # time up to which the truth is known [s]


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write stress.csv and stress.png into `out_dir`; `full` adds steps of 0.2, 2 and 20 ms."""
    host, cases = machine(), progress_bar(stressed(full), desc="cases", leave=False)
    print(host)
    rows = tabulate(out_dir / "stress.csv", Row, (row for case in cases for row in judged(case)), host)
    counts = Counter(row.verdict for row in rows)
    right = counts["held"] + counts["alarm"]
    print(f"{len(rows)} runs: {', '.join(f'{counts[v]} {v}' for v in ('held', 'flagged', 'silent', 'alarm'))}; "
          f"false alarms {counts['alarm'] / max(right, 1):.1%} of the {right} runs that are right")  # fmt: skip
    save_figure(plot(rows, host), out_dir / "stress.png")
    return rows


def judged(case: Case) -> list[Row]:
    """Run a case with all its settings."""
    truths = (case.run(case.by("extrapolation", 1e-3), rtol=rtol, estimate_error=False) for rtol in (1e-9, 1e-8))
    exact = agreed(case, *truths)
    known, rows = exact.known, []
    for integrator, step in case.settings:
        run = case.run(case.by(integrator, 1e-3 if math.isnan(step) else step))
        error = float(distances(case.scene, positions(run), exact.q)[:known].max(initial=0.0))
        estimate = float(estimate_of(run)[:known].max(initial=0.0))
        right = error <= WRONG or (run.ok and error <= COVERED * estimate)
        false = error <= WRONG and known == len(exact.q)
        verdict = ("held" if right else "silent") if run.ok else ("alarm" if false else "flagged")
        until = max(known - 1, 0) * case.every
        rows.append(Row(case.name, integrator, step, verdict, run.status, error, estimate, until))
    return rows


@look()
def plot(rows: list[Row], notes: str = "") -> Figure:
    """Draw a cell for each run: cases down, integrators and steps across."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    names = list(dict.fromkeys(row.case for row in rows))
    columns = sorted({(INTEGRATORS[row.integrator].adaptive, row.integrator, row.step) for row in rows}, key=str)
    kinds = list(COLORS)
    cells = np.full((len(names), len(columns)), kinds.index(""))
    for row in rows:
        column = next(k for k, c in enumerate(columns) if str(c[1:]) == str((row.integrator, row.step)))
        cells[names.index(row.case), column] = kinds.index(row.verdict)
    figure, axes = subplots(11.0, 1.8 + 0.33 * len(names))
    axes.pcolormesh(cells, cmap=ListedColormap(list(COLORS.values())), vmin=-0.5, vmax=len(kinds) - 0.5,
                    edgecolors="white", linewidth=1.5)  # fmt: skip
    labels = [name if math.isnan(step) else f"{name}\n{1e3 * step:g} ms" for _, name, step in columns]
    axes.set_xticks(np.arange(len(columns)) + 0.5, labels, rotation=90, fontsize=8)
    axes.set_yticks(np.arange(len(names)) + 0.5, names, fontsize=9)
    axes.invert_yaxis()
    figure.legend(
        handles=[Patch(facecolor=color, edgecolor="0.8", label=kind or "not run") for kind, color in COLORS.items()],
        loc="outside upper right", ncols=5,
    )  # fmt: skip
    figure.suptitle(notes, fontsize=7, x=0.01, ha="left")
    return figure
