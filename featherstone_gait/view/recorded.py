"""Collect the data of a page from runs: poses at frames, forces, footprints, channels for plots, and the status."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..base.arguments import instance
from ..core.effects.energies import METER, SUPPLY
from ..core.step.state import BY_NAME
from ..dynamics import deepest_points, forward_kinematics
from ..model import TORQUE_LAWS, Ground, Model, Servo
from ..run.contacts import PairTable, by_pair
from ..run.range_sensor import strips
from ..run.sensors import in_world
from ..run.trajectory import Trajectory, positions
from ..scene.channels import column_of, joint_labels, unit_of
from ..scene.contact import ground_under, plane_axes
from .full_mesh import full_meshes
from .visuals import FACES, ROUND, Body, Piece, bodies_of, read, side_of, sided

FRAME = 0.04  # [s] at least; the page draws straight lines between frames
POSES, PLOTTED = 400_000, 120_000  # numbers of all runs together, so that a page stays below 5 MB
MESHES = 4.0  # of a page [MB]
SAMPLES = 800  # of a channel in a plot
TURN = 1e-4  # of the quaternions in the page
FINE = 5e-5  # of the largest length: unit of lengths in the page
TOUCH = 0.01  # of the weight: smaller normal forces do not count as contact
STANCE = 0.03  # [s] of the shortest step that leaves a footprint
NEAR = 1e-3  # [m] above the ground, below which a point counts as touching if forces were not recorded
FIELD = 40  # cells along a height field
PRINTS = 400  # footprints of a run
HIDDEN = (  # channels that are not offered for plots; those of slots say nothing without their owners
    "time", "velocity_change", "newton_iterations", "worst_chatter",
    "pair", "pair_feature", "pair_deflection", "pair_turning", "pair_position",
)  # fmt: skip


@dataclass(frozen=True)
class Seen:
    """A run, its robot and its ground.

    Attributes
    ----------
    model : Model
        The robot.
    trajectory : Trajectory
        The run.
    ground : Ground or None
        The ground of the run; None if there was none or it is not known.
    level : float or None
        Height of the surface of a fluid [m].
    rays : ndarray or None
        Where rays of sensors begin and end at each sample [m], and 1 if they meet something (samples, rays, 7).
    """

    model: Model
    trajectory: Trajectory
    ground: Ground | None = None
    level: float | None = None
    rays: np.ndarray | None = None


def page_data(
    runs: Mapping[str, Seen], plots: Sequence[str] = (), ghosts: bool = False, together: bool = False,
    mesh_limit: float = MESHES,
) -> dict[str, Any]:  # fmt: skip
    """Collect the data of a page from runs by caption, of which `together` makes one picture.

    mesh_limit: size of all meshes that are in the page in full [MB].

    Raises ValueError if channels are missing that say where the robot is, and for a robot that has nothing to draw.
    """
    robots = {id(seen.model): seen.model for seen in runs.values()}
    looks = {key: _look(model, FACES // len(runs), 1e6 * mesh_limit / len(robots)) for key, model in robots.items()}
    found = [looks[id(seen.model)].bodies for seen in runs.values()]
    poses = [sampled(seen) for seen in runs.values()]
    boxes = [corners_of(seen.model, p, f) for seen, p, f in zip(runs.values(), poses, found)]
    if together:  # one box about all that all of them pass through
        begin, whole = _around([box[0] for box in boxes]), _around(boxes)
        boxes = [whole[None]] * len(boxes)
    across = max(1e-3, *(float(np.ptp(box[..., :2], axis=1).max()) for box in boxes))
    height = max(1e-3, *(float(np.ptp(box[..., 2], axis=1).max()) for box in boxes))
    unit = 10.0 ** math.floor(math.log10(max(FINE * max(across, height), 1e-9)))
    span, low = max(1.45 * height, 1.55 * across), 1.0
    if together:
        begin = _near(begin, whole)
        x, y, z = np.ptp(begin, axis=0)
        span = max(1.45 * z, 1.15 * math.hypot(x, y), 1e-3)
        low = min(1.0, 1.45 * max(y, z + 0.3 * math.hypot(x, y)) / span)  # y from above, the rest from a corner
    data: dict[str, Any] = {
        "unit": unit,
        "turn": TURN,
        "models": [_robot(model, looks[key], unit) for key, model in robots.items()],
        "runs": [
            {"caption": caption, "model": [*robots].index(id(seen.model))} | _run(seen, p, f, box, unit, len(runs))
            for (caption, seen), p, f, box in zip(runs.items(), poses, found, boxes)
        ],
        "span": float(f"{span:.3g}"),
        "low": float(f"{low:.3g}"),
        "plots": list(plots),
        "ghosts": ghosts,
        "together": together,
        "notes": list(dict.fromkeys(note for look in looks.values() for note in look.notes)),
    }
    if together:
        data["runs"] = [run | {"middle": np.round(begin.mean(axis=0), 4).tolist()} for run in data["runs"]]
    known_channels([run["channels"] for run in data["runs"]], plots)
    return data


def _around(boxes: Sequence[np.ndarray]) -> np.ndarray:
    """Return the lowest and the highest coordinates (2, 3) of points (..., 3)."""
    points = np.concatenate([box.reshape(-1, 3) for box in boxes])
    return np.array([points.min(axis=0), points.max(axis=0)])


def _near(begin: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Widen the box of all bodies at first by what they pass through, but not by what leaves far."""
    room = max(1e-3, float(np.ptp(begin, axis=0).max())) * np.array([0.25, 0.25, 1.0])  # what falls is seen to fall
    return np.array([np.maximum(whole[0], begin[0] - room), np.minimum(whole[1], begin[1] + room)])


