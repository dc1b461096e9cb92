"""Read the links, joints and collision shapes of a compiled MJCF file."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ...base.fixed_order import applied, product
from ...base.rotation import rotation_about, rotation_from_quaternion, rpy_from_rotation
from ...model import Base, HeightField, Joint, Link, Mimic, Surface
from ...model.links import weakens
from ...model.rigid_bodies import inertia_tuple, turned_inertia
from ...model.shapes import Box, Capsule, Cylinder, Geometry, Hull, Shape, Sphere
from ..robot import MASSLESS
from .equalities import Line

WORLD = "world"
FLOOR = "floor"  # name of the geom that is the ground in what this package writes
PAIRS = "featherstone_gait_pairs"  # name of the <text> that says which bodies touch each other
FRICTIONS = "featherstone_gait_frictions"  # and of that with the friction of shapes that have no priority
FREE, BALL, SLIDE, HINGE = range(4)  # mjtJoint
PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH, SDF = range(9)  # mjtGeom
GEOMS = ("plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh", "sdf")
NO_STOP = 1e10  # a range this wide is none
NO_FRICTION, NO_LIMITS, NO_SPRINGS, NO_DAMPERS = 1 << 2, 1 << 3, 1 << 5, 1 << 6  # mjtDisableBit, of <flag>


class Tree(NamedTuple):
    """The kinematic tree of a file."""

    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    base: Base
    root: int  # body that is the root link, 0 for the world
    left: tuple[int, ...]  # bodies that move in the world and are left out, with all that they carry
    bodies: list[str]  # link name of each body
    joint_names: list[str]  # of each MuJoCo joint
    several: bool = False  # each body of the world begins a tree of its own, as in a scene
    top: int = 0  # of a tree of a scene whose root is the world, the body of the world that it begins with

    def holds(self, m: Any, b: int) -> bool:
        """Return whether a body is one of the links, or the world that carries them."""
        if self.root or self.top:
            return m.body_rootid[b] == (self.root or self.top) or (self.top > 0 and b == 0)
        return m.body_rootid[b] not in self.left

    def joins(self, m: Any, bodies: Iterable[int]) -> bool:
        """Return whether bodies are links of one tree, so that what acts between them can be simulated."""
        roots = {int(m.body_rootid[b]) for b in bodies}
        return all(self.holds(m, b) for b in roots) and not (self.several and len(roots) > 1)


def read_tree(m: Any, base: Base | None, mimics: dict[int, Line]) -> Tree:
    """Read links and joints.

    base: None is "floating" if the tree has a free joint; mimics: by follower.
    """
    bodies, names = names_of(m, "body", m.nbody), names_of(m, "joint", m.njnt)
    base, left = _chosen(m, base)
    return _read(m, Tree((), (), base, _root(m, base, left), left, bodies, names), mimics)


def tree_at(m: Any, top: int, bodies: list[str], names: list[str], mimics: dict[int, Line]) -> Tree:
    """Read the tree that begins at a body of the world, as it is in that body's frame.

    The root link is the body, or a link without mass in its place if the body moves by joints.  bodies, names: of
    bodies and joints; mimics: by follower.
    """
    base: Base = "floating" if top in _free(m) else "fixed"
    if base == "floating" or not m.body_jntnum[top]:
        return _read(m, Tree((), (), base, top, (), bodies, names), mimics)
    tree = Tree((), (), base, 0, (), [unused("base", bodies), *bodies[1:]], names, top=top)
    return _read(m, tree, mimics, top)


def top_bodies(m: Any) -> list[int]:
    """Return the bodies that hang on the world."""
    return [b for b in range(1, m.nbody) if m.body_parentid[b] == 0]


def _read(m: Any, tree: Tree, mimics: dict[int, Line], top: int = 0) -> Tree:
    """Read links and joints; top: a body whose place counts as that of the root."""
    root, bodies, names = tree.root, tree.bodies, tree.joint_names
    links = [_link(m, root, bodies[root])]
    joints: list[Joint] = []
    begins = root or tree.top
    for b in np.flatnonzero(m.body_rootid == begins).tolist() if begins else range(1, m.nbody):
        if b != root and tree.holds(m, b):
            place = (np.eye(3), np.zeros(3)) if b == top else (rotation_from_quaternion(m.body_quat[b]), m.body_pos[b])
            chain = _chain(m, b, place, bodies, names, [joint.name for joint in joints])
            links += [*(Link(joint.child, **MASSLESS) for joint in chain[:-1]), _link(m, b, bodies[b])]
            joints += chain
    follow = {names[j]: Mimic(names[line.leader], line.b, line.offset) for j, line in mimics.items()}
    joints = [replace(joint, mimic=follow[joint.name]) if joint.name in follow else joint for joint in joints]
    return tree._replace(links=tuple(links), joints=tuple(joints))


def moving_trees(m: Any) -> list[int]:
    """Return the bodies of the world at which moving trees begin."""
    return sorted({int(m.body_rootid[b]) for b in range(1, m.nbody) if m.body_dofnum[b]})


def _free(m: Any) -> list[int]:
    """Return the bodies with a free joint."""
    return [int(m.jnt_bodyid[j]) for j in range(m.njnt) if m.jnt_type[j] == FREE]


def _chosen(m: Any, base: Base | None) -> tuple[Base, tuple[int, ...]]:
    """Choose the base, and the trees that are left out.

    Trees that the world carries are branches of one, and so are free ones that are to be fixed.  Of these together and
    each floating one the tree with most joints is taken: links do not touch each other, so trees that nothing connects
    do not interact.
    """
    free, moving = _free(m), moving_trees(m)
    if not free or base == "fixed":
        return base or "fixed", ()
    carried = [b for b in moving if b not in free]
    choices = [[b] for b in free] if base else [carried, *([b] for b in free)]
    roots = m.body_rootid[m.jnt_bodyid][m.jnt_type != FREE].tolist()
    taken = max(choices, key=lambda trees: (sum(map(roots.count, trees)), trees != carried))
    return "fixed" if taken == carried else "floating", tuple(b for b in moving if b not in taken)


def _root(m: Any, base: Base, left: tuple[int, ...]) -> int:
    """Return the body that is the root link: that of the free joint, or the only body fixed to the world.

    A free body that is to be fixed elsewhere than at the world's frame stays where it is: 0, the world, is its root.
    """
    free = [b for b in _free(m) if b not in left]
    if len(free) == 1 and moving_trees(m) == sorted([*free, *left]):
        return free[0] if base == "floating" or _at_origin(m, free[0]) else 0
    top = [b for b in top_bodies(m) if b not in left]
    if len(top) != 1 or m.body_jntnum[top[0]]:
        return 0
    b = top[0]
    alone = all(m.geom_type[g] == PLANE for g in np.flatnonzero(m.geom_bodyid == 0))
    return b if base == "floating" or (_at_origin(m, b) and alone) else 0


def _at_origin(m: Any, b: int) -> bool:
    """Return whether a body of the world has the world's frame."""
    return not m.body_pos[b].any() and m.body_quat[b, 0] == 1.0


