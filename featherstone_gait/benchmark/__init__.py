"""Benchmarks: run time, always beside the error."""
