"""What robots look like, from their files; and the page that viser serves."""

import json
import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import published
import pytest
from pages import fallen, humanoid, walking

from featherstone_gait import Ground, RobotFileWarning, forward_kinematics, load_robot, show_live
from featherstone_gait.cli import main
from featherstone_gait.geometry.mesh import mesh_parts, mesh_triangles
from featherstone_gait.model.shapes import Box, Sphere
from featherstone_gait.robot_file.visuals import Triangles, read_visuals
from featherstone_gait.view.visuals import bodies, creased, fans, pieces

INERTIA = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'


def robot(folder, visuals, solid=""):
    file = folder / "robot.urdf"
    file.write_text(f'<robot name="robot"><link name="base">{INERTIA}{visuals}{solid}</link></robot>', "utf-8")
    return file


def in_world(model, q):
    """Rotations and positions of all visuals in the world, by link."""
    poses = forward_kinematics(model, q)
    rows = {link.name: k for k, link in enumerate(model.links)}
    seen, notes = read_visuals(model)
    assert notes == []
    placed = {}
    for link, several in seen.items():
        turn, place = poses.rotation[rows[link]], poses.position[rows[link]]
        placed[link] = [(turn @ v.rotation, turn @ v.position + place) for v in several]
    return placed


# ---------------------------------------------------------------------------------------------- where visuals are


@pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")
@pytest.mark.parametrize("file", ["talos_data/robots/talos_reduced.urdf", "so_arm_description/urdf/so101.urdf"])
def test_visuals_of_published_robots_are_where_pinocchio_puts_them(file):
    pinocchio = pytest.importorskip("pinocchio")
    path = published.folder("example-robot-data") / file
    model = load_robot(path, base="fixed", mimic="free")
    peer = pinocchio.buildModelFromUrdf(str(path))
    folders = [str(path.parents[k]) for k in (2, 3, 4)]
    shapes = pinocchio.buildGeomFromUrdf(peer, str(path), pinocchio.VISUAL, package_dirs=folders)
    data, placed = peer.createData(), shapes.createData()
    angles = np.random.default_rng(1).uniform(-0.5, 0.5, len(model.joint_names))
    x = pinocchio.neutral(peer)
    for name, angle in zip(model.joint_names, angles):
        x[peer.joints[peer.getJointId(name)].idx_q] = angle
    pinocchio.updateGeometryPlacements(peer, data, shapes, placed, x)
    mine, count = in_world(model, angles), 0
    for link, several in mine.items():
        for k, (turn, place) in enumerate(several):
            at = placed.oMg[shapes.getGeometryId(f"{link}_{k}")]
            assert turn == pytest.approx(at.rotation, abs=1e-9)
            assert place == pytest.approx(at.translation, abs=1e-9)
            count += 1
    assert count == len(shapes.geometryObjects) > 15


@pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")
@pytest.mark.parametrize("name", ["humanoid.xml", "walker2d_v5.xml"])
def test_geoms_of_published_robots_are_where_mujoco_puts_them(name):
    mujoco = pytest.importorskip("mujoco")
    path = published.folder("gymnasium") / "envs" / "mujoco" / "assets" / name
    model = load_robot(path)
    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    q = np.array(d.qpos)
    q[-len(model.joint_names) :] += np.random.default_rng(1).uniform(-0.3, 0.3, len(model.joint_names))
    d.qpos = q
    mujoco.mj_kinematics(m, d)
    mine, taken = in_world(model, q), dict.fromkeys(range(m.nbody), 0)
    for g in range(m.ngeom):
        body = int(m.geom_bodyid[g])
        if m.geom_type[g] == 0:
            continue  # the floor
        turn, place = mine[m.body(body).name][taken[body]]
        taken[body] += 1
        assert place == pytest.approx(d.geom_xpos[g], abs=1e-12)
        assert turn == pytest.approx(d.geom_xmat[g].reshape(3, 3), abs=1e-12)
    assert sum(taken.values()) == sum(map(len, mine.values())) > 6


