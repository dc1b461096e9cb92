"""What a robot is: frozen dataclasses in SI units, as read from URDF and TOML, checked when they are made.

A `Model` holds the links and joints exactly as the files state them; `rigid_bodies` merges what moves as one.  Laying
the numbers out for the kernels is the work of `scene/`.

Coordinates of a state, the same as MuJoCo's free joint:

- fixed base: ``q (nq,)`` are the joint positions in file order, ``qd (nv,)`` their rates;
- floating base: ``q = [x y z, qw qx qy qz, joints]``, ``qd = [v (world axes), omega (body axes), joint rates]``.

Every class raises ValueError, naming the element, the value, what is allowed and what to do about it.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from ..base.arguments import floats, instance, is_real, shown, texts, whole
from ..base.arguments import listed as items
from ..base.fixed_order import applied, product
from ..base.flaws import Flaw, FlawError, listed
from ..base.rotation import rotation_about, rotation_from_rpy, rotation_z_to
from ..core.compile.elementary import NEAR
from .mass_checks import indefinite_flaws
from .shapes import Shape

JointType = Literal["revolute", "continuous", "prismatic", "fixed"]
Base = Literal["fixed", "floating"]
Law = Literal["state", "pid_position", "pid_speed", "pd", "pd_clamped"]
TORQUE_LAWS = ("pd", "pd_clamped")
FIRMWARE = ("compliance_margin", "punch", "pwm_steps", "duty_limit", "profile_speed", "delay")  # of a `Controller`

MOST_STAIRS = 10**6
AXIS_TOLERANCE = 1e-9  # how far from 1 the length of a joint axis may be
DEFINITE_TOLERANCE = 1e-9  # smallest principal moment of inertia, relative to the largest

LARGEST = 1e50  # number of a robot [SI]: products of several stay within floats, and so do their inverses

_RULES: dict[str, Callable[[float], bool]] = {
    "> 0": lambda x: 1.0 / LARGEST <= x <= LARGEST,
    ">= 0": lambda x: 0 <= x <= LARGEST,
    "> 0 or inf": lambda x: x >= 1.0 / LARGEST,
    ">= 0 or inf": lambda x: x >= 0,
    "finite": lambda x: abs(x) <= LARGEST,
    "0 or >= 1": lambda x: x == 0 or 1 <= x <= LARGEST,
    "> 0 and <= 1": lambda x: 0 < x <= 1,
}


def _refuse(element: str, texts: Iterable[str]) -> None:
    """Raise FlawError if there is any text."""
    flaws = [Flaw(element, text) for text in texts]
    if flaws:
        raise FlawError(flaws)


def _range(rule: str, unit: str, remedy: str = "") -> dict[str, str]:
    """Metadata of a field that must be a number of this range and unit; `remedy`: what to do about another."""
    return {"rule": rule, "unit": unit, "remedy": remedy or f"correct it, and mind the unit {unit}"}


def _number(rule: str, unit: str, default: float, remedy: str = "") -> Any:
    """Such a field with a default."""
    return field(default=default, metadata=_range(rule, unit, remedy))


@dataclass(frozen=True)
class Link:
    """A rigid body.  `inertia` is about the center of mass, in link axes.

    An inertia that no body has is taken as it is: a `Model` asks only that its mass matrix be positive definite.
    """

    name: str
    mass: float = field(metadata=_range(">= 0", "kg", "a link without mass is one without <inertial>"))  # 0: a frame
    center_of_mass: tuple[float, float, float]  # [m], link frame
    inertia: tuple[float, ...]  # ixx ixy ixz iyy iyz izz [kg m^2]

    def __post_init__(self) -> None:
        _refuse(f"link {self.name!r}", self._flaws(f"link {self.name!r}"))
        _freeze(self, "center_of_mass", "inertia")

    def _flaws(self, what: str) -> Iterator[str]:
        yield from _name_flaws("link", self.name)
        yield from _number_flaws(what, self)
        yield from _vector_flaws(what, "center_of_mass", self.center_of_mass, 3)
        yield from _vector_flaws(what, "inertia", self.inertia, 6)


@dataclass(frozen=True)
class Mimic:
    """A coupling: the joint's position is multiplier * (that of the joint named) + offset.

    The joint keeps its coordinate, and its own stops, friction and servo act on both.  A locked joint follows none.
    """

    joint: str
    multiplier: float = _number("finite", "-", 1.0)
    offset: float = _number("finite", "rad or m", 0.0)

    def __post_init__(self) -> None:
        _check_name("joint", self.joint)
        _check_numbers(f"mimic of joint {self.joint!r}", self)


@dataclass(frozen=True)
class Joint:
    """A joint from `parent` to `child`; the child's frame sits at the joint."""

    name: str
    type: JointType
    parent: str
    child: str
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)  # child frame in the parent frame at zero [m]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)  # fixed-axis roll, pitch, yaw [rad]
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)  # in the child frame; unit length unless fixed
    lower: float = -math.inf  # [rad or m]
    upper: float = math.inf  # [rad or m]
    effort: float = _number(">= 0 or inf", "SI", math.inf, "correct the value")  # [N m or N]
    velocity: float = _number(">= 0 or inf", "SI", math.inf, "correct the value")  # [rad/s or m/s]
    damping: float = _number(">= 0", "SI", 0.0, "correct the value")  # [N m s/rad or N s/m]
    friction: float = _number(">= 0", "SI", 0.0, "correct the value")  # Coulomb [N m or N]
    armature: float = _number(">= 0", "SI", 0.0, "correct the value")  # of the joint alone [kg m^2 or kg]
    mimic: Mimic | None = None  # the joint that this one follows

    def __post_init__(self) -> None:
        _refuse(f"joint {self.name!r}", self._flaws(f"joint {self.name!r}"))
        _freeze(self, "xyz", "rpy", "axis")

    def _flaws(self, what: str) -> Iterator[str]:
        yield from _name_flaws("joint", self.name)
        yield from _choice_flaws(what, "type", self.type, get_args(JointType))
        for name in ("parent", "child"):
            yield from _text_flaws(what, name, getattr(self, name))
        if self.mimic is not None and not isinstance(self.mimic, Mimic):
            yield f"{what}: mimic is {shown(self.mimic)}; expected a Mimic or None: give Mimic(joint)"
        if isinstance(self.parent, str) and isinstance(self.child, str) and self.parent == self.child:
            yield f"{what}: parent and child are both {self.child!r}; connect two different links"
        yield from _vector_flaws(what, "xyz", self.xyz, 3)
        turned = list(_vector_flaws(what, "rpy", self.rpy, 3))
        yield from turned or _angle_flaws(what, "rpy", self.rpy)
        yield from _vector_flaws(what, "axis", self.axis, 3)
        if isinstance(self.type, str) and self.type != "fixed":
            yield from self._motion_flaws(what)

    def _motion_flaws(self, what: str) -> Iterator[str]:
        if not any(_vector_flaws(what, "axis", self.axis, 3)) and abs(math.hypot(*self.axis) - 1.0) > AXIS_TOLERANCE:
            yield f"{what}: axis {self.axis!r} is not of unit length; divide it by its length"
        if not (is_real(self.lower) and is_real(self.upper)):
            yield f"{what}: limits lower {shown(self.lower)}, upper {shown(self.upper)}; expected numbers: correct them"
        elif not self.lower <= self.upper or self.lower == math.inf or self.upper == -math.inf:
            yield f"{what}: limits lower {self.lower!r}, upper {self.upper!r}; lower must be below upper: swap them"
        if self.type == "continuous" and (self.lower, self.upper) != (-math.inf, math.inf):
            yield f"{what}: type 'continuous' has limits {self.lower!r} to {self.upper!r}; use type 'revolute'"
        yield from _number_flaws(what, self)


