"""Gymnasium environments: robots driven by servos, tick by tick."""

from ..base.deprecated import renamed
from .environment import *  # noqa: F403
from .environment import __all__ as __all__

__getattr__ = renamed(__name__, {"Settings": "builtins:dict"})
