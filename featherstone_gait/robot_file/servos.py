"""Read servos: their files with gearbox presets and manuals, and the table [servos] of a robot."""

from __future__ import annotations

import functools
import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Any

from ..base.arguments import instance
from ..base.brief import some
from ..base.files import FilePath
from ..base.flaws import quoted
from ..model import SERVO_UNITS, TORQUE_LAWS, Controller, Gearbox, Joint, Model, Servo
from ..model.checks import check, field_flaws, refuse
from ..model.degrees import degrees_of
from ..model.tree_checks import check_servos
from .report import Report, RobotFileError, RobotFileWarning, blamed_on
from .source import robots_folder
from .toml import Problems, at, check_keys, read_toml, real, string, table_of, truth

# The keys of a servo's table are the fields of these; a new field needs no line here.
PARTS = {
    part: [f for f in fields(part) if f.name not in ("controller", "gearbox")] for part in (Controller, Gearbox, Servo)
}
_FIELDS = {f.name: f for part in PARTS.values() for f in part}
MOTOR = ("resistance", "inductance", "motor_constant", "voltage_limit")  # what a servo of the other laws must state
LONGEST_NAME = 60  # characters of a file's name: systems take 255 bytes
_ANGLES = tuple(name for name, unit in SERVO_UNITS.items() if unit == "rad")
SERVO_KEYS = (*_FIELDS, *(f"{name}_deg" for name in _ANGLES))
_TABLES = ("gearboxes", "about", "manual")  # of a servo's file, beside its numbers


@dataclass(frozen=True)
class ManualPoint:
    """The figures of a servo's manual at one voltage; NaN where it states none."""

    voltage: float  # [V]
    stall_torque: float = math.nan  # [N m]
    stall_current: float = math.nan  # [A]
    no_load_speed: float = math.nan  # [rad/s]
    no_load_current: float = math.nan  # [A]


@dataclass(frozen=True)
class ServoSheet:
    """The tables [about] and [manual] of a servo's file."""

    product: str = ""
    source: str = ""  # of the numbers
    quality: str = ""  # how far they are to be trusted
    manual_source: str = ""
    manual: tuple[ManualPoint, ...] = ()


_ABOUT = ("product", "source", "quality")
_FIGURES = tuple(f.name for f in fields(ManualPoint))


def with_servo(model: Model, servo: FilePath, **overrides: Any) -> Model:
    """Return the robot with one servo in all joints that turn or have one; servo, overrides: as in `load_servo`.

    What stood for the servo before goes (`without_actuators`).
    """
    turning = [joint.name for joint in model.degrees.joints if joint.type in ("revolute", "continuous")]
    own = dict.fromkeys([*turning, *model.servos], load_servo(servo, **overrides))
    return replace(without_actuators(model, own), servos=own)


def without_actuators(model: Model, servos: Mapping[str, Servo]) -> Model:
    """Return the robot whose joints have no losses and inertia of the actuators that servos with motors replace.

    A position actuator of MJCF has no motor: its rotor is the joint's armature, and its losses are the joint's damping
    and friction, which a servo's motor, gear and friction would count a second time.
    """
    gone = {
        name for name, servo in servos.items()
        if servo.motor_constant and name in model.servos and not model.servos[name].motor_constant
    }  # fmt: skip
    numbers = ("armature", "damping", "friction", "quadratic_damping", "cubic_damping")
    zeros: dict[str, Any] = dict.fromkeys(numbers, 0.0)
    joints = tuple(replace(joint, **zeros) if joint.name in gone else joint for joint in model.joints)
    if joints == model.joints:
        return model
    changed = some([one.name for one, other in zip(joints, model.joints) if one != other], 3)
    note = f"left out armature, damping and friction of joints whose actuators servos replace: {changed}"
    return replace(model, joints=joints, notes=(*model.notes, note))


