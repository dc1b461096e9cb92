"""Pages that show runs: what is in them, without a browser."""

import ast
import html
import json
import os
import re
import struct
import sys
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pages import WEIGHT, data_of, fallen, humanoid, walking
from PIL import Image
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import featherstone_gait
from featherstone_gait import (
    Ground,
    HeightField,
    Trajectory,
    contact_positions,
    forward_kinematics,
    load_robot,
    save_movie,
    show,
    stairs,
)
from featherstone_gait.cli import main
from featherstone_gait.scene.contact import ground_under
from featherstone_gait.view import recorded, shown
from featherstone_gait.view.page import MOST_BYTES, page_html, write_animation
from featherstone_gait.view.recorded import Seen, page_data, thinned_samples
from featherstone_gait.view.visuals import FACES, SIDES, bodies, side_of, thinned

VIEW = Path(featherstone_gait.__file__).parent / "view"


@pytest.fixture(scope="module")
def model():
    return humanoid()


@pytest.fixture(scope="module")
def run(model):
    return walking(model)


@pytest.fixture(scope="module")
def page(model, run):
    runs = {"walks": run, "falls": fallen(model)}
    return page_html({name: Seen(model, one, Ground()) for name, one in runs.items()}, "two <b>", ["torque"])


def poses_of(data, k=0):
    """Rotations (frames, bodies, 3, 3) and positions (frames, bodies, 3) [m] of a page's run."""
    frames = np.array(data["runs"][k]["frames"]).reshape(len(data["runs"][k]["frames"]), -1, 7)
    turns = Rotation.from_quat(frames[..., 3:].reshape(-1, 4)).as_matrix().reshape(*frames.shape[:2], 3, 3)
    return turns, data["unit"] * frames[..., :3]


# ---------------------------------------------------------------------------------------------- what is drawn


def test_bodies_are_where_forward_kinematics_puts_the_links(model, run, page):
    data = data_of(page)
    rotation, position = poses_of(data)
    rows = [[link.name for link in model.links].index(name) for name in data["models"][0]["links"]]
    at = np.searchsorted(run["time"], np.array(data["runs"][0]["times"]) - 1e-9)
    exact = forward_kinematics(model, np.hstack([run["base_q"], run["q"]])[at])
    assert np.abs(position - exact.position[:, rows]).max() <= 0.51 * data["unit"]
    assert np.abs(rotation - exact.rotation[:, rows]).max() <= 3 * data["turn"]
    assert data["unit"] <= 1e-4


def test_quaternions_do_not_jump_to_their_negatives(model):
    turning = walking(model)
    half = 4.0 * turning["time"]  # more than two turns about z
    turning["base_q"][:, 3], turning["base_q"][:, 6] = np.cos(half), np.sin(half)
    (told,) = page_data({"run": Seen(model, turning, Ground())})["runs"]
    frames = np.array(told["frames"]).reshape(51, -1, 7)[..., 3:]
    assert ((frames[1:] * frames[:-1]).sum(axis=2) > 0).all()


def test_a_link_without_a_shape_is_the_uniform_box_with_its_inertia(model):
    bare = replace(model, shapes=(), source="")
    found, _ = bodies(bare)
    links = {link.name: link for link in model.links}
    assert len(found) == sum(link.mass > 0 for link in model.links)
    for body in found:
        link, corners = links[body.link], body.points
        x, y, z = (np.linalg.norm(corners[k] - corners[0]) for k in (1, 2, 4))
        assert corners.mean(axis=0) == pytest.approx(link.center_of_mass)
        expected = link.mass / 12.0 * np.sort([y * y + z * z, x * x + z * z, x * x + y * y])
        assert np.sort([link.inertia[k] for k in (0, 3, 5)]) == pytest.approx(expected)


def volume(points, faces):
    """Of a closed surface whose faces look outward, by Gauss's theorem."""
    fan = [(face[0], a, b) for face in faces for a, b in pairwise(face[1:])]
    a, b, c = np.asarray(points)[np.array(fan)].transpose(1, 0, 2)
    return (a * np.cross(b, c)).sum() / 6.0


