"""Which geoms of an MJCF scene may touch: those that MuJoCo's filters leave, by geoms, before and after saving."""

import pytest

mujoco = pytest.importorskip("mujoco")

import featherstone_gait.scene.pairs as pairs_of  # noqa: E402
from featherstone_gait import compile_scene, load_robot, load_scene, save_robot, save_scene  # noqa: E402
from featherstone_gait.geometry.distance import meeting_shapes  # noqa: E402

SMALL = 'type="sphere" size="0.05" mass="1"'
MASKS = f"""
<body name="A"><freejoint/><geom name="a1" {SMALL} contype="2" conaffinity="2"/><geom name="a2" {SMALL}/></body>
<body name="B" pos="1 0 0"><freejoint/><geom name="b1" {SMALL}/><geom name="b2" {SMALL} contype="4" conaffinity="2"/>
  <body name="C" pos="1 0 0"><joint axis="0 1 0"/><geom name="c" {SMALL}/>
    <body name="D" pos="1 0 0"><joint axis="0 1 0"/>
      <geom name="d1" {SMALL} contype="2"/><geom name="d2" {SMALL}/></body>
  </body></body>
"""
NONE = f'{SMALL} contype="0" conaffinity="0"'
PAIRED = f"""
<body name="A"><freejoint/><geom name="shell" {NONE}/><geom name="core" {NONE}/>
  <body name="child" pos="1 0 0"><joint axis="0 1 0"/><geom name="tip" {NONE}/><geom name="side" {NONE}/></body></body>
<body name="B" pos="0 1 0"><freejoint/><geom name="box" {NONE}/></body>
<body name="C" pos="0 3 0"><freejoint/><geom name="c" {NONE}/></body>
"""
BY_PAIR = "".join(
    f'<pair geom1="{a}" geom2="{b}"/>' for a, b in (("core", "box"), ("shell", "c"), ("core", "tip"), ("c", "box"))
)
HINGES = f"""
<body name="trunk" pos="0 0 1"><freejoint/><geom name="trunk" {SMALL}/>
  <body name="arm" pos="0 0.5 0"><joint name="x" axis="1 0 0"/><joint name="y" axis="0 1 0" pos="0 0.1 0"/>
    <geom name="arm" {SMALL}/>
    <body name="hand" pos="0 0.5 0"><joint name="p" axis="1 0 0"/><joint name="q" axis="0 1 0"/><joint axis="0 0 1"/>
      <geom name="hand" {SMALL}/></body></body></body>
"""
STATIC = f"""
<geom name="post" {SMALL} pos="0 0 -1"/>
<body name="frame" pos="0 0 1"><geom name="frame" {SMALL} pos="0.3 0 -0.3"/>
  <geom name="rim" {SMALL} pos="0 0 0.5" contype="4" conaffinity="4"/>
  <body name="plate" pos="0 1 0"><geom name="plate" {SMALL}/></body>
  <body name="door"><joint axis="0 1 0"/><geom name="door" {SMALL} pos="0.5 0 0"/>
    <body name="handle" pos="0.5 0 0.5"><joint axis="1 0 0"/><geom name="handle" {SMALL}/></body></body>
  <body name="flap"><joint axis="0 1 0"/><geom name="flap" {SMALL} pos="-0.5 0 0"/></body></body>
"""
FILES = {
    "masks": (MASKS, '<exclude body1="A" body2="C"/>'),
    "pairs": (PAIRED, BY_PAIR),
    "hinges": (HINGES, ""),
    "neighbors by a flag": (HINGES, ""),
    "static": (STATIC, ""),
    "static, excluded": (STATIC, '<exclude body1="frame" body2="flap"/>'),
}


