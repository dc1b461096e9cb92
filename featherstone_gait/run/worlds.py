"""Describe worlds, the physical numbers in which the runs of a batch differ.

    worlds = Worlds(
        runs=1000,
        ground={"friction": Distribution("uniform", 0.2), "slope": np.linspace(0.0, 0.1, 1000)},
        servos={"resistance": Distribution("normal", 0.1), "voltage_limit": Distribution("uniform", 0.05, shared=True)},
        links={"mass": Distribution("lognormal", 0.1)},
    )
    trajectories = simulate_batch(scene, 4.0, references=[gait] * 1000, worlds=worlds)

Each run has the same bits as alone in the scene of its world, `worlds.scenes(scene)[k]`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, TypeAlias, get_args
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, instance, listed, one_of, real, shown, truth, whole
from ..base.brief import brief
from ..base.portable_math import exp
from ..model import LARGEST, Controller, Gearbox, Ground, HeightField, Servo, Supply
from ..scene.compile import CompiledScene

Kind = Literal["uniform", "normal", "lognormal"]
MOST_RUNS = 10**7
WIDEST = 10.0  # relative scale
LEAST_SHARE = 2.0**-53  # of a normal distribution, beyond which nothing is drawn
FIELDS = {  # numbers that may differ, by section
    "ground": tuple(f.name for f in dataclasses.fields(Ground) if f.name not in ("steps", "field", "lines")),
    "servos": tuple(
        f.name
        for part in (Servo, Gearbox, Controller)
        for f in dataclasses.fields(part)
        if f.name not in ("controller", "gearbox", "law", "wrap")
    ),
    "links": ("mass", "center_of_mass", "inertia", "gravity_compensation"),
    "joints": ("damping", "friction", "armature", "effort", "lower", "upper", "stiffness", "spring_reference"),
    "supply": tuple(f.name for f in dataclasses.fields(Supply)),
    "places": ("position",),
    "pairs": ("penetration", "damping_ratio", "friction"),
}
WHOLE = ("ground", "supply", "pairs")  # of which a scene has one

INFINITE = (  # numbers that may be infinite
    "stiffness", "current_limit", "current_slew", "torque_limit", "profile_speed", "effort", "lower", "upper"
)  # fmt: skip
_OWNER = {f.name: part for part in (Controller, Gearbox, Servo) for f in dataclasses.fields(part)}


@dataclass(frozen=True)
class Distribution:
    """The distribution of a number that is drawn for each run, about the number of the scene.

    Attributes
    ----------
    kind : {"uniform", "normal", "lognormal"}
        "uniform": the scene's number times 1 + scale u, with u uniform in [-1, 1); "normal": times 1 + scale n, with n
        of standard normal distribution; "lognormal": times exp(scale n).
    scale : float
        Relative width; absolute, in the number's unit, if `additive`.
    additive : bool
        Add scale u or scale n to the scene's number instead.
    shared : bool
        Draw once for all servos, links or joints of a run, not for each.

    Raises
    ------
    ValueError
        For unknown kinds, scales out of range, and an additive lognormal distribution.
    """

    kind: Kind
    scale: float
    additive: bool = False
    shared: bool = False

    __repr__ = brief

    def __post_init__(self) -> None:
        one_of("distribution: kind", self.kind, get_args(Kind))
        truth("distribution: additive", self.additive)
        truth("distribution: shared", self.shared)
        most = LARGEST if self.additive else WIDEST
        object.__setattr__(self, "scale", real("distribution: scale", self.scale, 0.0, most, "0.1 is a tenth"))
        if self.additive and self.kind == "lognormal":
            raise ValueError("distribution: additive is True, kind 'lognormal' is a factor; use 'normal' or 'uniform'")

    def drawn(self, numbers: np.ndarray, runs: int, generator: np.random.Generator) -> np.ndarray:
        """Draw numbers (runs, ...) about those of the scene (parts, ...)."""
        size = (runs, *self.shape(numbers))
        x = generator.uniform(-1.0, 1.0, size) if self.kind == "uniform" else generator.standard_normal(size)
        return self.applied(numbers, x)

    def shape(self, numbers: np.ndarray) -> tuple[int, ...]:
        """Return the shape of what is drawn for one run about the numbers (parts, ...) of the scene."""
        return (1 if self.shared else len(numbers), *(numbers.shape[1:] if self.additive else ()))

    def at(self, shares: np.ndarray) -> np.ndarray:
        """Return the quantiles, in widths, of shares in [0, 1)."""
        if self.kind == "uniform":
            return 2.0 * shares - 1.0
        from scipy.special import ndtri

        return ndtri(np.clip(shares, LEAST_SHARE, 1.0 - LEAST_SHARE))

    def applied(self, numbers: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the numbers (runs, parts, ...) of draws x (runs, *shape) in widths."""
        if self.additive:
            return numbers + self.scale * x
        factors = exp(self.scale * x) if self.kind == "lognormal" else 1.0 + self.scale * x
        return numbers * factors.reshape(*x.shape, *[1] * (numbers.ndim - 1))


