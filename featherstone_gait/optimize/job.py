"""The main job: from a robot to a cheaper gait and all its files.

    report = main_job("humanoid", OptimizeOptions(iterations=800, seed=0))

The stages are `planning`, `search`, `selection`, `measure` and `report`, a file each.
"""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import replace
from typing import Any

from ..base import deprecated
from ..base.arguments import instance
from ..base.files import FilePath
from ..base.progress import WholeJob
from .measure import measure
from .options import OptimizeOptions
from .planning import plan_start
from .preparation import prepare
from .report import write_report
from .search import search
from .selection import select
from .summary_table import summary

RENAMED = {  # keywords of `main_job` until 0.1, whose names in `OptimizeOptions` are others
    "servos": "gearbox", "unseen": "test_worlds", "electronics": "electronics_power", "holding": "holding_power",
    "fair": "baselines",
}  # fmt: skip


def main_job(robot: FilePath = "humanoid", options: OptimizeOptions | None = None, **old: Any) -> dict:
    """Optimize a robot's gait and write all files into the output folder.

    The search can be interrupted (KeyboardInterrupt): the files then hold the best gait so far, measured on the robot's
    own ground alone.  A process that is killed leaves the history, from which it resumes to the same files; these
    appear only when all of them are complete.

    Parameters
    ----------
    robot : str or path
        A name or a robot file, as in `load_robot`; "humanoid" is the paper's simplified one.
    options : OptimizeOptions, optional
        The options of the search.
    **old
        Options as keywords: deprecated, until version 0.4.

    Returns
    -------
    dict
        What the JSON file of the report holds.

    Raises
    ------
    ValueError
        If no gait walks, or the history is of another robot.
    FileExistsError
        If there is a history and `resume` is not set.
    OSError
        If files cannot be written or another process is at work with the history; if possible before the search.
    ImportError
        If a crosscheck is asked for without MuJoCo.
    """
    began = time.perf_counter()
    instance("options", options, (OptimizeOptions, type(None)), "give OptimizeOptions(...)")
    options = options or OptimizeOptions()
    if old:
        deprecated.warn(f"main_job({', '.join(old)}=...)", "main_job(robot, OptimizeOptions(...))")
        options = replace(options, **{RENAMED.get(name, name): value for name, value in old.items()})
    job = prepare(robot, options)
    with closing(WholeJob(job.seconds, options.progress)) as whole:
        with whole.stage("first gait"):
            start = plan_start(job)
        searching = time.perf_counter()
        with whole.stage("search", 1 + (options.worlds > 0 and options.limits)):
            result = search(job, start)
        searching = time.perf_counter() - searching
        with whole.stage("selection"):
            found = select(job, start, result)
        result.x = found.x
        with whole.stage("measurement"):
            measured = measure(job, start, result, found)
        with whole.stage("files"):
            report = write_report(job, start, result, found, measured, began, searching)
    job.print(summary(report))
    return report
