"""Parameter studies: the same experiment many times, one row of a table for each run.

A study is a TOML file (`settings`) that names a robot, an experiment (`measures`) and what varies::

    robot = "arm7"
    experiment = "hold"                              # "walk" or "stable_step"
    duration = 20.0                                  # [s]

    [scene]                                          # what holds for all runs
    servos = "mipsd"

    [vary]                                           # what differs between them
    scene.integrator = ["implicit_euler", "midpoint"]
    servo.Kp = {from = 10.0, to = 100.0, count = 10, scale = "log"}

    [sampling]                                       # without it: the grid of all values
    method = "latin_hypercube"                       # or "random", or "saltelli" for Sobol's indices
    count = 1000
    seed = 1

    [worlds]                                         # what each run draws for itself, see `draws`
    links.mass = {law = "uniform", width = 0.1}

``featherstone-gait study FILE.toml``, or in Python ``run_study(read_study("FILE.toml"), "results")``, writes
``FILE.csv`` and ``FILE.png``.  Finished runs are kept in ``FILE.jsonl``: whatever ends a study, started again it goes
on from there, to the same table to the last byte.

Runs go through any `concurrent.futures.Executor`, and the table does not depend on which.  Kernels release the GIL, so
that the default, a thread for each core, is also the fastest on one machine; but not with [worlds], whose scenes are
made in Python: there the command takes processes, of which `processes.process_pool` makes an executor.  On several
machines use dask.distributed (the extra `cluster`), here with two worker processes on this one::

    from distributed import Client, LocalCluster

    one = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    with LocalCluster(n_workers=2, threads_per_worker=1, env=one) as cluster, Client(cluster) as client:
        run_study(read_study("FILE.toml"), "results", executor=client.get_executor(), batch=64)

or, with a scheduler that is running, ``featherstone-gait study FILE.toml --cluster tcp://HOST:8786``.  Workers need the
same version of this package and no robot files: the robot goes with the task.  A batch whose worker dies is given to
another one.  Give each worker one thread a core and let its numeric libraries start none of their own, as above.
"""

from .run import run_study
from .settings import Study, read_study

__all__ = ["Study", "read_study", "run_study"]
