"""Show runs: as a page in a notebook or a file, or as a page that is served while the program runs."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base import arguments
from ..base.arguments import instance, real, shown, texts, truth
from ..base.files import FilePath
from ..base.rotation import rotation_from_quaternion, rpy_from_rotation
from ..model import FloorLine, Ground, Joint, Link, Model
from ..model.placed import Placed
from ..model.rest_posture import nearest_posture
from ..robot_file import load_robot, robot_names
from ..run.contacts import seen_from
from ..run.range_sensor import rays_of
from ..run.start import check_one
from ..run.status import Status
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from ..scene.contact import standing_height
from .live import Live, serve
from .page import Page, page_html
from .recorded import MESHES, Seen
from .style import in_notebook

OF_WORLD = "world/"  # no link of a robot in a scene has such a name
STILL = (
    "; without a run, `featherstone-gait view ROBOT` shows a robot at rest, as in Python does "
    'scene = compile_scene(robot); run = simulate(scene, 0.01, record=("q", "base_q")); show(run, scene)'
)
FEW = 3  # members that a title names
Robot = Model | CompiledScene | str | os.PathLike[str] | None


def show(
    trajectory: Trajectory,
    robot: Robot = None,
    *others: Trajectory,
    captions: Sequence[str] = (),
    plots: Sequence[str] = (),
    ghosts: bool = False,
    path: FilePath | None = None,
    mesh_limit: float = MESHES,
) -> Page:
    """Show a motion as a page to play: inline in a notebook, elsewhere as an HTML file that opens without network.

    Parameters
    ----------
    trajectory : Trajectory
        What `simulate` returns, with the channel q, and base_q of a floating base.
    robot : Model, CompiledScene, path or str, optional
        The model or scene that made the run (a scene knows its ground too), or the robot's file or name.  By default
        as the run says, which knows robots that come with the package.  A run of several robots and objects needs
        its scene, and all are drawn in one picture.
    *others : Trajectory
        More runs of the robot, beside the first or, with `ghosts`, seen through it.
    captions : list of str
        A text for each run.
    plots : list of str
        Channels to draw under the picture; the page offers the others too.
    ghosts : bool
        Draw all runs in one picture.
    path : path, optional
        Of the file; by default ROBOT_view.html in the current folder, and none in a notebook.
    mesh_limit : float
        Size that the robots' full meshes may have in the page [MB].  Larger ones are simplified, and the page says so.
        0: the page has only what a browser without WebGL draws, some 8000 triangles.

    Returns
    -------
    Page

    Raises
    ------
    ValueError
        Robot and run do not fit, channels are missing, captions are not one for each run, or a scene of several robots
        comes with captions, ghosts or others.
    """
    together, seen = one_or_many([trajectory, *others], robot, captions, plots, ghosts)
    mesh_limit = real("mesh_limit", mesh_limit, 0.0, 1e3, "[MB]")
    page = Page(page_html(*seen, truth("ghosts", ghosts), together, mesh_limit))
    if path is not None:
        page.save(arguments.path("path", path))
    elif not in_notebook():
        page.save(re.sub(r"[^\w.-]+", "_", str(trajectory.info.get("robot", "robot"))) + "_view.html")
    return page


def show_live(
    trajectory: Trajectory,
    robot: Robot = None,
    *others: Trajectory,
    captions: Sequence[str] = (),
    plots: Sequence[str] = (),
    ghosts: bool = False,
    port: int = 8080,
) -> Live:
    """Show a motion in a page that is served while the program runs, with the full detail of the robot's meshes.

    Parameters
    ----------
    trajectory, robot, *others, captions, plots, ghosts
        As in `show`; plots are drawn in a panel beside the picture.
    port : int
        Port of this machine, or the first free one after it; 0 for any.

    Returns
    -------
    Live

    Raises
    ------
    ValueError
        As in `show`.
    ImportError
        Without viser (pip install featherstone-gait[viser]).
    """
    together, seen = one_or_many([trajectory, *others], robot, captions, plots, ghosts)
    return serve(*seen, ghosts=ghosts, together=together, port=port)


def one_or_many(
    runs: Sequence[Trajectory], robot: Robot, captions: Sequence[str], plots: Sequence[str], ghosts: bool
) -> tuple[bool, tuple[dict[str, Seen], str, list[str]]]:
    """Return whether members of one scene are drawn together, and the runs by caption, the title and the plots."""
    together = isinstance(robot, CompiledScene) and bool(robot.members)
    if together and (captions or truth("ghosts", ghosts)):
        raise ValueError("captions, ghosts: members of a scene are drawn under their names; leave out both")
    return together, _company(runs, robot, plots) if together else _seen(runs, robot, captions, plots)


def _check_run(run: Any) -> None:
    remedy = f"give what simulate returns{STILL * isinstance(run, Model | CompiledScene)}"
    instance("trajectory", run, Trajectory, remedy)


def _seen(
    runs: Sequence[Trajectory], robot: Robot, captions: Sequence[str], plots: Sequence[str]
) -> tuple[dict[str, Seen], str, list[str]]:
    """Find robot and ground of each run, by its caption, the page's title, and plots where none are given."""
    for run in runs:
        _check_run(run)
    names = [str(run.info.get("robot", "run")) + (f" {k + 1}" if k else "") for k, run in enumerate(runs)]
    captions = texts("captions", captions, "give a text for each run") or names
    if len(captions) != len(runs) or len(set(captions)) != len(captions):
        raise ValueError(f"captions are {shown(captions)}; expected {len(runs)} texts that differ, one for each run")
    found: dict[str, tuple[Model, Ground | None]] = {}
    seen = {}
    for caption, run in zip(captions, runs):
        key = repr([run.info.get(name) for name in ("source", "robot", "locked", "joints", "ground")])
        if key not in found:
            found[key] = robot_of(run, robot)
        seen[caption] = Seen(found[key][0], run, found[key][1])
        if isinstance(robot, CompiledScene):
            seen[caption] = replace(seen[caption], level=_level(robot), rays=rays_of(robot, run))
    title = runs[0].info.get("start") if len(runs) == 1 else None
    usual = [name for name in ("contact_force", "torque", "q") if name in runs[0] and runs[0][name].size]
    channels = texts("plots", plots, "give a list of channels") or usual[: int(len(runs[0]["time"]) > 1)]
    return seen, title or seen[captions[0]].model.name, channels


