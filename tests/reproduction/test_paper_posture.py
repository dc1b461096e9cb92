"""The complete humanoid holds a posture (the paper's Table 3, Figs. 12 and 13)."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import inverse_dynamics, load_robot
from featherstone_gait.reproduction.posture import (
    BASES,
    EXPLICIT,
    IMPLICIT,
    JOINTS,
    QUICK,
    SHORT_INTEGRAL_TIME,
    TABLE_3,
    P,
    check,
    ordered,
    plot,
    run,
    table,
)

pytestmark = pytest.mark.long

SHORT = replace(QUICK, gains=(61.0,), steps=(1e-3,), masses=(0.6,), duration=14.0, dropped=7.0)
REFERENCE = np.array([reference for reference, _ in TABLE_3.values()])


@pytest.fixture(scope="module")
def result():
    return run(SHORT)


def test_the_posture_lies_within_the_joints_limits_and_the_table_within_itself():
    joints = {joint.name: joint for joint in load_robot("humanoid").joints}
    for name, (reference, models) in TABLE_3.items():
        assert joints[name].lower < np.radians(reference) < joints[name].upper
        for highest, lowest, deviation in models.values():
            assert lowest + deviation < highest


def test_the_proportional_law_droops_by_the_static_torque(result):
    """Torque over Kp G K / R at the angles reached; Coulomb friction may hide 1.7e-5 N m, which is 7e-5 deg."""
    model = load_robot("humanoid", "fixed")
    places = [model.joint_names.index(name) for name in JOINTS]
    found = result.of(integrator=IMPLICIT, base="fixed", integral_time=P).mean[0]
    q = np.zeros(19)
    q[places] = np.radians(found)
    servo = model.servos["left_elbow"]
    stiffness = 61.0 * servo.gearbox.ratio * servo.motor_constant / servo.resistance
    torque = inverse_dynamics(model, q, np.zeros(19), np.zeros(19))[places]
    # The other joints droop too, by up to 0.1 deg, which turns the arms by as much: some 0.2 % of the torque.
    np.testing.assert_allclose(REFERENCE - found, np.degrees(torque / stiffness), rtol=5e-3, atol=1e-3)
    assert np.abs(REFERENCE - found).max() > 0.4


def test_integral_action_centers_the_angles(result):
    """Its rest after 7 of its time constants is e^-7 of 0.5 deg; the standing sway is another 0.001 deg."""
    for base in BASES:
        assert np.abs(result.of(gearbox="mipsd", base=base).mean - REFERENCE).max() < 5e-3


def test_the_standard_model_chatters_and_the_others_stand_still(result):
    """Standing, the elbow's deviation is 0.06 to 0.13 deg over 8 disturbances, the lateral shoulder's 0.03 to 0.16."""
    elbow, shoulder = JOINTS.index("left_elbow"), JOINTS.index("right_lateral_shoulder")
    for Ti in (1.0, P):
        found = result.of(integral_time=Ti)
        assert set(found.statuses) == {"chatter"}
        assert 0.03 < found.typical[elbow] < 0.3
        assert 0.03 < found.typical[shoulder] < 0.3
    for base in BASES:
        assert set(result.of(gearbox="mipsd", base=base).statuses) == {"ok"}
        # Standing with MIPSD a sway of 0.02 deg dies away slowly, twice that at the earlier window of this test.
        assert result.of(gearbox="mipsd", base=base).typical.max() < 0.08
        assert result.of(integrator=IMPLICIT, base=base).typical.max() < 2e-3
    assert result.of(gearbox="rotor", base="fixed").typical.max() < 2e-3


def test_the_chatter_hangs_on_step_and_inertia(result):
    """Some tenfold each way, three to be safe from the spread over disturbances."""
    elbow = JOINTS.index("left_elbow")
    assert result.of(step=5e-4).typical[elbow] < result.of().typical[elbow] / 3.0
    assert result.of(mass=0.6).typical[elbow] > result.of().typical[elbow] * 3.0
    assert result.of(base="fixed", step=2e-3).typical[elbow] > result.of(base="fixed").typical[elbow] * 3.0


def test_the_least_inertia_shakes_most(result):
    """With the trunk fixed; the paper's order, which its masses alone could not give: both shoulders feel the same."""
    assert np.argmin(result.inertias) == JOINTS.index("left_elbow")
    assert np.argmax(result.of(base="fixed").typical) == JOINTS.index("left_elbow")
    assert np.argmin(result.of(base="fixed").typical) == np.argmax(result.inertias)


def test_fast_integral_action_topples_the_standing_robot_with_every_model(result):
    for gearbox in ("standard", "mipsd"):
        for integrator in (EXPLICIT, IMPLICIT):
            assert result.of(gearbox=gearbox, integrator=integrator, integral_time=SHORT_INTEGRAL_TIME).fell


def test_verdicts(result):
    claims = check(result)
    assert [claim.verdict for claim in claims] == [
        "not reproduced",  # standard: 0.1 deg instead of 0.8
        "not reproduced",  # MIPSD: two joints move less than a third of 0.01 deg
        "reproduced in direction",  # less in all joints
        "reproduced",  # centered
        "not reproduced",  # order of joints: with the trunk fixed alone
        "not reproduced",  # the gearbox is not what it takes
    ]
    assert all(claim.why and claim.ours for claim in claims)


def test_the_order_of_the_joints_needs_more_than_one_base(result):
    fixed = [case for case in ordered() if case.base == "fixed"]
    for n, verdict in ((0, "not reproduced"), (1, "reproduced in direction"), (6, "reproduced")):
        others = {replace(case, base="floating"): result.outcomes[case] for case in fixed[:n]}
        assert check(replace(result, outcomes=result.outcomes | others))[4].verdict == verdict


def test_table_and_figures(result):
    lines = table(result).splitlines()
    assert len(lines) == 1 + 2 * (1 + 8)
    assert len({len(line) for line in lines}) == 1
    figures = plot(result)
    assert len(figures) == 3
    for figure in figures.values():
        figure.draw_without_rendering()


@pytest.mark.parametrize("wrong", [{"dropped": 20.0}, {"disturbances": 0}])
def test_settings_that_make_no_experiment_are_refused(wrong):
    with pytest.raises(ValueError, match=r"is .*; "):
        replace(QUICK, **wrong)
