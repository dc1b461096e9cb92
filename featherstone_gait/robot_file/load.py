"""Load a robot from its files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..base.arguments import instance, listed, real, texts, truth
from ..geometry.contact_choice import Choice, with_contacts
from ..model import LARGEST, Base, Joint, Model
from ..model.rest_posture import nearest_positions
from ..model.tree_checks import check_locked
from .collision import MeshFinder
from .coupling import MimicMode, resolve_couplings
from .markup import read_markup
from .mjcf.read import read_mjcf
from .report import Report, RobotFileError, blamed_on
from .robot import Robot
from .settings import Settings, read_settings
from .simtwo.read import read_simtwo
from .source import robot_path
from .urdf import read_urdf


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
) -> Model:
    """Load a robot by name, or from a URDF, an MJCF file or a scene of SimTwo.

    The .toml file of the same stem is read too, if it exists; its servos override those of the robot's file.  MJCF
    needs MuJoCo: ``pip install featherstone-gait[mjcf]``.  Keyframes of MJCF become `Model.keyframes`.

    A file that deviates from its format but has one meaning is read.  What changes the motion and cannot be represented
    in a `Model`, such as the joint springs of MJCF, is ignored.  `Model.notes` lists both, and one RobotFileWarning
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
    _check_arguments(name_or_path, strict, repair_inertia, package_dirs)
    path = robot_path(name_or_path)
    with blamed_on(path):
        markup = read_markup(path)
        report = Report(markup.lines, strict)
        for sentence in markup.doubts:
            report.doubt(sentence)
        meshes = MeshFinder(path, package_dirs)
        if markup.root.tag == "mujoco":
            robot = read_mjcf(path, base, report)
        elif markup.root.tag == "scene" or markup.root.find("solids") is not None:
            robot = read_simtwo(path, markup.root, base, report)
        else:
            robot = read_urdf(markup.root, path, meshes, report, repair_inertia)
    settings = _settings(path, robot, report)
    held = {**robot.held, **_held(path, robot, locked, settings, report)}
    joints, held = resolve_couplings(robot.joints, held, mimic, report)
    if base is None:
        base = settings.base or robot.base or "fixed"
    robot = robot._replace(joints=joints, base=base, held=held)
    model = _model(path, robot, settings, report, meshes.package_dirs)
    report.warn(path, stacklevel=2)
    choice = settings.choice if contacts is None else contacts
    if choice is None:
        return model
    with blamed_on(f"{path}: contacts={choice!r}"):
        return with_contacts(model, choice)


def _check_arguments(name_or_path: Any, strict: Any, repair_inertia: Any, package_dirs: Any) -> None:
    """Raise TypeError for arguments of other types; values are checked where they are used."""
    instance("name_or_path", name_or_path, (str, os.PathLike), "give a robot's name, or the path of its file")
    truth("strict", strict)
    truth("repair_inertia", repair_inertia)
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
            return read_settings(toml, robot.links, robot.joints)
    except RobotFileError:
        if not report.problems:
            raise
        return Settings()


def _held(path: Path, robot: Robot, locked: Any, settings: Settings, report: Report) -> dict[str, float]:
    """Return the joints to hold; raise RobotFileError if they cannot be held, unless the URDF is wrong."""
    if report.problems:
        return {}
    with blamed_on(f"{path}: load_robot(locked={locked!r})"):
        held = _chosen(locked, settings.locked, robot.joints)
        check_locked(robot.joints, held)
    return held


def _model(path: Path, robot: Robot, settings: Settings, report: Report, package_dirs: tuple[str, ...]) -> Model:
    """Make the model; report what is wrong with it."""
    armature, postures = settings.armature, {**robot.postures, **settings.postures}
    moving = [joint.name for joint in robot.joints if joint.type != "fixed" and joint.name not in robot.held]
    keyframes = {
        name: (*(at.base if robot.base == "floating" else ()), *(at.joints[joint] for joint in moving))
        for name, at in postures.items()
    }
    with report.blaming():
        model = Model(
            name=robot.name,
            links=robot.links,
            joints=tuple(replace(j, armature=armature[j.name]) if j.name in armature else j for j in robot.joints),
            base=robot.base or "fixed",
            locked=robot.held,
            servos={**robot.servos, **settings.servos},
            contacts=settings.contacts,
            shapes=robot.shapes,
            keyframes={**keyframes, **settings.keyframes},
            notes=report.notes(),
            source=str(path),
            supply=settings.supply,
            package_dirs=package_dirs,
        )
    report.raise_problems(path)
    return model


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
