"""Makes walk.gif, the picture of the README, of what `featherstone-gait optimize` wrote:

python docs/images/walk.py humanoid_gait.npz docs/images/walk.gif
"""

import sys

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from featherstone_gait import forward_kinematics, load_robot
from featherstone_gait.optimize import walking_cost
from featherstone_gait.view.visuals import bodies

RATE, DURATION = 15, 5.3  # frames a second, [s]
EAST = np.array([np.cos(0.35), np.sin(0.35), 0.0])  # to the right of the picture, and up in it
UP = np.array([-0.22 * np.sin(0.35), 0.22 * np.cos(0.35), 0.975])
LOOK = np.cross(EAST, UP)


def walked(path):
    """The robot, and both gaits on its own floor: positions [m, rad] and the energy drawn [J], at each picture."""
    robot, found = load_robot("humanoid", locked="simplified"), np.load(path)
    runs = walking_cost(robot, states="step").simulate([found["first"], found["x"]], strides=12)
    for run in runs:
        rows = np.searchsorted(run["time"], np.arange(0.0, DURATION, 1.0 / RATE) - 1e-9)
        yield (
            robot,
            np.hstack([run["base_q"], run["q"]])[rows],
            run.column("energy", "electrical_no_regeneration").sum(axis=1)[rows],
        )


def faces(robot, q):
    """Corners (n, faces, 4, 3) of all visible boxes, their normals and colors."""
    poses, rows = forward_kinematics(robot, q), {link.name: k for k, link in enumerate(robot.links)}
    corners, normals, colors = [], [], []
    for body in bodies(robot)[0]:
        k, sides = rows[body.link], np.array(body.faces)
        world = poses.position[:, k, None] + np.einsum("nij,cj->nci", poses.rotation[:, k], body.points)
        corners.append(world[:, sides])
        along = np.diff(corners[-1], axis=2)
        out = np.cross(along[:, :, 0], along[:, :, 1])
        normals.append(out / np.linalg.norm(out, axis=-1, keepdims=True))
        color = "tab:orange" if "left" in body.link else "tab:blue" if "right" in body.link else "0.6"
        colors += [to_rgb(color)] * len(sides)
    return np.concatenate(corners, axis=1), np.concatenate(normals, axis=1), np.array(colors)


def tiles():
    """Squares of the floor, 0.1 m wide."""
    x, y = np.meshgrid(np.arange(-4, 14), np.arange(-2, 3), indexing="ij")
    dark = (x + y) % 2 == 0
    corners = np.stack([x[dark], y[dark], 0 * x[dark]], axis=1)[:, None] + [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    return 0.1 * (corners - [0.5, 0.5, 0.0])


def flat(points):
    return np.stack([points @ EAST, points @ UP], axis=-1)


def draw(axes, scene, k):
    caption, (_, q, energy), (corners, normals, colors) = scene
    axes.clear()
    axes.set_axis_off()
    axes.set(xlim=(-0.16, 0.76), ylim=(-0.06, 0.42), aspect="equal")
    axes.add_collection(PolyCollection(flat(tiles()), facecolors="0.92", edgecolors="none"))
    facing = normals[k] @ LOOK > 0.0
    order = np.argsort((corners[k].mean(axis=1) @ LOOK)[facing])
    light = 0.55 + 0.45 * np.clip(normals[k][facing] @ np.array([-0.3, -0.5, 0.8]), 0.0, 1.0)
    shown = (colors[facing] * light[:, None])[order]
    sides = flat(corners[k][facing][order])
    axes.add_collection(PolyCollection(sides, facecolors=shown, edgecolors="0.25", linewidths=0.3))
    way = q[k, 0] - q[0, 0]
    axes.text(0.01, 0.97, caption, transform=axes.transAxes, fontsize=11, weight="bold", va="top")
    axes.text(0.99, 0.97, f"{k / RATE:.1f} s   {round(1e2 * way):3d} cm   {energy[k]:4.1f} J", transform=axes.transAxes,
              fontsize=11, family="monospace", va="top", ha="right")  # fmt: skip


def main(source, target):
    figure = Figure(figsize=(5.0, 5.22), dpi=100)
    panels = figure.subplots(2)
    figure.subplots_adjust(0, 0, 1, 1, 0, 0)
    scenes = [
        (caption, run, faces(*run[:2])) for caption, run in zip(("planned gait", "optimized gait"), walked(source))
    ]
    writer = PillowWriter(fps=RATE)
    with writer.saving(figure, target, dpi=100):
        for k in range(round(DURATION * RATE)):
            for axes, scene in zip(panels, scenes):
                draw(axes, scene, k)
            writer.grab_frame()


if __name__ == "__main__":
    main(*sys.argv[1:])
