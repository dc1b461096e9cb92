"""Coupled joints of a file (<mimic>), resolved to leaders that move by themselves."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import replace
from typing import Literal

from ..model import Joint, Mimic
from ..model.links import Leader, leader_of
from .report import Report

MimicMode = Literal["coupled", "free", "locked"]


def resolve_couplings(
    joints: tuple[Joint, ...], locked: dict[str, float], mode: MimicMode, report: Report
) -> tuple[tuple[Joint, ...], dict[str, float]]:
    """Return joints whose Mimic names a leader that moves by itself, and the joints to hold with their positions.

    Chains lead to the joint at their end.  A follower of a joint that does not move is held, and with the mode "locked"
    every follower is, where its leader's position nearest to zero puts it; with "free" it moves by itself.  A locked
    joint ignores its coupling.  Raises ValueError on another mode; a chain that leads nowhere goes into the report.
    """
    if not isinstance(mode, str) or mode not in ("coupled", "free", "locked"):
        raise ValueError(f"mimic={mode!r}; expected 'coupled', 'free' or 'locked': use one of these")
    by_name = {joint.name: joint for joint in joints}
    held, resolved = dict(locked), []
    for joint in joints:
        mimic = None
        if _is_coupled(joint, by_name, locked, mode, report):
            leader = leader_of(joint, by_name, locked)
            still = leader.joint.type == "fixed" or leader.joint.name in locked or leader.multiplier == 0
            if mode == "locked" or still:
                held[joint.name] = _held_position(joint, leader, locked, report)
            else:
                head, k, offset = leader
                mimic = Mimic(head.name, k, offset)
                low, high = sorted(k * limit + offset for limit in (head.lower, head.upper))
                if low > joint.upper or high < joint.lower:
                    report.doubt(
                        f"joint {joint.name!r} follows joint {head.name!r}, whose limits put it between {low:.6g} and "
                        f"{high:.6g}, beyond its own {joint.lower:.6g} to {joint.upper:.6g}"
                    )
        resolved.append(replace(joint, mimic=mimic))
    return tuple(resolved), held


def _is_coupled(
    joint: Joint, by_name: Mapping[str, Joint], locked: Container[str], mode: MimicMode, report: Report
) -> bool:
    """Return whether a joint follows another; a chain that does not end in a joint is reported."""
    if joint.mimic is None or joint.type == "fixed" or joint.name in locked:
        return False
    if mode == "free":
        report.remark(f"joint {joint.name!r} moves by itself, not with joint {joint.mimic.joint!r}")
        return False
    path: list[str] = [joint.name]
    mimic: Mimic | None = joint.mimic
    while mimic is not None:
        if mimic.joint in path:
            loop = sorted(path[path.index(mimic.joint) :])
            text = f"joints {', '.join(map(repr, loop))} follow each other in a circle; remove one <mimic>"
            return _refuse(report, loop[0], text)
        if mimic.joint not in by_name:
            text = f"<mimic> names joint {mimic.joint!r}, which is not there; correct the name"
            return _refuse(report, path[-1], text)
        path.append(mimic.joint)
        mimic = by_name[mimic.joint].mimic
    return True


def _refuse(report: Report, joint: str, text: str) -> bool:
    report.refuse_at(f"joint {joint!r}", f"joint {joint!r}: {text}, or load with mimic='free'")
    return False


def _held_position(joint: Joint, leader: Leader, locked: Mapping[str, float], report: Report) -> float:
    """Compute where a follower is held [rad or m]: as its leader says, within its own limits."""
    head = leader.joint
    at = 0.0 if head.type == "fixed" else min(max(locked.get(head.name, 0.0), head.lower), head.upper)
    wanted = leader.multiplier * at + leader.offset
    position = min(max(wanted, joint.lower), joint.upper)
    text = f"joint {joint.name!r} is held at {position:.6g}, since it follows joint {head.name!r}"
    if position == wanted:
        report.remark(text)
    else:
        report.doubt(f"{text}, which asks for {wanted:.6g}, beyond its limits")
    return position