@dataclass(frozen=True)
class Gearbox:
    """A gear train.  Stiffness, damping and backlash are stated at the output side, the rotor's at the rotor.

    The last ten numbers are those of the friction models M2 to M6, and K_p, of core/effects/gear_friction.py, with the
    letters of their source: M2 has Stribeck's alone, M3 equal load frictions, M4 both with equal Stribeck loads.
    """

    ratio: float = field(metadata=_range("> 0", "-"))  # G = rotor speed / joint speed
    rotor_inertia: float = _number(">= 0", "kg m^2", 0.0)  # J, rotor side; reflected to the joint it is G^2 J
    rotor_damping: float = _number(">= 0", "N m s/rad", 0.0)  # B_vr, rotor side
    stiffness: float = _number("> 0 or inf", "N m/rad", math.inf)  # K_out, output side
    damping: float = _number(">= 0", "N m s/rad", 0.0)  # B_out, output side
    backlash: float = _number(">= 0", "rad", 0.0)  # whole gap, output side
    external_load_friction: float = _number(">= 0", "-", 0.0)  # K_e, of the torque that the mechanism asks for
    motor_load_friction: float = _number(">= 0", "-", 0.0)  # K_m, of the torque that drives the joint
    load_product_friction: float = _number(">= 0", "1/(N m)", 0.0)  # K_p, of the product of both
    stribeck_speed: float = _number("> 0", "rad/s", 1.0)  # v_s, about which what follows is gone
    stribeck_exponent: float = _number("> 0", "-", 1.0)  # alpha, how suddenly
    stribeck_friction: float = _number(">= 0", "N m", 0.0)  # K_cs
    stribeck_external_load: float = _number(">= 0", "-", 0.0)  # K_es
    stribeck_motor_load: float = _number(">= 0", "-", 0.0)  # K_ms
    quadratic_external_load: float = _number(">= 0", "1/(N m)", 0.0)  # K_eq
    quadratic_motor_load: float = _number(">= 0", "1/(N m)", 0.0)  # K_mq

    def __post_init__(self) -> None:
        remedy = "to turn the motor round, reverse the joint's axis"
        _check_number("gearbox", "ratio", self.ratio, "> 0", "rotor turns per joint turn", remedy)
        _check_numbers("gearbox", self)


def depends_on_load_or_speed(gearbox: Gearbox) -> bool:
    """Whether the gearbox has dry friction beyond Coulomb's, the models M2 to M6."""
    loads = (gearbox.external_load_friction, gearbox.motor_load_friction, gearbox.load_product_friction)
    slow = (gearbox.stribeck_friction, gearbox.stribeck_external_load, gearbox.stribeck_motor_load)
    return any((*loads, *slow, gearbox.quadratic_external_load, gearbox.quadratic_motor_load))


