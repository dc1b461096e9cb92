"""The report of a gait search, and all the files it writes."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import OptimizeResult

from .. import __version__
from ..base.files import Format, moving_up
from ..crosscheck.run import files as crosscheck_files
from ..view.page import write_animation
from ..walking.cost import WalkingCost
from ..walking.feedback import add_feedback
from ..walking.gait_file import ARRAYS, write_angles, write_goal_positions
from ..walking.limits import LIMITS
from .gait_page import write_gait_page
from .measure import servo_in_file, servo_name
from .planning import Start
from .plots import plot_angles, plot_convergence
from .preparation import Job, beside, claimed
from .quality import describe
from .search import AMPLITUDE, MAX_MISS
from .selection import Selected

REPORT = Format("gait report")
STRIDES = 12  # in the files and the animation


def write_report(
    job: Job,
    start: Start,
    result: OptimizeResult,
    found: Selected,
    measured: dict[str, Any],
    began: float,
    searching: float,
) -> dict:
    """Write all files, which appear together when all are complete; return what the JSON file holds.

    measured: what `measure` returns; began: when the job began, of `time.perf_counter` [s]; searching: how long the
    search took [s].
    """
    stem, cost = job.stem, start.cost
    checked = zip(("crosscheck", "crosscheck_table"), crosscheck_files(job.crosscheck))
    with claimed(job.history), _appearing_together(stem) as folder:
        files = write_results(folder / stem.name, cost, result, servo_in_file(job.options.servo))
        if found.walk is not None:
            add_feedback(files["arrays"], found.walk)
        report = {
            "format": str(REPORT),
            "robot": job.model.name,
            "source": job.model.source,
            "joints": cost.gait.joint_names,
            "version": __version__,
            "settings": _settings(job, start, result),
            "search": {
                "candidates": result.nit, "message": result.message, "first": _finite(start.value), "best": result.fun,
                "with_limits_from": result.get("since"),
                "chosen_among": found.candidates,
            },
            **measured,
            # What differs from run to run:
            "evaluations": {"begun": result.nfev, "wasted": result.wasted, "lane_occupancy": _finite(result.occupancy)},
            "seconds": {"search": searching, "all": time.perf_counter() - began},
            "files": {kind: str(stem.parent / path.name) for kind, path in files.items()}
            | {"history": str(job.history)}
            | ({"limits_history": str(beside(job.history, 'limits'))} if "limited" in result else {})
            | {kind: str(path) for kind, path in checked if measured["crosscheck"] and path.exists()},
        }  # fmt: skip
        text = json.dumps(report, indent=2)
        files["report"].write_text(text, encoding="utf-8")
        write_gait_page(files["page"], report, result.history["f"])
    return json.loads(text)


def write_results(stem: Path, cost: WalkingCost, result: OptimizeResult, servo: str = "") -> dict[str, Path]:
    """Write arrays, plots, an animation and the motion for the real robot.

    Parameters
    ----------
    stem : Path
        Path of the files without their endings, in a folder that exists.
    cost : WalkingCost
        The cost that was searched.
    result : scipy.optimize.OptimizeResult
        Of `optimize_gait`.
    servo : str
        Servo in place of the robot's own, as `walking.servo_of` reads it.

    Returns
    -------
    dict of str to Path
        The files by kind.  Those of the kinds "report" and "page" are named, not written: `main_job` does that.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    endings = {
        "report": ".json", "arrays": ".npz", "convergence": "_convergence.png", "angles_plot": "_angles.png",
        "page": "_report.html", "animation": "_animation.html", "angles": "_angles.csv",
        "goal_positions": "_goal_positions.csv",
    }  # fmt: skip
    files = {kind: stem.with_name(stem.name + ending) for kind, ending in endings.items()}
    first, names = cost.gait.to_vector(), cost.gait.joint_names
    motion = cost.reference(result.x, STRIDES)
    np.savez_compressed(
        files["arrays"], format=str(ARRAYS), x=result.x, first=first, period=cost.gait.period, joint_names=names,
        start=cost.start, poses=cost.gait.from_vector(result.x).poses, times=motion.times, angles=motion.values,
        costs=result.history["f"], visited=result.history["x"], first_poses=cost.gait.poses,
        servo=servo,
    )  # fmt: skip
    write_angles(files["angles"], motion.times, motion.values, names)
    write_goal_positions(files["goal_positions"], motion.times, motion.values, names)
    plot_convergence(result).savefig(files["convergence"], dpi=130)
    plot_angles(cost, first, result.x).savefig(files["angles_plot"], dpi=130)
    vectors = {"first gait": first, "optimized gait": result.x}
    runs = cost.simulate(vectors.values(), strides=STRIDES)
    captions = [f"{name}: {describe(m)}" for name, m in zip(vectors, cost.measure(vectors.values()))]
    title = f"{cost.scene.model.name}, {cost.scene.gearbox} servos"
    write_animation(files["animation"], cost.scene.model, dict(zip(captions, runs)), title)
    return files


def _settings(job: Job, start: Start, result: OptimizeResult) -> dict[str, Any]:
    cost, options, scene = start.cost, job.options, start.cost.scene
    return {
        "servo": str(options.servo or servo_name(job.own)), "plan": start.plan,
        "servos": scene.gearbox, "integrator": scene.integrator, "timestep": scene.timestep,
        "ground": scene.ground and asdict(scene.ground), "iterations": options.iterations, "seed": options.seed,
        "max_miss": MAX_MISS, "worlds": options.worlds,
        "states": "stride" if cost.gait.mirror is None else "step",
        "amplitude_deg": math.degrees(AMPLITUDE), "period": cost.gait.period, "poses": len(cost.gait.poses),
        "warm_up_strides": cost.warm_up, "measured_strides": cost.strides, "start_of_measurement": cost.mark,
        "limits": {one.name: one.bound for one in LIMITS} if "limited" in result else None,
    }  # fmt: skip


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


@contextmanager
def _appearing_together(stem: Path) -> Iterator[Path]:
    """Make a folder whose files are moved beside it when all are complete; if they cannot be written, none is."""
    try:
        with moving_up(stem.parent, stem.name + ".partial") as folder:
            yield folder
    except OSError as error:
        raise OSError(
            f"{stem.parent}: the results cannot be written ({error.strerror}); the search is kept in its history: make "
            "room, then resume (--resume)"
        ) from error
