"""The planned walk: feet, center of mass and zero-moment point are where a walk needs them."""

from dataclasses import replace

import numpy as np
import pytest
from biped import biped, without_contacts

from featherstone_gait.dynamics import contact_positions_at
from featherstone_gait.model import Joint, Link, Model
from featherstone_gait.robot_file import load_robot
from featherstone_gait.walking.gait import mirror_of
from featherstone_gait.walking.kinematics import center_of_mass, link_poses
from featherstone_gait.walking.plan import downward, walking_plan
from featherstone_gait.walking.zero_moment_point import multibody_zmp, polygon_margin, support_polygon


@pytest.fixture(scope="module")
def plan():
    return walking_plan(biped())


def sole_corners(model, plan):
    """World positions (n, corners, 3) of the contact points."""
    return contact_positions_at(model, link_poses(model, plan.angles, plan.base_position))


def test_zmp_of_the_moving_links_stays_25_mm_inside_the_support_polygon(plan):
    assert plan.margin().min() > 0.025


def test_preview_by_the_zmps_speed_misses_the_reference_by_half(plan):
    other = walking_plan(biped(), preview="auxiliary_zmp")
    errors = [np.sqrt(((p.zmp - p.zmp_reference) ** 2).mean(axis=0)) for p in (other, plan)]
    assert (errors[0] < 0.6 * errors[1]).all()
    assert other.margin().min() > 0.025
    assert np.abs(other.angles - plan.angles).max() > 1e-4


def test_a_plan_of_less_accuracy_is_as_close_as_was_asked_for(plan):
    """The center of mass by 10 um, so the joints of legs of 0.2 m by some 1e-4 rad."""
    other = walking_plan(biped(), followed=1e-5)
    assert np.abs(center_of_mass(biped(), other.angles, other.base_position) - other.com).max() < 1e-5
    assert 0.0 < np.abs(other.angles - plan.angles).max() < 5e-4


@pytest.mark.quick("0.36")
@pytest.mark.parametrize("step_time", [0.28, 0.30, 0.36])
def test_other_step_times_keep_15_mm(step_time):
    assert walking_plan(biped(), step_time=step_time).margin().min() > 0.015


def test_zmp_keeps_to_its_reference(plan):
    # What is left are the lift-off and touch-down of the swing foot, whose half sine begins and ends at full speed.
    assert (np.sqrt(((plan.zmp - plan.zmp_reference) ** 2).mean(axis=0)) < 4e-3).all()


def test_standing_soles_lie_flat_and_still_and_no_sole_is_below_ground(plan):
    model = biped()
    corners = sole_corners(model, plan)
    left = np.array([contact.link.startswith("left") for contact in model.contacts])
    for foot, own in enumerate((left, ~left)):
        stands = plan.contact[:, foot]
        assert np.abs(corners[stands][:, own, 2]).max() < 1e-8
        still = stands[1:] & stands[:-1]
        assert np.abs(np.diff(corners[:, own], axis=0)[still]).max() < 1e-8
    assert corners[..., 2].min() > -1e-8
    assert corners[..., 2].max() == pytest.approx(plan.walk.lift, rel=0.01)


def test_the_models_center_of_mass_follows_its_path_at_constant_height(plan):
    center = center_of_mass(biped(), plan.angles, plan.base_position)
    assert np.abs(center - plan.com).max() < 3e-9
    assert np.ptp(plan.com[:, 2]) == 0.0


def test_the_walk_starts_and_ends_standing_one_step_less_ahead_than_steps(plan):
    walk = plan.walk
    assert np.abs(np.diff(plan.angles[:10], axis=0)).max() < 1e-5
    assert plan.com[-1, 0] - plan.com[0, 0] == pytest.approx(walk.step_length * (walk.n_steps - 1), abs=1e-5)
    assert plan.standing == pytest.approx(mirror_of(biped())(plan.standing), abs=1e-7)
    assert plan.contact[[0, -1]].all()