@dataclass(frozen=True)
class Controller:
    """The servo's own control law.

    `state`, `pid_position`, `pid_speed`: sampled every `period`, output a voltage (the servo of Lima et al. 2013,
    Fig. 3, with the controllers of SimTwo).
    `pd`, `pd_clamped`: continuous torque laws; `pd` keeps the damping (back-EMF) outside the torque clamp,
    `pd_clamped` clamps the sum.

    What follows the torque limit is firmware, of sampled laws alone (core/effects/firmware.py): their voltage is a duty
    cycle of the servo's `voltage_limit`, which is the nominal supply that gains and punch refer to.
    """

    law: Law
    Kp: float = _number(">= 0", "V/rad", 0.0)  # of pid_speed [V s/rad], of pd [N m/rad]
    Ki: float = _number(">= 0", "V/(rad s)", 0.0)  # of pid_speed [V/rad]
    Kd: float = _number(">= 0", "V s/rad", 0.0)  # of pid_speed [V s^2/rad], of pd [N m s/rad]
    Kf: float = _number("finite", "V/rad", 0.0)  # feed-forward of the angle reference
    period: float = _number("> 0", "s", 0.01)
    lag: float = _number(">= 0", "s", 0.01)  # from a reference being issued to the controller seeing it
    torque_limit: float = _number("> 0 or inf", "N m", math.inf)  # of the pd laws
    compliance_margin: float = _number(">= 0", "rad", 0.0)  # dead band of the error, of pid_speed [rad/s]
    punch: float = _number(">= 0", "V", 0.0)  # added in the direction of an error beyond the margin
    pwm_steps: float = _number("0 or >= 1", "-", 0.0, "1023 are ten bits")  # counts of a full duty cycle; 0: continuous
    duty_limit: float = _number("> 0 and <= 1", "-", 1.0, "it is a share of the supply")  # largest duty cycle
    profile_speed: float = _number("> 0 or inf", "rad/s", math.inf)  # at which the goal goes toward the reference
    delay: float = _number(">= 0", "s", 0.0)  # from a reading to the voltage that comes of it; whole steps

    def __post_init__(self) -> None:
        _check_choice("controller", "law", self.law, get_args(Law))
        _check_numbers("controller", self)
        if self.law in TORQUE_LAWS:
            for f in fields(self):
                if f.name in FIRMWARE and getattr(self, f.name) != f.default:
                    raise ValueError(
                        f"controller: {f.name} is {getattr(self, f.name)!r}; the law {self.law!r} acts at all times, "
                        "without ticks and voltage: use a sampled law, or leave it out"
                    )


@dataclass(frozen=True)
class Servo:
    """A DC motor with its controller, gearbox and friction (Lima et al. 2013, Tables 1 and 2).

    The torque laws (`TORQUE_LAWS`) know no motor: their servos need none of its numbers.
    """

    controller: Controller
    gearbox: Gearbox = field(default_factory=lambda: Gearbox(1.0))
    resistance: float = _number(">= 0", "Ohm", 0.0)  # R
    inductance: float = _number(">= 0", "H", 0.0)  # L
    motor_constant: float = _number(">= 0", "V s/rad", 0.0)  # K = [N m/A], rotor side
    voltage_limit: float = _number(">= 0", "V", 0.0)
    current_limit: float = _number("> 0 or inf", "A", math.inf)
    current_slew: float = _number("> 0 or inf", "A/s", math.inf)
    viscous_friction: float = _number(">= 0", "N m s/rad", 0.0)  # B_v, output side
    coulomb_friction: float = _number(">= 0", "N m", 0.0)  # F_c, output side
    stick_speed: float = _number(">= 0", "rad/s", 0.0)  # up to which it grows from rest; 0: it holds a joint
    encoder_resolution: float = _number(">= 0", "rad", 0.0)  # 0 = exact
    speed_filter: float = _number(">= 0", "s", 0.0)  # time constant of the speed that controller and friction see

    def __post_init__(self) -> None:
        instance("servo: controller", self.controller, Controller, "give Controller(law)")
        instance("servo: gearbox", self.gearbox, Gearbox, "give Gearbox(ratio)")
        if self.controller.law not in TORQUE_LAWS:
            for name in ("resistance", "motor_constant", "voltage_limit"):
                remedy = f"correct it, the law {self.controller.law!r} drives a motor"
                _check_number("servo", name, getattr(self, name), "> 0", SERVO_UNITS[name], remedy)
        _check_numbers("servo", self)


# Units of the numbers of a servo; the gains of the laws other than state and pid_position differ.
SERVO_UNITS = {
    f.name: f.metadata["unit"] for part in (Servo, Controller, Gearbox) for f in fields(part) if "unit" in f.metadata
}


@dataclass(frozen=True)
class Supply:
    """The source that feeds all servos of a robot: V = voltage - resistance * sum of duty cycle by motor current.

    Servos apply duty cycles of it; at their `voltage_limit`, without resistance, it is as if there were none.
    """

    voltage: float = field(metadata=_range("> 0", "V"))  # without load
    resistance: float = _number(">= 0", "Ohm", 0.0)  # of battery and cables

    def __post_init__(self) -> None:
        _check_numbers("supply", self)


@dataclass(frozen=True)
class ContactPoint:
    """What of a link can touch the ground: a point, or the lowest point of a sphere or of a circle.

    Capsules are two spheres, cylinders two circles, boxes and hulls their corners.
    """

    link: str
    position: tuple[float, float, float]  # of the point, or the center [m], link frame
    radius: float = _number(">= 0", "m", 0.0, "it is the radius of a sphere")
    rim: float = _number(">= 0", "m", 0.0, "it is the radius of a circle about the axis")
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)  # of the circle, out of the cylinder, unit length, link frame
    carries: bool = True  # at rest; the ground is as stiff as the weight on those that do asks for

    def __post_init__(self) -> None:
        what = f"contact point on link {self.link!r}"
        _check_name("link", self.link)
        _check_vector(what, "position", self.position, 3)
        _check_vector(what, "axis", self.axis, 3)
        instance(f"{what}: carries", self.carries, (bool, np.bool_), "give True or False")
        _freeze(self, "position", "axis")
        _check_numbers(what, self)
        if self.rim > 0 and abs(math.hypot(*self.axis) - 1.0) > AXIS_TOLERANCE:
            raise ValueError(f"{what}: axis {self.axis!r} is not of unit length; divide it by its length")


