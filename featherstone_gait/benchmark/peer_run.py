"""A case in MuJoCo, at its own step and with its own integrator."""

from __future__ import annotations

import importlib.util
import math
import statistics
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ..robot_file import save_robot
from ..scene.compile import CompiledScene
from .case import Case, Truth, distances
from .limited import at_most
from .mujoco_models import disable, quick_mujoco, rolled

STEP = 2e-3  # MuJoCo's default [s]
LONGEST = 10.0  # [s]


def peer_run(case: Case, exact: Truth) -> tuple[float, float]:
    """Error of positions [rad or m], NaN where laws differ, and CPU time per simulated second [ms].

    Both are NaN without MuJoCo, and for servos and springs, which it has not.
    """
    scene = case.scene
    if not importlib.util.find_spec("mujoco") or scene.gearbox or scene.springs or case.duration > LONGEST:
        return math.nan, math.nan
    try:
        m = model_of(scene)
    except ValueError:
        return math.nan, math.nan
    with quick_mujoco(), at_most(30.0):
        runs = [_rolled(m, case) for _ in range(3)]
    error = float(distances(scene, runs[0][0], exact.q)[: exact.known].max()) if same_laws(scene) else math.nan
    return error, statistics.median(seconds for _, seconds in runs) * 1e3 / case.duration


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

    d, base, (q, qd) = mujoco.MjData(m), case.scene.tree.floating, case.coordinates
    joints = [m.joint(name) for name in case.model.joint_names]
    at_q = [*range(7 * base), *(joint.qposadr[0] for joint in joints)]
    d.qpos[at_q], d.qvel[[*range(6 * base), *(joint.dofadr[0] for joint in joints)]] = q, qd
    path, seconds = rolled(m, d, round(case.every / STEP), round(case.duration / case.every))
    return path[:, at_q], seconds
