"""Find published robots: those of `example-robot-data`, `pybullet_data` and `mani_skill`, as far as installed."""

from __future__ import annotations

import importlib.util
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..base.brief import in_full
from ..model import Model
from ..robot_file import RobotFileError, RobotFileWarning, load_robot

PACKAGES = ("pybullet_data", "mani_skill")
PREFIX = Path("cmeel.prefix", "share", "example-robot-data", "robots")
VARIABLE = "FEATHERSTONE_GAIT_ROBOTS"  # of the environment: more folders
OBJECTS = "random_urdfs"  # a thousand single things


def folders() -> list[Path]:
    """Return the installed packages' folders of robots, and those that `FEATHERSTONE_GAIT_ROBOTS` names."""
    specs = [spec for spec in map(importlib.util.find_spec, PACKAGES) if spec]
    found = [Path(folder) for spec in specs for folder in spec.submodule_search_locations or ()]
    found += [Path(folder) / PREFIX for folder in sys.path if (Path(folder) / PREFIX).is_dir()]
    return found + [Path(folder) for folder in os.environ.get(VARIABLE, "").split(os.pathsep) if folder]


def published(places: Sequence[Path], refused: list[str]) -> Iterator[tuple[str, Model]]:
    """Yield name and robot of each URDF below the folders that moves; of robots that move alike, the first.

    refused: takes the files that do not load, and why.
    """
    known = set()
    for place in places:
        for path in sorted(place.rglob("*.urdf")):
            if OBJECTS in path.parts:
                continue
            name = f"{path.parent.name}/{path.stem}"
            try:
                model = _loaded(path)
            except (RobotFileError, ImportError, OSError) as error:
                refused.append(f"{name}: does not load: {str(error).splitlines()[0][:90]}")
                continue
            motion = in_full((model.links, model.joints, model.base))
            if model.joint_names and motion not in known:
                known.add(motion)
                yield name, model


def _loaded(path: Path) -> Model:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotFileWarning)
        return load_robot(path)
