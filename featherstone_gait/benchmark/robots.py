"""Find published robots: those of `example-robot-data`, `pybullet_data` and `mani_skill`, as far as installed.

Two of them walk: ANYmal B on its four point feet, and the Unitree G1 with the twelve joints of its legs.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..base.brief import in_full
from ..model import Ground, Model
from ..robot_file import RobotFileError, RobotFileWarning, load_robot
from ..scene.compile import CompiledScene, compile_scene
from ..walking import (
    Pattern,
    WalkingCost,
    cheapest_plan,
    fit_gait,
    four_legged_stride,
    mirror_by_place,
    with_generic_servos,
)

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


def anymal() -> WalkingCost:
    """Return a trot of 120 mm in 0.48 s.  Raises ImportError without the package of the robot."""
    robot = with_generic_servos(_on_its_feet("anymal_b_simple_description/robots/anymal.urdf"), leg=0.55)
    bend = {"HAA": 0.0, "HFE": 0.4, "KFE": -0.8}  # [rad], of the hind legs the other way
    posture = np.array([bend[name[3:]] * (1.0 if name[1] == "F" else -1.0) for name in robot.joint_names])
    stride = four_legged_stride(robot, posture, Pattern(period=0.48, step=0.12, lift=0.06))
    gait = fit_gait(stride, 8, mirror=mirror_by_place(robot, posture)).gait
    return WalkingCost(_grounded(robot), gait, posture, blend_strides=2)


def g1() -> WalkingCost:
    """Return the cheapest of 73 plans, for the robot with all joints but those of its legs held.

    Its servos are twice as strong for its weight as a Bioloid's: with such as these none of 35 plans walks in eight
    worlds.  Raises as `anymal`.
    """
    urdf = "g1_description/urdf/g1_29dof_rev_1_0.urdf"
    names = _on_its_feet(urdf).joint_names
    held = [name for name in names if not any(part in name for part in ("hip", "knee", "ankle"))]
    robot = with_generic_servos(_on_its_feet(urdf, held), leg=0.75, margin=2.0)
    return cheapest_plan(_grounded(robot), "step").cost


def _on_its_feet(urdf: str, locked: Sequence[str] = ()) -> Model:
    path = next((folder / urdf for folder in folders() if (folder / urdf).is_file()), None)
    if path is None:
        raise ImportError(f"{Path(urdf).name} comes with a package; pip install example-robot-data")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the file says in another way than it should
        return load_robot(path, base="floating", contacts="feet", locked=[*locked])


def _grounded(robot: Model) -> CompiledScene:
    return compile_scene(robot, "mipsd", Ground(), "midpoint", 1e-3)
