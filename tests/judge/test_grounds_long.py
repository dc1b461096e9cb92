"""Judgments on rough ground, and with the control ranges of a robot's file, beside MuJoCo."""

import warnings

import mujoco
import numpy as np
import pytest

from featherstone_gait import Ground, Session, compile_scene, load_robot, simulate, standing_state
from featherstone_gait.benchmark.little_biped import NETWORK, little_biped
from featherstone_gait.judge import Policy, PolicyDescription, judge, load_policy
from featherstone_gait.judge.description import Action, Block
from featherstone_gait.judge.doubts import draw_worlds

pytestmark = pytest.mark.long
FRICTION = {"ground": {"friction": {"kind": "uniform", "scale": 0.2}}}


@pytest.fixture(scope="module")
def network():
    pytest.importorskip("onnxruntime")
    return load_policy(NETWORK, little_biped(), NETWORK.with_suffix(".toml"))


def test_it_breaks_on_rough_ground_and_the_roughness_is_named(network):
    """Its feet are lifted by 4 mm: on nodes 3 cm apart that differ by as much it falls."""
    rough = {"worlds": FRICTION, "roughness": {"height": 0.02, "cell": 0.03}}
    found = judge(network, little_biped(), 64, 6.0, doubts=rough, again=0)
    cause = found.causes[0]
    assert (cause.name, cause.chance < 1e-3, cause.effect > 0.6) == ("roughness", True, True)
    assert cause.others < cause.failing
    few = judge(network, little_biped(), 8, 6.0, doubts=rough, again=0)
    for name, values in few.worlds.items():
        assert values.tobytes() == found.worlds[name][:8].tobytes(), name
    even = judge(network, little_biped(), 64, 6.0, doubts={"worlds": FRICTION}, again=0)
    assert found.walking < even.walking - 10


def test_a_field_without_roughness_is_the_plane(network):
    """With the same slopes, which the fields have in their heights: tangents are other ones, and a walk goes apart."""
    hills = {"worlds": {"ground": {"slope": {"kind": "uniform", "scale": 0.03, "additive": True}}}}
    plane = judge(network, little_biped(), 8, 3.0, doubts=hills, again=0)
    field = judge(network, little_biped(), 8, 3.0, doubts=hills | {"roughness": {"height": 1e-9}}, again=0)
    assert field.factors["ground.slope"].tolist() == plane.factors["ground.slope"].tolist()
    for name in ("way", "energy", "clearance"):
        assert field.worlds[name] == pytest.approx(plane.worlds[name], rel=2e-2), name
    assert field.worlds["slip"] == pytest.approx(plane.worlds["slip"], abs=0.01)


def test_fields_in_lanes_are_those_of_the_worlds_alone():
    """And robots that are dropped side by side stand at the heights of their own worlds."""
    scene = compile_scene(little_biped(), "rotor", Ground(), "midpoint", 1e-3)
    drawn = draw_worlds(scene, 8, 1, {"worlds": FRICTION, "roughness": {"height": 0.01}}, 1.0)
    scenes = drawn.worlds.scenes(scene)
    starts = [standing_state(one, np.zeros(14)) for one in scenes]
    for k, start in enumerate(starts):
        start[scene.layout["base_q"] + 1] += 0.2 + 0.02 * k  # beside the even place
        start[scene.layout["base_q"] + 2] += 0.02
    with Session(scene, observe=("base_q",), worlds=drawn.worlds) as session:
        session.reset(state=starts)
        seen = session.step(np.zeros((8, 14)), ticks := round(0.3 / session.tick))["base_q"].copy()
        for k in (0, 5):
            alone = simulate(scenes[k], ticks * session.tick, starts[k], record=("base_q",), estimate_error=False)
            assert alone["base_q"][-1].tobytes() == seen[k].tobytes()
    assert len({*seen[:, 2].tolist()}) == 8
    assert np.ptp(seen[:, 2]) > 2e-3  # [m]


BOX = """<mujoco><option timestep="0.001"/><worldbody><geom type="plane" size="5 5 0.1"/>
<body pos="0 0 0.1"><freejoint/><geom type="box" size="0.2 0.2 0.1" mass="20"/>
<body pos="0 0 0.15"><joint name="j" axis="0 1 0" damping="0.5" range="-90 90" limited="true"/>
<geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.5" contype="0" conaffinity="0"/></body></body>
</worldbody><actuator><position name="a" joint="j" kp="8" kv="0.3" %s/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("stated", "high"), [('ctrlrange="-0.2 0.5"', 0.5), ('inheritrange="0.8"', 0.4 * np.pi), ("", 10.0)]
)
def test_references_are_clamped_as_mujoco_clamps_them(stated, high, tmp_path):
    """An arm on a heavy box is asked for 1.4 rad; without a range it goes there."""
    path = tmp_path / "box.xml"
    path.write_text(BOX % stated, "utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        robot = load_robot(path, contacts="all")
    description = PolicyDescription(("j",), (0.0,), 50.0, (Block("joint_pos"),), Action(limits=False), "up")
    policy = Policy(lambda seen: np.full((len(seen), 1), 1.4), description, "up")
    nothing = {"link": {"lost": 0.0}}
    found = judge(policy, robot, 8, 3.0, doubts=nothing, again=0)
    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    d.ctrl[:] = 1.4
    for _ in range(3000):
        mujoco.mj_step(m, d)
    angle = found.runs([0])[0]["q"][-1, 0]
    assert angle == pytest.approx(d.qpos[7], abs=2e-4)
    gravity = 8.0 * (min(high, 1.4) - angle)  # of the arm: 0.5 kg at 0.1 m, and negative angles lift it
    assert gravity == pytest.approx(-0.5 * 9.81 * 0.1 * np.cos(angle), abs=2e-3)
    assert ("within its control ranges" in found.note) == bool(stated)
