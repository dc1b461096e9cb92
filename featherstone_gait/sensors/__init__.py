"""Moved to `featherstone_gait.run.sensors`; this path works until version 0.4."""

from featherstone_gait.base.deprecated import moved

__getattr__, __dir__ = moved(__name__, "featherstone_gait.run.sensors")