@dataclass(frozen=True, eq=False)
class HeightField:
    """Heights over a grid; bilinear between its nodes, level beyond its edge."""

    heights: np.ndarray  # (nx, ny) at x = origin[0] + i spacing[0], y = origin[1] + j spacing[1] [m]
    spacing: tuple[float, float]  # [m]
    origin: tuple[float, float] = (0.0, 0.0)  # of heights[0, 0], world axes [m]

    def __post_init__(self) -> None:
        heights = np.array(floats("height field: heights", self.heights, "give an array (nx, ny) [m]"))
        if heights.ndim != 2 or min(heights.shape) < 2 or not (np.abs(heights) <= LARGEST).all():
            raise ValueError(
                f"height field: heights have shape {heights.shape}; expected finite ones of 2 x 2 nodes or more: "
                "give an array (nx, ny) [m]"
            )
        heights.setflags(write=False)
        object.__setattr__(self, "heights", heights)
        _check_vector("height field", "spacing", self.spacing, 2)
        _check_vector("height field", "origin", self.origin, 2)
        _freeze(self, "spacing", "origin")
        if not min(self.spacing) > 0:
            raise ValueError(f"height field: spacing is {self.spacing!r} m; expected > 0: give the distance of nodes")


@dataclass(frozen=True)
class Ground:
    """Ground under the contact points, given as what a person knows; stiffness and damping are worked out in `scene/`.

    A robot that stands on all contact points that carry it sinks in by `sinking`.  The ground is a plane that may be
    tilted and have steps, or a height field.  Steps are vertical rises that begin at a given distance along the slope,
    in the direction `heading`; their faces push nothing back.
    """

    friction: float = _number(">= 0", "-", 0.95, "0 is ice, 1 is rubber")  # coefficient; SimTwo's default
    sinking: float = _number("> 0", "m", 5e-4, "0.0005 suits a small robot")  # under the weight it carries
    damping_ratio: float = _number(">= 0", "-", 0.7, "0.7 hardly bounces")  # of small motions about rest; 1 = critical
    height: float = _number("finite", "m", 0.0, "0 is the world's origin")  # at the world's origin
    slope: float = 0.0  # rising along `heading` [rad]
    steps: tuple[tuple[float, float], ...] = ()  # (distance along the slope, rise) [m]
    heading: float = _number("finite", "rad", 0.0, "0 is along x")  # of slope and steps, about z from x
    field: HeightField | None = None  # on a level plane without steps

    def __post_init__(self) -> None:
        _check_numbers("ground", self)
        if not (is_real(self.slope) and abs(self.slope) < 0.5 * math.pi):
            raise ValueError(
                f"ground: slope {self.slope!r} rad; it must lie between -pi/2 and pi/2: give it in radians"
            )
        check_angles("ground", "heading", (self.heading,))
        steps = items("ground: steps", self.steps, "give (distance, rise) of each [m]")
        for step in steps:
            _check_vector("ground", "step", step, 2)
        object.__setattr__(self, "steps", tuple(tuple(float(x) for x in step) for step in steps))
        if self.field is not None and not isinstance(self.field, HeightField):
            raise ValueError(
                f"ground: field is {type(self.field).__name__}; expected a HeightField: make one of the array"
            )
        if self.field is not None and (self.slope or self.steps or self.heading):
            raise ValueError("ground: a height field has no slope, steps or heading besides; put them into its heights")


def stairs(count: int, depth: float, rise: float, start: float = 0.0) -> tuple[tuple[float, float], ...]:
    """The steps of a `Ground` that make stairs: `count` rises [m], the first at `start`, `depth` apart [m].

    Raises ValueError for a negative count, a depth that is not above zero and numbers that are not finite.
    """
    count = whole("stairs: count", count, 0, "give the number of steps", MOST_STAIRS)
    _check_number("stairs", "depth", depth, "> 0", "m", "give the distance of two rises")
    for name, value in (("rise", rise), ("start", start)):
        _check_number("stairs", name, value, "finite", "m", "correct it")
    return tuple((start + k * depth, rise) for k in range(count))


@dataclass(frozen=True)
class Spring:
    """A spring with a damper between points of two links: it pulls them together with K (l - l0) + C dl/dt.

    One of the links may be the root of a robot with a fixed base.  The simulator takes its force at the start of a
    step, or of a stage: a stiff one asks for small steps, best chosen by error control.
    """

    a: str  # link
    b: str  # link
    point_a: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m], frame of link a
    point_b: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m], frame of link b
    stiffness: float = _number(">= 0", "N/m", 0.0, "0 is a damper alone")  # K
    damping: float = _number(">= 0", "N s/m", 0.0, "0 is a spring alone")  # C
    length: float = _number(">= 0", "m", 0.0, "it is the distance at which the spring is slack")  # l0, at rest

    def __post_init__(self) -> None:
        what = f"spring from link {self.a!r} to {self.b!r}"
        _check_name("link", self.a)
        _check_name("link", self.b)
        if self.a == self.b:
            raise ValueError(f"{what}: both points are on one link, which does not stretch; give two links")
        _check_vector(what, "point_a", self.point_a, 3)
        _check_vector(what, "point_b", self.point_b, 3)
        _check_numbers(what, self)
        _freeze(self, "point_a", "point_b")


