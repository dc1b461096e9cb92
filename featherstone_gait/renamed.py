"""Names that have moved: the old ones work, with a warning, until version 0.3.

`RENAMED` is the only list.  An old module is found by `Finder`, which `install` puts behind Python's own finders.  A
module that is still there, but has lost names, has::

    def __getattr__(name):
        return renamed.lookup(__name__, name)
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

UNTIL = "0.3"
RENAMED = {  # modules, or names in modules (an old module has the names of the new one)
    "featherstone_gait.animation": "featherstone_gait.view.animation",
    "featherstone_gait.lane_engine": "featherstone_gait.run.lane_engine",
    "featherstone_gait.plotting": "featherstone_gait.view.plotting",
    "featherstone_gait.preflight": "featherstone_gait.build.preflight",
    "featherstone_gait.scene": "featherstone_gait.build.scene",
    "featherstone_gait.simulation": "featherstone_gait.run.simulate",
    "featherstone_gait.tree": "featherstone_gait.build.tree",
    "featherstone_gait.build.scene.LAWS": "featherstone_gait.build.actuator.LAWS",
    "featherstone_gait.build.scene.STOP_DEPTH": "featherstone_gait.core.effects.stop.STOP_DEPTH",
    "featherstone_gait.build.scene.TOOTH_LOAD": "featherstone_gait.build.actuator.TOOTH_LOAD",
    "featherstone_gait.build.tree.rotation_axis": "featherstone_gait.rotation.rotation_about",
    "featherstone_gait.run.simulate.BATCH": "featherstone_gait.run.batch.BATCH",
    "featherstone_gait.run.simulate.CHATTER_LIMIT": "featherstone_gait.run.verdict.CHATTER_LIMIT",
    "featherstone_gait.run.simulate.LEAST_STEP": "featherstone_gait.run.prepared.LEAST_STEP",
    "featherstone_gait.run.simulate.RINGING_LIMIT": "featherstone_gait.run.verdict.RINGING_LIMIT",
    "featherstone_gait.run.simulate.RTOL": "featherstone_gait.core.integrate.integrator.RTOL",
    "featherstone_gait.run.simulate.STATUS": "featherstone_gait.run.verdict.STATUS",
    "featherstone_gait.trajectory.UNITS": "featherstone_gait.core.step.state.UNITS",
    "featherstone_gait.walking.kinematics.LinkPoses": "featherstone_gait.dynamics.Poses",
    "featherstone_gait.walking.kinematics.axis_rotation": "featherstone_gait.rotation.rotation_about",
    "featherstone_gait.walking.kinematics.rpy_rotation": "featherstone_gait.rotation.rotation_from_rpy",
}
METHODS = {  # of classes, which keep the old ones by themselves
    "featherstone_gait.build.scene.CompiledScene.theta": "CompiledScene.method.theta",
    "featherstone_gait.walking.constraints.ConstrainedCost.map": "ConstrainedCost.costs",
    "featherstone_gait.walking.cost.WalkingCost.map": "WalkingCost.costs",
}


def install() -> None:
    """Let old names of modules be imported."""
    if Finder not in sys.meta_path:
        sys.meta_path.append(Finder)


def lookup(module: str, name: str) -> Any:
    """What `name` in `module` is now; called by the module's `__getattr__` (PEP 562).  Raises AttributeError."""
    old = f"{module}.{name}"
    if old not in RENAMED:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    from pkgutil import resolve_name

    warn(old, level=4)
    return resolve_name(RENAMED[old])


class Finder:
    """Finds old names of modules, and puts the new modules in their place (a meta path finder and its loader)."""

    @classmethod
    def find_spec(
        cls, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name not in RENAMED:
            return None
        return ModuleSpec(name, cls)  # type: ignore[arg-type]  # a class does as a loader, too

    @staticmethod
    def create_module(spec: ModuleSpec) -> None:
        """An empty one, as usual."""

    @staticmethod
    def exec_module(module: ModuleType) -> None:
        old = module.__name__
        warn(old, level=3)
        sys.modules[old] = import_module(RENAMED[old])


def warn(old: str, level: int = 3) -> None:
    """Say that `old` has a new name."""
    import warnings

    text = f"{old} is now {(RENAMED | METHODS)[old]}; the old name works until version {UNTIL}"
    warnings.warn(text, DeprecationWarning, stacklevel=level)
