"""Motions as an HTML page that any browser plays, with nothing from the network: runs side by side, in one clock.

A link is drawn as the box of uniform density that has its mass and inertia.  With principal moments ``A, B, C`` and
mass ``m`` the edges are ``sqrt(6 (B + C - A) / m)`` and so on in turn.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

import numpy as np

from ..core.effects.energies import METER
from ..dynamics import forward_kinematics
from ..files import FilePath, complete
from ..model import Link, Model, inertia_matrix
from .plotting import positions

if TYPE_CHECKING:
    from ..trajectory import Trajectory

UNIT = 1e-4  # [m] of the numbers in the page
FRAME = 0.04  # [s]; the page draws straight lines between frames
LEFT, RIGHT, MIDDLE = (74, 144, 226), (240, 140, 60), (170, 178, 186)  # colours of links, by name


def write_animation(path: FilePath, model: Model, runs: Mapping[str, Trajectory], title: str = "") -> None:
    """Write the page: one picture for each of `runs`, which are named by their captions.

    The trajectories need the channel q, and base_q of a floating base; with energy the page tells what was drawn.
    Raises ValueError where these are missing, and for a robot none of whose links has an inertia.
    """
    boxes = {link.name: _box(link) for link in model.links if max(link.inertia, default=0.0) > 0.0}
    if not boxes:
        raise ValueError(f"{model.name}: no link has an inertia; there is nothing to draw")
    drawn = [_run(model, boxes, caption, trajectory) for caption, trajectory in runs.items()]
    height, length = _size(drawn)
    page = Template(Path(__file__).with_suffix(".html").read_text("utf-8")).substitute(
        title=escape(title or model.name),
        runs=json.dumps(drawn, separators=(",", ":")).replace("<", "\\u003c"),
        colors=json.dumps([_color(name) for name in boxes]),
        span=f"{max(1.6 * height, 1.3 * length):.3g}",
        middle=f"{0.45 * height:.3g}",
    )
    with complete(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _box(link: Link) -> np.ndarray:
    """A corner and, from there, three edges (4, 3) of the link's box [m], link axes."""
    moments, axes = np.linalg.eigh(inertia_matrix(link.inertia))
    edges = np.sqrt(np.maximum(6.0 * (moments.sum() - 2.0 * moments) / link.mass, 0.0)) * axes
    edges[:, 2] *= np.sign(np.linalg.det(axes))  # right-handed, so that the page knows a face's outside
    return np.vstack([np.array(link.center_of_mass) - 0.5 * edges.sum(axis=1), edges.T])


def _run(model: Model, boxes: dict[str, np.ndarray], caption: str, trajectory: Trajectory) -> dict:
    """What the page needs of one run."""
    every = max(1, round(FRAME / (trajectory["time"][1] - trajectory["time"][0])))
    poses = forward_kinematics(model, positions(trajectory, model)[::every])
    rows = [k for k, link in enumerate(model.links) if link.name in boxes]
    world = np.einsum("nlij,lkj->nlki", poses.rotation[:, rows], np.stack(list(boxes.values())))
    world[:, :, 0] += poses.position[:, rows]
    energy = trajectory["energy"][::every, :, METER].sum(axis=1) if "energy" in trajectory else None
    return {
        "caption": caption,
        "dt": float(trajectory["time"][every]),
        "boxes": np.round(world / UNIT).astype(int).reshape(len(world), -1).tolist(),
        "energy": None if energy is None else np.round(energy, 2).tolist(),
    }


def _size(drawn: Sequence[dict]) -> tuple[float, float]:
    """Largest height and length of the robots at any time [m]."""
    boxes = UNIT * np.concatenate([run["boxes"] for run in drawn]).reshape(-1, len(drawn[0]["boxes"][0]) // 12, 4, 3)
    ends = np.concatenate([boxes[:, :, 0], boxes.sum(axis=2)], axis=1)  # two opposite corners of every box
    return float(ends[..., 2].max()), float(np.ptp(ends[..., 0], axis=1).max())


def _color(name: str) -> tuple[int, int, int]:
    return LEFT if "left" in name else RIGHT if "right" in name else MIDDLE
