"""Read and write tendons: springs, dampers and limits along sums of joint positions, or along paths between sites."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ...base.flaws import quoted
from ...model import Controller, Model, Tendon, Via
from ..markup import element
from .actuators import TENDON as TENDON_TRANSMISSION
from .actuators import turned
from .equalities import NO_CONSTRAINTS, Tie, ties, title
from .loops import SITE_WRAP, at_site, placed
from .tree import NO_DAMPERS, NO_LIMITS, NO_SPRINGS, NO_STOP, Tree, actuator_count, unused

JOINT_WRAP, PULLEY_WRAP = 1, 2  # mjtWrap
LEFT = ("frictionloss", "armature")  # what tendons have that has no like here


def taken(m: Any, tree: Tree) -> set[int]:
    """Return the tendons of a tree that are not left out."""
    return {t for t in range(m.ntendon) if why_not(m, tree, t) is None and _own(m, tree, t)}


def acts(m: Any, t: int) -> bool:
    """Return whether a tendon has a spring, a damper or a limit that no <flag> switches off."""
    K, C, limited = _numbers(m, t)
    return bool(K or C or limited)


def _numbers(m: Any, t: int) -> tuple[float, float, bool]:
    """Return stiffness, damping and whether limits act."""
    off = m.opt.disableflags
    K = 0.0 if off & NO_SPRINGS else float(m.tendon_stiffness[t])
    C = 0.0 if off & NO_DAMPERS else float(m.tendon_damping[t])
    return K, C, bool(m.tendon_limited[t]) and not off & (NO_LIMITS | NO_CONSTRAINTS)


def read_tendons(m: Any, tree: Tree, drives: Mapping[int, Controller], top: int = 0) -> tuple[Tendon, ...]:
    """Read the tendons of a tree that act or are driven, and equalities of three joints or more as tendons.

    drives: by tendon; top: body whose place counts as that of a fixed root.
    """
    found, names, used = [], tendon_names(m), driven(m)
    for t in sorted(taken(m, tree)):
        if acts(m, t) or t in used:
            found.append(replace(_tendon(m, tree, t, names[t], top), controller=drives.get(t)))
    for k, tie in _own_ties(m, tree).items():
        joints = tuple((tree.joint_names[j], c) for j, c in tie.terms.items())
        name = unused(m.equality(k).name or f"equality{k}", [*names, *(one.name for one in found)])
        found.append(Tendon(name, joints, (), tie.stiffness, tie.damping, tie.rest))
    return tuple(found)


def driven(m: Any) -> set[int]:
    """Return the tendons with an actuator that is not on one joint alone."""
    on_tendons = (k for k in range(actuator_count(m)) if m.actuator_trntype[k] == TENDON_TRANSMISSION)
    return {int(m.actuator_trnid[k, 0]) for k in on_tendons if turned(m, k)[0] < 0}


def _own_ties(m: Any, tree: Tree) -> dict[int, Tie]:
    return {k: tie for k, tie in ties(m).items() if all(tree.holds(m, int(m.jnt_bodyid[j])) for j in tie.terms)}


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
    return [b for b in found if m.body_weldid[b]]


def _own(m: Any, tree: Tree, t: int) -> bool:
    return any(tree.holds(m, b) for b in bodies_of(m, t))


def why_not(m: Any, tree: Tree, t: int) -> str | None:
    """Return why a tendon is left out, None if it is not."""
    if any(m.wrap_type[w] not in (JOINT_WRAP, PULLEY_WRAP, SITE_WRAP) for w in _wraps(m, t)):
        return "which wrap around geoms"
    if all(m.wrap_type[w] == JOINT_WRAP and m.wrap_prm[w] == 0 for w in _wraps(m, t)):
        return "whose coefficients are all 0"
    if not all(tree.holds(m, b) for b in bodies_of(m, t)):
        return "which tie the robot to another one"
    sites = [int(m.wrap_objid[w]) for w in _wraps(m, t) if m.wrap_type[w] == SITE_WRAP]
    if any(placed(m, tree, at_site(m, s), 0)[0] is None for s in sites):
        return "which tie a floating base to the world"
    return None


def _tendon(m: Any, tree: Tree, t: int, name: str, top: int) -> Tendon:
    (K, C, limited), joints, path, share = _numbers(m, t), [], list[Via](), 0.0
    for w in _wraps(m, t):
        k = int(m.wrap_objid[w])
        if m.wrap_type[w] == JOINT_WRAP and m.wrap_prm[w]:
            joints.append((tree.joint_names[k], float(m.wrap_prm[w])))
        elif m.wrap_type[w] == SITE_WRAP:
            link, _, point = placed(m, tree, at_site(m, k), top)
            assert link is not None  # else it is left out
            path.append(Via(link, point, share if path else 1.0))
            share = _share(m, t, w)
        elif m.wrap_type[w] == PULLEY_WRAP:
            share = 0.0
    lower, upper = (float(x) for x in m.tendon_range[t]) if limited else (-math.inf, math.inf)
    rest = tuple(float(x) for x in m.tendon_lengthspring[t]) if K else (0.0, 0.0)
    return Tendon(name, tuple(joints), tuple(path), K, C, rest, lower, upper)  # type: ignore[arg-type]


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
        yield f"ignored springs, dampers and limits of tendons {quoted(which)}, {why}: not supported"
    for what in LEFT:
        which = [names[t] for t in own if getattr(m, f"tendon_{what}")[t]]
        if which:
            yield f"ignored the {what} of tendons {quoted(which)}: not supported"
    for what, field in (("stiffness", "tendon_stiffnesspoly"), ("damping", "tendon_dampingpoly")):
        which = [names[t] for t in own if np.any(getattr(m, field, np.zeros(m.ntendon))[t])]
        if which:
            yield f"ignored the nonlinear {what} of tendons {quoted(which)}: not supported"
    which = [names[t] for t in own if getattr(m, "tendon_springyield", np.zeros(m.ntendon))[t]]
    if which:
        yield f"ignored the plastic yield of the springs of tendons {quoted(which)}: not supported"


def tendon_notes(m: Any, tree: Tree) -> Iterator[str]:
    """Yield what of tendons does not affect the simulation, and how limits differ from MuJoCo's."""
    own = [t for t in range(m.ntendon) if _own(m, tree, t)]
    idle, names = [t for t in own if not acts(m, t) and t not in driven(m)], tendon_names(m)
    if idle:
        yield f"skipped {len(idle)} tendons without spring, damper, limit and actuator"
    soft = [title(m, k) for k in _own_ties(m, tree)]
    if soft:
        which = ", ".join(soft)
        yield f"took equalities {which} of three joints or more as tendons with a spring and damper as of solref"
    limited = [names[t] for t in own if _numbers(m, t)[2] and why_not(m, tree, t) is None]
    if limited:
        yield f"took limits of tendons {quoted(limited)} as stops like those of joints (solref and solimp play no part)"