def _company(runs: Sequence[Trajectory], scene: Any, plots: Sequence[str]) -> tuple[dict[str, Seen], str, list[str]]:
    """Return the run of each member by its name, and the obstacles, as `_seen` does for runs of one robot."""
    run, *others = runs
    _check_run(run)
    if others:
        raise ValueError("others: runs of several robots are shown one by one; give one run and its scene")
    return company_of(run, scene), title_of(scene), texts("plots", plots, "give a list of channels")


def title_of(scene: CompiledScene) -> str:
    """Return the name of a robot, or of a few members of a scene."""
    count = len(scene.members)
    return scene.model.name if count <= FEW else f"{scene.members[0].name} and {count - 1} more"


def company_of(run: Trajectory, scene: CompiledScene) -> dict[str, Seen]:
    """Return the run of each member by its name, and the obstacles; the first has the rays of all sensors."""
    seen = {}
    rays: np.ndarray | None = rays_of(scene, run)
    for member in scene.members:
        fixed = member.model.base == "fixed"
        own = run.of(member.name)
        channels, pairs = seen_from(run, member.name)
        own = replace(own, channels=own.channels | channels, info=own.info | {"pairs": pairs})
        model = at_its_place(member.placed) if fixed else member.model
        seen[member.name] = Seen(model, own, scene.ground, _level(scene), rays)
        rays = None
    times = {"time": run["time"], "q": np.zeros((len(run["time"]), 0))}
    for placed in scene.obstacles:
        still = Trajectory(times, Status.OK, "", float(run["time"][-1]), np.zeros(0), {"robot": placed.name})
        seen[placed.name] = Seen(at_its_place(placed), still, scene.ground)
    return seen


def _level(scene: CompiledScene) -> float | None:
    """Return the height of the surface of a scene's fluid [m]."""
    return None if scene.options.fluid is None else scene.options.fluid.level


