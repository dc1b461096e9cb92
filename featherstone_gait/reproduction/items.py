"""Every figure, table and equation of the paper, in its order, and what here answers it.

An item that states a result is answered by claims of experiments, which name it; one that states a model, a method or a
scene by the module that has it and the test that holds it.
"""

from __future__ import annotations

from typing import NamedTuple


class Item(NamedTuple):
    """One item of the paper."""

    title: str  # what it shows or says
    here: str = ""  # what is here in its place; "" where experiments answer
    module: str = ""  # file that has it
    test: str = ""  # test that holds it, file::function


_SERVO = "tests/test_physics_servo.py::"
ITEMS = {
    "Fig. 1": Item(
        "SimTwo and its windows", "a screenshot, of no result; runs are looked at as pages", "featherstone_gait/view"
    ),
    "Fig. 2": Item(
        "Control levels and their cycle times",
        "controller ticks of 10 ms, references every 40 ms that take effect after a lag, physics at 1 ms",
        "featherstone_gait/core/effects/controller.py",
        _SERVO + "test_reference_takes_effect_after_the_lag",
    ),
    "Fig. 3": Item(
        "Servomotor: state feedback, limits, motor, friction",
        "the chain of controller, voltage limit, R-L motor with limits of current and slew, friction",
        "featherstone_gait/core/effects/mipsd_servo.py",
        _SERVO + "test_state_feedback_law",
    ),
    "Table 1": Item(
        "Symbols of the servomotor", "channels and their units", "featherstone_gait/core/step/state.py",
        _SERVO + "test_every_joule_is_accounted_for",
    ),
    "Table 2": Item("Motor and friction constants"),
    "Fig. 4": Item("A step: model and real servo"),
    "Fig. 5": Item("Free fall of an arm: model and real servo"),
    "Eq. 1": Item(
        "Rotor: J dw/dt = T_s - T_Bv + T_rotor", "the rotor as a state of its own",
        "featherstone_gait/core/effects/mipsd_servo.py", _SERVO + "test_two_masses_on_a_spring_ring_at_their_frequency",
    ),
    "Eq. 2": Item("Damping of the rotor: T_Bv = B_vr w"),
    "Fig. 6": Item(
        "Gearbox between rotor and axis", "spring and damper between two inertias",
        "featherstone_gait/core/effects/gearbox.py", _SERVO + "test_physical_gearbox_winds_up_by_load_over_stiffness",
    ),
    "Eq. 3": Item(
        "Action and reaction: T_gear = -T_axis", "one torque on joint and rotor",
        "featherstone_gait/core/effects/mipsd_servo.py", _SERVO + "test_every_joule_is_accounted_for",
    ),
    "Eq. 4": Item("Spring-damper T_axis = K_s e + K_B de/dt, K_s and K_B as printed"),
    "Eq. 5": Item(
        "T_rotor = T_gear / G", "stated at the output: inertia and damping of the rotor times G squared",
        "featherstone_gait/scene/actuator.py", _SERVO + "test_two_masses_on_a_spring_ring_at_their_frequency",
    ),
    "Eq. 6": Item(
        "e = rotor / G - axis", "the gearbox's deflection", "featherstone_gait/core/effects/gearbox.py",
        _SERVO + "test_backlash_lets_the_link_fall_through_the_gap",
    ),
    "Section 3": Item("The improved gearbox keeps servomotor and controller, and is more stable"),
    "Fig. 7": Item(
        "Arm of seven joints", "links of the AX-12's size; the paper gives none", "robots/arm7",
        "tests/test_paper_seven_joint_arm.py::test_links_are_scaled_by_geometry",
    ),
    "Fig. 8": Item(
        "The old model falls apart, in pictures", "its joint angles over time (Figs. 9 and 10)",
        "featherstone_gait/reproduction/seven_joint_arm.py",
        "tests/test_paper_seven_joint_arm.py::test_the_standard_model_chatters_by_a_degree_whatever_the_disturbance",
    ),
    "Fig. 9": Item("Lowest joint of the arm, standard model: 8.14"),
    "Fig. 10": Item("Lowest joint of the arm, MIPSD: 0.0022"),
    "Fig. 11": Item("Scatter of the energy over 200 runs: 14.62 and 3.9 %"),
    "Fig. 12": Item(
        "Complete humanoid", "19 joints, from the authors' scene of 2008", "robots/humanoid",
        "tests/test_paper_posture.py::test_the_posture_lies_within_the_joints_limits_and_the_table_within_itself",
    ),
    "Table 3": Item("Four joints of the humanoid that holds still"),
    "Fig. 13": Item(
        "Left elbow over time, both models", "drawn with Table 3", "featherstone_gait/reproduction/posture.py",
        "tests/test_paper_posture.py::test_the_standard_model_chatters_and_the_others_stand_still",
    ),
    "Section 4": Item(
        "Four states of ten joints; D = 40", "gaits of four poses, of a stride or of a step and its mirror image",
        "featherstone_gait/walking/gait.py", "tests/test_gait.py::test_vector_and_gait_are_the_same_to_the_bit",
    ),
    "Fig. 14": Item(
        "Adaptive simulated annealing", "the algorithm as printed", "featherstone_gait/search/annealing.py",
        "tests/test_annealing.py::test_misses_narrow_the_search_until_it_is_reheated_again_and_again",
    ),
    "Fig. 15": Item(
        "Walking, in pictures", "the planned gait and those found, as poses", "featherstone_gait/view/plotting.py",
        "tests/test_plan.py::test_the_humanoid_walks_with_its_ten_joints",
    ),
    "Fig. 16": Item("Energy per distance over iterations: converged after 800, the older model after 2600"),
    "Section 5": Item("14 % less energy per distance, steps 13 % longer"),
    "Section 6": Item("Future work: the complete model"),
}  # fmt: skip
