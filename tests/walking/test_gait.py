"""Key-pose gaits: the spline through them, their fit to a walk, what is sent to the robot, and the files."""

from dataclasses import replace

import numpy as np
import pytest
from biped import biped
from scipy.interpolate import CubicSpline

from featherstone_gait.walking.gait import Gait, bounds, fit_gait, mirror_of, periodic_spline, references
from featherstone_gait.walking.gait_file import (
    angles_of_goal_positions,
    goal_positions,
    read_angles,
    write_angles,
    write_goal_positions,
)
from featherstone_gait.walking.plan import Stride, walking_plan


@pytest.fixture(scope="module")
def plan():
    return walking_plan(biped())


def some_gait(n_poses=4, mirror=None, seed=0):
    names = biped().joint_names
    poses = np.random.default_rng(seed).uniform(-1.0, 1.0, (n_poses, len(names)))
    if mirror:
        poses[n_poses // 2 :] = mirror(poses[: n_poses // 2])
    return Gait(names, poses, 0.64, mirror)


@pytest.mark.parametrize("n_poses", [3, 4, 7, 16])
def test_the_spline_is_the_periodic_cubic_spline(n_poses):
    values = np.random.default_rng(n_poses).normal(size=(n_poses, 2))
    closed = np.concatenate([values, values[:1]])
    expected = CubicSpline(np.linspace(0.0, 1.0, n_poses + 1), closed, bc_type="periodic")
    s = np.linspace(0.0, 1.0, 101)
    assert np.abs(periodic_spline(values, s) - expected(s)).max() < 1e-13
    assert np.abs(periodic_spline(values, s - 3.0) - expected(s)).max() < 1e-13


def test_the_gait_passes_through_its_poses_and_repeats():
    gait = some_gait()
    times = gait.period * np.arange(4) / 4
    assert np.abs(gait.angles(times) - gait.poses).max() < 1e-15
    assert np.abs(gait.angles(times + 5 * gait.period) - gait.poses).max() < 1e-12


@pytest.mark.parametrize("mirrored", [False, True])
def test_vector_and_gait_are_the_same_to_the_bit(mirrored):
    gait = some_gait(mirror=mirror_of(biped()) if mirrored else None)
    x = gait.to_vector()
    assert len(x) == (20 if mirrored else 40)
    assert np.array_equal(gait.from_vector(x).poses, gait.poses)
    assert np.array_equal(gait.from_vector(x).to_vector(), x)


def test_a_mirrored_gait_walks_its_mirror_image_half_a_stride_later():
    mirror = mirror_of(biped())
    gait = some_gait(6, mirror)
    times = np.linspace(0.0, 0.6, 17)
    later = gait.angles(times + 0.5 * gait.period)
    assert np.abs(mirror(later) - gait.angles(times)).max() < 1e-13


def test_the_mirror_swaps_sides_and_turns_about_x_and_z_but_not_y():
    mirror, names = mirror_of(biped(hip_rotation_locked=False)), biped(hip_rotation_locked=False).joint_names
    assert [names[i].replace("right", "left") for i in mirror.index[:6]] == list(names[:6])
    turned = {name for name, sign in zip(names, mirror.sign) if sign < 0}
    assert turned == {f"{s}_{n}" for s in ("left", "right") for n in ("hip_rotation", "hip_lateral", "ankle_lateral")}
    angles = np.random.default_rng(0).normal(size=(3, 12))
    assert np.array_equal(mirror(mirror(angles)), angles)


def test_a_robot_that_has_no_mirror_image_is_refused():
    model = biped()
    knee = next(joint for joint in model.joints if joint.name == "left_knee")
    skew = tuple(replace(j, axis=(0.0, 0.6, 0.8)) if j is knee else j for j in model.joints)
    with pytest.raises(ValueError, match=r"'left_knee' and 'right_knee'.*do not mirror"):
        mirror_of(replace(model, joints=skew))
    with pytest.raises(ValueError, match=r"'left_knee'.*no partner 'right_knee'"):
        mirror_of(replace(model, locked={**model.locked, "right_knee": 0.0}))


def test_a_stride_that_is_a_spline_is_recovered_with_its_phase():
    gait = some_gait()
    times = 0.01 * np.arange(64)
    stride = Stride(gait.joint_names, times, gait.angles(times - 0.05), gait.period, 0.0)
    fit = fit_gait(stride, fit_phase=True)
    assert fit.phase == pytest.approx(0.05)
    assert np.abs(fit.gait.poses - gait.poses).max() < 2e-9
    assert fit.largest.max() < 1e-6
    assert fit_gait(stride).rms.max() > 1.0


def test_more_poses_follow_the_planned_stride_closer(plan):
    stride = plan.stride()
    rms = [np.sqrt((fit_gait(stride, n).rms ** 2).mean()) for n in (4, 8, 16, 32)]
    assert (np.diff(rms) < 0.0).all()
    assert rms[0] < 2.5
    assert rms[-1] < 0.3


def test_a_mirrored_fit_of_the_symmetric_stride_is_as_good(plan):
    free, mirrored = fit_gait(plan.stride()), fit_gait(plan.stride(), mirror=mirror_of(biped()))
    assert np.abs(free.gait.poses - mirrored.gait.poses).max() < 1e-5
    assert len(mirrored.gait.to_vector()) == 20


def test_references_grow_out_of_the_standing_posture_into_the_gait(plan):
    gait = fit_gait(plan.stride()).gait
    times, angles = references(gait, 3, plan.standing)
    assert len(times) == 16 + 3 * 16 + 1
    assert np.diff(times) == pytest.approx(np.full(64, 0.04))
    assert np.array_equal(angles[0], plan.standing)
    assert np.array_equal(angles[16:], gait.angles(0.04 * np.arange(16))[np.arange(49) % 16])
    assert np.abs(np.diff(angles, axis=0)).max() < 1.1 * np.abs(np.diff(angles[16:], axis=0)).max()


def test_references_follow_a_start_up_and_then_the_gait(plan):
    fit = fit_gait(plan.stride(), 8, fit_phase=True)
    start = plan.start_up(phase=fit.phase)
    _, angles = references(fit.gait, 2, start)
    assert np.array_equal(angles[: len(start) - 16], start[:-16])
    assert np.array_equal(angles[len(start)], fit.gait.angles([0.0])[0])
    # In step with each other, start-up and gait differ by no more than the fit's residual.
    assert np.abs(angles[: len(start)] - start).max() < 1.1 * np.radians(fit.largest.max())


def test_references_refuse_what_does_not_fit():
    gait = some_gait()
    with pytest.raises(ValueError, match=r"period of 0\.65 s .* 0\.04 s; take 0\.64 s"):
        references(replace(gait, period=0.65), 2, np.zeros(10))
    with pytest.raises(ValueError, match="start must be"):
        references(gait, 2, np.zeros((5, 10)))
    with pytest.raises(ValueError, match="start must be"):
        references(gait, 2, np.zeros(9))


def test_bounds_are_the_joint_limits_of_every_free_pose():
    model = biped()
    limits = bounds(model, some_gait(mirror=mirror_of(model)))
    assert limits.shape == (20, 2)
    assert limits[12] == pytest.approx(np.radians((-98.0, 32.0)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(poses=np.zeros((4, 9))), "poses must be"),
        (dict(poses=np.zeros((2, 10))), "poses must be"),
        (dict(poses=np.full((4, 10), np.nan)), "pose 0 of joint 'left_hip_lateral' is not finite"),
        (dict(period=0.0), "period = 0.0"),
        (dict(poses=np.zeros((5, 10)), mirror=mirror_of(biped())), "even number of poses"),
    ],
)
def test_a_gait_that_cannot_be_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(some_gait(), **change)


