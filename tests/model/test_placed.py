"""Models at their places, and what is in a scene before it is compiled."""

import math

import numpy as np
import pytest

from featherstone_gait import Box, Capsule, Cylinder, Hull, Mesh, Placed, SceneModel, Sphere, body
from featherstone_gait.model import inertia_matrix

BALL = body(Sphere(0.1), mass=1.0, name="ball")
WALL = body(Box((1.0, 1.0, 1.0)), name="wall", base="fixed")
SIZE = (0.1, 0.2, 0.3)


def inertia(model):
    return inertia_matrix(model.links[0].inertia)


def sampled(inside, half, mass, n=120):
    """Inertia about the center of a symmetric solid, by a grid of points inside of it."""
    axes = [np.linspace(-h, h, n + 1)[:-1] + h / n for h in half]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    x = x[inside(x)]
    second = x.T @ x / len(x)
    return mass * (np.eye(3) * np.trace(second) - second)


@pytest.mark.parametrize(
    ("shape", "inside"),
    [
        (Capsule(0.1, 0.3), lambda x: np.hypot(np.hypot(*x.T[:2]), np.maximum(0.0, abs(x[:, 2]) - 0.15)) <= 0.1),
        (Cylinder(0.1, 0.5), lambda x: np.hypot(*x.T[:2]) <= 0.1),
        (Sphere(0.1), lambda x: (x**2).sum(-1) <= 0.01),
        (Box((0.2, 0.2, 0.5)), lambda x: x[:, 0] < math.inf),
    ],
)
def test_a_body_has_the_inertia_of_its_points(shape, inside):
    assert inertia(body(shape, mass=3.0)) == pytest.approx(sampled(inside, (0.1, 0.1, 0.25), 3.0), rel=3e-3, abs=1e-12)


def test_a_hull_of_a_box_is_the_box_wherever_it_is():
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * SIZE + (3.0, -1.0, 2.0)
    hull = body(Hull(tuple(map(tuple, corners.tolist()))), mass=2.0)
    assert inertia(hull) == pytest.approx(inertia(body(Box(SIZE), mass=2.0)), abs=1e-15)
    assert hull.links[0].center_of_mass == pytest.approx(corners.mean(0), abs=1e-14)


def test_a_body_touches_by_points_and_an_obstacle_by_none():
    assert [len(body(s, mass=1.0).contacts) for s in (Box(SIZE), Sphere(1.0), Capsule(0.1, 1.0))] == [8, 1, 2]
    lowest = [point for point in body(Box(SIZE), mass=1.0).contacts if point.load_bearing]
    assert {point.position[2] for point in lowest} == {-0.15}
    assert {point.friction for point in body(Box(SIZE), mass=1.0, friction=0.3).contacts} == {0.3}
    assert WALL.contacts == ()
    assert len(WALL.shapes) == 1


def test_orientations_are_normalized_and_unit_ones_keep_their_bits():
    assert Placed(BALL, orientation=(0, 0, 0, -3)).orientation == (0.0, 0.0, 0.0, -1.0)
    assert Placed(BALL, orientation=(1e40, 0, 1e40, 0)).orientation == pytest.approx((0.5**0.5, 0.0, 0.5**0.5, 0.0))
    unit = (0.6, 0.0, 0.8, 0.0)
    assert Placed(BALL, orientation=unit).orientation == unit
    assert [Placed(BALL).name, Placed(BALL, "b").name] == ["ball", "b"]


WRONG_VALUES = [
    lambda: body(Sphere(0.1)),
    lambda: body(Sphere(0.1), mass=-1.0),
    lambda: body(Sphere(0.1), mass=math.nan),
    lambda: body(Box((0.1, 0.1, 0.0)), mass=1.0),
    lambda: body(Hull(((0, 0, 0), (1, 0, 0), (0, 1, 0))), mass=1.0),
    lambda: body(Mesh("nowhere.stl"), mass=1.0),
    lambda: body(Sphere(0.1), mass=1.0, inertia=(1.0, 0.0)),
    lambda: body(Sphere(0.1), mass=1.0, base="flying"),
    lambda: body(Sphere(0.1), mass=1.0, name=""),
    lambda: Placed(BALL, "a/b"),
    lambda: Placed(BALL, position=(0.0, math.inf, 0.0)),
    lambda: Placed(BALL, orientation=(0.0, 0.0, 0.0, 0.0)),
    lambda: Placed(BALL, orientation=(1.0, 0.0, 0.0)),
    lambda: SceneModel("s", ()),
    lambda: SceneModel("", [Placed(BALL)]),
    lambda: SceneModel("s", [Placed(BALL), Placed(BALL)]),
    lambda: SceneModel("s", [Placed(BALL)], [Placed(BALL, "b")]),
    lambda: SceneModel("s", [Placed(BALL)], gravity=(0.0, 0.0)),
    lambda: SceneModel("s", [Placed(BALL)], excluded=[("ball/body", "ball/hand")]),
    lambda: SceneModel("s", [Placed(BALL)], excluded=[("ball/body",)]),
    lambda: SceneModel("s", [Placed(BALL)]).member("cube"),
]
WRONG_TYPES = [
    lambda: body("box", mass=1.0),
    lambda: Placed("ball"),
    lambda: Placed(BALL, gearbox=3),
    lambda: Placed(BALL, ground_contact=1),
    lambda: SceneModel("s", [BALL]),
    lambda: SceneModel("s", [Placed(BALL)], ground=0.5),
]


@pytest.mark.parametrize("wrong", WRONG_VALUES, ids=range(len(WRONG_VALUES)))
def test_what_makes_no_sense_is_refused(wrong):
    with pytest.raises(ValueError, match=r"body|place|scene|nowhere"):
        wrong()


@pytest.mark.parametrize("wrong", WRONG_TYPES, ids=range(len(WRONG_TYPES)))
def test_other_types_are_refused(wrong):
    with pytest.raises(TypeError):
        wrong()
