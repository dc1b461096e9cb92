"""Describe what a policy observes and what its actions mean, in TOML.

    rate = 50.0                        # [Hz] at which the policy is evaluated; inf: at each tick of the servos
    joints = ["left_hip", ...]         # that it drives, in its order
    pose = [0.0, ...]                  # [rad or m] reference pose, in the same order
    stiffness = [0.43, ...]            # [N m/rad] of the servos that it was trained with; for information
    [action]                           # reference = pose + scale * action
    scale = 0.25                       # a number, or one for each joint
    clip = 100.0                       # largest action, before the scale
    max_speed = 5.24                   # [rad/s] by which a reference moves at most
    lower, upper                       # [rad or m] of references, a number or one for each joint
    limits = true                      # references stay within the limits of the joints
    [[observation]]                    # blocks, in their order
    name = "joint_vel"                 # one of `BLOCKS`
    scale = 0.05
    history = 3                        # the newest and two older ones

Names of blocks are those that mjlab writes into the metadata of its ONNX files.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arguments import floats, listed, one_of, real, shown, texts, truth, whole
from ..base.brief import brief
from ..base.files import FilePath
from ..robot_file.toml import Wrong, check_keys, read_toml, table_of

BLOCKS = {  # what can be observed, and its width; None: one number a joint
    "base_lin_vel": 3,  # [m/s] of the base, in its axes; a robot needs an estimator for it
    "base_ang_vel": 3,  # [rad/s] gyroscope
    "projected_gravity": 3,  # [-] unit vector down, in the axes of the base
    "accelerometer": 3,  # [m/s^2] specific force, in the axes of the base
    "joint_pos": None,  # [rad or m] less the reference pose
    "joint_vel": None,  # [rad/s or m/s]
    "actions": None,  # what the policy has answered, as it answered
    "targets": None,  # [rad or m] the references that were sent last
    "command": 3,  # [m/s, m/s, rad/s] forward, to the left, about the vertical
    "phase": 2,  # [-] cosine and sine of the phase of a clock, or of each of several: cosines first
    "contacts": 1,  # [-] 1 of each link that touches the ground
    "constant": 1,  # the numbers of `values`
    "time": 1,  # [s] since the start
}
KEYS = ("rate", "joints", "pose", "stiffness", "action", "observation", "about")
MOST_HISTORY = 1000
FOLDER = Path(__file__).parent / "policies"


@dataclass(frozen=True)
class Block:
    """One block of an observation: scale * (value + offset)."""

    name: str  # one of `BLOCKS`
    scale: float | tuple[float, ...] = 1.0
    offset: float | tuple[float, ...] = 0.0
    history: int = 1  # how many of the last observations, the present one included
    oldest_first: bool = False
    period: float = 0.0  # of "phase" [s]
    phases: tuple[float, ...] = (0.0,)  # of "phase": where each clock begins [rad]
    links: tuple[str, ...] = ()  # of "contacts"
    values: tuple[float, ...] = ()  # of "constant"
    zeros: int = 0  # of "command": how many follow, for what is not commanded

    __repr__ = brief

    def __post_init__(self) -> None:
        one_of("observation: name", self.name, BLOCKS)
        what = f"observation {self.name!r}"
        for key in ("scale", "offset", "phases", "values"):
            _numbers(f"{what}: {key}", getattr(self, key))
        whole(f"{what}: history", self.history, 1, "1 is the present one alone", MOST_HISTORY)
        whole(f"{what}: zeros", self.zeros, 0, "0 is usual", 1000)
        for name, owner, needed in (("period", "phase", self.period), ("links", "contacts", self.links),
                                    ("values", "constant", self.values)):  # fmt: skip
            if self.name == owner and not needed:
                raise ValueError(f"{what}: {name} is missing; give it")
        if self.name == "phase":
            real(f"{what}: period", self.period, 1e-3, 1e6, "give the time of a turn of the clock [s]")

    def width(self, joints: int) -> int:
        """Return how many numbers one observation has, without its history."""
        own = BLOCKS[self.name]
        many = {"phase": 2 * len(self.phases), "contacts": len(self.links), "constant": len(self.values)}
        return joints if own is None else many.get(self.name, own) + self.zeros


@dataclass(frozen=True)
class Action:
    """Turn actions into references: reference = pose + scale * action, within bounds."""

    scale: float | tuple[float, ...] = 1.0  # [rad or m]
    clip: float = math.inf  # largest action
    max_speed: float = math.inf  # of a reference [rad/s or m/s]
    lower: float | tuple[float, ...] = -math.inf  # least and largest reference [rad or m]
    upper: float | tuple[float, ...] = math.inf
    limits: bool = True  # whether references stay within the limits of the joints

    __repr__ = brief

    def __post_init__(self) -> None:
        _numbers("action: scale", self.scale)
        for key in ("clip", "max_speed"):
            real(f"action: {key}", getattr(self, key), 0.0, math.inf, "leave it out for none")
        for key in ("lower", "upper"):
            if np.isnan(floats(f"action: {key}", getattr(self, key), "give a number, or one for each joint")).any():
                raise ValueError(f"action: {key} is {shown(getattr(self, key))}; give numbers, or leave it out")
        truth("action: limits", self.limits)


@dataclass(frozen=True)
class PolicyDescription:
    """Describe the observation of a policy and its actions.

    Attributes
    ----------
    joints : tuple of str
        Joints that the policy drives, in its order.
    pose : tuple of float
        Reference pose of these joints [rad or m].
    rate : float
        How often the policy is evaluated [Hz]; infinite: at each tick of the servos.
    observation : tuple of Block
        Blocks of the observation, in their order.
    action : Action
        How its actions become references.
    name : str
        Where the description comes from.
    stiffness : tuple of float
        Position gain of the servos with which it was trained [N m/rad]; empty where it is not known.

    Raises
    ------
    ValueError
        For what is missing, named, and for lists of other lengths than `joints`.
    """

    joints: tuple[str, ...]
    pose: tuple[float, ...]
    rate: float
    observation: tuple[Block, ...]
    action: Action = field(default_factory=Action)
    name: str = "policy"
    stiffness: tuple[float, ...] = ()

    __repr__ = brief

    def __post_init__(self) -> None:
        real(f"{self.name}: rate", self.rate, 1e-3, math.inf, "give how often the policy is evaluated [Hz]")
        n = len(self.joints)
        if len({*self.joints}) < n:
            raise ValueError(f"{self.name}: joints name {_twice(self.joints)!r} twice; name each joint once")
        for what in ("pose", "stiffness"):
            if len(getattr(self, what)) not in ((n,) if what == "pose" else (0, n)):
                given = len(getattr(self, what))
                raise ValueError(f"{self.name}: {what} has {given} numbers; give {n}, one for each of joints")
        for what, width, owner in [
            *(("scale", n, self.action), ("lower", n, self.action), ("upper", n, self.action)),
            *((what, block.width(n), block) for block in self.observation for what in ("scale", "offset")),
        ]:
            value = getattr(owner, what)
            if isinstance(value, tuple) and len(value) != width:
                where = getattr(owner, "name", "action")
                raise ValueError(f"{self.name}: {where}: {what} has {len(value)} numbers; give one, or {width}")

    @property
    def size(self) -> int:
        """How many numbers are observed."""
        return sum(block.width(len(self.joints)) * block.history for block in self.observation)


def _twice(names: Sequence[str]) -> str:
    return next(name for k, name in enumerate(names) if name in names[:k])


def packaged_descriptions() -> tuple[str, ...]:
    """Return the names of the descriptions that come with the package.

    Returns
    -------
    tuple of str
        Names that `read_description` takes.
    """
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def read_description(source: FilePath, metadata: Mapping[str, Any] | None = None) -> PolicyDescription:
    """Read the description of a policy.

    Parameters
    ----------
    source
        Name of a description of the package (`packaged_descriptions`), or a TOML file.
    metadata
        What the policy's own file says, by the same keys: it goes before a description of the package, which is that of
        all policies of a robot, and after a file.

    Returns
    -------
    PolicyDescription
        The description.

    Raises
    ------
    ValueError
        Naming the file and what is missing, unknown or wrong.
    """
    path, packaged, says = Path(source), str(source) in packaged_descriptions(), dict(metadata or {})
    if packaged:
        path = FOLDER / f"{source}.toml"
    elif not path.exists():
        known = ", ".join(packaged_descriptions())
        raise ValueError(f"description {source}: there is no such file; give a TOML file, or one of {known}")
    try:
        own = read_toml(path)
        later, sooner = (own, says) if packaged else (says, own)
        action = {**table_of(later, "action", ""), **table_of(sooner, "action", "")}
        return description_of({**later, **sooner, "action": action}, path.stem)
    except (Wrong, ValueError, TypeError) as error:
        raise ValueError(f"{path}: {str(error).removeprefix(f'{path.stem}: ')}") from error


def description_of(table: Mapping[str, Any], name: str) -> PolicyDescription:
    """Return the description in a table; raise ValueError, naming what is missing."""
    check_keys(table, KEYS, name)
    needed = {"rate": "rate = 50.0 [Hz]", "joints": 'joints = ["left_knee", ...] in the order of the policy',
              "pose": "pose = [0.0, ...], the reference pose [rad]",
              "observation": "observation, a table with a name for each block"}  # fmt: skip
    missing = [remedy for key, remedy in needed.items() if key not in table]
    if missing:
        raise ValueError(f"{name}: it lacks {'; '.join(missing)}; add that to its description")
    blocks = []
    for k, row in enumerate(listed("observation", table["observation"], "write each block under [[observation]]")):
        if not isinstance(row, Mapping) or "name" not in row:
            known = ", ".join(BLOCKS)
            raise ValueError(f"{name}: observation {k} has no name; write [[observation]] and name = one of {known}")
        check_keys(row, tuple(f.name for f in fields(Block)), f"observation {row['name']}")
        blocks.append(Block(**{key: _frozen(value) for key, value in row.items()}))
    action = table_of(table, "action", "")
    check_keys(action, tuple(f.name for f in fields(Action)), "action")
    numbers = {key: _numbers(f"{name}: {key}", table.get(key, ())) for key in ("pose", "stiffness")}
    return PolicyDescription(
        tuple(texts(f"{name}: joints", table["joints"])), numbers["pose"], table["rate"], tuple(blocks),
        Action(**{key: _frozen(value) for key, value in action.items()}), name, numbers["stiffness"],
    )  # fmt: skip


def _numbers(what: str, given: Any) -> tuple[float, ...]:
    """Return a number or a list of numbers as a tuple; raise ValueError for others."""
    found = np.atleast_1d(floats(what, given, "give numbers"))
    if found.ndim != 1 or not np.isfinite(found).all():
        raise ValueError(f"{what} is {shown(given)}; give finite numbers")
    return tuple(found.tolist())


def _frozen(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
