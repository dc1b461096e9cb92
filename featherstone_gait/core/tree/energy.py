"""Energy, momentum and center of mass from the poses and velocities that `motion_pass` left in the workspace."""

from ..compile.jit import inline, kernel
from .forest import rows_of
from .joint import joint_pose
from .kinematics import quaternion_matrix
from .layout import P, R, V
from .rigid_body import center_velocity, mass_center, point_position
from .spatial import add, cross, dot, load3, scale, store3, store9, sub, symmetric


@inline
def _base_position(base_q):
    if base_q is None:
        return (0.0, 0.0, 0.0)
    return (base_q[0], base_q[1], base_q[2])


@kernel
def energy(tree, base_q, qd, armature, gravity, W, out):
    """Fill out (2,): kinetic and potential energy [J]; the height is counted from the world's origin."""
    kinetic = 0.0
    potential = 0.0
    p = _base_position(base_q)
    for i in range(len(tree)):
        b = tree[i]
        c, Jc = mass_center(b, i, W)
        v = center_velocity(i, c, W)
        w = load3(W, i, V)
        Jw = symmetric(Jc, w)
        kinetic = kinetic + 0.5 * (b.m * dot(v, v) + dot(w, Jw))
        potential = potential - b.m * dot(add(c, p), gravity)
    if armature is not None:
        for i in range(len(tree) - 1):
            kinetic = kinetic + 0.5 * armature[i] * (qd[i] * qd[i])
    out[0] = kinetic
    out[1] = potential


@kernel
def center_of_mass(tree, base_q, W, out):
    """Fill out (6,): position [m] and velocity [m/s] of the center of mass, world frame; return the mass [kg]."""
    mass = 0.0
    x = (0.0, 0.0, 0.0)
    v = (0.0, 0.0, 0.0)
    for i in range(len(tree)):
        b = tree[i]
        c, _ = mass_center(b, i, W)
        mass += b.m
        x = add(x, scale(c, b.m))
        v = add(v, scale(center_velocity(i, c, W), b.m))
    x = add(scale(x, 1.0 / mass), _base_position(base_q))
    v = scale(v, 1.0 / mass)
    for k in range(3):
        out[k] = x[k]
        out[3 + k] = v[k]
    return mass


@kernel
def center_of_floating(tree, part, base_q, ball_q, q, W):
    """Return the center of mass [m] of a floating robot by positions alone; fill R and P of its rows."""
    root, end = rows_of(part, tree)
    store3(W, root, P, (0.0, 0.0, 0.0))
    store9(W, root, R, quaternion_matrix(base_q))
    mass, x = tree[root].m, scale(point_position(root, tree[root].c, W), tree[root].m)
    for i in range(root + 1, end):
        b = tree[i]
        joint_pose(ball_q, b, i, q[b.dof], W)
        mass += b.m
        x = add(x, scale(point_position(i, b.c, W), b.m))
    return add(scale(x, 1.0 / mass), _base_position(base_q))


@kernel
def momentum(tree, base_q, W, out):
    """Fill out (6,): angular momentum about the center of mass [kg m^2/s] and linear momentum [kg m/s], world axes."""
    mass = center_of_mass(tree, base_q, W, out)
    com = sub((out[0], out[1], out[2]), _base_position(base_q))
    p = scale((out[3], out[4], out[5]), mass)
    L = (0.0, 0.0, 0.0)
    for i in range(len(tree)):
        b = tree[i]
        c, Jc = mass_center(b, i, W)
        Jw = symmetric(Jc, load3(W, i, V))
        L = add(L, add(Jw, cross(sub(c, com), scale(center_velocity(i, c, W), b.m))))
    for k in range(3):
        out[k] = L[k]
        out[3 + k] = p[k]
