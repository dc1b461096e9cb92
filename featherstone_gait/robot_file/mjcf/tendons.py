"""Read the tendons of a compiled MJCF file.

A fixed tendon has the length sum c q of joints; a spatial one runs through sites and around geoms, and is not
supported.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...base.flaws import quoted

JOINT = 1  # mjWRAP_JOINT


def joints_of(m: Any, t: int) -> dict[int, float]:
    """Return the c of a fixed tendon by joint; none for a spatial one."""
    parts = range(m.tendon_adr[t], m.tendon_adr[t] + m.tendon_num[t])
    if any(m.wrap_type[w] != JOINT for w in parts):
        return {}
    return {int(m.wrap_objid[w]): float(m.wrap_prm[w]) for w in parts}


def effects(m: Any) -> Iterator[str]:
    """Yield one sentence for each effect of tendons that is ignored."""
    acting: dict[str, list[str]] = {}
    for t in range(m.ntendon):
        acts = [what for what in ("stiffness", "damping", "frictionloss", "armature") if nonzero(m, "tendon", what, t)]
        for what in [*acts, *["limit"] * bool(m.tendon_limited[t])]:
            acting.setdefault(what, []).append(m.tendon(t).name or str(t))
    for what, names in acting.items():
        yield f"ignored the {what} of tendons {quoted(names)}: tendons are not supported"


def nonzero(m: Any, kind: str, what: str, k: int) -> bool:
    """Return whether a number of an element, or of the powers that MuJoCo 4 adds to it, is not zero."""
    powers = getattr(m, f"{kind}_{what}poly", None)
    return bool(np.any(getattr(m, f"{kind}_{what}")[k]) or (powers is not None and np.any(powers[k])))