def known_channels(runs: Sequence[Mapping[str, Any]], plots: Sequence[str]) -> list[str]:
    """List the names of the channels of some runs.  Raises ValueError for plots of other channels."""
    known = sorted({name for channels in runs for name in channels})
    for name in plots:
        if name not in known:
            raise ValueError(f"plots: there is no channel {name!r}; channels of the page: {', '.join(known)}")
    return known


# ---------------------------------------------------------------------------------------------- robots


class Look(NamedTuple):
    """A robot as a page draws it: simplified, and in full where that differs."""

    bodies: list[Body]
    full: dict[str, Any] | None
    notes: list[str]


def _look(model: Model, most: int, limit: float) -> Look:
    """Convert a robot to `most` faces, and to its full meshes in at most `limit` bytes."""
    found = read(model, ROUND)
    simple = bodies_of(found, most)
    full, note = full_meshes(found, [body.link for body in simple], most, limit)
    return Look(simple, full, [*found.notes, *filter(None, [note])])


def _robot(model: Model, look: Look, unit: float) -> dict[str, Any]:
    """Describe a robot and its bodies, points in whole units; equal colors are written once."""
    found = look.bodies
    places = {body.link: k for k, body in enumerate(found)}
    packed = []
    for body in found:
        palette = list(dict.fromkeys(body.colors))
        packed.append(
            {
                "points": np.round(body.points / unit).astype(int).reshape(-1).tolist(),
                "faces": body.faces,
                "palette": palette,
                "colors": [palette.index(color) for color in body.colors] if len(palette) > 1 else [],
                "smooth": body.smooth,
                "open": body.open,
            }
        )
    return {
        "name": model.name,
        "links": [body.link for body in found],
        "joints": [{"name": joint.name, "body": places.get(joint.child, -1)} for joint in model.moving_joints],
        "moves": model.base == "floating",
        "bodies": packed,
        "full": look.full,
    }


# ---------------------------------------------------------------------------------------------- runs


@dataclass(frozen=True)
class FramePoses:
    """The poses of all links at every frame up to the end of a run."""

    rows: np.ndarray  # samples of the run that are frames
    last: int  # the last sample before the run failed
    rotation: np.ndarray  # (frames, links, 3, 3)
    position: np.ndarray  # (frames, links, 3) [m]


