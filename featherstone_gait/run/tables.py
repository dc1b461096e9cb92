"""Convert the channels of a run to tables of pandas, xarray and Parquet; `pip install featherstone-gait[tables]`.

All functions take `channels` by name, arrays (samples, ...) with `time` (samples,) [s] among them, and what is known of
the run: its status, message, end_time and info, which holds the joints' names.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..base.files import FilePath, complete
from ..core.step.state import BY_NAME

OF_JOINTS = ("joint", "servo", "rotor", "profile", "fed")


def to_pandas(channels: Mapping[str, np.ndarray], run: Mapping[str, Any]) -> Any:
    """Make a pandas.DataFrame over time [s] with a column for each number: `q.left_knee`, `energy.left_knee.copper`.

    Its `attrs` hold the status, message, end time [s] and info of the run, and the channels' units under "units".
    Raises ImportError without pandas.
    """
    pandas = _imported("pandas")
    columns = {}
    for name, axes in _axes(channels, run).items():
        for at in np.ndindex(channels[name].shape[1:]):
            key = ".".join([name, *(labels[k] for (_, labels), k in zip(axes, at))])
            columns[key] = channels[name][(slice(None), *at)]
    frame = pandas.DataFrame(columns, index=pandas.Index(channels["time"], name="time"))
    units = {name: BY_NAME[name].unit for name in channels if name in BY_NAME}
    frame.attrs |= {**_attributes(run), "units": json.dumps(units, ensure_ascii=False)}
    return frame


def to_xarray(channels: Mapping[str, np.ndarray], run: Mapping[str, Any]) -> Any:
    """Make an xarray.Dataset with a variable for each channel over time [s], joints or contact points, and labels.

    Each variable has its unit in its attributes.  Raises ImportError without xarray.
    """
    xarray = _imported("xarray")
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {"time": ("time", channels["time"], {"units": "s"})}
    for name, axes in _axes(channels, run).items():
        attributes = {"units": BY_NAME[name].unit, "long_name": BY_NAME[name].what} if name in BY_NAME else {}
        variables[name] = (("time", *(axis for axis, _ in axes)), channels[name], attributes)
        coordinates |= {axis: (axis, labels, {}) for axis, labels in axes}
    return xarray.Dataset(variables, coordinates, _attributes(run))


def to_parquet(path: FilePath, channels: Mapping[str, np.ndarray], run: Mapping[str, Any]) -> None:
    """Write the table of `to_pandas` to a file, whole or not at all.  Raises ImportError without pandas and pyarrow."""
    _imported("pyarrow")
    frame = to_pandas(channels, run)
    with complete(path) as temporary:
        frame.to_parquet(temporary, engine="pyarrow")


def _imported(library: str) -> Any:
    try:
        return importlib.import_module(library)
    except ImportError as error:
        raise ImportError(f"this needs {library}: pip install featherstone-gait[tables]") from error


def _attributes(run: Mapping[str, Any]) -> dict[str, Any]:
    """Describe the run in plain texts and numbers, as these formats store them."""
    return {**run, "info": json.dumps(run["info"], default=float)}


def _axes(channels: Mapping[str, np.ndarray], run: Mapping[str, Any]) -> dict[str, list[tuple[str, list[str]]]]:
    """Name and label each axis of each channel after the time."""
    joints = run["info"].get("joints") or []
    return {name: _axes_of(name, values.shape[1:], joints) for name, values in channels.items() if name != "time"}


def _axes_of(name: str, shape: tuple[int, ...], joints: list[str]) -> list[tuple[str, list[str]]]:
    channel, axes = BY_NAME.get(name), []
    for k, size in enumerate(shape):
        axis, labels = f"{name}_{k}", [str(number) for number in range(size)]
        if channel is not None and channel.of in OF_JOINTS and k == 0 and size == len(joints):
            axis, labels = "joint", list(joints)
        elif channel is not None and channel.of == "point" and k == 0:
            axis = "point" if len(shape) > 1 or channel.width == 1 else axis
        elif channel is not None and size == len(channel.labels):
            own = channel.labels  # labels that come again are those of the quaternion: x y z w qx qy qz
            labels = [f"q{label}" if label in own[:j] else label for j, label in enumerate(own)]
        axes.append((axis, labels))
    return axes
