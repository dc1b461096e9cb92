"""Load a robot from its files."""

from __future__ import annotations

import os
import warnings
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from ..base import arguments
from ..base.arguments import instance, listed, real, texts, truth
from ..geometry.contact_choice import Choice, with_contacts
from ..geometry.distance import named_shapes
from ..model import LARGEST, Base, Joint, Mimic, Model, Surface
from ..model.degrees import by_degree, degrees_of
from ..model.links import Leader, leader_of
from ..model.rest_posture import nearest_positions
from ..model.shapes import Shape
from ..model.tree_checks import check_locked
from .closed import open_loops
from .collision import MeshFinder
from .markup import read_markup
from .mjcf.read import read_mjcf
from .plausible import doubt_inertias
from .report import Report, RobotFileError, RobotFileWarning, blamed_on, refusal
from .robot import Robot, with_rollers
from .settings import Settings, read_settings
from .simtwo.read import is_simtwo, read_simtwo
from .source import robot_path
from .srdf import read_excluded
from .urdf import read_urdf

MimicMode = Literal["coupled", "free", "locked"]


def load_robot(
    name_or_path: str | os.PathLike,
    base: Base | None = None,
    locked: str | Mapping[str, float] | list[str] | tuple[str, ...] | None = None,
    *,
    contacts: Choice | None = None,
    strict: bool = False,
    mimic: MimicMode = "coupled",
    repair_inertia: bool = False,
    package_dirs: str | os.PathLike | Sequence[str | os.PathLike] = (),
    srdf: str | os.PathLike | None = None,
) -> Model:
    """Load a robot by name, or from a URDF, an MJCF file or a scene of SimTwo.

    The .toml file of the same stem is read too, if it exists; its servos override those of the robot's file.  MJCF
    needs MuJoCo: ``pip install featherstone-gait[mjcf]``.  Keyframes of MJCF become `Model.keyframes`.

    A file that deviates from its format but has one meaning is read.  What changes the motion and cannot be represented
    in a `Model`, such as the forces of tendons in MJCF, is ignored.  `Model.notes` lists both, and one RobotFileWarning
    reports them.

    Parameters
    ----------
    name_or_path : str or path
        A name of `robot_names()`, or the path of a .urdf, .mjcf or .xml file.
    base : {"fixed", "floating"}, optional
        None: what the TOML file says, else "floating" if the file has a floating joint, else "fixed".
    locked : str, mapping or sequence of str, optional
        Joints to lock: the name of a set in the TOML file, {joint: position [rad or m]}, or joint names (locked at 0).
        "all" locks all joints in the posture nearest to zero, unless the TOML file has a set of that name.  None: the
        set "default" of the TOML file, if there is one.
    contacts : str or sequence of str, optional
        What can touch the ground: the collision shapes of the "feet", of "all" links, or of links by name (see
        `with_contacts`).  None: what the TOML file says.
    strict : bool, optional
        Raise an error in place of the warning.
    mimic : {"coupled", "free", "locked"}, optional
        How coupled joints move: with their leader, by themselves, or locked where the leader's position nearest to zero
        puts them.
    repair_inertia : bool, optional
        Repair inertias that no rigid body can have, as MuJoCo's `boundinertia` and `balanceinertia` do: principal
        moments below zero are raised to 1e-9 of the largest; if one is then above the sum of the other two, all become
        their mean.
    package_dirs : path or sequence of paths, optional
        Folders in which to search the packages of meshes `package://PACKAGE/...`, besides the folders above the URDF
        and those of ROS_PACKAGE_PATH.
    srdf : path, optional
        SRDF file whose <disable_collisions> become `Model.excluded`.  None: the one of the URDF's name beside it, or in
        the folder `srdf` beside its own.

    Returns
    -------
    Model
        The robot.

    Raises
    ------
    RobotFileError
        A ValueError that lists all that is wrong with a file.
    RobotFileNotFoundError
        If the file does not exist.
    ImportError
        For MJCF without MuJoCo.
    """
    _check_arguments(name_or_path, strict, repair_inertia, package_dirs, srdf)
    if base is not None:
        instance("base", base, str, "give 'fixed' or 'floating', or None")
    path = robot_path(name_or_path)
    with blamed_on(path):
        markup = read_markup(path)
        report = Report(markup.lines, strict)
        for sentence in markup.doubts:
            report.doubt(sentence)
        meshes = MeshFinder(path, package_dirs)
        if markup.root.tag == "mujoco":
            robot = read_mjcf(path, base, report)
        elif is_simtwo(markup.root):
            robot = read_simtwo(path, markup.root, base, report)
        else:
            robot = read_urdf(markup.root, path, meshes, report, repair_inertia)
            names, given = (link.name for link in robot.links), None if srdf is None else Path(srdf)
            robot = robot._replace(excluded=read_excluded(path, given, names, report))
    settings = robot.stated.under(_settings(path, robot, report))
    if markup.root.tag == "robot" and not (robot.loops or settings.loops):
        for sentence in open_loops(path, robot):
            report.doubt(sentence)
    held = {**robot.held, **_held(path, robot, locked, settings, report)}
    joints, held = resolve_couplings(robot.joints, held, mimic, report)
    if base is None:
        base = settings.base or robot.base or "fixed"
    robot = robot._replace(joints=joints, base=base, held=held)
    doubt_inertias(robot, report)
    model = model_of(path, robot, settings, report, meshes.package_dirs)
    report.warn(path, stacklevel=2)
    choice = settings.choice if contacts is None else contacts
    if choice is None:
        return model
    with blamed_on(f"{path}: contacts={choice!r}"):
        chosen = with_rollers(with_contacts(model, choice), robot.rollers)
    doubts = chosen.notes[len(model.notes) :]
    if doubts and strict:
        raise refusal(path, list(doubts))
    for doubt in doubts:
        warnings.warn(f"{path}: {doubt}", RobotFileWarning, stacklevel=2)
    return chosen


