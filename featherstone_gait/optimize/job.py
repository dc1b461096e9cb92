"""The main job: from a robot to a cheaper gait and all its files.

    report = main_job("humanoid", OptimizeOptions(iterations=800, seed=0))

The stages are `planning`, `search`, `selection`, `measure` and `report`, a file each.
"""

from __future__ import annotations

import time
from contextlib import closing

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


def main_job(robot: FilePath = "humanoid", options: OptimizeOptions | None = None) -> dict:
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
