"""Pictures of scenes of several robots and objects."""

import numpy as np
import pytest
from browser import found_in

from featherstone_gait.benchmark.scenes import unlimited
from featherstone_gait.geometry.body import body
from featherstone_gait.model import ContactPoint, FloorLine, Fluid, Ground, Immersed, Joint, Link, Model, Propeller
from featherstone_gait.model.placed import Placed, SceneModel
from featherstone_gait.model.sensor import RangeSensor
from featherstone_gait.model.shapes import Box, Cylinder, Shape, Sphere
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.simulate import simulate
from featherstone_gait.run.trajectory import Trajectory
from featherstone_gait.scene.compile import compile_scene
from featherstone_gait.view.movie import Picture, _actors, save_movie
from featherstone_gait.view.page import page_html
from featherstone_gait.view.recorded import Seen, page_data
from featherstone_gait.view.shown import _company, _seen, show, show_live, title_of

TURNED = (0.0, 0.0, 0.0, 1.0)


def four():
    arm = unlimited(load_robot("arm7"))
    members = (
        Placed(arm, "left", (0.0, 0.5, 0.0)),
        Placed(arm, "right", (0.0, -0.5, 0.2), TURNED),
        Placed(body(Sphere(0.1), 1.0), "ball", (0.5, 0.0, 1.0)),
        Placed(body(Box((0.2, 0.2, 0.2)), 1.0), "crate", (1.0, 0.0)),
    )
    table = Placed(body(Box((0.3, 0.3, 0.4)), name="table", base="fixed"), position=(2.0, 0.0, 0.2))
    return SceneModel("four", members, (table,), Ground())


def test_a_page_draws_four_robots_and_an_obstacle_at_their_places():
    scene = compile_scene(four(), None, integrator="implicit_euler", timestep=1e-3)
    run = simulate(scene, 0.1, record=("q", "base_q"), estimate_error=False)
    seen, _, _ = _company([run], scene, ())
    data = page_data(seen, together=True)
    assert [one["caption"] for one in data["runs"]] == ["left", "right", "ball", "crate", "table"]
    first = {one["caption"]: data["unit"] * np.reshape(one["frames"][0], (-1, 7))[:, :3] for one in data["runs"]}
    right = 2.0 * np.array([0.0, 0.0, 0.1])  # its root is 0.2 m above the ground, and it is turned by 180 degrees
    assert first["right"][0] == pytest.approx(np.array([0.0, -0.5, 0.0]) + right, abs=0.05)
    assert first["ball"][0] == pytest.approx([0.5, 0.0, 1.0], abs=1e-3)
    assert first["table"][0] == pytest.approx([2.0, 0.0, 0.2], abs=1e-3)
    assert len({tuple(one["middle"]) for one in data["runs"]}) == 1


def row(status="ok", message="", far=50.0):
    """Ten blocks in a row, which fall to the ground by hand, and a ball that leaves for far away."""
    time = np.linspace(0.0, 1.0, 26)
    seen = {}
    for k in range(11):
        model = body(Box((0.02, 0.08, 0.16)), mass=0.1) if k < 10 else body(Sphere(0.04), mass=0.3)
        base = np.tile([0.08 * k, 0.0, 0.08, 1.0, 0.0, 0.0, 0.0], (len(time), 1))
        base[:, 0] += far * time * (k == 10)
        channels = {"time": time, "q": np.zeros((len(time), 0)), "base_q": base}
        info = {"robot": f"block{k}", "joints": []}
        how = (status, message) if k == 3 else ("ok", "")
        seen[f"block{k}"] = Seen(model, Trajectory(channels, *how, 1.0, np.zeros(0), info), Ground())
    return seen


def test_the_camera_begins_with_the_bodies_as_they_stand_whatever_leaves_later():
    data, near = page_data(row(), together=True), page_data(row(far=0.0), together=True)
    assert near["span"] <= data["span"] < 1.3 * near["span"]
    assert 0.84 < near["span"] < 1.5 * 0.84  # from the first block to the ball [m]
    assert data["runs"][0]["middle"] == pytest.approx([0.5, 0.0, 0.08], abs=0.1)
    assert not any(run["feet"] or run["prints"] for run in data["runs"])  # nothing of it walks


SEEN = """
viewer.show();
const canvas = document.querySelector("#views canvas"), heads = [...document.querySelectorAll("figcaption div")];
return {lines: heads.map(e => e.textContent), high: canvas.clientHeight / innerHeight,
  toggles: [...document.querySelectorAll("#toggles button")].map(b => b.textContent),
  label: canvas.getAttribute("aria-label"), words: document.querySelector(".now").textContent,
  controls: document.getElementById("controls").getBoundingClientRect().bottom - innerHeight};
"""


