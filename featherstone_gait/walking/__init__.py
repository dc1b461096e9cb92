"""Walking: preview control of the zero-moment point, leg inverse kinematics, plans, key-pose gaits and their cost."""

from featherstone_gait.walking.constraints import ConstrainedCost, ConstraintReport, Constraints
from featherstone_gait.walking.cost import Measures, WalkingCost, cost_of_motion
from featherstone_gait.walking.gait import Gait, bounds, fit_gait, mirror_of, references
from featherstone_gait.walking.gait_file import read_angles, write_angles, write_goal_positions
from featherstone_gait.walking.inverse_kinematics import solve_leg
from featherstone_gait.walking.plan import BIOLOID_WALK, Plan, Walk, walking_plan
from featherstone_gait.walking.preview_control import plan_com, preview_controller
from featherstone_gait.walking.zero_moment_point import multibody_zmp

__all__ = [
    "BIOLOID_WALK",
    "ConstrainedCost",
    "ConstraintReport",
    "Constraints",
    "Gait",
    "Measures",
    "Plan",
    "Walk",
    "WalkingCost",
    "bounds",
    "cost_of_motion",
    "fit_gait",
    "mirror_of",
    "multibody_zmp",
    "plan_com",
    "preview_controller",
    "read_angles",
    "references",
    "solve_leg",
    "walking_plan",
    "write_angles",
    "write_goal_positions",
]