def test_a_foot_is_in_the_air_for_the_single_support_share(plan):
    walk = plan.walk
    single = (plan.contact.sum(axis=1) == 1).sum() * walk.T / (walk.n_steps * walk.step_time)
    assert single == pytest.approx(1.0 - walk.double_support, abs=walk.T / walk.step_time)


def test_the_stride_repeats_and_is_its_own_mirror_image_half_a_stride_later(plan):
    stride = plan.stride()
    assert stride.mismatch < 1e-5
    assert len(stride.times) == 64
    assert stride.period == 0.64
    later = np.roll(stride.angles, -32, axis=0)
    assert np.abs(mirror_of(biped())(later) - stride.angles).max() < 1e-5


def test_the_start_up_leads_from_standing_into_the_stride(plan):
    start, stride = plan.start_up(strides=3, phase=0.02), plan.stride()
    assert np.abs(start[0] - plan.standing).max() < 1e-3
    assert start[-1] == pytest.approx(stride.angles[-2], abs=1e-4)  # 40 ms before 20 ms
    assert start[-16] == pytest.approx(stride.angles[2], abs=1e-3)
    with pytest.raises(ValueError, match="n_steps > 16"):
        plan.start_up(strides=8)


def test_planning_twice_gives_the_same_bits_also_where_the_feet_are_named(plan):
    feet = ["left_ankle_lateral_link", "right_ankle_lateral_link"]
    assert np.array_equal(walking_plan(biped(), feet=feet).angles, plan.angles)
    with pytest.raises(ValueError, match="contact points on two feet"):
        walking_plan(biped(), feet=["left_knee_link", "right_knee_link"])


def test_a_model_that_cannot_stand_is_refused():
    with pytest.raises(ValueError, match="contact points on two feet"):
        walking_plan(without_contacts())
    with pytest.raises(ValueError, match="3 or more contact points"):
        walking_plan(replace(biped(), contacts=biped().contacts[2:]))


@pytest.mark.parametrize(
    ("walk", "message"),
    [
        (dict(com_height=0.3, n_steps=4), r"cannot reach .* at t = .* lower center of mass"),
        (dict(step_length=0.2, n_steps=4), r"cannot reach .* shorter step"),
        (dict(lift=0.1, n_steps=4), r"joint 'left_\w+' needs .* outside its limits"),
        (dict(n_steps=3), "n_steps is 3"),
        (dict(step_time=0.325), "whole number of samples"),
        (dict(double_support=0.0), "double_support = 0.0"),
        (dict(preview="jerk"), "walk: preview .*cart_table"),
        (dict(followed=0.0), "followed"),
        (dict(T=-0.01), "T = -0.01 must be finite and > 0"),
    ],
)
def test_a_walk_that_cannot_be_is_refused_by_name(walk, message):
    with pytest.raises(ValueError, match=message):
        walking_plan(biped(), **walk)


def test_a_walk_too_short_to_settle_has_no_stride():
    with pytest.raises(ValueError, match="not settled"):
        walking_plan(biped(), n_steps=4).stride()


@pytest.mark.quick("0.28")
@pytest.mark.parametrize("step_time", [0.28, 0.32, 0.36])
def test_the_humanoid_walks_with_its_ten_joints(step_time):
    model = load_robot("humanoid", locked="simplified")
    plan = walking_plan(model, step_time=step_time)
    assert len(plan.joint_names) == 10
    assert plan.margin().min() > 0.015
    stride = plan.stride()
    half = len(stride.times) // 2
    assert stride.mismatch < 1e-5
    assert np.abs(mirror_of(model)(np.roll(stride.angles, -half, axis=0)) - stride.angles).max() < 1e-5
    assert np.abs(sole_corners(model, plan)[plan.contact.all(axis=1)][..., 2]).max() < 1e-8


def test_free_arms_hang_and_free_hips_do_not_turn():
    simple, full = load_robot("humanoid", locked="simplified"), load_robot("humanoid", locked={})
    plan, whole = walking_plan(simple, n_steps=4), walking_plan(full, n_steps=4)
    shared = [full.joint_names.index(name) for name in simple.joint_names]
    assert np.abs(whole.angles[:, shared] - plan.angles).max() < 1e-8
    others = np.setdiff1d(np.arange(len(full.joint_names)), shared)
    assert len(others) == 9
    assert np.abs(whole.angles[:, others]).max() < 1e-8


