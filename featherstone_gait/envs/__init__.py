"""Gymnasium environments: robots driven by servos, tick by tick."""

from ..base.deprecated import renamed
from . import environment, kick
from .environment import *  # noqa: F403
from .kick import *  # noqa: F403

__all__ = sorted((*environment.__all__, *kick.__all__))

__getattr__ = renamed(__name__, {"Settings": "builtins:dict"})
