"""A robot from its files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..model import Base, Model, check_locked
from .collision import MeshFinder
from .coupling import MimicMode, resolve_couplings
from .errors import RobotFileError, blamed_on
from .markup import read_markup
from .report import Report
from .settings import Settings, read_settings
from .source import urdf_path
from .urdf import Robot, read_urdf


def load_robot(
    name_or_path: str | os.PathLike,
    base: Base | None = None,
    locked: str | Mapping[str, float] | list[str] | tuple[str, ...] | None = None,
    *,
    strict: bool = False,
    mimic: MimicMode = "coupled",
    repair_inertia: bool = False,
    package_dirs: Sequence[str | os.PathLike] = (),
) -> Model:
    """Read a robot: a name of `robot_names()`, or the path of a .urdf file, with the .toml of the same stem if there.

    A URDF that is not as it should be is read if it has one meaning: `Model.notes` and one RobotFileWarning tell which.

    Parameters
    ----------
    base : None is what the TOML says, else "floating" if the URDF has a floating joint, else "fixed"
    locked : joints to hold: the name of a set in the TOML, {joint: position [rad or m]}, or joint names (held at 0);
        None is the TOML's set "default", if it has one
    strict : refuse what would be warned about
    mimic : joints that follow others: "coupled", "free" (they move by themselves) or "locked" (held where the leader's
        position nearest to zero puts them)
    repair_inertia : make inertias possible that no body can have, as MuJoCo's `boundinertia` and `balanceinertia` do:
        principal moments below zero are raised to 1e-9 of the largest; where then one is above the sum of the other
        two, all become their mean
    package_dirs : folders in which, besides those above the URDF and those of ROS_PACKAGE_PATH, the package of a mesh
        `package://PACKAGE/...` is looked for

    Raises RobotFileError (a ValueError), which lists all that is wrong with a file, or RobotFileNotFoundError.
    """
    path = urdf_path(name_or_path)
    with blamed_on(path):
        markup = read_markup(path)
        report = Report(markup.lines, strict)
        robot = read_urdf(markup.root, path, MeshFinder(path, package_dirs), report, repair_inertia)
    settings = _settings(path, robot, report)
    held = robot.held | _held(path, robot, locked, settings, report)
    model = _model(path, robot, settings, base, resolve_couplings(robot.joints, held, mimic, report), report)
    report.warn(path, stacklevel=2)
    return model


def _settings(path: Path, robot: Robot, report: Report) -> Settings:
    """What the TOML says.  Raises RobotFileError if it is wrong, unless the URDF is."""
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
    """The joints to hold.  Raises RobotFileError if they cannot be, unless the URDF is wrong."""
    if report.problems:
        return {}
    with blamed_on(f"{path}: load_robot(locked={locked!r})"):
        held = _chosen(locked, settings.locked)
        check_locked(robot.joints, held)
    return held


def _model(path: Path, robot: Robot, settings: Settings, base: Base | None, moving: tuple, report: Report) -> Model:
    """The robot.  What is wrong with it is reported; nobody gets to see what is returned then."""
    joints, held = moving
    model = None
    with report.blaming():
        model = Model(
            name=robot.name,
            links=robot.links,
            joints=joints,
            base=next(b for b in (base, settings.base, robot.base, "fixed") if b is not None),
            locked=held,
            servos=dict(settings.servos),
            contacts=settings.contacts,
            shapes=robot.shapes,
            notes=report.notes(),
            source=str(path),
        )
    report.raise_problems(path)
    assert model is not None
    return model


def _chosen(locked: Any, sets: Mapping[str, dict[str, float]]) -> dict[str, float]:
    """The joints to hold, from the argument of `load_robot`."""
    if locked is None:
        return dict(sets.get("default", {}))
    if isinstance(locked, str):
        if locked not in sets:
            known = ", ".join(sets) or "none"
            raise ValueError(f"there is no set {locked!r}; expected one of {known}: use one, or add [locked.{locked}]")
        return dict(sets[locked])
    if isinstance(locked, Mapping):
        return {name: float(position) for name, position in locked.items()}
    return dict.fromkeys(locked, 0.0)
