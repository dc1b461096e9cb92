"""From a Model to the numbers that kernels read: one file for each file of `core/effects`, and the tree."""
