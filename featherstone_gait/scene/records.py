"""Constants go from a dataclass of the model to a record of the kernels by their name."""

from __future__ import annotations

import numpy as np


def records(count: int, dtype: np.dtype) -> np.recarray:
    """That many records of zeros; kernels without JIT read their fields as attributes."""
    return np.zeros(count, dtype).view(np.recarray)


def fill(record: np.void, *sources: object) -> None:
    """Give each field the number of that name, from the first source that has one."""
    for name in record.dtype.names or ():
        for source in sources:
            value = getattr(source, name, "")
            if not isinstance(value, str):
                record[name] = value
                break