SHAPES = """<robot name="shapes"><material name="red"><color rgba="1 0 0 1"/></material>
<link name="base"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
{visuals}</link></robot>"""
VISUAL = '<visual><origin xyz="0 0 1" rpy="1 0 0"/><geometry>{}</geometry><material name="red"/></visual>'


def seen_in(folder, *geometries, most=FACES):
    file = folder / "shapes.urdf"
    file.write_text(SHAPES.format(visuals="".join(VISUAL.format(geometry) for geometry in geometries)), "utf-8")
    return bodies(load_robot(file), most)


@pytest.mark.parametrize(
    ("geometry", "exact", "missing"),
    [
        ('<box size="1 2 3"/>', 6.0, 1e-12),
        ('<cylinder radius="1" length="2"/>', 2.0 * np.pi, 0.03),
        ('<sphere radius="1"/>', 4.0 / 3.0 * np.pi, 0.15),
        ('<capsule radius="1" length="2"/>', (4.0 / 3.0 + 2.0) * np.pi, 0.1),
    ],
)
def test_visual_shapes_have_their_volume_place_and_color(tmp_path, geometry, exact, missing):
    (body,), notes = seen_in(tmp_path, geometry)
    assert notes == []
    assert (1.0 - missing) * exact - 1e-9 <= volume(body.points, body.faces) <= exact + 1e-9
    assert 0.5 * (body.points.min(axis=0) + body.points.max(axis=0)) == pytest.approx([0, 0, 1], abs=1e-9)
    assert set(body.colors) == {(255, 0, 0)}


def ball(n):
    """Points and triangles of a unit sphere."""
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    angle = np.pi * (3.0 - 5.0**0.5) * np.arange(n)
    points = np.column_stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z])
    triangles = ConvexHull(points).simplices
    a, b, c = points[triangles].transpose(1, 0, 2)
    inward = (a * np.cross(b, c)).sum(axis=1) < 0
    triangles[inward] = triangles[inward, ::-1]
    return points, triangles


def test_a_mesh_keeps_its_budget_and_its_volume():
    points, triangles = ball(5000)
    few, faces, source = thinned(points, triangles, 400)
    assert len(triangles) > 9000
    assert 100 < len(faces) <= 400
    assert volume(few, faces) == pytest.approx(4.0 / 3.0 * np.pi, rel=0.1)
    whole = triangles[source]
    assert ((few[faces].mean(axis=1) * points[whole].mean(axis=1)).sum(axis=1) > 0.8).all()  # each where it was
    same, all_faces, _ = thinned(points, triangles, 10**5)
    assert len(all_faces) == len(triangles)
    assert volume(same, all_faces) == pytest.approx(volume(points, triangles), rel=1e-3)


