"""`Trajectory.show`: a page of a run, in a notebook or as a file."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.arguments import instance, listed, shown
from ..base.files import FilePath, complete
from ..model import Ground, Model
from ..model.rest_posture import nearest_posture
from ..scene.compile import CompiledScene
from .animation import page_html
from .recorded import Seen

if TYPE_CHECKING:
    from ..run.trajectory import Trajectory
    from .live import Live

HEIGHT = 620  # of a page in a notebook [pixel]

Robot = Model | CompiledScene | str | os.PathLike[str] | None


class Page:
    """An HTML page.  A notebook shows it; `save` writes it to a file, which opens without network."""

    def __init__(self, html: str, path: Path | None = None) -> None:
        self.html, self.path = html, path

    def __repr__(self) -> str:
        where = "not saved" if self.path is None else str(self.path)
        return f"<page of {len(self.html.encode()) / 1e6:.2g} MB, {where}>"

    def _repr_html_(self) -> str:
        return (
            f'<iframe title="motion" srcdoc="{escape(self.html)}" '
            f'style="width:100%;height:{HEIGHT}px;border:0" allow="fullscreen"></iframe>'
        )

    def save(self, path: FilePath) -> Path:
        """Write the page, whole or not at all, and return its path.  Raises OSError."""
        with complete(path) as temporary:
            temporary.write_text(self.html, encoding="utf-8")
        self.path = Path(path)
        return self.path


def show(
    trajectory: Trajectory,
    robot: Robot = None,
    *others: Trajectory,
    captions: Sequence[str] = (),
    plots: Sequence[str] = (),
    ghosts: bool = False,
    path: FilePath | None = None,
) -> Page:
    """See `Trajectory.show`."""
    runs = [trajectory, *others]
    named = listed("captions", captions, "give a text for each run") or [_caption(run, k) for k, run in enumerate(runs)]
    channels = listed("plots", plots, "give a list of channels") or default_plots(trajectory)
    page = page_of(runs, robot, named, channels, ghosts)
    if path is not None or not in_notebook():
        name = re.sub(r"[^\w.-]+", "_", str(trajectory.info.get("robot", "robot")))
        page.save(f"{name}_view.html" if path is None else path)
    return page


def page_of(
    runs: Sequence[Trajectory], robot: Robot, captions: Sequence[str], plots: Sequence[str], ghosts: bool = False
) -> Page:
    """The page of some runs.  Raises ValueError as `Trajectory.show`."""
    seen, title = _seen(runs, robot, captions)
    return Page(page_html(seen, title, plots, ghosts))


def show_live(
    trajectory: Trajectory,
    robot: Robot = None,
    *others: Trajectory,
    captions: Sequence[str] = (),
    plots: Sequence[str] = (),
    ghosts: bool = False,
    port: int = 8080,
) -> Live:
    """See `Trajectory.show_live`."""
    runs = [trajectory, *others]
    named = listed("captions", captions, "give a text for each run") or [_caption(run, k) for k, run in enumerate(runs)]
    channels = listed("plots", plots, "give a list of channels") or default_plots(trajectory)
    return live_of(runs, robot, named, channels, ghosts, port)


def live_of(
    runs: Sequence[Trajectory],
    robot: Robot,
    captions: Sequence[str],
    plots: Sequence[str],
    ghosts: bool = False,
    port: int = 8080,
) -> Live:
    """The live page of some runs.  Raises as `Trajectory.show_live`."""
    from .live import serve

    seen, title = _seen(runs, robot, captions)
    return serve(seen, title, ghosts, port, plots)


def _seen(runs: Sequence[Trajectory], robot: Robot, captions: Sequence[str]) -> tuple[dict[str, Seen], str]:
    """Runs by their captions with robots and ground, and a title."""
    if len(captions) != len(runs) or len(set(captions)) != len(captions):
        raise ValueError(f"captions are {shown(captions)}; expected {len(runs)} texts that differ, one for each run")
    found: dict[str, tuple[Model, Ground | None]] = {}
    seen = {}
    for caption, run in zip(captions, runs):
        key = repr([run.info.get(name) for name in ("source", "robot", "locked", "joints", "ground")])
        if key not in found:
            found[key] = robot_of(run, robot)
        seen[caption] = Seen(found[key][0], run, found[key][1])
    first = seen[captions[0]].model.name
    title = runs[0].info.get("start") if len(runs) == 1 else None
    return seen, title or first


def in_posture(model: Model, keyframe: str | None = None) -> Trajectory:
    """A robot at rest, as a run of one sample: a posture of its file, or the one nearest to zero, on level ground."""
    from ..run.trajectory import Trajectory
    from ..scene.contact import standing_height

    if keyframe is None:
        q = nearest_posture(model)
        if model.base == "floating" and model.contacts:
            q[2] = standing_height(model, Ground(), q)
    elif keyframe in model.keyframes:
        q = np.array(model.keyframes[keyframe])
    else:
        known = ", ".join(model.keyframes) or "none"
        raise ValueError(f"{model.name}: there is no keyframe {shown(keyframe)}; its keyframes: {known}")
    channels = {"time": np.zeros(1), "q": q[None, model.nq - len(model.joint_names) :]}
    channels |= {"base_q": q[None, :7]} if model.base == "floating" else {}
    text = f"{model.name}, {keyframe or 'the posture nearest to zero'}"
    info = {"robot": model.name, "joints": list(model.joint_names), "start": text}
    return Trajectory(channels, "ok", "", 0.0, np.zeros(0), info)


def default_plots(trajectory: Trajectory) -> list[str]:
    """The one channel that tells most of those that were recorded, of a run of some length."""
    if len(trajectory["time"]) < 2:
        return []
    telling = ("contact_force", "torque", "q")
    return next(([name] for name in telling if name in trajectory and trajectory[name].size), [])


def in_notebook() -> bool:
    """Whether what is returned to the user is shown as HTML."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and "kernel" in type(shell).__module__