def _link(m: Any, b: int, name: str) -> Link:
    mass = float(m.body_mass[b])
    if b == 0 or mass == 0:
        return Link(name, **MASSLESS)
    A, B, C = m.body_inertia[b].tolist()
    I = turned_inertia(rotation_from_quaternion(m.body_iquat[b]), (A, 0.0, 0.0, B, 0.0, C))
    borne = float(m.body_gravcomp[b]) if bears_weight(m) else 0.0
    return Link(name, mass, vector(m.body_ipos[b]), inertia_tuple(I), borne)


def bears_weight(m: Any) -> bool:
    """Return whether gravcomp acts on the bodies: no <flag> switches it off, and no actuator takes it over."""
    off = NO_SPRINGS | NO_DAMPERS
    return m.opt.disableflags & off != off and not m.jnt_actgravcomp.any()


def _chain(
    m: Any, b: int, place: tuple[np.ndarray, np.ndarray], bodies: list[str], names: list[str], taken: list[str]
) -> list[Joint]:
    """Return the joints from a body's parent to the body, whose rotation and place there are given.

    MuJoCo moves a body by its joints one after the other, each about an anchor in the body.  Here each joint has a
    frame at its anchor, turned back by its reference, so that positions count as in the file.  A last fixed joint leads
    from the anchor to the body's own origin, if they differ.
    """
    parent, (E, r) = bodies[m.body_parentid[b]], place
    chain, anchor = [], np.zeros(3)
    own = range(m.body_jntadr[b], m.body_jntadr[b] + m.body_jntnum[b])
    moving = [j for j in own if m.jnt_type[j] != FREE]  # of a base that is to be fixed
    for j in moving:
        offset, E_back = _step(m, j, anchor)
        anchor = m.jnt_pos[j] if m.jnt_type[j] in (HINGE, BALL) else anchor
        last = j == moving[-1] and not anchor.any()
        child = bodies[b] if last else unused(f"{bodies[b]}_{names[j]}", bodies)
        chain.append(_joint(m, j, names[j], parent, child, r + applied(E, offset), product(E, E_back)))
        parent, E, r = child, np.eye(3), np.zeros(3)
    if not moving or anchor.any():
        name = unused(f"{bodies[b]}_fixed", [*names, *taken])
        chain.append(Joint(name, "fixed", parent, bodies[b], vector(r - anchor), rpy_from_rotation(E)))
    return chain


