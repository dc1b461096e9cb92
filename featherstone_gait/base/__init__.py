"""Helpers that every room uses: argument checks, files, processes, rotations, sums in a fixed order."""
