"""Search for the least cost: knows vectors and numbers only."""

from featherstone_gait.search.annealing import AdaptiveSimulatedAnnealing, minimize

__all__ = ["AdaptiveSimulatedAnnealing", "minimize"]
