"""Equilibria and linear models of a robot under its servos."""