# ---------------------------------------------------------------------------------------------- writing


def tendon_site_lines(model: Model, link: str) -> list[str]:
    """Write the sites of tendons on a link."""
    found = []
    for tendon in model.tendons:
        for k, via in enumerate(tendon.path):
            if via.link == link:
                found += element("site", {"name": f"{tendon.name}_{k}", "pos": via.point})
    return found


def tendon_lines(model: Model) -> list[str]:
    """Write the tendons."""
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
        }
        inside += _path_lines(tendon)
        if inside:
            found += element("fixed" if tendon.joints else "spatial", attributes, inside)
    return found


def _rest(tendon: Tendon, offset: float) -> tuple[float, ...]:
    """Return the lengths at which the spring is slack; -1, which means another thing in MJCF, to the last bit."""
    return tuple(math.nextafter(x, 0.0) if x == -1.0 else x for x in (end - offset for end in tendon.slack))


def _path_lines(tendon: Tendon) -> list[str]:
    """Write the sites of a path; a pulley stands before each piece with another share than 1, or after a gap."""
    found: list[str] = []
    last = 1.0
    for k, via in enumerate(tendon.path):
        name = f"{tendon.name}_{k}"
        if k and via.share and via.share != last:
            found += element("pulley", {"divisor": 1.0 / via.share})
            found += element("site", {"site": f"{tendon.name}_{k - 1}"})
        if not (k and via.share) and k + 1 < len(tendon.path):  # a new piece, of the share that follows
            last = tendon.path[k + 1].share
            if k or last != 1.0:
                found += element("pulley", {"divisor": 1.0 / last}) if last else []
        elif via.share:
            last = via.share
        found += element("site", {"site": name})
    return found
