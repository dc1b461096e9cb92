"""Recordings of one joint, and the CSV files that hold them."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..base.arguments import finite, instance, is_real, listed, shown
from ..base.arguments import path as path_of
from ..base.brief import brief
from ..base.files import FilePath, Format, read_columns, read_csv, write_csv
from ..model import SERVO_UNITS

FORMAT = Format("recording")
COLUMNS = ("time [s]", "reference [rad]", "angle [rad]", "voltage [V]")
_ANGLES = {"rad": 1.0, "deg": math.pi / 180.0, "°": math.pi / 180.0}
_MEANT = {  # names and units, by SI, of columns that are read
    COLUMNS[0]: (("time",), {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}),
    COLUMNS[1]: (("reference", "goal"), _ANGLES),
    COLUMNS[2]: (("angle", "position"), _ANGLES),
    COLUMNS[3]: (("voltage",), {"V": 1.0, "mV": 1e-3}),
}
_ON = "torque_on"  # a column of those who may let go
_HEAD = re.compile(r"([^\W_]+)\s*(?:[\[(]([^\])]*)[\])]|_(\w*))?")  # NAME [UNIT], NAME (UNIT), NAME_UNIT
SIMILAR = 0.8  # from here on a name is taken for a misspelled one (difflib's ratio)
MOTOR_OFF = {"current_limit": 1e-9}  # settings of a recording with open terminals: no current, no torque
LEAST_SAMPLES = 10
LARGEST_ANGLE = 4.0 * math.pi  # beyond it a file is taken to be in degrees [rad]
LARGEST_GAP = 0.5  # beyond it a file is taken to be in milliseconds [s]
EARLY = 1e-7  # a command that comes with a controller tick counts for it, whatever the rounding of times [s]


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording of one joint that follows a reference from rest.

    Attributes
    ----------
    name : str
    time : (k,) ndarray
        Rising from 0 [s].
    reference : (k,) ndarray
        Each value is held until the next [rad].
    angle : (k,) ndarray
        As measured [rad].
    voltage : (k,) ndarray or None
        At the motor [V]; None if it was not recorded.
    settings : mapping of str to float
        Servo parameters of this recording alone, such as {"Kp": 20.0} or `MOTOR_OFF`.
    """

    name: str
    time: np.ndarray
    reference: np.ndarray
    angle: np.ndarray
    voltage: np.ndarray | None = None
    settings: Mapping[str, float] = field(default_factory=dict)

    __repr__ = brief

    def __post_init__(self) -> None:
        instance("recording: name", self.name, str, "give a text")
        instance(f"recording {self.name}: settings", self.settings, Mapping, "give {name: value}")
        check_names(self.settings, f"recording {self.name}: settings")
        for name, value in self.settings.items():
            if not is_real(value):
                raise ValueError(f"recording {self.name}: settings: {name} is {shown(value)}; expected a number")
        for name in ("time", "reference", "angle", *(() if self.voltage is None else ("voltage",))):
            count, unit = (None, "[s]") if name == "time" else (len(self.time), "as time has")
            values = finite(f"recording {self.name}: {name}", getattr(self, name), (count,), unit)
            object.__setattr__(self, name, values.copy())
        if len(self.time) < LEAST_SAMPLES or self.time[0] != 0.0 or (np.diff(self.time) <= 0).any():
            raise ValueError(f"recording {self.name}: give {LEAST_SAMPLES} times or more that rise from 0")