def wheel_on_a_post(I):
    """A wheel on a frictionless pivot at 0.5 m, its center of mass on the axis y."""
    links = (Link("post", 1.0, (0, 0, 0), (1, 0, 0, 1, 0, 1)), Link("wheel", 2.0, (0, 0, 0), (I, 0, 0, I, 0, 2 * I)))
    return Model("wheel", links, (Joint("pivot", "revolute", "post", "wheel", xyz=(0, 0, 0.5), axis=(0, 1, 0)),))


def test_a_wheel_speeding_up_shifts_the_zmp_by_its_torque_over_the_weight():
    I, alpha, T = 0.03, 4.0, 1e-3
    angles = 0.5 * alpha * (T * np.arange(50))[:, None] ** 2
    zmp = multibody_zmp(wheel_on_a_post(I), angles, np.zeros((50, 3)), T)
    assert zmp == pytest.approx(np.tile([-I * alpha / (3.0 * 9.81), 0.0], (50, 1)), rel=1e-5)


@pytest.mark.parametrize("g", [9.81, 1.62])
def test_a_body_moved_without_turning_has_the_zmp_of_a_cart_table(g):
    T, a, height = 0.01, np.array([0.7, -0.4]), 0.2
    base = np.zeros((40, 3))
    base[:, :2], base[:, 2] = 0.5 * a * (T * np.arange(40))[:, None] ** 2, height
    body = Model("body", (Link("body", 2.0, (0, 0, 0), (1, 0, 0, 1, 0, 1)),), ())
    zmp = multibody_zmp(body, np.zeros((40, 0)), base, T, g)[2:-2]
    assert zmp == pytest.approx(base[2:-2, :2] - height / g * a, abs=1e-12)


@pytest.mark.parametrize("g", [9.81, 1.62])
def test_a_robot_that_stands_has_its_zmp_under_its_center_of_mass(plan, g):
    still, base = np.tile(plan.angles[150], (6, 1)), np.tile(plan.base_position[150], (6, 1))
    zmp = multibody_zmp(biped(), still, base, 0.01, g)
    assert zmp == pytest.approx(np.tile(plan.com[150, :2], (6, 1)), abs=1e-8)


def test_a_walk_on_the_moon_is_that_on_earth_slowed_down():
    """Dynamically similar: times as the root of 1/g, and the weight of jerks as the sixth power of time."""
    plan = walking_plan(biped(), n_steps=4)
    s = np.sqrt(9.81 / 1.62)
    T = plan.walk.T * s
    slow = {"T": T, "step_time": plan.walk.step_samples * T, "R": plan.walk.R * s**6}
    moon = walking_plan(biped(), g=1.62, n_steps=4, **slow)
    assert np.abs(moon.angles - plan.angles).max() < 1e-7
    assert np.abs(moon.zmp - plan.zmp).max() < 1e-7
    hasty = walking_plan(biped(), g=1.62, n_steps=4)  # the feet swing as fast, but weigh a sixth
    assert np.abs(hasty.zmp - hasty.zmp_reference).max() > 2.0 * np.abs(plan.zmp - plan.zmp_reference).max()


def test_a_plan_is_for_gravity_that_points_straight_down():
    assert downward(np.array([0.0, 0.0, -1.62])) == 1.62
    for gravity in ((0.5, 0.0, -9.8), (0.0, 0.0, 9.81), (0.0, 0.0, 0.0), (0.0, 0.0, np.nan)):
        with pytest.raises(ValueError, match=r"gravity .* must point straight down, along -z.*Ground\(slope"):
            downward(gravity)


def test_margin_is_the_distance_to_the_nearest_edge():
    square = support_polygon(np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.5], [2.0, 1.0], [0.0, 1.0]]))
    assert len(square) == 4
    assert polygon_margin(np.array([1.0, 0.3]), square) == pytest.approx(0.3)
    assert polygon_margin(np.array([2.5, 0.3]), square) == pytest.approx(-0.5)
