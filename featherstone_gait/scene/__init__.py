"""Compile a model into a scene: the arrays that kernels read, a file for each file of `core/effects`, and the tree."""
