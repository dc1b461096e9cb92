"""Read and write tendons: springs, dampers and limits along sums of joint positions, or along paths between sites."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ...base.flaws import quoted
from ...base.rotation import rotation_from_quaternion, rotation_from_rpy
from ...model import Controller, Model, Tendon, Via, Wrap
from ..markup import element
from .actuators import TENDON as TENDON_TRANSMISSION
from .actuators import turned
from .equalities import NO_CONSTRAINTS, Tie, joints_of, ties, title
from .loops import SITE_WRAP, End, at_site, placed
from .tree import NO_DAMPERS, NO_FRICTION, NO_LIMITS, NO_SPRINGS, NO_STOP, Tree, actuator_count, unused, vector

JOINT_WRAP, PULLEY_WRAP, SPHERE_WRAP, CYLINDER_WRAP = 1, 2, 4, 5  # mjtWrap
AROUND = {SPHERE_WRAP: "sphere", CYLINDER_WRAP: "cylinder"}


def taken(m: Any, tree: Tree) -> dict[int, bool]:
    """Return the tendons of a tree, and whether they are taken or left out."""
    return {t: why_not(m, tree, t) is None for t in range(m.ntendon) if _own(m, tree, t)}


def acts(m: Any, t: int) -> bool:
    """Return whether a tendon has anything along it that no <flag> switches off."""
    return any((*_numbers(m, t), *_dry_and_heavy(m, t)))


def _numbers(m: Any, t: int) -> tuple[float, float, bool]:
    """Return stiffness, damping and whether limits act."""
    off = m.opt.disableflags
    K = 0.0 if off & NO_SPRINGS else float(m.tendon_stiffness[t])
    C = 0.0 if off & NO_DAMPERS else float(m.tendon_damping[t]) + _beside(m, t, "damping")
    return K, C, bool(m.tendon_limited[t]) and not off & (NO_LIMITS | NO_CONSTRAINTS)


def _dry_and_heavy(m: Any, t: int) -> tuple[float, float]:
    """Return friction and inertia."""
    friction = 0.0 if m.opt.disableflags & (NO_FRICTION | NO_CONSTRAINTS) else float(m.tendon_frictionloss[t])
    return friction, float(m.tendon_armature[t]) + (0.0 if _bends(m, t) else _beside(m, t, "armature"))


def _beside(m: Any, t: int, what: str) -> float:
    """Return what actuators of a tendon add to its armature or damping."""
    numbers = getattr(m, f"actuator_{what}", None)
    own = (k for k in range(actuator_count(m)) if m.actuator_trntype[k] == TENDON_TRANSMISSION)
    on = [k for k in own if m.actuator_trnid[k, 0] == t and turned(m, k)[0] < 0]
    return 0.0 if numbers is None else sum(float(m.actuator_gear[k, 0] ** 2 * numbers[k]) for k in on)


def _bends(m: Any, t: int) -> bool:
    return any(m.wrap_type[w] in AROUND for w in _wraps(m, t))


def read_tendons(
    m: Any, tree: Tree, drives: Mapping[int, Controller], top: int = 0, prefix: str = ""
) -> tuple[Tendon, ...]:
    """Read the tendons of a tree that act or are driven, and equalities of three joints or more as tendons.

    drives: by tendon; top: body whose place counts as that of a fixed root; prefix: of names, which they lose.
    """
    found, names, used = [], [name.removeprefix(prefix) for name in tendon_names(m)], driven(m)
    for t, whole in taken(m, tree).items():
        if whole and (acts(m, t) or t in used):
            found.append(replace(_tendon(m, tree, t, names[t], top), controller=drives.get(t)))
    for k, tie in _own_ties(m, tree).items():
        joints = tuple((tree.joint_names[j], c) for j, c in tie.terms.items())
        own = m.equality(k).name.removeprefix(prefix) or f"equality{k}"
        name = unused(own, [*names, *(one.name for one in found)])
        found.append(Tendon(name, joints, (), tie.stiffness, tie.damping, tie.rest))
    return tuple(found)


def driven(m: Any) -> set[int]:
    """Return the tendons with an actuator that is not on one joint alone."""
    on_tendons = (k for k in range(actuator_count(m)) if m.actuator_trntype[k] == TENDON_TRANSMISSION)
    return {int(m.actuator_trnid[k, 0]) for k in on_tendons if turned(m, k)[0] < 0}


def _own_ties(m: Any, tree: Tree) -> dict[int, Tie]:
    return {k: tie for k, tie in ties(m).items() if tree.joins(m, m.jnt_bodyid[[*tie.terms]])}


def tendon_names(m: Any) -> list[str]:
    """Return unique names of the tendons."""
    given = [m.tendon(t).name for t in range(m.ntendon)]
    return [name or unused(f"tendon{t}", given) for t, name in enumerate(given)]


def _wraps(m: Any, t: int) -> range:
    return range(m.tendon_adr[t], m.tendon_adr[t] + m.tendon_num[t])


def bodies_of(m: Any, t: int) -> list[int]:
    """Return the bodies that move and that a tendon acts on."""
    found = []
    for w in _wraps(m, t):
        k = int(m.wrap_objid[w])
        if m.wrap_type[w] == JOINT_WRAP:
            found.append(int(m.jnt_bodyid[k]))
        elif m.wrap_type[w] == SITE_WRAP:
            found.append(int(m.site_bodyid[k]))
        elif m.wrap_type[w] in AROUND:
            found.append(int(m.geom_bodyid[k]))
    return [b for b in found if m.body_weldid[b]]


def _own(m: Any, tree: Tree, t: int) -> bool:
    return any(tree.holds(m, b) for b in bodies_of(m, t))


def why_not(m: Any, tree: Tree, t: int) -> str | None:
    """Return why a tendon is left out, None if it is not."""
    around = [w for w in _wraps(m, t) if m.wrap_type[w] in AROUND]
    sides = [(int(m.geom_bodyid[m.wrap_objid[w]]), _side(m, w)) for w in around]
    if any(side is not None and m.site_bodyid[side] != body for body, side in sides):
        return "which wrap around geoms with a sidesite on another body"
    if all(m.wrap_type[w] == JOINT_WRAP and m.wrap_prm[w] == 0 for w in _wraps(m, t)):
        return "whose coefficients are all 0"
    if not tree.joins(m, bodies_of(m, t)):
        return "which tie one robot to another"
    return None


def _side(m: Any, w: int) -> int | None:
    """Return the site on whose side a tendon runs around a geom."""
    return int(m.wrap_prm[w]) if m.wrap_prm[w] >= 0 else None


def _at_geom(m: Any, g: int) -> End:
    return End(int(m.geom_bodyid[g]), rotation_from_quaternion(m.geom_quat[g]), m.geom_pos[g])


def _wrap(m: Any, tree: Tree, w: int, top: int) -> Wrap:
    g, side = int(m.wrap_objid[w]), _side(m, w)
    link, rpy, point = placed(m, tree, _at_geom(m, g), top)
    shape = AROUND[int(m.wrap_type[w])]
    axis = vector(rotation_from_rpy(rpy)[:, 2]) if shape == "cylinder" else (0.0, 0.0, 1.0)
    at = None if side is None else placed(m, tree, at_site(m, side), top)[2]
    return Wrap(link, shape, float(m.geom_size[g, 0]), point, axis, at)  # type: ignore[arg-type]


def _tendon(m: Any, tree: Tree, t: int, name: str, top: int) -> Tendon:
    (K, C, limited), joints, path, share = _numbers(m, t), [], list[Via | Wrap](), 0.0
    for w in _wraps(m, t):
        k = int(m.wrap_objid[w])
        if m.wrap_type[w] == JOINT_WRAP and m.wrap_prm[w]:
            joints.append((tree.joint_names[k], float(m.wrap_prm[w])))
        elif m.wrap_type[w] == SITE_WRAP:
            link, _, point = placed(m, tree, at_site(m, k), top)
            path.append(Via(link, point, share if path else 1.0))
            share = _share(m, t, w)
        elif m.wrap_type[w] in AROUND:
            path.append(_wrap(m, tree, w, top))
        elif m.wrap_type[w] == PULLEY_WRAP:
            share = 0.0
    lower, upper = (float(x) for x in m.tendon_range[t]) if limited else (-math.inf, math.inf)
    rest = tuple(float(x) for x in m.tendon_lengthspring[t]) if K else (0.0, 0.0)
    friction, armature = _dry_and_heavy(m, t)
    return Tendon(name, tuple(joints), tuple(path), K, C, rest, lower, upper, None, friction, armature)  # type: ignore[arg-type]


def _share(m: Any, t: int, w: int) -> float:
    """Return the share of distances after an element of a path: one over the divisor of the pulley before it."""
    pulleys = [v for v in _wraps(m, t) if v <= w and m.wrap_type[v] == PULLEY_WRAP]
    return 1.0 / float(m.wrap_prm[pulleys[-1]]) if pulleys else 1.0


def tendon_doubts(m: Any, tree: Tree) -> Iterator[str]:
    """Yield one sentence for each effect of a tree's tendons that is ignored."""
    names, own = tendon_names(m), [t for t in range(m.ntendon) if _own(m, tree, t)]
    left: dict[str, list[str]] = {}
    for t in own:
        why = why_not(m, tree, t)
        if why is not None and acts(m, t):
            left.setdefault(why, []).append(names[t])
    for why, which in left.items():
        yield f"ignored springs, dampers, friction, inertia and limits of tendons {quoted(which)}, {why}: not supported"
    apart = [title(m, k) for k in ties(m).keys() - _own_ties(m, tree).keys()]
    if tree.several and apart:
        yield f"ignored equalities {', '.join(apart)} of three joints or more, of several robots: not supported"
    for what, field in (("stiffness", "tendon_stiffnesspoly"), ("damping", "tendon_dampingpoly")):
        which = [names[t] for t in own if np.any(getattr(m, field, np.zeros(m.ntendon))[t])]
        if which:
            yield f"ignored the nonlinear {what} of tendons {quoted(which)}: not supported"
    which = [names[t] for t in own if _bends(m, t) and _beside(m, t, "armature")]
    if which:
        yield f"ignored the armature of actuators on tendons {quoted(which)}, which run around shapes: not supported"
    limited = {tree.joint_names[j] for t in own if t in driven(m) for j in _moved(m, t) if m.jnt_actfrclimited[j]}
    if limited:
        yield f"ignored actuatorfrcrange of joints {quoted(sorted(limited))} for drives of tendons: limit the tendons"
    which = [names[t] for t in own if getattr(m, "tendon_springyield", np.zeros(m.ntendon))[t]]
    if which:
        yield f"ignored the plastic yield of the springs of tendons {quoted(which)}: not supported"