def _check_arguments(name_or_path: Any, strict: Any, repair_inertia: Any, package_dirs: Any, srdf: Any) -> None:
    """Raise TypeError for arguments of other types; values are checked where they are used."""
    instance("name_or_path", name_or_path, (str, os.PathLike), "give a robot's name, or the path of its file")
    truth("strict", strict)
    truth("repair_inertia", repair_inertia)
    if srdf is not None:
        arguments.path("srdf", srdf)
    if not isinstance(package_dirs, (str, os.PathLike)):
        for folder in listed("package_dirs", package_dirs, "give a folder, or a list of them"):
            instance("package_dirs", folder, (str, os.PathLike), "give a folder, or a list of them")


def _settings(path: Path, robot: Robot, report: Report) -> Settings:
    """Read the TOML file, if there is one; raise RobotFileError if it is wrong, unless the URDF is."""
    toml = path.with_suffix(".toml")
    if not toml.exists():
        return Settings()
    try:
        with blamed_on(toml):
            return read_settings(toml, robot.links, robot.joints, report)
    except RobotFileError:
        if not report.problems:
            raise
        return Settings()


def _held(path: Path, robot: Robot, locked: Any, settings: Settings, report: Report) -> dict[str, float]:
    """Return the joints to hold; raise RobotFileError if they cannot be held, unless the URDF is wrong."""
    if report.problems:
        return {}
    with blamed_on(f"{path}: load_robot(locked={locked!r})"):
        single = degrees_of(robot.joints).joints
        held = by_degree(_chosen(locked, settings.locked, single), robot.joints)
        check_locked(single, held)
    return held


