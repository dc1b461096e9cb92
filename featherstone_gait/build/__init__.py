"""From a model to the numbers that the kernels read."""