def _moved(m: Any, t: int) -> set[int]:
    """Return the joints that a fixed tendon turns, or those that carry what a spatial one runs along."""
    if joints := joints_of(m, t):
        return {*joints}
    carriers: set[int] = set()
    for b in bodies_of(m, t):
        while b:
            carriers.add(b)
            b = int(m.body_parentid[b])
    return {j for j in range(m.njnt) if int(m.jnt_bodyid[j]) in carriers}


def tendon_notes(m: Any, tree: Tree) -> Iterator[str]:
    """Yield what of tendons does not affect the simulation, and how limits differ from MuJoCo's."""
    own = [t for t in range(m.ntendon) if _own(m, tree, t)]
    idle, names = [t for t in own if not acts(m, t) and t not in driven(m)], tendon_names(m)
    if idle:
        yield f"skipped {len(idle)} tendons on which nothing acts"
    soft = [title(m, k) for k in _own_ties(m, tree)]
    if soft:
        which = ", ".join(soft)
        yield f"took equalities {which} of three joints or more as tendons with a spring and damper as of solref"
    limited = [names[t] for t in own if _numbers(m, t)[2] and why_not(m, tree, t) is None]
    if limited:
        yield f"took limits of tendons {quoted(limited)} as stops like those of joints (solref and solimp play no part)"


