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


def lane_dtype(dtype: np.dtype, names: Collection[str], width: int = WIDTH) -> np.dtype:
    """Return the dtype of records of which the named fields have a last axis of lanes, on whole vectors.

    Their titles tell them from others.  width: of that axis.
    """
    varying, shared = ([name for name in dtype.names if (name in names) == varies] for varies in (True, False))
    formats, offsets, end = [], [], 0
    for name in (*varying, *shared):
        one, shape = dtype[name].base, dtype[name].shape
        each = ALIGNMENT if name in names else one.alignment
        formats.append((one, (*shape, width) if name in names else shape))
        offsets.append(-(-end // each) * each)
        end = offsets[-1] + np.dtype(formats[-1]).itemsize
    size = -(-end // ALIGNMENT) * ALIGNMENT
    titles = [f"{name} varies" for name in varying] + [None] * len(shared)
    table = {
        "names": [*varying, *shared], "titles": titles, "formats": formats, "offsets": offsets, "itemsize": size
    }  # fmt: skip
    return np.dtype(table, align=True)


def lane_records(count: int, dtype: np.dtype) -> np.recarray:
    """Return `count` records of a `lane_dtype`, all zero, in aligned memory."""
    return aligned(count * dtype.itemsize // 8).view(dtype).view(np.recarray)


def varying_fields(dtype: np.dtype) -> list[str]:
    """Return the names of the fields of a `lane_dtype` that vary."""
    assert dtype.names is not None
    assert dtype.fields is not None
    return [name for name in dtype.names if len(dtype.fields[name]) == 3]


class WideRecord(types.Record):
    """The Numba type of a record of a `lane_dtype`, whose numbers by lane are values of a type.

    record: Numba's type of it as plain memory.
    """

    def __init__(self, record, kind):
        self.fields = {
            name: field._replace(type=_wide(field.type, kind)) if field.title else field
            for name, field in record.fields.items()
        }
        self.size, self.aligned, self.bitwidth = record.size, record.aligned, 8 * record.size
        types.Type.__init__(self, f"{kind}{record.name}")


def _wide(field, kind):
    return types.NestedArray(kind, field.shape[:-1]) if field.ndim > 1 else kind


register_model(WideRecord)(RecordModel)


def _viewing_records(kind):
    """Make an intrinsic that views an array of records as one of `WideRecord`."""

    @intrinsic
    def view(typingctx, table):
        seen = types.Array(WideRecord(table.dtype, kind), 1, "C")

        def codegen(context, builder, sig, args):
            source = context.make_array(sig.args[0])(context, builder, args[0])
            result = context.make_array(seen)(context, builder)
            for name in ("shape", "strides", "itemsize", "nitems"):
                setattr(result, name, getattr(source, name))
            result.data = builder.bitcast(source.data, result.data.type)
            return result._getvalue()

        return seen(table), codegen

    return view


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
        return _values(value) if name in varying_fields(self.record.dtype) else value


def _values(array):
    """View an array of lanes, or copy the single value of lanes that it is."""
    return array.copy().view(LaneValue) if array.ndim == 1 else as_lanes(array)


def varies(kind) -> bool:
    """Return whether something in a Numba type is `Varying`."""
    return isinstance(kind, StructureType) and (kind.instance_class is Varying or any(map(varies, kind.types)))


def varying_viewer(of_array, kind, by_hand):
    """Make a function that views the `Varying` parts of what lanes share, at any depth, and leaves the rest as it is.

    of_array: what views an array; kind: the Numba type of its values; by_hand: what views values with the JIT off.
    """

    def seen(x):
        if isinstance(x, Varying):
            return by_hand(x.values)
        if isinstance(x, tuple) and hasattr(x, "_fields"):
            return type(x)(*map(seen, x))
        return x

    as_records = _viewing_records(kind)

    @overload(seen, jit_options=INNER)
    def _seen(x):
        if not varies(x):
            return lambda x: x
        if x.instance_class is not Varying:
            fields = ", ".join(
                f"seen(x.{name})" if varies(kind) else f"x.{name}" for name, kind in zip(x.fields, x.types, strict=True)
            )
            scope = {"kind": x.instance_class, "seen": seen}
            exec(f"def view(x): return kind({fields})", scope)  # Numba loops over no fields of different types
            return scope["view"]
        (values,) = x.types
        if isinstance(values.dtype, types.Record):
            return lambda x: as_records(x.values)
        if values.ndim == 1:
            return lambda x: of_array(x.values)[()]
        return lambda x: of_array(x.values)

    return seen


varying_in_lanes = varying_viewer(
    as_lanes, Lanes, lambda values: LaneRecords(values) if values.dtype.names else _values(values)
)
