"""Measure run time, always beside the error: the modules behind `featherstone-gait benchmark`."""

from .. import reproduction as reproduction  # adds the integrator "simtwo", which is compared with the others
