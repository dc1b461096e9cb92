"""MuJoCo at its best: without what its Python package adds to every step."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def quick_mujoco() -> Iterator[None]:
    """MuJoCo without the clock by which its Python package times every step, and without warnings on the screen."""
    import mujoco

    library = next(Path(mujoco.__file__).parent.glob("libmujoco*"), None)
    clock = ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mjcb_time") if library else ctypes.c_void_p()
    before, clock.value = clock.value, None
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        clock.value = before
        mujoco.set_mju_user_warning(None)
