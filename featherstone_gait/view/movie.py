"""Draw robots with Matplotlib: motions as GIF, MP4, WebM or PNG files, and single postures as arrays of pixels."""

from __future__ import annotations

import math
import shutil
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..base import arguments
from ..base.arguments import instance, listed, real, shown, whole
from ..base.files import FilePath, complete
from ..dynamics import forward_kinematics
from ..model import Ground, Model
from ..run.trajectory import Trajectory, positions
from ..scene.compile import CompiledScene
from .shown import Robot, company_of, robot_of
from .visuals import bodies, round_up

MOST_FRAMES = 3000
DOTS = 100  # per inch
SIZE = 640, 480  # [pixel]
EYE = 17.0, -63.0  # elevation and azimuth [deg], as in page.js
FOCAL, ZOOM = 0.45, 1.65  # distance of the eye and size of the picture, as Matplotlib measures them
SKY, GROUND, SQUARE, BAD = "#e6eef6", "#f1f0eb", "#dedcd3", "#a3160f"
VIDEOS = (".mp4", ".webm")
ENDINGS = (".gif", *VIDEOS)
NO_FFMPEG = "MP4 and WebM need ffmpeg: pip install featherstone-gait[movie], or install ffmpeg itself; a .gif does not"


def save_movie(
    trajectory: Trajectory,
    path: FilePath,
    robot: Robot = None,
    *,
    fps: float = 25.0,
    speed: float = 1.0,
    size: tuple[int, int] = SIZE,
) -> int:
    """Draw a motion with Matplotlib, as a GIF, MP4 or WebM, or as PNG files.

    Parameters
    ----------
    trajectory : Trajectory
        What `simulate` returns, with the channel q, and base_q of a floating base.
    path : path
        Of the .gif, .mp4 or .webm, or of a folder for PNG files.
    robot : Model, CompiledScene, path or str, optional
        As in `show`; all members of a scene are drawn.
    fps : float
        Frames per second; at most 50, which is the most that a GIF shows.
    speed : float
        Playing speed; 0.1 is slow motion.
    size : tuple of int
        Width and height [pixel]; MP4 and WebM round them down to even numbers.

    Returns
    -------
    int
        Number of frames.

    Raises
    ------
    ValueError
        As in `show`, and for more frames or pixels than a file should have.
    ImportError
        MP4 or WebM without ffmpeg (pip install featherstone-gait[movie]).
    OSError
        The file cannot be written, or ffmpeg lacks the encoder.
    """
    instance("trajectory", trajectory, Trajectory, "give what simulate returns")
    fps = real("fps", fps, 0.1, 50.0, "a GIF shows at most 50 frames a second")
    speed = real("speed", speed, 1e-4, 100.0, "1 is real time")
    target, remedy = arguments.path("path", path), "give width and height [pixel]"
    pixels = [whole("size", x, 64, remedy, 4000) for x in listed("size", size, remedy)]
    if len(pixels) != 2:
        raise ValueError(f"size is {shown(size)}; {remedy}")
    ending = target.suffix.lower()
    if ending and ending not in ENDINGS:
        kinds = ", ".join(ENDINGS)
        raise ValueError(f"{target}: expected a name that ends in {kinds}, or a folder for PNG files: use these")
    models, motions, ground = _actors(trajectory, robot)
    times = _times(trajectory, fps, speed)
    rows = np.searchsorted(trajectory["time"], times + 1e-9, side="right") - 1  # of the last samples before
    rows = np.clip(rows, 0, len(trajectory["time"]) - 1)
    q = np.hstack([motion[rows] for motion in motions])
    even = [x - x % 2 for x in pixels] if ending in VIDEOS else pixels
    picture = Picture(models, q, None if ground is None else ground.height, even)
    frames = _drawn(picture, trajectory, q, times)
    if ending:
        with complete(target) as temporary, _writing(temporary, fps, picture.figure) as writer:
            for _ in frames:
                writer.grab_frame()
    else:
        target.mkdir(parents=True, exist_ok=True)
        for k, _ in enumerate(frames):
            with complete(target / f"frame_{k:04d}.png") as temporary:
                picture.figure.savefig(temporary, dpi=DOTS)
    return len(times)


def _actors(trajectory: Trajectory, robot: Robot) -> tuple[list[Model], list[np.ndarray], Ground | None]:
    """Return the models to draw, their positions (samples, nq), and the ground."""
    if isinstance(robot, CompiledScene) and robot.members:
        seen = company_of(trajectory, robot).values()
        models = [one.model for one in seen]
        return models, [positions(one.trajectory, one.model) for one in seen], robot.ground
    model, ground = robot_of(trajectory, robot)
    return [model], [positions(trajectory, model)], ground