def test_a_vector_of_the_wrong_length_is_refused():
    with pytest.raises(ValueError, match=r"gait vector x must be \(40,\), got \(20,\)"):
        some_gait().from_vector(np.zeros(20))


def test_csv_gives_back_what_was_written_in_the_order_wanted(tmp_path):
    gait = some_gait()
    times, angles = references(gait, 1, np.zeros(10))
    write_angles(tmp_path / "gait.csv", times, angles, gait.joint_names)
    comment, header = (tmp_path / "gait.csv").read_text().splitlines()[:2]
    assert comment.startswith("# featherstone_gait joint angles 2,")
    assert header.startswith("time_s,left_hip_lateral,")
    back_times, back, names = read_angles(tmp_path / "gait.csv")
    assert names == gait.joint_names
    assert np.abs(back_times - times).max() < 1e-9
    assert np.abs(back - angles).max() < 1e-15
    assert np.array_equal(read_angles(tmp_path / "gait.csv", names[::-1])[1], back[:, ::-1])


def test_ax12_counts_1023_over_300_degrees_from_512_in_the_middle(tmp_path):
    assert goal_positions(np.radians([[0.0, 90.0, -90.0, 149.8, -150.0]]), list("abcde")).tolist() == [
        [512, 819, 205, 1023, 0]
    ]
    angles = np.random.default_rng(0).uniform(-2.6, 2.6, (20, 3))
    error = np.degrees(angles_of_goal_positions(goal_positions(angles, list("abc"))) - angles)
    assert np.abs(error).max() <= 0.5 * 300 / 1023 + 1e-12
    write_goal_positions(tmp_path / "goals.csv", [0.0, 0.04], np.zeros((2, 2)), ("a", "b"))
    comment, *lines = (tmp_path / "goals.csv").read_text().splitlines()
    assert comment.startswith("# featherstone_gait goal positions 2,")
    assert lines == ["time_s,a,b", "0.0,512,512", "0.04,512,512"]


