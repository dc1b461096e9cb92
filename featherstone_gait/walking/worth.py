"""Old names of `featherstone_gait.optimize.quality`, until version 0.4."""

from featherstone_gait.base.deprecated import renamed

__getattr__ = renamed(
    __name__,
    {
        old: f"featherstone_gait.optimize.quality:{new}"
        for old, new in {
            "Quality": "Quality",
            "plausible": "measure_limits",
            "quality": "measure_quality",
            "worth_elsewhere": "measure_in_test_worlds",
        }.items()
    },
)
