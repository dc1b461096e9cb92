"""Entries whose compiled code is kept as long as the sources of this package are the same.

The cache of `core` lies in a folder of its own sources' hash; these kernels are not among them, so that their hash is
the stamp by which Numba's index tells what is stale.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...core.compile.jit import entry
from ...core.compile.sealed import SealedFiles


def own_entry(function: Callable[..., Any]) -> Any:
    """`entry` for functions of this package, whose arguments are arrays and structures of `core`."""
    made = entry(function)
    cache: Any = getattr(made, "_cache", None)
    if getattr(cache, "_cache_file", None) is not None:
        cache._cache_file = SealedFiles(cache.cache_path, cache._impl.filename_base, _stamp())
    return made


def _stamp() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()