@pytest.mark.quick("how1-*")
@pytest.mark.parametrize(("how", "lines"), [
    ({}, ["11 bodies ok"]),
    ({"status": "inaccurate", "message": "by 1 rad"}, ["10 bodies ok", "block3 inaccurateby 1 rad"]),
])  # fmt: skip
def test_the_picture_of_many_bodies_has_at_least_half_of_the_window(how, lines, tmp_path):
    page = page_html(row(**how), "row", together=True)
    found, console = found_in(page, SEEN, tmp_path, sizes=[(1280, 720), (640, 480), (375, 667)])
    assert console == []
    for one in found:
        assert one["lines"] == lines
        assert one["high"] >= 0.5
        assert one["controls"] <= 0.5
        assert one["toggles"] == []  # no feet, no forces, nobody to follow
        assert one["label"].startswith("moving picture of 1")
        assert one["words"].startswith("squares of ")


def test_a_title_names_few_members():
    model = body(Sphere(0.1), 1.0)
    for count, title in ((3, "b0 and b1 and b2"), (5, "b0 and 4 more")):
        members = [Placed(model, f"b{k}", (float(k), 0.0, 1.0)) for k in range(count)]
        scene = compile_scene(SceneModel("many", members), integrator="rk4", timestep=1e-3)
        assert title_of(scene) == title


def test_a_robot_without_a_run_is_told_how_it_is_shown():
    with pytest.raises(TypeError, match=r"featherstone-gait view ROBOT.*compile_scene"):
        show(load_robot("ax12_arm"))


def test_pictures_of_one_robot_name_the_member_to_take(tmp_path):
    scene = compile_scene(four(), None, integrator="implicit_euler", timestep=1e-3)
    run = simulate(scene, 0.1, record=("q", "base_q"), estimate_error=False)
    with pytest.raises(ValueError, match="one by one"):
        show(run, scene, run)
    for wrong in (dict(captions=["all"]), dict(ghosts=True)):
        with pytest.raises(ValueError, match="captions, ghosts"):
            show(run, scene, **wrong)
    for robot in (None, load_robot("arm7")):
        with pytest.raises(ValueError, match="scene"):
            show(run, robot)
    show(run, scene, path=tmp_path / "four.html")
    assert '"together":true' in (tmp_path / "four.html").read_text("utf-8")


@pytest.fixture(scope="module")
def pile():
    """A lid on a crate on a table; the scene and its run."""
    lid, crate = body(Cylinder(0.1, 0.2), 1.0), body(Box((0.2, 0.2, 0.2)), 1.0)
    members = (Placed(lid, "lid", (0.0, 0.0, 0.7 - 1e-3)), Placed(crate, "crate", (0.0, 0.0, 0.5 - 5e-4)))
    table = body(Box((0.3, 0.3, 0.4)), name="table", base="fixed")
    scene = SceneModel("pile", members, (Placed(table, position=(0.0, 0.0, 0.2)),))
    compiled = compile_scene(scene, None, integrator="extrapolation", pairs="all")
    record = ("q", "base_q", "pair", "pair_force", "pair_position", "pair_normal_force")
    return compiled, simulate(compiled, 0.3, record=record, estimate_error=False)


def test_a_page_draws_the_forces_of_other_bodies_on_each_member(pile):
    """All of a member balance its weight; the lid presses on the crate; plots name the other body."""
    compiled, run = pile
    seen, _, _ = _company([run], compiled, ())
    data = page_data(seen, together=True)
    for shown in data["runs"][:2]:
        numbers = np.reshape(shown["pairs"][-1], (-1, 6))
        assert 1e-3 * numbers[:, 3:].sum(axis=0) == pytest.approx([0.0, 0.0, 1.0], abs=2e-2)
    down = np.reshape(data["runs"][1]["pairs"][-1], (-1, 6))
    assert 1e-3 * down[down[:, 5] < 0, 5].sum() == pytest.approx(-1.0, abs=1e-2)
    assert data["unit"] * down[down[:, 5] < 0, 2] == pytest.approx(0.6, abs=2e-3)
    assert data["runs"][0]["channels"]["pair_normal_force"]["labels"] == ["body - crate/body"]
    assert data["runs"][1]["channels"]["pair_normal_force"]["labels"] == ["body - table/body", "body - lid/body"]