def sampled(seen: Seen) -> FramePoses:
    """Choose the frames of a run and compute the poses of all links there."""
    run = seen.trajectory
    instance("run", run, Mapping, "give what simulate returns")
    q = positions(run, seen.model)
    time = run["time"]
    sound = np.isfinite(q).all(axis=1)
    last = int(np.searchsorted(time, run.end_time + 1e-9, side="right")) - 1 if run.failed else len(time) - 1
    last = min(max(last, 0), len(time) - 1)
    last = min(last, int(np.argmin(sound)) - 1) if not sound.all() else last
    if last < 0:
        raise ValueError(f"{seen.model.name}: no sample of the run is finite; there is nothing to draw")
    numbers = 7 * len(seen.model.links) + 6 * len(seen.model.contacts)
    step = float(time[1] - time[0]) if len(time) > 1 else FRAME
    every = max(1, round(FRAME / step), math.ceil((last + 1) * numbers / POSES))
    rows = np.unique(np.append(np.arange(0, last + 1, every), last))
    poses = forward_kinematics(seen.model, q[rows])
    return FramePoses(rows, last, poses.rotation, poses.position)


def corners_of(model: Model, poses: FramePoses, found: Sequence[Body | Piece]) -> np.ndarray:
    """Compute corners (frames, n, 3) of the bodies' boxes along their links' axes [m]."""
    rows = _rows(model, found)
    ends = np.array([[body.points.min(axis=0), body.points.max(axis=0)] for body in found])
    pick = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    corners = np.stack([ends[:, pick[:, axis], axis] for axis in range(3)], axis=-1)
    world = np.einsum("nlij,lkj->nlki", poses.rotation[:, rows], corners) + poses.position[:, rows, None]
    return world.reshape(len(world), -1, 3)


def _rows(model: Model, found: Sequence[Body | Piece]) -> list[int]:
    rows = {link.name: k for k, link in enumerate(model.links)}
    return [rows[body.link] for body in found]


