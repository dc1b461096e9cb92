"""Hulls that lose many corners are named with their error, and refused where a file is read strictly."""

import re

import numpy as np
import pytest

from featherstone_gait import (
    Placed,
    RobotFileError,
    RobotFileWarning,
    SceneModel,
    compile_scene,
    load_robot,
    load_scene,
)

trimesh = pytest.importorskip("trimesh")
MJCF = """<mujoco><asset><mesh name="b" file="ball.obj"/><mesh name="s" file="small.obj"/></asset><worldbody>
<geom type="plane" size="9 9 1"/><body name="a" pos="0 0 .1"><freejoint/><geom name="ball" type="mesh" mesh="b"/>
<geom name="small" type="mesh" mesh="s" pos="0 0 .2"/></body></worldbody></mujoco>"""
LINK = """<robot name="r"><link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
iyz="0"/></inertial><collision name="small"><geometry><mesh filename="small.obj"/></geometry></collision>
<collision name="ball"><geometry><mesh filename="ball.obj"/></geometry></collision></link></robot>"""


@pytest.fixture
def folder(tmp_path):
    """Balls of 0.1 m and 0.05 m, each of 642 corners."""
    for name, radius in (("ball", 0.1), ("small", 0.05)):
        trimesh.creation.icosphere(3, radius).export(tmp_path / f"{name}.obj")
    (tmp_path / "ball.xml").write_text(MJCF)
    (tmp_path / "ball.urdf").write_text(LINK)
    return tmp_path


@pytest.mark.parametrize(
    "load",
    [
        lambda folder, **how: load_scene(folder / "ball.xml", **how),
        lambda folder, **how: load_robot(folder / "ball.xml", contacts="all", **how),
        lambda folder, **how: load_robot(folder / "ball.urdf", "floating", contacts=["a"], **how),
    ],
    ids=["scene", "MJCF", "URDF"],
)
def test_a_ball_of_many_corners_is_warned_of_with_its_error(folder, load):
    """The error is that of the farthest corner from the hull of those that are left; the larger ball comes first."""
    with pytest.warns(RobotFileWarning, match="32 of their corners") as caught:
        loaded = load(folder)
    (text,) = (str(one.message) for one in caught if "32 of their corners" in str(one.message))
    points = trimesh.load(folder / "ball.obj").vertices
    model = loaded.members[0].model if isinstance(loaded, SceneModel) else loaded
    left = np.array([p.position for p in model.contacts if abs(np.linalg.norm(p.position) - 0.1) < 1e-3])
    hull = trimesh.Trimesh(left).convex_hull
    gap = float((points @ hull.face_normals.T - np.sum(hull.face_normals * hull.triangles[:, 0], axis=1)).max())
    ball, small = (float(re.search(rf"'{name}' (\S+) m", text)[1]) for name in ("ball", "small"))
    assert ball == pytest.approx(gap, rel=0.01)
    assert 0.4 * ball < small < 0.6 * ball  # MuJoCo's numbers are single precision: other corners are the farthest
    assert text.index("'ball'") < text.index("'small'")
    with pytest.raises(RobotFileError, match="32 of their corners"):
        load(folder, strict=True)


def test_a_scene_notes_hulls_that_touch_others(folder):
    ball = load_robot(folder / "ball.urdf", "floating")
    members = [Placed(ball, name, position=(x, 0.0, 1.0)) for name, x in (("one", 0.0), ("two", 0.3))]
    (note,) = (text for text in compile_scene(SceneModel("two", members), pairs="all").notes if "32 of" in text)
    assert note.count("'ball'") == note.count("'small'") == 1
