"""What lies on a body at the start sizes its contact with the ground, and what comes later is watched."""

import itertools

import numpy as np
import pytest
from touching import obstacle, placed

from featherstone_gait import (
    Box,
    Capsule,
    ContactPoint,
    Ground,
    HeightField,
    Link,
    Model,
    PairContact,
    Placed,
    SceneModel,
    Session,
    Shape,
    Sphere,
    body,
    compile_scene,
    initial_state,
    simulate,
    simulate_batch,
)

G = 9.80665
FLOOR = (obstacle(Box((2.0, 2.0, 0.2)), "floor", (0.0, 0.0, -0.1)),)


def stacked(*things, x=0.0):
    """Boxes (size, mass) on each other from the ground on, named by their order."""
    z, found = 0.0, []
    for k, (size, mass) in enumerate(things):
        found.append(placed(Box(size), mass, f"b{k}", (x, 0.0, z + 0.5 * size[2])))
        z += size[2]
    return found


def scene_of(members, on_ground=True, **options):
    model = SceneModel("stack", members, () if on_ground else FLOOR, ground=Ground() if on_ground else None)
    return compile_scene(model, **{"pairs": "all"} | options)


def borne(scene, name):
    """The mass that the four points of a box on the ground bear at the stated penetration [kg]."""
    first = 0
    for member in scene.members:
        count = len(member.model.contacts)
        if member.name == name:
            return 4 * scene.constants.contact.points.stiffness[first] * scene.ground.penetration / scene.options.g
        first += count
    raise KeyError(name)


@pytest.mark.parametrize("order", [*itertools.permutations(range(3))])
def test_the_ground_bears_a_tree_and_all_that_lies_on_it(order):
    size = (0.1, 0.1, 0.1)
    pile = stacked((size, 0.05), (size, 2.0), (size, 50.0))
    beside = placed(Box(size), 1.0, "beside", (0.12, 0.0, 0.05))
    scene = scene_of([*(pile[k] for k in order), beside])
    for name, mass in (("b0", 52.05), ("b1", 52.0), ("b2", 50.0), ("beside", 1.0)):
        assert borne(scene, name) == pytest.approx(mass, rel=1e-12), name
    limits = [limit.step for limit in scene.preflight.limits if limit.cause == "contact spring"]
    lightest = 2.0 * np.sqrt(0.05 * scene.ground.penetration / (52.05 * scene.options.g))
    assert min(limits) <= lightest * (1.0 + 1e-12)
    assert scene.preflight.largest_explicit_step <= min(limits)


def test_a_stated_load_is_what_the_ground_bears_under_others():
    pile = stacked(((0.1, 0.1, 0.1), 0.5), ((0.1, 0.1, 0.1), 2.0))
    scene = scene_of(pile, pairs=PairContact(load=1.5))
    assert borne(scene, "b0") == pytest.approx(1.5)
    assert borne(scene, "b1") == pytest.approx(2.0)
    later = [pile[0], placed(Box((0.1, 0.1, 0.1)), 2.0, "later", (0.0, 0.0, 1.0))]
    assert borne(scene_of(later, pairs=PairContact(load=1.5)), "b0") == pytest.approx(1.5)
    assert borne(scene_of(later), "b0") == pytest.approx(0.5)


@pytest.mark.long
@pytest.mark.parametrize("on_ground", [True, False])
@pytest.mark.parametrize(
    "things",
    [
        [((0.1, 0.1, 0.1), 0.05), ((0.1, 0.1, 0.1), 50.0)],
        [((0.1, 0.1, 0.1), 50.0), ((0.1, 0.1, 0.1), 0.05), ((0.1, 0.1, 0.1), 20.0)],
        [((0.4, 0.4, 0.02), 0.5), ((0.3, 0.3, 0.3), 20.0)],
        [((0.2, 0.2, 0.004), 0.1)] * 8,
    ],
)
def test_nothing_sinks_by_more_than_twice_its_penetration(things, on_ground):
    members = stacked(*things)
    run = simulate(scene_of(members, on_ground), 2.0, record=("base_q", "base_qd"))
    assert run.status == "ok"
    heights = [run[one.name]["base_q"][-1, 2] for one in members]
    sunk = np.diff([0.0, *(one.position[2] - z for one, z in zip(members, heights))])
    assert (sunk > 0.0).all()
    assert sunk.max() < 2 * 5e-4
    assert max(np.abs(run[one.name]["base_qd"][-1]).max() for one in members) < 1e-4