def _run(
    seen: Seen, poses: FramePoses, found: list[Body], corners: np.ndarray, unit: float, several: int
) -> dict[str, Any]:
    """Collect the data of one of several runs; corners (frames, n, 3) of its bodies [m]."""
    run, model = seen.trajectory, seen.model
    time, rows = run["time"], _rows(model, found)
    root = next((k for k, body in enumerate(found) if body.link == model.root), 0)
    frames = np.concatenate(
        [np.round(poses.position[:, rows] / unit), np.round(quaternions(poses.rotation[:, rows]) / TURN)], axis=2
    )
    drawn = np.round(_sound(run["energy"][poses.rows, :, METER].sum(axis=1)), 3).tolist() if "energy" in run else None
    floor = seen.ground.height if seen.ground is not None else float(corners[..., 2].min())
    return {
        "status": run.status,
        "message": run.message,
        "failed": run.failed,
        "times": [float(f"{t:.6g}") for t in time[poses.rows]],
        "end": float(run.end_time if run.failed else time[-1]),
        "frames": frames.astype(int).reshape(len(frames), -1).tolist(),
        "root": root,
        "middle": [float(f"{x:.4g}") for x in 0.5 * (corners[0].min(axis=0) + corners[0].max(axis=0))],
        "energy": drawn,  # that the servos have taken by each frame [J]
        "load": _load(model, run, poses.rows),
        "channels": channels_of(model, run, poses.last, PLOTTED // several),
        **_touching(seen, poses, unit),
        "rays": None if seen.rays is None else _flat(seen.rays[poses.rows] / [*(6 * [unit]), 1.0]),
        "level": None if seen.level is None else float(f"{seen.level:.5g}"),
        "lines": [] if seen.ground is None else _lines(seen.ground),
        "floor": {"real": seen.ground is not None, "height": float(f"{floor:.5g}"), **relief(seen.ground, corners)},
    }


def quaternions(rotation: np.ndarray) -> np.ndarray:
    """Convert rotations (frames, bodies, 3, 3) to quaternions (frames, bodies, 4), x y z w, continuous in time."""
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat().reshape(*rotation.shape[:2], 4)
    turns = np.where((q[1:] * q[:-1]).sum(axis=2) < 0.0, -1.0, 1.0)
    return q * np.concatenate([np.ones((1, q.shape[1])), np.cumprod(turns, axis=0)])[..., None]


def _sound(values: np.ndarray) -> np.ndarray:
    """Replace values that are not finite, as in a run that diverged, by 0."""
    return np.where(np.isfinite(values), values, 0.0)


def _load(model: Model, run: Trajectory, rows: np.ndarray) -> dict[str, Any] | None:
    """Compute each joint's torque in percent of its servo's stall torque; without servos, of the largest in the run."""
    if "torque" not in run or not model.moving_joints:
        return None
    torque = np.abs(_sound(run["torque"]))
    stall = np.array([_stall_torque(model.servos.get(joint.name)) for joint in model.moving_joints])
    known = np.isfinite(stall).all() and bool(run.info.get("servos", True))
    limit = stall if known else np.full(len(stall), max(float(torque.max(initial=0.0)), 1e-12))
    percent = np.round(100.0 * torque[rows] / limit).clip(0, 999).astype(int)
    return {"percent": percent.tolist(), "of": "the stall torque" if known else "the largest torque of the run"}


def _stall_torque(servo: Servo | None) -> float:
    """Compute the stall torque at the limits of voltage and current, without friction [N m]; NaN without a motor."""
    if servo is None or servo.controller.law in TORQUE_LAWS or not servo.resistance > 0:
        return math.nan
    return servo.gearbox.ratio * servo.motor_constant * min(servo.voltage_limit / servo.resistance, servo.current_limit)


# ---------------------------------------------------------------------------------------------- ground


def _touching(seen: Seen, poses: FramePoses, unit: float) -> dict[str, Any]:
    """Collect contact points, forces on them and footprints; empty without ground or points."""
    model, run, ground = seen.model, seen.trajectory, seen.ground
    pairs = _pushing(model, run, poses, unit)
    if ground is None or not model.contacts:
        return {"points": None, "forces": None, "pairs": pairs, "prints": [], "feet": False}
    weight = 9.81 * model.mass
    forces = _sound(run["contact_force"]) if "contact_force" in run else None
    q = positions(run, model)[: poses.last + 1]
    fine = np.arange(0, len(q), max(1, round(0.01 / _step(run))))
    points = touching_points(model, q[poses.rows])
    pushed = None if forces is None else in_world(ground, forces[poses.rows], points if ground.field else None)
    close = touching_points(model, q[fine])
    if forces is not None:
        touch = forces[fine, :, 0] > TOUCH * weight
    else:
        over = ground_under(ground, close.reshape(-1, 3))[:, 6].reshape(close.shape[:2])
        touch = over < NEAR + ground.penetration
    touch_at_frames = touch[np.searchsorted(fine, poses.rows).clip(0, len(fine) - 1)] if forces is None else None
    return {
        "points": _flat(points / unit),
        "forces": None if pushed is None else _flat(pushed / (1e-3 * weight)),  # [1/1000 of the weight]
        "pairs": pairs,
        "touch": None if touch_at_frames is None else touch_at_frames.astype(int).tolist(),
        "weight": float(f"{weight:.4g}"),
        "prints": _prints(model, run["time"][fine], close, touch, unit),
        "feet": bool(_feet(model)),
    }


def _pushing(model: Model, run: Trajectory, poses: FramePoses, unit: float) -> list[list[int]] | None:
    """Collect where bodies and propellers push a robot at each frame, and with which force; None if that is not known.

    Six numbers each: the place, and the force by 1/1000 of the weight.
    """
    found = pushes_of(model, run, poses)
    if found is None:
        return None
    place, force, on = found
    force = force / (1e-3 * 9.81 * max(model.mass, 1e-9))
    numbers = np.round(np.concatenate([place / unit, force], axis=2)).astype(int)
    on = on & (np.abs(force).max(axis=2) > 5.0)
    return [one[there].reshape(-1).tolist() for one, there in zip(numbers, on)]


def pushes_of(model: Model, run: Trajectory, poses: FramePoses) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return where bodies, propellers or a hand push a robot, forces (frames, pushes, 3) [m, N], and which there are.

    None if the run does not say.
    """
    places, forces, on = [], [], []
    if {"pair", "pair_force", "pair_position"} <= run.channels.keys():
        places.append(run["pair_position"][poses.rows])
        forces.append(run["pair_force"][poses.rows])
        on.append(run["pair"][poses.rows] > 0)
    if model.propellers and "qd" in run:
        places.append(poses.position[:, [model.link_index(model.joint(one.joint).child) for one in model.propellers]])
        forces.append(_thrusts(model, run["qd"][poses.rows], poses))
        on.append(np.ones(forces[-1].shape[:2], bool))
    links, names = run.info.get("inputs", {}).get("links", ()), [link.name for link in model.links]
    if "push" in run and set(links) <= set(names):  # by hand
        numbers = run["push"][poses.rows]
        at, k = np.array([names.index(link) for link in links])[numbers[:, 0].astype(int)], np.arange(len(numbers))
        turned = (poses.rotation[k, at] @ numbers[:, 1:4, None])[..., 0]
        places.append((poses.position[k, at] + turned)[:, None])
        forces.append(numbers[:, None, 4:7])
        on.append(numbers[:, None, 4:7].any(axis=2))
    if not places:
        return None
    place, force, there = (np.concatenate(parts, axis=1) for parts in (places, forces, on))
    return place, _sound(force), there


def _thrusts(model: Model, qd: np.ndarray, poses: FramePoses) -> np.ndarray:
    """Compute the thrust of each propeller (frames, propellers, 3) at joint speeds (frames, joints) [N]."""
    found = []
    for one in model.propellers:
        joint, speed = model.joint(one.joint), qd[:, model.joint_rows[one.joint], None]
        axis = poses.rotation[:, model.link_index(joint.child)] @ np.array(joint.axis)
        found.append((one.thrust * np.abs(speed) + one.linear_thrust) * speed * axis)
    return np.stack(found, axis=1)


def _lines(ground: Ground) -> list[list[float]]:
    """Return the corners of the lines on the ground, x y z of four each [m]."""
    corners = strips(ground.lines).reshape(-1, 2)
    if not len(corners):
        return []
    height = -ground_under(ground, np.column_stack([corners, np.zeros(len(corners))]))[:, 6]
    return np.round(np.column_stack([corners, height]), 4).reshape(-1, 12).tolist()


def _flat(values: np.ndarray) -> list[list[int]]:
    """Round to whole numbers, a list for each frame."""
    return np.round(values).astype(int).reshape(len(values), -1).tolist()


def _step(run: Trajectory) -> float:
    return float(run["time"][1] - run["time"][0]) if len(run["time"]) > 1 else 1.0


def touching_points(model: Model, q: np.ndarray) -> np.ndarray:
    """Compute the lowest points (samples, points, 3) of the contacts in world axes [m]."""
    return deepest_points(model, forward_kinematics(model, q), (0.0, 0.0, 1.0))


def _feet(model: Model) -> list[str]:
    """List links that can step: those with contact points that joints carry, and that are no wheels."""
    rolls = {point.link for point in model.contacts if point.circle_radius > 0.0}
    links = dict.fromkeys(point.link for point in model.contacts)
    return [link for link in links if link != model.root and link not in rolls and model.moving_joints]


def _prints(model: Model, time: np.ndarray, points: np.ndarray, touch: np.ndarray, unit: float) -> list[dict[str, Any]]:
    """Collect footprints: the time at which each stance of a link began, and its contact points in the middle of it."""
    links = [point.link for point in model.contacts]
    feet = _feet(model)
    prints: list[dict[str, Any]] = []
    for link in feet:
        own = np.array([name == link for name in links])
        on = np.concatenate([[False], touch[:, own].any(axis=1), [False]])
        begins, ends = np.flatnonzero(on[1:] & ~on[:-1]), np.flatnonzero(~on[1:] & on[:-1])
        for begin, end in zip(begins, ends):
            if time[end - 1] - time[begin] < STANCE:
                continue
            stood = np.round(points[(begin + end - 1) // 2, own] / unit).astype(int)
            at = float(f"{time[begin]:.5g}")
            prints.append({"at": at, "color": list(sided(link)), "points": stood.reshape(-1).tolist()})
    return sorted(prints, key=lambda one: one["at"])[:PRINTS]


def margin_of(corners: np.ndarray) -> float:
    """Compute how far `relief` extends the ground beyond the way of a robot [m]."""
    return 0.6 * float(max(np.ptp(corners[..., :2], axis=(0, 1)).max(), np.ptp(corners[..., 2])))


def relief(ground: Ground | None, corners: np.ndarray) -> dict[str, Any]:
    """Cut ground that is not level into quadrangles [m] along the way of the robot; {} for a level floor.

    `shade` alternates between 0 and 1, and is 2 for the riser of a step.
    """
    if ground is None or not (ground.slope or ground.steps or ground.field is not None):
        return {}
    margin = margin_of(corners)
    box = np.array([corners[..., :2].min(axis=(0, 1)) - margin, corners[..., :2].max(axis=(0, 1)) + margin])
    nodes, faces = _stairs(ground, box) if ground.field is None else (_field(ground, box), np.zeros(FIELD, bool))
    quads = np.stack([nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]], axis=2)
    shade = np.add.outer(np.arange(quads.shape[0]), np.arange(quads.shape[1])) & 1
    shade[faces[: quads.shape[0]]] = 2
    return {"quads": np.round(quads.reshape(-1, 12), 5).tolist(), "shade": shade.reshape(-1).tolist()}


def _field(ground: Ground, box: np.ndarray) -> np.ndarray:
    """Compute nodes (n, n, 3) on a height field over a box (2, 2) in x and y [m]."""
    x, y = (np.linspace(low, high, FIELD + 1) for low, high in box.T)
    level = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((len(x), len(y)))], axis=-1)
    level[..., 2] = -ground_under(ground, level.reshape(-1, 3))[:, 6].reshape(level.shape[:2])
    return level


def _stairs(ground: Ground, box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute nodes (n, m, 3) of a plane with slope and steps, two rows per step, and which rows begin a riser."""
    normal, first, second = plane_axes(ground)
    across = [np.array([x, y, 0.0]) for x in box[:, 0] for y in box[:, 1]]
    along, side = np.array([(c @ first / (1.0 - first[2] ** 2), c @ second) for c in across]).T
    steps = sorted(step for step in ground.steps if along.min() < step[0] < along.max())
    base = sum(rise for start, rise in ground.steps if start <= along.min())
    rows = sorted([(t, 0.0) for t in np.linspace(along.min(), along.max(), 31)] + [(t, 0.0) for t, _ in steps])
    rows = sorted(rows + steps, key=lambda row: (row[0], row[1] != 0.0))
    t, rises = np.array(rows).T
    up = ground.height * normal[2] + base + np.cumsum(rises)
    y = np.linspace(side.min(), side.max(), 13)
    nodes = (t[:, None] * first + up[:, None] * normal)[:, None] + y[None, :, None] * second
    return nodes, np.append(rises[1:] != 0.0, False)


# ---------------------------------------------------------------------------------------------- plots


def channels_of(model: Model, run: Trajectory, last: int, most: int = PLOTTED) -> dict[str, Any]:
    """Prepare channels for plots: unit, names of columns, times and values, thinned so that peaks stay."""
    found: dict[str, tuple[str, list[str], np.ndarray]] = {}
    for name, values in run.items():
        if name not in HIDDEN and values.ndim > 1 and values[0].size and np.isfinite(values[: last + 1]).any():
            found[name] = _column_table(model, run, name, values[: last + 1])
    found = {name: one for name, one in found.items() if one[1]}
    if "energy" in run and last > 2:
        found["power by way"] = _power(run, last)
    rows = max(50, min(SAMPLES, most // max(1, sum(v.shape[1] for _, _, v in found.values()))))
    channels = {}
    for name, (unit, labels, values) in found.items():
        time, thin = thinned_samples(run["time"][: last + 1], _sound(values), rows)
        scale = float(f"{max(np.abs(thin).max(initial=0.0), 1e-12) / 9999:.4g}")
        channels[name] = {
            "unit": unit,
            "labels": labels,
            "sides": [side_of(label) for label in labels],
            "times": [float(f"{t:.6g}") for t in time],
            "scale": scale,
            "values": np.round(thin.T / scale).astype(int).tolist(),
        }
    return channels


def _column_table(model: Model, run: Trajectory, name: str, values: np.ndarray) -> tuple[str, list[str], np.ndarray]:
    """Find unit, labels and (samples, columns) of a channel; energies are summed over joints, forces over links."""
    channel, unit = BY_NAME.get(name), unit_of(name, [joint.type for joint in model.moving_joints])
    if name == "contact_force" and values.ndim == 3 and values.shape[1] == len(model.contacts):
        links = [point.link for point in model.contacts]
        normal = values[..., column_of(name, "normal")]
        table = {f"{link}": normal[:, [x == link for x in links]].sum(axis=1) for link in dict.fromkeys(links)}
        return f"{unit}, normal", list(table), np.stack(list(table.values()), axis=1)
    found = by_pair(run.channels, run.info, name)
    if found is not None:
        labels, lines = lines_of(found, name)
        return unit, labels, lines[: len(values)]
    summed = channel is not None and channel.unit == "J"
    known = model.position_names if name == "q" else model.joint_names
    labels = joint_labels(run.info, name) or list(known)
    return unit, *columns_of(name, values, labels, summed)


def lines_of(table: PairTable, name: str) -> tuple[list[str], np.ndarray]:
    """Flatten a channel by pairs of links to labels and columns (samples, n), of the pairs that push or are near."""
    values = table.values
    several = values.ndim == 3
    says = np.isfinite(values) & (values != 0.0)
    used = np.flatnonzero(says.any(axis=(0, 2) if several else 0))
    labels = [table.labels[k] for k in used]
    if several:
        labels = [f"{label} {axis}" for label in labels for axis in BY_NAME[name].labels]
    return labels, np.where(np.isfinite(values), values, np.nan)[:, used].reshape(len(values), -1)


def columns_of(name: str, values: np.ndarray, joints: Sequence[str], summed: bool) -> tuple[list[str], np.ndarray]:
    """Flatten a channel to labels and columns (samples, n); summed: of all joints or points together."""
    channel, several = BY_NAME.get(name), not (summed and values.ndim == 3)
    flat = values.reshape(len(values), -1) if several else values.sum(axis=1)
    named = joints if several and (channel is None or channel.of in ("joint", "servo", "rotor", "row")) else ()
    choices = (named, channel.labels if channel is not None else (), [str(k) for k in range(flat.shape[1])])
    return next(list(labels) for labels in choices if len(labels) == flat.shape[1]), flat


def _power(run: Trajectory, last: int) -> tuple[str, list[str], np.ndarray]:
    """Compute the power of all joints together by its kind [W], as the mean over 1/50 s around each sample."""
    energy = run["energy"][: last + 1].sum(axis=1)
    time = run["time"][: last + 1]
    k = max(1, round(0.01 / _step(run)))
    before, after = np.maximum(np.arange(len(time)) - k, 0), np.minimum(np.arange(len(time)) + k, len(time) - 1)
    power = (energy[after] - energy[before]) / (time[after] - time[before])[:, None]
    labels = list(BY_NAME["energy"].labels)
    keep = [j for j in range(len(labels)) if j != SUPPLY]
    return "W", [labels[j] for j in keep], power[:, keep]


def thinned_samples(time: np.ndarray, values: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Thin values (n, columns) to about `most` samples, the least and the largest of each stretch, so peaks stay."""
    n = len(time)
    if n <= most:
        return time, values
    size = math.ceil(2 * n / most)
    whole = n // size * size
    parts = values[:whole].reshape(-1, size, values.shape[1])
    first = parts.argmin(axis=1) <= parts.argmax(axis=1)
    low, high = parts.min(axis=1), parts.max(axis=1)
    pairs = np.stack([np.where(first, low, high), np.where(first, high, low)], axis=1).reshape(-1, values.shape[1])
    begin = time[:whole:size]
    span = time[size - 1 : whole : size] - begin
    times = np.stack([begin + 0.25 * span, begin + 0.75 * span], axis=1).reshape(-1)
    ends = np.r_[time[:1], times, time[-1:]]
    return ends, np.vstack([values[:1], pairs, values[-1:]])
