"""Penalties of what a gait must keep to: zero where it is kept, continuous where not, and apart from the cost."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import ContactPoint, Link, Model, Trajectory, load_robot
from featherstone_gait.optimize import walking_cost
from featherstone_gait.walking import ConstrainedCost, ConstraintReport, Constraints
from featherstone_gait.walking.constraints import hull_margins, zmp_margins
from featherstone_gait.walking.zero_moment_point import polygon_margin, support_polygon

STRICT = Constraints(torque=0.5, joint_margin=math.radians(10.0), slip=0.5e-3, zmp_margin=0.01)
NAMES = ("torque", "joint_margin", "slip", "zmp_margin")


@pytest.fixture(scope="module")
def walking():
    """Short: what is looked at is not how well the gait does."""
    return replace(walking_cost(load_robot("humanoid", locked="simplified")), warm_up=1, strides=2)


@pytest.fixture(scope="module")
def vectors(walking):
    """The first gait and one that falls."""
    first, poses = walking.gait.to_vector(), walking.gait.poses.copy()
    poses[:, walking.gait.joint_names.index("left_hip_front")] += 0.7
    return [first, poses.ravel()]


def test_the_margin_is_that_of_the_convex_hull():
    rng = np.random.default_rng(0)
    points, used = rng.normal(size=(40, 8, 2)), rng.random((40, 8)) < 0.7
    used[:, :3] = True
    point = rng.normal(size=(40, 2))
    expected = [polygon_margin(p, support_polygon(x[u])) for p, x, u in zip(point, points, used)]
    assert min(expected) < 0.0 < max(expected)
    assert hull_margins(point, points, used) == pytest.approx(expected, abs=1e-12)


def test_without_two_points_there_is_no_margin():
    points = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    assert math.isnan(hull_margins(np.zeros((1, 2)), points, np.array([[True, False, False]]))[0])


def standing_box(forces):
    """A box on its four corners, pressed by `forces` (n, 4) [N]."""
    box = Link("box", 1.0, (0.0, 0.0, 0.0), (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3))
    corners = tuple(ContactPoint("box", (x, y, -0.1)) for x in (-0.1, 0.1) for y in (-0.05, 0.05))
    n = len(forces)
    base = np.tile([0.3, 0.2, 0.1, 1.0, 0.0, 0.0, 0.0], (n, 1))
    force = np.zeros((n, 4, 3))
    force[..., 0] = forces
    channels = {"base_q": base, "q": np.zeros((n, 0)), "contact_force": force}
    return Model("box", (box,), (), "floating", contacts=corners), Trajectory(channels, "ok", "", 1.0, np.zeros(0))


def test_the_zmp_is_the_center_of_pressure_and_its_margin_is_to_the_nearest_edge():
    even, right, edge, air = [2.0] * 4, [1.0, 3.0, 1.0, 3.0], [0.0, 4.0, 0.0, 4.0], [0.0] * 4
    margins = zmp_margins(*standing_box([even, right, edge, air]))
    assert margins == pytest.approx([0.05, 0.025, 0.0, 0.0], abs=1e-12)
    excess = Constraints(zmp_margin=0.03).violations(*standing_box([even, right, edge, air]), slice(None), 0.0)
    assert excess["zmp_margin"][:, 0] == pytest.approx([-0.02, 0.005, 0.03, 0.03], abs=1e-12)


def test_what_counts_as_load_is_a_share_of_the_local_weight():
    box = standing_box([[0.01, 0.01, 0.01, 0.01]])  # of 1 kg: 0.4 % of its weight on Earth, 2.5 % on the Moon
    assert zmp_margins(*box)[0] == 0.0
    assert zmp_margins(*box, gravity=(0.0, 0.0, -1.62)) == pytest.approx([0.05], abs=1e-12)
    found = Constraints(zmp_margin=0.03).violations(*box, slice(None), 0.0, (0.0, 0.0, -1.62))
    assert found["zmp_margin"][0, 0] == pytest.approx(-0.02, abs=1e-12)


def test_the_zmp_of_a_simulated_walk_never_leaves_the_polygon(walking, vectors):
    """The ground only pushes: that it does not holds of every motion, walking or falling."""
    for run in walking.simulate(vectors, strides=2):
        assert zmp_margins(walking.scene.model, run).min() > -1e-9


def test_what_is_kept_costs_nothing(walking, vectors):
    mild = Constraints(torque=5.0, joint_margin=0.0, slip=0.1)
    report = ConstrainedCost(walking, mild).report(vectors[0])
    assert report.penalties == dict.fromkeys(NAMES[:3], 0.0)
    assert report.violations == dict.fromkeys(NAMES[:3], 0.0)
    # Nothing but penalties is added: the cost has the same bits as without constraints.
    assert report.total == report.cost == walking(vectors[0])[0]


def test_cost_and_penalties_are_reported_apart(walking, vectors):
    cost = ConstrainedCost(walking, STRICT)
    report = cost.report(vectors[0])
    assert isinstance(report, ConstraintReport)
    assert report.cost == walking(vectors[0])[0]
    assert set(report.penalties) == set(NAMES)
    assert all(penalty > 0.0 for penalty in report.penalties.values())
    assert report.violations["slip"] == pytest.approx(report.measures.slip - 0.5e-3)
    assert report.total == report.cost + sum(report.penalties.values())
    assert cost(vectors[0]) == (report.total, "ok")
    assert ConstrainedCost(walking, Constraints(slip=1.0)).report(vectors[0]).penalties.keys() == {"slip"}


def test_a_penalty_is_the_weight_times_the_mean_square_of_the_excess(walking, vectors):
    first, weighted = (
        ConstrainedCost(walking, replace(STRICT, torque_weight=w)).report(vectors[0]) for w in (1.0, 7.0)
    )
    assert weighted.penalties["torque"] == pytest.approx(7.0 * first.penalties["torque"], rel=1e-12)
    # A mean square is no more than the joints' number times the square of the largest excess.
    assert first.penalties["torque"] <= 10 * first.violations["torque"] ** 2
    assert first.penalties["slip"] == pytest.approx(1e6 * first.violations["slip"] ** 2, rel=1e-12)


def test_a_penalty_sets_in_without_a_step(walking, vectors):
    """Near its limit it grows as the square: a tenth of the excess costs a hundredth."""
    slip = walking.measure(vectors[:1])[0].slip
    excess = np.array([0.0, 1e-6, 1e-5, 1e-4])
    reports = [ConstrainedCost(walking, Constraints(slip=slip - e)).report(vectors[0]) for e in excess]
    assert [r.penalties["slip"] for r in reports] == pytest.approx(1e6 * excess**2, rel=1e-6, abs=1e-15)


def test_a_fall_costs_infinity_and_has_no_penalties(walking, vectors):
    cost = ConstrainedCost(walking, STRICT)
    (_, ok), (f, status) = cost.costs(vectors)
    assert ok == "ok"
    assert f == math.inf
    assert "fell at" in status
    assert all(math.isnan(p) for p in cost.report(vectors[1]).penalties.values())


@pytest.mark.parametrize("name", ["torque", "zmp_margin", "slip_weight"])
@pytest.mark.parametrize("value", [-1.0, math.inf, math.nan])
def test_limits_out_of_range_are_named(name, value):
    with pytest.raises(ValueError, match=f"constraints: {name} = {value} must be >= 0 and finite"):
        Constraints(**{name: value})
