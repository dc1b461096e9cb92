"""Dynamics and kinematics of a tree from Python, without a scene."""

from .algorithms import (
    Energy,
    center_of_mass,
    energy,
    forward_dynamics,
    inverse_dynamics,
    loop_forces,
    mass_matrix,
    momentum,
)
from .kinematics import Poses, contact_positions, contact_positions_at, deepest_points, forward_kinematics
from .loops import Coupling, coupling_matrix, loop_gaps, loop_jacobian
from .states import check_model
from .tendons import spring_energy, spring_vectors, tendon_energy, tendon_jacobian, tendon_lengths
from .wrench import Wrench

__all__ = [
    "Coupling",
    "Energy",
    "Poses",
    "Wrench",
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
    "loop_forces",
    "loop_gaps",
    "loop_jacobian",
    "mass_matrix",
    "momentum",
    "spring_energy",
    "spring_vectors",
    "tendon_energy",
    "tendon_jacobian",
    "tendon_lengths",
]
