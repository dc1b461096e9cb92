"""Copy constants from the dataclasses of the model to the records of the kernels, by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def records(count: int, dtype: np.dtype) -> np.recarray:
    """Make zeroed records whose fields kernels can read as attributes without JIT."""
    return np.zeros(count, dtype).view(np.recarray)


def fill(record: np.void, *sources: object) -> None:
    """Copy to each field the number of that name, from the first source that has one."""
    for name in record.dtype.names or ():
        for source in sources:
            value = getattr(source, name, "")
            if not isinstance(value, str):
                record[name] = value
                break


def filled(dtype: np.dtype, sources: Sequence[tuple | None]) -> np.recarray:
    """Make a record for each of the tuples of sources, as `fill` does; zeros for None."""
    table = records(len(sources), dtype)
    for row, given in zip(table, sources):
        fill(row, *given or ())
    return table
