"""Several trees in one scene: which rows, joints, points and coordinates are those of each.

Tables hold one tree after the other.  What works on one tree takes its record `TREE`, or None for the only tree of a
scene, whose rows are then all rows.  Each tree has a common frame of its own, with its origin at the tree's base: far
from the world's origin it loses no digits, and moves to the same bits as it would alone.

In a scene of several trees each has the coordinates of a floating base, which a fixed one never changes.
"""

from ..compile.jit import inline
from ..compile.optional import slice_if
from ..compile.structure import record

TREE = record(
    root=int,  # row of the root
    end=int,  # row after the last body
    fixed=int,  # 1 = the root is fixed to the world
    number=int,  # which of the trees it is; its base has the same number
    joint=int,  # first joint
    end_joint=int,
    point=int,  # first contact point
    end_point=int,
    coupling=int,  # first coupling
    end_coupling=int,
    ball=int,  # first ball joint
    end_ball=int,
    tendon=int,  # first tendon
    end_tendon=int,
    loop=int,  # first loop, of those that join no other tree
    end_loop=int,
    row=int,  # first row of couplings, tendons and those loops
    falls=int,  # 1 = it can fall
    min_height=float,  # of the center of mass over the ground, along its normal [m]; below it the robot has fallen
    min_upright=float,  # cosine of the base's tilt; below it the robot has fallen
    upright=(float, 3),  # what points up in the frame of a base that is not tilted
)

# A mask of all rows there can be.  With it LLVM knows that a loop's indices are not negative, and leaves out what
# counts negative ones from an array's end: 10 % of a step.
LARGEST = 0x7FFFFFFF


@inline
def rows_of(part, tree):
    """Return the row of the root and the row after the last body."""
    if part is None:
        return 0, len(tree)
    return part.root & LARGEST, part.end & LARGEST


@inline
def joints_of(part, tree):
    """Return the first joint and the one after the last."""
    if part is None:
        return 0, len(tree) - 1
    return part.joint & LARGEST, part.end_joint & LARGEST


@inline
def points_of(part, points):
    """Return the first contact point and the one after the last."""
    if part is None:
        return 0, len(points)
    return part.point & LARGEST, part.end_point & LARGEST


@inline
def couplings_of(part, coupling):
    """Return the first coupling and the one after the last."""
    if part is None:
        return 0, len(coupling)
    return part.coupling & LARGEST, part.end_coupling & LARGEST


@inline
def balls_of(part, balls):
    """Return the first ball joint and the one after the last."""
    if part is None:
        return 0, len(balls)
    return part.ball & LARGEST, part.end_ball & LARGEST


@inline
def tendons_of(part, tendons):
    """Return the first tendon and the one after the last."""
    if part is None:
        return 0, len(tendons)
    return part.tendon & LARGEST, part.end_tendon & LARGEST


@inline
def loops_of(part, loop):
    """Return the first loop of a tree that joins no other, and the one after the last."""
    if part is None:
        return 0, len(loop)
    return part.loop & LARGEST, part.end_loop & LARGEST


@inline
def own_loops(trees, loop):
    """Return the number of loops that join no trees; those that do come after them."""
    if trees is None:
        return len(loop)
    return trees[len(trees) - 1].end_loop & LARGEST


@inline
def system_of(part):
    """Return the first block and the first row of the system of a tree alone (rows.py)."""
    if part is None:
        return 0, 0
    return (part.coupling + part.tendon + part.loop) & LARGEST, part.row & LARGEST


@inline
def base_index(part):
    """Return which of the scene's bases is the tree's."""
    if part is None:
        return 0
    return part.number & LARGEST


@inline
def base_of(floating, part, array, start, count):
    """Return the numbers of the tree's base, `count` each, of those that start at array[start]; None if none floats."""
    return slice_if(floating, array, start + count * base_index(part), count)


@inline
def is_fixed(part):
    """Return whether the root of one of several trees is fixed."""
    if part is None:
        return False
    return part.fixed > 0


@inline
def joint_count(trees, tree):
    """Return the number of joints of all trees; trees (trees,) TREE, None for one."""
    if trees is None:
        return len(tree) - 1
    return trees[len(trees) - 1].end_joint


@inline
def base_count(trees):
    """Return the number of bases that have coordinates, where any has."""
    if trees is None:
        return 1
    return len(trees)
