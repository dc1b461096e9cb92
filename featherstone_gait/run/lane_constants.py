"""Scenes of one structure whose numbers differ: which may share lanes, and their constants lane by lane.

Numbers that all scenes share bit for bit stay as they are.  Numbers that differ become `Varying`, in memory that
`write_lane` fills with the constants of the scene whose run occupies a lane.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np

from ..core.compile.lanes import WIDTH, aligned
from ..core.compile.varying import Varying, lane_dtype, lane_records, varying_fields


def structure(constants: Any) -> Hashable:
    """Return what scenes that share lanes have in common: the kinds and counts of parts, and all whole numbers."""
    if isinstance(constants, tuple):
        return type(constants), *map(structure, constants)
    if not isinstance(constants, np.ndarray):
        return constants
    names = constants.dtype.names
    parts = [constants] if names is None else [constants[name] for name in names]
    return constants.shape, constants.dtype, *(part.tobytes() for part in parts if part.dtype.kind != "f")


def numbers_in(constants: Any) -> bytes:
    """Return all numbers of a scene's constants, for digests."""
    if isinstance(constants, tuple):
        return b"(" + b",".join(map(numbers_in, constants)) + b")"
    return constants.tobytes() if isinstance(constants, np.ndarray) else repr(constants).encode()


def merge(parts: Sequence[Any], width: int = WIDTH) -> Any:
    """Merge the constants of scenes of one structure; what differs between them is `Varying`, and still zero.

    width: of the axis of what varies.
    """
    first = parts[0]
    if all(part is first for part in parts):
        return first
    if isinstance(first, tuple):
        return type(first)(*(merge(each, width) for each in zip(*parts)))
    if not isinstance(first, np.ndarray):
        return first if len(set(parts)) == 1 else Varying(aligned(width))
    names = first.dtype.names
    if names is None:
        return Varying(aligned((*first.shape, width))) if _differ(parts) else first
    varying = [name for name in names if _differ([part[name] for part in parts])]
    if not varying:
        return first
    table = lane_records(len(first), lane_dtype(first.dtype, varying, width))
    for name in set(names) - set(varying):
        table[name] = first[name]
    return Varying(table)


def _differ(arrays: Sequence[np.ndarray]) -> bool:
    """Return whether arrays of one shape have different bits."""
    return len({array.tobytes() for array in arrays}) > 1


def has_varying(x: Any) -> bool:
    """Return whether something in x, at any depth, is `Varying`."""
    return isinstance(x, Varying) or (isinstance(x, tuple) and any(map(has_varying, x)))


def with_own_memory(x: Any) -> Any:
    """Return x with what is `Varying` copied into aligned memory of its own."""
    if isinstance(x, Varying):
        values = x.values
        fresh = aligned(values.shape) if values.dtype.names is None else lane_records(len(values), values.dtype)
        fresh[...] = values
        return Varying(fresh)
    return type(x)(*map(with_own_memory, x)) if has_varying(x) else x


def write_lane(x: Any, lane: int, part: Any) -> None:
    """Write a scene's constants, or other numbers, into a lane of what is `Varying` in x."""
    if not isinstance(x, Varying):
        for inner, own in zip(x, part) if has_varying(x) else ():
            write_lane(inner, lane, own)
    elif x.values.dtype.names is None:
        x.values[..., lane] = part
    else:
        values, own = x.values.view(np.ndarray), part.view(np.ndarray)  # whose fields come ten times as fast
        for name in varying_fields(values.dtype):
            values[name][..., lane] = own[name]
