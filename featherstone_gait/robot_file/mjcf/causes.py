"""What of a compiled MJCF file has no place in a Model: what is refused, and what is passed over."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from .names import actuator_count
from .tree import BALL, FREE, Tree

GRAVITY = (0.0, 0.0, -9.81)
EQUALITY_KINDS = ("connect", "weld", "joint", "tendon", "flex", "flexvert", "flexstrain")
JOINT_EQUALITY = 2  # mjEQ_JOINT
TENDON = 3  # mjTRN_TENDON
# mjtDisableBit, of <flag>
NO_CONSTRAINTS, NO_EQUALITIES, NO_FRICTION, NO_LIMITS = 1 << 0, 1 << 1, 1 << 2, 1 << 3
NO_SPRINGS, NO_DAMPERS, NO_GRAVITY = 1 << 5, 1 << 6, 1 << 7


def refusals(m: Any, names: Tree) -> list[str]:
    """Why a compiled file cannot be a Model, all reasons at once."""
    equalities = [*_equalities(m), *_twice_led(m, names)]
    return [*_joints(m, names), *_trees(m, names), *equalities, *_tendons(m), *_others(m)]


def _joints(m: Any, names: Tree) -> Iterator[str]:
    balls = [names.joint_names[j] for j in range(m.njnt) if m.jnt_type[j] == BALL]
    if balls:
        yield f"ball joints {listed(balls)} have no like here; replace each by three hinges"


def _trees(m: Any, names: Tree) -> Iterator[str]:
    moving = sorted({int(m.body_rootid[b]) for b in range(1, m.nbody) if m.body_dofnum[b]})
    if len(moving) > 1:
        yield (
            f"{len(moving)} kinematic trees move, from bodies {listed([names.bodies[b] for b in moving])}; a robot is "
            "one: remove the others"
        )


def _equalities(m: Any) -> Iterator[str]:
    for k in _active(m):
        kind = int(m.eq_type[k])
        if kind != JOINT_EQUALITY:
            what = EQUALITY_KINDS[kind] if kind < len(EQUALITY_KINDS) else f"of kind {kind}"
            yield f"equality {_equality(m, k)} <{what}> closes a loop; remove it, or set active='false'"
        elif not _linear(m, k):
            yield (
                f"equality {_equality(m, k)} <joint> is not linear: polycoef is {m.eq_data[k, :5].tolist()}; only the "
                "first two numbers may differ from 0: change them, or set active='false'"
            )


def _twice_led(m: Any, names: Tree) -> Iterator[str]:
    """Joints that two equalities lead."""
    led: dict[int, list[str]] = {}
    for k in _active(m):
        if m.eq_type[k] == JOINT_EQUALITY:
            led.setdefault(int(m.eq_obj1id[k]), []).append(_equality(m, k))
    for j, equalities in led.items():
        if len(equalities) > 1:
            yield (
                f"joint {names.joint_names[j]!r} is joint1 of equalities {', '.join(equalities)}; it can follow one "
                "alone: remove the others, or set active='false'"
            )


def _active(m: Any) -> list[int]:
    """The equalities that act."""
    if m.opt.disableflags & (NO_CONSTRAINTS | NO_EQUALITIES):
        return []
    return [k for k in range(m.neq) if m.eq_active0[k]]


def _equality(m: Any, k: int) -> str:
    return repr(m.equality(k).name or k)


def _linear(m: Any, k: int) -> bool:
    """Whether a joint is held to a straight line of another, or at a place of its own."""
    return m.eq_obj2id[k] < 0 or not m.eq_data[k, 2:5].any()


def couplings(m: Any) -> dict[int, tuple[int, float, float]]:
    """Leader, multiplier and offset by follower: MuJoCo's y - y0 = a + b (x - x0) of a <joint> equality."""
    mimics = {}
    for k in _active(m):
        if m.eq_type[k] == JOINT_EQUALITY and m.eq_obj2id[k] >= 0 and _linear(m, k):
            y, x = int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
            a, b = m.eq_data[k, :2].tolist()
            mimics[y] = (x, b, _reference(m, y) + a - b * _reference(m, x))
    return mimics


def held_joints(m: Any) -> dict[int, float]:
    """Joints that an equality without a second joint holds, and where: MuJoCo's y = y0 + a [rad or m]."""
    alone = [k for k in _active(m) if m.eq_type[k] == JOINT_EQUALITY and m.eq_obj2id[k] < 0]
    return {j: _reference(m, j) + float(m.eq_data[k, 0]) for k in alone for j in [int(m.eq_obj1id[k])]}


def _reference(m: Any, j: int) -> float:
    return float(m.qpos0[m.jnt_qposadr[j]])


def _tendons(m: Any) -> Iterator[str]:
    """One reason for each way in which tendons act."""
    actuators = range(actuator_count(m))
    driven = {int(m.actuator_trnid[k, 0]) for k in actuators if m.actuator_trntype[k] == TENDON}
    acting: dict[str, list[str]] = {}
    for k in range(m.ntendon):
        acts = [what for what in ("stiffness", "damping", "frictionloss", "armature") if _nonzero(m, "tendon", what, k)]
        for what in [*acts, *["limit"] * bool(m.tendon_limited[k]), *["actuator"] * (k in driven)]:
            acting.setdefault(what, []).append(m.tendon(k).name or str(k))
    for what, names in acting.items():
        yield f"tendons act on the joints by their {what}: {listed(names)}; remove the tendons, or their {what}"


