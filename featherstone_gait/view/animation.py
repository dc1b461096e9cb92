"""Moved to `featherstone_gait.view.page`; this path works until version 0.4."""

from ..base.deprecated import moved

__getattr__, __dir__ = moved(__name__, "featherstone_gait.view.page")
