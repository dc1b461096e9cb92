"""Read a study from TOML, strictly.

    robot, locked, base     as `load_robot` takes them
    experiment              "hold", "walk" or "stable_step", see `measures`
    duration                of a run of hold or stable_step [s]; default 10
    strides, warm_up        of a run of walk: strides that are measured, and before them; default 8 and 2
    [scene] [servo] [gearbox] [supply] [ground] [posture] [gait]    parameters of all runs
    [vary]                  the parameters that differ, by the same names, with a list of values or, for a number,
                            {from, to, scale = "linear" or "log"}, and for a grid its count
    [worlds]                random numbers of each run (`draws`); not for a grid
    [sampling]              method = "grid" (default), "random", "latin_hypercube" or, for Sobol's indices
                            (`sensitivity`), "saltelli"; the last three have count and seed.  For "saltelli" the count,
                            a power of two, is the number of base samples: with p parameters, including those of
                            [worlds], it makes count (p + 2) runs

`PARAMETERS` lists all names and units; values are SI.  `servo`, which has its controller's numbers too, and `gearbox`
change all servos of the robot; `supply` changes its voltage supply or gives it one.  `gait.file` names a gait that
`walking.read_walk` reads, beside the study or in the robot's folder, instead of one that the other `gait.*` plan.

Runs are numbered with the last parameter changing fastest.  `posture` and `gait` come last: they do not change the
scene, so that neighbors share it.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Collection, Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, get_args

import numpy as np

from .. import __version__
from ..base.arguments import HUGE, one_of, real, whole
from ..base.brief import brief, in_full
from ..base.files import FilePath, is_number
from ..core.compile.jit import source_hash
from ..core.integrate import INTEGRATORS
from ..model import SERVO_UNITS, Gearbox, Ground, Law, Model, Supply
from ..robot_file import load_robot, load_servo
from ..robot_file.servos import without_actuators
from ..robot_file.toml import check_keys, table_of, written
from ..run.worlds import servo_with
from ..scene.actuator import servo_gearbox
from ..scene.compile import CompiledScene, compile_scene
from ..scene.gearbox_kinds import GEARBOX_KINDS
from .draws import OFFSET, Draw, read_draws

if TYPE_CHECKING:
    from ..walking.feedback import BalancedWalk
    from ..walking.motion import Motion

    Walk: TypeAlias = Motion | BalancedWalk

MOST_RUNS, MOST_NUMBERS = 20_000_000, 100_000_000
FEWER = f"at most {MOST_RUNS} runs are allowed, make several studies of more"
_GEARS = [f.name for f in fields(Gearbox)]
UNITS = {
    "servo": {name: unit for name, unit in SERVO_UNITS.items() if name not in _GEARS},
    "gearbox": {name: SERVO_UNITS[name] for name in _GEARS},
    "supply": {f.name: f.metadata["unit"] for f in fields(Supply)},
    "ground": {"friction": "-", "penetration": "m", "damping_ratio": "-", "height": "m", "slope": "rad"},
    "posture": {"tilt": "rad"},
    "gait": {  # period: of a stride, two steps
        "period": "s", "step_length": "m", "com_height": "m", "half_width": "m", "lift": "m", "double_support": "-",
    },
}  # fmt: skip
# Name -> unit of a number, or the values that are allowed (None: any text).
PARAMETERS: dict[str, str | Collection | None] = {
    "scene.gearbox": (*GEARBOX_KINDS, "none"),
    "scene.ground": (True, False),
    "scene.integrator": INTEGRATORS.keys(),
    "scene.timestep": "s",
    "scene.fall_height": "-",
    "scene.fall_tilt": "rad",
    "servo.type": None,
    "servo.gearbox": None,
    "servo.law": get_args(Law),
    **{f"{section}.{name}": unit for section, units in UNITS.items() for name, unit in units.items()},
    "gait.file": None,
}
SECTIONS = tuple(dict.fromkeys(name.partition(".")[0] for name in PARAMETERS))
# Settings and sections that not all experiments read; the sections leave the scene as it is.
FOREIGN = {"hold": ("strides", "warm_up"), "walk": ("duration",), "stable_step": ("strides", "warm_up")}
ONLY = {"posture": ("hold", "stable_step"), "gait": ("walk",)}
LEAST_DURATION = 1e-9  # [s]
METHODS = ("grid", "random", "latin_hypercube", "saltelli")


@dataclass(frozen=True)
class Setup:
    """The inputs of a worker; setups are equal if the digests of all inputs of the results are."""

    digest: str
    model: Model = field(compare=False)
    experiment: str = field(compare=False)
    duration: float = field(compare=False)  # [s]
    strides: int = field(compare=False)
    warm_up: int = field(compare=False)
    fixed: dict[str, Any] = field(compare=False)  # parameters of all runs
    names: tuple[str, ...] = field(compare=False)  # of those that vary
    draws: tuple[Draw, ...] = field(compare=False)  # beside them
    walks: dict[str, Walk] = field(compare=False)  # by `gait.file`

    __repr__ = brief


class Axis(NamedTuple):
    """The values of a parameter: `values`, or, if there are none, any between `low` and `high`."""

    values: tuple[Any, ...]
    low: float = 0.0
    high: float = 1.0
    log: bool = False

    def at(self, u: float) -> Any:
        """Return the value at the fraction u in [0, 1) of the axis."""
        if self.values:
            return self.values[int(u * len(self.values))]
        if self.log:
            return self.low * (self.high / self.low) ** u
        return self.low + u * (self.high - self.low)


@dataclass(frozen=True, eq=False)
class Study:
    """A study, ready to run; `read_study` makes it.

    Attributes
    ----------
    name : str
        Name of the study, that of its file.
    setup : Setup
        What workers need.
    axes : tuple of Axis
        The values of each varied parameter.
    shares : ndarray, shape (runs, axes and draws), or None
        Where each run lies along each axis, in [0, 1); None for a grid.
    settings : dict
        All inputs of the results, as JSON.
    """

    name: str
    setup: Setup
    axes: tuple[Axis, ...]
    shares: np.ndarray | None
    settings: dict[str, Any]

    __repr__ = brief

    def __len__(self) -> int:
        """Count the runs."""
        return math.prod(len(axis.values) for axis in self.axes) if self.shares is None else len(self.shares)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all varied parameters and draws."""
        return (*self.setup.names, *(draw.name for draw in self.setup.draws))

    def values(self, run: int) -> tuple:
        """Find the varied parameters of a run, in the order of `names`; draws are arrays, in units of their scale."""
        if self.shares is not None:
            own = self.shares[run]
            places = np.cumsum([len(self.axes), *(draw.numbers for draw in self.setup.draws)])
            drawn = (d.spread.at(own[k : k + d.numbers]) for d, k in zip(self.setup.draws, places.tolist()))
            return (*(axis.at(u) for axis, u in zip(self.axes, own.tolist())), *drawn)
        listed = [axis.values for axis in self.axes]
        chosen = np.unravel_index(run, [len(values) for values in listed])
        return tuple(values[k] for values, k in zip(listed, chosen))

    def cells(self, run: int) -> tuple:
        """Find the same for the table, where draws are their mean, in units of their scale."""
        return tuple(math.fsum(x.tolist()) / x.size if isinstance(x, np.ndarray) else x for x in self.values(run))