# ---------------------------------------------------------------------------------------------- writing


def tendon_site_lines(model: Model, link: str | None) -> list[str]:
    """Write the sites of tendons on a link, or in the world."""
    found = []
    for tendon in model.tendons:
        for k, via in enumerate(tendon.path):
            if via.link == link and isinstance(via, Wrap):
                found += _wrap_lines(f"{tendon.name}_{k}", via)
            elif via.link == link:
                found += element("site", {"name": f"{tendon.name}_{k}", "pos": via.point})
    return found


def _wrap_lines(name: str, wrap: Wrap) -> list[str]:
    """Write the geom around which a tendon runs, which touches nothing, and the site of its side."""
    geom = {
        "name": name,
        "type": wrap.shape,
        "size": (wrap.radius, wrap.radius) if wrap.shape == "cylinder" else wrap.radius,
        "pos": wrap.point,
        "zaxis": wrap.axis if wrap.shape == "cylinder" else None,
        "mass": "0",
        "contype": "0",
        "conaffinity": "0",
    }
    side = [] if wrap.side is None else element("site", {"name": f"{name}_side", "pos": wrap.side})
    return [*element("geom", geom), *side]


def wound(model: Model, tendon: Tendon) -> bool:
    """Return whether the length of a tendon has joints and a path, which MJCF does not state."""
    return bool(tendon.path) and any(name not in model.held for name, _ in tendon.joints)


