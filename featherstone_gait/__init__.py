"""Articulated-body simulation of servo-driven robots, and gait optimisation on top of it.

The public names are loaded when they are first used, so that importing the package costs nothing.  Walking patterns
are in `featherstone_gait.walking`, optimisers in `featherstone_gait.search`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from . import renamed

if TYPE_CHECKING:  # what `__getattr__` finds
    from .build.scene import CompiledScene as CompiledScene
    from .build.scene import compile_scene as compile_scene
    from .channels import channel_table as channel_table
    from .collision import Clearance as Clearance
    from .collision import clearance as clearance
    from .contact_choice import contact_points as contact_points
    from .contact_choice import with_contacts as with_contacts
    from .dynamics import Coupling as Coupling
    from .dynamics import Poses as Poses
    from .dynamics import center_of_mass as center_of_mass
    from .dynamics import contact_positions as contact_positions
    from .dynamics import coupling_matrix as coupling_matrix
    from .dynamics import energy as energy
    from .dynamics import forward_dynamics as forward_dynamics
    from .dynamics import forward_kinematics as forward_kinematics
    from .dynamics import inverse_dynamics as inverse_dynamics
    from .dynamics import mass_matrix as mass_matrix
    from .dynamics import momentum as momentum
    from .dynamics import spring_energy as spring_energy
    from .equilibrium import Trim as Trim
    from .equilibrium import trim as trim
    from .jacobians import center_of_mass_jacobian as center_of_mass_jacobian
    from .jacobians import jacobian as jacobian
    from .linearisation import Kink as Kink
    from .linearisation import Linearisation as Linearisation
    from .linearisation import linearise as linearise
    from .model import ContactPoint as ContactPoint
    from .model import Controller as Controller
    from .model import Gearbox as Gearbox
    from .model import Ground as Ground
    from .model import HeightField as HeightField
    from .model import Joint as Joint
    from .model import Link as Link
    from .model import Mimic as Mimic
    from .model import Model as Model
    from .model import Servo as Servo
    from .model import Spring as Spring
    from .model import Supply as Supply
    from .model import stairs as stairs
    from .posture import Posture as Posture
    from .posture import Target as Target
    from .posture import inverse_kinematics as inverse_kinematics
    from .reference import Reference as Reference
    from .rest import nearest_posture as nearest_posture
    from .robot_file import RobotFileError as RobotFileError
    from .robot_file import RobotFileNotFoundError as RobotFileNotFoundError
    from .robot_file import RobotFileWarning as RobotFileWarning
    from .robot_file import gearbox_presets as gearbox_presets
    from .robot_file import load_robot as load_robot
    from .robot_file import load_servo as load_servo
    from .robot_file import robot_names as robot_names
    from .robot_file import save_robot as save_robot
    from .run.program import controller as controller
    from .run.session import Session as Session
    from .run.simulate import Push as Push
    from .run.simulate import initial_state as initial_state
    from .run.simulate import restarted as restarted
    from .run.simulate import simulate as simulate
    from .run.simulate import simulate_batch as simulate_batch
    from .run.simulate import standing_state as standing_state
    from .shape import Box as Box
    from .shape import Capsule as Capsule
    from .shape import Cylinder as Cylinder
    from .shape import Hull as Hull
    from .shape import Mesh as Mesh
    from .shape import Shape as Shape
    from .shape import Sphere as Sphere
    from .trajectory import Trajectory as Trajectory
    from .view.plotting import plot_motion as plot_motion
    from .view.plotting import plot_trajectory as plot_trajectory
    from .worlds import Spread as Spread
    from .worlds import Worlds as Worlds

__version__ = "0.2.0.dev0"

_MODULES = {
    "channels": ("channel_table",),
    "collision": ("Clearance", "clearance"),
    "contact_choice": ("contact_points", "with_contacts"),
    "dynamics": (
        "Coupling",
        "Poses",
        "center_of_mass",
        "contact_positions",
        "coupling_matrix",
        "energy",
        "forward_dynamics",
        "forward_kinematics",
        "inverse_dynamics",
        "mass_matrix",
        "momentum",
        "spring_energy",
    ),
    "equilibrium": ("Trim", "trim"),
    "jacobians": ("center_of_mass_jacobian", "jacobian"),
    "linearisation": ("Kink", "Linearisation", "linearise"),
    "model": (
        "ContactPoint",
        "Controller",
        "Gearbox",
        "Ground",
        "HeightField",
        "Joint",
        "Link",
        "Mimic",
        "Model",
        "Servo",
        "Spring",
        "Supply",
        "stairs",
    ),
    "view.plotting": ("plot_motion", "plot_trajectory"),
    "posture": ("Posture", "Target", "inverse_kinematics"),
    "reference": ("Reference",),
    "rest": ("nearest_posture",),
    "robot_file": (
        "RobotFileError",
        "RobotFileNotFoundError",
        "RobotFileWarning",
        "gearbox_presets",
        "load_robot",
        "load_servo",
        "robot_names",
        "save_robot",
    ),
    "build.scene": ("CompiledScene", "compile_scene"),
    "run.program": ("controller",),
    "run.session": ("Session",),
    "run.simulate": ("Push", "initial_state", "restarted", "simulate", "simulate_batch", "standing_state"),
    "shape": ("Box", "Capsule", "Cylinder", "Hull", "Mesh", "Shape", "Sphere"),
    "trajectory": ("Trajectory",),
    "worlds": ("Spread", "Worlds"),
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
