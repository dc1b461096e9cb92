"""A case in MuJoCo, at its own step and with its own integrator."""

from __future__ import annotations

import importlib.util
import math
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..robot_file import save_robot
from ..scene.compile import CompiledScene
from .case import Case, Truth, distances
from .limited import at_most
from .mujoco_models import disable, quick_mujoco

STEP = 2e-3  # MuJoCo's default [s]
LONGEST = 10.0  # [s]


class Peer(NamedTuple):
    """What MuJoCo gives."""

    error: float  # of positions [rad or m], NaN where laws differ
    time: float  # CPU per simulated second [ms], NaN where it cannot


def peer_run(case: Case, exact: Truth) -> Peer:
    """Error and time; NaN without MuJoCo, and for servos and springs, which it has not."""
    scene = case.scene
    if not importlib.util.find_spec("mujoco") or scene.gearbox or scene.springs or case.duration > LONGEST:
        return Peer(math.nan, math.nan)
    try:
        m = model_of(scene)
    except ValueError:
        return Peer(math.nan, math.nan)
    with quick_mujoco(), at_most(30.0):
        runs = [_rolled(m, case) for _ in range(3)]
    error = float(distances(scene, runs[0][0], exact.q)[: exact.known].max()) if same_laws(scene) else math.nan
    return Peer(error, statistics.median(seconds for _, seconds in runs) * 1e3 / case.duration)


def same_laws(scene: CompiledScene) -> bool:
    """Whether nothing acts of which MuJoCo has another law: ground, stops, dry friction, couplings."""
    parts = scene.constants
    rubs = any(joint.friction > 0 for joint in scene.model.moving_joints)
    return parts.contact is None and parts.stops is None and parts.coupling is None and not rubs


def model_of(scene: CompiledScene) -> Any:
    """The scene's model in MuJoCo; ValueError where it cannot be stated."""
    import mujoco

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.xml"
        save_robot(scene.model, path, scene.ground)
        m = mujoco.MjModel.from_xml_path(str(path))
    m.opt.gravity[:] = scene.gravity
    if scene.ground is None:
        disable(m, "CONTACT")
    return m


def _rolled(m: Any, case: Case) -> tuple[np.ndarray, float]:
    """Positions (samples, nq) in our order of joints, and the CPU time [s]."""
    import mujoco

    d, scene = mujoco.MjData(m), case.scene
    o, n, base = scene.layout, scene.tree.n, scene.tree.floating
    joints = [m.joint(name) for name in scene.model.joint_names]
    at_q = [*range(7 * base), *(joint.qposadr[0] for joint in joints)]
    at_v = [*range(6 * base), *(joint.dofadr[0] for joint in joints)]
    y = case.state
    d.qpos[at_q] = np.concatenate([y[o["base_q"] : o["base_q"] + 7 * base], y[o["q"] : o["q"] + n]])
    d.qvel[at_v] = np.concatenate([y[o["base_qd"] : o["base_qd"] + 6 * base], y[o["qd"] : o["qd"] + n]])
    every, seconds, q = round(case.every / STEP), 0.0, [d.qpos[at_q].copy()]
    for _ in range(round(case.duration / case.every)):
        start = time.thread_time()
        mujoco.mj_step(m, d, every)
        seconds += time.thread_time() - start
        q.append(d.qpos[at_q].copy())
    return np.array(q), seconds
