"""Scenes of one structure, whose numbers differ: which may share lanes, and their constants lane by lane.

A number that differs between scenes is told from those that all share by its bits.  What varies is `Varying`, in memory
that `put` fills with the constants of the scene whose run a lane takes; the rest all lanes share.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np

from ..core.compile.lanes import WIDTH, aligned
from ..core.compile.varying import Varying, lane_dtype, lane_records, of_lanes
from ..core.integrate.rollout import NEVER
from ..core.step.context import Plan


def structure(constants: Any) -> Hashable:
    """What scenes that share lanes have in common: what there is, how many of each, and all whole numbers."""
    if isinstance(constants, tuple):
        return type(constants), *map(structure, constants)
    if not isinstance(constants, np.ndarray):
        return constants
    names = constants.dtype.names
    parts = [constants] if names is None else [constants[name] for name in names]
    return constants.shape, constants.dtype, *(part.tobytes() for part in parts if part.dtype.kind != "f")


def course(plan: Plan) -> Hashable:
    """What plans have in common whose runs share lanes: all but the lag, and how low a robot has fallen."""
    return plan._replace(lag=0.0, min_height=float(plan.min_height > NEVER))


def together(parts: Sequence[Any]) -> Any:
    """The constants of some scenes of one structure in one: what differs between them is `Varying`, and still zero."""
    first = parts[0]
    if all(part is first for part in parts):
        return first
    if isinstance(first, tuple):
        return type(first)(*map(together, zip(*parts)))
    if not isinstance(first, np.ndarray):
        return first if len(set(parts)) == 1 else Varying(aligned(WIDTH))
    names = first.dtype.names
    if names is None:
        return Varying(aligned((*first.shape, WIDTH))) if _differ(parts) else first
    varying = [name for name in names if _differ([part[name] for part in parts])]
    if not varying:
        return first
    table = lane_records(len(first), lane_dtype(first.dtype, varying))
    for name in set(names) - set(varying):
        table[name] = first[name]
    return Varying(table)


def _differ(arrays: Sequence[np.ndarray]) -> bool:
    """Whether arrays of one shape have different bits."""
    bits = {array.tobytes() for array in arrays}
    return len(bits) > 1


def of_own_lanes(x: Any) -> Any:
    """The same with what is `Varying` in memory of its own, aligned."""
    if isinstance(x, Varying):
        values = x.values
        fresh = aligned(values.shape) if values.dtype.names is None else lane_records(len(values), values.dtype)
        fresh[...] = values
        return Varying(fresh)
    return type(x)(*map(of_own_lanes, x)) if has_varying(x) else x


def has_varying(x: Any) -> bool:
    """Whether something in it is `Varying`."""
    return isinstance(x, Varying) or (isinstance(x, tuple) and any(map(has_varying, x)))


def put(x: Any, lane: int, part: Any) -> None:
    """Write a scene's constants, or other numbers, into a lane of what is `Varying` in x."""
    if not isinstance(x, Varying):
        for inner, own in zip(x, part) if has_varying(x) else ():
            put(inner, lane, own)
    elif x.values.dtype.names is None:
        x.values[..., lane] = part
    else:
        for name in x.values.dtype.names:
            if of_lanes(x.values.dtype[name]):
                x.values[name][..., lane] = part[name]
