"""Load scenes of several models from MJCF and from TOML files that name robots and objects; save them as MJCF."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base.arguments import instance, truth
from ..base.files import complete
from ..base.rotation import rotation_from_rpy, rpy_from_rotation
from ..geometry.contact_choice import with_contacts
from ..model import Fluid, Ground, Link, Model
from ..model.numpy_dynamics import link_poses, zero_position
from ..model.placed import SEPARATOR, Placed, SceneModel, link_name
from .load import model_of, resolve_couplings
from .markup import Markup, read_markup
from .mjcf.scene import OBSTACLE, Part, read_scene
from .mjcf.tree import unused
from .mjcf.write_scene import scene_text
from .plausible import doubt_inertias
from .report import Report, blamed_on, refuse_losses, warn_losses
from .robot import with_rollers
from .save import MJCF
from .scene_toml import read_scene_toml, with_stated
from .settings import Settings
from .simtwo.read import file_of, is_simtwo, name_of, read_simtwo
from .simtwo.scene import read_rest, read_solids
from .simtwo.solids import AIR
from .source import scene_path


def load_scene(path: str | os.PathLike, *, strict: bool = False) -> SceneModel:
    """Load a scene by name, or one of several models from MJCF, TOML or SimTwo.

    Of MJCF each body of the world is a member if anything of it moves, else an obstacle, as are the geoms of the world;
    the first plane or height field is the ground.  Geoms that touch it make contact points.  MJCF needs MuJoCo:
    ``pip install featherstone-gait[mjcf]``.  A TOML file names robots' files and objects; `docs/scenes.md` lists its
    keys.  Of SimTwo robots, things and obstacles are read, on level ground, or the file of one robot.

    Parameters
    ----------
    path : str or path
        A name of `scene_names()`, or the path of an .xml, .mjcf or .toml file.
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
    path = scene_path(path)
    with blamed_on(path):
        if path.suffix == ".toml":
            return read_scene_toml(path, strict)
        markup = read_markup(path)
        if is_simtwo(markup.root):
            return _simtwo(path, markup, strict)
        if markup.root.tag != "mujoco":
            raise ValueError(
                f"is <{markup.root.tag}>; a scene is MJCF (<mujoco>), SimTwo (<scene>, or <robot> with <solids>) or "
                "TOML: load a robot with load_robot, or name its file in a TOML"
            )
        report = Report(markup.lines, strict)
        for sentence in markup.doubts:
            report.doubt(sentence)
        content = read_scene(path, report)
        members = tuple(_placed(path, part, _model(path, part, report)) for part in content.members)
        obstacles = tuple(_placed(path, part, _still(part, path)) for part in content.obstacles)
        report.raise_problems(path)
        links = [link_name(placed.name, link.name) for placed in members for link in placed.model.links]
        ground, fluid, sensors = with_stated(content.stated, content.ground, content.fluid, links)
        sensors = tuple({one.name: one for one in (*content.sensors, *sensors)}.values())
        scene = SceneModel(
            content.name, members, obstacles, ground, content.gravity, tuple(content.excluded), report.notes(),
            str(path), content.pairs, content.loops, fluid, sensors, content.frictions,
        )  # fmt: skip
    report.warn(path, stacklevel=2)
    return scene


def _simtwo(path: Path, markup: Markup, strict: bool) -> SceneModel:
    """Load the robots, things and obstacles of a scene of SimTwo, or one robot, on level ground."""
    members: list[Placed] = []
    whole, root = Report(markup.lines, strict), markup.root
    for sentence in markup.doubts:
        whole.doubt(sentence)
    for element in root.iterfind("robot") if root.tag == "scene" else (None,):
        if element is not None and not file_of(path, element).is_file():
            file = file_of(path, element).name
            where = f"{path.name}, line {markup.lines[element]}"
            whole.doubt(f"{where}: there is no file {file!r}: its robot is left out")
            continue
        report = Report(markup.lines, strict)
        name = (path.stem if element is None else name_of(element)).replace(SEPARATOR, "_")
        robot = read_simtwo(path, root, None, report, element, unused(name, [placed.name for placed in members]))
        x, y, z, *quaternion = robot.postures["scene"].base
        model = with_rollers(with_contacts(model_of(path, robot, Settings(), report, ()), "all"), robot.rollers)
        members.append(_placed(path, Part(robot, (x, y, z), tuple(quaternion), ()), model))
        report.warn(path, stacklevel=4)
    things, remarks = read_solids(path, markup, "things", strict)
    obstacles, more = read_solids(path, markup, "obstacles", strict)
    members += things
    still = [placed for placed in members if placed.model.base == "fixed" and not placed.model.moving_joints]
    if len(still) < len(members):
        members = [placed for placed in members if placed not in still]
        obstacles = [*(_unmoved(placed) for placed in still), *obstacles]
        for placed in still:
            if placed.model.sensors:
                whole.doubt(f"robot {placed.name!r} is an obstacle, as nothing of it moves: its sensors are left out")
    sensors = read_rest(path, root, whole) if root.tag == "scene" else ()
    if len(members) + len(obstacles) > 1:
        whole.remark('bodies touch the ground alone: give pairs="all" to compile_scene to let them touch as in SimTwo')
    whole.raise_problems(path)
    whole.warn(path, stacklevel=4)
    notes = (*whole.notes(), *remarks, *more)
    fluid = Fluid(AIR) if any(placed.model.immersed for placed in members) else None
    return SceneModel(
        path.stem, tuple(members), tuple(obstacles), Ground(), notes=notes, source=str(path), fluid=fluid,
        sensors=sensors,
    )  # fmt: skip