Values: TypeAlias = ArrayLike | Distribution


class Column(NamedTuple):
    """One field of some parts in all runs."""

    section: str
    name: str
    parts: list[str]
    values: np.ndarray  # (runs, parts) or (runs, parts, numbers)


@dataclass(frozen=True, eq=False)
class Worlds:
    """The physical numbers in which runs differ; all other numbers are those of the scene.

    Attributes
    ----------
    runs : int
        Number of runs; may be left out where an array has it.
    ground, servos, links, joints, supply, places, pairs : dict
        Values by the names of fields: of `Ground`; `Servo` with its `Gearbox` and `Controller`; `Link`; `Joint`;
        `Supply`, in their units; "position" of `Placed`, where runs start that are given no state; and penetration,
        damping_ratio and friction of `PairContact`, for all pairs and shapes without friction.  A name stands
        for all servos, links, joints or members of the scene, "PART.name" for that of one.  A value is a number; an
        array (runs,); an array (runs, parts) in the order of the model (servos in the order of moving joints), with a
        last axis of 3 or 6 for centers of mass and inertias, of 2 or 3 for positions; or a `Distribution` from which to
        draw.
    gravity : array_like or None
        Gravity (3,) or (runs, 3) [m/s^2].
    fields : sequence of HeightField
        The height field of the ground in each run; runs share lanes where all have as many nodes.  Empty: the scene's.
    seed : int
        Seed of the draws; those of a field do not depend on other fields, nor those of a run on the number of runs.

    Raises
    ------
    ValueError
        For unknown names and arrays that do not fit.

    Examples
    --------
    >>> worlds = Worlds(runs=100, ground={"friction": Distribution("uniform", 0.2)})
    >>> trajectories = simulate_batch(scene, 2.0, worlds=worlds)
    """

    runs: int | None = None
    ground: Mapping[str, Values] = field(default_factory=dict)
    servos: Mapping[str, Values] = field(default_factory=dict)
    links: Mapping[str, Values] = field(default_factory=dict)
    joints: Mapping[str, Values] = field(default_factory=dict)
    gravity: ArrayLike | None = None
    seed: int = 0
    supply: Mapping[str, Values] = field(default_factory=dict)
    places: Mapping[str, Values] = field(default_factory=dict)
    pairs: Mapping[str, Values] = field(default_factory=dict)
    fields: Sequence[HeightField] = ()

    __repr__ = brief

    def __post_init__(self) -> None:
        whole("worlds: seed", self.seed, 0, "it is the seed of the draws")
        sizes = {} if self.runs is None else {"runs": whole("worlds: runs", self.runs, 0, "give a number", MOST_RUNS)}
        for section, names in FIELDS.items():
            given = getattr(self, section)
            instance(f"worlds: {section}", given, Mapping, "give a dictionary, by name")
            checked = {name: _checked(section, names, name, value) for name, value in given.items()}
            object.__setattr__(self, section, checked)
            for name, value in checked.items():
                if isinstance(value, np.ndarray) and value.ndim > 0:
                    sizes[f"{section} {name}"] = len(value)
        if self.gravity is not None:
            gravity = floats("worlds: gravity", self.gravity, "give (3,) or (runs, 3) [m/s^2]")
            if gravity.ndim not in (1, 2) or gravity.shape[-1] != 3:
                raise ValueError(f"worlds: gravity has the shape {gravity.shape}; give (3,) or (runs, 3) [m/s^2]")
            object.__setattr__(self, "gravity", gravity)
            sizes |= {"gravity": len(gravity)} if gravity.ndim == 2 else {}
        object.__setattr__(self, "fields", tuple(listed("worlds: fields", self.fields, "give a HeightField for each")))
        for one in self.fields:
            instance("worlds: fields", one, HeightField, "give a HeightField for each run")
        sizes |= {"fields": len(self.fields)} if self.fields else {}
        if len(set(sizes.values())) != 1:
            found = ", ".join(f"{name} {size}" for name, size in sizes.items()) or "no runs and no array"
            raise ValueError(f"worlds: the number of runs is not clear: {found}; give arrays of one length, or runs")
        object.__setattr__(self, "runs", next(iter(sizes.values())))

    def __len__(self) -> int:
        """Return the number of runs."""
        assert self.runs is not None
        return self.runs

    def scenes(self, scene: CompiledScene, runs: Iterable[int] | None = None) -> list[CompiledScene]:
        """Return the scene of each world, with integrator and step of the scene; runs: which, all if None.

        Raises ValueError for parts that the scene does not have, and for numbers that make no scene.
        """
        columns = [*self.columns(scene)]
        return [self._scene(scene, columns, run) for run in (range(len(self)) if runs is None else runs)]

    def _scene(self, scene: CompiledScene, columns: list[Column], run: int) -> CompiledScene:
        changed: dict[str, dict[str, dict[str, Any]]] = {section: {} for section in FIELDS}
        for column in columns:
            for part, value in zip(column.parts, column.values[run].tolist()):
                changed[column.section].setdefault(part, {})[column.name] = value
        gravity = None if self.gravity is None else np.broadcast_to(self.gravity, (len(self), 3))[run]
        if self.fields:
            if scene.ground is None:
                raise ValueError(f"worlds: fields are given, but {scene.model.name} has no ground; give Ground()")
            changed["ground"].setdefault("", {})["field"] = self.fields[run]
        try:
            return _scene_with(scene, changed, gravity)
        except ValueError as error:
            raise ValueError(f"world {run}: {error}") from error

    def columns(self, scene: CompiledScene) -> Iterator[Column]:
        """Yield the numbers of each field in all runs; raise ValueError for parts that the scene does not have."""
        for section in FIELDS:
            for key, value in getattr(self, section).items():
                parts, numbers = nominal(scene, section, key)
                name = key.rpartition(".")[2]
                yield Column(section, name, parts, self._values(f"{section}.{key}", value, numbers))

    def _values(self, what: str, value: Values, numbers: np.ndarray) -> np.ndarray:
        """Return values (runs, parts, ...); numbers (parts, ...): those of the scene."""
        if isinstance(value, Distribution):
            return value.drawn(numbers, len(self), np.random.default_rng([self.seed, crc32(what.encode())]))
        array, shape = np.asarray(value), (len(self), *numbers.shape)
        if array.ndim == 1 and numbers.ndim == 1:  # an entry a run, for all parts
            return np.broadcast_to(array[:, None], shape)
        fits = array.ndim == 0 or (array.ndim == len(shape) and array.shape[1] in (1, shape[1]))
        if not fits or array.shape[2:] != shape[2 : array.ndim]:
            one = f"({shape[0]},)" if numbers.ndim == 1 else f"({shape[0]}, 1, {shape[2]})"
            raise ValueError(f"worlds: {what} has the shape {array.shape}; give a number, or an array {one} or {shape}")
        return np.broadcast_to(array, shape)


