"""Read and write <sensor>: rays along the z axis of a site, force and torque at a site, and touch of a body."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Iterator
from typing import Any

import numpy as np

from ...base.fixed_order import applied, product
from ...base.flaws import quoted
from ...base.rotation import rotation_from_quaternion, rpy_from_rotation
from ...model.placed import SEPARATOR
from ...model.sensor import (
    RESERVED,
    WORLD,
    ContactSensor,
    ForceTorqueSensor,
    LineSensor,
    RangeSensor,
    SampledSensor,
    Sensor,
)
from ..markup import element
from .tree import unused, vector

TOUCH, FORCE, TORQUE, RANGEFINDER = 0, 4, 5, 7  # mjtSensor
SITE_OBJECT = 6  # mjtObj
EVERYWHERE = 100.0  # radius of the site that finds all contacts of a body [m]
ELSEWHERE = {  # what every run has of others, by mjtSensor
    1: "the accelerometer of the base", 3: "the gyroscope of the base", 9: "the channel q", 10: "the channel qd",
}  # fmt: skip
SWITCH = "a switch for the force on the whole body, which is 1 above 0 N"
BOTH = "a force and moment sensor, of six numbers"


def read_sensors(
    m: Any, owner: Callable[[int], str | None], prefix: str = "", world: bool = True
) -> tuple[list[Sensor], list[str]]:
    """Read the sensors on some bodies, and what to say of them.

    owner: name of the link that a body is, None for others; prefix: what all names begin with; world: whether to read
    those of bodies without owner that never move.
    """
    found: list[Sensor] = []
    sites: dict[tuple[int, int], str] = {}  # of forces and torques
    taken: dict[str, list[str]] = {}
    for k in (k for k in range(m.nsensor) if _is_read(m, k)):
        kind, site = int(m.sensor_type[k]), int(m.sensor_objid[k])
        E, r, b = rotation_from_quaternion(m.site_quat[site]), m.site_pos[site], int(m.site_bodyid[site])
        link = owner(b)
        if link is None and (not world or m.body_weldid[b]):
            continue
        while b and link is None:
            turn = rotation_from_quaternion(m.body_quat[b])
            E, r, b = product(turn, E), m.body_pos[b] + applied(turn, r), int(m.body_parentid[b])
        own = (m.sensor(k).name or f"sensor{k}").removeprefix(prefix).replace(SEPARATOR, "_")
        name = unused(own, {*RESERVED, *(one.name for one in found)})
        place: dict[str, Any] = {"name": name, "position": vector(r), "rpy": rpy_from_rotation(E)}
        if kind == RANGEFINDER:
            reach = float(m.sensor_cutoff[k]) or math.inf
            found.append(RangeSensor(link or WORLD, np.array([[0.0, 0.0, 1.0]]), reach=reach, **place))
        elif link is None:
            taken.setdefault("nothing, since what carries them never moves", []).append(name)
        elif kind == TOUCH:
            found.append(ContactSensor(link, name=name))
            taken.setdefault(SWITCH, []).append(name)
        elif (FORCE + TORQUE - kind, site) in sites:
            taken.setdefault(f"the numbers of {sites[FORCE + TORQUE - kind, site]!r}", []).append(name)
        else:
            sites[kind, site] = name
            found.append(ForceTorqueSensor(link, **place))
            taken.setdefault(BOTH, []).append(name)
    return found, [f"took sensors {quoted(names)} as {what}" for what, names in taken.items()]


def _is_read(m: Any, k: int) -> bool:
    kind, at_site = int(m.sensor_type[k]), m.sensor_objtype[k] == SITE_OBJECT
    return kind in (TOUCH, FORCE, TORQUE, RANGEFINDER) and at_site and (kind != RANGEFINDER or m.sensor_dim[k] == 1)


def unseen(m: Any, shapes: Container[int], floor: int | None) -> Iterator[str]:
    """Yield which geoms rays meet in MuJoCo alone: those that touch nothing and are no shapes."""
    carriers = {int(m.site_bodyid[m.sensor_objid[k]]) for k in _rays(m)}
    ghosts = (g for g in range(m.ngeom) if carriers and g not in shapes and g != floor and _shows(m, g))
    names = [m.geom(g).name or f"geom{g}" for g in ghosts if carriers - {int(m.geom_bodyid[g])}]
    if names:
        yield (
            f"rays of rangefinders pass through geoms {quoted(names)}, which touch nothing: give them a contype to "
            "have them seen"
        )


def _shows(m: Any, g: int) -> bool:
    """Return whether a ray of MuJoCo meets a geom: it is not transparent."""
    material = int(m.geom_matid[g])
    return bool(m.geom_rgba[g, 3]) if material < 0 else bool(m.mat_rgba[material, 3])


def _rays(m: Any) -> list[int]:
    return [k for k in range(m.nsensor) if _is_read(m, k) and m.sensor_type[k] == RANGEFINDER]


def sensor_notes(m: Any) -> Iterator[str]:
    """Yield what of sensors is not read, sensors that are not, by kind, and what rays that meet nothing read."""
    names = [m.sensor(k).name or f"sensor{k}" for k in _rays(m)]
    if names:
        yield f"rangefinders {quoted(names)} read inf, where MuJoCo reads -1 or, beyond it, the cutoff"
    for what in ("cutoff", "noise", "delay", "interval"):
        stated = getattr(m, f"sensor_{what}", np.zeros(m.nsensor))  # delay and interval: since MuJoCo 4
        own = [k for k in range(m.nsensor) if _is_read(m, k) and np.any(stated[k])]
        names = [m.sensor(k).name or f"sensor{k}" for k in own if what != "cutoff" or m.sensor_type[k] != RANGEFINDER]
        if names:
            remedy = "" if what == "cutoff" else ": a SampledSensor has it"
            yield f"ignored {what} of sensors {quoted(names)}{remedy}"
    kinds: dict[str, list[str]] = {}
    for k in (k for k in range(m.nsensor) if not _is_read(m, k)):
        kinds.setdefault(_kind(int(m.sensor_type[k])), []).append(m.sensor(k).name or f"sensor{k}")
    for kind, names in kinds.items():
        yield f"skipped sensors {quoted(names)} ({kind})"


def _kind(kind: int) -> str:
    import mujoco

    name = mujoco.mjtSensor(kind).name.removeprefix("mjSENS_").lower()
    return f"{name}: every run has {ELSEWHERE[kind]}" if kind in ELSEWHERE else name


# ---------------------------------------------------------------------------------------------- writing


def sensor_site_lines(sensors: Iterable[Sensor | SampledSensor], link: str) -> list[str]:
    """Write the sites of sensors on a link, or in the world."""
    lines: list[str] = []
    for one in sensors:
        inner = measures(one)
        if inner is None or inner.link != link:
            continue
        if isinstance(inner, RangeSensor):
            for name, ray in zip(_ray_names(one, inner), inner.mounted):
                lines += element("site", {"name": name, "pos": ray[:3], "zaxis": ray[3:]})
        elif isinstance(inner, ForceTorqueSensor):
            lines += element("site", {"name": one.name, "pos": inner.position, "euler": inner.rpy})
        elif isinstance(inner, ContactSensor):
            lines += element("site", {"name": one.name, "size": EVERYWHERE, "rgba": "0 0 0 0"})
    return lines


def sensor_lines(sensors: Iterable[Sensor | SampledSensor]) -> list[str]:
    """Write the sensors that MuJoCo has."""
    lines: list[str] = []
    for one in sensors:
        inner = measures(one)
        if isinstance(inner, RangeSensor):
            reach = inner.reach if inner.reach < math.inf else None
            for name in _ray_names(one, inner):
                lines += element("rangefinder", {"name": name, "site": name, "cutoff": reach})
        elif isinstance(inner, ForceTorqueSensor):
            lines += element("force", {"name": one.name, "site": one.name})
            lines += element("torque", {"name": f"{one.name}_torque", "site": one.name})
        elif isinstance(inner, ContactSensor):
            lines += element("touch", {"name": one.name, "site": one.name})
    return lines


def lost_of_sensors(sensors: Iterable[Sensor | SampledSensor]) -> list[str]:
    """Return what the written sensors lack."""
    lost: dict[str, list[str]] = {}
    for one in sensors:
        inner = measures(one)
        found = {
            "left out sensors of channels, which no file states": inner is None,
            "left out sensors of lines, which MJCF does not have": isinstance(inner, LineSensor),
            "wrote touch, a force, for the switches": isinstance(inner, ContactSensor),
            "no noise, rate and delay of sensors in MuJoCo": inner is not None and inner is not one,
        }
        if isinstance(inner, RangeSensor):
            found["wrote each ray by itself, and not the nearest, of sensors"] = inner.nearest
            found["wrote distances, and not voltages, of sensors"] = bool(inner.curve)
        for what in (what for what, holds in found.items() if holds):
            lost.setdefault(what, []).append(one.name)
    return [f"{what}: {', '.join(map(repr, names))}" for what, names in lost.items()]


def measures(one: Sensor | SampledSensor) -> Sensor | None:
    """Return the sensor that measures; None for a channel."""
    inner = one.sensor if isinstance(one, SampledSensor) else one
    return None if isinstance(inner, str) else inner


def _ray_names(one: Sensor | SampledSensor, inner: RangeSensor) -> list[str]:
    count = len(inner.directions)
    return [one.name] if count == 1 else [f"{one.name}_{k}" for k in range(count)]
