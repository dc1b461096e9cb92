"""Moved to `featherstone_gait.reproduction`; this path works until version 0.4."""

from featherstone_gait.base.deprecated import moved, warn
from featherstone_gait.reproduction import __path__ as __path__

warn(__name__, "featherstone_gait.reproduction")
__getattr__, __dir__ = moved(__name__, "featherstone_gait.reproduction")