@dataclass(frozen=True, eq=False)
class Model:
    """A robot.  Compared and hashed by identity; compare `links` and `joints` to compare robots."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    base: Base = "fixed"
    locked: Mapping[str, float] = field(default_factory=dict)  # joint name -> position it is held at [rad or m]
    servos: Mapping[str, Servo] = field(default_factory=dict)  # joint name -> servo
    contacts: tuple[ContactPoint, ...] = ()
    shapes: tuple[Shape, ...] = ()  # collision shapes
    keyframes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # named postures q (nq,) [m, -, rad or m]
    notes: tuple[str, ...] = ()  # what the reader skipped or changed, one sentence each
    source: str = ""  # file it was read from
    supply: Supply | None = None  # None: each servo has its own `voltage_limit`, whatever the others draw
    package_dirs: tuple[str, ...] = ()  # where the file's packages are, besides where they are looked for anyway

    def __post_init__(self) -> None:
        _check_name("robot", self.name)
        _check_choice(f"robot {self.name!r}", "base", self.base, ("fixed", "floating"))
        self._freeze()
        check_tree(self.links, self.joints)
        check_locked(self.joints, self.locked)
        check_mimics(self.joints)
        check_servos(self.joints, self.servos)
        for name, servo in self.servos.items():
            instance(f"servos: that of joint {name!r}", servo, Servo, "give a Servo, as load_servo does")
        if self.supply is not None:
            instance(f"robot {self.name!r}: supply", self.supply, Supply, "give Supply(voltage, resistance), or None")
        check_contacts(self.links, self.contacts)
        _check_shapes(self.links, self.shapes)
        check_can_move(self.joints, self.held)
        for name, q in self.keyframes.items():
            _check_vector(f"keyframe {name!r}", "q", q, self.nq)
        _check_bodies(self)

    def _freeze(self) -> None:
        """Keep copies that nobody can change, for what is checked here is read again whenever a scene is compiled."""
        for name, kind in _PARTS.items():
            parts = tuple(items(f"robot {self.name!r}: {name}", getattr(self, name), f"give a list of {kind.__name__}"))
            for part in parts:
                instance(f"robot {self.name!r}: {name}", part, kind, f"give a list of {kind.__name__}")
            object.__setattr__(self, name, parts)
        object.__setattr__(self, "notes", tuple(texts("notes", self.notes, "give a list of sentences")))
        instance("source", self.source, str, "give the path of a file, or an empty text")
        folders = tuple(texts("package_dirs", self.package_dirs, "give a list of folders"))
        object.__setattr__(self, "package_dirs", folders)
        for name in _TABLES:
            table = getattr(self, name)
            instance(f"robot {self.name!r}: {name}", table, Mapping, "give a dictionary, by name")
            object.__setattr__(self, name, MappingProxyType(dict(table)))

    def __getstate__(self) -> dict[str, Any]:
        return {name: dict(value) if name in _TABLES else value for name, value in self.__dict__.items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {name: MappingProxyType(state[name]) for name in _TABLES})

    def with_numbers(
        self,
        links: Sequence[Link] | None = None,
        joints: Sequence[Joint] | None = None,
        servos: Mapping[str, Servo] | None = None,
        supply: Supply | None = None,
    ) -> Model:
        """The same robot with other numbers: supply, and links, joints and servos in place of those of the same names.

        The tree that they make must stay, with the place of every joint: that, and what stays with it, is not looked at
        again.  Raises ValueError as a new model does.
        """
        made = object.__new__(Model)
        made.__dict__.update({f.name: getattr(self, f.name) for f in fields(Model)})
        if servos is not None:
            made.__dict__["servos"] = MappingProxyType(dict(servos))
        if supply is not None:
            made.__dict__["supply"] = supply
        if links is None and joints is None:
            made.__dict__.update({name: getattr(self, name) for name in ("moving_joints", "held", "joint_names")})
            made.__dict__["skeleton"] = self.skeleton
        else:
            made.__dict__.update(links=tuple(links or self.links), joints=tuple(joints or self.joints))
            check_locked(made.joints, made.locked)
            check_can_move(made.joints, made.held)
            made.__dict__["_laid_out"] = self._laid_out
            _check_bodies(made)
        return made

    @cached_property
    def skeleton(self) -> Model:
        """A model with the same links and joints, the same object for all that differ in their servos alone."""
        return self

    @cached_property
    def _laid_out(self) -> tuple[list[Frame], dict[str, Placement]]:
        return _lay_out(self)

    @cached_property
    def _merged(self) -> tuple[list[RigidBody], dict[str, Placement]]:
        return _merge(self)

    @property
    def root(self) -> str:
        """Name of the link that is no joint's child."""
        return ({link.name for link in self.links} - {joint.child for joint in self.joints}).pop()

    @cached_property
    def moving_joints(self) -> tuple[Joint, ...]:
        """The joints that have a coordinate, in file order; those that follow another one too."""
        held = self.held
        return tuple(j for j in self.joints if j.type != "fixed" and j.name not in held)

    @cached_property
    def held(self) -> dict[str, float]:
        """Joints that could move but do not, and where they are held [rad or m]: the locked ones and what follows
        a joint that is locked or fixed, or follows with the multiplier 0."""
        held = dict(self.locked)
        for joint in self.joints:
            if joint.mimic is not None and joint.type != "fixed" and joint.name not in held:
                head, k, offset = leader_of(self, joint)
                if k == 0 or head.type == "fixed" or head.name in self.locked:
                    held[joint.name] = k * self.locked.get(head.name, 0.0) + offset
        return held

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(j.name for j in self.moving_joints)

    @property
    def nq(self) -> int:
        """Number of position coordinates."""
        return len(self.moving_joints) + (7 if self.base == "floating" else 0)

    @property
    def nv(self) -> int:
        """Number of velocity coordinates."""
        return len(self.moving_joints) + (6 if self.base == "floating" else 0)

    @cached_property
    def couplings(self) -> tuple[tuple[str, str, float, float], ...]:
        """Joints that follow others: (follower, leader, multiplier, offset [rad or m]), in file order."""
        followers = [joint for joint in self.moving_joints if joint.mimic]
        leaders = [leader_of(self, joint) for joint in followers]
        return tuple((joint.name, head.name, k, offset) for joint, (head, k, offset) in zip(followers, leaders))

    @property
    def mass(self) -> float:
        """Total mass [kg]; of a fixed base too."""
        return math.fsum(link.mass for link in self.links)

    def show_tree(self) -> str:
        """Links and joints as a tree of text, with types, limits, masses and servos: print it."""
        from ..view.tree import tree_text

        return tree_text(self)


_PARTS = {"links": Link, "joints": Joint, "contacts": ContactPoint, "shapes": Shape}
_TABLES = ("locked", "servos", "keyframes")


