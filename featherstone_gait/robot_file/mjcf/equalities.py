"""Read the equalities of joints of a compiled MJCF file: linear ones, which become couplings.

An equality of joints or of fixed tendons, whose lengths are sums c q of joints, says sum c (q - q0) = a, q0 of the
posture in which the file is compiled.  Over two joints it is a coupling, over one it holds the joint.
`loops.py` reads those that close loops.
"""

from __future__ import annotations

from collections.abc import Container, Iterator
from typing import Any, NamedTuple

CONNECT, WELD, JOINT, TENDON = range(4)  # mjtEq
KINDS = ("connect", "weld", "joint", "tendon", "flex", "flexvert", "flexstrain")
SITE, WRAPPED_JOINT = 6, 1  # mjtObj, mjtWrap
NO_CONSTRAINTS, NO_EQUALITIES = 1 << 0, 1 << 1  # mjtDisableBit, of <flag>


class Line(NamedTuple):
    """An equality of joints: y - y0 = a + b (x - x0)."""

    follower: int
    leader: int  # -1: none, y is held at y0 + a
    b: float
    offset: float  # of y = b x + offset [rad or m]


def joints_of(m: Any, t: int) -> dict[int, float]:
    """Return the c of a fixed tendon by joint; none for a spatial one."""
    parts = range(m.tendon_adr[t], m.tendon_adr[t] + m.tendon_num[t])
    if any(m.wrap_type[w] != WRAPPED_JOINT for w in parts):
        return {}
    return {int(m.wrap_objid[w]): float(m.wrap_prm[w]) for w in parts}


def active(m: Any) -> list[int]:
    """Return the active equalities."""
    if m.opt.disableflags & (NO_CONSTRAINTS | NO_EQUALITIES):
        return []
    return [k for k in range(m.neq) if m.eq_active0[k]]


def lines(m: Any) -> dict[int, Line]:
    """Return the linear equalities, by their number.

    Of two joints of tendons the later one in the file follows, or the other if that one follows already.
    """
    found: dict[int, Line] = {}
    for k in sorted(active(m), key=lambda k: m.eq_type[k] != JOINT):
        terms, a = _terms(m, k)
        if 1 <= len(terms) <= 2:
            led = {line.follower for line in found.values()}
            order = list(terms) if m.eq_type[k] == JOINT else sorted(terms, key=lambda j: (j in led, -j))
            found[k] = _line(m, terms, order, a)
    return found


def _terms(m: Any, k: int) -> tuple[dict[int, float], float]:
    """Return the c by joint, and a; no joints if the equality is no such sum."""
    one, two, data = int(m.eq_obj1id[k]), int(m.eq_obj2id[k]), m.eq_data[k]
    if m.eq_type[k] not in (JOINT, TENDON) or (two >= 0 and data[2:5].any()):
        return {}, 0.0
    a, b = float(data[0]), float(data[1])
    if m.eq_type[k] == JOINT:
        return {one: 1.0} if two < 0 else {one: 1.0, two: -b}, a
    sums = [joints_of(m, t) for t in (one, two) if t >= 0]
    if not all(sums):  # a spatial tendon's length is no sum
        return {}, 0.0
    terms = dict(sums[0])
    for j, c in sums[1].items() if two >= 0 else ():
        terms[j] = terms.get(j, 0.0) - b * c
    return {j: c for j, c in terms.items() if c}, a


class Tie(NamedTuple):
    """An equality of three joints or more: the sum of c q is at rest at a length, held by a spring and a damper."""

    terms: dict[int, float]  # c by joint
    rest: float
    stiffness: float
    damping: float


