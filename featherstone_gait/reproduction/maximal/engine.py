"""Settings of the maximal-coordinate engine, and a step of it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ...base.arguments import real, truth, whole
from ...core.compile.jit import kernel
from ...scene.records import records
from .bodies import apply_torques, load, move, refresh
from .contact import contact_rows
from .direct import solve
from .psor import relax
from .rows import finish_rows, joint_rows


@dataclass(frozen=True)
class Engine:
    """Settings of the engine; the defaults are those with which SimTwo ran ODE's QuickStep in 2012.

    Attributes
    ----------
    iterations : int
        Sweeps of the projected successive over-relaxation; 0 solves the same problem directly, as ODE's dWorldStep.
    shuffle_every : int
        Sweeps between two shuffles of the rows, the first one at the start of a step; 0: never.
    relaxation : float
        Over-relaxation; 1 is Gauss-Seidel.
    erp : float
        Share of a position error that a step corrects.
    cfm, soft_cfm : float
        Compliance of constraints, and of contacts along the normal [m/(s N) or rad/(s N m)].
    bounce : float
        Coefficient of restitution.
    bounce_speed : float
        Speed above which a contact bounces [m/s].
    linear_damping, angular_damping : float
        Share of a velocity that a step removes.
    damping_threshold : float
        Speed above which damping acts [m/s and rad/s].
    single : bool
        Round positions, velocities and constraint forces to single precision.
    gyroscopic : bool
        Include gyroscopic moments.
    per_step : bool
        Slew and filter of a servo act per step as at 1 ms; False: per second.
    hardening : float
        Of a gearbox's spring, K (1 + hardening |e|) e [1/rad].
    damper_share : float
        Rotor speed that a gearbox's damper may change in a step [rad/s].

    Raises
    ------
    ValueError
        For a number out of its range.
    """

    iterations: int = 10
    shuffle_every: int = 8
    relaxation: float = 1.3
    erp: float = 0.4
    cfm: float = 1e-5
    soft_cfm: float = 1e-5
    bounce: float = 0.6
    bounce_speed: float = 1e-3
    linear_damping: float = 1e-5
    angular_damping: float = 1e-3
    damping_threshold: float = 0.01
    single: bool = True
    gyroscopic: bool = True
    # Of the servos
    per_step: bool = True
    hardening: float = 1.0
    damper_share: float = 0.2

    def __post_init__(self) -> None:
        for name in ("iterations", "shuffle_every"):
            whole(name, getattr(self, name), 0, "it is a number of sweeps", 10**6)
        for name in ("single", "gyroscopic", "per_step"):
            truth(name, getattr(self, name))
        real("relaxation", self.relaxation, 1e-3, 1.999, "1 is Gauss and Seidel's, 1.3 ODE's")
        for name in ("erp", "bounce", "linear_damping", "angular_damping"):
            real(name, getattr(self, name), 0.0, 1.0, "it is a share")
        for name in ("cfm", "soft_cfm", "bounce_speed", "damping_threshold", "hardening", "damper_share"):
            real(name, getattr(self, name), 0.0, 1e9, "it cannot be negative")

    def record(self) -> np.recarray:
        """Return the settings as kernels read them (1,)."""
        kinds = {"int": np.int64, "bool": np.int64, "float": np.float64}
        layout = np.dtype([(field.name, kinds[str(field.type)]) for field in fields(self)], align=True)
        made = records(1, layout)
        for name in layout.names or ():
            made[0][name] = getattr(self, name)
        return made


EXACT = Engine(
    iterations=0, cfm=1e-10, soft_cfm=1e-10, bounce=0.0, linear_damping=0.0, angular_damping=0.0, single=False,
    per_step=False, hardening=0.0, damper_share=1e9,
)  # fmt: skip
"""Rigid constraints, solved: what the equations of motion are in the limit of small steps."""


@kernel
def step(w: Any, x: Any, gravity: np.ndarray, h: float) -> int:
    """Make one step of all bodies with the torques of the axes; return the first row of the contacts."""
    load(w, x, gravity)
    apply_torques(w, x)
    contacts = joint_rows(w, x, h)
    rows = contact_rows(w, x, h, contacts)
    finish_rows(w, x, rows, h)
    if w.engine[0].iterations > 0:
        relax(w, x, rows)
    else:
        solve(w, x, rows)
    move(w, x, h)
    refresh(w, x)
    x.counts[0] = rows
    x.counts[3] += 1
    return contacts
