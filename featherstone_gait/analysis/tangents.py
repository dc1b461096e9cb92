"""Derivatives of a period by tangents: exact to rounding, without runs beside the one that is linearized.

Each column goes through the period as a tangent (core/integrate/adjoint.py).  Deviations become numbers of the state,
and numbers of its end become deviations, by differences of the chart alone, which is no run.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..run.adjoint import Adjoint
from ..run.compiled_run import CompiledRun, RunInput
from .chart import AnyChart

WIDTH = 2e-3  # of the differences of a chart, whose fourth order leaves 1e-12
ROUNDING = 64.0 * np.finfo(float).eps  # of a column


def tangent_columns(
    compiled: CompiledRun, start: RunInput, chart: AnyChart, signals: dict[str, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return derivatives (rows, columns) of deviations at the end and of what is recorded there, their errors, the end.

    signals: how many columns "reference" and "torque" have.
    """
    run = Adjoint(compiled, start)
    run.run()
    size, deviations = len(chart.names), np.eye(len(chart.names))
    states = _slope(lambda h: chart.moved(start.y, h * deviations))
    count = size + sum(signals.values())
    tangents, directions = np.zeros((run.length, count)), np.zeros((run.entries, count))
    tangents[:, :size] = states[0]
    at = size
    for name, width in signals.items():
        slot = next(one for one in run.slots if one.path == ("signals", "torques" if name == "torque" else name))
        entries = slot.first + np.arange(int(np.prod(slot.shape))).reshape(slot.shape)
        for k in range(width):
            directions[entries[:, k, 0], at + k] = 1.0
        at += width
    out, end = run.push(tangents, directions)
    read = _slope(lambda h: chart.difference(run.final[:, None] + h * end, run.final))
    value = np.concatenate([read[0], out[-1]])
    error = ROUNDING * np.abs(value) + ROUNDING * np.abs(value).max(axis=1, keepdims=True)
    error[: len(read[0])] += read[1]
    return value, error, run.final


def _slope(f: Callable[[float], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivative of f at 0 by central differences of fourth order, and about its error."""
    wide, narrow = (0.5 * (f(h) - f(-h)) / h for h in (WIDTH, 0.5 * WIDTH))
    return narrow + (narrow - wide) / 3.0, WIDTH**2 * np.abs(narrow - wide)