def read_recording(path: FilePath, **settings: float) -> Recording:
    """Read a recording from a CSV file.

    Parameters
    ----------
    path : path-like
        A table with the columns `time [s]`, `reference [rad]` or `goal [rad]`, `angle [rad]` or `position [rad]` and,
        if recorded, `voltage [V]`, in any order.  Each name states its unit, as `angle [deg]`, `angle (deg)` or
        `angle_deg`; times may be in ms or us, voltages in mV.  A column `torque_on` has to be 1 throughout, and others
        are ignored.
    **settings : float
        Servo parameters of this recording alone, such as Kp=20.0.

    Returns
    -------
    Recording
        Its first time is 0.

    Raises
    ------
    ValueError
        If the file is not such a table; the message names file, line and column.
    """
    path = path_of("path", path)
    heads = _heads(path)
    on = [_ON] if _ON in heads else []
    named = [heads.get(name, (name, 1.0)) for name in COLUMNS]
    texts = [text for text, _ in named]
    missing = [column for column in COLUMNS[:3] if column not in heads]
    if missing:
        meant = "; ".join(f"{' or '.join(names)} in {', '.join(units)}" for names, units in _MEANT.values())
        raise ValueError(
            f"{path}, line 1: column {missing[0]!r} is missing; head the columns NAME [UNIT], separated by commas: "
            f"{meant} ({COLUMNS[3].split()[0]} may be left out)"
        )
    table, lines = read_columns(path, FORMAT, [*texts[:3], *on], texts[3:], LEAST_SAMPLES, others=True)
    for text, factor in named[1:3]:
        k = int(np.abs(table[text]).argmax())
        if abs(factor * table[text][k]) > LARGEST_ANGLE:
            raise ValueError(
                f"{path}, line {lines[k]}, column {text!r}: {table[text][k]:g} is more than two turns "
                f"({LARGEST_ANGLE:.4g} rad); convert degrees to radians, name their unit, or subtract whole turns"
            )
    if on and not (table[_ON] > 0.5).all():
        k = int((table[_ON] > 0.5).argmin())
        raise ValueError(f"{path}, line {lines[k]}, column {_ON!r}: the servo lets go; cut the file there")
    table = {name: factor * table[text] for name, (text, factor) in zip(COLUMNS, named) if text in table}
    time = table[COLUMNS[0]]
    wrong = np.flatnonzero((np.diff(time) <= 0.0) | (np.diff(time) > LARGEST_GAP))
    if len(wrong):
        k = wrong[0] + 1
        raise ValueError(
            f"{path}, line {lines[k]}, column {texts[0]!r}: {time[k]:g} follows {time[k - 1]:g} s; times must rise by "
            f"at most {LARGEST_GAP:g} s: sort them, give seconds, or cut the file at the gap"
        )
    column = {name.split()[0]: values for name, values in table.items()} | {"time": time - time[0]}
    return Recording(path.stem, **column, settings=settings)


def _heads(path: Path) -> dict[str, tuple[str, float]]:
    """Return the text and the unit, in SI, of each column that the header names, by its name in `COLUMNS`."""
    line, cells = next(iter(read_csv(path, FORMAT)), (1, []))
    found: dict[str, tuple[str, float]] = {}
    for text in (cell.strip() for cell in cells):
        parts = _HEAD.fullmatch(text)
        name, unit = (parts[1].lower(), parts[2] or parts[3] or "") if parts else (text, "")
        for column, (names, units) in _MEANT.items():
            if name in names:
                if unit not in units:
                    remedy = f"use one of {', '.join(units)}, as in {column!r}"
                    raise ValueError(f"{path}, line {line}: the unit of column {text!r} is {unit!r}; {remedy}")
                if column in found:
                    raise ValueError(f"{path}, line {line}: {found[column][0]!r} and {text!r} are twice one; keep one")
                found[column] = text, units[unit]
            elif difflib.get_close_matches(name, names, 1, SIMILAR):
                raise ValueError(f"{path}, line {line}: column {text!r} is unknown; if {column!r} is meant, name it so")
        if text == _ON:
            found[_ON] = text, 1.0
    return found


def write_recording(path: FilePath, recording: Recording) -> None:
    """Write a recording to a CSV file, whole or not at all.

    Parameters
    ----------
    path : path-like
    recording : Recording
        Its settings are not written.
    """
    instance("recording", recording, Recording, "give a Recording")
    path = path_of("path", path)
    measured = (recording.time, recording.reference, recording.angle, recording.voltage)
    columns = [column for column in measured if column is not None]
    write_csv(path, FORMAT, COLUMNS[: len(columns)], np.column_stack(columns).tolist())


def check_recordings(recordings: object, kind: type) -> list:
    """Return the recordings as a list; raise TypeError or ValueError unless they are one or more of a kind."""
    found = listed("recordings", recordings, f"give a list of {kind.__name__}")
    if not found:
        raise ValueError(f"recordings: there is none; give a list of one {kind.__name__} or more")
    for recording in found:
        instance("recordings", recording, kind, f"give a list of {kind.__name__}")
    return found


def check_names(names: Iterable[str], where: str) -> None:
    """Raise ValueError for a name that is no parameter of a servo."""
    for name in names:
        if not isinstance(name, str) or name not in SERVO_UNITS:
            raise ValueError(f"{where}: a servo has no parameter {shown(name)}; parameters: {', '.join(SERVO_UNITS)}")
