"""Judge what `simulate(scene, duration)` gives by default: error, estimate, status and cost, on many scenes.

A run is judged up to where its reference is known (`case.py`).  Its status is right if it is "fell" where the
reference fell, and otherwise "ok".  The status of a run that fell, but says that its course is uncertain, is neither.

    held      right (within 1e-3 rad or m, and 1e-2 of the largest speed, at least 1 rad/s or m/s), status right
    silent    wrong, and nothing says so
    flagged   wrong, and the status says so
    alarm     right, but the status is not
    slow      no result after `PATIENCE` CPU seconds

Robots are those of installed packages (see `robots.py`).  MuJoCo runs the same model at its own step of 2 ms with its
own integrator; where stops, ground, dry friction or couplings act, its laws differ, and only its time is given.

Whether the run's own errors hold is counted by channel, and apart for scenes of one and of several: the largest error
of a run is within the largest that it states, and each number within its own.

    featherstone-gait benchmark default        twenty minutes, with references kept from an earlier run
    featherstone-gait benchmark default --only company        scenes of several alone, and single bodies beside them
"""

from __future__ import annotations

import math
import statistics
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np

from ..base.progress import progress_bar
from ..run.error_estimate import SPEED_LIMIT
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from ..view.style import BLUE, COLORS, ORANGE, look, subplots
from .case import Case, Truth, Worker, at_most, cache_folder, distances, estimate_of, positions, truth, velocities
from .default_scenes import cases
from .engines import peer_run
from .table import machine, print_table, save_figure, write_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WRONG, SILENT = 1e-3, 1e-2  # error that counts of the default, and of integrators named [rad or m]
ROUNDING = 1e-12  # an error that may be estimated for a robot that does not move [rad or m]
PATIENCE = 30.0  # CPU seconds of a run
ENOUGH, REPEATS = 0.5, 9  # CPU seconds and runs after which a time is believed
NAMED = ("implicit_euler", "midpoint", "rk4", "dop853", "extrapolation", "ars343")
VERDICTS = {"held": BLUE, "silent": ORANGE, "flagged": COLORS[4], "alarm": COLORS[5]}


class Outcome(NamedTuple):
    """Hold the part of a run that is compared."""

    q: np.ndarray  # (samples, nq)
    qd: np.ndarray  # (samples, nv)
    status: str
    end: float  # [s]
    estimate: np.ndarray  # of positions (samples,), NaN where the run has none
    stated: np.ndarray  # of all numbers (samples, nq + nv), the same
    time: float  # CPU per simulated second [ms]


class Row(NamedTuple):
    """One line of the table."""

    case: Annotated[str, "case", "<50.50"]
    kind: str
    duration: float  # [s]
    until: Annotated[float, "until s", "8.3g"]  # the reference is known up to here [s]
    integrator: Annotated[str, "integrator", "<14"]
    step: float  # [s]
    status: Annotated[str, "status", "<14"]
    verdict: Annotated[str, "", "<8"]
    error: Annotated[float, "error", "8.1e"]  # of positions, up to `until` [rad or m]
    speed_error: float  # relative to the largest speed, at least 1 rad/s or m/s
    estimate: Annotated[float, "estimate", "9.1e"]  # the run's own, NaN without
    time: Annotated[float, "ms/s", "8.3g"]  # CPU per simulated second [ms]
    ratio: Annotated[float, "ratio", "7.2f"]  # of that to version 0.1's default: implicit_euler at 1 ms, or dop853 1e-8
    mujoco_error: float  # [rad or m], NaN where laws differ
    mujoco_time: float  # [ms]
    bodies: int = 1  # robots and objects
    base_q: float = math.nan  # largest error of a channel by the largest that the run states, NaN without
    q: float = math.nan
    base_qd: float = math.nan
    qd: float = math.nan
    within: float = math.nan  # share of all numbers whose error is within their own


CHANNELS = ("base_q", "q", "base_qd", "qd")
NAMED_COLUMNS = ("case", "integrator", "status", "verdict", "error", "time")  # of the table of integrators


