"""Load scenes of several models: MJCF files with all that is in them, and TOML files that name robots and objects."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from ..base.arguments import instance, truth
from ..geometry.contact_choice import with_contacts
from ..model import Link, Model
from ..model.placed import Placed, SceneModel
from .load import model_of, resolve_couplings
from .markup import read_markup
from .mjcf.scene import OBSTACLE, Part, read_scene
from .plausible import doubt_inertias
from .report import Report, blamed_on
from .scene_toml import read_scene_toml
from .settings import Settings


def load_scene(path: str | os.PathLike, *, strict: bool = False) -> SceneModel:
    """Load a scene of several models from MJCF or TOML.

    Of MJCF each body of the world is a member if anything of it moves, else an obstacle, as are the geoms of the world;
    the first plane or height field is the ground.  Geoms that touch it make contact points.  MJCF needs MuJoCo:
    ``pip install featherstone-gait[mjcf]``.  A TOML file names robots' files and objects; `docs/scenes.md` lists its
    keys.

    Parameters
    ----------
    path : str or path
        Path of an .xml, .mjcf or .toml file.
    strict : bool, optional
        Raise an error in place of the warning about what is ignored.

    Returns
    -------
    SceneModel
        What is in the scene.

    Raises
    ------
    RobotFileError
        A ValueError that lists all that is wrong with the file.
    RobotFileNotFoundError
        If the file does not exist.
    ImportError
        For MJCF without MuJoCo.
    """
    instance("path", path, (str, os.PathLike), "give the path of an .xml, .mjcf or .toml file")
    truth("strict", strict)
    path = Path(path)
    with blamed_on(path):
        if path.suffix == ".toml":
            return read_scene_toml(path, strict)
        markup = read_markup(path)
        if markup.root.tag != "mujoco":
            raise ValueError(
                f"is <{markup.root.tag}>; a scene is MJCF (<mujoco>) or TOML: load a robot with load_robot, or name "
                "its file in a TOML"
            )
        report = Report(markup.lines, strict)
        for sentence in markup.doubts:
            report.doubt(sentence)
        content = read_scene(path, report)
        members = tuple(_placed(path, part, _model(path, part, report)) for part in content.members)
        obstacles = tuple(_placed(path, part, _still(part, path)) for part in content.obstacles)
        report.raise_problems(path)
        scene = SceneModel(
            content.name, members, obstacles, content.ground, content.gravity, tuple(content.excluded),
            report.notes(), str(path),
        )  # fmt: skip
    report.warn(path, stacklevel=2)
    return scene


def _model(path: Path, part: Part, report: Report) -> Model:
    """Make the model of a tree, with contact points of the shapes that touch the ground."""
    robot = part.robot
    joints, held = resolve_couplings(robot.joints, dict(robot.held), "coupled", report)
    robot = robot._replace(joints=joints, held=held, shapes=part.touching)
    doubt_inertias(robot, report)
    model = model_of(path, robot, Settings(), report, ())
    contacts = with_contacts(model, "all").contacts if part.touching else ()
    return replace(model, contacts=contacts, shapes=part.robot.shapes, notes=())


def _still(part: Part, path: Path) -> Model:
    return Model(part.robot.name, (Link(OBSTACLE),), (), shapes=part.robot.shapes, source=str(path))


def _placed(path: Path, part: Part, model: Model) -> Placed:
    x, y, z = part.position
    a, b, c, d = part.orientation
    return Placed(model, part.robot.name, (x, y, z), (a, b, c, d))
