"""Articulated-body simulation of servo-driven robots, and gait optimisation on top of it.

The public names are loaded when they are first used, so that importing the package costs nothing.  Walking patterns
are in `featherstone_gait.walking`, optimisers in `featherstone_gait.search`.
"""

from importlib import import_module
from typing import Any

from . import renamed

__version__ = "0.1.0"

_MODULES = {
    "dynamics": (
        "Poses",
        "center_of_mass",
        "contact_positions",
        "energy",
        "forward_dynamics",
        "forward_kinematics",
        "inverse_dynamics",
        "mass_matrix",
        "momentum",
        "spring_energy",
    ),
    "model": ("ContactPoint", "Controller", "Gearbox", "Ground", "Joint", "Link", "Model", "Servo", "Spring"),
    "view.plotting": ("plot_motion", "plot_trajectory"),
    "reference": ("Reference",),
    "robot_file": (
        "RobotFileError",
        "RobotFileNotFoundError",
        "gearbox_presets",
        "load_robot",
        "load_servo",
        "robot_names",
        "save_robot",
    ),
    "build.scene": ("CompiledScene", "compile_scene"),
    "run.simulate": ("Push", "initial_state", "simulate", "simulate_batch", "standing_state"),
    "trajectory": ("Trajectory",),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}

__all__ = sorted(_HOME)
renamed.install()


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562)."""
    if name in _HOME:
        value = getattr(import_module(f".{_HOME[name]}", __name__), name)
    else:
        value = renamed.lookup(__name__, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *__all__]
