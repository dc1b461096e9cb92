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
from .visuals import Body, bodies, round_up

MOST_FRAMES = 3000
DOTS = 100  # per inch
YAW, PITCH, FAR = -1.1, 0.3, 2.4  # [rad], [rad], distance of the eye by the width that is seen; as in page.js
SKY, GROUND, SQUARE, BAD = "#e6eef6", "#f1f0eb", "#dedcd3", "#a3160f"
LIGHT = np.array([0.29, -0.42, 0.86])


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
    from matplotlib.collections import PolyCollection

    found, _ = bodies(model)
    rows = {link.name: k for k, link in enumerate(model.links)}
    poses = forward_kinematics(model, q)
    places = [rows[body.link] for body in found]
    first = _points(found, poses.rotation[0, places], poses.position[0, places])
    low, high = first.min(axis=0), first.max(axis=0)
    spread = np.ptp(poses.position[:, places], axis=1).max(axis=0)
    span = 1.6 * max(float(high[2] - low[2]), float(spread[:2].max()), float(spread[2]), 1e-3)
    root = rows[model.root]
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for k, time in enumerate(times):
        axes.clear()
        axes.set_axis_off()
        away = poses.position[k, root] - poses.position[0, root]
        camera = _Camera(0.5 * (low + high) + [away[0], away[1], 0.0], span)
        x, y = figure.get_size_inches()
        reach = 0.5 * span * max(1.0, 0.8 * x / y)
        axes.set(xlim=(-reach, reach), ylim=(-reach * y / x, reach * y / x), facecolor=SKY)
        figure.set_facecolor(GROUND if floor is not None else SKY)
        if floor is not None:
            axes.add_collection(PolyCollection(list(camera.squares(floor)), facecolor=SQUARE, linewidth=0))
        polygons, colors, smooth = camera.faces(found, poses.rotation[k, places], poses.position[k, places])
        edges = [color if soft else (0.0, 0.0, 0.0, 0.4) for color, soft in zip(colors, smooth)]
        axes.add_collection(PolyCollection(polygons, facecolor=colors, edgecolor=edges, linewidth=0.5))
        ended = trajectory.failed and bool(time >= trajectory.end_time - 1e-9)
        marked = ended or not (trajectory.failed or trajectory.ok)
        label = f"{time:.2f} s" + f": {trajectory.status}" * marked
        axes.text(0.02, 0.95, label, transform=axes.transAxes, color=BAD if ended else "0.15", va="top", fontsize=11)
        yield


def _points(found: list[Body], rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Compute all corners (n, 3) of the bodies in world axes [m]."""
    return np.concatenate([body.points @ R.T + p for body, R, p in zip(found, rotation, position)])


class _Camera:
    """Project points in perspective, as page.js does: toward `center`, from YAW and PITCH."""

    def __init__(self, center: np.ndarray, span: float) -> None:
        c, s, cp, sp = math.cos(YAW), math.sin(YAW), math.cos(PITCH), math.sin(PITCH)
        self.axes = np.array([[-s, c, 0.0], [-sp * c, -sp * s, cp], [cp * c, cp * s, sp]])  # right, up, back
        self.span, self.distance, self.center = span, FAR * span, center
        self.eye = center + self.distance * self.axes[2]

    def see(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project points to right and up (..., 2) [m, at the distance of the center], and depth (...) [m]."""
        seen = (points - self.eye) @ self.axes.T
        depth = -seen[..., 2]
        return seen[..., :2] * (self.distance / np.maximum(depth, 0.05 * self.distance))[..., None], depth

    def squares(self, height: float) -> np.ndarray:
        """Project every other square of the ground (n, 4, 2)."""
        edge = round_up(self.span / 14.0)
        n = math.ceil(2.0 * self.span / edge)
        i, j = np.meshgrid(*(np.arange(-n, n) + round(x / edge) for x in self.center[:2]), indexing="ij")
        pick = (i + j) % 2 == 1
        around = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        corner = edge * (np.stack([i[pick], j[pick]], axis=-1)[:, None] + around)
        quads, depth = self.see(np.concatenate([corner, np.full((*corner.shape[:2], 1), height)], axis=2))
        return quads[(depth > 0.1 * self.distance).all(axis=1)]

    def faces(self, found: list[Body], rotation: np.ndarray, position: np.ndarray) -> tuple[list, list, list]:
        """Project the faces that look at the eye, from far to near; with colors, and whether they are smooth."""
        drawn = []
        for body, R, p in zip(found, rotation, position):
            world = body.points @ R.T + p
            seen, depth = self.see(world)
            for face, color in zip(body.faces, body.colors):
                corner = world[list(face)]
                normal = np.cross(corner[1] - corner[0], corner[2] - corner[0])
                length = float(np.sqrt(normal @ normal))
                if length > 0.0 and normal @ (self.eye - corner[0]) > 0.0:
                    light = 0.42 + 0.31 * (1.0 + float(normal @ LIGHT) / length)
                    shade = tuple(min(1.0, light * x / 255.0) for x in color)
                    drawn.append((float(depth[list(face)].mean()), seen[list(face)], shade, body.smooth))
        drawn.sort(key=lambda item: -item[0])
        return [d[1] for d in drawn], [d[2] for d in drawn], [d[3] for d in drawn]
