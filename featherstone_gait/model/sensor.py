"""Sensors that a link carries: what they measure and where they are.  `run/measure.py` computes what they read."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, instance, listed, real, shown, vector, whole
from ..base.brief import brief
from ..base.fixed_order import applied, total
from ..base.flaws import quoted
from ..base.rotation import rotation_from_rpy
from ..core.step.state import BY_NAME, RECORDABLE
from .checks import LARGEST, check, quantity, quantity_flaws, vector_flaws

PARALLEL = 1e-9  # length of a direction below which it is none
WORLD = "world"
BUILT_IN: dict[str, tuple[str, ...]] = {  # sensors of every scene, and the channels that they need
    "encoders": ("q",),
    "gyroscope": ("base_qd",),
    "accelerometer": ("base_q", "base_qd", "base_qdd"),
    "sole_forces": ("contact_force", "q", "base_q"),
    "center_of_pressure": ("contact_force", "q", "base_q"),
    "contact_positions": ("q", "base_q"),
}
RESERVED = frozenset({*BY_NAME, *BUILT_IN, "time"})  # what records have under names of their own


@dataclass(frozen=True, eq=False)
class RangeSensor:
    """Rays from a link, whose lengths to the first shape are measured: collision shapes, obstacles, the ground.

    Shapes of the link and of those that do not move against it are transparent, and shapes of its robot within which a
    ray begins.  One that begins within another shape measures 0, one that meets nothing infinity.  Meshes count as
    their convex hulls.

    Attributes
    ----------
    link : str
        Name of the link that carries it, in a scene of several as "robot/link"; "world" for a fixed place.
    directions : ndarray, shape (rays, 3)
        Directions in the sensor's frame, of any length.
    position : tuple of float
        Where all rays begin (3,), in the frame of the link [m].
    rpy : tuple of float
        Orientation (3,) of the sensor there: roll, pitch and yaw about fixed axes [rad].
    reach : float
        Longest distance that it measures [m].
    nearest : bool
        Whether it measures the least of all rays alone, as a sonar does.
    name : str
        Name in what a session observes and a run records.
    curve : tuple of (float, float)
        Distances [m], rising, and the voltages [V] that it gives in place of them: on straight lines between them,
        those of the ends beyond.  Empty: it gives distances.

    Raises
    ------
    ValueError
        For values out of range.

    Examples
    --------
    >>> from featherstone_gait import Ground, RangeSensor, compile_scene, load_robot, ranges, simulate
    >>> scene = compile_scene(load_robot("humanoid"), gearbox="mipsd", ground=Ground())
    >>> run = simulate(scene, 0.1)
    >>> down = RangeSensor("world", [[0.0, 0.0, -1.0]], position=(1.0, 0.0, 0.5))
    >>> float(ranges(scene, run, down)[-1, 0])
    0.5
    """

    link: str
    directions: np.ndarray
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reach: float = math.inf
    nearest: bool = False
    name: str = "range"
    curve: tuple[tuple[float, float], ...] = ()

    __repr__ = brief

    def __post_init__(self) -> None:
        instance("range sensor: nearest", self.nearest, bool, "give True or False")
        directions = unit_directions("range sensor", self.directions)
        if not (self.reach == math.inf and isinstance(self.reach, float)):
            real("range sensor: reach", self.reach, 0.0, 1e6, "[m]; leave it out for a sensor without limit")
        object.__setattr__(self, "directions", directions)
        object.__setattr__(self, "curve", _curve(self.curve))
        _check_place(self, "range sensor")

    @classmethod
    def fan(cls, link: str, angle: float, rays: int, **more: Any) -> RangeSensor:
        """Make a scanner whose rays lie in its x-y plane, evenly about x.

        Parameters
        ----------
        link : str
            Name of the link that carries it.
        angle : float
            Angle between the first and the last ray, counterclockwise [rad]; at 2 pi the last is one step before it.
        rays : int
            Number of rays.
        **more
            Further attributes.

        Returns
        -------
        RangeSensor
            The sensor.
        """
        angle = real("range sensor: angle", angle, 0.0, 2.0 * math.pi, "[rad]")
        count = whole("range sensor: rays", rays, 1, "give their number", 10**6)
        whole_turn = 2.0 * math.pi - angle < PARALLEL
        turns = np.linspace(-0.5 * angle, 0.5 * angle, count, endpoint=not whole_turn) if count > 1 else np.zeros(1)
        return cls(link, np.stack([np.cos(turns), np.sin(turns), 0.0 * turns], axis=1), **more)

    @classmethod
    def cone(cls, link: str, angle: float, rays: int = 64, **more: Any) -> RangeSensor:
        """Make a sonar: rays spread evenly over a cone about x, of which the nearest echo counts.

        Parameters
        ----------
        link : str
            Name of the link that carries it.
        angle : float
            Opening angle of the cone, from side to side [rad].
        rays : int
            Number of rays; the first lies on the axis.
        **more
            Further attributes.

        Returns
        -------
        RangeSensor
            The sensor.
        """
        angle = real("range sensor: angle", angle, 0.0, math.pi, "[rad]")
        count = whole("range sensor: rays", rays, 1, "give their number", 10**6)
        k = np.arange(count)
        along = 1.0 - (1.0 - math.cos(0.5 * angle)) * k / max(count - 1, 1)  # equal shares of the sphere's area
        turns, across = k * math.pi * (3.0 - math.sqrt(5.0)), np.sqrt(np.maximum(1.0 - along * along, 0.0))
        return cls(link, np.stack([along, across * np.cos(turns), across * np.sin(turns)], axis=1),
                   **{"nearest": True, **more})  # fmt: skip

    @classmethod
    def infrared(cls, link: str, curve: ArrayLike, **more: Any) -> RangeSensor:
        """Make an infrared sensor: one ray along x, whose distance is given as a voltage.

        Parameters
        ----------
        link : str
            Name of the link that carries it.
        curve : array_like
            Distances [m] and voltages [V] (n, 2), as of the diagram in its data sheet.
        **more
            Further attributes.

        Returns
        -------
        RangeSensor
            The sensor.
        """
        if not (curve := _curve(curve)):
            raise ValueError("range sensor: curve is empty; give distances [m], rising, and voltages [V]")
        return cls(link, **{"directions": [[1.0, 0.0, 0.0]], "curve": curve, "name": "infrared", **more})

    def voltage(self, distance: ArrayLike) -> np.ndarray:
        """Return the voltages [V] of distances [m] of any shape, by `curve`; infinity is beyond its end."""
        return _on_lines(distance, *self._columns())

    def distance(self, voltage: ArrayLike) -> np.ndarray:
        """Return the distances [m] of voltages [V] of any shape, by the part of `curve` from its largest voltage on.

        Voltages beyond those of the curve give its ends, as a program on a robot does it: whether something is nearer
        than the distance of the largest voltage cannot be said.
        """
        distances, voltages = self._columns()
        first = int(np.argmax(voltages))
        falling = np.flatnonzero(np.diff(voltages[first:]) >= 0.0)
        last = first + (int(falling[0]) if len(falling) else len(voltages) - 1 - first)
        part = slice(first, last + 1)
        return _on_lines(voltage, voltages[part][::-1], distances[part][::-1])

    def _columns(self) -> tuple[np.ndarray, np.ndarray]:
        if not self.curve:
            raise ValueError(f"range sensor {self.name!r}: it gives distances; make it with a curve")
        distances, voltages = np.transpose(self.curve)
        return distances, voltages

    @property
    def mounted(self) -> np.ndarray:
        """Origins [m] and unit directions of the rays in the frame of the link (rays, 6)."""
        along = applied(rotation_from_rpy(self.rpy), self.directions)
        return np.hstack([np.tile(self.position, (len(along), 1)), along])


@dataclass(frozen=True)
class LineSensor:
    """Spots on the ground under a link, of each of which it measures the share that is dark: the lines of the ground.

    A spot is a disc about the place where a ray from the sensor meets the ground.  A ray that meets none within the
    reach comes back as dark: 1.  Obstacles and robots in between hide nothing.

    Attributes
    ----------
    link : str
        Name of the link that carries it, in a scene of several as "robot/link"; "world" for a fixed place.
    positions : tuple of (float, float, float)
        Where the rays begin (spots, 3), in the frame of the link [m].
    radius : float
        Radius of the spots, as seen from above [m]; 0 for points, which are dark or not.
    direction : tuple of float
        Direction of the rays (3,) in the frame of the link, of any length.
    reach : float
        Longest distance from which it sees the ground [m].
    name : str
        Name in what a session observes and a run records.

    Raises
    ------
    ValueError
        For values out of range.
    """

    link: str
    positions: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),)
    radius: float = quantity(">= 0", "m", 0.002, "0.002 is a small reflective sensor near the ground")
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    reach: float = quantity("> 0 or inf", "m", math.inf, "leave it out for a sensor without limit")
    name: str = "line"

    __repr__ = brief

    def __post_init__(self) -> None:
        what = "line sensor"
        check(quantity_flaws(what, self), vector_flaws(what, "direction", self.direction, 3))
        positions = np.asarray(floats(f"{what}: positions", self.positions, "give a list of places (x, y, z) [m]"))
        if positions.ndim != 2 or positions.shape[1:] != (3,) or not len(positions) or not np.isfinite(positions).all():
            raise ValueError(f"{what}: positions are {shown(self.positions)}; give places (x, y, z) of the spots [m]")
        object.__setattr__(self, "positions", tuple(map(tuple, positions.tolist())))
        unit_directions(what, [self.direction])
        _check_place(self, what)

    @property
    def mounted(self) -> np.ndarray:
        """Origins [m] and unit directions of the rays in the frame of the link (spots, 6)."""
        along = unit_directions("line sensor", [self.direction] * len(self.positions))
        return np.hstack([np.array(self.positions), along])


@dataclass(frozen=True)
class ForceTorqueSensor:
    """Force and moment on a link by what carries it: the joint, with gear and bearings, or the link it is fixed to.

    It reads six numbers: the force, then the moment about its place, in its axes.  At rest that is the weight of the
    link and of all that it carries, upward.

    Attributes
    ----------
    link : str
        Name of the link that is carried, in a scene of several as "robot/link".
    position : tuple of float
        Its place (3,) in the frame of the link [m].
    rpy : tuple of float
        Its orientation (3,) there: roll, pitch and yaw about fixed axes [rad].
    name : str
        Name in what a session observes and a run records.

    Raises
    ------
    ValueError
        For values out of range.
    """

    link: str
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = "force"

    __repr__ = brief

    def __post_init__(self) -> None:
        _check_place(self, "force torque sensor")


@dataclass(frozen=True)
class ContactSensor:
    """A switch on a link: 1 while ground and other bodies push it by more than a threshold, else 0.

    Attributes
    ----------
    link : str
        Name of the link, in a scene of several as "robot/link".
    threshold : float
        Sum of normal forces above which it closes [N].
    name : str
        Name in what a session observes and a run records.

    Raises
    ------
    ValueError
        For values out of range.
    """

    link: str
    threshold: float = quantity(">= 0", "N", 0.0, "0 closes at every touch")
    name: str = "contact"

    __repr__ = brief

    def __post_init__(self) -> None:
        _check_place(self, "contact sensor")
        check(quantity_flaws("contact sensor", self))


Sensor: TypeAlias = RangeSensor | LineSensor | ForceTorqueSensor | ContactSensor


@dataclass(frozen=True)
class SampledSensor:
    """A sensor that measures at a rate, with noise, and answers late.

    It measures at the start and at whole multiples of its period; between them its last answer stands.  Until the
    first one it answers what it measures at the start, of a run that goes on from another at its own.  Noise is a
    function of the seed, the name, the number of the robot in a batch or session, and the number of the measurement
    since time 0: the same alone and among others.

    Attributes
    ----------
    sensor : str or a sensor
        What measures: a sensor, or the name of one or of a channel.
    noise : float or tuple of float
        Standard deviation of the noise, in the unit of the sensor; several are those of its numbers.
    rate : float or None
        Measurements a second [Hz]; None: one at each record of a run, at each tick of a session.
    delay : float
        Time from the measurement to the answer [s].
    seed : int
        Seed of the noise.
    name : str
        Name in what a session observes and a run records; empty: that of a sensor that is given as such, "sampled q"
        of one that is named "q".

    Raises
    ------
    ValueError
        For values out of range.

    Examples
    --------
    >>> from featherstone_gait import SampledSensor
    >>> SampledSensor("gyroscope", noise=1e-3, rate=200.0, delay=0.01)
    SampledSensor(sensor='gyroscope', noise=0.001, rate=200, delay=0.01, name='sampled gyroscope')
    """

    sensor: str | Sensor
    noise: float | tuple[float, ...] = 0.0
    rate: float | None = None
    delay: float = quantity(">= 0", "s", 0.0, "0 is an answer at once")
    seed: int = 0
    name: str = ""

    __repr__ = brief

    def __post_init__(self) -> None:
        what = "sampled sensor"
        remedy = "give a sensor that is not sampled, or the name of one"
        instance(f"{what}: sensor", self.sensor, (str, *get_args(Sensor)), remedy)
        instance(f"{what}: name", self.name, str, "give a text")
        check(quantity_flaws(what, self))
        if self.rate is not None:
            real(f"{what}: rate", self.rate, 1e-6, 1e9, "it is in Hz; None for one at each record or tick")
        whole(f"{what}: seed", self.seed, 0, "any number will do", 2**63 - 1)
        several = np.asarray(floats(f"{what}: noise", self.noise, "give a standard deviation, or one for each number"))
        if several.ndim > 1 or not ((several >= 0.0) & (several <= LARGEST)).all():
            raise ValueError(f"{what}: noise is {shown(self.noise)}; give standard deviations >= 0")
        object.__setattr__(self, "noise", float(several) if several.ndim == 0 else tuple(several.tolist()))
        if not self.name:
            exact = self.sensor
            object.__setattr__(self, "name", f"sampled {exact}" if isinstance(exact, str) else exact.name)


def check_sensors(
    what: str, sensors: Any, links: Collection[str], others: Iterable[Sensor | SampledSensor] = ()
) -> tuple[Sensor | SampledSensor, ...]:
    """Return sensors of a robot or scene.

    Raises ValueError for links and sensors that are not there, and for names that come again.

    links: but for the world; others: sensors that `SampledSensor`s may name beside these.
    """
    found = tuple(listed(f"{what}: sensors", sensors, "give a list of sensors"))
    for one in found:
        instance(f"{what}: sensors", one, (*get_args(Sensor), SampledSensor), "give sensors, such as RangeSensor(...)")
    names, exact = set[str](), [one.name for one in (*others, *found) if not isinstance(one, SampledSensor)]
    for one in found:
        inner = one.sensor if isinstance(one, SampledSensor) else one
        if isinstance(inner, str):
            if inner == "sole_forces" or inner not in (*RECORDABLE, *BUILT_IN, *exact):
                raise ValueError(
                    f"{what}: sampled sensor {one.name!r} is of {inner!r}; give a channel, or one of "
                    f"{quoted([*(name for name in BUILT_IN if name != 'sole_forces'), *exact])}"
                )
        elif inner.link not in ([*links, WORLD] if isinstance(inner, RangeSensor | LineSensor) else links):
            raise ValueError(f"{what}: sensor {one.name!r} is on {inner.link!r}; links: {quoted(links)}")
        check_name(what, one.name)
        if not one.name or "/" in one.name or one.name in names:
            raise ValueError(f"{what}: a sensor is called {one.name!r}; give each a name of its own, without '/'")
        names.add(one.name)
    return found


def check_name(what: str, name: str) -> None:
    """Raise ValueError for the name of a sensor that a channel or a sensor of every scene has."""
    if name in RESERVED:
        raise ValueError(f"{what}: a sensor is called {name!r}, as is what every scene records; give it another name")


def _check_place(sensor: Any, what: str) -> None:
    """Raise ValueError for the link, the name or the place of a sensor; keep the place as tuples."""
    instance(f"{what}: link", sensor.link, str, "give the name of a link, or 'world'")
    instance(f"{what}: name", sensor.name, str, "give a text")
    for name, unit in (("position", "[m]"), ("rpy", "[rad]"), ("direction", "")):
        if hasattr(sensor, name):
            value = vector(f"{what}: {name}", getattr(sensor, name), 3, unit)
            object.__setattr__(sensor, name, tuple(value.tolist()))


def _curve(given: ArrayLike) -> tuple[tuple[float, float], ...]:
    """Return distances and voltages; raise ValueError for what is no curve."""
    remedy = "give distances [m], from 0 on and rising, and voltages [V]"
    curve = np.asarray(floats("range sensor: curve", given, remedy))
    if curve.size and (curve.ndim != 2 or curve.shape[1] != 2 or len(curve) < 2 or not np.isfinite(curve).all()):
        raise ValueError(f"range sensor: curve is {shown(given)}; expected finite numbers (2 or more, 2): {remedy}")
    if curve.size and not (curve[0, 0] >= 0.0 and (np.diff(curve[:, 0]) > 0.0).all()):
        raise ValueError(f"range sensor: the distances of curve are {shown(curve[:, 0].tolist())}; {remedy}")
    return tuple((float(d), float(v)) for d, v in curve) if curve.size else ()


def _on_lines(x: ArrayLike, knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate on straight lines between rising knots; np.interp may fuse products and sums, by the processor."""
    inside = np.clip(floats("range sensor: curve", x), knots[0], knots[-1])
    k = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, max(len(knots) - 2, 0))
    after = np.minimum(k + 1, len(knots) - 1)
    span = np.where(after > k, knots[after] - knots[k], 1.0)
    return values[k] + (inside - knots[k]) / span * (values[after] - values[k])


def unit_directions(what: str, given: ArrayLike) -> np.ndarray:
    """Return unit directions (rays, 3); raise ValueError for what is none."""
    try:
        found = np.array(given, dtype=float)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.ndim != 2 or found.shape[1:] != (3,) or not len(found) or not np.isfinite(found).all():
        raise ValueError(f"{what}: directions are {shown(given)}; expected finite numbers (rays, 3): give a list")
    lengths = np.sqrt(total(found * found))
    if lengths.min() < PARALLEL:
        raise ValueError(f"{what}: direction {int(lengths.argmin())} has no length; give another one")
    return found / lengths[:, None]
