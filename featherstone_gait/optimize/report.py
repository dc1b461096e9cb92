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
from ..model import Model
from ..view.gait_page import write_gait_page
from ..view.page import write_animation
from ..walking.cost import WalkingCost
from ..walking.feedback import add_feedback
from ..walking.gait_file import ARRAYS, write_angles, write_goal_positions
from ..walking.limits import LIMITS
from .feedback import report_feedback
from .measure import (
    Measured,
    crosscheck_stem,
    floors_of_crosscheck,
    measure_with_own_servos,
    servo_in_file,
    servo_name,
    standby_costs,
)
from .planning import Start
from .plots import plot_angles, plot_convergence
from .preparation import Job, claimed
from .quality import describe, measure_limits
from .search import AMPLITUDE, MAX_MISS, limits_history
from .selection import Selected

REPORT = Format("gait report")
STRIDES = 12  # in the files and the animation


def write_report(
    job: Job, start: Start, result: OptimizeResult, found: Selected, measured: Measured, began: float, searching: float
) -> dict:
    """Write all files, which appear together when all are complete; return what the JSON file holds.

    began: when the job began, of `time.perf_counter` [s]; searching: how long the search took [s].
    """
    stem, cost = job.stem, start.cost
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
            **_measured(job, start, found, measured),
            # What differs from run to run:
            "evaluations": {"begun": result.nfev, "wasted": result.wasted, "lane_occupancy": _finite(result.occupancy)},
            "seconds": {"search": searching, "all": time.perf_counter() - began},
            "files": {kind: str(stem.parent / path.name) for kind, path in files.items()}
            | {"history": str(job.history)}
            | ({"limits_history": str(limits_history(job.history))} if "limited" in result else {})
            | (_crosscheck_files(stem) if measured.crosscheck else {}),
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


def _measured(job: Job, start: Start, found: Selected, measured: Measured) -> dict[str, Any]:
    """Collect the part of the report that was measured."""
    cost, worlds, options = start.cost, measured.test_worlds, job.options
    limits = {
        side: measure_limits(cost, x, start.watch)
        for side, x in (("before", cost.gait.to_vector()), ("after", found.x))
    }
    return {
        "before": measured.before.as_dict(),
        "after": measured.after.as_dict(),
        "elsewhere": worlds and dict(zip(("before", "after"), worlds)),
        **({} if options.servo is None else {"with_own_servos": measure_with_own_servos(job.own, cost)}),
        "feedback": found.walk and report_feedback(cost, found.walk, options.worlds),
        "crosscheck": measured.crosscheck,
        "crosscheck_floors": floors_of_crosscheck(job.stem) if measured.crosscheck else [],
        "plausible": limits | {"servo": _servo_limits(job.model), "not_watched": start.watch.close()},
        "standby": standby_costs(job, measured),
        "baselines": measured.baselines,
        "at_equal_speed": measured.at_equal_speed,
    }


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


def _servo_limits(model: Model) -> str:
    """Describe in words what the servo can take."""
    servo = next((servo for servo in model.servos.values() if servo.voltage_limit < math.inf), None)
    if servo is None:
        return ""
    limit = f", and lets no more than {servo.current_limit:g} A pass" if servo.current_limit < math.inf else ""
    return (
        f"This servo stalls at {servo.voltage_limit / servo.resistance:.2f} A from {servo.voltage_limit:g} V{limit}; "
        "a real AX-12 at 1.5 A from 12 V (its manual), which is for moments: the manual calls motions stable up to a "
        "fifth of the stall torque."
    )


def _crosscheck_files(stem: Path) -> dict[str, str]:
    """Name the files of the crosscheck by kind, if it has written any."""
    paths = crosscheck_files(crosscheck_stem(stem))
    return {kind: str(path) for kind, path in zip(("crosscheck", "crosscheck_table"), paths) if path.exists()}


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
