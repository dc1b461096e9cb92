"""Convert runs to tables of pandas, xarray and Parquet; `pip install featherstone-gait[tables]`.

The functions are methods of `Trajectory`.
"""

from __future__ import annotations

import importlib
import json
from typing import Any

import numpy as np

from ..base.files import FilePath, complete
from ..core.step.state import BY_NAME
from ..scene.channels import joint_labels, unit_of
from .contacts import by_pair

OF_JOINTS = ("joint", "servo", "rotor", "profile", "fed")


def to_pandas(self: Any) -> Any:
    """Convert to a pandas.DataFrame over time [s] with a column for each number.

    Returns
    -------
    pandas.DataFrame
        With columns such as `q.left_knee` and `energy.left_knee.copper`; `attrs` hold the status, message, end time
        [s] and info of the run, and the channels' units under "units".

    Raises
    ------
    ImportError
        Without pandas (pip install featherstone-gait[tables]).
    """
    pandas, columns = _imported("pandas"), {}
    channels = _by_pairs(self)
    for name, axes in _axes(self).items():
        for at in np.ndindex(channels[name].shape[1:]):
            key = ".".join([name, *(labels[k] for (_, labels), k in zip(axes, at))])
            columns[key] = channels[name][(slice(None), *at)]
    frame = pandas.DataFrame(columns, index=pandas.Index(channels["time"], name="time"))
    units = {name: unit_of(name, _types(self)) for name in channels if name in BY_NAME}
    frame.attrs |= {**_attributes(self), "units": json.dumps(units, ensure_ascii=False)}
    return frame


def to_xarray(self: Any) -> Any:
    """Convert to an xarray.Dataset with a variable for each channel.

    Returns
    -------
    xarray.Dataset
        Over time [s], joints or contact points, and labels; each variable has its unit in its attributes.

    Raises
    ------
    ImportError
        Without xarray (pip install featherstone-gait[tables]).
    """
    xarray, variables = _imported("xarray"), {}
    channels = _by_pairs(self)
    coordinates: dict[str, Any] = {"time": ("time", channels["time"], {"units": "s"})}
    for name, axes in _axes(self).items():
        unit = unit_of(name, _types(self))
        attributes = {"units": unit, "long_name": BY_NAME[name].what} if name in BY_NAME else {}
        variables[name] = (("time", *(axis for axis, _ in axes)), channels[name], attributes)
        coordinates |= {axis: (axis, labels, {}) for axis, labels in axes}
    return xarray.Dataset(variables, coordinates, _attributes(self))


def to_parquet(self: Any, path: FilePath) -> None:
    """Write the table of `to_pandas` to a Parquet file, atomically.

    Parameters
    ----------
    path : path
        Of the file.

    Raises
    ------
    ImportError
        Without pandas and pyarrow (pip install featherstone-gait[tables]).
    """
    _imported("pyarrow")
    frame = to_pandas(self)
    with complete(path) as temporary:
        frame.to_parquet(temporary, engine="pyarrow")


def _imported(library: str) -> Any:
    try:
        return importlib.import_module(library)
    except ImportError as error:
        raise ImportError(f"this needs {library}: pip install featherstone-gait[tables]") from error


def _attributes(run: Any) -> dict[str, Any]:
    """Describe the run in plain texts and numbers, as these formats store them."""
    return {**run.described(), "info": json.dumps(run.info, default=float)}


def _types(run: Any) -> list[str]:
    return run.info.get("joint_types") or []


def _axes(run: Any) -> dict[str, list[tuple[str, list[str]]]]:
    """Name and label each axis of each channel after the time."""
    axes: dict[str, list[tuple[str, list[str]]]] = {}
    for name, values in run.items():
        if name != "time":
            found = by_pair(run.channels, run.info, name)
            shape = (values if found is None else found.values).shape[1:]
            axes[name] = _axes_of(name, shape, joint_labels(run.info, name), joint_labels(run.info, ""))
            if found is not None:
                axes[name][0] = ("pair_of_links", found.labels)
    return axes


def _by_pairs(run: Any) -> dict[str, np.ndarray]:
    """Return the channels of a run, those of pairs by the links and not by the slots that they had."""
    tables = ((name, by_pair(run.channels, run.info, name)) for name in run)
    return dict(run.items()) | {name: table.values for name, table in tables if table is not None}


def _axes_of(name: str, shape: tuple[int, ...], joints: list[str], whole: list[str]) -> list[tuple[str, list[str]]]:
    """Name and label the axes after the time; joints: of the numbers of this channel, whole: of all others."""
    channel, axes = BY_NAME.get(name), []
    for k, size in enumerate(shape):
        axis, labels = f"{name}_{k}", [str(number) for number in range(size)]
        if channel is not None and channel.of == "row" and size == len(joints):
            axis, labels = channel.of, list(joints)
        elif channel is not None and channel.of in OF_JOINTS and k == 0 and size == len(joints):
            axis, labels = "joint" if joints == whole else "position", list(joints)
        elif channel is not None and channel.of in ("point", "slot", "turning") and k == 0:
            axis = channel.of if len(shape) > 1 or channel.width == 1 else axis
        elif channel is not None and size == len(channel.labels):
            own = channel.labels  # labels that come again are those of the quaternion: x y z w qx qy qz
            labels = [f"q{label}" if label in own[:j] else label for j, label in enumerate(own)]
        axes.append((axis, labels))
    return axes