def robot_of(trajectory: Trajectory, robot: Robot = None) -> tuple[Model, Ground | None]:
    """Robot and ground of a run: as given, or as the run tells.

    None asks the run, which knows the file that its robot was read from if a command made it, and else its name: that
    of a robot that comes with the package.  Raises ValueError where that leads nowhere or the joints are others.
    """
    if isinstance(robot, CompiledScene):
        model, ground = robot.model, robot.ground
    else:
        model = robot if isinstance(robot, Model) else _loaded(trajectory.info, robot, "base_q" in trajectory)
        ground = _ground(trajectory.info, model)
    joints = trajectory.info.get("joints")
    if joints is not None and list(joints) != list(model.joint_names):
        raise ValueError(
            f"the run has the joints {shown(joints)}, the robot {model.name} has {shown(list(model.joint_names))}; "
            "give the model or the scene that made the run"
        )
    return model, ground


def _caption(run: Trajectory, k: int) -> str:
    return str(run.info.get("robot", "run")) + (f" {k + 1}" if k else "")


def _loaded(info: Mapping[str, Any], robot: Any, floating: bool) -> Model:
    from ..robot_file import load_robot, robot_names

    named: Any = robot if robot is not None else info.get("source") or info.get("robot")
    if robot is None and (named is None or not (Path(named).is_file() or named in robot_names())):
        named = info.get("robot")
        if named not in robot_names():
            raise ValueError(
                f"the run is of the robot {shown(named)}, which does not come with the package; give its model, its "
                "scene or its file: show(model), or --robot FILE"
            )
    instance("robot", named, (str, os.PathLike), "give a Model, a scene, the name of a robot or its file")
    base: Any = "floating" if floating else "fixed"
    locked = info.get("locked")
    model = load_robot(named, base=base, locked=locked)
    missing = [name for name in model.joint_names if name not in info.get("joints", model.joint_names)]
    if missing and locked is None:  # a run of fewer joints: the others were held
        return load_robot(named, base=base, locked=dict(model.locked) | dict.fromkeys(missing, 0.0))
    return model


def _ground(info: Mapping[str, Any], model: Model) -> Ground | None:
    """As the run tells; else a level floor under a robot that can stand on it."""
    if "ground" not in info:
        return Ground() if model.base == "floating" and model.contacts else None
    told = info["ground"]
    if told is None:
        return None
    known = {f.name for f in fields(Ground)} - {"field"}
    return Ground(**{name: value for name, value in told.items() if name in known})
