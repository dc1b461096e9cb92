"""Measure run time, always beside the error: the modules behind `featherstone-gait benchmark`."""
