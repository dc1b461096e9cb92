"""Walking: preview control of the zero-moment point, leg inverse kinematics, plans, key-pose gaits and their cost."""

from .cheapest_plan import cheapest_plan, first_gait
from .constraints import ConstrainedCost, ConstraintReport, Constraints
from .cost import Measures, WalkingCost, cost_of_motion
from .cost_gradient import cost_and_gradient
from .disturbed import LongWalk, pushes_survived, rough_field, walk_far
from .feedback import BalancedWalk, Feedback, Imu, add_feedback, balanced, generic_feedback, read_walk
from .four_legs import Pattern, four_legged_stride, mirror_by_place
from .gait import Gait, bounds, fit_gait, mirror_of, references
from .gait_file import read_angles, write_angles, write_goal_positions
from .generic_servo import with_generic_servos
from .inverse_kinematics import solve_leg
from .motion import Motion, motion_of, read_motion, servo_of
from .plan import BIOLOID_WALK, Plan, WalkSettings, walking_plan
from .preview_control import plan_com, preview_controller
from .zero_moment_point import multibody_zmp

__all__ = [
    "BIOLOID_WALK", "BalancedWalk", "ConstrainedCost", "ConstraintReport", "Constraints", "Feedback", "Gait", "Imu",
    "LongWalk", "Measures", "Motion", "Pattern", "Plan", "WalkSettings", "WalkingCost", "add_feedback", "balanced",
    "bounds", "cheapest_plan", "cost_and_gradient", "cost_of_motion", "first_gait", "fit_gait", "four_legged_stride",
    "generic_feedback", "mirror_by_place", "mirror_of", "motion_of", "multibody_zmp", "plan_com", "preview_controller",
    "pushes_survived", "read_angles", "read_motion", "read_walk", "references", "rough_field", "servo_of", "solve_leg",
    "walk_far", "walking_plan", "with_generic_servos", "write_angles", "write_goal_positions",
]  # fmt: skip
