"""Find what of a compiled MJCF file a Model cannot represent: what is refused, and what is ignored."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ...base.flaws import quoted
from . import equalities, loops, tendons
from .sensors import sensor_notes
from .stated import STATED
from .tree import (
    BALL,
    FREE,
    NO_DAMPERS,
    NO_FRICTION,
    NO_LIMITS,
    NO_SPRINGS,
    Tree,
    damping_powers,
    moving_trees,
    names_of,
    stiffness_powers,
    vector,
)

GRAVITY = (0.0, 0.0, -9.81)
# mjtDisableBit, of <flag>
NO_CONSTRAINTS = 1 << 0
SLEEP, SLEEP_AT_START = 1 << 4, 5  # mjtEnableBit, mjtSleepPolicy
NO_CONTACTS, NO_GRAVITY = 1 << 4, 1 << 7
SOLREF, SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)  # MuJoCo's defaults
IDLE = "visual statistic size skin texture material numeric tuple text extension"  # elements that move nothing
READ = {  # attributes that are read of the settings of MuJoCo's solver and integrator
    "option": "gravity wind density viscosity actuatorgroupdisable",
    "flag": "constraint equality frictionloss limit contact spring damper gravity clampctrl actuation filterparent "
    "override sleep",
}


def idle(documents: Iterable[Element]) -> Iterator[str]:
    """Yield what a file and those that it includes say that plays no part."""
    roots = [*documents]
    used = [tag for tag in IDLE.split() if any(_is_idle(element) for root in roots for element in root.iter(tag))]
    if used:
        yield f"skipped what moves nothing ({', '.join(used)})"
    for tag, read in READ.items():
        stated = (name for root in roots for element in root.iter(tag) for name in element.attrib)
        if names := [name for name in dict.fromkeys(stated) if name not in read.split()]:
            yield f"skipped {', '.join(names)} of <{tag}>: compile_scene has integrators and solvers of its own"


def _is_idle(element: Element) -> bool:
    """Return whether an element is not the <text> of this package."""
    return not element.get("name", "").startswith(STATED)


def refusals(m: Any, names: Tree) -> Iterator[str]:
    """Yield why a compiled file cannot be a Model, all reasons at once."""
    held = [names.holds(m, b) for b in range(m.nbody)]
    yield from equalities.refusals(m, names.joint_names, held, loops.closing(m))
    yield from loops.loop_refusals(m, names)
    if m.nflex:
        yield f"{m.nflex} flexible bodies <flex>; only rigid ones are simulated: remove them"
    if (m.body_plugin >= 0).any() or (m.actuator_plugin >= 0).any():
        yield "plugins act on bodies or actuators; what they do is not in the file: remove them"


def doubts(m: Any, tree: Tree) -> Iterator[str]:
    """Yield what changes the motion in MuJoCo and is ignored here."""
    if tree.left:
        kept = [tree.root] if tree.root else [b for b in moving_trees(m) if b not in tree.left]
        yield (
            f"left out bodies {quoted([tree.bodies[b] for b in tree.left])} with all that they carry: a Model has one "
            "floating base at most, and of several trees the one with most joints is taken, here "
            f"{quoted([tree.bodies[b] for b in kept])}; load_scene reads all of them"
        )
    drawn = [equalities.title(m, k) for k in equalities.active(m) if equalities.follows_mocap(m, k)]
    if drawn:
        yield f"ignored equalities {', '.join(drawn)}, which attach a body to a mocap body: not supported"
    yield from tendons.tendon_doubts(m, tree)
    yield from _nonlinear(m, tree)
    yield from _free_joint(m)
    yield from _ball_joints(m, tree)
    yield from _switched_off(m)
    uneven = [tree.joint_names[j] for j in range(m.njnt) if m.jnt_actfrclimited[j] and m.jnt_actfrcrange[j].sum()]
    if uneven:
        yield f"took the larger end of actuatorfrcrange of joints {quoted(uneven)} either way: effort has one number"
    yield from _gravity_compensation(m, tree)
    yield from _contacts(m, tree)
    asleep = [tree.bodies[_first(m, k)] for k in _asleep(m)]
    if asleep:
        yield f"ignored that bodies {quoted(asleep)} sleep at the start (sleep='init'): they move at once"


def _asleep(m: Any) -> list[int]:
    """Return the trees that sleep until something touches them."""
    if not m.opt.enableflags & SLEEP:
        return []
    return np.flatnonzero(getattr(m, "tree_sleep_policy", np.zeros(0)) == SLEEP_AT_START).tolist()


def _first(m: Any, tree: int) -> int:
    """Return the body at which a tree of MuJoCo begins."""
    return int(m.tree_bodyadr[tree])


def _keyframes(m: Any) -> Iterator[str]:
    """Yield what keyframes state beside positions."""
    mocap = [b for b in range(m.nbody) if m.body_mocapid[b] >= 0]
    usual = {"mpos": m.body_pos[mocap].ravel(), "mquat": m.body_quat[mocap].ravel()}
    parts: dict[str, list[str]] = {}
    for k in range(m.nkey):
        stated = {what: getattr(m, f"key_{what}")[k] for what in ("qvel", "ctrl", "act", "mpos", "mquat")}
        found = [what for what, x in stated.items() if x.size and np.any(x != usual.get(what, 0.0))]
        parts.setdefault(", ".join(found), []).append(m.key(k).name or f"key{k}")
    for what, names in parts.items():
        if what:
            yield f"took positions alone of keyframes {quoted(names)}, without their {what}"


def _contacts(m: Any, tree: Tree) -> Iterator[str]:
    """Yield what of contacts is unknown here, whatever touches."""
    names = names_of(m, "geom", m.ngeom)
    sticky = np.flatnonzero(getattr(m, "geom_adhesion", np.zeros(m.ngeom)))
    pairs = np.flatnonzero(getattr(m, "pair_adhesion", np.zeros(m.npair)))
    found = {int(g) for k in pairs for g in (m.pair_geom1[k], m.pair_geom2[k])} | {int(g) for g in sticky}
    if found:
        yield f"ignored the adhesion of geoms {quoted(names[g] for g in sorted(found))}: contacts do not pull"


def _slack_joints(m: Any, tree: Tree) -> Iterator[str]:
    """Yield what joints state of how their limits and friction give way."""
    found = []
    for j in range(m.njnt):
        dof = int(m.jnt_dofadr[j])
        stated = ((m.jnt_solref[j], m.jnt_solimp[j], m.jnt_limited[j]), (m.dof_solref[dof], m.dof_solimp[dof], True))
        soft = any(acts and [*ref, *imp] != [*SOLREF, *SOLIMP] for ref, imp, acts in stated)
        found += [tree.joint_names[j]] if soft or (m.jnt_limited[j] and m.jnt_margin[j]) else []
    if found:
        yield f"took limits and friction of joints {quoted(found)}, and not how they give way (margin, solref, solimp)"


def _nonlinear(m: Any, tree: Tree) -> Iterator[str]:
    """Yield what joints have besides linear springs and dampers, since MuJoCo 4."""
    own = range(m.njnt)
    parts = {
        "nonlinear stiffness": [
            j
            for j in own
            if np.any(getattr(m, "jnt_stiffnesspoly", np.zeros(m.njnt))[j])
            and (not any(stiffness_powers(m, j)) or m.jnt_type[j] in (BALL, FREE))
        ],
        "plastic yield of the springs": [j for j in own if getattr(m, "jnt_springyield", np.zeros(m.njnt))[j]],
        "nonlinear damping": [
            j
            for j in own
            if np.any(getattr(m, "dof_dampingpoly", np.zeros(m.nv))[m.jnt_dofadr[j]])
            and (not any(damping_powers(m, j)) or m.jnt_type[j] == FREE)
        ],
    }
    for what, joints in parts.items():
        if joints and not (what != "nonlinear damping" and m.opt.disableflags & NO_SPRINGS):
            names = quoted([tree.joint_names[j] for j in joints])
            yield f"ignored the {what} of joints {names}: dampers may not weaken anywhere, nor springs give way"


def _ball_joints(m: Any, tree: Tree) -> Iterator[str]:
    """Yield what ball joints have that is left out."""
    own = [j for j in range(m.njnt) if m.jnt_type[j] == BALL and tree.holds(m, int(m.jnt_bodyid[j]))]
    parts = {
        "limits of 0 and of half a turn": [
            j
            for j in own
            if m.jnt_limited[j]
            and not 0.0 < m.jnt_range[j, 1] < math.pi
            and not m.opt.disableflags & (NO_LIMITS | NO_CONSTRAINTS)
        ],
        "references of springs": [
            j
            for j in own
            if m.jnt_stiffness[j]
            and not m.opt.disableflags & NO_SPRINGS
            and abs(m.qpos_spring[m.jnt_qposadr[j]]) != 1.0
        ],
    }
    for what, joints in parts.items():
        if joints:
            yield f"ignored the {what} of ball joints {quoted([tree.joint_names[j] for j in joints])}: not supported"


def _switched_off(m: Any) -> Iterator[str]:
    """Yield parts of the joints that a <flag> switches off."""
    parts = {
        "dampers": (NO_DAMPERS, m.dof_damping),
        "limits of joints": (NO_LIMITS | NO_CONSTRAINTS, m.jnt_limited),
        "friction of joints": (NO_FRICTION | NO_CONSTRAINTS, m.dof_frictionloss),
    }
    for what, (bits, values) in parts.items():
        if m.opt.disableflags & bits and np.any(values):
            yield f"ignored the <flag> that switches off {what}: they stay active"


def _gravity_compensation(m: Any, tree: Tree) -> Iterator[str]:
    if np.any(m.body_gravcomp) and m.jnt_actgravcomp.any() and any(gravity_of(m)):
        held = [tree.bodies[b] for b in np.flatnonzero(m.body_gravcomp)]
        yield f"ignored gravcomp of bodies {quoted(held)}, which actuators take over (actuatorgravcomp): not supported"


def gravity_of(m: Any) -> tuple[float, float, float]:
    """Return the file's gravity [m/s^2]: none if a <flag> switches it off."""
    return (0.0, 0.0, 0.0) if m.opt.disableflags & NO_GRAVITY else vector(m.opt.gravity)


