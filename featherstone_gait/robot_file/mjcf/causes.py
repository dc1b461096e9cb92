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


def refusals(m: Any, names: Tree) -> list[str]:
    """Why a compiled file cannot be a Model, all reasons at once."""
    return [*_joints(m, names), *_trees(m, names), *_equalities(m), *_tendons(m), *_others(m)]


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
    for k in range(m.neq):
        kind = int(m.eq_type[k])
        if m.eq_active0[k] and not (kind == JOINT_EQUALITY and _linear(m, k)):
            what = EQUALITY_KINDS[kind] if kind < len(EQUALITY_KINDS) else f"of kind {kind}"
            bent = " that is not linear" if kind == JOINT_EQUALITY else ""
            yield f"equality {m.equality(k).name or k!r} <{what}>{bent} closes a loop; remove it, or set active='false'"


def _linear(m: Any, k: int) -> bool:
    """Whether a joint is held to a straight line of another, or at a place of its own."""
    return m.eq_obj2id[k] >= 0 and not m.eq_data[k, 2:5].any()


def couplings(m: Any) -> dict[int, tuple[int, float, float]]:
    """Leader, multiplier and offset by follower: MuJoCo's y - y0 = a + b (x - x0) of a <joint> equality."""
    mimics = {}
    for k in range(m.neq):
        if m.eq_active0[k] and m.eq_type[k] == JOINT_EQUALITY and _linear(m, k):
            y, x = int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
            y0, x0 = (float(m.qpos0[m.jnt_qposadr[j]]) for j in (y, x))
            a, b = m.eq_data[k, :2].tolist()
            mimics[y] = (x, b, y0 + a - b * x0)
    return mimics


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
    return bool(np.any(getattr(m, f"{kind}_{what}")[k]))


def _others(m: Any) -> Iterator[str]:
    if m.nflex:
        yield f"{m.nflex} flexible bodies <flex>; only rigid ones are simulated: remove them"
    if (m.body_plugin >= 0).any() or (m.actuator_plugin >= 0).any():
        yield "plugins act on bodies or actuators; what they do is not in the file: remove them"


def doubts(m: Any, tree: Tree) -> Iterator[str]:
    """What changes the motion in MuJoCo and is passed over here."""
    springs = [tree.joint_names[j] for j in range(m.njnt) if m.jnt_stiffness[j]]
    if springs:
        yield f"passed over the springs (stiffness) of joints {listed(springs)}: joints have none here"
    poly = getattr(m, "dof_dampingpoly", np.zeros(m.nv))  # not of older versions
    bent = [tree.joint_names[m.dof_jntid[k]] for k in range(m.nv) if np.any(poly[k])]
    if bent:
        yield f"passed over the nonlinear damping of joints {listed(bent)}: it is linear here"
    yield from _free_joint(m)
    if m.opt.density or m.opt.viscosity:
        yield f"passed over a fluid (density {m.opt.density:g}, viscosity {m.opt.viscosity:g}): there is none here"
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
    off = [k for k in range(m.neq) if not m.eq_active0[k]]
    if off:
        yield f"skipped {len(off)} equalities that are not active"


def listed(names: list[str]) -> str:
    """Names for a message, cut short after ten."""
    shown = ", ".join(repr(name) for name in names[:10])
    return shown + (f" and {len(names) - 10} more" if len(names) > 10 else "")