def nominal(scene: CompiledScene, section: str, key: str) -> tuple[list[str], np.ndarray]:
    """Return whose numbers a field stands for, and what they are in the scene (parts, ...).

    Raises ValueError for parts that the scene does not have.
    """
    parts = _parts(scene, section)
    part, _, name = key.rpartition(".")
    if part and part not in parts:
        raise ValueError(f"worlds: {section}: there is no {part!r}; use one of {', '.join(parts)}")
    if not parts:
        raise ValueError(f"worlds: {section}: {key} is given, but the scene of {scene.model.name} has none; remove it")
    chosen = {part: parts[part]} if part else parts
    if section == "places" and len({len(placed.position) for placed in chosen.values()}) > 1:
        raise ValueError("worlds: places: some members have positions of two numbers: name one, as 'ball.position'")
    return [*chosen], np.array([_number(owner, name) for owner in chosen.values()], dtype=float)


def _checked(section: str, names: Sequence[str], key: str, value: Values) -> Values:
    if not isinstance(key, str) or key.rpartition(".")[2] not in names or (section in WHOLE and "." in key):
        raise ValueError(f"worlds: {section}: there is no number {shown(key)}; use one of {', '.join(names)}")
    if isinstance(value, Distribution):
        return value
    array = floats(f"worlds: {section}: {key}", value, "give a number, an array with an entry a run, or a Distribution")
    if not np.isfinite(array).all() and key.rpartition(".")[2] not in INFINITE:
        raise ValueError(f"worlds: {section}: {key} has numbers that are not finite; correct them")
    return array


