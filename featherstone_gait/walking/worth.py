"""Old names of `featherstone_gait.optimize.quality`, until version 0.4."""

from ..base.deprecated import renamed

QUALITY = "featherstone_gait.optimize.quality"
NAMES = {"Quality": "Quality", "plausible": "measure_limits", "quality": "measure_quality"}
NAMES["worth_elsewhere"] = "measure_in_test_worlds"
__getattr__ = renamed(__name__, {old: f"{QUALITY}:{new}" for old, new in NAMES.items()})
