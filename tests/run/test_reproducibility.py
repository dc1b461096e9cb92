"""The same bits: alone or in a batch, in any lane, beside any neighbor, on any thread, compiled or not."""

import hashlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from random_tree import random_states

from featherstone_gait.core.compile.lanes import WIDTH, aligned
from featherstone_gait.core.tree.batch import aba_lanes, rnea_lanes
from featherstone_gait.core.tree.layout import Motion, Robot
from featherstone_gait.dynamics import forward_dynamics, inverse_dynamics
from featherstone_gait.dynamics.tree import GRAVITY, compile_tree
from featherstone_gait.model import Joint, Link, Model
from featherstone_gait.robot_file import load_robot

FUNCTIONS = [forward_dynamics, inverse_dynamics]
COUNT = 64


def humanoid_states():
    model = load_robot("humanoid")
    return model, random_states(model, COUNT, seed=1)


def one_by_one(function, model, states):
    return np.array([function(model, *state) for state in zip(*states)])


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize("size", [1, 7, 8, 9, 64])
def test_a_state_alone_and_in_a_batch(function, size):
    model, states = humanoid_states()
    batches = [function(model, *(a[k : k + size] for a in states)) for k in range(0, COUNT, size)]
    assert np.concatenate(batches).tobytes() == one_by_one(function, model, states).tobytes()


@pytest.mark.parametrize("function", FUNCTIONS)
def test_any_lane(function):
    model, states = humanoid_states()
    straight = function(model, *states)
    for shift in range(1, WIDTH):
        rolled = function(model, *(np.roll(a, shift, axis=0) for a in states))
        assert np.roll(rolled, -shift, axis=0).tobytes() == straight.tobytes()


@pytest.mark.bounds
@pytest.mark.nojit
@pytest.mark.parametrize("kernel", [aba_lanes, rnea_lanes], ids=["aba", "rnea"])
@pytest.mark.parametrize("calm", [0, 3, 7])
def test_a_calm_lane_beside_lanes_full_of_inf_and_nan(kernel, calm):
    model, states = humanoid_states()
    alone = lanes_of(kernel, model, [np.repeat(a[:1], WIDTH, axis=0) for a in states])
    wild = [np.repeat([[np.nan], [np.inf], [-np.inf], [1e200]] * 2, a.shape[1], axis=1) for a in states]
    for a, quiet in zip(wild, states):
        a[calm] = quiet[0]
    beside = lanes_of(kernel, model, wild)
    finite = np.isfinite(beside).all(axis=1)
    assert finite.tolist() == [lane == calm for lane in range(WIDTH)]
    assert beside[calm].tobytes() == alone[calm].tobytes()


def lanes_of(kernel, model, states):
    """Run a batch kernel on one state in each lane, whatever its values are."""
    tree = compile_tree(model)
    joints = [in_lanes(a[:, a.shape[1] - tree.n :]) for a in states]
    bases = [in_lanes(a[:, : a.shape[1] - tree.n]) for a in states]
    work = aligned((1, *tree.workspace_shape(), WIDTH))
    base, out = aligned((1, 6, WIDTH)), aligned((1, tree.n, WIDTH))
    robot = Robot(tree.bodies, None, np.array(GRAVITY))
    if kernel is aba_lanes:
        moving = Motion(*bases[:2], None, *joints[:2], None)
        kernel(robot, moving, bases[2], joints[2], None, (work, None), base, out, None)
    else:
        kernel(robot, Motion(*bases, *joints), None, work, base, out)
    return np.ascontiguousarray(np.concatenate([base[0], out[0]]).T)


def in_lanes(a):
    """(WIDTH, k) as (1, k, WIDTH)."""
    out = aligned((1, a.shape[1], WIDTH))
    out[0] = a.T
    return out


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize("size", [1, 8])
def test_threads(function, size):
    model, states = humanoid_states()
    parts = [[a[k : k + size] for a in states] for k in range(0, COUNT, size)] * 4
    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(lambda part: function(model, *part), parts))
    assert np.concatenate(results).tobytes() == 4 * one_by_one(function, model, states).tobytes()


# Every operation from these numbers to the hash is an IEEE addition, subtraction, multiplication or division, or a
# comparison: joint axes lie along coordinate axes, so that no sine of the platform's libm and no fused multiply-add of
# its BLAS can enter.  It therefore holds on every machine and with the JIT off; it changes when the order of
# operations in a kernel does, and then has to be replaced knowingly.
GOLDEN = {
    "forward_dynamics": "13e26c62e93efbf7",
    "inverse_dynamics": "6a845426dff196e4",
}


def plain_robot():
    """A floating trunk with an arm of three joints, one of them sliding, and a single swinging one."""
    axes = {"shoulder": "x", "elbow": "-y", "slide": "z", "tail": "y"}
    parents = {"shoulder": "trunk", "elbow": "shoulder", "slide": "elbow", "tail": "trunk"}
    vectors = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    links = [Link("trunk", 0.75, (0.0, 0.0625, 0.0), (0.003, 0.0005, 0.0, 0.002, 0.00025, 0.0025))]
    joints = []
    for k, (name, axis) in enumerate(axes.items(), start=1):
        mass, inertia = 0.125 * k, (0.0003 * k, 0.0, 0.0, 0.0004, 0.0, 0.0002 * k)
        links.append(Link(name, mass, (0.03125, 0.0, -0.0625 * k), inertia))
        kind = "prismatic" if name == "slide" else "continuous"
        joints.append(Joint(name, kind, parents[name], name, (0.0, 0.0625 * k, -0.125), axis=vectors[axis]))
    return Model("plain", tuple(links), tuple(joints), "floating")


def plain_states(model):
    """Nine states of small fractions."""
    fractions = (np.arange(9 * 31) * 37 % 64 - 31.5) / 32
    q, qd, tau = np.split(fractions.reshape(9, 31), [model.nq, model.nq + model.nv], axis=1)
    return q, qd, tau


@pytest.mark.bounds
@pytest.mark.nojit
@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize("rows", [[0, 1, 2], range(9)], ids=["rows", "lanes"])
def test_the_same_bits_as_ever(function, rows):
    model = plain_robot()
    result = function(model, *(a[rows] for a in plain_states(model)))
    assert hashlib.sha256(result[:3].tobytes()).hexdigest()[:16] == GOLDEN[function.__name__]
