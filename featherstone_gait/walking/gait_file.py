"""Joint angles in files that a robot can play: CSV in degrees, and goal positions of AX-12 servos.

The CSV has its format in a comment, a header ``time_s`` and one column a joint, named as in the model; angles are in
degrees.  An AX-12 counts 0..1023 over 300 degrees, 512 in the middle (ROBOTIS e-Manual, AX-12A, control table address
30).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, floats, texts
from ..base.arguments import path as path_of
from ..base.files import FilePath, Format, read_columns, read_csv, write_csv

MIDDLE, LARGEST, RANGE = 512, 1023, 300.0  # of an AX-12 [counts, counts, deg]
TIME_COLUMN = "time_s"
ANGLES, GOAL_POSITIONS = Format("joint angles"), Format("goal positions")
ARRAYS = Format("gait arrays")  # written by featherstone-gait optimize


def write_angles(path: FilePath, times: np.ndarray, angles: np.ndarray, joint_names: Sequence[str]) -> None:
    """Write joint angles as CSV in degrees, with all digits.

    Parameters
    ----------
    path : str or path
        Path of the file.
    times : numpy.ndarray
        Times (n,) [s].
    angles : numpy.ndarray
        Joint angles (n, nj) [rad].
    joint_names : sequence of str
        Names of the joints (nj).
    """
    _write(path, ANGLES, times, np.degrees(floats("angles", angles)), joint_names)


def write_goal_positions(path: FilePath, times: np.ndarray, angles: np.ndarray, joint_names: Sequence[str]) -> None:
    """Write joint angles as CSV of AX-12 goal positions; raises as `goal_positions`.

    Parameters
    ----------
    path : str or path
        Path of the file.
    times : numpy.ndarray
        Times (n,) [s].
    angles : numpy.ndarray
        Joint angles (n, nj) [rad].
    joint_names : sequence of str
        Names of the joints (nj).
    """
    _write(path, GOAL_POSITIONS, times, goal_positions(angles, joint_names), joint_names)


def goal_positions(angles: ArrayLike, joint_names: Sequence[str]) -> np.ndarray:
    """Convert `angles` (n, nj) [rad] to AX-12 goal positions (n, nj), 0..1023.

    Raises ValueError, naming joint and row, for an angle beyond the servo's range.
    """
    degrees, joint_names = np.degrees(np.atleast_2d(floats("angles", angles))), texts("joint_names", joint_names)
    if degrees.ndim != 2 or degrees.shape[1] != len(joint_names):
        raise ValueError(f"angles have shape {degrees.shape}; give one column for each of the joint_names")
    counts = np.round(MIDDLE + degrees * LARGEST / RANGE)
    bad = ~((counts >= 0) & (counts <= LARGEST))
    if bad.any():
        row, joint = np.argwhere(bad)[0]
        raise ValueError(
            f"angles: row {row}, joint {joint_names[joint]!r}: {degrees[row, joint]:.2f} deg is outside the AX-12's "
            f"{_degrees(0):.2f}..{_degrees(LARGEST):.2f} deg; tighten the joint's limits"
        )
    return counts.astype(int)


def angles_of_goal_positions(counts: ArrayLike) -> np.ndarray:
    """Convert AX-12 goal positions to angles [rad]."""
    return np.radians(_degrees(np.asarray(counts, dtype=float)))


def read_angles(
    path: FilePath, joint_names: Sequence[str] | None = None
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Read a CSV file of `write_angles`.

    Parameters
    ----------
    path : str or path
        Path of the file.
    joint_names : sequence of str, optional
        Names that the columns must have; the columns are returned in this order.

    Returns
    -------
    times : numpy.ndarray
        Times (n,) [s].
    angles : numpy.ndarray
        Joint angles (n, nj) [rad].
    joint_names : tuple of str
        Names of the joints.

    Raises
    ------
    ValueError
        For a missing, doubled or unknown column, a row of the wrong length, a value that is not a finite number or is
        beyond one turn, times that do not increase, or an unknown format; the message names file, line and column.
    """
    path = path_of("path", path)
    header = [name.strip() for name in next(read_csv(path, ANGLES), (1, []))[1]]
    found = dict.fromkeys(name for name in header if name != TIME_COLUMN)
    names = tuple(found if joint_names is None else texts("joint_names", joint_names))
    table, lines = read_columns(path, ANGLES, (TIME_COLUMN, *names), (), least=1)
    if not names:
        raise ValueError(f"{path}: no column of a joint; there must be one for each joint of the robot")
    times, degrees = table[TIME_COLUMN], np.column_stack([table[name] for name in names])
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if len(late):
        k = late[0] + 1
        raise ValueError(
            f"{path}, line {lines[k]}, column {TIME_COLUMN!r}: {times[k]} s does not lie after {times[k - 1]} s; sort "
            "the rows by time and drop doubled ones"
        )
    beyond = np.argwhere(np.abs(degrees) > 360.0)
    if len(beyond):
        k, joint = beyond[0]
        raise ValueError(
            f"{path}, line {lines[k]}, column {names[joint]!r}: {degrees[k, joint]:g} must lie in -360..360 deg"
        )
    return times, np.radians(degrees), names


def _degrees(counts: float | np.ndarray) -> float | np.ndarray:
    return (counts - MIDDLE) * RANGE / LARGEST


def _write(path: FilePath, form: Format, times: np.ndarray, values: np.ndarray, joint_names: Sequence[str]) -> None:
    path, joint_names = path_of("path", path), texts("joint_names", joint_names)
    times = finite("times", times, (None,), "[s]")
    finite("angles", values, (len(times), len(joint_names)), "as times and joint_names say")
    # Rounding takes the noise of k * 0.04 off the times; the values keep all digits.
    rows = ([round(float(t), 9), *row] for t, row in zip(times, np.asarray(values).tolist()))
    write_csv(path, form, [TIME_COLUMN, *joint_names], rows)