def test_a_mesh_of_two_colors_has_no_gap_between_them(tmp_path):
    """Simplified together, its faces meet edge to edge; half of it alone has a boundary."""
    points, triangles = ball(3000)
    upper = points[triangles].mean(axis=1)[:, 2] > 0.1
    text = "mtllib two.mtl\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in points)
    for material, faces in (("red", triangles[upper]), ("blue", triangles[~upper])):
        text += f"usemtl {material}\n" + "".join("f {} {} {}\n".format(*(face + 1)) for face in faces)
    (tmp_path / "two.obj").write_text(text)
    (tmp_path / "two.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    (tmp_path / "half.obj").write_text(text[: text.index("usemtl blue")])
    (body,), notes = seen_in(tmp_path, '<mesh filename="two.obj"/>')
    assert (notes, body.open, len({*body.colors})) == ([], False, 2)
    (body,), _ = seen_in(tmp_path, '<mesh filename="two.obj"/>', most=500)
    assert (len(body.faces) <= 500, body.open, len({*body.colors})) == (True, False, 2)
    assert volume(body.points, body.faces) == pytest.approx(4.0 / 3.0 * np.pi, rel=0.1)
    red, blue = ([f for f, color in zip(body.faces, body.colors) if color == own] for own in dict.fromkeys(body.colors))
    ways = {tuple(body.points[[a, b]].ravel()) for face in red for a, b in zip(face, face[1:] + face[:1])}
    rim = {way[:3] for way in ways if way[3:] + way[:3] not in ways}
    assert len(rim) > 5
    assert rim <= {tuple(body.points[k]) for face in blue for k in face}
    (body,), _ = seen_in(tmp_path, '<mesh filename="half.obj"/>')
    assert body.open


def test_meshes_of_visuals_are_read_and_missing_ones_told(tmp_path):
    points, triangles = ball(300)
    rows = [struct.pack("<12fH", 0, 0, 0, *points[t].reshape(-1), 0) for t in triangles]
    (tmp_path / "ball.stl").write_bytes(b"\0" * 80 + struct.pack("<I", len(rows)) + b"".join(rows))
    (body,), notes = seen_in(tmp_path, '<mesh filename="ball.stl" scale="1 1 2"/>', '<mesh filename="none.stl"/>')
    assert volume(body.points, body.faces) == pytest.approx(8.0 / 3.0 * np.pi, rel=0.05)
    assert notes == ["mesh 'none.stl' does not exist"]


def test_sides_are_told_by_names():
    names = ("left_foot", "R_knee", "lf_hip", "arm_r", "calf", "upper", "RIGHT_HAND", "roll")
    assert [side_of(name) for name in names] == ["left", "right", "left", "right", "", "", "right", ""]


# ---------------------------------------------------------------------------------------------- how it ended


def test_a_failed_run_is_not_shown_beyond_its_failure(page):
    walks, falls = data_of(page)["runs"]
    assert (falls["status"], falls["failed"], falls["end"]) == ("fell", True, 1.0)
    assert falls["message"] == "humanoid fell at 1.0 s"
    assert falls["times"][-1] == 1.0
    assert max(max(channel["times"]) for channel in falls["channels"].values()) == 1.0
    assert (walks["failed"], walks["times"][-1]) == (False, 2.0)


def test_a_doubtful_run_is_shown_to_its_end_and_told(model):
    doubtful = walking(model, status="inaccurate", message="from 0.1 s on")
    (told,) = page_data({"run": Seen(model, doubtful, Ground())})["runs"]
    assert (told["failed"], told["status"], told["times"][-1]) == (False, "inaccurate", 2.0)


def test_positions_that_are_not_finite_are_left_out(model):
    run = walking(model)
    run["q"][120:] = np.nan
    (told,) = page_data({"run": Seen(model, run, Ground())})["runs"]
    assert told["times"][-1] == pytest.approx(1.19)
    run["q"][:] = np.nan
    with pytest.raises(ValueError, match="no sample of the run is finite"):
        page_data({"run": Seen(model, run, Ground())})


def test_other_numbers_that_are_not_finite_are_zero(model):
    run = walking(model, status="diverged", message="at 1 s", end_time=1.0)
    for name in ("energy", "torque", "contact_force"):
        run[name][90:] = np.nan
        run[name][150:] = np.inf
    (told,) = page_data({"run": Seen(model, run, Ground())})["runs"]
    assert told["energy"][-1] == 0.0
    assert set(told["forces"][-1]) == set(told["load"]["percent"][-1]) == {0}
    json.dumps(told, allow_nan=False)


def test_a_body_without_joints_is_shown():
    box = replace(load_robot("ax12_arm"), base="floating", locked={"elbow": 0.0}, servos={})
    (told,) = page_data({"box": Seen(box, shown.in_posture(box), Ground())})["runs"]
    assert (len(told["frames"]), told["load"], "q" in told["channels"]) == (1, None, False)


# ---------------------------------------------------------------------------------------------- forces and ground


def test_forces_of_a_standing_robot_add_up_to_its_weight(page):
    run = data_of(page)["runs"][0]
    forces = 1e-3 * np.array(run["forces"]).reshape(51, -1, 3)
    assert forces.sum(axis=1) == pytest.approx(np.broadcast_to([0, 0, 1], (51, 3)), abs=8 * 5e-4)


def test_on_a_slope_normal_forces_are_upright_on_it(model, run):
    slope = 0.3
    (told,) = page_data({"run": Seen(model, run, Ground(slope=slope))})["runs"]
    force = np.array(told["forces"][0]).reshape(-1, 3).sum(axis=0)
    assert force / 1000 == pytest.approx([-np.sin(slope), 0, np.cos(slope)], abs=8 * 5e-4)


def test_contact_points_are_where_kinematics_puts_them(model, run, page):
    data = data_of(page)
    exact = contact_positions(model, np.hstack([run["base_q"], run["q"]])[:1])[0]
    shown_at = data["unit"] * np.array(data["runs"][0]["points"][0]).reshape(-1, 3)
    assert shown_at == pytest.approx(exact, abs=data["unit"])


def test_a_footprint_is_the_sole(model):
    standing = walking(model, speed=0.0)
    standing["q"][:] = 0.0
    standing["contact_force"][:30, 4:] = 0.0  # the right foot comes down at 0.3 s
    data = page_data({"run": Seen(model, standing, Ground())})
    left, right = data["runs"][0]["prints"]
    assert (left["at"], right["at"]) == (0.0, 0.3)
    q = np.hstack([standing["base_q"], standing["q"]])
    for one, middle, points in ((left, 100, slice(0, 4)), (right, 115, slice(4, 8))):
        outline = data["unit"] * np.array(one["points"]).reshape(-1, 3)
        assert ConvexHull(outline[:, :2]).volume == pytest.approx(0.1 * 0.06, rel=0.01)  # the area, in a plane
        sole = contact_positions(model, q[middle])[points]  # half way through the stance
        assert outline.mean(axis=0) == pytest.approx(sole.mean(axis=0), abs=data["unit"])


def test_without_forces_feet_that_are_near_the_ground_touch_it(model):
    standing = walking(model, speed=0.0)
    standing["q"][:] = 0.0
    del standing.channels["contact_force"]
    standing["base_q"][100:, 2] += 0.02  # it is lifted
    (told,) = page_data({"run": Seen(model, standing, Ground())})["runs"]
    touch = np.array(told["touch"])
    assert told["forces"] is None
    assert touch[:24].all()
    assert not touch[26:].any()


@pytest.mark.parametrize(
    "ground",
    [
        Ground(slope=0.2, heading=0.4, height=0.1),
        Ground(steps=stairs(3, 0.2, 0.03, start=0.1)),
        Ground(slope=-0.1, steps=stairs(2, 0.3, 0.05)),
        Ground(field=HeightField(np.random.default_rng(1).normal(0, 0.02, (5, 6)), (1.0, 1.0), (-2.0, -2.0))),
    ],
    ids=["slope", "stairs", "both", "field"],
)
def test_relief_lies_on_the_ground(model, run, ground):
    (told,) = page_data({"run": Seen(model, run, ground)})["runs"]
    quads = np.array(told["floor"]["quads"]).reshape(-1, 4, 3)
    level = np.array(told["floor"]["shade"]) < 2  # not the front of a step
    over = ground_under(ground, quads[level].mean(axis=1))[:, 6]
    assert np.abs(over).max() < (0.01 if ground.field else 1e-4)
    assert (~level).any() == bool(ground.steps)
    fronts = np.linalg.norm(quads[~level, 1] - quads[~level, 0], axis=1)
    assert fronts == pytest.approx(np.full(len(fronts), ground.steps[0][1] if ground.steps else 0.0), abs=1e-4)


def test_level_ground_takes_no_numbers(model, run):
    (told,) = page_data({"run": Seen(model, run, Ground(height=0.25))})["runs"]
    assert told["floor"] == {"real": True, "height": 0.25}
    (told,) = page_data({"run": Seen(model, run)})["runs"]
    assert not told["floor"]["real"]


# ---------------------------------------------------------------------------------------------- channels


def test_plots_keep_the_values_and_every_peak(run, page):
    channel = data_of(page)["runs"][0]["channels"]["torque"]
    assert channel["labels"] == run.info["joints"]
    assert channel["unit"] == "N m"
    assert channel["scale"] * np.array(channel["values"]).T == pytest.approx(run["torque"], abs=0.6 * channel["scale"])
    x = np.random.default_rng(3).normal(size=(10_007, 2))
    time, few = thinned_samples(np.arange(10_007.0), x, 500)
    assert len(time) <= 510
    assert (np.diff(time) >= 0).all()
    whole = x[:10_007 // 41 * 41]
    assert few.max(axis=0) == pytest.approx(whole.max(axis=0))
    assert few.min(axis=0) == pytest.approx(whole.min(axis=0))


def test_power_is_the_slope_of_energy(run, page):
    channel = data_of(page)["runs"][0]["channels"]["power by way"]
    joints = len(run.info["joints"])
    losses = ["copper", "driver_loss", "friction", "gear", "stops", "work"]
    assert channel["labels"] == ["electrical_no_regeneration", *losses]
    assert channel["scale"] * np.array(channel["values"]) == pytest.approx(joints, rel=1e-3)  # 1 W a joint


def test_load_is_the_share_of_the_stall_torque(model, run):
    servo = model.servos[model.joint_names[0]]
    current = min(servo.voltage_limit / servo.resistance, servo.current_limit)
    stall = servo.gearbox.ratio * servo.motor_constant * current
    (told,) = page_data({"run": Seen(model, run, Ground())})["runs"]
    assert told["load"]["of"] == "the stall torque"
    assert told["load"]["percent"][0] == np.round(100 * np.abs(run["torque"][0]) / stall).astype(int).tolist()


def test_unknown_channels_are_refused(model, run):
    with pytest.raises(ValueError, match="plots: there is no channel 'speed'; channels of the page: base_q, contact_f"):
        page_data({"run": Seen(model, run)}, ["speed"])


# ---------------------------------------------------------------------------------------------- the page


def test_the_page_needs_nothing_from_the_network(page):
    assert re.findall(r"https?:|//[a-z]|<link|@import|src=|url\(|import\(|fetch\(", page) == []
    assert "two &lt;b&gt;" in page


def test_two_minutes_of_two_humanoids_with_everything_stay_below_five_megabytes():
    whole = load_robot("humanoid")
    long = walking(whole, duration=120.0)
    runs = {name: Seen(whole, long, Ground()) for name in ("a", "b")}
    page = page_html(runs, "long")
    assert 1e6 < len(page.encode()) < MOST_BYTES
    times = data_of(page)["runs"][0]["times"]
    assert times[-1] == 120.0


def test_a_page_that_is_too_large_is_refused(model, run, monkeypatch):
    monkeypatch.setattr("featherstone_gait.view.page.MOST_BYTES", 1000)
    with pytest.raises(ValueError, match="at most 1000: show fewer runs"):
        page_html({"run": Seen(model, run)}, "")


class Named(HTMLParser):
    """Collects what a person can use, with its name."""

    def __init__(self):
        super().__init__()
        self.found, self.open = [], None

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag in ("button", "select", "input", "dialog"):
            self.found.append([tag, given.get("aria-label", "")])
            self.open = self.found[-1] if tag == "button" else None

    def handle_data(self, text):
        if self.open is not None and not self.open[1]:
            self.open[1] = text.strip()

    def handle_endtag(self, tag):
        self.open = None if tag == "button" else self.open


def test_every_control_has_a_name():
    parser = Named()
    parser.feed((VIEW / "page.html").read_text("utf-8"))
    assert len(parser.found) > 8
    assert [tag for tag, name in parser.found if not name] == []


def contrast(a, b):
    """Of two colors by WCAG 2, from 1 to 21."""

    def luminance(color):
        c = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
        return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722]

    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_its_ground(scheme):
    style = (VIEW / "page.css").read_text("utf-8")
    part = style.partition("prefers-color-scheme: dark")[0 if scheme == "light" else 2]
    colors = dict(re.findall(r"--(\w+): (#\w{6})", part))
    for text, ground in (("text", "page"), ("soft", "page"), ("soft", "panel"), ("bad", "badpage"), ("good", "panel")):
        assert contrast(colors[text], colors[ground]) >= 4.5, (text, ground)
    for mark, ground in (("force", "ground"), ("left", "page"), ("right", "page"), ("mid", "page")):
        assert contrast(colors[mark], colors[ground]) >= 3.0, (mark, ground)


# ---------------------------------------------------------------------------------------------- show, view, GIF


def test_show_writes_a_page_and_a_notebook_gets_the_same_inline(model, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = show(run, plots=["torque"])
    assert repr(page).endswith("humanoid_view.html>")
    assert (tmp_path / "humanoid_view.html").read_text("utf-8") == page.html
    inline = re.search(r'srcdoc="([^"]*)"', page._repr_html_())[1]
    assert html.unescape(inline) == page.html
    assert data_of(page.html)["plots"] == ["torque"]
    (tmp_path / "humanoid_view.html").unlink()
    monkeypatch.setattr(shown, "in_notebook", lambda: True)
    assert show(run, model).path is None
    assert list(tmp_path.iterdir()) == []


def test_runs_are_told_apart_by_captions(model, run, tmp_path):
    page = show(run, model, fallen(model), captions=["before", "after"], ghosts=True, path=tmp_path / "page.html")
    assert [told["caption"] for told in data_of(page.html)["runs"]] == ["before", "after"]
    assert data_of(page.html)["ghosts"]
    with pytest.raises(ValueError, match=r"captions are .*expected 2 texts that differ"):
        show(run, model, run, captions=["a", "a"], path=tmp_path / "page.html")


def test_a_run_finds_its_robot_and_its_ground(model, run):
    found, ground = shown.robot_of(run)
    assert found.joint_names == model.joint_names
    assert ground == Ground()
    told = replace(run, info=run.info | {"ground": {"slope": 0.1, "steps": [[0.1, 0.2]]}, "source": model.source})
    assert shown.robot_of(told)[1] == Ground(slope=0.1, steps=((0.1, 0.2),))
    assert shown.robot_of(replace(run, info=run.info | {"ground": None}))[1] is None
    with pytest.raises(ValueError, match="'nobody', which does not come with the package; give its model"):
        shown.robot_of(replace(run, info=run.info | {"robot": "nobody"}))
    with pytest.raises(ValueError, match=r"the run has the joints .*give the model or the scene that made the run"):
        shown.robot_of(run, load_robot("arm7"))


def test_view_shows_robots_and_saved_runs(model, run, tmp_path, capsys):
    fallen(model).save(tmp_path / "falls")
    run.save(tmp_path / "walks")
    out = ["--out", str(tmp_path)]
    assert main(["view", "arm7", *out]) == 0
    (still,) = data_of((tmp_path / "arm7_view.html").read_text("utf-8"))["runs"]
    assert len(still["frames"]) == 1
    assert main(["view", str(tmp_path / "falls.npz"), str(tmp_path / "walks"), "--ghosts", *out]) == 0
    printed = capsys.readouterr().out
    assert "falls: fell: humanoid fell at 1.0 s\nwalks: ok\n" in printed
    data = data_of((tmp_path / "falls_view.html").read_text("utf-8"))
    assert ([r["caption"] for r in data["runs"]], data["plots"]) == (["falls", "walks"], ["contact_force"])
    for wrong in (["nothing.npz"], [str(tmp_path / "falls"), "arm7"]):
        assert main(["view", *wrong, *out]) == 2
        assert f"{wrong[-1]}: there is no such file" in capsys.readouterr().err
    assert main(["view", "arm7", "--keyframe", "sitting", *out]) == 2
    assert "there is no keyframe 'sitting'; its keyframes: none" in capsys.readouterr().err


def test_a_gif_plays_in_its_time_and_stops_where_the_run_failed(model, tmp_path):
    run = fallen(model, at=0.4)
    count = save_movie(run, tmp_path / "run.gif", fps=10.0, size=(160, 120))
    assert count == 15  # 0 to 0.4 s, and the end for a second
    with Image.open(tmp_path / "run.gif") as picture:
        assert (picture.size, picture.info["duration"]) == ((160, 120), 100)
    assert save_movie(run, tmp_path / "frames", fps=10.0, speed=0.5, size=(160, 120)) == 19
    files = sorted((tmp_path / "frames").iterdir())
    assert [file.name for file in files[:2]] == ["frame_0000.png", "frame_0001.png"]
    first, later, last = (np.asarray(Image.open(files[k]).convert("RGB"), dtype=int) for k in (0, 6, 18))
    assert np.abs(first - later).max() > 50
    assert np.abs(last - np.asarray(Image.open(files[9]).convert("RGB"), dtype=int)).max() == 0
    with pytest.raises(ValueError, match=r"run.avi: expected a name that ends in .gif, .mp4, .webm, or a folder"):
        save_movie(run, tmp_path / "run.avi")
    with pytest.raises(ValueError, match="frames; at most 3000: lower fps, or raise speed"):
        save_movie(run, tmp_path / "run.gif", speed=1e-3)


@pytest.mark.parametrize("ending", ["mp4", "webm"])
def test_movies_are_made_of_all_frames_by_ffmpeg(model, tmp_path, monkeypatch, ending):
    """A program in its place keeps its arguments and what it reads: every pixel of every frame."""
    program = tmp_path / "ffmpeg"
    program.write_text(
        f"#!{sys.executable}\nimport sys\nwith open(sys.argv[-1], 'wb') as file:\n"
        "    file.write(repr((sys.argv[1:-1], len(sys.stdin.buffer.read()))).encode())\n"
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    count = save_movie(fallen(model, at=0.4), tmp_path / f"run.{ending}", fps=10.0, size=(161, 121))
    told, read = ast.literal_eval((tmp_path / f"run.{ending}").read_text())
    assert read == 15 * 160 * 120 * 4
    assert count == 15
    given = [*pairwise(told)]
    for option in (("-s", "160x120"), ("-pix_fmt", "yuv420p"), ("-f", ending)):
        assert option in given


def test_movies_without_ffmpeg_name_the_command(model, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    run = fallen(model, at=0.4)
    with pytest.raises(ImportError, match=r"pip install featherstone-gait\[movie\]"):
        save_movie(run, tmp_path / "run.mp4", size=(160, 120))
    run.save(tmp_path / "run")
    assert main(["view", str(tmp_path / "run"), "--movie", "run.webm", "--out", str(tmp_path)]) == 2
    assert "pip install featherstone-gait[movie]" in capsys.readouterr().err
    assert not (tmp_path / "run.mp4").exists()


def test_an_encoder_that_fails_is_named(model, tmp_path, monkeypatch):
    program = tmp_path / "ffmpeg"
    program.write_text("#!/bin/sh\necho \"Unknown encoder 'h264'\" >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    with pytest.raises(OSError, match="h264"):
        save_movie(fallen(model, at=0.4), tmp_path / "run.mp4", fps=10.0, size=(160, 120))
    assert not (tmp_path / "run.mp4").exists()


@pytest.mark.long
def test_simulate_saves_what_view_needs(tmp_path):
    assert main(["simulate", "ax12_arm", "--duration", "0.05", "--out", str(tmp_path)]) == 0
    told = Trajectory.load(tmp_path / "ax12_arm_simulation").info
    assert (Path(told["source"]).name, told["ground"], told["locked"]) == ("ax12_arm.urdf", None, {})
    assert main(["view", str(tmp_path / "ax12_arm_simulation.npz"), "--out", str(tmp_path)]) == 0


def test_write_animation_takes_runs_by_caption(model, run, tmp_path):
    write_animation(tmp_path / "page.html", model, {"first": run, "second": run}, "title")
    data = data_of((tmp_path / "page.html").read_text("utf-8"))
    assert [told["caption"] for told in data["runs"]] == ["first", "second"]
    assert len(data["models"]) == 1
    with pytest.raises(ValueError, match="runs is empty"):
        write_animation(tmp_path / "none.html", model, {})
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


def test_faces_of_boxes_look_outward():
    corners = np.array([(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=float)
    assert volume(corners, SIDES) == pytest.approx(1.0)
    assert json.dumps(SIDES).replace(" ", "") in (VIEW / "page.js").read_text("utf-8").replace(" ", "")


def test_frames_are_spared_in_long_runs(model, monkeypatch):
    monkeypatch.setattr(recorded, "POSES", 20_000)
    (told,) = page_data({"run": Seen(model, walking(model, duration=20.0), Ground())})["runs"]
    assert 20_000 / (7 * len(model.links) + 6 * 8) / 2 <= len(told["frames"]) <= 110
    assert WEIGHT * model.mass == pytest.approx(told["weight"], rel=1e-3)
