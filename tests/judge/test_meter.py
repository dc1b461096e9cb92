"""How robots walk in a judgment: clearance of the feet, slip, time near a fall, on any ground."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from featherstone_gait import ContactPoint, Ground, Joint, Link, Model, compile_scene
from featherstone_gait.judge.floors import Floors, rough_fields
from featherstone_gait.judge.meter import LABELS, Meter, _Feet
from featherstone_gait.model import HeightField
from featherstone_gait.scene.contact import ground_under

RADIUS, STEP = 0.1, 1e-2


def measured(base_q, force=1.0, **how):
    """What a meter finds of a single ball whose base moves as stated (samples, 7)."""
    links = [Link(name, mass=m, inertia=(m, 0.0, 0.0, m, 0.0, m)) for name, m in (("ball", 1.0), ("hand", 1e-9))]
    touching = (ContactPoint("ball", (0.0, 0.0, 0.0), radius=RADIUS),)
    model = Model("ball", tuple(links), (Joint("wrist", "continuous", "ball", "hand"),), "floating", contacts=touching)
    scene = compile_scene(model, ground=Ground(**how))
    n = len(base_q)
    session = SimpleNamespace(
        scene=scene, scenes=[scene], n=1, time=np.array([STEP * (n - 1)]),
        state_view={"energy": np.zeros((1, 1, len(LABELS)))},
    )  # fmt: skip
    seen = [
        {"q": np.zeros((1, 1)), "qd": np.zeros((1, 1)), "base_q": row[None], "torque": np.zeros((1, 1)),
         "contact_force": np.full((1, 1, 3), force), "energy": np.zeros((1, 1, len(LABELS)))}
        for row in base_q
    ]  # fmt: skip
    meter = Meter(session, seen[0], np.array([1.0, 0.0]), STEP)
    for one in seen[1:]:
        meter.take(one, np.ones(1, bool))
    return {name: float(values[0]) for name, values in meter.result()[0].items()}


def moving(way, turn, n=101):
    """Bases that go ahead [m] and turn about y [rad] at even speeds."""
    share = np.linspace(0.0, 1.0, n)
    base = np.zeros((n, 7))
    base[:, 0], base[:, 2] = way * share, RADIUS
    base[:, 3], base[:, 5] = np.cos(0.5 * turn * share), np.sin(0.5 * turn * share)
    return base


@pytest.mark.parametrize(
    ("turn", "slip"),
    [(0.0, 1.0), (1.0 / RADIUS, 0.0), (-1.0 / RADIUS, 2.0), (0.5 / RADIUS, 0.5)],
    ids=["sliding", "rolling", "spinning back", "half rolling"],
)
def test_slip_is_the_way_of_the_matter_that_touches(turn, slip):
    """A ball that rolls has none, though its lowest point moves as far as the ball."""
    assert measured(moving(0.1, 0.1 * turn))["slip"] == pytest.approx(slip, abs=2e-3)


def test_what_carries_no_load_does_not_slip():
    assert measured(moving(1.0, 0.0), force=0.0)["slip"] == 0.0


def test_near_a_fall_is_half_of_its_tilt_or_of_its_sinking():
    """A fall is a tilt of 45 degrees or 0.6 of the standing height: near it are 22.5 degrees, and 0.8."""
    tilted = moving(1.0, math.radians(45.0), 1001)  # half of the time beyond the half
    assert measured(tilted)["near_fall"] == pytest.approx(0.5, abs=2e-3)
    sinking = moving(1.0, 0.0, 1001)
    sinking[:, 2] = RADIUS * np.linspace(1.0, 0.6, 1001)
    assert measured(sinking)["near_fall"] == pytest.approx(0.5, abs=2e-3)
    level = moving(1.0, 0.0, 1001)
    level[:, 2] += math.tan(0.1) * level[:, 0] + RADIUS * (1.0 / math.cos(0.1) - 1.0)
    assert measured(level, slope=0.1)["near_fall"] == 0.0  # it is as high over the slope as it stands


def test_a_swing_counts_from_lift_to_touch_by_its_highest():
    """Of two worlds: swings of 30 and 50 mm, one that only rebounds; and one foot that never touches."""
    over, loaded = np.zeros((60, 2, 1)), np.ones((60, 2, 1), bool)
    for first, height in ((5, 0.03), (25, 0.05)):
        over[first : first + 15, 0, 0] = height * np.sin(np.linspace(0.0, np.pi, 15))
        loaded[first : first + 15, 0] = False
    over[50:55, 0], loaded[50:55, 0] = 0.001, False
    over[:, 1], loaded[:, 1] = 0.2, False
    feet = _Feet(2, [np.array([0])], STEP)
    for heights, on in zip(over, loaded):
        feet.take(heights, on, np.ones(2, bool))
    median, least = feet.clearance()
    assert (median[0], least[0]) == pytest.approx((0.04, 0.03), rel=1e-12)
    assert np.isnan([median[1], least[1]]).all()


def test_floors_of_many_worlds_are_looked_up_as_one_by_one():
    draws = np.random.default_rng(0)
    x = draws.uniform(-1.5, 1.5, (5, 40, 3))
    tilts = (draws.normal(size=(5, 2)) / 3).tolist()
    planes = [Ground(slope=s, heading=h, height=0.1 * s, steps=((0.2, 0.03),)) for s, h in tilts]
    fields = rough_fields(np.full(5, 0.02), np.zeros(5), np.zeros(5), 0.1, 1.0, 0.2, [3])  # narrower than the points
    hills = [Ground(field=one, height=0.01 * k) for k, one in enumerate(fields)]
    for grounds in (planes, hills):
        normals, over = Floors(grounds).under(x)
        for k, ground in enumerate(grounds):
            alone = ground_under(ground, x[k])
            assert np.abs(normals[k] - alone[:, :3]).max() < 1e-9
            assert np.abs(over[k] - alone[:, 6] * alone[:, 2]).max() < 1e-12


def test_a_rough_field_is_as_rough_as_stated_and_even_where_the_robot_stands():
    slope, heading = np.array([0.0, 0.05]), np.array([0.0, 1.0])
    wide = rough_fields(np.array([0.01, 0.02]), slope, heading, 0.05, 3.0, 0.3, [7])
    for field, rms, s, h in zip(wide, (0.01, 0.02), slope, heading):
        x, y = (np.array(field.origin)[:, None] + 0.05 * np.arange(field.heights.shape[0]))[:, :, None]
        rough = field.heights - math.tan(s) * (math.cos(h) * x + math.sin(h) * y.T)
        away = np.hypot(x, y.T) > 0.4
        deviation = rms / math.sqrt(2.0 * away.sum())
        assert abs(rough[away].std() - rms) < 4.0 * deviation
        assert abs(np.mean(rough[away][1:] * rough[away][:-1])) < 4.0 * rms**2 / math.sqrt(away.sum())  # node by node
        assert np.abs(rough[~away & (np.hypot(x, y.T) < 0.3)]).max() < 1e-15
    narrow = rough_fields(np.array([0.01, 0.02]), slope, heading, 0.05, 1.0, 0.3, [7])
    middle = slice(40, 81)
    assert np.abs(wide[1].heights[middle, middle] - narrow[1].heights).max() < 1e-15
    assert isinstance(narrow[0], HeightField)