def _step(m: Any, j: int, anchor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return offset (3,) and rotation (3, 3) from the last anchor to a joint's frame at zero, in body axes."""
    reference = float(m.qpos0[m.jnt_qposadr[j]])
    if m.jnt_type[j] == BALL:
        return m.jnt_pos[j] - anchor, np.eye(3)
    if m.jnt_type[j] == SLIDE:
        return -reference * m.jnt_axis[j], np.eye(3)
    return m.jnt_pos[j] - anchor, rotation_about(m.jnt_axis[j], -reference) if reference else np.eye(3)


def _joint(m: Any, j: int, name: str, parent: str, child: str, r: np.ndarray, E: np.ndarray) -> Joint:
    dof, limited = m.jnt_dofadr[j], bool(m.jnt_limited[j])
    lower, upper = (float(x) if limited and abs(x) < NO_STOP else s * np.inf for x, s in zip(m.jnt_range[j], (-1, 1)))
    common: dict[str, Any] = {
        "effort": float(np.abs(m.jnt_actfrcrange[j]).max()) if m.jnt_actfrclimited[j] else np.inf,
        "damping": float(m.dof_damping[dof]),
        "friction": float(m.dof_frictionloss[dof]),
        "armature": float(m.dof_armature[dof]),
    }
    b, c = damping_powers(m, j)
    if b or c:
        common |= {"quadratic_damping": b, "cubic_damping": c}
    if m.jnt_type[j] == BALL:
        common["stiffness"] = 0.0 if m.opt.disableflags & NO_SPRINGS else float(m.jnt_stiffness[j])
        if limited and 0.0 < upper < math.pi:
            common["upper"] = upper
        return Joint(name, "ball", parent, child, vector(r), rpy_from_rotation(E), **common)
    return Joint(
        name,
        "prismatic" if m.jnt_type[j] == SLIDE else "revolute" if limited else "continuous",
        parent,
        child,
        vector(r),
        rpy_from_rotation(E),
        vector(m.jnt_axis[j]),
        lower=lower,
        upper=upper,
        **common,
        **_spring(m, j),
    )


def _spring(m: Any, j: int) -> dict[str, Any]:
    """Return stiffness and reference of a joint's spring; nothing if it has none, or a <flag> switches it off."""
    b, c = stiffness_powers(m, j)
    if m.opt.disableflags & NO_SPRINGS or not (m.jnt_stiffness[j] or c):
        return {}
    found = {"stiffness": float(m.jnt_stiffness[j]), "spring_reference": float(m.qpos_spring[m.jnt_qposadr[j]])}
    return found | ({"quadratic_stiffness": b, "cubic_stiffness": c} if c else {})


def damping_powers(m: Any, j: int) -> tuple[float, float]:
    """Return what the damper of a joint has beyond the first power; zeros where it would weaken somewhere."""
    if not hasattr(m, "dof_dampingpoly"):  # before MuJoCo 4
        return 0.0, 0.0
    b, c = m.dof_dampingpoly[m.jnt_dofadr[j]].tolist()
    return (0.0, 0.0) if weakens(float(m.dof_damping[m.jnt_dofadr[j]]), b, c) else (b, c)


def stiffness_powers(m: Any, j: int) -> tuple[float, float]:
    """Return what the spring of a joint has beyond the first power; zeros where it would give way somewhere."""
    if not hasattr(m, "jnt_stiffnesspoly"):  # before MuJoCo 4
        return 0.0, 0.0
    b, c = m.jnt_stiffnesspoly[j].tolist()
    return (b, c) if c > 0 and b * b <= 3.0 * m.jnt_stiffness[j] * c else (0.0, 0.0)


def vector(values: np.ndarray) -> tuple[float, float, float]:
    """Return three numbers as floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


# ---------------------------------------------------------------------------------------------- shapes


def read_shapes(m: Any, tree: Tree, friction: Mapping[int, float | None]) -> tuple[tuple[Shape, ...], list[str]]:
    """Read shapes of the geoms that touch the ground, with their friction, and what is ignored."""
    names = names_of(m, "geom", m.ngeom)
    shapes, left, silent = [], Counter[str](), 0
    for g in range(m.ngeom):
        if not tree.holds(m, int(m.geom_bodyid[g])):
            continue
        geometry = geometry_of(m, g)
        if g not in friction:
            silent += 1
        elif geometry is None:
            left[GEOMS[m.geom_type[g]]] += 1
        else:
            rpy = rpy_from_rotation(rotation_from_quaternion(m.geom_quat[g]))
            link, at = tree.bodies[m.geom_bodyid[g]], vector(m.geom_pos[g])
            surface = surface_of(m, g, names[g])
            shapes.append(Shape(link, geometry, at, rpy, names[g], friction[g], *moments_of(m, g), surface))
    notes = [f"skipped {silent} geoms that touch no floor"] if silent else []
    notes += [f"ignored {count} geoms of type {kind}, which is not supported" for kind, count in left.items()]
    return tuple(shapes), notes


def moments_of(m: Any, g: int) -> tuple[float | None, float | None]:
    """Return the coefficients of torsional and rolling friction [m] that `condim` lets a geom have, None for others."""
    _, torsional, rolling = m.geom_friction[g].tolist()
    return torsional if m.geom_condim[g] >= 4 else None, rolling if m.geom_condim[g] >= 6 else None


def surface_of(m: Any, g: int, name: str) -> Surface | None:
    """Return how the surface of a geom moves, which MuJoCo states in the geom's frame; None where it rests.

    The name of the geom is that of its drive.
    """
    stated = getattr(m, "geom_surfacevel", None)
    if stated is None or not stated[g].any():
        return None
    E = rotation_from_quaternion(m.geom_quat[g])
    velocity, turning = (vector(applied(E, part)) for part in (stated[g, :3], stated[g, 3:]))
    return Surface(velocity, turning, vector(m.geom_pos[g]), name)


def geometry_of(m: Any, g: int) -> Geometry | None:
    """Return the geometry of a geom; None if it is not supported."""
    kind, size = m.geom_type[g], m.geom_size[g].tolist()
    if kind == SPHERE or (kind == ELLIPSOID and size[0] == size[1] == size[2]):
        return Sphere(size[0])
    if kind in (CAPSULE, CYLINDER):
        return (Capsule if kind == CAPSULE else Cylinder)(size[0], 2.0 * size[1])
    if kind == BOX:
        return Box((2.0 * size[0], 2.0 * size[1], 2.0 * size[2]))
    if kind == MESH:
        return Hull(tuple(vector(point) for point in _corners(m, int(m.geom_dataid[g]))))
    if kind == ELLIPSOID:
        return Hull(tuple((x * size[0], y * size[1], z * size[2]) for x, y, z in ROUND))
    if kind == HFIELD:
        return height_field(m, int(m.geom_dataid[g]))
    return None


def _round() -> list[tuple[float, float, float]]:
    """Return the corners of an icosahedron and its dual, as far out as the faces of their hull lie within 1."""
    golden, found = 0.5 * (1.0 + math.sqrt(5.0)), []
    signs = [(one, two) for one in (-1.0, 1.0) for two in (-1.0, 1.0)]
    for second, third in ((1.0, golden), (golden, 1.0 / golden)):
        for one, two in signs:
            x, y = one * second, two * third
            found += [(0.0, x, y), (y, 0.0, x), (x, y, 0.0)]
    found += [(one, two, three) for one, two in signs for three in (-1.0, 1.0)]
    return [tuple((1.0 + ROUNDNESS) / math.hypot(*point) * x for x in point) for point in found]  # type: ignore[misc]


ROUNDNESS = 0.0403  # by which part of the radius the hull of `ROUND` differs from a sphere at most
ROUND = _round()


def rounded(m: Any, geoms: Iterable[int], names: list[str]) -> list[str]:
    """Return what to say of ellipsoids among geoms that touch something."""
    found = (g for g in geoms if m.geom_type[g] == ELLIPSOID and isinstance(geometry_of(m, g), Hull))
    off = sorted(((ROUNDNESS * float(max(m.geom_size[g])), names[g]) for g in found), reverse=True)
    if not off:
        return []
    each = ", ".join(f"{name!r} {x:.3g} m" for x, name in off)
    remedy = "write spheres, capsules or meshes for what must be closer"
    return [
        f"took ellipsoids as hulls of {len(ROUND)} corners, off by up to {ROUNDNESS:.0%} of a radius: {each}; {remedy}"
    ]


def height_field(m: Any, k: int) -> HeightField:
    """Return a height field about its middle, as MuJoCo has it."""
    rows, columns, start = int(m.hfield_nrow[k]), int(m.hfield_ncol[k]), int(m.hfield_adr[k])
    half_x, half_y, top, _ = m.hfield_size[k].tolist()
    heights = m.hfield_data[start : start + rows * columns].astype(float).reshape(rows, columns).T * top
    return HeightField(heights, (2.0 * half_x / (columns - 1), 2.0 * half_y / (rows - 1)), (-half_x, -half_y))


def _corners(m: Any, mesh: int) -> np.ndarray:
    """Return the vertices (n, 3) of a mesh's convex hull if MuJoCo has computed it, else all vertices."""
    start = m.mesh_vertadr[mesh]
    points = m.mesh_vert[start : start + m.mesh_vertnum[mesh]]
    if m.mesh_graphadr[mesh] < 0:
        return points
    graph = m.mesh_graph[m.mesh_graphadr[mesh] :]
    count = graph[0]
    return points[graph[2 + count : 2 + 2 * count]]


# ---------------------------------------------------------------------------------------------- names


def names_of(m: Any, kind: str, count: int) -> list[str]:
    """Return unique names of all elements of a kind ("body", "joint", ...)."""
    given = [getattr(m, kind)(k).name for k in range(count)]
    taken = set(given)
    return [name or unused(f"{kind}{k}", taken) for k, name in enumerate(given)]


def unused(name: str, taken: Iterable[str]) -> str:
    """Lengthen a name until nothing else has it."""
    taken = taken if isinstance(taken, (set, dict)) else set(taken)
    while name in taken:
        name += "_"
    return name


def actuator_count(m: Any) -> int:
    """Return the number of actuators; since MuJoCo 4 one may have several controls, or none."""
    return int(getattr(m, "nactuator", m.nu))
