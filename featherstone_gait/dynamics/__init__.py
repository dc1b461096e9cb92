"""Dynamics and kinematics of a tree from Python, without a scene."""

from .algorithms import (
    Coupling,
    Poses,
    center_of_mass,
    check_model,
    contact_positions,
    contact_positions_at,
    coupling_matrix,
    deepest_points,
    energy,
    forward_dynamics,
    forward_kinematics,
    inverse_dynamics,
    mass_matrix,
    momentum,
    spring_energy,
    spring_vectors,
)

__all__ = [
    "Coupling",
    "Poses",
    "center_of_mass",
    "check_model",
    "contact_positions",
    "contact_positions_at",
    "coupling_matrix",
    "deepest_points",
    "energy",
    "forward_dynamics",
    "forward_kinematics",
    "inverse_dynamics",
    "mass_matrix",
    "momentum",
    "spring_energy",
    "spring_vectors",
]