def read_study(path: FilePath) -> Study:
    """Read a study from a TOML file.

    Parameters
    ----------
    path : path
        Of the file.

    Returns
    -------
    Study

    Raises
    ------
    ValueError
        Something is wrong in the file; the message names file, key, value, what is allowed and a remedy.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            table = tomllib.load(file)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not a TOML file ({error}); correct it there") from error
    try:
        return _study(path, table)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _study(path: Path, table: dict) -> Study:
    own = ("robot", "locked", "base", "experiment", "duration", "strides", "warm_up", "sampling", "vary", "worlds")
    check_keys(table, (*own, *SECTIONS), "top level")
    experiment = one_of("experiment", table.get("experiment"), FOREIGN)
    for key in FOREIGN[experiment]:
        if key in table:
            raise ValueError(f"{key} is not used by experiment {experiment!r}: remove it")
    sampling = _sampling(table_of(table, "sampling", ""))
    fixed = {name: _value(name, value) for name, value in _parameters(table, experiment)}
    worlds = table_of(table, "worlds", "")
    axes = _axes(table_of(table, "vary", ""), experiment, sampling, bool(worlds))
    for name in axes:
        if name in fixed:
            raise ValueError(f"{name} is both in [{name.partition('.')[0]}] and in [vary]; keep one of the two")
    model = _model(path, table)
    _check_values(model, fixed, axes)
    draws = _draws(worlds, model, fixed, axes, experiment, sampling)
    walks = _walks(path, model, fixed, axes)
    for name, walk in walks.items():
        if hasattr(walk, "feedback") and any(draw.section == "reference" for draw in draws):
            raise ValueError(f"gait.file {name!r} has feedback, which computes its own references: remove {OFFSET}")
    shares = _shares(sampling, [1] * len(axes) + [draw.numbers for draw in draws])
    settings = {
        "robot": _digest(in_full(replace(model, notes=(), source=""))),
        "experiment": experiment,
        "duration": real("duration", table.get("duration", 10.0), LEAST_DURATION, HUGE, "give seconds"),
        "strides": whole("strides", table.get("strides", 8), 1, "give how many are measured"),
        "warm_up": whole("warm_up", table.get("warm_up", 2), 0, "give how many come before"),
        "fixed": fixed,
        "sampling": sampling,
        "vary": {name: list(axis) for name, axis in axes.items()},
        "worlds": {draw.name: [*asdict(draw.spread).values(), draw.shape] for draw in draws},
        "gaits": {name: walk.digest() for name, walk in walks.items()},
        "shares": None if shares is None else _digest(shares.tobytes()),
        "version": __version__,
        "kernels": source_hash(),
    }
    settings = json.loads(json.dumps(settings))
    digest = _digest(json.dumps(settings))
    runs = {key: settings[key] for key in ("experiment", "duration", "strides", "warm_up")}
    setup = Setup(digest, model, fixed=fixed, names=tuple(axes), draws=draws, walks=walks, **runs)
    study = Study(path.stem, setup, tuple(axes.values()), shares, settings)
    whole("the number of combinations", len(study), 0, FEWER, MOST_RUNS)
    return study


def _model(path: Path, table: dict) -> Model:
    """Load the robot; a .urdf file is beside the study."""
    robot = table.get("robot")
    if not isinstance(robot, str):
        raise ValueError(f"robot is {'missing' if robot is None else repr(robot)}; give a name in quotes")
    source = path.parent / robot if robot.endswith(".urdf") else robot
    base: Any = one_of("base", table["base"], ("fixed", "floating")) if "base" in table else None
    locked = table.get("locked")
    if not isinstance(locked, (str, list, dict, type(None))):
        raise ValueError(f"locked is {locked!r}; give a set of the robot, a list of joints or a table of positions")
    return load_robot(source, base, locked)


def _draws(
    worlds: dict, model: Model, fixed: dict, axes: dict[str, Axis], experiment: str, sampling: dict
) -> tuple[Draw, ...]:
    if not worlds:
        return ()
    if sampling["method"] == "grid":
        remedy = 'add [sampling] method = "latin_hypercube", count'
        raise ValueError(f"worlds need random numbers, which a grid does not have; {remedy}")
    if experiment == "stable_step":
        raise ValueError(f"worlds are not used by experiment {experiment!r}: remove them")
    first = {name: axis.at(0.0) for name, axis in axes.items()}
    return read_draws(worlds, scene_of(model, {**fixed, **first}))


def _walks(path: Path, model: Model, fixed: dict, axes: dict[str, Axis]) -> dict[str, Walk]:
    """Read the gaits that are named by files."""
    files = axes["gait.file"].values if "gait.file" in axes else [fixed[key] for key in ("gait.file",) if key in fixed]
    planned = [name for name in (*fixed, *axes) if name.startswith("gait.") and name != "gait.file"]
    if files and planned:
        raise ValueError(f"gait.file is a whole gait and {planned[0]} plans another; keep one of the two")
    if not files:
        return {}
    from ..walking.feedback import read_walk

    folders, found = [path.parent, *([Path(model.source).parent] if model.source else [])], {}
    for name in files:
        try:
            places = [folder / name for folder in folders if (folder / name).is_file()]
        except (OSError, ValueError):  # no name of a file
            places = []
        if not places:
            raise ValueError(f"gait.file is {name!r}, which is neither in {' nor in '.join(map(str, folders))}")
        found[name] = read_walk(places[0], model.joint_names)
    return found


def _parameters(table: dict, experiment: str, where: str = "") -> Iterator[tuple[str, Any]]:
    """Yield name and value of every parameter in the sections of a table, in its order."""
    for section in [key for key in table if key in SECTIONS]:
        for key, value in table_of(table, section, where).items():
            name = f"{section}.{key}"
            if name not in PARAMETERS:
                known = [other for other in PARAMETERS if other.startswith(section + ".")]
                raise ValueError(f"{where}{name} is not a parameter; use one of {', '.join(known)}")
            found = name == "scene.timestep" and experiment == "stable_step"
            if found or experiment not in ONLY.get(section, (experiment,)):
                raise ValueError(f"{where}{name} is not used by experiment {experiment!r}: remove it")
            yield name, value


def _value(name: str, value: Any) -> Any:
    """Check a single value of a parameter, as far as that is possible without the others."""
    kind = PARAMETERS[name]
    if isinstance(kind, str):
        if not is_number(value) and value not in (math.inf, -math.inf):
            raise ValueError(f"{name} is {value!r}; give a number [{kind}], or vary it under [vary]")
        return float(value)
    if kind is None and not isinstance(value, str):
        raise ValueError(f"{name} is {value!r}; give a name in quotes")
    if kind is not None and (value not in kind or type(value) is not type(next(iter(kind)))):
        raise ValueError(f"{name} is {value!r}; use one of {', '.join(map(written, kind))}")
    return value


def _axes(vary: dict, experiment: str, sampling: dict, drawn: bool) -> dict[str, Axis]:
    if not {"links", "link", "joints", "joint"}.isdisjoint(vary):
        raise ValueError(
            "vary: numbers of links and joints are drawn at random, under [worlds]; to try certain values, give a "
            "robot file and a study for each"
        )
    check_keys(vary, SECTIONS, "vary")
    found = {name: _axis(name, value, sampling) for name, value in _parameters(vary, experiment, "vary.")}
    if not found and not drawn:
        raise ValueError("vary is empty; name at least one parameter, for instance [vary] servo.Kp = [30.0, 60.0]")
    order = sorted(found, key=lambda name: name.partition(".")[0] in ONLY)
    return {name: found[name] for name in order}


def _axis(name: str, value: Any, sampling: dict) -> Axis:
    if isinstance(value, list) and value:
        values = tuple(_value(name, each) for each in value)
        if len(set(values)) < len(values):
            raise ValueError(f"vary.{name} is {value!r}; give every value once")
        return Axis(values)
    if isinstance(value, dict) and isinstance(PARAMETERS[name], str):
        return _range(name, value, sampling)
    remedy = "" if not isinstance(PARAMETERS[name], str) else " or a table {from = ..., to = ...}"
    raise ValueError(f"vary.{name} is {value!r}; give a list of values{remedy}")


def _range(name: str, table: dict, sampling: dict) -> Axis:
    what, grid = f"vary.{name}", sampling["method"] == "grid"
    check_keys(table, ("from", "to", "scale", *(("count",) if grid else ())), what)
    if not {"from", "to"} <= table.keys() or (grid and "count" not in table):
        raise ValueError(f"{what} is {table!r}; give from and to{', and for a grid the count of values' * grid}")
    low, high = (_value(name, table[key]) for key in ("from", "to"))
    log = one_of(what + ".scale", table.get("scale", "linear"), ("linear", "log")) == "log"
    if not -math.inf < low < high < math.inf or (log and low <= 0):
        raise ValueError(f"{what} goes from {low} to {high}; give two finite numbers that rise{', > 0' * log}")
    if not grid:
        return Axis((), low, high, log)
    count = whole(what + ".count", table["count"], 2, f"give how many values; {FEWER}", MOST_RUNS)
    spaced = np.geomspace if log else np.linspace
    return Axis(tuple(float(f"{x:.15g}") for x in spaced(low, high, count)))


def _sampling(table: dict) -> dict:
    check_keys(table, ("method", "count", "seed"), "sampling")
    method = one_of("sampling.method", table.get("method", "grid"), METHODS)
    if method == "grid":
        check_keys(table, ("method",), "sampling of a grid")
        return {"method": method}
    if "count" not in table:
        raise ValueError(f"sampling.count is missing; give the number of runs of {method!r}")
    count = whole("sampling.count", table["count"], 1, f"give how many runs; {FEWER}", MOST_RUNS)
    if method == "saltelli" and count & (count - 1):
        raise ValueError(f"sampling.count is {count}; 'saltelli' takes a power of two: {2 ** count.bit_length()}")
    seed = whole("sampling.seed", table.get("seed", 0), 0, "any will do")
    return {"method": method, "count": count, "seed": seed}


def _shares(sampling: dict, widths: list[int]) -> np.ndarray | None:
    """Draw where each run lies along each axis (runs, axes), in [0, 1), `widths` numbers per name; None for a grid."""
    if sampling["method"] == "grid":
        return None
    generator, width = np.random.default_rng(sampling["seed"]), sum(widths)
    numbers = sampling["count"] * width * (len(widths) + 2 if sampling["method"] == "saltelli" else 1)
    if numbers > MOST_NUMBERS:
        raise ValueError(
            f"sampling.count {sampling['count']} draws {numbers} numbers; at most {MOST_NUMBERS} are allowed: take a "
            "smaller count, or worlds that are alike"
        )
    if sampling["method"] == "random":
        return generator.random((sampling["count"], width))
    from scipy.stats import qmc

    if sampling["method"] == "saltelli":
        if 2 * width > qmc.Sobol.MAXDIM:
            raise ValueError(f"{width} numbers are drawn; 'saltelli' takes at most {qmc.Sobol.MAXDIM // 2}: use shared")
        drawn = qmc.Sobol(2 * width, seed=generator).random_base2(sampling["count"].bit_length() - 1)
        a, b = drawn[:, None, :width], drawn[:, None, width:]
        own = np.repeat(np.eye(len(widths), dtype=bool), widths, axis=1)  # the columns of each name
        shares = np.concatenate([a, b, np.where(own, b, a)], axis=1).reshape(-1, width)
    else:
        shares = qmc.LatinHypercube(width, seed=generator).random(sampling["count"])
    return np.minimum(shares, np.nextafter(1.0, 0.0))


def section_of(values: dict[str, Any], section: str) -> dict[str, Any]:
    """Select the parameters of a section, by their names in it."""
    return {name.partition(".")[2]: value for name, value in values.items() if name.startswith(f"{section}.")}


def servos_with(model: Model, values: dict[str, Any]) -> Model:
    """Change the robot's servos and supply by the parameters `servo.*`, `gearbox.*` and `supply.*`."""
    supply, given = section_of(values, "supply"), section_of(values, "servo") | section_of(values, "gearbox")
    if supply:
        if model.supply is None and "voltage" not in supply:
            raise ValueError(f"{model.name} has no supply to change; add supply.voltage")
        own = {} if model.supply is None else asdict(model.supply)
        model = replace(model, supply=Supply(**{**own, **supply}))
    if not given:
        return model
    kind, gearbox = given.pop("type", None), given.pop("gearbox", None)
    if gearbox is not None and kind is None:
        raise ValueError("servo.gearbox is a preset of a servo type and none is given: add servo.type")
    if kind is not None:
        servos = dict.fromkeys(model.joint_names, load_servo(kind, gearbox or "physical", **given))
        return replace(without_actuators(model, servos), servos=servos)
    if not model.servos:
        raise ValueError(f"{model.name} has no servos to change; add servo.type")
    return replace(model, servos={joint: servo_with(servo, given) for joint, servo in model.servos.items()})