def _parts(scene: CompiledScene, section: str) -> dict[str, Any]:
    """Return the parts that have the numbers of a section, by name."""
    model = scene.model
    if section == "ground":
        return {} if scene.ground is None else {"": scene.ground}
    if section == "supply":
        return {} if scene.constants.supply is None else {"": model.supply}
    if section == "pairs":
        return {} if scene.options.pairs is None else {"": scene.options.pairs}
    if section == "places":
        return {member.name: member.placed for member in scene.members}
    if section == "servos":
        return {name: model.servos[name] for name in model.joint_names if scene.gearbox and name in model.servos}
    if section == "links":
        return {link.name: link for link in (model.links[1:] if scene.members else model.links)}  # not the world
    return {joint.name: joint for joint in model.joints if joint.type != "fixed"}


def _number(owner: Any, name: str) -> Any:
    for part in (owner, getattr(owner, "gearbox", None), getattr(owner, "controller", None)):
        if hasattr(part, name):
            return getattr(part, name)
    raise AssertionError(name)


def _scene_with(scene: CompiledScene, changed: dict[str, Any], gravity: np.ndarray | None) -> CompiledScene:
    """Return the scene compiled with other numbers, by section and part."""
    model = scene.model
    given: dict[str, Any] = {} if gravity is None else {"gravity": gravity}
    parts: dict[str, Any] = {}
    own = changed["servos"]
    if own:
        parts["servos"] = {name: servo_with(servo, own.get(name, {})) for name, servo in model.servos.items()}
    for section in ("links", "joints"):
        own = changed[section]
        if own:
            parts[section] = tuple(_with(part, own.get(part.name, {})) for part in getattr(model, section))
    if changed["supply"]:
        assert model.supply is not None
        parts["supply"] = dataclasses.replace(model.supply, **changed["supply"][""])
    if parts:
        model = model.with_numbers(**parts)
    if changed["ground"]:
        assert scene.ground is not None
        given["ground"] = dataclasses.replace(scene.ground, **changed["ground"][""])
    if changed["pairs"]:
        assert scene.options.pairs is not None
        given["pairs"] = dataclasses.replace(scene.options.pairs, **changed["pairs"][""])
    return scene.recompiled(model, places=changed["places"], **given)


def servo_with(servo: Servo, given: Mapping[str, Any]) -> Servo:
    """Return the servo with other numbers of its own, its gearbox and its controller, by name."""
    own = {name: value for name, value in given.items() if _OWNER[name] is Servo}
    for name, kind in (("controller", Controller), ("gearbox", Gearbox)):
        changed = {field: value for field, value in given.items() if _OWNER[field] is kind}
        if changed:
            own[name] = _with(getattr(servo, name), changed)
    return _with(servo, own)


def _with(record: Any, changed: Mapping[str, Any]) -> Any:
    """Replace fields as `dataclasses.replace` does, with the same checks, in half of its time."""
    if not changed:
        return record
    made = object.__new__(type(record))
    made.__dict__.update(record.__dict__, **changed)
    made.__post_init__()
    return made