MJCF = """<mujoco><asset><material name="blue" rgba="0 0 1 0.5"/>
<mesh name="wedge" vertex="0 0 0 1 0 0 0 2 0 0 0 3" face="0 2 1 0 1 3 0 3 2 1 2 3"/></asset>
<worldbody><body name="base"><freejoint/>
<geom type="box" size="1 2 3" group="2" material="blue"/><geom type="sphere" size="1" group="3"/>
<geom type="mesh" mesh="wedge" rgba="1 0 0 1" group="1" contype="0" conaffinity="0"/>
<geom type="ellipsoid" size="1 2 3" mass="0" contype="0" conaffinity="0"/></body></worldbody></mujoco>"""


def test_the_humanoid_is_seen_as_its_boxes_and_a_neck_that_closes_the_gap_under_its_head():
    model = load_robot("humanoid")
    drawn, _ = bodies(model)
    solid, _ = bodies(replace(model, source=""))  # without a file: its collision shapes
    head = {body.link: body.points for body in drawn}["head"]
    neck, box = head[:8], head[8:]
    places = forward_kinematics(model, np.eye(1, model.nq, 3)[0]).position
    trunk = {body.link: body.points for body in solid}["trunk"]
    offset = places[model.link_index("head"), 2] - places[model.link_index("trunk"), 2]
    assert neck[:, 2].max() == pytest.approx(box[:, 2].min(), abs=1e-12)
    assert neck[:, 2].min() + offset == pytest.approx(trunk[:, 2].max(), abs=1e-12)
    for seen, own in zip(drawn, solid, strict=True):
        assert seen.link == own.link
        np.testing.assert_array_equal(seen.points[-8:], own.points)


def test_mjcf_gives_the_geoms_that_its_viewer_shows_with_their_colors(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "robot.xml").write_text(MJCF, "utf-8")
    model = load_robot(tmp_path / "robot.xml")
    box, wedge, egg = read_visuals(model).of["base"]
    assert (box.geometry, box.color, box.opacity) == (Box((2.0, 4.0, 6.0)), (0, 0, 255), 0.5)
    assert (wedge.color, wedge.opacity, egg.color) == ((255, 0, 0), 1.0, None)
    assert isinstance(wedge.geometry, Triangles)
    corners = wedge.geometry.points @ wedge.rotation.T + wedge.position
    assert np.sort(corners, axis=0)[[0, -1]] == pytest.approx(np.array([[0, 0, 0], [1, 2, 3]]), abs=1e-6)
    found = pieces(model, 1000, 48)[0]
    reach = found[2].points.max(axis=0)
    assert reach == pytest.approx([1.0, 2.0, 3.0], rel=2e-3)
    (body,), notes = bodies(model)
    assert notes == []
    assert {(0, 0, 255), (255, 0, 0)} < set(body.colors)


# ---------------------------------------------------------------------------------------------- meshes

