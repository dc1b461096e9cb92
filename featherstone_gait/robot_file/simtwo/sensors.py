"""Say which RangeSensor does what a sensor of a SimTwo file does.

A ray leaves a sensor along x.  A sensor is placed in the frame of its solid, or in the robot's or the world's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from ...base.fixed_order import applied, product
from ...base.rotation import rotation_from_rpy, rpy_from_rotation
from .differences import RAYS, Differences
from .expression import Numbers

OTHERS = {
    "floorline": "nothing is painted on the ground here",
    "imu": "a Session observes `gyroscope` and `accelerometer`",
    "RFID": "nothing has tags here; compare positions instead",
    "beacon": "compare positions instead",
    "pentip": "nothing is painted here",
    "spraygun": "nothing is painted here",
}
SOLENOID = "it pulls nothing here; hold with a Loop that `switch_loop` makes and breaks"


class Carrier(NamedTuple):
    """The link that carries a sensor, and where the solid of SimTwo is on it."""

    link: str
    position: np.ndarray  # (3,) of the solid's center in the link's frame [m]
    rotation: np.ndarray  # (3, 3) of the solid's axes
    origin: np.ndarray  # (3,) of the link's frame in the robot's [m]


WORLD = Carrier("world", np.zeros(3), np.eye(3), np.zeros(3))


def tell_sensor(
    element: Element, numbers: Numbers, carriers: Mapping[str, Carrier], first: Carrier, differences: Differences
) -> None:
    """Add what a sensor is here; first: what carries one that names no solid."""
    named = element.find("ID")
    name = "" if named is None else named.get("name", named.get("value", ""))
    what = f"<{element.tag}> {name!r}"
    if element.tag == "solenoid":
        differences.add(element, f"{what} is left out: {SOLENOID}", doubt=True)
    elif element.tag in OTHERS:
        differences.add(element, f"{what} is left out: {OTHERS[element.tag]}")
    elif element.tag in RAYS.split():
        solid, carrier = element.find("solid"), first
        if solid is not None:
            carrier = carriers.get(solid.get("id", ""), first)
            if solid.get("id") not in carriers:
                differences.add(element, f"{what} names no solid that is there: it is on {first.link!r}, as in SimTwo")
        differences.add(element, f"{what} is left out: use {_range_sensor(element, numbers, carrier, name)}")


def _range_sensor(element: Element, numbers: Numbers, carrier: Carrier, name: str) -> str:
    """Return the call that makes the sensor."""
    what = f"<{element.tag}> {name!r}"
    position = np.array(numbers.xyz(element.find("pos"), f"{what} <pos>"))
    R = rotation_from_rpy(tuple(map(math.radians, numbers.xyz(element.find("rot_deg"), f"{what} <rot_deg>"))))
    if element.find("absolute_coords") is not None:
        position = position - carrier.origin
    else:
        position, R = carrier.position + applied(carrier.rotation, position), product(carrier.rotation, R)
    beam = element.find("beam")
    angle = math.radians(numbers.one(beam, "angle", 30.0, f"{what} <beam>"))
    rays = max(3, round(numbers.one(beam, "rays", 9.0, f"{what} <beam>")))
    start = {
        "ranger2d": f"RangeSensor.fan({carrier.link!r}, {_short(angle)}, {rays}",
        "sonar": f"RangeSensor.cone({carrier.link!r}, {_short(angle)}, {rays}",
    }.get(element.tag, f"RangeSensor({carrier.link!r}, [[1.0, 0.0, 0.0]]")
    x, y, z = map(_short, position)
    roll, pitch, yaw = map(_short, rpy_from_rotation(R))
    reach = _short(numbers.one(beam, "length", 0.8, f"{what} <beam>"))
    return f"{start}, position=({x}, {y}, {z}), rpy=({roll}, {pitch}, {yaw}), reach={reach}, name={name!r})"


def _short(value: float) -> str:
    """Write a number in nine digits."""
    return repr(float(f"{value + 0.0:.9g}"))
