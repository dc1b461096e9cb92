"""What of a compiled MJCF file has no place in a Model: what is refused, and what is passed over."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...base.flaws import quoted
from . import equalities
from .tendons import effects, nonzero
from .tree import BALL, FREE, Tree, moving_trees

GRAVITY = (0.0, 0.0, -9.81)
# mjtDisableBit, of <flag>
NO_CONSTRAINTS, NO_FRICTION, NO_LIMITS = 1 << 0, 1 << 2, 1 << 3
NO_SPRINGS, NO_DAMPERS, NO_GRAVITY = 1 << 5, 1 << 6, 1 << 7


def refusals(m: Any, names: Tree) -> list[str]:
    """Why a compiled file cannot be a Model, all reasons at once."""
    taken = [names.holds(m, b) for b in range(m.nbody)]
    return [*_joints(m, names), *equalities.refusals(m, names.joint_names, taken), *_others(m)]


def _joints(m: Any, names: Tree) -> Iterator[str]:
    balls = [names.joint_names[j] for j in range(m.njnt) if m.jnt_type[j] == BALL and names.holds(m, m.jnt_bodyid[j])]
    if balls:
        yield f"ball joints {quoted(balls)} have no like here; replace each by three hinges"


def _others(m: Any) -> Iterator[str]:
    if m.nflex:
        yield f"{m.nflex} flexible bodies <flex>; only rigid ones are simulated: remove them"
    if (m.body_plugin >= 0).any() or (m.actuator_plugin >= 0).any():
        yield "plugins act on bodies or actuators; what they do is not in the file: remove them"


def doubts(m: Any, tree: Tree) -> Iterator[str]:
    """What changes the motion in MuJoCo and is passed over here."""
    if tree.left:
        yield (
            f"left out bodies {quoted([tree.bodies[b] for b in tree.left])} with all that they carry: a Model has one "
            f"floating base at most, and of several trees the one with most joints is taken, here {_taken(m, tree)}"
        )
    drawn = [equalities.title(m, k) for k in equalities.active(m) if equalities.follows_mocap(m, k)]
    if drawn:
        yield f"passed over equalities {', '.join(drawn)}, which draw a body after a mocap body: there are none here"
    yield from effects(m)
    springs = [tree.joint_names[j] for j in range(m.njnt) if nonzero(m, "jnt", "stiffness", j)]
    if springs and not m.opt.disableflags & NO_SPRINGS:
        yield f"passed over the springs (stiffness) of joints {quoted(springs)}: joints have none here"
    poly = getattr(m, "dof_dampingpoly", np.zeros(m.nv))  # not of older versions
    bent = [tree.joint_names[m.dof_jntid[k]] for k in range(m.nv) if np.any(poly[k])]
    if bent:
        yield f"passed over the nonlinear damping of joints {quoted(bent)}: it is linear here"
    yield from _free_joint(m)
    yield from _switched_off(m)
    uneven = [tree.joint_names[j] for j in range(m.njnt) if m.jnt_actfrclimited[j] and m.jnt_actfrcrange[j].sum()]
    if uneven:
        yield f"took the larger end of actuatorfrcrange of joints {quoted(uneven)} either way: effort has one number"
    if m.opt.density or m.opt.viscosity:
        yield f"passed over a fluid (density {m.opt.density:g}, viscosity {m.opt.viscosity:g}): there is none here"
    yield from _gravity(m, tree)


def _taken(m: Any, tree: Tree) -> str:
    """What is not left out, in words."""
    if tree.root:
        return repr(tree.bodies[tree.root])
    return quoted([tree.bodies[b] for b in moving_trees(m) if b not in tree.left])


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
        yield f"passed over gravcomp of bodies {quoted(held)}: gravity acts on all alike"
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
    fixed = [b for b in range(1, m.nbody) if not tree.holds(m, b) and m.body_rootid[b] not in tree.left]
    if fixed:
        yield f"passed over bodies {quoted([tree.bodies[b] for b in fixed])}, which stand in the world"
    if m.ntendon:
        yield f"skipped {m.ntendon} tendons"
    for count, what in ((m.nsensor, "sensors"), (m.nsite, "sites"), (m.ncam, "cameras"), (m.nlight, "lights")):
        if count:
            yield f"skipped {count} {what}"
    if m.nexclude or m.npair:
        yield "skipped <contact>: links touch the ground alone"
    if equalities.couplings(m):
        yield "took the equalities of joints as exact; MuJoCo's give way"
    held = equalities.held_joints(m)
    if held:
        yield f"held joints {quoted([tree.joint_names[j] for j in held])} where equalities put them"
    off = m.neq - len(equalities.active(m))
    if off:
        yield f"skipped {off} equalities that are not active"
