"""Write motions as GIF or PNG files, drawn by Matplotlib."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..base import arguments
from ..base.arguments import instance, listed, real, shown, whole
from ..base.files import FilePath, complete
from ..dynamics import forward_kinematics
from ..model import Model
from ..run.trajectory import Trajectory, positions
from .shown import Robot, robot_of
from .visuals import bodies, round_up

MOST_FRAMES = 3000
DOTS = 100  # per inch
EYE = 17.0, -63.0  # elevation and azimuth [deg], as in page.js
FOCAL, ZOOM = 0.45, 1.65  # distance of the eye and size of the picture, as Matplotlib measures them
SKY, GROUND, SQUARE, BAD = "#e6eef6", "#f1f0eb", "#dedcd3", "#a3160f"


def save_movie(
    trajectory: Trajectory,
    path: FilePath,
    robot: Robot = None,
    *,
    fps: float = 25.0,
    speed: float = 1.0,
    size: tuple[int, int] = (640, 480),
) -> int:
    """Draw a motion with Matplotlib, as a GIF or as PNG files.

    Parameters
    ----------
    trajectory : Trajectory
        What `simulate` returns, with the channel q, and base_q of a floating base.
    path : path
        Of the .gif, or of a folder for PNG files.
    robot : Model, CompiledScene, path or str, optional
        As in `show`.
    fps : float
        Frames per second.
    speed : float
        Playing speed; 0.1 is slow motion.
    size : tuple of int
        Width and height [pixel].

    Returns
    -------
    int
        Number of frames.

    Raises
    ------
    ValueError
        As in `show`, and for more frames or pixels than a file should have.
    """
    from matplotlib.animation import PillowWriter
    from matplotlib.figure import Figure

    instance("trajectory", trajectory, Trajectory, "give what simulate returns")
    fps = real("fps", fps, 0.1, 50.0, "a GIF shows at most 50 frames a second")
    speed = real("speed", speed, 1e-4, 100.0, "1 is real time")
    target, remedy = arguments.path("path", path), "give width and height [pixel]"
    pixels = [whole("size", x, 64, remedy, 4000) / DOTS for x in listed("size", size, remedy)]
    if len(pixels) != 2:
        raise ValueError(f"size is {shown(size)}; {remedy}")
    if target.suffix and target.suffix.lower() != ".gif":
        raise ValueError(f"{target}: expected a name that ends in .gif, or a folder for PNG files; give one of these")
    model, ground = robot_of(trajectory, robot)
    times = _times(trajectory, fps, speed)
    rows = np.searchsorted(trajectory["time"], times + 1e-9, side="right") - 1  # of the last samples before
    q = positions(trajectory, model)[np.clip(rows, 0, len(trajectory["time"]) - 1)]
    figure = Figure(figsize=(pixels[0], pixels[1]), dpi=DOTS)
    frames = _drawn(figure, trajectory, model, q, times, None if ground is None else ground.height)
    if target.suffix:
        writer = PillowWriter(fps=fps)  # type: ignore[arg-type]  # it divides by it
        with complete(target) as temporary, writer.saving(figure, str(temporary), dpi=DOTS):
            for _ in frames:
                writer.grab_frame()
    else:
        target.mkdir(parents=True, exist_ok=True)
        for k, _ in enumerate(frames):
            with complete(target / f"frame_{k:04d}.png") as temporary:
                figure.savefig(temporary, dpi=DOTS)
    return len(times)


def _times(trajectory: Trajectory, fps: float, speed: float) -> np.ndarray:
    """Choose the times of the frames [s]; the end of a run that failed is shown for another second."""
    time = trajectory["time"]
    end = min(trajectory.end_time, time[-1]) if trajectory.failed else time[-1]
    count = 1 + math.floor((end - time[0]) * fps / speed + 1e-9)
    if count > MOST_FRAMES:
        raise ValueError(f"{count} frames; at most {MOST_FRAMES}: lower fps, or raise speed")
    times = time[0] + np.arange(count) * speed / fps
    return np.append(times, np.full(round(fps), end)) if trajectory.failed else times


def _drawn(
    figure: Any, trajectory: Trajectory, model: Model, q: np.ndarray, times: np.ndarray, floor: float | None
) -> Iterator[None]:
    """Draw one frame after another into the figure; yield after each."""
    from matplotlib.colors import LightSource
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    found, _ = bodies(model)
    rows = {link.name: k for k, link in enumerate(model.links)}
    poses, places = forward_kinematics(model, q), [rows[body.link] for body in found]

    def corners(k: int) -> list[np.ndarray]:
        return [body.points @ poses.rotation[k, row].T + poses.position[k, row] for body, row in zip(found, places)]

    low, high = (end(np.concatenate(corners(0)), axis=0) for end in (np.min, np.max))
    spread = np.ptp(poses.position[:, places], axis=1).max(axis=0)
    half = 0.8 * max(float(high[2] - low[2]), float(spread.max()), 1e-3)
    colors = [np.array([*color, 255.0]) / 255.0 for body in found for color in body.colors]
    smooth = [body.smooth for body in found for _ in body.colors]
    edges = [color if soft else (0.0, 0.0, 0.0, 0.4) for color, soft in zip(colors, smooth)]
    figure.set_facecolor(GROUND if floor is not None else SKY)
    light, wide = LightSource(145.0, 59.0), np.divide(*figure.get_size_inches())
    square = (0.0, 0.5 - 0.5 * wide, 1.0, wide)
    axes = figure.add_axes(square, projection="3d", computed_zorder=False, facecolor="none")
    for k, time in enumerate(times):
        axes.clear()
        axes.set_axis_off()
        axes.view_init(*EYE)
        axes.set_proj_type("persp", focal_length=FOCAL)
        away = poses.position[k, rows[model.root]] - poses.position[0, rows[model.root]]
        x, y, z = 0.5 * (low + high) + [away[0], away[1], 0.0]
        axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), zlim=(z - half, z + half))
        axes.set_box_aspect((1.0, 1.0, 1.0), zoom=ZOOM / max(1.0, 0.8 * wide))
        if floor is not None:
            axes.add_collection3d(Poly3DCollection(_squares(x, y, floor, half), facecolor=SQUARE, zorder=0))
        faces = [points[list(face)] for body, points in zip(found, corners(k)) for face in body.faces]
        looks = {"facecolors": colors, "edgecolors": edges, "linewidths": 0.5, "shade": True, "lightsource": light}
        axes.add_collection3d(Poly3DCollection(faces, **looks, zorder=1))
        ended = trajectory.failed and bool(time >= trajectory.end_time - 1e-9)
        marked = ended or not (trajectory.failed or trajectory.ok)
        label = f"{time:.2f} s" + f": {trajectory.status}" * marked
        color = BAD if ended else "0.15"
        axes.text2D(0.02, 0.95, label, transform=figure.transFigure, color=color, va="top", fontsize=11)
        yield


def _squares(x: float, y: float, height: float, half: float) -> np.ndarray:
    """Cover the ground around a place with every other square (n, 4, 3) of a board."""
    edge = round_up(half / 7.0)
    n = math.ceil(4.0 * half / edge)
    i, j = np.meshgrid(*(np.arange(-n, n) + round(x / edge) for x in (x, y)), indexing="ij")
    pick = ((i + j) % 2 == 1) & (np.hypot(edge * i - x, edge * j - y) < 4.0 * half)  # before the eye
    around = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    corner = edge * (np.stack([i[pick], j[pick]], axis=-1)[:, None] + around)
    return np.concatenate([corner, np.full((*corner.shape[:2], 1), height)], axis=2)