def load_servo(name: str | os.PathLike, gearbox: str = "physical", **overrides: Any) -> Servo:
    """Load a servo with one of its gearbox presets.

    Parameters
    ----------
    name : str or path
        Name of a servo of the package (`robots/servos/`), or the path of a .toml file.
    gearbox : str, optional
        Name of a preset of the file.
    **overrides
        Fields of `Servo`, `Controller` or `Gearbox` (their names are distinct), in SI units; angles may carry `_deg`.

    Returns
    -------
    Servo
        The servo.

    Raises
    ------
    RobotFileError
        A ValueError, for an unknown servo, preset or field and for a value out of range.

    Warns
    -----
    RobotFileWarning
        If dry friction is given without `stick_speed`, and the file has one, up to which a loaded joint creeps.
    """
    instance("name", name, (str, os.PathLike), "give the name of a servo, or the path of a .toml file")
    instance("gearbox", gearbox, str, "give the name of a preset")
    with blamed_on(f"load_servo({os.fspath(name)!r})"):
        own, of_file = _servo_settings(overrides, "overrides"), _servo_values(_servo_file(name), gearbox)
        servo = _servo({**of_file, **own}, os.fspath(name))
    for found, taken, remedy in _soft_friction(of_file, own):
        warnings.warn(f"load_servo({os.fspath(name)!r}): {found}: {taken}; {remedy}", RobotFileWarning, stacklevel=2)
    return servo


def gearbox_presets(name: str | os.PathLike) -> dict[str, Gearbox]:
    """Read the gearbox presets of a servo.

    Parameters
    ----------
    name : str or path
        Name of a servo of the package, or the path of a .toml file.

    Returns
    -------
    dict of str to Gearbox
        Gearboxes by the names of their presets.

    Raises
    ------
    RobotFileError
        A ValueError, for an unknown servo and for values out of range.
    """
    instance("name", name, (str, os.PathLike), "give the name of a servo, or the path of a .toml file")
    with blamed_on(f"gearbox_presets({os.fspath(name)!r})"):
        presets = table_of(read_toml(_servo_file(name)), "gearboxes", "")
    return {preset: load_servo(name, preset).gearbox for preset in presets}


def servo_names() -> list[str]:
    """Return the names of the servos of the package, sorted."""
    return sorted(path.stem for path in (robots_folder() / "servos").glob("*.toml"))


def servo_sheet(name: str | os.PathLike) -> ServoSheet:
    """Read what the file of a servo, named as in `load_servo`, says of product, source, quality and manual.

    Raises RobotFileError (a ValueError) for an unknown servo and wrong tables.
    """
    instance("name", name, (str, os.PathLike), "give the name of a servo, or the path of a .toml file")
    with blamed_on(f"servo_sheet({os.fspath(name)!r})"):
        path = _servo_file(name)
        with blamed_on(path):
            return _sheet(read_toml(path))


def read_servos(section: dict[str, Any], joints: tuple[Joint, ...], folder: Path, report: Report) -> dict[str, Servo]:
    """Read the servos by joint: [servos] for all joints that turn, overridden by [servos.joints.NAME]."""
    problems, own, shared, servos = Problems(), dict[str, Any](), dict[str, Any](), dict[str, Servo]()
    joints = degrees_of(joints).joints
    with problems.at(section, "joints"):
        own = table_of(section, "joints", "servos.")
    for name in own:
        with problems.at(own, name):
            check_servos(joints, [name])
        with problems.at(own, name):
            table_of(own, name, "servos.joints.")
    with problems.at(section):
        shared = _servo_settings(section, "servos", also=("default", "gearbox", "joints"))
    with problems.at(section):
        if "default" in section:
            string(section, "default", "servos")
    if "default" not in section and not own and (shared or "gearbox" in section):
        stated = ", ".join(key for key in section if key != "joints")
        with problems.at(section):
            raise ValueError(
                f"servos: {stated} would act on no joint: name the servo of all joints that turn, for instance "
                'default = "ax12", or give joints their own in [servos.joints.NAME]'
            )
    if problems.found:  # which would come again with each joint
        for name in own:
            with problems.at(own, name):
                own_table = table_of(own, name, "servos.joints.")
                _servo_settings(own_table, f"servo of joint {name!r}", also=("type", "gearbox"))
    problems.raise_all()
    read = functools.cache(lambda name, gearbox: _servo_values(_servo_path(name, folder), gearbox))
    turning = [joint.name for joint in joints if joint.type in ("revolute", "continuous")] * ("default" in section)
    shared_by = [name for name in turning if name not in own]
    common = None  # the servo of these
    for joint in joints:
        if joint.name in own:
            with problems.at(own, joint.name):
                what = f"servo of joint {joint.name!r}"
                servos[joint.name] = _joint_servo(own[joint.name], section, shared, read, what, report)
        elif joint.name in shared_by:
            with problems.at(section):
                what = f"servo of joints {quoted(shared_by)}"
                common = common or _joint_servo({}, section, shared, read, what, report)
                servos[joint.name] = common
    problems.raise_all()
    return servos


