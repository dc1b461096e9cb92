"""Joints that follow others: <mimic>, resolved to leaders that move by themselves."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from ..model import Joint, Mimic
from .report import Report

MimicMode = Literal["coupled", "free", "locked"]


def _check_mode(mode: str) -> None:
    """Raise ValueError unless it is a way to take <mimic>."""
    if not isinstance(mode, str) or mode not in ("coupled", "free", "locked"):
        raise ValueError(f"mimic={mode!r}; expected 'coupled', 'free' or 'locked': use one of these")


def resolve_couplings(
    joints: tuple[Joint, ...], locked: dict[str, float], mode: MimicMode, report: Report
) -> tuple[tuple[Joint, ...], dict[str, float]]:
    """Joints whose Mimic names a leader that moves by itself, and the joints to hold with their positions.

    Chains lead to the joint at their end.  A follower of a joint that does not move is held, and with mode "locked"
    every follower is, where its leader's position nearest to zero puts it; with "free" it moves by itself.  A joint
    that is locked follows nobody.  Raises ValueError on another mode; a chain that leads nowhere goes into the report.
    """
    _check_mode(mode)
    by_name = {joint.name: joint for joint in joints}
    held, resolved = dict(locked), []
    for joint in joints:
        mimic = _followed(joint, by_name, locked, mode, report)
        if mimic and (mode == "locked" or _is_still(mimic, by_name[mimic.joint], locked)):
            held[joint.name] = _position(joint, mimic, by_name[mimic.joint], locked, report)
            mimic = None
        elif mimic:
            _check_ranges(joint, mimic, by_name[mimic.joint], report)
        resolved.append(replace(joint, mimic=mimic))
    return tuple(resolved), held


def _followed(
    joint: Joint, by_name: dict[str, Joint], locked: dict[str, float], mode: MimicMode, report: Report
) -> Mimic | None:
    """The coupling of a joint to one that follows nobody, or None if it moves by itself or not at all."""
    if joint.mimic is None or joint.type == "fixed" or joint.name in locked:
        return None
    if mode == "free":
        report.remark(f"joint {joint.name!r} moves by itself, not with joint {joint.mimic.joint!r}")
        return None
    return _resolved(joint.mimic, by_name, locked) if _is_sound(joint, by_name, report) else None


def _is_still(mimic: Mimic, leader: Joint, locked: dict[str, float]) -> bool:
    return leader.type == "fixed" or leader.name in locked or mimic.multiplier == 0


def _is_sound(joint: Joint, by_name: dict[str, Joint], report: Report) -> bool:
    """Whether a chain of mimics ends in a joint that is there; if not, that is reported."""
    path = [joint.name]
    mimic = joint.mimic
    while mimic is not None:
        if mimic.joint in path:
            loop = sorted(path[path.index(mimic.joint) :])
            text = f"joints {', '.join(map(repr, loop))} follow each other in a circle; remove one <mimic>"
            _refuse(report, loop[0], text)
            return False
        if mimic.joint not in by_name:
            _refuse(report, path[-1], f"<mimic> names joint {mimic.joint!r}, which is not there; correct the name")
            return False
        path.append(mimic.joint)
        mimic = by_name[mimic.joint].mimic
    return True


def _refuse(report: Report, joint: str, text: str) -> None:
    report.refuse_at(f"joint {joint!r}", f"joint {joint!r}: {text}, or load with mimic='free'")


def _resolved(mimic: Mimic, by_name: dict[str, Joint], locked: dict[str, float]) -> Mimic:
    """The coupling to the joint at the end of a chain, or to the first that is held."""
    multiplier, offset, leader = mimic.multiplier, mimic.offset, by_name[mimic.joint]
    while leader.mimic is not None and leader.name not in locked and leader.type != "fixed":
        offset += multiplier * leader.mimic.offset
        multiplier *= leader.mimic.multiplier
        leader = by_name[leader.mimic.joint]
    return Mimic(leader.name, multiplier, offset)


def _check_ranges(joint: Joint, mimic: Mimic, leader: Joint, report: Report) -> None:
    """Doubt a follower that is beyond its limits wherever its leader is."""
    low, high = sorted(mimic.multiplier * limit + mimic.offset for limit in (leader.lower, leader.upper))
    if low > joint.upper or high < joint.lower:
        report.doubt(
            f"joint {joint.name!r} follows joint {leader.name!r}, whose limits put it between {low:.6g} and "
            f"{high:.6g}, beyond its own {joint.lower:.6g} to {joint.upper:.6g}"
        )


def _position(joint: Joint, mimic: Mimic, leader: Joint, locked: dict[str, float], report: Report) -> float:
    """Where a follower is held [rad or m]: as its leader says, within its own limits."""
    at = 0.0 if leader.type == "fixed" else min(max(locked.get(leader.name, 0.0), leader.lower), leader.upper)
    asked = mimic.multiplier * at + mimic.offset
    position = min(max(asked, joint.lower), joint.upper)
    said = f"joint {joint.name!r} is held at {position:.6g}, since it follows joint {leader.name!r}"
    if position == asked:
        report.remark(said)
    else:
        report.doubt(f"{said}, which asks for {asked:.6g}, beyond its limits")
    return position
