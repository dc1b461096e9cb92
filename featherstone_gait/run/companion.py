"""The error of a run, told by a companion: the same run to a coarser tolerance.

Where the tolerance orders the errors, those of the companion are `COARSER` times as large, and the difference of both
is some nine errors of the run.  Kinks and chaos leave less between them; hence a larger `SHARE` of it than a ninth is
taken for the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..build.scene import CompiledScene
from ..trajectory import Trajectory, with_error

COARSER = 10.0  # tolerance of the companion, by the run's
SHARE = 0.25  # of the difference, that is taken for the error
ROUNDING = 1e-13  # of the values, below which no error is told
LIMIT = 1e-3  # of angles [rad], positions [m] and, of the largest there is or 1, speeds: beyond it a run is inaccurate


def coordinates(scene: CompiledScene) -> tuple[str, ...]:
    """The channels that are judged."""
    base = ("base_q", "base_qd") if scene.model.base == "floating" else ()
    return ("q", "qd", *base)


def accounted(run: Trajectory, companion: Trajectory, record: Sequence[str]) -> Trajectory:
    """The run with its error; inaccurate if that is too large; only what is to be recorded is kept."""
    told = with_error(run, companion, SHARE)
    error = {name: e + ROUNDING * np.abs(run[name]) for name, e in (told.error or {}).items()}
    wrong = _inaccurate(run, error) if run.ok else None
    status, message = wrong or (run.status, run.message)
    return replace(
        run,
        channels={name: values for name, values in run.channels.items() if name == "time" or name in record},
        error={name: values for name, values in error.items() if name in record},
        status=status,
        message=message,
        companion=companion.final,
    )


def _inaccurate(run: Trajectory, error: dict[str, np.ndarray]) -> tuple[str, str] | None:
    """Status and message of a run whose error is beyond the limit, from the first record on where it is."""
    found = []
    for name, limit, unit in (("q", LIMIT, "rad or m"), ("base_q", LIMIT, "m or -"), ("qd", 0.0, "rad/s or m/s"),
                              ("base_qd", 0.0, "m/s or rad/s")):  # fmt: skip
        if name in error and error[name].size:
            limit = limit or LIMIT * max(float(np.abs(run[name]).max()), 1.0)
            beyond = (error[name] > limit).any(axis=1)
            if beyond.any():
                found.append((int(beyond.argmax()), name, limit, unit))
    if not found:
        return None
    k, name, limit, unit = min(found)
    column = int(error[name][k].argmax())
    what = run.info["joints"][column] if name in ("q", "qd") else f"number {column} of {name}"
    return "inaccurate", (
        f"{run.info['robot']}: from {run['time'][k]:.4g} s on {name} of {what} is uncertain by "
        f"{error[name][k, column]:.2g} {unit} (limit {limit:.2g}): give a smaller rtol than {run.info['rtol']:g}; if "
        "that does not help, the motion is chaotic and cannot be told so far ahead"
    )