def check_tree(links: Iterable[Link], joints: Iterable[Joint]) -> None:
    """Raise FlawError, a ValueError, unless the joints make one tree of the links."""
    names, joints = [link.name for link in links], list(joints)
    flaws = [*_twice("link", names), *_twice("joint", [joint.name for joint in joints])]
    flaws += _joining_flaws(set(names), joints)
    if not names:
        flaws.append(Flaw("robot", "the robot has no link; at least one <link> is needed"))
    if not flaws:
        flaws += _root_flaws(names, {joint.child: joint for joint in joints})
    if flaws:
        raise FlawError(flaws)


def _joining_flaws(names: set[str], joints: list[Joint]) -> Iterator[Flaw]:
    """Joints to links that are not there, or to a link that has a parent joint."""
    parent_joint: dict[str, Joint] = {}
    for joint in joints:
        what = f"joint {joint.name!r}"
        for end in (joint.parent, joint.child):
            if end not in names:
                yield Flaw(what, f"{what}: there is no link {end!r}; define it, or correct the name")
        if joint.child in parent_joint:
            yield Flaw(
                what,
                f"link {joint.child!r} is the child of joints {parent_joint[joint.child].name!r} and {joint.name!r}; "
                "a link has one parent joint: cut the closed loop, or rename one of the two",
            )
        parent_joint[joint.child] = joint


def _root_flaws(names: list[str], parent_joint: dict[str, Joint]) -> Iterator[Flaw]:
    """Links that do not lead up to one root."""
    roots = [name for name in names if name not in parent_joint]
    if len(roots) > 1:
        yield Flaw(
            f"link {roots[1]!r}",
            f"links {listed(roots)} have no parent joint; exactly one link may be the root: "
            "connect the others to it, for instance by a fixed joint",
        )
    rooted = set(roots)
    for name in names:
        path: dict[str, None] = {}  # a set that keeps its order
        while name not in rooted and name not in path:
            path[name] = None
            name = parent_joint[name].parent
        if name in path:
            cycle = list(path)[list(path).index(name) :]  # the part of the path that comes back on itself
            text = f"links {listed(cycle)} form a cycle of joints; a robot is a tree: remove one joint"
            yield Flaw(f"link {cycle[0]!r}", text)
        rooted.update(path)


def check_locked(joints: Iterable[Joint], locked: Mapping[str, float]) -> None:
    """Raise ValueError unless every locked joint exists, moves and is held within its limits."""
    by_name = {joint.name: joint for joint in joints}
    for name, position in locked.items():
        joint = _movable(by_name, name, "locked")
        _check_number(f"locked joint {name!r}", "position", position, "finite", "rad or m", "give a finite position")
        if joint.type != "prismatic":
            check_angles(f"locked joint {name!r}", "position", (position,))
        if not joint.lower <= position <= joint.upper:
            raise ValueError(
                f"locked joint {name!r}: position {position!r} is outside its limits "
                f"{joint.lower!r} to {joint.upper!r}; hold it at a position between them"
            )


class Leader(NamedTuple):
    """What a joint follows at the end of all chains: its position is multiplier * (that of the leader) + offset."""

    joint: Joint
    multiplier: float  # [-, m/rad or rad/m]
    offset: float  # [rad or m]


def leader_of(model: Model, joint: Joint) -> Leader:
    """The leader of a joint: a joint that follows none, or that is fixed or locked; it may be the joint itself."""
    by_name = {joint.name: joint for joint in model.joints}
    k, offset = 1.0, 0.0
    while joint.mimic is not None and joint.type != "fixed" and joint.name not in model.locked:
        offset += k * joint.mimic.offset
        k *= joint.mimic.multiplier
        joint = by_name[joint.mimic.joint]
    return Leader(joint, k, offset)


def check_mimics(joints: Iterable[Joint]) -> None:
    """Raise ValueError unless every joint that follows one follows a joint that there is, and none itself."""
    leaders = {joint.name: joint.mimic.joint if joint.mimic else None for joint in joints}
    for name, leader in leaders.items():
        path = [name]
        while leader is not None:
            if leader not in leaders:
                raise ValueError(
                    f"joint {path[-1]!r}: it follows {leader!r}, and there is no such joint; joints are "
                    f"{listed(leaders)}: correct the name in its mimic"
                )
            if leader in path:
                circle = path[path.index(leader) :]
                raise ValueError(
                    f"joints {listed(circle)} follow each other in a circle; one must be free: remove its mimic"
                )
            path.append(leader)
            leader = leaders[leader]


def check_can_move(joints: Iterable[Joint], held: Mapping[str, float]) -> None:
    """Raise ValueError for a joint that is neither fixed nor held, and whose limits coincide."""
    for joint in joints:
        if joint.type != "fixed" and joint.name not in held and joint.lower == joint.upper:
            raise ValueError(
                f"joint {joint.name!r}: limits lower {joint.lower!r}, upper {joint.upper!r}; lower must be below "
                "upper: use type 'fixed' for a joint that does not move, or lock it there"
            )


def check_servos(joints: Iterable[Joint], servos: Iterable[str]) -> None:
    """Raise ValueError unless every servo's joint exists and moves."""
    by_name = {joint.name: joint for joint in joints}
    for name in servos:
        _movable(by_name, name, "servos")


def check_contacts(links: Iterable[Link], contacts: Iterable[ContactPoint]) -> None:
    """Raise ValueError unless every contact point is on a link of the robot."""
    names = {link.name: link for link in links}
    for contact in contacts:
        if contact.link not in names:
            raise ValueError(f"contacts: there is no link {contact.link!r}; use one of {listed(names)}")


def _check_shapes(links: Iterable[Link], shapes: Iterable[Shape]) -> None:
    """Raise ValueError unless every shape is on a link of the robot."""
    names = {link.name: link for link in links}
    for shape in shapes:
        if shape.link not in names:
            raise ValueError(f"shapes: there is no link {shape.link!r}; use one of {listed(names)}")


