"""Robots on wheels against the closed forms of their kinematics."""

import math

import numpy as np
import pytest

from featherstone_gait import ContactPoint, Ground, Joint, Link, Model, compile_scene, initial_state, simulate

RADIUS, TRACK = 0.05, 0.3


def cart():
    """Return a cart with two wheels on one axle and a caster that slides before and behind it."""
    inertia = (0.01, 0.0, 0.0, 0.02, 0.0, 0.02)
    links, joints, points = [Link("cart", 2.0, (0.0, 0.0, 0.0), inertia)], [], []
    for name, y in (("left", 0.5 * TRACK), ("right", -0.5 * TRACK)):
        links.append(Link(name, 0.2, (0.0, 0.0, 0.0), (1.3e-4, 0.0, 0.0, 2.5e-4, 0.0, 1.3e-4)))
        joints.append(Joint(name, "continuous", "cart", name, xyz=(0.0, y, 0.0), axis=(0.0, 1.0, 0.0)))
        place = (0.0, 0.01 * RADIUS, 0.0)  # the circle lies a hundredth of its radius inside of what it is the end of
        points.append(ContactPoint(name, place, circle_radius=RADIUS, axis=(0.0, 1.0, 0.0), friction=0.8))
    for x in (-0.15, 0.15):
        points.append(ContactPoint("cart", (x, 0.0, -RADIUS), friction=0.0))
    return Model("cart", tuple(links), tuple(joints), "floating", contacts=tuple(points))


@pytest.mark.long
def test_a_differential_drive_turns_about_the_point_that_its_wheels_say():
    """Torques bring it to speed without slip; then it rolls along a circle of radius v / w for good."""
    scene = compile_scene(cart(), ground=Ground(penetration=1e-5), fall_height=-1e6)
    run = simulate(scene, 1.0, initial_state(scene), tau=[0.02, 0.03], record=("qd", "base_qd"), rtol=1e-8)
    left, right = run["qd"][-1]
    v, w = 0.5 * RADIUS * (left + right), RADIUS * (right - left) / TRACK
    speed, turning = np.hypot(*run["base_qd"][-1, :2]), run["base_qd"][-1, 5]
    assert [speed, turning] == pytest.approx([v, w], rel=1e-5)
    coasting = simulate(scene, 3.0, run, record=("base_q", "base_qd"), rtol=1e-8)
    v, w = np.hypot(*coasting["base_qd"][-1, :2]), coasting["base_qd"][-1, 5]
    assert [v, w] == pytest.approx([speed, turning], rel=1e-5)  # it loses nothing
    x, y = coasting["base_q"][:, :2].T
    solved = np.linalg.lstsq(np.stack([2 * x, 2 * y, np.ones(len(x))], axis=1), x * x + y * y, rcond=None)[0]
    radius = math.sqrt(solved[2] + solved[0] ** 2 + solved[1] ** 2)
    assert radius == pytest.approx(v / w, rel=1e-5)