def other_gravity(m: Any) -> Iterator[str]:
    """Yield the file's gravity if it is not that of a scene, for a Model has none."""
    if m.opt.disableflags & NO_GRAVITY:
        yield "a <flag> switches off gravity in the file: give gravity=(0, 0, 0) to compile_scene"
    elif gravity_of(m) != GRAVITY:
        yield f"gravity of the file is {gravity_of(m)} m/s^2: give it to compile_scene"


def _free_joint(m: Any) -> Iterator[str]:
    for j in np.flatnonzero(m.jnt_type == FREE):
        dofs = slice(m.jnt_dofadr[j], m.jnt_dofadr[j] + 6)
        stated = [w for w in ("armature", "damping", "frictionloss") if np.any(getattr(m, f"dof_{w}")[dofs])]
        if m.jnt_stiffness[j] and not m.opt.disableflags & NO_SPRINGS:
            stated.append("stiffness")
        if stated:
            yield f"ignored {', '.join(stated)} of the free joint: not supported for a floating base"


def notes(m: Any, tree: Tree) -> Iterator[str]:
    """Yield what does not affect the simulation."""
    if tree.root and m.body_geomnum[0]:
        yield f"ignored {m.body_geomnum[0]} geoms of the world: ground is an argument of compile_scene"
    fixed = [b for b in range(1, m.nbody) if not tree.holds(m, b) and m.body_rootid[b] not in tree.left]
    if fixed:
        yield f"ignored bodies {quoted([tree.bodies[b] for b in fixed])}, which are fixed to the world"
    yield from tendons.tendon_notes(m, tree)
    yield from sensor_notes(m)
    yield from _keyframes(m)
    for count, what in ((m.nsite, "sites"), (m.ncam, "cameras"), (m.nlight, "lights")):
        if count:
            yield f"skipped {count} {what}"
    if equalities.couplings(m):
        yield "took the equalities of joints as exact; MuJoCo's give way"
    yield from loops.loop_notes(m, tree)
    yield from _slack_joints(m, tree)
    if m.opt.disableflags & NO_CONTACTS and not tree.several:
        yield "a <flag> switches contacts off in the file: ground is an argument of compile_scene"
    held = equalities.held_joints(m)
    if held:
        yield f"held joints {quoted([tree.joint_names[j] for j in held])} where equalities put them"
    off = m.neq - len(equalities.active(m))
    if off:
        yield f"skipped {off} equalities that are not active"
