"""Scenes of SimTwo (https://github.com/P33a/SimTwo), the simulator of Lima et al. 2013.

A robot is solids (cuboids, cylinders, spheres) and articulations with motors, all placed in the robot's frame.  What
the numbers mean is taken from the program as of 2012 (commit f9dc76a), which the paper used.
"""
