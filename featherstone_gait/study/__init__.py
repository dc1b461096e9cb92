"""Run parameter studies: the same experiment many times, with a row of a table for each run.

A study is a TOML file (`settings`) that names a robot, an experiment (`measures`) and the parameters that vary::

    robot = "arm7"
    experiment = "hold"                              # "walk" or "stable_step"
    duration = 20.0                                  # [s]

    [scene]                                          # parameters of all runs
    gearbox = "mipsd"

    [vary]                                           # parameters that differ
    scene.integrator = ["implicit_euler", "midpoint"]
    gearbox.ratio = [127.0, 254.0]
    servo.Kp = {from = 10.0, to = 100.0, count = 10, scale = "log"}

    [sampling]                                       # by default the grid of all values
    method = "latin_hypercube"                       # or "random", or "saltelli" for Sobol's indices
    count = 1000
    seed = 1

    [worlds]                                         # random numbers of each run, see `draws`
    links.mass = {kind = "uniform", scale = 0.1}

``featherstone-gait study FILE.toml``, or in Python ``run_study(read_study("FILE.toml"), "results")``, writes
``FILE.csv`` and ``FILE.png``.  Finished runs are kept in ``FILE.jsonl``: an interrupted study continues from there when
it is started again, and its table has the same bytes as without the interruption.

Any `concurrent.futures.Executor` can run a study; the table does not depend on it.  Kernels release the GIL, so the
default, a thread for each core, is the fastest on one machine.  With [worlds], scenes are made in Python, and the
command uses processes instead (`base.processes.process_pool`).  For several machines use dask.distributed (the extra
`cluster`), here with two worker processes on one machine::

    from distributed import Client, LocalCluster

    one = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    local = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:8787"}  # where nobody else can send tasks
    with LocalCluster(n_workers=2, threads_per_worker=1, env=one, **local) as cluster, Client(cluster) as client:
        run_study(read_study("FILE.toml"), "results", executor=client.get_executor(), batch=64)

or, if a scheduler is running, ``featherstone-gait study FILE.toml --cluster tcp://10.0.0.1:8786``.  Workers need the
same version of this package, but no robot files: the robot is sent with the task.  If a worker dies, another one gets
its batch.  Give each worker one thread per core, and keep its numeric libraries from starting threads, as above.
"""

from .run import run_study
from .settings import Study, read_study

__all__ = ["Study", "read_study", "run_study"]
