"""Describe the machine that a benchmark runs on."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
from pathlib import Path

from ..core.compile.jit import instruction_set

PACKAGES = {"numpy": "numpy", "scipy": "scipy", "numba": "numba", "llvmlite": "llvmlite"}
PACKAGES |= {"mujoco": "mujoco", "pinocchio": "pin"}  # module: name under which it is installed


def machine() -> str:
    """Return processor and versions, one line each."""
    found = [name for module, name in PACKAGES.items() if importlib.util.find_spec(module)]
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in found)
    return (
        f"{_processor()}, {os.cpu_count()} cores, {instruction_set()}, {platform.system()} {platform.machine()}\n"
        f"Python {platform.python_version()}, {versions}"
    )


def _processor() -> str:
    """Return the name of the processor, which Linux states in a file only."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown processor"
