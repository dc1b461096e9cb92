"""Read scenes from TOML: the files of robots, objects and obstacles of one shape, ground and gravity.

::

    name = "kitchen"                     # else the file's
    gravity = [0.0, 0.0, -9.81]
    excluded = [["left/hand", "cup/body"]]         # links that do not touch each other
    pairs = "all"                        # what touches each other: or "none", or [["left", "cup"], ...]; or a table
                                         # [pairs] with fields of PairContact: select, penetration, friction, ...

    [ground]                             # fields of Ground: friction, penetration, damping_ratio, height, slope, ...
    friction = 0.8

    [fluid]                              # fields of Fluid: density, viscosity, level, current
    density = 1000.0                     # around what robots state as [[immersed]]
    level = 0.5

    [[robots]]
    file = "arm.urdf"                    # beside this file; or a name of robot_names()
    name = "left"
    position = [0.0, 0.3, 0.0]           # of two numbers, x and y, a floating robot stands on the ground there
    rpy = [0.0, 0.0, 1.5]                # or orientation = [w, x, y, z]
    gearbox = "rotor"                    # or "none"; without it that of the scene
    locked = "default"                   # base, locked, contacts: as load_robot takes them
    servos = {default = "ax12"}          # in place of those of the robot's files

    [[objects]]
    name = "cup"
    shape = "cylinder"                   # or sphere, capsule, box, mesh, hull, with their fields
    radius = 0.04
    length = 0.1
    mass = 0.2
    friction = 0.5
    rolling_friction = 0.001             # also torsional_friction; obstacles have these three as well

    [[obstacles]]                        # never move
    name = "table"
    shape = "box"
    size = [0.8, 0.8, 0.02]
    position = [0.5, 0.0, 0.7]
    surface = {velocity = [0.5, 0.0, 0.0], drive = "belt"}   # fields of Surface; objects have it as well

    [[frictions]]                        # fields of PairFriction: in place of what follows from the two
    a = "cup"
    b = "table"
    friction = 0.3

    [[loops]]                            # fields of Loop: between links of two robots or objects, or one and the world
    name = "grip"
    kind = "weld"
    a = "left/hand"
    b = "cup/body"
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, cast

from ..geometry.body import body
from ..model import FloorLine, Fluid, Ground, Loop, Model
from ..model.pair_contact import PairContact, PairWord
from ..model.pair_friction import FIELDS, PairFriction
from ..model.placed import OF_SCENE, Placed, SceneModel
from .load import load_robot
from .report import Report
from .sensors import read_sensors
from .servos import read_servos
from .settings import records_of
from .simtwo.read import quaternion_from_rpy
from .source import robot_names
from .toml import (
    Problems,
    at,
    beside,
    check_keys,
    geometry_of,
    kind_of,
    name_pairs_of,
    number,
    read_toml,
    real,
    record,
    string,
    surface,
    table_of,
    truth,
    vector,
)

TOP = (
    "name", "gravity", "excluded", "pairs", "ground", "fluid", "robots", "objects", "obstacles", "frictions", "loops",
)  # fmt: skip
PLACE = ("name", "position", "orientation", "rpy")
OF_ROBOT = ("file", "base", "locked", "contacts", "gearbox", "ground_contact", "servos")
PLANAR = ("velocity", "center")  # of the ground, two numbers each
NO_SERVOS = "none"  # as a gearbox
PAIRS = 'write "all", "none", or [["robot/hand", "cup"], ...]'


def read_scene_toml(path: Path, strict: bool) -> SceneModel:
    """Read a scene; raise ValueError for what the file says wrongly, each with its line."""
    table, problems = read_toml(path), Problems()
    with problems.at(table):
        check_keys(table, TOP, "top level")
    found: dict[str, Any] = {"name": path.stem, "source": str(path)}
    with problems.at(table, "name"):
        found["name"] = string(table, "name", "scene") if "name" in table else path.stem
    with problems.at(table, "gravity"):
        found["gravity"] = vector(table, "gravity", "scene") if "gravity" in table else None
    with problems.at(table, "excluded"):
        found["excluded"] = name_pairs_of(table, "excluded", 'write [["robot/link", "object/body"], ...]')
    with problems.at(table, "pairs"):
        found |= {"pairs": _touching(table)} if "pairs" in table else {}
    with problems.at(table, "ground"):
        found["ground"] = _ground(table_of(table, "ground", "")) if "ground" in table else None
    for key, kind in (("loops", Loop), ("frictions", PairFriction)):
        with problems.at(table, key):
            found |= {key: records_of(kind, table[key], key)} if key in table else {}
    with problems.at(table, "fluid"):
        found["fluid"] = record(Fluid, table_of(table, "fluid", ""), "fluid") if "fluid" in table else None
    placed: dict[str, list[Placed]] = {"robots": [], "objects": [], "obstacles": []}
    for section, members in placed.items():
        rows: list[dict[str, Any]] = []  # where it is no list of tables
        with problems.at(table, section):
            rows = _rows(table, section)
        for k, row in enumerate(rows):
            with problems.at(row):
                what = f"{section}[{k}]"
                members.append(
                    _robot(row, what, path.parent, strict) if section == "robots" else _solid(row, what, path.parent)
                )
    problems.raise_all()
    return SceneModel(members=(*placed["robots"], *placed["objects"]), obstacles=tuple(placed["obstacles"]), **found)


def _rows(table: Mapping[str, Any], section: str) -> list[dict[str, Any]]:
    rows = table.get(section, [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ValueError(f"{section} is {rows!r}; expected tables: write [[{section}]] above each")
    return rows


def _touching(table: Mapping[str, Any]) -> PairWord | tuple[tuple[str, str], ...] | PairContact:
    """Read what touches what: a word, pairs of names, or a table of numbers, in which `select` says it."""
    given = table["pairs"]
    if isinstance(given, str):
        return PairContact(cast("PairWord", given)).select
    if not isinstance(given, dict):
        return name_pairs_of(table, "pairs", PAIRS)
    numbers = tuple(f.name for f in fields(PairContact) if f.name != "select")
    check_keys(given, ("select", *numbers), "pairs")
    problems, found = Problems(), dict[str, Any]()
    for key in given:
        with problems.at(given, key):
            if key == "select":
                found[key] = given[key] if isinstance(given[key], str) else name_pairs_of(given, key, PAIRS)
            else:
                found[key] = given[key] if key == "max_points" else number(given, key, "pairs")
            PairContact(**{key: found[key]})
    problems.raise_all()
    return PairContact(**found)


def _ground(table: dict[str, Any]) -> Ground:
    """Read [ground]: the numbers of Ground, its steps and lines; a height field comes from Python."""
    numbers = tuple(f.name for f in fields(Ground) if f.name not in ("steps", "field", "lines", *PLANAR))
    check_keys(table, (*numbers, *PLANAR, "steps", "lines"), "ground")
    problems, found = Problems(), dict[str, Any]()
    for key in table:
        with problems.at(table, key):
            if key in PLANAR:
                found[key] = _numbers(table, key, "ground")
            elif key == "lines":
                found[key] = records_of(FloorLine, table[key], "ground.lines")
            else:
                found[key] = number(table, key, "ground") if key != "steps" else _steps(table[key])
    problems.raise_all()
    return Ground(**found)


def with_stated(
    table: Mapping[str, Any], ground: Ground | None, fluid: Fluid | None, links: Collection[str]
) -> tuple[Ground | None, Fluid | None, tuple[Any, ...]]:
    """Return ground, fluid and sensors of a scene with what `save_scene` has written of them as TOML."""
    check_keys(table, ("ground", "fluid", "sensors"), "scene")
    if ground is not None and "ground" in table:
        stated = _ground(table_of(table, "ground", ""))
        ground = replace(ground, **{key: getattr(stated, key) for key in table["ground"]})
    fluid = record(Fluid, table_of(table, "fluid", ""), "fluid") if "fluid" in table else fluid
    return ground, fluid, read_sensors(table["sensors"], links) if "sensors" in table else ()


def _steps(rows: Any) -> tuple[tuple[float, ...], ...]:
    if not isinstance(rows, list) or not all(isinstance(row, list) and len(row) == 2 for row in rows):
        raise ValueError(f"ground: steps is {rows!r}; expected distance and rise of each: write [[0.5, 0.02], ...]")
    return tuple(tuple(real(x, "ground: steps") for x in row) for row in rows)


# ---------------------------------------------------------------------------------------------- members


def _robot(row: dict[str, Any], what: str, folder: Path, strict: bool) -> Placed:
    check_keys(row, (*PLACE, *OF_ROBOT), what)
    with at(row, "file"):
        file = string(row, "file", what)
        path: str | Path = file if file in robot_names() else folder / file
    options: dict[str, Any] = {}
    if "base" in row:
        options["base"] = string(row, "base", what)
    for key in ("locked", "contacts"):
        if key in row:
            options[key] = row[key]
    with at(row, "file"):
        model = _loaded(path, options, what, strict)
    if "servos" in row:
        table = table_of(row, "servos", f"{what}.")
        report = Report({}, strict)
        model = replace(model, servos=read_servos(table, model.joints, folder, report))
        report.raise_problems(Path(model.source))
    gearbox: Any = string(row, "gearbox", what) if "gearbox" in row else OF_SCENE
    contact = truth(row, "ground_contact", what) if "ground_contact" in row else True
    return _placed(row, what, model, None if gearbox == NO_SERVOS else gearbox, contact)


def _loaded(path: str | Path, options: dict[str, Any], what: str, strict: bool) -> Model:
    try:
        return load_robot(path, strict=strict, **options)
    except TypeError as error:
        raise ValueError(f"{what}: {error}") from error


def _solid(row: dict[str, Any], what: str, folder: Path) -> Placed:
    """Read an object or an obstacle."""
    moves = what.startswith("objects")
    kind = kind_of(row, what)
    own = tuple(f.name for f in fields(kind))
    of_mass = ("mass", "inertia", "center_of_mass") if moves else ()
    check_keys(row, (*PLACE, "shape", *own, *of_mass, *FIELDS, "surface"), what)
    geometry = beside(geometry_of(kind, row, what), folder)
    given: dict[str, Any] = {"name": string(row, "name", what)}
    if moves:
        given["mass"] = number(row, "mass", what)
        given |= {key: _numbers(row, key, what) for key in ("inertia", "center_of_mass") if key in row}
    given |= {key: number(row, key, what) for key in FIELDS if key in row}
    given |= {"surface": surface(row, "surface", what)} if "surface" in row else {}
    return _placed(row, what, body(geometry, base="floating" if moves else "fixed", **given))


def _placed(
    row: dict[str, Any], what: str, model: Model, gearbox: Any = OF_SCENE, ground_contact: bool = True
) -> Placed:
    """Put a model at the place that its table states."""
    if "rpy" in row and "orientation" in row:
        raise ValueError(f"{what}: both rpy and orientation are given; keep one of the two")
    place: dict[str, Any] = {}
    if "position" in row:
        place["position"] = _numbers(row, "position", what)
    if "orientation" in row:
        place["orientation"] = _numbers(row, "orientation", what)
    if "rpy" in row:
        angles = vector(row, "rpy", what)
        if not all(map(math.isfinite, angles)):
            raise ValueError(f"{what}: rpy is {list(angles)}; expected finite numbers: give roll, pitch and yaw [rad]")
        place["orientation"] = quaternion_from_rpy(angles)
    name = string(row, "name", what) if "name" in row else ""
    return Placed(model, name, gearbox=gearbox, ground_contact=ground_contact, **place)


def _numbers(row: Mapping[str, Any], key: str, what: str) -> tuple[float, ...]:
    if not isinstance(row[key], list):
        raise ValueError(f"{what}: {key} is {row[key]!r}; expected a list of numbers")
    return tuple(real(x, f"{what}: {key}") for x in row[key])