def run(
    out_dir: Path, full: bool = False, robots: Sequence[Path] | None = None, references: Path | None = None,
    only: str = "",
) -> list[Row]:  # fmt: skip
    """Print the tables; write default.csv, default_integrators.csv and default.png into `out_dir`.

    full: all robots and the long runs; robots: folders with robot files in place of the installed packages';
    references: folder in which the references are kept, in the user's cache if None; only: a group of `cases`.

    Raises
    ------
    ValueError
        If there is no such group.
    """
    host, rows, named, skipped = machine(), list[Row](), list[Row](), list[str]()
    print(host)

    def found(worker: Worker) -> Iterator[Row]:
        for case in progress_bar(cases(full, robots, skipped, only), desc="cases", leave=False):
            case = case._replace(exact=None)  # the reference is computed, and a function here cannot go to the worker
            exact = truth(case, worker, references or cache_folder())
            if exact is None or exact.known < 2:
                skipped.append(f"{case.name}: no reference within the limit of time")
                continue
            row, others = judged(case, exact, worker)
            rows.append(row)
            named.extend(others)
            write_table(out_dir / "default.csv", Row._fields, rows, host)
            cells = ([getattr(each, name) for name in NAMED_COLUMNS] for each in named)
            write_table(out_dir / "default_integrators.csv", NAMED_COLUMNS, cells, host)
            yield row

    with closing(Worker()) as worker:
        print_table(Row, found(worker))
    print("\n".join([f"left out: {text}" for text in skipped] + ["", *summary(rows)]))
    print("\n".join(["", *coverage(rows)]))
    print(f"\nby name, wrong from {SILENT:g} on:")
    print("\n".join(shares(named, "integrator")))
    save_figure(plot(rows, host), out_dir / "default.png")
    return rows


# ---------------------------------------------------------------------------------------------- judging


def judged(case: Case, exact: Truth, worker: Worker) -> tuple[Row, list[Row]]:
    """Judge the default; where one robot is alone, the named integrators, a run without estimate and MuJoCo too."""
    row = _row(case, exact, case.scene, worker, WRONG)
    if case.scene.members:
        return row, []
    named = [_row(case, exact, case.by(name), worker, SILENT) for name in NAMED]
    plain = worker.call(plain_time, case)
    peer = worker.call(peer_run, case, exact) or (math.nan, math.nan)
    ratio = row.time / plain if plain else math.nan
    return row._replace(ratio=ratio, mujoco_error=peer[0], mujoco_time=peer[1]), named


def _row(case: Case, exact: Truth, scene: CompiledScene, worker: Worker, wrong: float) -> Row:
    """Judge one run, which counts as wrong above that error; costs to compare with are left NaN."""
    until = (exact.known - 1) * case.every
    what = (case.name, case.kind, case.duration, until, scene.integrator, scene.timestep)
    outcome = worker.call(outcome_of, case, scene)
    if outcome is None:
        return Row(*what, "", "slow", math.nan, math.nan, math.nan, math.inf, math.nan, math.nan, math.nan)
    error, speed_error, estimate = errors(case, exact, outcome)
    verdict = verdict_of(max(error, speed_error / SPEED_LIMIT), is_right(outcome.status, exact), wrong)
    costs = outcome.time, math.nan, math.nan, math.nan
    row = Row(*what, outcome.status, verdict, error, speed_error, estimate, *costs)
    return row._replace(bodies=max(len(scene.members), 1), **held(case, exact, outcome))


def outcome_of(case: Case, scene: CompiledScene) -> Outcome:
    """Run and time the scene."""
    result, time_ = timed(case, scene)
    status = f"{result.status}{', uncertain' if result.status == 'fell' and 'uncertain' in result.message else ''}"
    q, qd, stated = positions(result), velocities(result), np.full((len(result["time"]), 1), math.nan)
    if result.error:
        stated = np.hstack([positions(result.error), velocities(result.error)])
    return Outcome(q, qd, status, result.end_time, estimate_of(result), stated, time_)