def mujocos(path):
    """Which geoms may touch: masks, <exclude>, parents that move, and <pair>."""
    m = mujoco.MjModel.from_xml_path(str(path))
    body, rigid, parent = m.geom_bodyid, m.body_weldid, m.body_parentid
    out = {frozenset(divmod(int(both), 1 << 16)) for both in m.exclude_signature}
    found = {frozenset((int(a), int(b))) for a, b in zip(m.pair_geom1, m.pair_geom2)}
    for a in range(m.ngeom):
        for b in range(a):
            one, two = rigid[body[a]], rigid[body[b]]
            met = m.geom_contype[a] & m.geom_conaffinity[b] or m.geom_contype[b] & m.geom_conaffinity[a]
            filtered = not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
            kin = filtered and one and two and (rigid[parent[one]] == two or rigid[parent[two]] == one)
            if met and one != two and not kin and frozenset((int(body[a]), int(body[b]))) not in out:
                found.add(frozenset((a, b)))
    return {frozenset(m.geom(g).name.rpartition("/")[2] for g in pair) for pair in found}


def ours(path, monkeypatch):
    """Which shapes the compiled scene lets touch, by the names of their geoms."""
    found = set()

    def table(solids, chosen, inner=pairs_of._table):
        found.update(frozenset(solids[k].shape.name for k in pair) for pair in chosen.tolist())
        return inner(solids, chosen)

    with monkeypatch.context() as patch:
        patch.setattr(pairs_of, "_table", table)
        compile_scene(load_scene(path, strict=True), pairs="all", gearbox=None)
    return found


@pytest.fixture(params=FILES)
def file(request, tmp_path):
    bodies, contact = FILES[request.param]
    path = tmp_path / "scene.xml"
    flag = '<option><flag filterparent="disable"/></option>' if "flag" in request.param else ""
    path.write_text(f"<mujoco>{flag}<worldbody>{bodies}</worldbody><contact>{contact}</contact></mujoco>", "utf-8")
    return path


def test_shapes_touch_whose_geoms_do_in_mujoco(file, monkeypatch):
    assert ours(file, monkeypatch) == mujocos(file)


def test_a_saved_scene_lets_the_same_shapes_touch_here_and_in_mujoco(file, monkeypatch, tmp_path):
    saved = tmp_path / "saved.xml"
    save_scene(load_scene(file), saved)
    assert mujocos(saved) == mujocos(file)
    assert ours(saved, monkeypatch) == mujocos(file)


@pytest.mark.parametrize("name", ["saved.xml", "saved.urdf"])
def test_a_saved_robot_keeps_which_of_its_shapes_touch(name, tmp_path):
    """A door touches the frame that carries it, as in MuJoCo; of the trunk's geoms one passes the hand."""
    trunk = HINGES.replace(
        '<geom name="trunk"', f'<geom name="side" {SMALL} contype="2" conaffinity="3"/><geom name="trunk"'
    ).replace('<geom name="hand" ', '<geom name="hand" contype="4" conaffinity="1" ')
    floor = '<geom name="floor" type="plane" size="5 5 1" contype="7" conaffinity="7"/>'
    for bodies, want in ((STATIC, ("door", "frame")), (trunk, ("hand", "trunk"))):
        path = tmp_path / "robot.xml"
        path.write_text(f"<mujoco><worldbody>{floor}{bodies}</worldbody></mujoco>", "utf-8")
        robot = load_robot(path)
        save_robot(robot, tmp_path / name)
        again = load_robot(tmp_path / name)
        found, kept = (
            {frozenset(one.shapes[k].name for k in pair) for pair in meeting_shapes(one).pairs}
            for one in (robot, again)
        )
        assert frozenset(want) in found
        assert found == kept
    assert frozenset(("hand", "side")) not in found


def test_a_shape_that_a_link_does_not_have_is_refused_by_name(tmp_path):
    path = tmp_path / "robot.xml"
    floor = '<geom type="plane" size="5 5 1"/>'
    path.write_text(f"<mujoco><worldbody>{floor}{HINGES}</worldbody></mujoco>", "utf-8")
    (tmp_path / "robot.toml").write_text('excluded = [["trunk", "hand/palm"]]\n', "utf-8")
    with pytest.raises(ValueError, match=r"'hand/palm'.*no shape of that name; expected one of 'hand'"):
        load_robot(path)