@contextmanager
def _writing(path: Path, fps: float, figure: Any) -> Iterator[Any]:
    """Yield Matplotlib's writer of a movie.  Raises ImportError without ffmpeg, and OSError where it fails."""
    from matplotlib import rc_context
    from matplotlib.animation import FFMpegWriter, PillowWriter

    ending = path.suffix.lower()
    if ending not in VIDEOS:
        with PillowWriter(fps=fps).saving(figure, str(path), dpi=DOTS) as writer:  # type: ignore[arg-type]
            yield writer
        return
    options = ["-f", ending[1:], "-pix_fmt", "yuv420p"]  # the colors that browsers and players show
    with rc_context({"animation.ffmpeg_path": _ffmpeg()}):
        movie = FFMpegWriter(fps=fps, codec="h264", extra_args=options)  # type: ignore[arg-type]
        try:
            with movie.saving(figure, str(path), dpi=DOTS):
                yield movie
        except (subprocess.CalledProcessError, BrokenPipeError) as error:
            said = [line for line in str(getattr(error, "stderr", None) or "it ended early").splitlines() if line]
            raise OSError(f"ffmpeg: {said[-1]}; write a .gif, or give a complete ffmpeg") from error


def _ffmpeg() -> str:
    """Find ffmpeg: that of Matplotlib's settings, or that of the package imageio-ffmpeg."""
    from matplotlib import rcParams

    found = shutil.which(rcParams["animation.ffmpeg_path"])
    if found is not None:
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise ImportError(NO_FFMPEG) from error


def _times(trajectory: Trajectory, fps: float, speed: float) -> np.ndarray:
    """Choose the times of the frames [s]; the end of a run that failed is shown for another second."""
    time = trajectory["time"]
    end = min(trajectory.end_time, time[-1]) if trajectory.failed else time[-1]
    count = 1 + math.floor((end - time[0]) * fps / speed + 1e-9)
    if count > MOST_FRAMES:
        raise ValueError(f"{count} frames; at most {MOST_FRAMES}: lower fps, or raise speed")
    times = time[0] + np.arange(count) * speed / fps
    return np.append(times, np.full(round(fps), end)) if trajectory.failed else times


def _drawn(picture: Picture, trajectory: Trajectory, q: np.ndarray, times: np.ndarray) -> Iterator[None]:
    """Draw one frame after another; yield after each."""
    for posture, at in zip(q, times):
        ended = trajectory.failed and bool(at >= trajectory.end_time - 1e-9)
        marked = ended or not (trajectory.failed or trajectory.ok)
        picture.draw(posture, f"{at:.2f} s" + f": {trajectory.status}" * marked, BAD if ended else "0.15")
        yield


