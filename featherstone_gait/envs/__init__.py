"""Gymnasium environments: robots driven by servos, tick by tick."""

from . import environment, kick
from .environment import *  # noqa: F403
from .kick import *  # noqa: F403

__all__ = sorted((*environment.__all__, *kick.__all__))