def scene_of(model: Model, values: dict[str, Any]) -> CompiledScene:
    """Compile the scene that the parameters describe, without the draws."""
    model, given = servos_with(model, values), section_of(values, "scene")
    on_ground = given.pop("ground", model.base == "floating")
    gearbox = given.pop("gearbox", None) or servo_gearbox(model, None)
    ground = Ground(**section_of(values, "ground")) if on_ground else None
    return compile_scene(model, None if gearbox == "none" else gearbox, ground, **given)


def _check_values(model: Model, fixed: dict, axes: dict[str, Axis]) -> None:
    """Check every value that `servo`, `gearbox` and `ground` can take, one parameter at a time."""
    ends = {name: axis.values or (axis.low, axis.high) for name, axis in axes.items()}
    first = {name: values[0] for name, values in ends.items()}
    changes = [(name, value) for name, values in ends.items() for value in values]
    for change in [*([item] for item in changes), []]:
        point, what = fixed | first | dict(change), "".join(f"vary.{k} = {written(value)}: " for k, value in change)
        if not 0 < point.get("scene.timestep", 1.0) < math.inf:
            raise ValueError(f"{what}scene.timestep is {point['scene.timestep']} s; it must be positive and finite")
        try:
            servos_with(model, point)
            Ground(**section_of(point, "ground"))
        except ValueError as error:
            raise ValueError(f"{what}{error}") from error


def _digest(data: bytes | str) -> str:
    data = data.encode() if isinstance(data, str) else data
    return hashlib.sha256(data).hexdigest()[:16]
