"""Trajectories as tables of other libraries: pandas, xarray, Parquet; `pip install featherstone-gait[tables]`."""

from __future__ import annotations

import importlib
import json
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.files import FilePath, complete
from ..core.step.state import BY_NAME

if TYPE_CHECKING:
    from .trajectory import Trajectory

OF_JOINTS = ("joint", "servo", "rotor", "profile", "fed")


def to_pandas(trajectory: Trajectory) -> Any:
    """A pandas.DataFrame with the time [s] as index and a column a number: `q.left_knee`, `energy.left_knee.copper`.

    Its `attrs` say how the run ended and, as "units", in what each channel is.  Raises ImportError without pandas.
    """
    pandas = _imported("pandas")
    columns = {}
    for name, values in trajectory.items():
        if name != "time":
            parts = [[name], *(labels for _, labels in _axes(trajectory, name))]
            for at in np.ndindex(values.shape[1:]):
                key = ".".join([name, *(labels[k] for labels, k in zip(parts[1:], at))])
                columns[key] = values[(slice(None), *at)]
    frame = pandas.DataFrame(columns, index=pandas.Index(trajectory["time"], name="time"))
    frame.attrs.update(_attributes(trajectory))
    return frame


def to_xarray(trajectory: Trajectory) -> Any:
    """An xarray.Dataset: a variable a channel, over time [s], joints or contact points, and labels, with its unit.

    Raises ImportError without xarray.
    """
    xarray = _imported("xarray")
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {"time": ("time", trajectory["time"], {"units": "s"})}
    for name, values in trajectory.items():
        if name == "time":
            continue
        axes = _axes(trajectory, name)
        attributes = {"units": BY_NAME[name].unit, "long_name": BY_NAME[name].what} if name in BY_NAME else {}
        variables[name] = (("time", *(axis for axis, _ in axes)), values, attributes)
        coordinates |= {axis: (axis, labels, {}) for axis, labels in axes}
    found = xarray.Dataset(variables, coordinates)
    found.attrs.update({k: v for k, v in _attributes(trajectory).items() if k != "units"})
    return found


def to_parquet(trajectory: Trajectory, path: FilePath) -> None:
    """Write the table of `to_pandas` to PATH, whole or not at all.  Raises ImportError without pandas and pyarrow."""
    _imported("pyarrow")
    frame = to_pandas(trajectory)
    with complete(path) as temporary:
        frame.to_parquet(temporary, engine="pyarrow")


def _imported(library: str) -> Any:
    try:
        return importlib.import_module(library)
    except ImportError as error:
        raise ImportError(f"this needs {library}: pip install featherstone-gait[tables]") from error


def _attributes(trajectory: Trajectory) -> dict[str, Any]:
    """What is told with a table; plain texts and numbers."""
    units = {name: BY_NAME[name].unit for name in trajectory if name in BY_NAME}
    told = {"status": trajectory.status, "message": trajectory.message, "end_time": float(trajectory.end_time)}
    return told | {"units": json.dumps(units, ensure_ascii=False), "info": json.dumps(trajectory.info, default=float)}


def _axes(trajectory: Trajectory, name: str) -> list[tuple[str, list[str]]]:
    """Name and labels of each axis of a channel after the time."""
    channel, shape, joints = BY_NAME.get(name), trajectory[name].shape[1:], trajectory.info.get("joints") or []
    axes = []
    for k, size in enumerate(shape):
        axis, labels = f"{name}_{k}", [str(number) for number in range(size)]
        if channel is not None and channel.of in OF_JOINTS and k == 0 and size == len(joints):
            axis, labels = "joint", list(joints)
        elif channel is not None and channel.of == "point" and k == 0:
            axis = "point" if len(shape) > 1 or channel.width == 1 else axis
        elif channel is not None and size == len(channel.labels):
            labels = _distinct(channel.labels)
        axes.append((axis, labels))
    return axes


def _distinct(labels: tuple[str, ...]) -> list[str]:
    """Those that come again are of the quaternion: x y z w qx qy qz."""
    return [f"q{label}" if label in labels[:k] else label for k, label in enumerate(labels)]