def _unmoved(placed: Placed) -> Placed:
    """Return a robot of which nothing moves as an obstacle of one link, with the shapes and their surfaces."""
    model, shapes = placed.model, []
    poses = link_poses(model, zero_position(model))
    for shape in model.shapes:
        k, surface = model.link_rows[shape.link], shape.surface
        E, r = poses.rotation[k], poses.position[k]
        if surface is not None:
            x, v, w = (tuple((E @ np.array(a)).tolist()) for a in (surface.center, surface.velocity, surface.turning))
            center = tuple((r + np.array(x)).tolist())
            surface = replace(surface, velocity=v, turning=w, center=center, drive=surface.drive or shape.link)
        xyz, rpy = tuple((r + E @ np.array(shape.xyz)).tolist()), rpy_from_rotation(E @ rotation_from_rpy(shape.rpy))
        shapes.append(replace(shape, link=OBSTACLE, xyz=xyz, rpy=rpy, surface=surface))
    still = Model(model.name, (Link(OBSTACLE),), (), shapes=tuple(shapes), notes=model.notes, source=model.source)
    return replace(placed, model=still)


def save_scene(scene: SceneModel, path: str | os.PathLike, *, strict: bool = False) -> None:
    """Save a scene as MJCF, which MuJoCo opens and `load_scene` reads back.

    Bodies and joints are named "name/link" and "name/joint".  In MuJoCo all shapes touch each other that are neither
    neighbors nor `excluded`, whatever `pairs` says, which is written for `load_scene` alone; those of links without
    contact points touch the ground if bodies touch each other at all.  MuJoCo takes the larger friction of two shapes,
    also where this package takes the geometric mean.  The ground gives way as under the heaviest member.  A fluid
    without a surface that acts on all bodies by MuJoCo's laws is MuJoCo's.  Contact points that are not those of a
    shape become small spheres and flat cylinders.  Every keyframe of a member becomes one of the scene, in which the
    others stand where they start, or as their keyframe of that name says.  What MJCF has no element for is in a <text>
    for `load_scene`, and one warning names what another program misses, as with `save_robot`.

    Parameters
    ----------
    scene : SceneModel
        The scene.
    path : str or path
        Path that ends in .xml or .mjcf; the file is written in full or not at all.
    strict : bool, optional
        Raise an error in place of the warning, and write nothing.

    Raises
    ------
    ValueError
        For another suffix, and for a model that MJCF cannot state.
    RobotFileError
        A ValueError that lists all that the file would lack, with `strict`.
    OSError
        If the file cannot be written.
    """
    instance("scene", scene, SceneModel, "give what load_scene returns, or SceneModel(name, members)")
    instance("path", path, (str, os.PathLike), "give the path of a file")
    path = Path(path)
    if path.suffix not in MJCF:
        raise ValueError(f"{path}: the file name must end in .xml or .mjcf; scenes are written as MJCF: rename it")
    truth("strict", strict)
    text, lost = scene_text(scene)
    if strict:
        refuse_losses(path, lost)
    with complete(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    warn_losses(path, lost, stacklevel=2)


def _model(path: Path, part: Part, report: Report) -> Model:
    """Make the model of a tree, with contact points of the shapes that touch the ground."""
    robot = part.robot
    joints, held = resolve_couplings(robot.joints, dict(robot.held), "coupled", report)
    excluded, included = (*robot.excluded, *robot.stated.excluded), (*robot.included, *robot.stated.included)
    stated = robot.stated._replace(excluded=(), included=())  # which may name shapes that do not touch the ground
    robot = robot._replace(joints=joints, held=held, shapes=part.touching, excluded=(), included=(), stated=stated)
    doubt_inertias(robot, report)
    model = model_of(path, robot, robot.stated, report, ())
    contacts = with_contacts(model, "all").contacts if part.touching else ()
    points, shapes = (*contacts, *model.contacts), part.robot.shapes
    return replace(model, contacts=points, shapes=shapes, notes=(), excluded=excluded, included=included)


def _still(part: Part, path: Path) -> Model:
    return Model(part.robot.name, (Link(OBSTACLE),), (), shapes=part.robot.shapes, source=str(path))


def _placed(path: Path, part: Part, model: Model) -> Placed:
    x, y, z = part.position
    a, b, c, d = part.orientation
    return Placed(model, part.robot.name, (x, y, z), (a, b, c, d))