def check_springs(links: Iterable[Link], springs: Iterable[Spring]) -> None:
    """Raise ValueError unless every spring joins links of the robot."""
    names = {link.name: link for link in links}
    for spring in springs:
        instance("springs", spring, Spring, "give a list of Spring(a, b)")
        for end in (spring.a, spring.b):
            if end not in names:
                raise ValueError(f"springs: there is no link {end!r}; use one of {listed(names)}")


def check_angles(what: str, name: str, angles: Iterable[float]) -> None:
    """Raise ValueError for an angle too large for its sine to be exact."""
    for text in _angle_flaws(what, name, angles):
        raise ValueError(text)


def _angle_flaws(what: str, name: str, angles: Iterable[float]) -> Iterator[str]:
    for angle in angles:
        if not abs(angle) <= NEAR:
            yield f"{what}: {name} is {angle!r} rad; at most {NEAR:.0f} rad: subtract whole turns"


def _movable(by_name: dict[str, Joint], name: str, where: str) -> Joint:
    """The joint of that name; ValueError if there is none or it is fixed."""
    if name not in by_name:
        moving = [joint.name for joint in by_name.values() if joint.type != "fixed"]
        raise ValueError(f"{where}: there is no joint {name!r}; moving joints are {listed(moving)}: use one of them")
    if by_name[name].type == "fixed":
        raise ValueError(f"{where}: joint {name!r} is of type 'fixed'; remove it here, or change its type in the URDF")
    return by_name[name]


def _check_bodies(model: Model) -> None:
    """Raise FlawError, a ValueError, unless the mass matrix is positive definite.

    It is if what moves as one has a mass and an inertia that resist every motion.  A body that has not may still be
    carried by, or carry, others that have: then the matrix itself is looked at, in a few postures.
    """
    bodies = rigid_bodies(model)[0]
    if _resist([body for body in bodies if body.frame.joint or model.base == "floating"]):
        return
    flaws = indefinite_flaws(model, bodies)
    if flaws:
        raise FlawError(flaws)


def _resist(bodies: list[RigidBody]) -> bool:
    """Whether each of the bodies alone has an inertia against every motion."""
    if not bodies or not all(body.mass > 0 for body in bodies):
        return not bodies
    moments = np.linalg.eigvalsh(np.array([body.inertia for body in bodies]))
    return bool((moments[:, 0] > DEFINITE_TOLERANCE * moments[:, 2]).all())


class Placement(NamedTuple):
    """Where a link sits: the body that carries it and the link's frame in that body's frame."""

    row: int  # of the body; 0 is the world or the floating base
    E: np.ndarray  # (3, 3) rotation link -> body frame
    r: np.ndarray  # (3,) origin of the link frame in the body frame [m]


class Frame(NamedTuple):
    """Frame of a body in that of its parent, with the joint at zero: origin at the joint, z along the joint's axis."""

    joint: Joint | None  # that moves the body; None for the root's
    parent: int  # row of the body that the joint hangs on
    E: np.ndarray  # (3, 3) rotation body -> parent
    r: np.ndarray  # (3,) origin in the parent [m]


class RigidBody(NamedTuple):
    """Links that move as one, and what they have together, in the body's frame."""

    frame: Frame
    links: tuple[str, ...]  # the joint's child first
    mass: float  # [kg]
    center: np.ndarray  # (3,) center of mass [m]
    inertia: np.ndarray  # (3, 3) about the center of mass [kg m^2]


def rigid_bodies(model: Model) -> tuple[list[RigidBody], dict[str, Placement]]:
    """Merge what fixed and locked joints hold together: the bodies, and the place of every link.

    First the root's body, then one for each moving joint, depth first: parents before children, chains in one piece.
    """
    return model._merged


def _merge(model: Model) -> tuple[list[RigidBody], dict[str, Placement]]:
    links = {link.name: link for link in model.links}
    frames, placements = _frames(model)
    groups: list[list[tuple[Link, Placement]]] = [[] for _ in frames]
    for name, place in placements.items():
        groups[place.row].append((links[name], place))
    names = [tuple(link.name for link, _ in group) for group in groups]
    bodies = [RigidBody(*body) for body in zip(frames, names, *_composites(groups))]
    return bodies, placements


def _frames(model: Model) -> tuple[list[Frame], dict[str, Placement]]:
    """The frame of each body, and where each link sits."""
    frames, placements = model._laid_out
    joints = {joint.name: joint for joint in model.joints}
    return [frame._replace(joint=frame.joint and joints[frame.joint.name]) for frame in frames], placements


def _lay_out(model: Model) -> tuple[list[Frame], dict[str, Placement]]:
    moving, held = set(model.joint_names), model.held
    frames = [Frame(None, 0, np.eye(3), np.zeros(3))]
    placements = {model.root: Placement(0, np.eye(3), np.zeros(3))}
    for joint in depth_first(model):
        row, E, r = placements[joint.parent]
        E, r = product(E, rotation_from_rpy(joint.rpy)), r + applied(E, np.array(joint.xyz))
        if joint.name in moving:
            Q = rotation_z_to(joint.axis)
            placements[joint.child] = Placement(len(frames), Q.T, np.zeros(3))
            frames.append(Frame(joint, row, product(E, Q), r))
        else:
            placements[joint.child] = Placement(row, *_held(joint, held.get(joint.name, 0.0), E, r))
    return frames, placements


def depth_first(model: Model) -> list[Joint]:
    """The joints, a parent's before its children's and each chain in one piece; children in file order."""
    children: dict[str, list[Joint]] = {}
    for joint in model.joints:
        children.setdefault(joint.parent, []).append(joint)
    order, stack = [], children.get(model.root, [])[::-1]
    while stack:
        joint = stack.pop()
        order.append(joint)
        stack.extend(children.get(joint.child, [])[::-1])
    return order


