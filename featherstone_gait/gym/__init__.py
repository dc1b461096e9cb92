"""Moved to `featherstone_gait.envs`; this path works until version 0.4."""

from featherstone_gait.base.deprecated import moved

__getattr__, __dir__ = moved(__name__, "featherstone_gait.envs")