@pytest.mark.parametrize("degrees", [150.5, -151.0, np.nan])
def test_an_angle_beyond_the_servo_is_named(degrees):
    with pytest.raises(ValueError, match=r"row 1, joint 'knee': .* -150\.15\.\.149\.85 deg"):
        goal_positions(np.radians([[0.0, 0.0], [0.0, degrees]]), ("hip", "knee"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: column 'time_s' is missing"),
        ("t,hip,knee\n0,1,2\n", "line 1: column 't' is unknown; name the columns time_s, hip, knee"),
        ("time_s,hip\n0,1\n", "line 1: column 'knee' is missing"),
        ("time_s,hip,knee,tail\n0,1,2,3\n", "line 1: column 'tail' is unknown"),
        ("time_s,hip,knee,hip\n0,1,2,3\n", "line 1: column 'hip' is there twice"),
        ("time_s,hip,knee\n", "has 0 samples"),
        ("time_s,hip,knee\n0,1,2\n0.04,1\n", "line 3: has 2 values, expected 3"),
        ("time_s,hip,knee\n0,1,2\n\n0.04,1,2\n", "line 3: has 0 values"),
        ("time_s,hip,knee\n0,1,2\n0.04,1,nan\n", "line 3, column 'knee': 'nan' is not a finite number"),
        ("time_s,hip,knee\n0,one,2\n", "line 2, column 'hip': 'one' is not a finite number"),
        ("time_s,hip,knee\n0,512,2\n", r"line 2, column 'hip': 512 .*-360\.\.360"),
        ("time_s,hip,knee\ninf,1,2\n", "line 2, column 'time_s'"),
        ("time_s,hip,knee\n0.04,1,2\n0.04,1,2\n", "line 3, column 'time_s': 0.04 s does not lie after 0.04 s"),
    ],
)
def test_a_damaged_csv_is_refused_with_file_line_and_column(tmp_path, text, message):
    path = tmp_path / "gait.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"gait.csv.*{message}"):
        read_angles(path, ("hip", "knee"))