def ties(m: Any) -> dict[int, Tie]:
    """Return the linear equalities of three joints or more, by their number, as soft as the file has them.

    With the time constant T and the damping ratio d of `solref`, of a mass 1/w that moves along the sum, MuJoCo's force
    is that of a spring 1/(w T^2 d^2) and a damper 2/(w T); negative numbers are stiffness and damping of a unit mass.
    """
    found = {}
    for k in active(m):
        terms, a = _terms(m, k)
        if len(terms) > 2:
            one, two = int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
            w = float(m.tendon_invweight0[one])
            w += float(m.eq_data[k][1] ** 2 * m.tendon_invweight0[two]) if two >= 0 else 0.0
            first, second = m.eq_solref[k].tolist()
            per_mass = (-first, -second) if first <= 0 else (1.0 / (first * first * second * second), 2.0 / first)
            rest = a + sum(c * _reference(m, j) for j, c in terms.items())
            found[k] = Tie(terms, rest, per_mass[0] / w, per_mass[1] / w)
    return found


def _line(m: Any, terms: dict[int, float], order: list[int], a: float) -> Line:
    y, *others = order
    at_rest = _reference(m, y) + a / terms[y]
    if not others:
        return Line(y, -1, 0.0, at_rest)
    (x,) = others
    b = -terms[x] / terms[y]
    return Line(y, x, b, at_rest - b * _reference(m, x))


def _reference(m: Any, j: int) -> float:
    return float(m.qpos0[m.jnt_qposadr[j]])


def couplings(m: Any) -> dict[int, Line]:
    """Return linear equalities between two joints, by follower."""
    return {line.follower: line for line in lines(m).values() if line.leader >= 0}


def held_joints(m: Any) -> dict[int, float]:
    """Return joints that an equality holds, and their positions [rad or m]."""
    return {line.follower: line.offset for line in lines(m).values() if line.leader < 0}


def refusals(m: Any, names: list[str], taken: list[bool], loops: Container[int]) -> Iterator[str]:
    """Yield why equalities can be neither couplings nor loops.

    names: of joints; taken: whether a body belongs to the robot; loops: equalities that close loops
    """
    found, soft = lines(m), ties(m)
    for k in active(m):
        if k in found or k in soft or k in loops or not any(taken[b] for b in _bodies(m, k)) or follows_mocap(m, k):
            continue
        if m.eq_type[k] == JOINT:
            yield (
                f"equality {title(m, k)} <joint> is not linear: polycoef is {m.eq_data[k, :5].tolist()}; only the "
                "first two numbers may differ from 0: change them, or set active='false'"
            )
        else:
            kind = int(m.eq_type[k])
            what = KINDS[kind] if kind < len(KINDS) else f"of kind {kind}"
            yield (
                f"equality {title(m, k)} <{what}> is not supported; of tendons those are that are fixed and "
                "linear, and those that run straight between two sites: remove it, or set active='false'"
            )
    led: dict[int, list[str]] = {}
    for k, line in found.items():
        led.setdefault(line.follower, []).append(title(m, k))
    for j, titles in led.items():
        if len(titles) > 1:
            yield (
                f"joint {names[j]!r} is led by equalities {', '.join(titles)}; it can follow one alone: remove the "
                "others, or set active='false'"
            )


def title(m: Any, k: int) -> str:
    """Name an equality for messages."""
    return repr(m.equality(k).name or k)


def _bodies(m: Any, k: int) -> list[int]:
    """Return the bodies that an equality connects."""
    objects = [int(x) for x in (m.eq_obj1id[k], m.eq_obj2id[k]) if x >= 0]
    if m.eq_type[k] in (CONNECT, WELD):
        return [int(m.site_bodyid[x]) if m.eq_objtype[k] == SITE else x for x in objects]
    if m.eq_type[k] == JOINT:
        return [int(m.jnt_bodyid[j]) for j in objects]
    return list(range(m.nbody))


def follows_mocap(m: Any, k: int) -> bool:
    """Return whether an equality attaches a body to a mocap body."""
    return m.eq_type[k] in (CONNECT, WELD) and any(m.body_mocapid[b] >= 0 for b in _bodies(m, k))
