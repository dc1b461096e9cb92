"""Policies of files: networks in ONNX with and without metadata, and gaits."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.judge import PolicyDescription, load_policy
from featherstone_gait.judge.description import Block
from featherstone_gait.robot_file.source import robots_folder
from featherstone_gait.walking.motion import read_motion

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

ROBOT = load_robot("humanoid", locked="simplified")
JOINTS = ROBOT.joint_names
W = np.random.default_rng(0).normal(size=(13, 10)).astype(np.float32)
DESCRIPTION = PolicyDescription(JOINTS, (0.1,) * 10, 50.0, (Block("joint_pos"), Block("projected_gravity")))


def network(path, metadata=None, rows=1, weights=W):
    """Write a network tanh(x W), of so many rows as its exporter took."""
    info = onnx.helper.make_tensor_value_info
    size, joints = weights.shape
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("MatMul", ["obs", "W"], ["sum"]), onnx.helper.make_node("Tanh", ["sum"], ["actions"])],
        "policy",
        [info("obs", onnx.TensorProto.FLOAT, [rows, size])],
        [info("actions", onnx.TensorProto.FLOAT, [rows, joints])],
        [onnx.numpy_helper.from_array(weights, "W")],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)
    onnx.helper.set_model_props(model, metadata or {})
    onnx.save(model, path)
    return path


def test_a_network_answers_all_worlds_and_each_with_the_bits_that_it_has_among_others(tmp_path):
    policy = load_policy(network(tmp_path / "own.onnx"), ROBOT, DESCRIPTION)
    seen = np.random.default_rng(1).normal(size=(150, 13))
    answers = policy.actions(seen, 0.0)
    assert np.abs(answers - np.tanh(seen.astype(np.float32) @ W)).max() < 1e-6
    for few in (1, 7, 64, 65):
        assert policy.actions(seen[:few], 0.0).tobytes() == answers[:few].tobytes()


@pytest.mark.parametrize("first", ["refuses several rows", "answers them by one"])
def test_a_network_that_keeps_the_row_of_its_export_is_asked_row_by_row(first, tmp_path):
    file, made = tmp_path / "own.onnx", onnx.helper.make_node
    kept = onnx.load(network(file))
    if first == "refuses several rows":
        shape = onnx.numpy_helper.from_array(np.array([1, 10]), "shape")
        node = made("Reshape", ["sum", "shape"], ["row"])
    else:
        shape = onnx.numpy_helper.from_array(np.array([0]), "shape")
        node = made("Gather", ["sum", "shape"], ["row"], axis=0)
    kept.graph.initializer.append(shape)
    kept.graph.node.pop()
    kept.graph.node.extend([node, made("Tanh", ["row"], ["actions"])])
    onnx.save(kept, file)
    seen = np.random.default_rng(1).normal(size=(5, 13))
    found = load_policy(file, ROBOT, DESCRIPTION).actions(seen, 0.0)
    assert np.abs(found - np.tanh(seen.astype(np.float32) @ W)).max() < 1e-6


def test_what_a_network_says_of_itself_is_taken_and_what_is_given_goes_before(tmp_path):
    says = {
        "joint_names": ",".join(JOINTS), "default_joint_pos": ",".join(["0.100"] * 10), "action_scale": "0.5",
        "observation_names": "joint_pos,projected_gravity",
    }  # fmt: skip
    (tmp_path / "rate.toml").write_text("rate = 25.0\n[action]\nscale = 0.2\n", "utf-8")
    file = network(tmp_path / "own.onnx", says)
    policy = load_policy(file, ROBOT, tmp_path / "rate.toml")
    assert (policy.description.joints, policy.description.pose) == (JOINTS, (0.1,) * 10)
    assert (policy.description.rate, policy.description.action.scale, policy.name) == (25.0, 0.2, "own")
    (tmp_path / "none.toml").write_text("[about]\nwhat = 'nothing'\n", "utf-8")
    with pytest.raises(ValueError, match=r"none\.toml.*lacks rate"):
        load_policy(file, ROBOT, tmp_path / "none.toml")
    with pytest.raises(ValueError, match=r"own\.onnx.*not known: its metadata say joints, pose.*microduck"):
        load_policy(file, ROBOT)


def test_the_policies_of_a_robot_that_the_package_knows_need_no_description(tmp_path):
    from featherstone_gait.judge import read_description

    duck = read_description("microduck")
    own = replace(ROBOT, name="duck")
    says = {"joint_names": ",".join(duck.joints), "default_joint_pos": ",".join(["0.2"] * 14)}
    file = network(tmp_path / "walk.onnx", says, weights=np.zeros((51, 14), np.float32))
    with pytest.raises(ValueError, match="'left_hip_yaw' is none of duck"):  # by its joints the description was found
        load_policy(file, own)


@pytest.mark.parametrize(
    ("shape", "said"),
    [((12, 10), "observes 12 numbers.*has 13: correct its observation"), ((13, 9), "answers 9.*correct its joints")],
)
def test_a_network_of_other_sizes_is_told(shape, said, tmp_path):
    file = network(tmp_path / "own.onnx", weights=np.zeros(shape, np.float32))
    with pytest.raises(ValueError, match=rf"own\.onnx: .*{said}"):
        load_policy(file, ROBOT, DESCRIPTION)


def test_what_is_no_network_is_told(tmp_path):
    (tmp_path / "text.onnx").write_text("no network", "utf-8")
    with pytest.raises(ValueError, match=r"text\.onnx: no network with one input"):
        load_policy(tmp_path / "text.onnx", ROBOT, DESCRIPTION)
    flat = onnx.load(network(tmp_path / "flat.onnx"))
    del flat.graph.input[0].type.tensor_type.shape.dim[1:]
    onnx.save(flat, tmp_path / "flat.onnx")
    with pytest.raises(ValueError, match=r"flat\.onnx: no network with one input"):
        load_policy(tmp_path / "flat.onnx", ROBOT, DESCRIPTION)
    free = onnx.load(network(tmp_path / "free.onnx"))
    free.graph.input[0].type.tensor_type.shape.dim[1].dim_param = "any"
    onnx.save(free, tmp_path / "free.onnx")
    with pytest.raises(ValueError, match=r"free\.onnx: it does not answer 10 numbers"):
        load_policy(tmp_path / "free.onnx", ROBOT, replace(DESCRIPTION, observation=(Block("joint_pos"),)))
    with pytest.raises(ValueError, match=r"says\.onnx: its metadata has action_scale = '0.2,x'"):
        load_policy(network(tmp_path / "says.onnx", {"action_scale": "0.2,x"}), ROBOT)
    with pytest.raises(ValueError, match=r"absent\.onnx: there is no such file"):
        load_policy(tmp_path / "absent.onnx", ROBOT, DESCRIPTION)
    with pytest.raises(ValueError, match=r"policy\.pt: give an \.onnx file"):
        load_policy("policy.pt", ROBOT)


def test_a_package_that_is_missing_is_named_with_the_command(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ImportError, match=r"pip install featherstone-gait\[policy\]"):
        load_policy(network(tmp_path / "own.onnx"), ROBOT, DESCRIPTION)


def test_a_gait_is_played_as_its_motion_says():
    file = robots_folder() / "humanoid" / "optimized_gait.npz"
    motion, policy = read_motion(file, JOINTS), load_policy(file, ROBOT)
    reference = motion.reference(4)
    times = np.linspace(0.0, reference.times[-1], 999)
    found = policy.description.pose + policy.actions(times[:, None], 0.0)
    lines = np.column_stack([np.interp(times, reference.times, column) for column in reference.values.T])
    order = [policy.description.joints.index(name) for name in JOINTS]
    assert np.abs(found[:, order] - lines).max() < 1e-12
