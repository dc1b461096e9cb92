"""A robot from its files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ..model import Base, Joint, Model, check_locked
from .errors import blamed_on
from .robot import Robot
from .settings import Settings, read_settings
from .source import robot_path
from .urdf import read_urdf
from .xml_file import SUFFIXES, read_xml


def load_robot(
    name_or_path: str | os.PathLike,
    base: Base | None = None,
    locked: str | Mapping[str, float] | list[str] | tuple[str, ...] | None = None,
    *,
    strict: bool = False,
) -> Model:
    """Read a robot: a name of `robot_names()`, or the path of a .urdf, .mjcf or .xml file.

    The .toml of the same stem is read too, if it is there; its servos and contact points come before the file's own.

    Parameters
    ----------
    base : None is what the TOML says, else "floating" if the URDF has a floating joint, else "fixed"
    locked : joints to hold: the name of a set in the TOML, {joint: position [rad or m]}, or joint names (held at 0);
        None is the TOML's set "default", if it has one
    strict : refuse what changes the motion and has no place in a Model, as the springs of an MJCF file's joints;
        False passes it over, with a RobotFileWarning and a sentence in `Model.notes`

    MJCF takes MuJoCo: pip install featherstone-gait[mjcf].  Its keyframes become `Model.keyframes`.

    Raises RobotFileError (a ValueError) if a file is wrong, RobotFileNotFoundError if it is not there.
    """
    path = robot_path(name_or_path)
    with blamed_on(path):
        robot = read_xml(path, base, strict) if path.suffix in SUFFIXES else read_urdf(path)
    settings, toml = Settings(), path.with_suffix(".toml")
    if toml.exists():
        with blamed_on(toml):
            settings = read_settings(toml, robot.links, robot.joints)
    with blamed_on(f"{path}: load_robot(locked={locked!r})"):
        held = _chosen(locked, settings.locked)
        check_locked(robot.joints, held)
    taken: Base = next(b for b in (base, settings.base, robot.base, "fixed") if b is not None)
    with blamed_on(path):
        return Model(
            name=robot.name,
            links=robot.links,
            joints=_with_armature(robot.joints, settings.armature),
            base=taken,
            locked=held,
            servos={**robot.servos, **settings.servos},
            contacts=settings.contacts or robot.contacts,
            shapes=robot.shapes,
            keyframes={**_keyframes(robot, taken, held), **settings.keyframes},
            notes=robot.notes,
            source=str(path),
        )


def _with_armature(joints: tuple[Joint, ...], armature: Mapping[str, float]) -> tuple[Joint, ...]:
    """The joints, with the armature that the TOML gives to some."""
    return tuple(replace(j, armature=armature[j.name]) if j.name in armature else j for j in joints)


def _keyframes(robot: Robot, base: Base, held: Mapping[str, float]) -> dict[str, tuple[float, ...]]:
    """The file's postures as q (nq,)."""
    moving = [joint.name for joint in robot.joints if joint.type != "fixed" and joint.name not in held]
    return {
        name: (*(posture.base if base == "floating" else ()), *(posture.joints[joint] for joint in moving))
        for name, posture in robot.postures.items()
    }


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
