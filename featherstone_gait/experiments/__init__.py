"""Moved to `featherstone_gait.reproduction`; this path works until version 0.4."""

from featherstone_gait.base.deprecated import moved
from featherstone_gait.reproduction import __path__ as __path__

__getattr__ = moved(__name__, "featherstone_gait.reproduction")
