"""Measure run time against error of every integrator, on arms, a humanoid and published problems.

Each problem runs with fixed steps and with tolerances.  The error is the largest of joint angles and base rotation
[rad], and of the base's position [m], at the end or over all records, against a closed form or a run of error control
near rounding.  The reference's own error is its difference to another integrator or to a ten times looser tolerance.

The time is that of the compiled run, with all its arguments prepared: least CPU time of some runs, single-threaded, by
simulated time.  A call of `simulate` costs more, which is a column of its own.

    featherstone-gait benchmark precision        twelve minutes
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from ..base.files import number, read_csv
from ..base.progress import progress_bar
from ..core.integrate import INTEGRATORS
from ..run.trajectory import positions
from ..view.style import look, subplots
from .case import Case, Setting, deviation, solution
from .scenes import problems
from .table import TABLE, machine, print_table, save_figure, write_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ENOUGH, REPEATS, REPEATS_FULL = 0.15, 5, 25  # CPU seconds and runs after which a time is believed
COLUMNS = ("problem", "integrator", "step_s", "rtol", "error_rad", "error_m", "reference_error", "run_ms_per_s",
           "simulate_ms_per_s", "evaluations", "status")  # fmt: skip


class Row(NamedTuple):
    """One line of the table."""

    problem: str
    integrator: Annotated[str, "integrator", "<15"]
    step: Annotated[float, "step [s]", "8g"]  # [s], NaN with error control
    rtol: Annotated[float, "rtol", "7.0e"]  # NaN with fixed steps
    angle: Annotated[float, "[rad]", "8.1e"]  # error of joints and of the base's turn [rad, of sliding joints m]
    shift: Annotated[float, "[m]", "8.1e"]  # error of the base's position [m], NaN where it is fixed
    reference_error: float  # of what the errors are counted from [rad or m]
    time: Annotated[float, "run [ms/s]", "10.4g"]  # of the compiled run per simulated second [ms]
    call: Annotated[float, "simulate", "10.4g"]  # of `simulate` per simulated second [ms]
    # Of the derivative or implicit solutions; with fixed steps one or, of rk4, four a step.
    evaluations: Annotated[int, "evaluations", "12"]
    status: Annotated[str, "", "<4"]

    @property
    def error(self) -> float:
        """Larger one of the two errors [rad or m]."""
        return self.angle if math.isnan(self.shift) else max(self.angle, self.shift)


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write precision.csv and precision.png into `out_dir`; `full` repeats runs more often."""
    host, rows = machine(), []
    print(host)
    for case in problems():
        part = measure(case, REPEATS_FULL if full else REPEATS)
        print(f"\n{case.name}; the reference is exact to {part[0].reference_error:.1e} rad or m")
        rows += print_table(Row, part)
    write(out_dir / "precision.csv", rows, host)
    plot(out_dir / "precision.png", rows, host)
    return rows


def measure(case: Case, repeats: int = REPEATS, settings: Sequence[Setting] = ()) -> list[Row]:
    """Measure a case; settings: (integrator, step or tolerance) to try, by default all of the case."""
    exact, own_error = solution(case)
    tried = settings or case.settings
    for integrator in dict.fromkeys(integrator for integrator, _ in tried):
        case.ready(integrator, max(value for name, value in tried if name == integrator)).once()  # compiles
    bar = progress_bar(tried, desc=case.name, leave=False)
    return [_row(case, integrator, value, exact, own_error, repeats) for integrator, value in bar]


def _row(case: Case, integrator: str, setting: float, exact: np.ndarray, own_error: float, repeats: int) -> Row:
    run = case.ready(integrator, setting)
    times: list[float] = []
    calls: list[float] = []
    while not times or (len(calls) < repeats and sum(times) + sum(calls) < 1e3 * ENOUGH / case.duration):
        times += [run.once() for _ in range(3)]  # the first after a call of `simulate` finds cold caches
        calls.append(run.call())
    result, method = run.trajectory, INTEGRATORS[integrator]
    errors = deviation(case.model, positions(result), exact)
    if result.status in ("diverged", "fell", "step too small", "too costly"):
        errors = (math.inf, math.inf + errors[1])
    evaluations = result.info.get("evaluations", run.ready.plan.steps * method.stages)
    step, rtol = (math.nan, setting) if method.adaptive else (setting, math.nan)
    return Row(
        case.name, integrator, step, rtol, *errors, own_error, min(times), min(calls), evaluations, str(result.status)
    )


