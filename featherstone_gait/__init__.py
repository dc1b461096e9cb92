"""Articulated-body simulation of servo-driven robots, and gait optimization on top of it.

The public names are loaded when they are first used, so that importing the package costs nothing.  Walking patterns
are in `featherstone_gait.walking`, optimizers in `featherstone_gait.search`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .base.deprecated import renamed

if TYPE_CHECKING:  # what `__getattr__` finds
    from .analysis.equilibrium import Trim as Trim
    from .analysis.equilibrium import trim as trim
    from .analysis.linearization import Discontinuity as Discontinuity
    from .analysis.linearization import Linearization as Linearization
    from .analysis.linearization import linearize as linearize
    from .dynamics import Coupling as Coupling
    from .dynamics import Energy as Energy
    from .dynamics import Poses as Poses
    from .dynamics import Wrench as Wrench
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
    from .dynamics.conventions import from_engine as from_engine
    from .dynamics.conventions import to_engine as to_engine
    from .dynamics.inverse_kinematics import IKResult as IKResult
    from .dynamics.inverse_kinematics import Target as Target
    from .dynamics.inverse_kinematics import inverse_kinematics as inverse_kinematics
    from .dynamics.jacobians import center_of_mass_jacobian as center_of_mass_jacobian
    from .dynamics.jacobians import jacobian as jacobian
    from .geometry.contact_choice import contact_points as contact_points
    from .geometry.contact_choice import with_contacts as with_contacts
    from .geometry.distance import Clearance as Clearance
    from .geometry.distance import clearance as clearance
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
    from .model.rest_posture import nearest_posture as nearest_posture
    from .model.shapes import Box as Box
    from .model.shapes import Capsule as Capsule
    from .model.shapes import Cylinder as Cylinder
    from .model.shapes import Hull as Hull
    from .model.shapes import Mesh as Mesh
    from .model.shapes import Shape as Shape
    from .model.shapes import Sphere as Sphere
    from .robot_file import RobotFileError as RobotFileError
    from .robot_file import RobotFileNotFoundError as RobotFileNotFoundError
    from .robot_file import RobotFileWarning as RobotFileWarning
    from .robot_file import gearbox_presets as gearbox_presets
    from .robot_file import load_robot as load_robot
    from .robot_file import load_servo as load_servo
    from .robot_file import robot_names as robot_names
    from .robot_file import save_robot as save_robot
    from .run.program import controller as controller
    from .run.reference import Reference as Reference
    from .run.session import Session as Session
    from .run.simulate import Push as Push
    from .run.simulate import initial_state as initial_state
    from .run.simulate import reset_time as reset_time
    from .run.simulate import simulate as simulate
    from .run.simulate import simulate_batch as simulate_batch
    from .run.simulate import standing_state as standing_state
    from .run.status import Status as Status
    from .run.trajectory import Trajectory as Trajectory
    from .run.worlds import Distribution as Distribution
    from .run.worlds import Worlds as Worlds
    from .scene.channels import StateView as StateView
    from .scene.channels import channel_table as channel_table
    from .scene.compile import CompiledScene as CompiledScene
    from .scene.compile import compile_scene as compile_scene
    from .view.movie import save_movie as save_movie
    from .view.plotting import plot as plot
    from .view.plotting import plot_motion as plot_motion
    from .view.shown import show as show
    from .view.shown import show_live as show_live
    from .view.tree import tree_text as tree_text

__version__ = "0.2.0.dev0"

_MODULES = {
    "geometry.distance": ("Clearance", "clearance"),
    "geometry.contact_choice": ("contact_points", "with_contacts"),
    "dynamics": (
        "Coupling",
        "Energy",
        "Poses",
        "Wrench",
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
    "analysis.equilibrium": ("Trim", "trim"),
    "dynamics.conventions": ("from_engine", "to_engine"),
    "dynamics.jacobians": ("center_of_mass_jacobian", "jacobian"),
    "analysis.linearization": ("Discontinuity", "Linearization", "linearize"),
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
    "view.movie": ("save_movie",),
    "view.plotting": ("plot", "plot_motion"),
    "view.shown": ("show", "show_live"),
    "view.tree": ("tree_text",),
    "dynamics.inverse_kinematics": ("IKResult", "Target", "inverse_kinematics"),
    "run.reference": ("Reference",),
    "model.rest_posture": ("nearest_posture",),
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
    "scene.compile": ("CompiledScene", "compile_scene"),
    "scene.channels": ("StateView", "channel_table"),
    "run.program": ("controller",),
    "run.session": ("Session",),
    "run.simulate": ("Push", "initial_state", "reset_time", "simulate", "simulate_batch", "standing_state"),
    "model.shapes": ("Box", "Capsule", "Cylinder", "Hull", "Mesh", "Shape", "Sphere"),
    "run.status": ("Status",),
    "run.trajectory": ("Trajectory",),
    "run.worlds": ("Distribution", "Worlds"),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}

_renamed = renamed(
    __name__,
    {
        "Linearisation": "featherstone_gait.analysis.linearization:Linearization",
        "Kink": "featherstone_gait.analysis.linearization:Discontinuity",
        "Posture": "featherstone_gait.dynamics.inverse_kinematics:IKResult",
        "Spread": "featherstone_gait.run.worlds:Distribution",
        "linearise": "featherstone_gait.analysis.linearization:linearize",
        "restarted": "featherstone_gait.run.simulate:reset_time",
    },
)

__all__ = sorted(_HOME)
_HOME["plot_trajectory"] = "view.plotting"  # an old name, which warns when it is called


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562)."""
    if name in _HOME:
        value = getattr(import_module(f".{_HOME[name]}", __name__), name)
    else:
        return _renamed(name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
