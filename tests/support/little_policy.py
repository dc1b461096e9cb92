"""How `benchmark/little_biped_walk.onnx` was made: a small network fitted to planned gaits of the little biped.

    PYTHONPATH=. python tests/support/little_policy.py featherstone_gait/benchmark

Gaits of five step lengths are planned by preview control (`walking.first_gait`, nothing is searched).  The network has
one layer of 96 tanh with random weights; the weights of its output are fitted, by least squares, to the angles of the
gaits less a pose, plus an ankle strategy: ankles turn against the tilt and the rotation of the trunk.  Its gains were
tried by `judge`: in 64 worlds of 6 s the robot walks in all with them, in 42 without.
"""

import sys
from pathlib import Path

import numpy as np

from featherstone_gait import Ground, compile_scene
from featherstone_gait.benchmark.little_biped import little_biped
from featherstone_gait.walking.cheapest_plan import first_gait

STEP_TIME, BEGIN = 0.4, 0.25  # [s], share of the stride at which a walk starts
LENGTHS = (0.0, 0.01, 0.02, 0.03, 0.04)  # of steps [m]; a command of 0.1 m/s asks for the last
PITCH, PITCH_RATE, ROLL, ROLL_RATE = 0.3, 0.02, 0.5, 0.06  # [rad], [s] of the ankles
HIDDEN, SAMPLES = 96, 20000


def gaits(robot):
    """The planned gaits, by the speed that is commanded [m/s]."""
    scene, walk = compile_scene(robot, "rotor", Ground(), "midpoint", 1e-3), {"lift": 0.025, "com_height": 0.125}
    planned = (first_gait(scene, "plain", "step", step_time=STEP_TIME, step_length=x, **walk) for x in LENGTHS)
    return {x / STEP_TIME: cost.gait for x, cost in zip(LENGTHS, planned)}


def pose_of(found):
    """The reference pose [rad], from which all gaits begin nearly."""
    gait = found[max(found)]
    return np.round(gait.angles([BEGIN * gait.period])[0], 4)


def answers(found, robot, seen):
    """Return the actions (n, 14) to which the network is fitted, for observations (n, 11)."""
    gait = found[max(found)]
    times = np.arctan2(seen[:, 1], seen[:, 0]) / (2.0 * np.pi) * gait.period
    speeds = np.array([*found])
    by_speed = np.array([one.angles(times) for one in found.values()])  # (speeds, n, joints)
    at = np.clip(seen[:, 8] / np.diff(speeds)[0], 0.0, len(speeds) - 1.0)
    k = np.minimum(at.astype(int), len(speeds) - 2)
    share, rows = (at - k)[:, None], np.arange(len(seen))
    angles = (1.0 - share) * by_speed[k, rows] + share * by_speed[k + 1, rows] - pose_of(found)
    for side in ("left", "right"):
        angles[:, robot.joint_names.index(f"{side}_ankle_pitch")] += PITCH * seen[:, 2] + PITCH_RATE * seen[:, 6]
        angles[:, robot.joint_names.index(f"{side}_ankle_roll")] += ROLL * seen[:, 3] + ROLL_RATE * seen[:, 5]
    return angles


def observations(draws, n):
    """Observations (n, 11) as they may occur: phase, gravity, rotation, command."""
    turn, tilt = 2.0 * np.pi * draws.random(n), 0.15 * draws.normal(size=(n, 2))
    down = np.column_stack([tilt, -np.sqrt(np.maximum(1.0 - (tilt**2).sum(axis=1), 0.0))])
    command = np.column_stack([0.1 * draws.random(n), np.zeros((n, 2))])
    return np.column_stack([np.cos(turn), np.sin(turn), down, 0.7 * draws.normal(size=(n, 3)), command])


def fitted(found, robot):
    """Weights of both layers, (12, 96) and (97, 14); the last rows are biases."""
    draws = np.random.default_rng(0)
    seen = observations(draws, SAMPLES)
    first = np.vstack([draws.normal(size=(11, HIDDEN)), draws.normal(size=(1, HIDDEN))])
    first[[4, 9, 10]] = 0.0  # gravity along z, and commands that it does not know
    first[8] *= 10.0  # of the command, which is small
    first[5:8] *= 0.4
    hidden = np.tanh(np.c_[seen, np.ones(SAMPLES)] @ first)
    second = np.linalg.lstsq(np.c_[hidden, np.ones(SAMPLES)], answers(found, robot, seen), rcond=None)[0]
    return first, second


def write(folder):
    """Write the network and its description."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    robot = little_biped()
    found = gaits(robot)
    weights = dict(zip("AB", (one.astype(np.float32) for one in fitted(found, robot))))
    nodes = [helper.make_node("Gemm", ["obs", "A", "a"], ["first"]), helper.make_node("Tanh", ["first"], ["hidden"])]
    nodes.append(helper.make_node("Gemm", ["hidden", "B", "b"], ["actions"]))
    parts = {"A": weights["A"][:-1], "a": weights["A"][-1], "B": weights["B"][:-1], "b": weights["B"][-1]}
    shapes = (
        helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 11]),
        helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 14]),
    )
    stored = [numpy_helper.from_array(values, name) for name, values in parts.items()]
    graph = helper.make_graph(nodes, "walk", shapes[:1], shapes[1:], stored)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    pose = ",".join(f"{x:.4f}" for x in pose_of(found))
    names = "phase,projected_gravity,base_ang_vel,command"
    says = {"joint_names": ",".join(robot.joint_names), "default_joint_pos": pose, "observation_names": names}
    helper.set_model_props(model, says)
    onnx.save(model, Path(folder) / "little_biped_walk.onnx")
    (Path(folder) / "little_biped_walk.toml").write_text(
        "# What the metadata of little_biped_walk.onnx do not say (tests/support/little_policy.py).\nrate = 50.0\n\n"
        f'[[observation]]\nname = "phase"\nperiod = {2 * STEP_TIME}\nphases = [{2 * np.pi * BEGIN:.7f}]\n'
        + "".join(f'[[observation]]\nname = "{name}"\n' for name in names.split(",")[1:]),
        "utf-8",
    )


if __name__ == "__main__":
    write(sys.argv[1])