def model_of(path: Path, robot: Robot, settings: Settings, report: Report, package_dirs: tuple[str, ...]) -> Model:
    """Make the model; report what is wrong with it."""
    own, postures = settings.parts, {**robot.postures, **settings.postures}
    moving = {name: stated["surface"] for name, stated in own["links"].items() if "surface" in stated}
    numbers = {name: {k: x for k, x in stated.items() if k != "surface"} for name, stated in own["links"].items()}
    keyframes = {
        name: (*(at.base if robot.base == "floating" else ()), *at.numbers(robot.joints, robot.held))
        for name, at in postures.items()
    }
    with report.blaming():
        model = Model(
            name=robot.name,
            links=tuple(replace(link, **numbers.get(link.name, {})) for link in robot.links),
            joints=tuple(replace(joint, **own["joints"].get(joint.name, {})) for joint in robot.joints),
            base=robot.base or "fixed",
            locked=robot.held,
            servos={**robot.servos, **settings.servos},
            contacts=_with_surfaces(settings.contacts, moving),
            shapes=_as_stated(_with_surfaces(_with_each(robot.shapes, moving, report), moving), settings, report),
            keyframes={**keyframes, **settings.keyframes},
            references={**robot.references, **settings.references},
            notes=report.notes(),
            source=str(path),
            supply=settings.supply,
            package_dirs=package_dirs,
            excluded=tuple(dict.fromkeys((*robot.excluded, *settings.excluded))),
            included=tuple(dict.fromkeys((*robot.included, *settings.included))),
            loops=tuple({loop.name: loop for loop in (*robot.loops, *settings.loops)}.values()),
            tendons=tuple({one.name: one for one in (*robot.tendons, *settings.tendons)}.values()),
            immersed=(*robot.immersed, *settings.immersed),
            propellers=tuple({one.joint: one for one in (*robot.propellers, *settings.propellers)}.values()),
            sensors=tuple({one.name: one for one in (*robot.sensors, *settings.sensors)}.values()),
        )
        named_shapes(model, (*model.excluded, *model.included))  # raises for shapes that links lack
    report.raise_problems(path)
    return model