def _held(joint: Joint, position: float, E: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The child frame of a fixed or locked joint, from the one at zero."""
    if position == 0.0:
        return E, r
    if joint.type == "prismatic":
        return E, r + applied(E, position * np.array(joint.axis))
    return product(E, rotation_about(joint.axis, position)), r


def _composites(groups: list[list[tuple[Link, Placement]]]) -> tuple[list[float], list[np.ndarray], list[np.ndarray]]:
    """Mass, center of mass and inertia about it of links that move as one, in the body's frame, of each body."""
    links = [link for group in groups for link, _ in group]
    places = [place for group in groups for _, place in group]
    E, mass = np.array([place.E for place in places]), np.array([link.mass for link in links])
    centers = np.array([place.r for place in places]) + applied(E, np.array([link.center_of_mass for link in links]))
    inertias = turned(E, np.array([inertia_matrix(link.inertia) for link in links]))
    ends = np.cumsum([len(group) for group in groups]).tolist()
    parts = [slice(end - len(group), end) for group, end in zip(groups, ends)]
    masses = [math.fsum(link.mass for link, _ in group) for group in groups]
    weighted = mass[:, None] * centers
    means = [functools.reduce(np.add, weighted[part], np.zeros(3)) for part in parts]
    means = [c / m if m > 0 else c for m, c in zip(masses, means)]
    d = centers - np.repeat(means, [len(group) for group in groups], axis=0)
    square = (d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1] + d[:, 2] * d[:, 2])[:, None, None]
    about = inertias + mass[:, None, None] * (square * np.eye(3) - d[:, :, None] * d[:, None, :])
    return masses, means, [functools.reduce(np.add, about[part], np.zeros((3, 3))) for part in parts]


def turned_inertia(E: np.ndarray, inertia: tuple[float, ...]) -> np.ndarray:
    """E I E' (3, 3): an inertia ixx ixy ixz iyy iyz izz [kg m^2] in the axes that the rotation E leads to."""
    return turned(E, inertia_matrix(inertia))


def turned(E: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """E I E' of matrices (..., 3, 3)."""
    return product(product(E, inertia), E.swapaxes(-1, -2))


def inertia_matrix(inertia: tuple[float, ...]) -> np.ndarray:
    """Symmetric (3, 3) matrix of ixx ixy ixz iyy iyz izz [kg m^2]."""
    xx, xy, xz, yy, yz, zz = inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _name_flaws(kind: str, name: str) -> Iterator[str]:
    if not isinstance(name, str) or not name or not name.isprintable():
        yield f"{kind} name {name!r} is empty or has characters that cannot be printed; use a plain name"


def _text_flaws(what: str, name: str, value: str) -> Iterator[str]:
    if not isinstance(value, str):
        yield f"{what}: {name} is {shown(value)}; expected the name of a link: write it in quotes"


def _choice_flaws(what: str, name: str, value: str, choices: tuple[str, ...]) -> Iterator[str]:
    if not isinstance(value, str) or value not in choices:
        yield f"{what}: {name} is {value!r}; expected one of {listed(choices)}: use one of these"


def _number_flaws(what: str, record: Any) -> Iterator[str]:
    """Of the fields that are declared by `_number`."""
    for name, metadata in _declared(type(record)):
        if not _fits(getattr(record, name), metadata["rule"]):
            yield _number_flaw(what, name, getattr(record, name), **metadata)


_known: dict[type, list[tuple[str, Mapping[str, str]]]] = {}


def _declared(kind: type) -> list[tuple[str, Mapping[str, str]]]:
    if kind not in _known:
        _known[kind] = [(f.name, f.metadata) for f in fields(kind) if f.metadata]
    return _known[kind]


def _number_flaw(what: str, name: str, value: float, rule: str, unit: str, remedy: str) -> str:
    size = f", of a size from {1 / LARGEST:g} to {LARGEST:g}" if is_real(value) and 0 < abs(value) < math.inf else ""
    return f"{what}: {name} is {shown(value)} [{unit}]; expected {rule}{size}: {remedy}"


def _fits(value: Any, rule: str) -> bool:
    return (type(value) is float or is_real(value)) and _RULES[rule](value)  # worlds have many, all floats


def _vector_flaws(what: str, name: str, value: tuple[float, ...], size: int) -> Iterator[str]:
    if type(value) is tuple and len(value) == size and all(type(x) is float and abs(x) <= LARGEST for x in value):
        return  # the usual case first: worlds make many links
    try:
        numbers = floats(name, value)
    except ValueError:
        numbers = np.zeros(0)
    if numbers.shape != (size,) or not (np.abs(numbers) <= LARGEST).all():
        yield f"{what}: {name} is {shown(value)}; expected {size} finite numbers: correct it"


def _freeze(record: Any, *names: str) -> None:
    """Turn checked vectors into tuples of floats, that nobody can change."""
    for name in names:
        if type(getattr(record, name)) is not tuple:
            object.__setattr__(record, name, tuple(float(x) for x in getattr(record, name)))


def _check_name(kind: str, name: str) -> None:
    for text in _name_flaws(kind, name):
        raise ValueError(text)


def _check_choice(what: str, name: str, value: str, choices: tuple[str, ...]) -> None:
    for text in _choice_flaws(what, name, value, choices):
        raise ValueError(text)


def _check_number(what: str, name: str, value: float, rule: str, unit: str, remedy: str) -> None:
    if not _fits(value, rule):
        raise ValueError(_number_flaw(what, name, value, rule, unit, remedy))


def _check_numbers(what: str, record: Any) -> None:
    """Check the fields that are declared by `_number`."""
    for text in _number_flaws(what, record):
        raise ValueError(text)


def _check_vector(what: str, name: str, value: tuple[float, ...], size: int) -> None:
    for text in _vector_flaws(what, name, value, size):
        raise ValueError(text)


def _twice(kind: str, names: list[str]) -> Iterator[Flaw]:
    """Names that several have."""
    for name, count in Counter(names).items():
        if count > 1:
            text = f"{kind} name {name!r} is used more than once; give every {kind} its own name"
            yield Flaw(f"{kind} {name!r}", text)