def at_its_place(placed: Placed) -> Model:
    """Return a model with a fixed base whose root link is at its place in a world of its own."""
    xyz: Any = (*placed.position, 0.0)[:3]
    rpy = rpy_from_rotation(rotation_from_quaternion(placed.orientation))
    place = Joint(f"{OF_WORLD}place", "fixed", OF_WORLD, placed.model.root, xyz=xyz, rpy=rpy)
    links, joints = (Link(OF_WORLD), *placed.model.links), (place, *placed.model.joints)
    return replace(placed.model, links=links, joints=joints, base="fixed")


def in_posture(model: Model, keyframe: str | None = None) -> Trajectory:
    """Make a run of one sample: a robot at rest, in a posture of its file or the one nearest to zero."""
    if keyframe is None:
        q = nearest_posture(model)
        if model.base == "floating" and model.contacts:
            q[2] = standing_height(model, Ground(), q)
    elif keyframe in model.keyframes:
        q = np.array(model.keyframes[keyframe])
    else:
        known = ", ".join(model.keyframes) or "none"
        raise ValueError(f"{model.name}: there is no keyframe {shown(keyframe)}; its keyframes: {known}")
    channels = {"time": np.zeros(1), "q": q[None, model.base_positions :]}
    channels |= {"base_q": q[None, :7]} if model.base == "floating" else {}
    text = f"{model.name}, {keyframe or 'the posture nearest to zero'}"
    info = {"robot": model.name, "joints": list(model.joint_names), "start": text}
    info["joint_types"] = [joint.type for joint in model.moving_joints]
    return Trajectory(channels, Status.OK, "", 0.0, np.zeros(0), info)


def robot_of(trajectory: Trajectory, robot: Robot = None) -> tuple[Model, Ground | None]:
    """Find robot and ground of a run.

    If no robot is given, it is the one of the file or name that the run's info has; commands store the file, other runs
    the name, which only leads to robots of the package.  Raises ValueError if no robot is found or its joints differ.
    """
    if isinstance(robot, CompiledScene):
        check_one(robot, "this picture")
        model, ground = robot.model, robot.ground
    else:
        if "members" in trajectory.info:
            names = list(trajectory.info["members"])
            raise ValueError(
                f"the run is of several robots and objects, {', '.join(names)}; give the scene that made it, "
                f"show(run, scene), or the run of one of them, run[{names[0]!r}]"
            )
        model = robot if isinstance(robot, Model) else _loaded(trajectory.info, robot, "base_q" in trajectory)
        ground = _ground(trajectory.info, model)
    joints = trajectory.info.get("joints")
    if joints is not None and list(joints) != list(model.joint_names):
        raise ValueError(
            f"the run has the joints {shown(joints)}, the robot {model.name} has {shown(list(model.joint_names))}; "
            "give the model or the scene that made the run"
        )
    return model, ground


def _loaded(info: Mapping[str, Any], robot: Any, floating: bool) -> Model:
    named: Any = robot if robot is not None else info.get("source") or info.get("robot")
    if robot is None and (named is None or not (Path(named).is_file() or named in robot_names())):
        named = info.get("robot")
        if named not in robot_names():
            raise ValueError(
                f"the run is of the robot {shown(named)}, which does not come with the package; give its model, its "
                "scene or its file: show(run, model), or --robot FILE"
            )
    instance("robot", named, (str, os.PathLike), "give a Model, a scene, the name of a robot or its file")
    base: Any = "floating" if floating else "fixed"
    locked, contacts = info.get("locked"), info.get("contacts")
    model = load_robot(named, base=base, locked=locked, contacts=contacts)
    missing = [name for name in model.joint_names if name not in info.get("joints", model.joint_names)]
    if missing and locked is None:  # a run of fewer joints: the others were held
        return load_robot(named, base=base, contacts=contacts, locked=dict(model.locked) | dict.fromkeys(missing, 0.0))
    return model


def _ground(info: Mapping[str, Any], model: Model) -> Ground | None:
    """Find the ground in a run's info; else a level floor under a robot that can stand on it."""
    if "ground" not in info:
        return Ground() if model.base == "floating" and model.contacts else None
    stored = info["ground"]
    if stored is None:
        return None
    known = {f.name for f in fields(Ground)} - {"field"}
    lines = [FloorLine(**line) for line in stored.get("lines", ())]
    return Ground(**{name: value for name, value in stored.items() if name in known} | {"lines": lines})
