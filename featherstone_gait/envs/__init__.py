"""Gymnasium environments: robots driven by servos, tick by tick."""

from .environment import *  # noqa: F403
from .environment import __all__ as __all__