def _joint_servo(
    table: dict[str, Any],
    section: dict[str, Any],
    shared: dict[str, Any],
    read: Callable[[str, str], dict[str, Any]],
    what: str,
    report: Report,
) -> Servo:
    """Read the servo of a joint: the fields of its type and preset, those shared by all, and its own."""
    values, preset = _servo_settings(table, what, also=("type", "gearbox")), "gearbox"
    kind, stated = ("type", table) if "type" in table else ("default", section)
    where = table if preset in table else section
    gearbox = string(where, preset, what) if preset in where else "physical"
    if kind not in stated:
        if preset in where:
            with at(where, preset):
                raise ValueError(
                    f"{what}: gearbox {gearbox!r} is a preset of a servo type, and none is given: add type"
                )
        return _servo({**shared, **values}, what)
    name = string(stated, kind, what)
    try:
        with at(stated, kind):
            found = read(name, gearbox)
    except RobotFileError as error:  # which names the servo's file alone
        with at(stated, kind):
            raise ValueError(f"{what}: {error}") from error
    for given, taken, remedy in _soft_friction(found, {**shared, **values}):
        report.assume_at(what, given, taken, remedy)
    return _servo({**found, **shared, **values}, what)


def _soft_friction(of_file: dict[str, Any], own: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield what is found, taken and to do if the `stick_speed` of a file weakens one's own dry friction."""
    dry = [name for name, x in own.items() if name.endswith("friction") and name != "viscous_friction" and x > 0.0]
    width = of_file.get("stick_speed", 0.0)
    if dry and width > 0.0 and "stick_speed" not in own:
        yield (
            f"{dry[0]} is given, but not stick_speed",
            f"that of the servo's file, {width:g} rad/s, applies, and up to that speed a loaded joint creeps",
            "give stick_speed too, 0 if dry friction is to hold a joint",
        )


def _servo_file(name: str | os.PathLike) -> Path:
    """Return the path as given, or the file of a servo of the package."""
    text = os.fspath(name)
    return Path(text) if isinstance(name, os.PathLike) or text.endswith(".toml") else _servo_path(text)


def _servo_path(name: str, folder: Path | None = None) -> Path:
    """Find the servo's file beside the robot's TOML file, else in the package."""
    packaged, name = robots_folder() / "servos", name.removesuffix(".toml")
    for path in (folder or packaged, packaged):
        if len(name) <= LONGEST_NAME and Path(name).name == name and (path / f"{name}.toml").is_file():
            return path / f"{name}.toml"
    known = ", ".join(servo_names())
    raise ValueError(f"there is no servo {name!r}; expected one of {known}: use one, or add {name}.toml to the robot")


def _servo_values(path: Path, gearbox: str) -> dict[str, Any]:
    """Read the fields of Servo, Controller and Gearbox in a servo's file, with one of its presets."""
    with blamed_on(path):
        table = read_toml(path)
        presets = table_of(table, "gearboxes", "")
        if gearbox not in presets and (presets or gearbox != "physical"):  # the one gearbox of a file without presets
            expected = f"; expected one of {', '.join(presets)}: use one of these"
            none = ": the file has no [gearboxes]; leave the name out, or add it"
            raise ValueError(f"there is no gearbox {gearbox!r}{expected if presets else none}")
        problems, found, values = Problems(), dict[str, dict[str, Any]](), dict[str, Any]()
        for name in presets:
            with problems.at(presets, name):
                found[name] = _servo_settings(table_of(presets, name, "gearboxes."), f"gearboxes.{name}")
        with problems.at(table):
            _sheet(table)
        with problems.at(table):
            values = _servo_settings(table, "servo", also=_TABLES)
        problems.raise_all()
        return {**values, **found.get(gearbox, {})}


def _sheet(table: Mapping[str, Any]) -> ServoSheet:
    about, manual, problems = table_of(table, "about", ""), table_of(table, "manual", ""), Problems()
    with problems.at(about):
        check_keys(about, _ABOUT, "about")
    with problems.at(manual):
        check_keys(manual, ("source", *_FIGURES), "manual")
    texts: dict[str, str] = {}
    for key in _ABOUT:
        with problems.at(about, key):
            texts[key] = string(about, key, "about") if key in about else ""
    columns: dict[str, list[float]] = {}
    for key in _FIGURES if manual else ():
        with problems.at(manual, key):
            if key in manual or key == "voltage":
                columns[key] = _numbers(manual, key, len(columns.get("voltage", ())))
    with problems.at(manual):
        source = string(manual, "source", "manual") if manual else ""
    problems.raise_all()
    points = tuple(ManualPoint(**dict(zip(columns, row))) for row in zip(*columns.values()))
    return ServoSheet(**texts, manual_source=source, manual=points)


def _numbers(manual: Mapping[str, Any], key: str, count: int) -> list[float]:
    """Read a column of [manual]; count: of the voltages, 0 if these are not known."""
    value = manual.get(key)
    if not isinstance(value, list) or not value:
        raise ValueError(f"manual: {key} is {value!r}; expected numbers, one for each voltage: write [12.0, 14.8]")
    if count and len(value) != count:
        raise ValueError(
            f"manual: {key} has {len(value)} numbers, and voltage {count}; expected one for each voltage: give as many"
        )
    numbers = [real(x, f"manual: {key}") for x in value]
    for x in numbers:
        if not 0.0 < x < math.inf:
            raise ValueError(f"manual: {key} has {x!r}; expected numbers above 0: correct it, or leave {key} out")
    return numbers


def _servo_settings(table: Mapping[str, Any], what: str, also: tuple[str, ...] = ()) -> dict[str, Any]:
    """Read a table's fields, numbers in SI, angles in radians; skip keys in `also`, refuse others."""
    problems, values = Problems(), dict[str, Any]()
    with problems.at(table):
        check_keys(table, (*also, *SERVO_KEYS), what)
    for key, value in table.items():
        name = key if key in _FIELDS else key.removesuffix("_deg")
        if key not in SERVO_KEYS:
            continue
        with problems.at(table, key):
            if name in values:
                raise ValueError(f"{what}: {name} is given twice; keep one of {name} and {name}_deg")
            if _FIELDS[name].type == "float":
                number = real(value, f"{what}: {key}")
                values[name] = number if name == key else math.radians(number)
            elif _FIELDS[name].type == "bool":
                values[name] = truth(table, key, what)
            else:
                values[name] = string(table, key, what)
            if name not in (*MOTOR, "ratio"):  # of which Servo and Gearbox know more
                check(field_flaws(what, name, values[name], _FIELDS[name]))
    problems.raise_all()
    return values


def _servo(values: dict[str, Any], what: str) -> Servo:
    if values.get("law") in TORQUE_LAWS:
        values = {"ratio": 1.0, **values}  # which matters to reflected inertia alone
    needed = [name for name, f in _FIELDS.items() if f.default is MISSING]
    needed += () if values.get("law") in TORQUE_LAWS else MOTOR
    remedy = "is missing; it is required: add it, or name a servo type that has it"
    refuse(what, [f"{what}: {name} {remedy}" for name in needed if name not in values])
    controller, gearbox, motor = ({f.name: values[f.name] for f in part if f.name in values} for part in PARTS.values())
    try:
        return Servo(Controller(**controller), Gearbox(**gearbox), **motor)
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error
