"""Trajectories to look at: plots, stick figures, and pages that play a motion."""