OBJ = "mtllib paint.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl red\nf 1 3 2\nusemtl blue\nf 1 2 4\nf 1 4 3\n"
EFFECT = "<effect id='{0}-e'><profile_COMMON><technique sid='t'><lambert><diffuse>{1}</diffuse></lambert></technique>"
EFFECT += "</profile_COMMON></effect>"
DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset/>
<library_effects>{effects}</library_effects>
<library_materials><material id="a"><instance_effect url="#a-e"/></material>
<material id="b"><instance_effect url="#b-e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="f" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array><technique_common>
<accessor source="#f" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles material="a" count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1</p></triangles>
<triangles material="b" count="2"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 3 0 3 2</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="a" target="#a"/><instance_material symbol="b" target="#b"/></technique_common>
</bind_material></instance_geometry></node><node><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="a" target="#a"/><instance_material symbol="b" target="#a"/></technique_common>
</bind_material></instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>"""
PLAIN, PICTURE = "<color>{} 1</color>", '<texture texture="none" texcoord="x"/>'


def dae(folder, first, second, name="b"):
    file = folder / "mesh.dae"
    effects = EFFECT.format("a", first) + EFFECT.format(name, second)
    file.write_text(DAE.format(effects=effects), "utf-8")
    return {part.color: len(part.triangles) for part in mesh_parts(file)}


def test_parts_of_a_gltf_are_where_its_nodes_put_them_in_their_colors(tmp_path):
    """Three primitives in one node: red, textured, and without a material."""
    pytest.importorskip("trimesh")
    points, corners = np.vstack([np.zeros(3), np.eye(3)]).astype("<f4"), np.array([0, 2, 1, 0, 1, 3], dtype="<u2")
    (tmp_path / "numbers.bin").write_bytes(points.tobytes() + corners.tobytes())
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    told = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], "translation": [1, 2, 3]}, {"mesh": 0, "scale": [2, 2, 2]}],
        "meshes": [{"primitives": [primitive | {"material": 0}, primitive | {"material": 1}, primitive]}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}},
            {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}},
        ],
        "textures": [{"source": 0}], "images": [{"uri": "../picture.png"}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "buffers": [{"byteLength": 60, "uri": "numbers.bin"}],
    }  # fmt: skip
    (tmp_path / "mesh.gltf").write_text(json.dumps(told), "utf-8")
    parts = mesh_parts(tmp_path / "mesh.gltf")
    assert {part.color: len(part.triangles) for part in parts} == {(255, 0, 0): 2, (255, 255, 255): 2, None: 2}
    for part in parts:
        assert sorted(map(tuple, part.points.tolist())) == [(1, 2, 3), (1, 2, 5), (1, 4, 3), (3, 2, 3)]
    told["buffers"][0]["uri"] = "../numbers.txt"
    (tmp_path / "mesh.gltf").write_text(json.dumps(told), "utf-8")
    with pytest.raises(ValueError, match=r"mesh.gltf: cannot be read as GLTF"):
        mesh_parts(tmp_path / "mesh.gltf")


def test_parts_of_meshes_have_the_colors_of_their_materials(tmp_path):
    pytest.importorskip("collada")
    red, blue = PLAIN.format("1 0 0"), PLAIN.format("0 0 1")
    assert dae(tmp_path, red, blue) == {(255, 0, 0): 4, (0, 0, 255): 2}
    assert dae(tmp_path, red, PICTURE) == {(255, 0, 0): 4, (255, 255, 255): 2}
    assert dae(tmp_path, red, blue, name="other") == {None: 6}  # a material leads nowhere
    (tmp_path / "mesh.obj").write_text(OBJ, "utf-8")
    assert {part.color for part in mesh_parts(tmp_path / "mesh.obj")} == {None}
    (tmp_path / "paint.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\nmap_Kd ../picture.png\n", "utf-8")
    parts = {part.color: len(part.triangles) for part in mesh_parts(tmp_path / "mesh.obj")}
    assert parts == {(255, 0, 0): 1, (0, 0, 255): 2}
    assert len(mesh_triangles(tmp_path / "mesh.obj")[1]) == 3


def test_a_mesh_keeps_its_own_colors_and_takes_the_urdf_s_where_it_has_none(tmp_path):
    (tmp_path / "mesh.obj").write_text(OBJ, "utf-8")
    material = '<material name=""><color rgba="0 1 0 0.25"/></material>'
    model = load_robot(robot(tmp_path, f'<visual><geometry><mesh filename="mesh.obj"/></geometry>{material}</visual>'))
    (piece,), notes = pieces(model, 1000, 48)
    assert (piece.color, piece.opacity, len(piece.triangles), notes) == ((0, 255, 0), 0.25, 3, [])
    (tmp_path / "paint.mtl").write_text("newmtl red\nKd 1 0 0\n", "utf-8")
    assert {piece.color for piece in pieces(model, 1000, 48)[0]} == {(255, 0, 0), (0, 255, 0)}


def test_meshes_of_packages_are_found_where_those_of_the_loading_were(tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "elsewhere" / "deep" / "pack").mkdir(parents=True)
    (tmp_path / "elsewhere" / "deep" / "pack" / "mesh.obj").write_text(OBJ, "utf-8")
    file = robot(tmp_path / "here", '<visual><geometry><mesh filename="package://pack/mesh.obj"/></geometry></visual>')
    model = load_robot(file, package_dirs=tmp_path / "elsewhere" / "deep")
    assert model.package_dirs == (str(tmp_path / "elsewhere" / "deep"),)
    assert pieces(model, 1000, 48)[1] == []
    assert pieces(replace(model, package_dirs=()), 1000, 48)[1] == ["mesh 'package://pack/mesh.obj' does not exist"]


def test_edges_are_seen_and_smooth_surfaces_are_smooth(tmp_path):
    def surface(geometry):
        model = load_robot(robot(tmp_path, f"<visual><geometry>{geometry}</geometry></visual>"))
        (piece,) = pieces(model, 1000, 48)[0]
        return len(piece.points), len(piece.triangles)

    assert surface('<box size="1 2 3"/>') == (24, 12)  # four corners of each side
    assert surface('<cylinder radius="1" length="2"/>') == (4 * 48, 2 * 48 + 2 * 46)
    points, triangles = surface('<sphere radius="1"/>')
    assert triangles == 2 * (points - 2)  # Euler: all corners shared
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert len(creased(square, fans([(0, 1, 2, 3)]))[0]) == 4


# ---------------------------------------------------------------------------------------------- the live page


def test_without_viser_the_live_page_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ImportError, match=r"pip install featherstone-gait\[viser\]"):
        show_live(walking(humanoid()), humanoid())
    assert main(["view", "arm7", "--live"]) == 2
    assert "error: a live page needs viser: pip install" in capsys.readouterr().err


def test_looking_needs_no_viser_and_loading_reads_no_visuals():
    told = "import sys, featherstone_gait as f; f.load_robot('humanoid'); import featherstone_gait.view.live; "
    told += "print([m for m in ('viser', 'trimesh', 'featherstone_gait.robot_file.visuals') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['featherstone_gait.robot_file.visuals']"


@pytest.fixture
def page():
    pytest.importorskip("viser")
    opened = []

    def show(model, *runs, **how):
        opened.append(show_live(runs[0], model, *runs[1:], port=0, **how))
        return opened[0]

    yield show
    for one in opened:
        one.stop()


def test_nodes_of_the_live_page_move_with_the_run_and_it_stops(page):
    from urllib.error import URLError
    from urllib.request import urlopen

    model = humanoid()
    run = walking(model)
    live = page(model, run)
    assert b"<html" in urlopen(live.url, timeout=10).read()
    (actor,) = live._actors
    q = np.hstack([run["base_q"], run["q"]])
    for t in (0.0, 0.5, 2.0):
        live.seek(t)
        exact = forward_kinematics(model, q[round(100 * t)])
        for name, frame in actor.links.items():
            k = [link.name for link in model.links].index(name)
            assert frame.position == pytest.approx(exact.position[k], abs=1e-12)
            w, *v = frame.wxyz
            x = np.array([0.3, -0.2, 0.5])
            turned = x + 2.0 * np.cross(v, np.cross(v, x) + w * x)  # by a quaternion
            assert turned == pytest.approx(exact.rotation[k] @ x, abs=1e-12)
        force = np.diff(actor.arrows.points, axis=1).sum(axis=(0, 1))
        assert force == pytest.approx([0.0, 0.0, 0.8 * actor.size], abs=1e-5)  # they carry the weight
        assert live._controls["time"].value == t
    assert len(actor.meshes) == len(pieces(model, 1000, 48)[0]) > 10
    live.stop()
    with pytest.raises(URLError):
        urlopen(live.url, timeout=10)


def test_the_live_page_tells_which_run_fell_and_when(page):
    model = humanoid()
    live = page(model, walking(model), fallen(model), captions=["walks", "<falls>"], ghosts=True)
    walks, falls = live._actors
    assert (walks.status_html().count("ok"), "&lt;falls&gt;: fell at 1 s" in falls.status_html()) == (1, True)
    live.seek(0.9)
    assert (walks.label.text, falls.label.text) == ("walks", "<falls>")
    assert falls.meshes[0].opacity < 0.5
    assert walks.meshes[0].opacity is None
    live.seek(1.5)
    assert falls.label.text == "<falls>: fell at 1 s"
    assert falls.links[model.root].position[0] == pytest.approx(0.2)  # where it was at its failure
    assert walks.links[model.root].position[0] == pytest.approx(0.3)
    assert len({tuple(mesh.color) for mesh in falls.meshes}) == 1
    assert not (walks.place.position - falls.place.position).any()
    live._switch("ghosts", False)
    apart = np.abs(walks.place.position - falls.place.position)
    assert apart[1] > np.ptp(walks.box[0, :, 1])
    assert falls.meshes[0].opacity is None


def test_plots_of_the_live_page_follow_the_time_and_whoever_looks_chooses_them(page):
    model = humanoid()
    run, short = walking(model), fallen(model)
    live = page(model, run, short, captions=["walks", "falls"], plots=["q", "contact_force"])
    angles, forces = live._charts
    assert [lines.handle.title for lines in forces.lines] == [
        "walks: contact_force [N, normal]", "falls (fell): contact_force [N, normal]",
    ]  # fmt: skip
    for t in (0.0, 0.505, 2.0):
        live.seek(t)
        time, *columns, line = angles.lines[0].handle.data
        (k,) = np.flatnonzero(line == line.max())
        assert time[k] == t == live.time
        assert (np.delete(line, k) < angles.lines[0].low).all()  # it is seen nowhere else
        assert (np.diff(time) >= 0.0).all()
        for column, values in zip(columns, run["q"].T):
            fine = 1e-4 * np.abs(run["q"]).max()
            assert column[k] == pytest.approx(np.interp(t, run["time"], values), abs=fine)
            assert np.delete(column, [k - 1, k, k + 1]) == pytest.approx(values, abs=fine)
        falls = angles.lines[1].handle.data
        assert falls[0][np.argmax(falls[-1])] == min(t, 1.0)  # to its failure
    angles.column.value = run.info["joints"][2]
    (one,) = {len(lines.handle.data) for lines in angles.lines}
    assert one == 3
    angles.channel.value = "contact_force"
    assert (angles.column.value, len(angles.lines[0].handle.data)) == ("all", 4)
    with pytest.raises(ValueError, match=r"plots: there is no channel 'qd'; channels of the page: .*contact_force"):
        page(model, run, plots=["qd"])


def test_what_is_missing_is_told_once_by_name_and_its_collision_shape_is_drawn(page, tmp_path):
    mesh = '<visual><geometry><mesh filename="none.stl"/></geometry></visual>'
    solid = '<collision><geometry><sphere radius="0.5"/></geometry></collision>'
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = replace(load_robot(robot(tmp_path, mesh, solid)), base="floating")
    assert model.shapes[0].geometry == Sphere(0.5)
    from featherstone_gait.view.shown import in_posture

    with pytest.warns(RobotFileWarning, match=r"robot.urdf: mesh 'none.stl' does not exist: collision shapes") as told:
        live = page(model, in_posture(model))
    assert len(told) == 1
    (piece,) = live._actors[0].found
    assert np.linalg.norm(piece.points, axis=1) == pytest.approx(np.full(len(piece.points), 0.5))


@pytest.mark.parametrize("ground", [Ground(slope=0.2, heading=0.4, height=0.1), Ground(height=0.1)])
def test_the_ground_of_the_live_page_is_where_the_run_s_is(ground):
    from featherstone_gait.scene.contact import ground_under
    from featherstone_gait.view.live import _floor

    class Scene:
        def add_grid(self, name, *size, wxyz, position, **look):
            return np.array(wxyz), np.array(position)

    ((wxyz, position),) = _floor(Scene(), "ground", ground, np.array([[[1.0, 2.0, 0.0], [3.0, 1.0, 0.8]]]))
    w, v, up = wxyz[0], wxyz[1:], np.array([0.0, 0.0, 1.0])
    turned = up + 2.0 * np.cross(v, np.cross(v, up) + w * up)
    under = ground_under(ground, position[None])[0]
    assert under[6] == pytest.approx(0.0, abs=1e-12)
    assert turned == pytest.approx(under[:3], abs=1e-12)
