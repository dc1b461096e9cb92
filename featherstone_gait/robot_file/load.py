"""A robot from its files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

from ..contact_choice import Choice, with_contacts
from ..model import Base, Joint, Model, check_locked
from ..rest import nearest_positions
from .errors import blamed_on
from .settings import Settings, read_settings
from .source import urdf_path
from .urdf import read_urdf


def load_robot(
    name_or_path: str | os.PathLike,
    base: Base | None = None,
    locked: str | Mapping[str, float] | list[str] | tuple[str, ...] | None = None,
    *,
    contacts: Choice | None = None,
) -> Model:
    """Read a robot: a name of `robot_names()`, or the path of a .urdf file, with the .toml of the same stem if there.

    Parameters
    ----------
    base : None is what the TOML says, else "floating" if the URDF has a floating joint, else "fixed"
    locked : joints to hold: the name of a set in the TOML, {joint: position [rad or m]}, or joint names (held at 0);
        None is the TOML's set "default", if it has one, and "all" holds all joints in the admissible posture nearest
        to zero, unless the TOML has a set of that name
    contacts : what touches the ground: None is what the TOML says, if anything; "feet", "all" or names of links take
        the collision shapes of these (`with_contacts` says how)

    Raises RobotFileError (a ValueError) if a file is wrong, RobotFileNotFoundError if it is not there.
    """
    path = urdf_path(name_or_path)
    with blamed_on(path):
        robot = read_urdf(path)
    settings, toml = Settings(), path.with_suffix(".toml")
    if toml.exists():
        with blamed_on(toml):
            settings = read_settings(toml, robot.links, robot.joints)
    with blamed_on(f"{path}: load_robot(locked={locked!r})"):
        held = _chosen(locked, settings.locked, robot.joints)
        check_locked(robot.joints, held)
    with blamed_on(path):
        model = Model(
            name=robot.name,
            links=robot.links,
            joints=robot.joints,
            base=next(b for b in (base, settings.base, robot.base, "fixed") if b is not None),
            locked=held,
            servos=dict(settings.servos),
            contacts=settings.contacts,
            notes=robot.notes,
            source=str(path),
        )
    return _touching(model, settings.choice if contacts is None else contacts)


def _touching(model: Model, choice: Choice | None) -> Model:
    """The robot with the contact points chosen, if any are."""
    if choice is None:
        return model
    with blamed_on(f"{model.source}: contacts={choice!r}"):
        return with_contacts(model, choice)


def _chosen(locked: Any, sets: Mapping[str, dict[str, float]], joints: Iterable[Joint]) -> dict[str, float]:
    """The joints to hold, from the argument of `load_robot`."""
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
        return {name: float(position) for name, position in locked.items()}
    return dict.fromkeys(locked, 0.0)