def tendon_lines(model: Model) -> list[str]:
    """Write the tendons, but those that are wound up."""
    found: list[str] = []
    rods = [loop.name for loop in model.loops if loop.kind == "distance"]
    for tendon in model.tendons:
        moving = [(name, c) for name, c in tendon.joints if name not in model.held]
        inside = [line for name, c in moving for line in element("joint", {"joint": name, "coef": c})]
        offset = sum(c * model.held[name] for name, c in tendon.joints if name in model.held)
        lower, upper = max(tendon.lower - offset, -NO_STOP), min(tendon.upper - offset, NO_STOP)
        attributes = {
            "name": unused(tendon.name, rods),
            "stiffness": tendon.stiffness or None,
            "springlength": _rest(tendon, offset) if tendon.stiffness else None,
            "damping": tendon.damping or None,
            "range": (lower, upper) if tendon.limited else None,
            "frictionloss": tendon.friction or None,
            "armature": tendon.armature or None,
        }
        inside += _path_lines(tendon)
        if inside and not wound(model, tendon):
            found += element("spatial" if tendon.path else "fixed", attributes, inside)
    return found


def _rest(tendon: Tendon, offset: float) -> tuple[float, ...]:
    """Return the lengths at which the spring is slack; -1, which means another thing in MJCF, to the last bit."""
    return tuple(math.nextafter(x, 0.0) if x == -1.0 else x for x in (end - offset for end in tendon.slack))


def _path_lines(tendon: Tendon) -> list[str]:
    """Write the sites of a path; a pulley stands before each piece with another share than 1, or after a gap."""
    found: list[str] = []
    path, last = tendon.path, 1.0
    for k, via in enumerate(path):
        if isinstance(via, Wrap):
            continue
        bend = path[k - 1] if k else None
        if not (k and via.share):  # a new piece, of the share that follows
            following = next((one.share for one in path[k + 1 : k + 3] if isinstance(one, Via)), last)
            if k or following != 1.0:
                found += element("pulley", {"divisor": 1.0 / following}) if following and k + 1 < len(path) else []
            last = following
        else:
            if via.share != last:
                before = k - 2 if isinstance(bend, Wrap) else k - 1
                found += element("pulley", {"divisor": 1.0 / via.share})
                found += element("site", {"site": f"{tendon.name}_{before}"})
            last = via.share
            if isinstance(bend, Wrap):
                side = None if bend.side is None else f"{tendon.name}_{k - 1}_side"
                found += element("geom", {"geom": f"{tendon.name}_{k - 1}", "sidesite": side})
        found += element("site", {"site": f"{tendon.name}_{k}"})
    return found