class Picture:
    """A picture of robots on the ground, which is drawn anew for each posture.

    Parameters
    ----------
    models : sequence of Model
        The robots.  A single one stays in the middle, several stand where they are.
    q : ndarray
        Postures (n, sum of all nq) that the picture has room for, robot by robot; the first is in its middle.
    floor : float or None
        Height of the ground [m]; None: nothing is under the robot.
    size : sequence of int
        Width and height [pixel].

    Attributes
    ----------
    figure : matplotlib.figure.Figure
        The picture.
    """

    def __init__(self, models: Sequence[Model], q: np.ndarray, floor: float | None, size: Sequence[int] = SIZE) -> None:
        from matplotlib.colors import LightSource
        from matplotlib.figure import Figure

        self.models, self.floor, self.size = models, floor, size
        self.found = [body for model in models for body in bodies(model)[0]]
        self.figure = Figure(figsize=(size[0] / DOTS, size[1] / DOTS), dpi=DOTS)
        self.figure.set_facecolor(GROUND if floor is not None else SKY)
        self.ends = np.cumsum([model.nq for model in models])[:-1]
        firsts = np.cumsum([0, *(len(model.links) for model in models)])
        links = [(first, model, body.link) for first, model in zip(firsts, models) for body in bodies(model)[0]]
        self.rows = [first + model.link_index(link) for first, model, link in links]
        rotation, position = self._poses(q)
        first = np.concatenate(self._corners(rotation[0], position[0]))
        self.low, self.high = first.min(axis=0), first.max(axis=0)
        self.root = models[0].link_index(models[0].root)
        self.start = position[0, self.root]
        spread = np.ptp(position[:, self.rows], axis=1).max(axis=0)
        self.half = 0.8 * max(*((self.high - self.low) * (0.7, 0.7, 1.0)).tolist(), float(spread.max()), 1e-3)
        colors = [np.array([*color, 255.0]) / 255.0 for body in self.found for color in body.colors]
        smooth = [body.smooth for body in self.found for _ in body.colors]
        edges = [color if soft else (0.0, 0.0, 0.0, 0.4) for color, soft in zip(colors, smooth)]
        light = LightSource(145.0, 59.0)
        self.looks = {"facecolors": colors, "edgecolors": edges, "linewidths": 0.5, "shade": True, "lightsource": light}
        self.wide = size[0] / size[1]
        square = (0.0, 0.5 - 0.5 * self.wide, 1.0, self.wide)
        self.axes: Any = self.figure.add_axes(square, projection="3d", computed_zorder=False, facecolor="none")

    def _poses(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the poses of all links, one robot after the other, in postures (n, sum of all nq)."""
        poses = [forward_kinematics(model, own) for model, own in zip(self.models, np.split(q, self.ends, axis=1))]
        return np.concatenate([one.rotation for one in poses], 1), np.concatenate([one.position for one in poses], 1)

    def _corners(self, rotation: np.ndarray, position: np.ndarray) -> list[np.ndarray]:
        """Compute the corners (n, 3) of each body in the world [m] from the poses of all links."""
        return [body.points @ rotation[row].T + position[row] for body, row in zip(self.found, self.rows)]

    def draw(self, q: np.ndarray, label: str = "", color: str = "0.15") -> None:
        """Draw a posture (sum of all nq,), with a label in a corner."""
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        axes, half = self.axes, self.half
        rotation, position = (part[0] for part in self._poses(q[None]))
        axes.clear()
        axes.set_axis_off()
        axes.view_init(*EYE)
        axes.set_proj_type("persp", focal_length=FOCAL)
        away = (position[self.root] - self.start) * (len(self.models) == 1)
        x, y, z = 0.5 * (self.low + self.high) + [away[0], away[1], 0.0]
        axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), zlim=(z - half, z + half))
        axes.set_box_aspect((1.0, 1.0, 1.0), zoom=ZOOM / max(1.0, 0.8 * self.wide))
        if self.floor is not None:
            axes.add_collection3d(Poly3DCollection(_squares(x, y, self.floor, half), facecolor=SQUARE, zorder=0))
        corners = self._corners(rotation, position)
        faces = [points[list(face)] for body, points in zip(self.found, corners) for face in body.faces]
        axes.add_collection3d(Poly3DCollection(faces, **self.looks, zorder=1))
        looks = {"color": color, "va": "top", "fontsize": 11, "parse_math": False}  # a "$" in a name is no formula
        axes.text2D(0.02, 0.95, label, transform=self.figure.transFigure, **looks)

    def pixels(self) -> np.ndarray:
        """Return what was drawn last as colors (height, width, 3) from 0 to 255."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        canvas = FigureCanvasAgg(self.figure)
        canvas.draw()
        return np.array(canvas.buffer_rgba(), dtype=np.uint8)[..., :3]


class Window:
    """A window of Matplotlib that shows one picture after another.

    Parameters
    ----------
    size : sequence of int
        Width and height [pixel].
    fps : float
        The most pictures in a second.

    Attributes
    ----------
    opened : bool
        Whether there is a window: there is none in a notebook, without a display, and after it was closed.
    """

    def __init__(self, size: Sequence[int], fps: float) -> None:
        from matplotlib import pyplot

        figure = pyplot.figure(figsize=(size[0] / DOTS, size[1] / DOTS), dpi=DOTS)
        self.canvas: Any = figure.canvas
        self.image: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), frameon=False, xticks=[], yticks=[]).imshow(
            np.zeros((size[1], size[0], 3), np.uint8), aspect="auto"
        )
        self.opened, self.pause, self.shown = True, 1.0 / fps, 0.0
        self.canvas.mpl_connect("close_event", self._closed)
        if self.canvas.required_interactive_framework is None:
            self.close()
        else:
            figure.show()

    def _closed(self, _: Any) -> None:
        self.opened = False

    def show(self, pixels: np.ndarray) -> None:
        """Show a picture (height, width, 3), and wait until the time of the next."""
        self.image.set_data(pixels)
        self.canvas.draw_idle()
        self.canvas.start_event_loop(max(1e-3, self.shown + self.pause - time.perf_counter()))
        self.shown = time.perf_counter()

    def close(self) -> None:
        """Close the window."""
        from matplotlib import pyplot

        self.opened = False
        pyplot.close(self.canvas.figure)


def _squares(x: float, y: float, height: float, half: float) -> np.ndarray:
    """Cover the ground around a place with every other square (n, 4, 3) of a board."""
    edge = round_up(half / 7.0)
    n = math.ceil(4.0 * half / edge)
    i, j = np.meshgrid(*(np.arange(-n, n) + round(x / edge) for x in (x, y)), indexing="ij")
    pick = ((i + j) % 2 == 1) & (np.hypot(edge * i - x, edge * j - y) < 4.0 * half)  # before the eye
    around = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    corner = edge * (np.stack([i[pick], j[pick]], axis=-1)[:, None] + around)
    return np.concatenate([corner, np.full((*corner.shape[:2], 1), height)], axis=2)
