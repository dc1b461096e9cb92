"""Servos: motor, controller, gearbox, and the source that feeds them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Literal, get_args

from ..base.arguments import instance, truth
from ..base.brief import brief
from .checks import allowed, check, choice_flaws, number_flaws, quantity, quantity_flaws

Law = Literal["state", "pid_position", "pid_speed", "pd", "pd_clamped"]
TORQUE_LAWS = ("pd", "pd_clamped")
ONE_KIND = (
    "give all joints one kind of law: for the sampled ones Controller('pd_clamped', Kp, Kd=Kd, torque_limit=T), or "
    "gearbox=None and @controller(writes='torque') for all"
)
FIRMWARE = ("compliance_margin", "punch", "pwm_steps", "duty_limit", "profile_speed", "delay")  # of a `Controller`


@dataclass(frozen=True)
class Gearbox:
    """A gear train between a motor and a joint.

    The last ten numbers belong to the friction models M2 to M6 and K_p of `core/effects/gear_friction.py`, named as in
    their source: M2 uses the Stribeck friction alone, M3 equal load frictions, M4 both with equal Stribeck loads.

    Attributes
    ----------
    ratio : float
        Rotor speed over joint speed, G [-].
    rotor_inertia : float
        Inertia J of the rotor, at the rotor [kg m^2]; reflected to the joint it is G^2 J.
    rotor_damping : float
        Viscous friction B_vr of the rotor, at the rotor [N m s/rad]; behind a rigid gear
        it damps the joint by G^2 B_vr, and is no part of the load on which friction depends.
    stiffness : float
        Stiffness K_out at the output [N m/rad].
    damping : float
        Damping B_out at the output [N m s/rad].
    backlash : float
        Whole gap, at the output [rad].
    external_load_friction : float
        K_e, share of the torque that the mechanism exerts [-].
    motor_load_friction : float
        K_m, share of the torque that drives the joint [-].
    load_product_friction : float
        K_p, of the product of both torques [1/(N m)].
    stribeck_speed : float
        v_s, speed beyond which the Stribeck terms vanish [rad/s].
    stribeck_exponent : float
        alpha, how suddenly they vanish [-].
    stribeck_friction : float
        K_cs [N m].
    stribeck_external_load, stribeck_motor_load : float
        K_es and K_ms [-].
    quadratic_external_load, quadratic_motor_load : float
        K_eq and K_mq [1/(N m)].
    """

    ratio: float = field(metadata=allowed("> 0", "-"))
    rotor_inertia: float = quantity(">= 0", "kg m^2", 0.0)
    rotor_damping: float = quantity(">= 0", "N m s/rad", 0.0)
    stiffness: float = quantity("> 0 or inf", "N m/rad", math.inf)
    damping: float = quantity(">= 0", "N m s/rad", 0.0)
    backlash: float = quantity(">= 0", "rad", 0.0)
    external_load_friction: float = quantity(">= 0", "-", 0.0)
    motor_load_friction: float = quantity(">= 0", "-", 0.0)
    load_product_friction: float = quantity(">= 0", "1/(N m)", 0.0)
    stribeck_speed: float = quantity("> 0", "rad/s", 1.0)
    stribeck_exponent: float = quantity("> 0", "-", 1.0)
    stribeck_friction: float = quantity(">= 0", "N m", 0.0)
    stribeck_external_load: float = quantity(">= 0", "-", 0.0)
    stribeck_motor_load: float = quantity(">= 0", "-", 0.0)
    quadratic_external_load: float = quantity(">= 0", "1/(N m)", 0.0)
    quadratic_motor_load: float = quantity(">= 0", "1/(N m)", 0.0)

    __repr__ = brief

    def __post_init__(self) -> None:
        remedy = "to turn the motor round, reverse the joint's axis"
        check(number_flaws("gearbox", "ratio", self.ratio, "> 0", "rotor turns per joint turn", remedy))
        check(quantity_flaws("gearbox", self))

    @property
    def reflected_inertia(self) -> float:
        """Inertia of the rotor at the joint, G^2 J [kg m^2]."""
        return self.ratio**2 * self.rotor_inertia

    @property
    def reflected_damping(self) -> float:
        """Viscous friction of the rotor at the joint, G^2 B_vr [N m s/rad]."""
        return self.ratio**2 * self.rotor_damping


def depends_on_load_or_speed(gearbox: Gearbox) -> bool:
    """Return whether a gearbox has dry friction beyond Coulomb's (models M2 to M6).

    Parameters
    ----------
    gearbox : Gearbox
        The gearbox.

    Returns
    -------
    bool
        Whether its friction depends on load or speed.
    """
    loads = (gearbox.external_load_friction, gearbox.motor_load_friction, gearbox.load_product_friction)
    slow = (gearbox.stribeck_friction, gearbox.stribeck_external_load, gearbox.stribeck_motor_load)
    return any((*loads, *slow, gearbox.quadratic_external_load, gearbox.quadratic_motor_load))


@dataclass(frozen=True)
class Controller:
    """The control law of a servo.

    The laws "state", "pid_position" and "pid_speed" are sampled every `period` and output a voltage (the servo of Lima
    et al. 2013, Fig. 3, with the controllers of SimTwo).  The laws "pd" and "pd_clamped" are continuous and output a
    torque: "pd" keeps the damping (back-EMF) outside the torque limit, "pd_clamped" limits the sum.

    Those from `compliance_margin` to `delay` describe the firmware of sampled laws (`core/effects/firmware.py`): the
    voltage is a duty cycle of the servo's `voltage_limit`, the nominal supply that gains and punch refer to.

    Attributes
    ----------
    law : {"state", "pid_position", "pid_speed", "pd", "pd_clamped"}
        Kind of control law.
    Kp : float
        Proportional gain [V/rad]; of pid_speed [V s/rad], of the pd laws [N m/rad].
    Ki : float
        Integral gain [V/(rad s)]; of pid_speed [V/rad].
    Kd : float
        Derivative gain [V s/rad]; of pid_speed [V s^2/rad], of the pd laws [N m s/rad].
    Kf : float
        Feed-forward of the reference angle [V/rad].
    period : float
        Sampling period [s].
    lag : float
        Time from issuing a reference until the controller sees it [s].
    torque_limit : float
        Torque limit of the pd laws [N m].
    compliance_margin : float
        Dead band of the error [rad]; of pid_speed [rad/s].
    punch : float
        Voltage added in the direction of an error beyond the dead band [V].
    pwm_steps : float
        Counts of a full duty cycle, 1023 for ten bits; 0 for a continuous duty cycle [-].
    duty_limit : float
        Largest duty cycle [-].
    profile_speed : float
        Speed at which the internal goal moves toward the reference [rad/s].
    delay : float
        Time from a reading to the voltage that follows from it, a whole number of steps [s].
    wrap : bool
        Go the short way round, for joints without limits: the error is taken modulo a turn, in (-pi, pi].
    """

    law: Law
    Kp: float = quantity(">= 0", "V/rad", 0.0)
    Ki: float = quantity(">= 0", "V/(rad s)", 0.0)
    Kd: float = quantity(">= 0", "V s/rad", 0.0)
    Kf: float = quantity("finite", "V/rad", 0.0)
    period: float = quantity("> 0", "s", 0.01)
    lag: float = quantity(">= 0", "s", 0.01)
    torque_limit: float = quantity("> 0 or inf", "N m", math.inf)
    compliance_margin: float = quantity(">= 0", "rad", 0.0)
    punch: float = quantity(">= 0", "V", 0.0)
    pwm_steps: float = quantity("0 or >= 1", "-", 0.0, "1023 are ten bits")
    duty_limit: float = quantity("> 0 and <= 1", "-", 1.0, "it is a share of the supply")
    profile_speed: float = quantity("> 0 or inf", "rad/s", math.inf)
    delay: float = quantity(">= 0", "s", 0.0)
    wrap: bool = False

    __repr__ = brief

    def __post_init__(self) -> None:
        check(choice_flaws("controller", "law", self.law, get_args(Law)), quantity_flaws("controller", self))
        object.__setattr__(self, "wrap", truth("controller: wrap", self.wrap))
        if self.wrap and self.law == "pid_speed":
            raise ValueError("controller: wrap is True, and the law 'pid_speed' follows no angle: leave wrap out")
        if self.law in TORQUE_LAWS:
            for f in fields(self):
                if f.name in (*FIRMWARE, "Ki", "Kf") and getattr(self, f.name) != f.default:
                    raise ValueError(
                        f"controller: {f.name} is {getattr(self, f.name)!r}; the law {self.law!r} is continuous and "
                        "has no integral, sampling or voltage: use a sampled law, or leave it out"
                    )
        elif self.torque_limit < math.inf:
            raise ValueError(
                f"controller: torque_limit is {self.torque_limit!r} N m; the law {self.law!r} outputs a voltage: give "
                "the servo a current_limit, or use 'pd' or 'pd_clamped'"
            )


@dataclass(frozen=True)
class Servo:
    """A DC motor with its controller, gearbox and friction (Lima et al. 2013, Tables 1 and 2).

    Servos with a torque law ("pd", "pd_clamped") need none of the motor's numbers.

    Attributes
    ----------
    controller : Controller
        Control law.
    gearbox : Gearbox
        Gear train.
    resistance : float
        Resistance R of the winding [Ohm].
    inductance : float
        Inductance L of the winding [H].
    motor_constant : float
        K, back-EMF over rotor speed [V s/rad] and torque over current [N m/A].
    voltage_limit : float
        Supply voltage [V].
    current_limit : float
        Current limit [A].
    current_slew : float
        Largest rate of the current [A/s].
    viscous_friction : float
        B_v at the output [N m s/rad].
    coulomb_friction : float
        F_c at the output [N m].
    stick_speed : float
        Speed up to which dry friction grows from zero [rad/s], so that a loaded joint creeps, at most at that speed; 0:
        dry friction holds a joint at rest.
    encoder_resolution : float
        Step of the measured angle [rad]; 0 is exact.
    speed_filter : float
        Time constant of the filtered speed that controller and friction use [s].

    Raises
    ------
    ValueError
        For numbers out of range, and for a sampled law without resistance, motor constant or voltage limit.
    """

    controller: Controller
    gearbox: Gearbox = field(default_factory=lambda: Gearbox(1.0))
    resistance: float = quantity(">= 0", "Ohm", 0.0)
    inductance: float = quantity(">= 0", "H", 0.0)
    motor_constant: float = quantity(">= 0", "V s/rad", 0.0)
    voltage_limit: float = quantity(">= 0", "V", 0.0)
    current_limit: float = quantity("> 0 or inf", "A", math.inf)
    current_slew: float = quantity("> 0 or inf", "A/s", math.inf)
    viscous_friction: float = quantity(">= 0", "N m s/rad", 0.0)
    coulomb_friction: float = quantity(">= 0", "N m", 0.0)
    stick_speed: float = quantity(">= 0", "rad/s", 0.0)
    encoder_resolution: float = quantity(">= 0", "rad", 0.0)
    speed_filter: float = quantity(">= 0", "s", 0.0)

    __repr__ = brief

    def __post_init__(self) -> None:
        instance("servo: controller", self.controller, Controller, "give Controller(law)")
        instance("servo: gearbox", self.gearbox, Gearbox, "give Gearbox(ratio)")
        if self.controller.law not in TORQUE_LAWS:
            for name in ("resistance", "motor_constant", "voltage_limit"):
                remedy = f"correct it, the law {self.controller.law!r} drives a motor"
                check(number_flaws("servo", name, getattr(self, name), "> 0", SERVO_UNITS[name], remedy))
        check(quantity_flaws("servo", self))


# Units of the numbers of a servo; the gains of the laws other than state and pid_position differ.
SERVO_UNITS = {
    f.name: f.metadata["unit"] for part in (Servo, Controller, Gearbox) for f in fields(part) if "unit" in f.metadata
}


@dataclass(frozen=True)
class Supply:
    """The source that feeds all servos of a robot: V = voltage - resistance * sum of duty cycle times motor current.

    Servos apply duty cycles of V.  At their `voltage_limit` and without resistance the source has no effect.

    Attributes
    ----------
    voltage : float
        Voltage without load [V].
    resistance : float
        Resistance of battery and cables [Ohm].
    """

    voltage: float = field(metadata=allowed("> 0", "V"))
    resistance: float = quantity(">= 0", "Ohm", 0.0)

    __repr__ = brief

    def __post_init__(self) -> None:
        check(quantity_flaws("supply", self))
