"""Read MJCF through MuJoCo's compiler."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...model import Base
from ..report import Report
from ..robot import Posture, Robot
from .actuators import Actuators, read_actuators
from .causes import doubts, notes, refusals
from .equalities import couplings, held_joints
from .sizes import check_sizes
from .tree import Tree, read_shapes, read_tree

NAMELESS = "MuJoCo Model"  # what MuJoCo calls a file without a name
INSTALL = "MJCF is read through MuJoCo; install it with pip install featherstone-gait[mjcf]"


def read_mjcf(path: Path, base: Base | None, report: Report) -> Robot:
    """Read an MJCF file.  base: None is "floating" if the file has a free joint.

    What is ignored goes into the report.  Raises ImportError without MuJoCo, ValueError for what MuJoCo cannot read,
    RobotFileError for all that the simulator does not support.
    """
    m, remarks = compiled(path)
    tree = read_tree(m, base, couplings(m))
    for problem in refusals(m, tree):
        report.refuse(None, problem)
    actuators = Actuators({}, tree.joints, [], [])
    with report.blaming():
        actuators = read_actuators(m, tree, tree.joints)
    for sentence in (*doubts(m, tree), *actuators.doubts):
        report.doubt(sentence)
    report.raise_problems(path)
    shapes, left = read_shapes(m, tree)
    for sentence in (*notes(m, tree), *left, *actuators.remarks, *remarks):
        report.remark(sentence)
    joints = actuators.joints
    postures = {m.key(k).name or f"key{k}": _posture(m, tree, m.key_qpos[k]) for k in range(m.nkey)}
    held = {tree.joint_names[j]: place for j, place in held_joints(m).items() if tree.holds(m, m.jnt_bodyid[j])}
    name = bytes(m.names).split(b"\0", 1)[0].decode("utf-8", "replace")
    name = path.stem if name in ("", NAMELESS) else name
    return Robot(name, tree.links, joints, shapes, tree.base, held, actuators.servos, postures)


def compiled(path: Path) -> tuple[Any, list[str]]:
    """Compile a file: return MuJoCo's model, and MuJoCo's remarks."""
    try:
        import mujoco
    except ImportError as error:
        raise ImportError(INSTALL) from error
    check_sizes(path)
    remarks: list[object] = []
    with warnings.catch_warnings(record=True) as caught, heard(mujoco, remarks):
        warnings.simplefilter("always")
        try:
            m = mujoco.MjSpec.from_file(str(path.absolute())).compile()  # a relative one hides what includes add
        except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
            raise ValueError(f"MuJoCo cannot read it: {_line(error)}; correct the file there") from error
    said = dict.fromkeys(_line(remark) for remark in [*remarks, *(warning.message for warning in caught)])
    return m, [f"MuJoCo: {remark}" for remark in said]


@contextmanager
def heard(mujoco: Any, remarks: list[object]) -> Iterator[None]:
    """Collect MuJoCo's warnings, which it would write to a file in the current folder."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(remarks.append)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _line(message: object) -> str:
    return " ".join(str(message).split()).removeprefix("Error: ").removeprefix("XML Error: ")


def _posture(m: Any, tree: Tree, q: np.ndarray) -> Posture:
    own = {joint.name for joint in tree.joints}
    single = [j for j in range(m.njnt) if tree.joint_names[j] in own]
    joints = {tree.joint_names[j]: float(q[m.jnt_qposadr[j]]) for j in single}
    base = [*m.body_pos[tree.root].tolist(), *m.body_quat[tree.root].tolist()]
    if tree.root and m.body_jntnum[tree.root]:
        start = m.jnt_qposadr[m.body_jntadr[tree.root]]
        base = q[start : start + 7].tolist()
    return Posture(tuple(base), joints)
