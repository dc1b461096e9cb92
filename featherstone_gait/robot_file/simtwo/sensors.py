"""Read the sensors of a SimTwo file that measure along rays, and say what takes the place of others.

A ray leaves a sensor along x.  A sensor is placed in the frame of its solid, or in the robot's or the world's.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from ...base.fixed_order import applied, product
from ...base.rotation import rotation_from_rpy, rpy_from_rotation
from ...model.sensor import RESERVED, LineSensor, RangeSensor, Sensor
from ..markup import Read
from ..mjcf.tree import unused
from .differences import FLOOR, RAYS, Differences
from .expression import Numbers
from .solids import attribute

OTHERS = {
    "imu": "a Session observes `gyroscope` and `accelerometer`",
    "RFID": "nothing has tags here; compare positions instead",
    "beacon": "compare positions instead",
    "pentip": "nothing is painted here",
    "spraygun": "nothing is painted here",
}
MATTER = "it measures the distance to any matter"
SPOT = "it reads the share that is dark of a disc of half its final width, where SimTwo casts n x n rays"
SOLENOID = "it pulls nothing here; hold with a Loop that `switch_loop` makes and breaks"


class Carrier(NamedTuple):
    """The link that carries a sensor, and where the solid of SimTwo is on it."""

    link: str
    position: np.ndarray  # (3,) of the solid's center in the link's frame [m]
    rotation: np.ndarray  # (3, 3) of the solid's axes
    origin: np.ndarray  # (3,) of the link's frame in the robot's [m]


WORLD = Carrier("world", np.zeros(3), np.eye(3), np.zeros(3))


def read_sensor(
    element: Element, numbers: Numbers, carriers: Mapping[str, Carrier], first: Carrier, differences: Differences,
    taken: Collection[str],
) -> Sensor | None:  # fmt: skip
    """Return a sensor, and say what of it differs; None for one that has no place here.

    first: what carries one that names no solid; taken: names that others have.
    """
    name = attribute(element, "ID", "name value", "")
    what = f"<{element.tag}> {name!r}"
    if element.tag == "solenoid":
        differences.add(element, f"{what} is left out: {SOLENOID}", doubt=True)
    elif element.tag in OTHERS:
        differences.add(element, f"{what} is left out: {OTHERS[element.tag]}")
    if element.tag not in (*RAYS.split(), FLOOR):
        if isinstance(element, Read):
            element.whole = True
        return None
    solid, carrier = element.find("solid"), first
    if solid is not None:
        carrier = carriers.get(solid.get("id", ""), first)
        if solid.get("id") not in carriers:
            differences.add(element, f"{what} names no solid that is there: it is on {first.link!r}, as in SimTwo")
    if element.tag in ("capacitive", "inductive"):
        differences.add(element, f"{what}: {MATTER}")
    if element.tag == FLOOR:
        differences.add(element, f"{what}: {SPOT}")
    own = unused((name or element.tag).replace("/", "_"), {*taken, *RESERVED})
    if own != name:
        differences.add(element, f"{what} is called {own!r} here")
    return _sensor(element, numbers, carrier, what, own)


def _sensor(element: Element, numbers: Numbers, carrier: Carrier, what: str, name: str) -> Sensor:
    """Make the sensor."""
    position = np.array(numbers.xyz(element.find("pos"), f"{what} <pos>"))
    R = rotation_from_rpy(tuple(map(math.radians, numbers.xyz(element.find("rot_deg"), f"{what} <rot_deg>"))))
    if element.find("absolute_coords") is not None:
        position = position - carrier.origin
    else:
        position, R = carrier.position + applied(carrier.rotation, position), product(carrier.rotation, R)
    beam = element.find("beam")
    reach = numbers.one(beam, "length", 0.8, f"{what} <beam>")
    if element.tag == FLOOR:
        width = numbers.one(beam, "final_width", 0.0, f"{what} <beam>")
        return LineSensor(carrier.link, (tuple(position),), 0.5 * width, tuple(R[:, 0].tolist()), reach, name)
    more: dict[str, Any] = {"position": tuple(position), "rpy": rpy_from_rotation(R), "reach": reach, "name": name}
    if element.tag not in ("ranger2d", "sonar"):
        return RangeSensor(carrier.link, np.array([[1.0, 0.0, 0.0]]), **more)
    angle = math.radians(numbers.one(beam, "angle", 30.0, f"{what} <beam>"))
    rays = max(3, round(numbers.one(beam, "rays", 9.0, f"{what} <beam>")))
    make = RangeSensor.fan if element.tag == "ranger2d" else RangeSensor.cone
    return make(carrier.link, angle, rays, **more)