def _nonzero(m: Any, kind: str, what: str, k: int) -> bool:
    """Whether a number of an element, or of the powers that MuJoCo 4 adds to it, is not zero."""
    powers = getattr(m, f"{kind}_{what}poly", None)
    return bool(np.any(getattr(m, f"{kind}_{what}")[k]) or (powers is not None and np.any(powers[k])))


def _others(m: Any) -> Iterator[str]:
    if m.nflex:
        yield f"{m.nflex} flexible bodies <flex>; only rigid ones are simulated: remove them"
    if (m.body_plugin >= 0).any() or (m.actuator_plugin >= 0).any():
        yield "plugins act on bodies or actuators; what they do is not in the file: remove them"


def doubts(m: Any, tree: Tree) -> Iterator[str]:
    """What changes the motion in MuJoCo and is passed over here."""
    springs = [tree.joint_names[j] for j in range(m.njnt) if _nonzero(m, "jnt", "stiffness", j)]
    if springs and not m.opt.disableflags & NO_SPRINGS:
        yield f"passed over the springs (stiffness) of joints {listed(springs)}: joints have none here"
    poly = getattr(m, "dof_dampingpoly", np.zeros(m.nv))  # not of older versions
    bent = [tree.joint_names[m.dof_jntid[k]] for k in range(m.nv) if np.any(poly[k])]
    if bent:
        yield f"passed over the nonlinear damping of joints {listed(bent)}: it is linear here"
    yield from _free_joint(m)
    yield from _switched_off(m)
    uneven = [tree.joint_names[j] for j in range(m.njnt) if m.jnt_actfrclimited[j] and m.jnt_actfrcrange[j].sum()]
    if uneven:
        yield f"took the larger end of actuatorfrcrange of joints {listed(uneven)} either way: effort has one number"
    if m.opt.density or m.opt.viscosity:
        yield f"passed over a fluid (density {m.opt.density:g}, viscosity {m.opt.viscosity:g}): there is none here"
    yield from _gravity(m, tree)


def _switched_off(m: Any) -> Iterator[str]:
    """Parts of the joints that a <flag> switches off."""
    parts = {
        "dampers": (NO_DAMPERS, m.dof_damping),
        "limits of joints": (NO_LIMITS | NO_CONSTRAINTS, m.jnt_limited),
        "friction of joints": (NO_FRICTION | NO_CONSTRAINTS, m.dof_frictionloss),
    }
    for what, (bits, values) in parts.items():
        if m.opt.disableflags & bits and np.any(values):
            yield f"passed over the <flag> that switches off {what}: they act here"


def _gravity(m: Any, tree: Tree) -> Iterator[str]:
    if m.opt.disableflags & NO_GRAVITY:
        yield "a <flag> switches off gravity in the file: give gravity=(0, 0, 0) to compile_scene"
        return
    if np.any(m.body_gravcomp):
        held = [tree.bodies[b] for b in np.flatnonzero(m.body_gravcomp)]
        yield f"passed over gravcomp of bodies {listed(held)}: gravity acts on all alike"
    if tuple(m.opt.gravity) != GRAVITY:
        yield f"gravity of the file is {tuple(m.opt.gravity.tolist())} m/s^2: give it to compile_scene"


def _free_joint(m: Any) -> Iterator[str]:
    for j in np.flatnonzero(m.jnt_type == FREE):
        dofs = slice(m.jnt_dofadr[j], m.jnt_dofadr[j] + 6)
        stated = [w for w in ("armature", "damping", "frictionloss") if np.any(getattr(m, f"dof_{w}")[dofs])]
        if stated:
            yield f"passed over {', '.join(stated)} of the free joint: a base has none here"


def notes(m: Any, tree: Tree) -> Iterator[str]:
    """What is there and plays no part."""
    if tree.root and m.body_geomnum[0]:
        yield f"passed over {m.body_geomnum[0]} geoms of the world: ground is an argument of compile_scene"
    fixed = [b for b in range(1, m.nbody) if tree.root and m.body_rootid[b] != tree.root]
    if fixed:
        yield f"passed over bodies {listed([tree.bodies[b] for b in fixed])}, which stand in the world"
    if m.ntendon:
        yield f"skipped {m.ntendon} tendons that act on nothing"
    for count, what in ((m.nsensor, "sensors"), (m.nsite, "sites"), (m.ncam, "cameras"), (m.nlight, "lights")):
        if count:
            yield f"skipped {count} {what}"
    if m.nexclude or m.npair:
        yield "skipped <contact>: links touch the ground alone"
    if couplings(m):
        yield "took the equalities of joints as exact; MuJoCo's give way"
    if held_joints(m):
        yield f"held joints {listed([tree.joint_names[j] for j in held_joints(m)])} where equalities put them"
    off = m.neq - len(_active(m))
    if off:
        yield f"skipped {off} equalities that are not active"


def listed(names: list[str]) -> str:
    """Names for a message, cut short after ten."""
    shown = ", ".join(repr(name) for name in names[:10])
    return shown + (f" and {len(names) - 10} more" if len(names) > 10 else "")
