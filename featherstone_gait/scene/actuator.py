"""Build the servos of a model as one of the actuators of `core/effects`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import shown
from ..base.records import fill, filled, records
from ..core.effects.actuator import controller_of, motor_of
from ..core.effects.controller import CONTROLLER, PID_POSITION, PID_SPEED, STATE_FEEDBACK
from ..core.effects.decay import DECAYS, fill_decay
from ..core.effects.gearbox import GEAR
from ..core.effects.mipsd_servo import MipsdServo
from ..core.effects.motor import MOTOR
from ..core.effects.pd_servo import PD, PDServo
from ..core.effects.rigid_servo import RigidServo
from ..core.integrate.integrator import Integrator
from ..dynamics.tree import joint_armature
from ..model import TORQUE_LAWS, Controller, Model, Servo
from ..model.servo import ONE_KIND
from .gearbox_kinds import GEARBOX_KINDS, GearboxKind

Actuator: TypeAlias = PDServo | MipsdServo | RigidServo
LAWS = {"state": STATE_FEEDBACK, "pid_position": PID_POSITION, "pid_speed": PID_SPEED}
BEYOND = 10.0  # stall currents, which back-EMF and what is left of a current do not add up to
SOON = 1e-6  # [s] in which a current without inductance may rise
TOOTH_LOAD = 0.1  # of the stall torque, at which teeth that meet across a gap are damped as the gearbox is


class Drive(NamedTuple):
    """The servos of a scene, as the kernels read them."""

    kind: GearboxKind | None
    servos: list[Servo | None]  # of each moving joint; None where there is none
    actuator: Actuator | None
    armature: np.ndarray | None  # (n,) of the joints, with G^2 J of the rotors of rigid gearboxes [kg m^2 or kg]

    @property
    def sampled(self) -> bool:
        """Return whether the controllers are sampled."""
        return self.actuator is not None and "servo" in self.actuator.PARTS

    @property
    def switches(self) -> bool:
        """Return whether forces of sampled servos may be discontinuous between ticks: currents limited, teeth apart."""
        return self.sampled and any(_switches(servo) for servo in self.servos if servo)

    @property
    def slow_current(self) -> float | None:
        """Return the limited rate of a current without inductance [A/s] of sampled servos; None if there is none."""
        without = [servo for servo in self.servos if servo and self.sampled and not servo.inductance]
        slow = (s.current_slew for s in without if s.current_slew * SOON < s.voltage_limit / s.resistance)
        return next(slow, None)


def usual_gearbox(model: Model) -> GearboxKind | None:
    """Return the gearbox model that the servos have numbers for: "mipsd" needs elastic gears; None without servos."""
    servos = [model.servos[name] for name in model.joint_names if name in model.servos]
    if not servos:
        return None
    elastic = all(is_elastic(servo) and servo.controller.law not in TORQUE_LAWS for servo in servos)
    return "mipsd" if elastic else "rotor"


def _switches(servo: Servo) -> bool:
    stall = servo.voltage_limit / servo.resistance
    rise = servo.current_slew * max(servo.inductance / servo.resistance, SOON)
    return servo.gearbox.backlash > 0 or min(servo.current_limit, rise) < BEYOND * stall


def servo_gearbox(model: Model, gearbox: GearboxKind | None) -> GearboxKind:
    """Return a gearbox model, where none is named the usual one; raise ValueError for a robot without servos."""
    usual = usual_gearbox(model)
    if usual is None:
        raise ValueError(
            f"{model.name} has no servos; name them in the [servos] table of its TOML, or use gearbox=None"
        )
    return usual if gearbox is None else gearbox


def is_elastic(servo: Servo) -> bool:
    """Return whether the gear of a servo has the numbers that "mipsd" needs."""
    return servo.gearbox.stiffness < math.inf and servo.gearbox.rotor_inertia > 0


def build_drive(model: Model, kind: GearboxKind | None) -> Drive:
    """Build the actuator of a scene; raise ValueError for kinds and laws that do not fit the model."""
    joints = model.joint_names
    if kind is None:
        return Drive(None, [None] * len(joints), None, joint_armature(model))
    if not isinstance(kind, str) or kind not in GEARBOX_KINDS:
        raise ValueError(f"gearbox is {shown(kind)}; use {', '.join(map(repr, GEARBOX_KINDS))} or None")
    kind = servo_gearbox(model, kind)
    servos = [model.servos.get(name) for name in joints]
    continuous = {servo.controller.law in TORQUE_LAWS for servo in servos if servo}
    if len(continuous) > 1:
        raise ValueError(f"{model.name} mixes pd servos with sampled ones; {ONE_KIND}")
    armature = joint_armature(model)
    if kind == "rotor":
        rotors = np.array([s.gearbox.reflected_inertia if s else 0.0 for s in servos])
        armature = rotors if armature is None else armature + rotors
    return Drive(kind, servos, _actuator(model, servos, kind, continuous.pop()), armature)


def _actuator(model: Model, servos: list[Servo | None], kind: GearboxKind, continuous: bool) -> Actuator:
    if continuous and kind == "mipsd":
        raise ValueError(f"{model.name}: a pd servo has no motor to drive a spring-damper gearbox; use gearbox='rotor'")
    if continuous:
        return PDServo(pd_laws([servo.controller if servo else None for servo in servos]), wraps(model, servos))
    if kind == "mipsd":
        return MipsdServo(_motors(servos), _controllers(servos), _gears(model, servos))
    return RigidServo(_motors(servos), _controllers(servos))


def _motors(servos: list[Servo | None]) -> np.recarray:
    table = filled(MOTOR, [(servo,) if servo else None for servo in servos])
    table.resistance = [servo.resistance if servo else 1.0 for servo in servos]  # no servo: no torque, no current
    table.torque_constant = [servo.gearbox.ratio * servo.motor_constant if servo else 0.0 for servo in servos]
    return table


def _controllers(servos: list[Servo | None]) -> np.recarray:
    table = filled(CONTROLLER, [(servo.controller, servo) if servo else None for servo in servos])
    table.law = [LAWS[servo.controller.law] if servo else 0 for servo in servos]
    return table


def passive(kind: type[Actuator], count: int) -> Actuator:
    """Return so many joints without servos, in a scene whose servos are of this kind."""
    none: list[Servo | None] = [None] * count
    if issubclass(kind, PDServo):
        return PDServo(pd_laws([None] * count), None)
    if issubclass(kind, MipsdServo):
        return MipsdServo(_motors(none), _controllers(none), _no_gears(count))
    return RigidServo(_motors(none), _controllers(none))


def _no_gears(count: int) -> np.recarray:
    table = records(count, GEAR)
    table.inertia = table.ratio = 1.0
    return table


def _gears(model: Model, servos: list[Servo | None]) -> np.recarray:
    table = _no_gears(len(servos))
    for row, servo, name in zip(table, servos, model.joint_names):
        if servo is None:
            continue
        g = servo.gearbox
        if not is_elastic(servo):
            raise ValueError(
                f"{model.name}: joint {name}: mipsd needs a finite stiffness and a rotor inertia > 0; they are "
                f"{g.stiffness} N m/rad and {g.rotor_inertia} kg m^2: choose another gearbox, or gearbox='rotor'"
            )
        fill(row, g)
        row.gap = 0.5 * g.backlash
        row.inertia = g.reflected_inertia
        row.rotor_damping = g.reflected_damping
        row.tooth_damping = g.damping / (TOOTH_LOAD * stall_torque(servo))
    return table


def pd_laws(laws: Sequence[Controller | None], dtype: np.dtype = PD) -> np.recarray:
    """Return the records of torque laws."""
    table = filled(dtype, [(law,) if law else None for law in laws])
    table.free_damping = [law is not None and law.law == "pd" for law in laws]
    table.torque_limit = np.minimum(table.torque_limit, 1e300)
    return table


def wraps(model: Model, servos: list[Servo | None]) -> np.ndarray | None:
    """Return 1.0 for the joints that go the short way round (n,), None if none does.

    Raises ValueError for joints that do not repeat after a turn, or cannot make one.
    """
    table = np.array([float(servo is not None and servo.controller.wrap) for servo in servos])
    for joint, wrapped in zip(model.moving_joints, table):
        if wrapped and (joint.type == "prismatic" or min(-joint.lower, joint.upper) < math.inf):
            found = "prismatic" if joint.type == "prismatic" else f"limited to {joint.lower:g} ... {joint.upper:g} rad"
            raise ValueError(
                f"{model.name}: joint {joint.name} is {found} and its servo has wrap; only a joint without limits goes "
                "the short way round: set wrap in [servos.joints.NAME] of these alone, or use type 'continuous'"
            )
    return table if table.any() else None


def fold_springs(drive: Drive, integrator: Integrator, h: float, inertias: ArrayLike) -> None:
    """Include the spring of a continuous servo in the implicit step h [s] only where its own period needs it.

    Euler's method is more accurate with the spring at the start of the step.  inertias: those that the joints feel
    [kg m^2 or kg].
    """
    if isinstance(drive.actuator, PDServo):
        pd, inertia = drive.actuator.pd, np.asarray(inertias)
        driven = np.array([servo is not None for servo in drive.servos])
        pd.fold = driven & (integrator.folds_spring | (h * h * pd.Kp > inertia + h * pd.Kd))


def build_decay(drive: Drive, h: float) -> np.ndarray | None:
    """Return factors (n, DECAYS) by which currents and filtered speeds decay in a step h [s]; None without motors."""
    if drive.actuator is None or not drive.sampled:
        return None
    decay = np.zeros((len(drive.servos), DECAYS))
    fill_decay(motor_of(drive.actuator), controller_of(drive.actuator), h, decay)
    return decay


def controller_period(model: Model, drive: Drive, h: float, without: float) -> tuple[float, float]:
    """Return sampling period and lag of the controllers [s], the same for all joints.

    without: the period [s] that is rounded to whole steps where no controller is sampled.
    """
    if not drive.sampled:
        return max(1, round(without / h)) * h, 0.0
    settings = {(s.controller.period, s.controller.lag) for s in drive.servos if s}
    if len(settings) > 1:
        raise ValueError(f"{model.name}: controllers differ in period or lag: {sorted(settings)}; give them the same")
    period, lag = settings.pop()
    if round(period / h) < 1 or abs(round(period / h) * h - period) > 1e-9 * period:
        raise ValueError(
            f"timestep {h:g} s does not divide the controllers' period of {period:g} s; steps end on ticks"
        )
    return period, lag


def stall_torque(servo: Servo) -> float:
    """Return the torque of a servo at rest [N m]; infinite for a torque law without a limit and a motor."""
    if servo.controller.torque_limit < math.inf or servo.resistance == 0.0:
        return servo.controller.torque_limit
    current = min(servo.current_limit, servo.voltage_limit / servo.resistance)
    return servo.gearbox.ratio * servo.motor_constant * current