def plain_time(case: Case) -> float:
    """Return the CPU time per simulated second [ms] without error estimate, of `implicit_euler` at 1 ms or `dop853`."""
    smooth = case.scene.integrator == "dop853"
    how: dict[str, Any] = {"estimate_error": False} | ({"rtol": 1e-8} if smooth else {})
    return timed(case, case.by("dop853" if smooth else "implicit_euler", 1e-3), **how)[1]


def timed(case: Case, scene: CompiledScene, **how: Any) -> tuple[Trajectory, float]:
    """Run some times; return the run and its median CPU time per simulated second [ms]."""
    case.compiled(scene, **how)
    times: list[float] = []
    while not times or (len(times) < REPEATS and sum(times) < ENOUGH):
        start = time.process_time()
        with at_most(PATIENCE):
            result = case.run(scene, **how)
        times.append(time.process_time() - start)
    return result, 1e3 * statistics.median(times) / case.duration


def errors(case: Case, exact: Truth, outcome: Outcome) -> tuple[float, float, float]:
    """Return errors of positions [rad or m] and velocities (by the largest, at least 1), and the run's own estimate."""
    known = known_of(case, exact, outcome)
    error = distances(case.scene, outcome.q, exact.q)[:known]
    largest = np.abs(exact.qd[:known]).max(initial=1.0)
    speed = np.abs(outcome.qd - exact.qd)[:known].max(initial=0.0)
    return float(error.max()), float(speed / largest), float(outcome.estimate[:known].max())


def known_of(case: Case, exact: Truth, outcome: Outcome) -> int:
    """Return the number of records that are compared."""
    return min(exact.known, max(int(outcome.end / case.every + 1e-6) + 1, 1))


def held(case: Case, exact: Truth, outcome: Outcome) -> dict[str, Any]:
    """Return the last fields of a row; the reference's own error is taken from the run's."""
    known, (nq, nv) = known_of(case, exact, outcome), (outcome.q.shape[1], outcome.qd.shape[1])
    own = np.repeat([exact.own_error, exact.own_speed_error], [nq, nv])
    true = np.abs(np.hstack([outcome.q - exact.q, outcome.qd - exact.qd])[:known]) - own
    stated = np.broadcast_to(outcome.stated[:known], true.shape)
    if not np.isfinite(stated).all():
        return {}
    bases = (nq - len(case.model.position_names)) // 7
    parts = np.split(np.arange(nq + nv), [7 * bases, nq, nq + 6 * bases])
    largest: dict[str, Any] = {name: float(max(true[:, of].max(), 0.0) / max(stated[:, of].max(), ROUNDING))
               for name, of in zip(CHANNELS, parts) if len(of)}  # fmt: skip
    return largest | {"within": float((true <= stated).mean())}


def is_right(status: str, exact: Truth) -> bool:
    """Return whether a status is right: "fell" where the reference fell, otherwise "ok"."""
    return status == ("fell" if exact.status == "fell" else "ok")


def verdict_of(error: float, right: bool, wrong: float) -> str:
    """Return the verdict, as the head of this file defines it; right: whether the status is right."""
    if error <= wrong:
        return "held" if right else "alarm"
    return "silent" if right else "flagged"


# ---------------------------------------------------------------------------------------------- summary


def summary(rows: Sequence[Row]) -> list[str]:
    """Summarize all scenes and each kind, and list the runs that are silently wrong."""
    worst = sorted((row for row in rows if row.verdict == "silent"), key=lambda row: -row.error)
    silent = [f"silent: {row.case}: {row.error:.2g} rad or m before {row.until:.3g} s" for row in worst]
    return [*shares(rows, "kind"), _line("all", rows), *silent]