@pytest.mark.long
@pytest.mark.parametrize("on_ground", [True, False])
@pytest.mark.parametrize("at", [(0.12, 0.12), (0.12, 0.0), (-0.06, 0.1), (0.0, 0.0)])
@pytest.mark.parametrize("light", [0.05, 2.0])
def test_a_load_off_the_middle_presses_no_corner_by_more_than_two_penetrations(light, at, on_ground):
    """Of a plate of 0.3 m on which a cube of 0.1 m and 20 kg stands."""
    members = [placed(Box((0.3, 0.3, 0.02)), light, "plate", (0.0, 0.0, 0.01))]
    members.append(placed(Box((0.1, 0.1, 0.1)), 20.0, "cube", (*at, 0.07)))
    run = simulate(scene_of(members, on_ground), 1.0, record=("base_q", "base_qd"), estimate_error=False)
    assert run.status == "ok"
    _, _, z, w, i, j, _ = run["plate"]["base_q"][len(run["time"]) // 2 :].T
    corners = [z - 0.01 + 2.0 * w * (i * y - j * x) for x in (-0.15, 0.15) for y in (-0.15, 0.15)]
    assert -2.02 * 5e-4 < np.mean(corners, axis=1).min() < -0.9 * 5e-4


def test_only_what_bears_more_than_twice_its_share_is_stiffer():
    """A cube over one corner of a plate bears on a point 1.6 of 2 times what the law allows; over its middle none."""
    stiffness = []
    for x in (0.0, 0.05, 0.12):
        plate = placed(Box((0.3, 0.3, 0.02)), 2.0, "plate", (0.0, 0.0, 0.01))
        scene = scene_of([plate, placed(Box((0.1, 0.1, 0.1)), 18.0, "cube", (x, x, 0.07))])
        stiffness.append(borne(scene, "plate"))
    assert stiffness[:2] == [20.0, pytest.approx(20.0, rel=1e-12)]
    assert stiffness[2] == pytest.approx(
        2.0 * 18.0 * 0.12 / 0.15, rel=1e-9
    )  # three corners bear, as 1 : 0.8 : 0.1 : 0.1


@pytest.mark.long
def test_round_bodies_lie_on_light_ones():
    plate, ball = placed(Box((0.3, 0.3, 0.02)), 0.1, "plate", (0.0, 0.0, 0.01)), Sphere(0.1)
    roll = Placed(body(Capsule(0.1, 0.2), 30.0, name="roll"), position=(0.0, 0.0, 0.12), orientation=(1, 1, 0, 0))
    for heavy in (placed(ball, 30.0, "ball", (0.0, 0.0, 0.12)), roll):
        run = simulate(scene_of([plate, heavy]), 1.0, record=("base_q",))
        assert run.status == "ok"
        assert run["plate"]["base_q"][-1, 2] > 0.01 - 2 * 5e-4


@pytest.mark.long
def test_what_is_dropped_on_a_light_body_ends_the_run_and_is_named():
    """A crate of 20 kg falls on a pallet of 0.5 kg, sized to bear its own weight."""
    pallet = placed(Box((0.4, 0.4, 0.02)), 0.5, "pallet", (0.0, 0.0, 0.01))
    crate = placed(Box((0.3, 0.3, 0.3)), 20.0, "crate", (0.0, 0.0, 0.37))
    scene = scene_of([pallet, crate])
    run = simulate(scene, 1.0, record=("base_q",))
    assert run.status == "too deep"
    assert not run.success
    assert "'pallet/body' and 'ground'" in run.message
    assert "0.01 m" in run.message
    assert np.sqrt(2 * 0.2 / G) < run.end_time < 0.25
    assert 0.01 < 0.01 - run["pallet"]["base_q"][-1, 2] < 0.013
    with Session(scene) as session:
        for _ in range(400):
            session.step()
        assert session.status == ["too deep"]
        assert session.time[0] == pytest.approx(run.end_time, abs=2e-3)


def standing_on_three(count, thickness=0.002, high=0.3):
    """A body of 1 kg on a thin plate of so many contact points, of which three are lower than the others."""
    corners = [(0.05, 0.05, 0.0), (0.05, -0.05, 0.0), (-0.1, 0.0, 0.0)]
    at = [*corners, *((0.001 * k, 0.0, 0.05) for k in range(count - 3))]
    points = tuple(ContactPoint("plate", one) for one in at)
    plate = Link("plate", mass=1.0, center_of_mass=(0.0, 0.0, high), inertia=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    shapes = (Shape("plate", Box((0.1, 0.1, thickness))),)
    return Model("plate", (plate,), (), "floating", contacts=points, shapes=shapes)


def test_a_thin_foot_may_stand_on_few_of_its_points_on_a_plane():
    """Its weight on 3 of 30 points presses them in by 10 times the stated depth, and the plane bears it."""
    scene = compile_scene(standing_on_three(30), ground=Ground(), integrator="midpoint", timestep=1e-3)
    run = simulate(scene, 1.0, record=("base_q",))
    assert run.status == "ok"
    assert -run["base_q"][-1, 2] == pytest.approx(30 / 3 * 5e-4, rel=1e-3)  # more than half of the plate, 1 mm
    start = run.final.copy()
    for height, status in ((-0.028, "ok"), (-0.032, "too deep")):  # 30 mm: 2 * 30 * 0.5 mm, or a tenth of 0.3 m
        start[scene.layout["base_q"] + 2] = height
        assert simulate(scene, 0.002, start).status == status


@pytest.mark.parametrize(
    ("count", "high", "depth"), [(30, 0.3, 0.03), (30, 0.1, 0.01), (4, 0.3, 0.004), (3, 0.01, 0.001)]
)
def test_how_deep_a_thin_foot_may_be(count, high, depth):
    """Twice the weight on one point, at most a tenth of the standing height, and two depths at rest in any case."""
    for field in (None, HeightField(np.zeros((3, 3)), (1.0, 1.0), (-1.0, -1.0))):
        scene = compile_scene(standing_on_three(count, high=high), ground=Ground(field=field))
        found = scene.constants.contact.points.deepest
        assert found == pytest.approx(np.full(count, depth), rel=1e-12)


THROUGH = {
    "ars343": {}, "extrapolation": {"rtol": 1e-6}, "implicit_euler": {"timestep": 1e-4}, "midpoint": {"timestep": 1e-4},
    "rk4": {"timestep": 1e-5},
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("integrator", THROUGH)
def test_a_ball_that_passes_a_plate_is_told(integrator):
    """It has 10 g and 30 m/s: the law, sized by its weight, does not stop it within a plate of 1 mm."""
    options = dict(THROUGH[integrator])
    tolerance = {"rtol": options.pop("rtol")} if "rtol" in options else {}
    ball = placed(Sphere(0.01), 0.01, "ball", (0.0, 0.0, 0.0115))
    model = SceneModel("pass", [ball], [obstacle(Box((1.0, 1.0, 0.001)), "plate")])
    scene = compile_scene(model, pairs="all", integrator=integrator, **options)
    start = initial_state(scene, None, {"ball": (0.0, 0.0, -30.0, 0.0, 0.0, 0.0)})
    run = simulate(scene, 0.01, start, estimate_error=False, **tolerance)
    assert run.status == "too deep"
    assert "'ball/body' and 'plate/body'" in run.message
    assert run.end_time < 2e-3


@pytest.mark.long
def test_a_depth_ends_a_lane_where_it_ends_the_run_alone():
    ball = placed(Sphere(0.01), 0.01, "ball", (0.0, 0.0, 0.0115))
    model = SceneModel("pass", [ball], [obstacle(Box((1.0, 1.0, 0.001)), "plate")])
    scene = compile_scene(model, pairs="all", integrator="implicit_euler", timestep=1e-4)
    starts = [initial_state(scene, None, {"ball": (0, 0, -v, 0, 0, 0)}) for v in (0.1, 30.0, 0.02, 40.0, 0.05, 0.1)]
    several = simulate_batch(scene, 0.01, starts, estimate_error=False)
    for start, run in zip(starts, several):
        alone = simulate(scene, 0.01, start, estimate_error=False)
        assert (run.status, run.end_time) == (alone.status, alone.end_time)
        assert run.final.tobytes() == alone.final.tobytes()
    assert [run.status for run in several] == ["ok", "too deep", "ok", "too deep", "ok", "ok"]
