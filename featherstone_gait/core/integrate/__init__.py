"""Integrators, by name."""

from .ars343 import ARS343
from .dormand_prince import DOP853
from .extrapolation import EXTRAPOLATION
from .implicit import IMPLICIT_EULER, MIDPOINT
from .rk4 import RK4
from .simtwo import SIMTWO

INTEGRATORS = {i.name: i for i in (IMPLICIT_EULER, MIDPOINT, RK4, DOP853, EXTRAPOLATION, ARS343, SIMTWO)}
