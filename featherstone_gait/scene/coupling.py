"""Build the couplings of joints that follow others, and positions that agree with them."""

from __future__ import annotations

import numpy as np

from ..core.tree.coupling import COUPLING
from ..model import Model
from .records import records

AGREEMENT = 1e-9  # how far a follower may be from where its leader wants it [rad or m; rad/s or m/s]


def build_coupling(model: Model, rows: dict[str, int], first: int) -> np.recarray | None:
    """Build the COUPLING records, None without coupled joints.

    rows: bodies by the joints that move them; first: row of the workspace of the first coupling.
    """
    dof, table = model.joint_rows, records(len(model.couplings), COUPLING)
    for k, (row, (follower, leader, multiplier, offset)) in enumerate(zip(table, model.couplings)):
        row.body, row.dof = rows[follower], dof[follower]
        row.leader, row.leader_dof = rows[leader], dof[leader]
        row.row, row.multiplier, row.offset = first + k, multiplier, offset
    return table if len(table) else None


def followed(coupling: np.recarray | None, joints: np.ndarray) -> np.ndarray:
    """Return positions of the joints (n,) [rad or m] in which followers are where their leaders put them."""
    joints = joints.copy()
    for k in () if coupling is None else coupling:
        joints[k.dof] = k.multiplier * joints[k.leader_dof] + k.offset
    return joints


def check_followers(model: Model, coupling: np.recarray | None, q: np.ndarray, qd: np.ndarray) -> None:
    """Raise ValueError unless followers have the positions q (n,) and velocities qd (n,) that their leaders ask for."""
    if coupling is None:
        return
    names = model.joint_names
    for k in coupling:
        for what, unit, x, offset in (("q", "", q, k.offset), ("qd", "/s", qd, 0.0)):
            wanted = k.multiplier * x[k.leader_dof] + offset
            if not abs(x[k.dof] - wanted) <= AGREEMENT * max(1.0, abs(wanted)):
                kind = "m" if model.moving_joints[k.dof].type == "prismatic" else "rad"
                raise ValueError(
                    f"{model.name}: {what} of joint {names[k.dof]} is {float(x[k.dof])!r} {kind}{unit}, but it follows "
                    f"{names[k.leader_dof]}: give {float(wanted)!r} {kind}{unit}, or another {what} of the latter"
                )