def _with_surfaces(parts: tuple[Any, ...], moving: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return shapes or contact points with the surfaces of their links, but those that state their own."""
    whole = {name: given for name, given in moving.items() if isinstance(given, Surface)}
    return tuple(one if one.surface else replace(one, surface=whole.get(one.link)) for one in parts)


def _with_each(shapes: tuple[Shape, ...], moving: Mapping[str, Any], report: Report) -> tuple[Shape, ...]:
    """Return shapes with surfaces that the TOML file lists for each shape of a link; report lists of another length."""
    lists = {name: given for name, given in moving.items() if not isinstance(given, Surface)}
    for name, given in lists.items():
        if (count := sum(shape.link == name for shape in shapes)) != len(given):
            text = f"surface of the TOML file lists {len(given)} surfaces and the link has {count} shapes"
            report.refuse(None, f"links.{name}: {text}; list one of each, {{}} for one at rest")
    left = {name: iter(given) for name, given in lists.items()}
    return tuple(replace(one, surface=next(left.get(one.link, iter(())), None) or one.surface) for one in shapes)


def _as_stated(shapes: tuple[Shape, ...], settings: Settings, report: Report) -> tuple[Shape, ...]:
    """Return shapes with what [shapes.NAME] states; report names that no shape has."""
    for name in settings.shapes.keys() - {shape.name for shape in shapes}:
        report.refuse(None, f"shapes.{name}: there is no shape of this name; expected one of a <collision> or <geom>: "
                            "correct the name")  # fmt: skip
    return tuple(replace(shape, **settings.shapes.get(shape.name, {})) for shape in shapes)


def _chosen(locked: Any, sets: Mapping[str, dict[str, float]], joints: Iterable[Joint]) -> dict[str, float]:
    """Return the joints to hold, from the argument of `load_robot`."""
    if locked is None:
        return dict(sets.get("default", {}))
    if isinstance(locked, str):
        if locked == "all" and "all" not in sets:
            return nearest_positions(joints)
        if locked not in sets:
            known = ", ".join(dict.fromkeys([*sets, "all"]))
            raise ValueError(f"there is no set {locked!r}; expected one of {known}: use one, or add [locked.{locked}]")
        return dict(sets[locked])
    if isinstance(locked, Mapping):
        return {name: real(f"position of {name}", x, -LARGEST, LARGEST, "[rad or m]") for name, x in locked.items()}
    remedy = "expected the name of a set, joint names or positions by joint name"
    return dict.fromkeys(texts("locked", locked, remedy), 0.0)


# ---------------------------------------------------------------------------------------------- coupled joints


def resolve_couplings(
    joints: tuple[Joint, ...], locked: dict[str, float], mode: MimicMode, report: Report
) -> tuple[tuple[Joint, ...], dict[str, float]]:
    """Return joints whose Mimic names a leader that moves by itself, and the joints to hold with their positions.

    Chains lead to the joint at their end.  A follower of a joint that does not move is held, and with the mode "locked"
    every follower is, where its leader's position nearest to zero puts it; with "free" it moves by itself.  A locked
    joint ignores its coupling.  Raises ValueError on another mode; a chain that leads nowhere goes into the report.
    """
    if not isinstance(mode, str) or mode not in ("coupled", "free", "locked"):
        raise ValueError(f"mimic={mode!r}; expected 'coupled', 'free' or 'locked': use one of these")
    by_name = {joint.name: joint for joint in joints}
    held, resolved = dict(locked), []
    for joint in joints:
        mimic = None
        if _is_coupled(joint, by_name, locked, mode, report):
            leader = leader_of(joint, by_name, locked)
            still = leader.joint.type == "fixed" or leader.joint.name in locked or leader.multiplier == 0
            if mode == "locked" or still:
                held[joint.name] = _held_position(joint, leader, locked, report)
            else:
                head, k, offset = leader
                mimic = Mimic(head.name, k, offset)
                low, high = sorted(k * limit + offset for limit in (head.lower, head.upper))
                if low > joint.upper or high < joint.lower:
                    report.doubt(
                        f"joint {joint.name!r} follows joint {head.name!r}, whose limits put it between {low:.6g} and "
                        f"{high:.6g}, beyond its own {joint.lower:.6g} to {joint.upper:.6g}"
                    )
        resolved.append(replace(joint, mimic=mimic))
    return tuple(resolved), held


def _is_coupled(
    joint: Joint, by_name: Mapping[str, Joint], locked: Container[str], mode: MimicMode, report: Report
) -> bool:
    """Return whether a joint follows another; a chain that does not end in a joint is reported."""
    if joint.mimic is None or joint.type == "fixed" or joint.name in locked:
        return False
    if mode == "free":
        report.remark(f"joint {joint.name!r} moves by itself, not with joint {joint.mimic.joint!r}")
        return False
    path: list[str] = [joint.name]
    mimic: Mimic | None = joint.mimic
    while mimic is not None:
        if mimic.joint in path:
            loop = sorted(path[path.index(mimic.joint) :])
            text = f"joints {', '.join(map(repr, loop))} follow each other in a circle; remove one <mimic>"
            return _refuse(report, loop[0], text)
        if mimic.joint not in by_name:
            text = f"<mimic> names joint {mimic.joint!r}, which is not there; correct the name"
            return _refuse(report, path[-1], text)
        path.append(mimic.joint)
        mimic = by_name[mimic.joint].mimic
    return True


def _refuse(report: Report, joint: str, text: str) -> bool:
    report.refuse_at(f"joint {joint!r}", f"joint {joint!r}: {text}, or load with mimic='free'")
    return False


def _held_position(joint: Joint, leader: Leader, locked: Mapping[str, float], report: Report) -> float:
    """Compute where a follower is held [rad or m]: as its leader says, within its own limits."""
    head = leader.joint
    at = 0.0 if head.type == "fixed" else min(max(locked.get(head.name, 0.0), head.lower), head.upper)
    wanted = leader.multiplier * at + leader.offset
    position = min(max(wanted, joint.lower), joint.upper)
    text = f"joint {joint.name!r} is held at {position:.6g}, since it follows joint {head.name!r}"
    if position == wanted:
        report.remark(text)
    else:
        report.doubt(f"{text}, which asks for {wanted:.6g}, beyond its limits")
    return position