def coverage(rows: Sequence[Row]) -> list[str]:
    """Count in which share of the runs that are ok the error is within the stated one, of scenes of one and several."""
    lines = [f"{'error within stated':24}{'runs':>7}" + "".join(f"{name:>9}" for name in (*CHANNELS, "all", "numbers"))]
    for name, several in (("scenes of one", False), ("scenes of several", True)):
        of = [row for row in rows if (row.bodies > 1) is several and row.status == "ok" and not math.isnan(row.within)]
        values = [[x for x in (getattr(row, channel) for channel in CHANNELS) if not math.isnan(x)] for row in of]
        by_channel = [[x for x in (getattr(row, c) for row in of) if not math.isnan(x)] for c in CHANNELS]
        cells = [share(sum(x <= 1.0 for x in each), len(each)) for each in by_channel]
        cells.append(share(sum(max(each) <= 1.0 for each in values), len(of)))
        cells.append(f"{statistics.fmean([row.within for row in of] or [math.nan]):.0%}" if of else "-")
        lines.append(f"{name:24}{len(of):7}" + "".join(f"{cell:>9}" for cell in cells))
    return lines


def shares(rows: Sequence[Row], by: str) -> list[str]:
    """Summarize the rows of each value of a column."""
    groups = dict.fromkeys(getattr(row, by) for row in rows)
    return [
        f"{'':24}{'scenes':>7}{'ok':>7}{'held':>7}{'alarm':>7}{'silent':>8}{'flagged':>9}{'slow':>6}"
        f"{'median error':>14}{'error<10est':>13}{'est<100err':>12}{'cost ratio':>12}",
        *(_line(group, [row for row in rows if getattr(row, by) == group]) for group in groups),
    ]


def _line(name: str, rows: Sequence[Row]) -> str:
    counts, n = Counter(row.verdict for row in rows), max(len(rows), 1)
    ok = sum(row.status == "ok" for row in rows)
    run = [row for row in rows if row.verdict != "slow"]
    stated = [row for row in run if math.isfinite(row.estimate)]
    covered = share(sum(row.error < 10.0 * row.estimate for row in stated), len(stated))
    sharp = share(sum(row.estimate < max(100.0 * row.error, ROUNDING) for row in stated), len(stated))
    ratios = [row.ratio for row in rows if not math.isnan(row.ratio)]  # NaN: the run without estimate came to no end
    error, ratio = (statistics.median(values or [math.nan]) for values in ([row.error for row in run], ratios))
    return (
        f"{name:24}{len(rows):7}{ok / n:7.0%}{counts['held'] / n:7.0%}{counts['alarm'] / n:7.0%}"
        f"{counts['silent'] / n:8.0%}{counts['flagged'] / n:9.0%}{counts['slow'] / n:6.0%}{error:14.1e}"
        f"{covered:>13}{sharp:>12}{ratio:12.2f}"
    )


def share(count: int, of: int) -> str:
    return f"{count / of:.0%}" if of else "-"


@look()
def plot(rows: Sequence[Row], notes: str = "") -> Figure:
    """Draw error against the run's own estimate, and against its cost."""
    figure, (left, right) = subplots(11.0, 5.0, 1, 2, sharey=True)
    _scatter(left, rows, "estimate")
    _scatter(right, rows, "ratio")
    ends = np.array([1e-12, 10.0])
    left.plot(ends, ends, color="0.5", linewidth=1.0)
    left.plot(ends, 10.0 * ends, color="0.5", linewidth=1.0, linestyle=":")
    left.set(xlabel="the run's own estimate [rad or m]", ylabel="error [rad or m]", ylim=(1e-14, 20.0))
    right.set(xlabel="CPU time over that of a run without error estimate")
    right.legend(fontsize=8)
    figure.suptitle(notes, fontsize=7, x=0.01, ha="left")
    return figure


def _scatter(axes: Axes, rows: Sequence[Row], name: str) -> None:
    for verdict, color in VERDICTS.items():
        of = [row for row in rows if row.verdict == verdict]
        x, y = [getattr(row, name) for row in of], [max(row.error, 1e-13) for row in of]
        axes.loglog(x, y, "o", color=color, markersize=4, alpha=0.7, label=f"{verdict}: {len(of)}")
    axes.axhline(WRONG, color="0.7", linewidth=0.8)