def write(path: Path, rows: list[Row], notes: str) -> None:
    """Write the table as CSV, the notes as comments above it."""
    write_table(path, COLUMNS, rows, notes)


def read(path: Path) -> list[Row]:
    """Read the rows of a precision.csv; raise ValueError, naming file and line, for anything else."""
    return [_read_row(path, line, cells) for line, cells in list(read_csv(path, TABLE))[1:]]


def _read_row(path: Path, line: int, cells: list[str]) -> Row:
    try:
        problem, integrator, *numbers, evaluations, status = cells
        return Row._make([problem, integrator, *map(_read_number, numbers), int(_read_number(evaluations)), status])
    except (ValueError, TypeError, OverflowError) as error:
        what = f"is no row of this benchmark ({error})"
        raise ValueError(f"{path}, line {line}: {what}; run the benchmark again") from error


def _read_number(text: str) -> float:
    value = {"": math.nan, "nan": math.nan, "inf": math.inf}.get(text, number(text))
    if math.isnan(value) and text not in ("", "nan"):
        raise ValueError(f"{text[:40]!r} is no number")
    return value


COLORS = {"implicit_euler": "C0", "midpoint": "C2", "rk4": "C1", "simtwo": "C3", "dop853": "C4",
           "extrapolation": "0.15", "ars343": "C5"}  # fmt: skip


@look()
def plot(path: Path, rows: list[Row], notes: str = "") -> None:
    """Draw a panel for each problem: time against error, of runs with errors below 1 rad or m."""
    from matplotlib.lines import Line2D

    names = list(dict.fromkeys(row.problem for row in rows))
    columns = min(4, len(names))
    lines = -(-len(names) // columns)
    figure, panels = subplots(max(3.3 * columns + 0.3, 8.0), 2.9 * lines + 0.9, lines, columns, squeeze=False)
    for k, panel in enumerate(panels.ravel()):
        if k < len(names):
            _panel(panel, [row for row in rows if row.problem == names[k]])
            panel.set_ylabel("CPU time [ms/s]" if k % columns == 0 else "")
        else:
            panel.set_axis_off()
    used = [name for name in COLORS if any(row.integrator == name for row in rows)]
    figure.legend(handles=[Line2D([], [], label=name, **_style(name)) for name in used], loc="outside lower center",
                  ncols=len(used))  # fmt: skip
    said = "CPU milliseconds per simulated second against error; filled: error control, hollow: fixed steps"
    figure.suptitle(f"{said}\n{notes}", fontsize=9)
    save_figure(figure, path)


def _style(name: str) -> dict:
    fill = COLORS[name] if INTEGRATORS[name].adaptive else "white"
    return {"color": COLORS[name], "marker": "o", "markersize": 4, "markerfacecolor": fill, "linewidth": 1.2}


def _panel(panel: Axes, rows: list[Row]) -> None:
    from matplotlib.ticker import NullFormatter

    for name in COLORS:
        line = [row for row in rows if row.integrator == name and 0.0 < row.error < 1.0]
        panel.loglog([row.error for row in line], [row.time for row in line], **_style(name))
    if rows[0].reference_error > 0.0:
        panel.axvspan(1e-20, rows[0].reference_error, color="0.9")
    shown = [row.error for row in rows if 0.0 < row.error < 1.0]
    panel.set_xlim(0.3 * min(shown), 3.0 * max(shown))
    panel.set_title(rows[0].problem, fontsize=10)
    panel.set_xlabel("error [rad]" if math.isnan(rows[0].shift) else "error [rad or m]", fontsize=9)
    panel.tick_params(labelsize=8)
    panel.yaxis.set_minor_formatter(NullFormatter())
