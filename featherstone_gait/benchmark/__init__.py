"""Benchmarks: run time, always beside the error."""

from .. import reproduction as reproduction  # adds the integrator "simtwo", which is compared with the others
