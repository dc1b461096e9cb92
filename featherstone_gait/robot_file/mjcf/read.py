"""Read MJCF through MuJoCo's compiler."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ...model import Base
from ...model.rest_posture import START
from ..report import Report, blamed_on
from ..robot import Robot
from ..settings import Posture, Settings
from .actuators import Actuators, read_actuators
from .causes import doubts, idle, notes, other_gravity, refusals
from .equalities import couplings, held_joints
from .fluids import other_fluid, read_immersed
from .frictions import slack_notes
from .loops import equality_names, read_loops
from .sensors import read_sensors
from .sizes import check_sizes, documents_of
from .stated import Stated
from .tendons import read_tendons, taken
from .touching import as_names, collisions, neighbors_that_touch, paired_geoms, read_touching
from .tree import BALL, HINGE, SLIDE, Tree, geometry_of, names_of, read_shapes, read_tree, rounded

NAMELESS = "MuJoCo Model"  # what MuJoCo calls a file without a name
LINE = re.compile(r"line \d+")  # 0 of what is included
INSTALL = "MJCF is read through MuJoCo; install it with pip install featherstone-gait[mjcf]"


@np.errstate(all="ignore")  # Link, Joint and the like refuse what is not finite
def read_mjcf(path: Path, base: Base | None, report: Report) -> Robot:
    """Read an MJCF file.  base: None is "floating" if the file has a free joint.

    What is ignored goes into the report.  Raises ImportError without MuJoCo, ValueError for what MuJoCo cannot read,
    RobotFileError for all that the simulator does not support.
    """
    documents = documents_of(path)
    m, remarks = compiled(path, documents)
    tree = read_tree(m, base, couplings(m))
    if m.nbody == 1:
        report.refuse(None, "there is no <body>; a robot needs one or more: add them to <worldbody>")
    for problem in refusals(m, tree):
        report.refuse(None, problem)
    actuators, settings = Actuators({}, tree.joints, [], [], {}, {}), Settings()
    stated = Stated(path, documents.values())
    with report.blaming():
        settings = stated.of("", tree.links, tree.joints, report)
        actuators = read_actuators(m, tree, tree.joints, taken(m, tree), settings.servos)
    pairs = (pair for root in documents.values() for pair in root.iter("pair"))
    touching = read_touching(m, tree, any("friction" in pair.attrib for pair in pairs))
    names = names_of(m, "geom", m.ngeom)
    for g in (g for g in range(m.ngeom) if names[g] in settings.shapes):  # also where they touch nothing
        touching.friction.setdefault(g, None)
    for g in (g for g in [*touching.friction] if names[g] in stated.points()):
        del touching.friction[g]
    touched = (g for g in touching.friction if tree.holds(m, int(m.geom_bodyid[g])))
    for sentence in (
        *doubts(m, tree),
        *rounded(m, touched, names),
        *other_gravity(m),
        *other_fluid(m),
        *actuators.doubts,
        *touching.doubts,
    ):
        report.doubt(sentence)
    report.raise_problems(path)
    shapes, left = read_shapes(m, tree, touching.friction)
    sensors, said = read_sensors(m, lambda b: tree.bodies[b] if tree.holds(m, b) and (b or tree.root == 0) else None)
    ground = [int(g) for pair in zip(m.pair_geom1, m.pair_geom2) for g in pair if m.geom_bodyid[g] == 0]
    slack = slack_notes(m, [*touching.friction, *ground])
    remarks += idle(documents.values())
    for sentence in (*notes(m, tree), *slack, *said, *left, *touching.remarks, *actuators.remarks, *remarks):
        report.remark(sentence)
    geoms = [g for g in touching.friction if tree.holds(m, int(m.geom_bodyid[g])) and geometry_of(m, g) is not None]
    every = [*range(len(geoms))]
    meeting = collisions(m, geoms, every, paired_geoms(m), stated.is_there)
    links = [tree.bodies[m.geom_bodyid[g]] for g in geoms]
    shaped = [f"{link}/{names[g]}" for link, g in zip(links, geoms)]
    near = neighbors_that_touch(m, geoms)
    included = [] if stated.is_there else as_names(links, shaped, every, near & meeting)
    return Robot(
        name_of(m, path), tree.links, actuators.joints, shapes, tree.base, held_by(m, tree), actuators.servos,
        postures_of(m, tree), tuple(as_names(links, shaped, every, ~meeting)), read_loops(m, tree, equality_names(m)),
        read_tendons(m, tree, actuators.drives), read_immersed(m, tree),
        sensors=tuple(sensors), included=tuple(included), references=actuators.references, stated=settings,
    )  # fmt: skip


def name_of(m: Any, path: Path) -> str:
    """Return the name that the file gives itself, or that of the file."""
    name = bytes(m.names).split(b"\0", 1)[0].decode("utf-8", "replace")
    return path.stem if name in ("", NAMELESS) else name


def held_by(m: Any, tree: Tree) -> dict[str, float]:
    """Return the joints of a tree that equalities hold, and their positions [rad or m]."""
    return {tree.joint_names[j]: at for j, at in held_joints(m).items() if tree.holds(m, int(m.jnt_bodyid[j]))}


def compiled(path: Path, documents: Mapping[Path, Element]) -> tuple[Any, list[str]]:
    """Compile a file, given with those that it includes: return MuJoCo's model, and MuJoCo's remarks."""
    try:
        import mujoco
    except ImportError as error:
        raise ImportError(INSTALL) from error
    check_sizes(path, documents)
    remarks: list[object] = []
    with warnings.catch_warnings(record=True) as caught, heard(mujoco, remarks):
        warnings.simplefilter("always")
        try:
            m = mujoco.MjSpec.from_file(str(path.absolute())).compile()  # a relative one hides what includes add
        except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
            file, text = _guilty(mujoco, _line(error), path, documents)
            with blamed_on(file):
                raise ValueError(f"MuJoCo cannot read it: {text}; correct the file there") from error
    said = dict.fromkeys(_line(remark) for remark in [*remarks, *(warning.message for warning in caught)])
    return m, [f"MuJoCo: {remark}" for remark in said]


def _guilty(mujoco: Any, text: str, path: Path, documents: Iterable[Path]) -> tuple[Path, str]:
    """Return the included file that MuJoCo refuses by itself with the same error, and that error, which has the line.

    Where there is none it is the file that includes the others, and its error.
    """
    for file in documents:
        try:
            if file != path:
                mujoco.MjSpec.from_file(str(file.absolute())).compile()
        except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
            if LINE.sub("", _line(error)) == LINE.sub("", text):
                return file, _line(error)
    return path, text


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


def postures_of(m: Any, tree: Tree) -> dict[str, Posture]:
    """Return what the keyframes say of a tree, and the posture of the references of its joints, if any is not 0."""
    own = (j for j in range(m.njnt) if tree.holds(m, int(m.jnt_bodyid[j])) and m.jnt_type[j] in (SLIDE, HINGE))
    start = {START: _posture(m, tree, m.qpos0)} if any(m.qpos0[m.jnt_qposadr[j]] for j in own) else {}
    return {m.key(k).name or f"key{k}": _posture(m, tree, m.key_qpos[k]) for k in range(m.nkey)} | start


def _posture(m: Any, tree: Tree, q: np.ndarray) -> Posture:
    own = {joint.name for joint in tree.joints}
    joints: dict[str, Any] = {}
    for j in range(m.njnt):
        at = m.jnt_qposadr[j]
        if tree.joint_names[j] in own:
            joints[tree.joint_names[j]] = tuple(q[at : at + 4].tolist()) if m.jnt_type[j] == BALL else float(q[at])
    base = [*m.body_pos[tree.root].tolist(), *m.body_quat[tree.root].tolist()]
    if tree.root and m.body_jntnum[tree.root]:
        start = m.jnt_qposadr[m.body_jntadr[tree.root]]
        base = q[start : start + 7].tolist()
    return Posture(tuple(base), joints)
