"""Constants that differ by lane: the same records and arrays, in which some numbers are eight.

A scene's constants are records and arrays of numbers that all lanes share.  Where lanes are to differ, `Varying` holds
a table of records of the same names, whose dtype `lane_dtype` gives the fields that vary a last axis of lanes; or an
array, or one number, with a last axis of lanes.  `in_lanes` makes of it what kernels read like any other constant:
`motor[i].resistance` is a value of lanes if it varies, else a number, which one load gives to all lanes.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numba import types
from numba.core.datamodel.models import RecordModel
from numba.extending import intrinsic, overload, register_model

from .jit import INNER
from .lanes import WIDTH, Lanes, LaneValue, aligned, as_lanes
from .structure import StructureType, structure

ALIGNMENT = 8 * WIDTH  # of a value of lanes [bytes]


@structure
class Varying(NamedTuple):
    """Constants of eight lanes: records of a `lane_dtype`, or numbers whose last axis is that of the lanes."""

    values: np.ndarray


def lane_dtype(dtype: np.dtype, names: Collection[str]) -> np.dtype:
    """Return the dtype of records of which the named fields have a last axis of lanes, on whole vectors."""
    varying, shared = ([name for name in dtype.names if (name in names) == varies] for varies in (True, False))
    formats, offsets, end = [], [], 0
    for name in (*varying, *shared):
        one, shape = dtype[name].base, dtype[name].shape
        each = ALIGNMENT if name in names else one.alignment
        formats.append((one, (*shape, WIDTH) if name in names else shape))
        offsets.append(-(-end // each) * each)
        end = offsets[-1] + np.dtype(formats[-1]).itemsize
    size = -(-end // ALIGNMENT) * ALIGNMENT
    table = {"names": [*varying, *shared], "formats": formats, "offsets": offsets, "itemsize": size}
    return np.dtype(table, align=True)


def lane_records(count: int, dtype: np.dtype) -> np.recarray:
    """Return `count` records of a `lane_dtype`, all zero, in aligned memory."""
    return aligned(count * dtype.itemsize // 8).view(dtype).view(np.recarray)


def of_lanes(kind: np.dtype) -> bool:
    """Return whether a field's type is that of numbers by lane: no other has so long a last axis."""
    return kind.shape[-1:] == (WIDTH,)


class LaneRecord(types.Record):
    """The Numba type of a record of a `lane_dtype`, whose numbers by lane are values of lanes.

    record: Numba's type of it as plain memory.
    """

    def __init__(self, record):
        self.fields = {name: field._replace(type=_lanes_of(field.type)) for name, field in record.fields.items()}
        self.size, self.aligned, self.bitwidth = record.size, record.aligned, 8 * record.size
        types.Type.__init__(self, f"Lane{record.name}")


def _lanes_of(kind):
    if not isinstance(kind, types.NestedArray) or kind.shape[-1] != WIDTH:
        return kind
    return types.NestedArray(Lanes, kind.shape[:-1]) if kind.ndim > 1 else Lanes


register_model(LaneRecord)(RecordModel)


@intrinsic
def _records_in_lanes(typingctx, table):
    view = types.Array(LaneRecord(table.dtype), 1, "C")

    def codegen(context, builder, sig, args):
        source = context.make_array(sig.args[0])(context, builder, args[0])
        result = context.make_array(view)(context, builder)
        for name in ("shape", "strides", "itemsize", "nitems"):
            setattr(result, name, getattr(source, name))
        result.data = builder.bitcast(source.data, result.data.type)
        return result._getvalue()

    return view(table), codegen


class LaneRecords:
    """With the JIT off: records of a `lane_dtype`, whose numbers by lane are values of lanes."""

    def __init__(self, table):
        self.table = table

    def __len__(self):
        return len(self.table)

    def __getitem__(self, i):
        return _Fields(self.table[i])


class _Fields:
    def __init__(self, record):
        self.record = record

    def __getattr__(self, name):
        value = self.record[name]
        return _values(value) if of_lanes(self.record.dtype[name]) else value


def _values(array):
    """View an array of lanes, or copy the single value of lanes that it is."""
    return array.copy().view(LaneValue) if array.ndim == 1 else as_lanes(array)


def varying_in_lanes(x):
    """View the `Varying` parts of what lanes share as lanes, at any depth, and leave the rest as it is."""
    if isinstance(x, Varying):
        return LaneRecords(x.values) if x.values.dtype.names else _values(x.values)
    if isinstance(x, tuple) and hasattr(x, "_fields"):
        return type(x)(*map(varying_in_lanes, x))
    return x


def varies(kind) -> bool:
    """Return whether something in a Numba type is `Varying`."""
    return isinstance(kind, StructureType) and (kind.instance_class is Varying or any(map(varies, kind.types)))


@overload(varying_in_lanes, jit_options=INNER)
def _varying_in_lanes(x):
    if not varies(x):
        return lambda x: x
    if x.instance_class is not Varying:
        fields = ", ".join(
            f"seen(x.{name})" if varies(kind) else f"x.{name}" for name, kind in zip(x.fields, x.types, strict=True)
        )
        scope = {"kind": x.instance_class, "seen": varying_in_lanes}
        exec(f"def view(x): return kind({fields})", scope)  # Numba loops over no fields of different types
        return scope["view"]
    (values,) = x.types
    if isinstance(values.dtype, types.Record):
        return lambda x: _records_in_lanes(x.values)
    if values.ndim == 1:
        return lambda x: as_lanes(x.values)[()]
    return lambda x: as_lanes(x.values)
