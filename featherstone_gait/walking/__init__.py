"""Walking: preview control of the zero-moment point, leg inverse kinematics, plans, key-pose gaits and their cost."""

from featherstone_gait.walking.cheapest_plan import cheapest_plan, first_gait
from featherstone_gait.walking.constraints import ConstrainedCost, ConstraintReport, Constraints
from featherstone_gait.walking.cost import Measures, WalkingCost, cost_of_motion
from featherstone_gait.walking.disturbed import LongWalk, pushes_survived, rough_field, walk_far
from featherstone_gait.walking.feedback import (
    BalancedWalk,
    Feedback,
    Imu,
    add_feedback,
    balanced,
    generic_feedback,
    read_walk,
)
from featherstone_gait.walking.four_legs import Pattern, four_legged_stride, mirror_by_place
from featherstone_gait.walking.gait import Gait, bounds, fit_gait, mirror_of, references
from featherstone_gait.walking.gait_file import read_angles, write_angles, write_goal_positions
from featherstone_gait.walking.generic_servo import with_generic_servos
from featherstone_gait.walking.inverse_kinematics import solve_leg
from featherstone_gait.walking.motion import Motion, motion_of, read_motion, servo_of
from featherstone_gait.walking.plan import BIOLOID_WALK, Plan, Walk, walking_plan
from featherstone_gait.walking.preview_control import plan_com, preview_controller
from featherstone_gait.walking.zero_moment_point import multibody_zmp

__all__ = [
    "BIOLOID_WALK",
    "BalancedWalk",
    "ConstrainedCost",
    "ConstraintReport",
    "Constraints",
    "Feedback",
    "Gait",
    "Imu",
    "LongWalk",
    "Measures",
    "Motion",
    "Pattern",
    "Plan",
    "Walk",
    "WalkingCost",
    "add_feedback",
    "balanced",
    "bounds",
    "cheapest_plan",
    "cost_of_motion",
    "first_gait",
    "fit_gait",
    "four_legged_stride",
    "generic_feedback",
    "mirror_by_place",
    "mirror_of",
    "motion_of",
    "multibody_zmp",
    "plan_com",
    "preview_controller",
    "pushes_survived",
    "read_angles",
    "read_motion",
    "read_walk",
    "references",
    "rough_field",
    "servo_of",
    "solve_leg",
    "walk_far",
    "walking_plan",
    "with_generic_servos",
    "write_angles",
    "write_goal_positions",
]