def test_the_live_page_draws_all_members_where_they_are_and_their_forces(pile):
    """Arrows on a member add up to its weight, 0.8 times its size; the lid's push on the crate points down."""
    pytest.importorskip("viser")
    compiled, run = pile
    with pytest.raises(ValueError, match="captions, ghosts"):
        show_live(run, compiled, ghosts=True)
    with show_live(run, compiled, port=0) as live:
        live.seek(0.3)
        actors = {actor.caption: actor for actor in live._actors}
        assert list(actors) == ["lid", "crate", "table"]
        assert not any(actor.place.position.any() for actor in actors.values())
        for name, height in (("lid", 0.7), ("crate", 0.5)):
            assert actors[name].links["body"].position == pytest.approx([0.0, 0.0, height], abs=2e-3)
            arrows = np.diff(actors[name].arrows.points, axis=1)[:, 0]
            assert arrows.sum(axis=0) == pytest.approx([0.0, 0.0, 0.8 * actors[name].size], abs=1e-2)
        down = np.diff(actors["crate"].arrows.points, axis=1)[:, 0, 2]
        assert down[down < 0.0].sum() == pytest.approx(-0.8 * actors["crate"].size, abs=1e-2)
        assert actors["table"].arrows.visible is False


def test_a_movie_draws_all_members_and_obstacles(pile, tmp_path):
    """From side to side of the table, from its foot to the top of the lid."""
    compiled, run = pile
    models, motions, _ = _actors(run, compiled)
    picture = Picture(models, np.hstack([motion[:1] for motion in motions]), 0.0)
    assert picture.low == pytest.approx([-0.15, -0.15, 0.0], abs=2e-3)
    assert picture.high == pytest.approx([0.15, 0.15, 0.8], abs=3e-3)
    assert save_movie(run, tmp_path / "frames", compiled, fps=10.0, size=(160, 120)) == 4


def test_a_page_has_the_surface_of_a_fluid_thrusts_rays_and_lines():
    """A boat at its level, whose propeller lifts it by its weight, with a scanner over a line on the ground."""
    joint = Joint("screw", "continuous", "hull", "prop", xyz=(0.0, 0.0, 0.2), axis=(0.0, 0.0, 1.0))
    inertia = (0.1, 0.0, 0.0, 0.1, 0.0, 0.1)
    scanner = RangeSensor("hull", [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]], reach=0.8, name="depth")
    boat = Model(
        "boat", (Link("hull", 1.5, (0.0, 0.0, 0.0), inertia), Link("prop", 0.5, (0.0, 0.0, 0.0), inertia)), (joint,),
        "floating", shapes=(Shape("hull", Sphere(0.1)), Shape("prop", Box((0.1, 0.1, 0.1)))),
        contacts=(ContactPoint("hull", (0.0, 0.0, 0.0)),), immersed=(Immersed("hull", Sphere(0.1)),),
        propellers=(Propeller("screw", 2.0 * 9.81 / 900.0),), sensors=(scanner,),
    )  # fmt: skip
    ground = Ground(height=-0.5, lines=(FloorLine(((0.0, 0.0), (1.0, 0.0)), 0.1),))
    scene = compile_scene(boat, ground=ground, fluid=Fluid(level=0.25), integrator="rk4", timestep=1e-3)
    base, speed = np.tile([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0], (3, 1)), np.array([[30.0], [0.0], [-30.0]])
    channels = {"time": 0.1 * np.arange(3), "q": np.zeros((3, 1)), "base_q": base, "qd": speed}
    info = {"robot": "boat", "joints": ["screw"], "joint_types": ["continuous"]}
    seen, _, _ = _seen([Trajectory(channels, "ok", "", 0.2, np.zeros(0), info)], scene, (), ())
    data = page_data(seen)
    (run,), unit = data["runs"], data["unit"]
    assert run["level"] == 0.25
    np.testing.assert_allclose(np.array(run["pairs"][0])[:3] * unit, [0.0, 0.0, 0.3], atol=unit)
    assert [push[3:] for push in run["pairs"]] == [[0, 0, 1000], [], [0, 0, -1000]]
    down, ahead = np.array(run["rays"][1]).reshape(2, 7)
    np.testing.assert_allclose(down[:6] * unit, [0.0, 0.0, 0.1, 0.0, 0.0, -0.5], atol=unit)
    np.testing.assert_allclose(ahead[:6] * unit, [0.0, 0.0, 0.1, 0.8, 0.0, 0.1], atol=unit)
    assert (down[6], ahead[6]) == (1, 0)
    corners = np.reshape(run["lines"], (1, 4, 3))
    assert {*map(tuple, corners[0].tolist())} == {(x, y, -0.5) for x in (0.0, 1.0) for y in (-0.05, 0.05)}
