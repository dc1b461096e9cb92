"""Run a parameter study, or continue one that was interrupted.

Writes FILE.csv (one row per run), .png (summary) and .jsonl (finished runs, to continue from).

Takes as long as the progress bar estimates; Ctrl-C keeps finished runs.  Exit code 1 if a run is not ok.

  featherstone-gait study notebooks/stability_study.toml --out results
  featherstone-gait study notebooks/unit_study.toml --out results
  featherstone-gait study FILE.toml --cluster tcp://10.0.0.1:8786 --batch 64
"""

from __future__ import annotations

import time
from argparse import Namespace
from pathlib import Path
from typing import Any

from .arguments import Commands, add_command, add_quiet


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    file = "the study; help('featherstone_gait.study') in Python lists its settings"
    parser.add_argument("file", type=Path, metavar="FILE.toml", help=file)
    parser.option("--batch", "runs per batch (default: 8, in large studies 64)", type=int, metavar="N")
    cluster = "run on the dask scheduler at this address (default: on this machine's cores)"
    parser.option("--cluster", cluster, metavar="ADDRESS")
    parser.option("--parquet", "also write FILE.parquet (needs pandas and pyarrow)", False)
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..base.processes import process_pool
    from ..study import read_study, run_study
    from ..study.run import cores

    study = read_study(args.file)
    start = time.perf_counter()
    options = {"batch": args.batch, "progress": True, "parquet": args.parquet}
    if args.cluster is not None:
        with _cluster(args.cluster) as client:
            outcome = run_study(study, args.out, executor=client.get_executor(), **options)
    elif study.setup.draws:  # each run's scene is made in Python, where threads would wait for each other
        with process_pool(cores()) as pool:
            outcome = run_study(study, args.out, executor=pool, **options)
    else:
        outcome = run_study(study, args.out, **options)
    seconds = time.perf_counter() - start
    print(f"{study.name}: {len(study)} runs, {outcome.computed} of them now in {seconds:.3g} s")
    print("status: " + ", ".join(f"{status} {count}" for status, count in outcome.statuses.items()))
    wrong = len(study) - outcome.statuses.get("ok", 0)
    if wrong:
        print(f"{wrong} of {len(study)} rows are not ok; the table is complete, and the messages of these rows say why")
    files = [outcome.table, outcome.picture, outcome.table.with_suffix(".jsonl")]
    files += [outcome.sensitivity] if outcome.sensitivity else []
    print("files: " + ", ".join(map(str, files)))
    return 1 if wrong else 0


def _cluster(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise ValueError('--cluster needs dask: pip install "featherstone-gait[cluster]"') from error
    return Client(address)
