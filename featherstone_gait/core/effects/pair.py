"""Contact between bodies: the law of contact.py at the points of pairs of shapes, with a bristle each.

Of a pair, body b is what the normal points away from; where one of both cannot move, it is b.  The relative velocity
u = v_a - v_b and the force on a are in the axes of the point (normal, two tangents); b takes the opposite force at the
same place, so that momentum and angular momentum are kept to rounding.

A pair's points come and go with its bodies.  What lasts from step to step, the bristles, is kept in a pool of slots in
the state, a block of slots for each pair that is near: see step/pool.py.
"""

from typing import NamedTuple

import numpy as np

from ..compile.structure import record, structure
from ..tree.distance import Shapes

PAIR = record(
    a=int,  # row of the shape in the table of `Shapes`
    b=int,
    tree_a=int,  # number of the tree that carries it
    tree_b=int,  # -1: fixed to the world, and E, r of its shape are those in the world
    body_a=int,  # row of the body
    body_b=int,
    row_a=int,  # workspace row in which the body's contacts are summed
    row_b=int,
    folded=int,  # 1 = b cannot move: a point of the pair touches a alone
    slots=int,  # points that the pair can have
    stiffness=float,  # normal, of a point [N/m]
    damping=float,  # Hunt and Crossley's d [s/m]
    friction=float,  # coefficient
    tangential_stiffness=float,  # [N/m]
    tangential_damping=float,  # [N s/m]
)


@structure
class Pairs(NamedTuple):
    """Shapes, and pairs of them that may touch."""

    shapes: Shapes  # E, r of a shape: in the frame of its body
    pairs: np.ndarray  # (pairs,) PAIR, by tree_a, tree_b and then bodies
    own_rows: np.ndarray  # (rows,) of row_a and row_b, those of bodies without a contact point on the ground
    reach: np.ndarray  # (joints,) bound of the way [m] that a shape moves by one radian or meter of a joint
    radius: np.ndarray  # (trees,) bound of the distance from a tree's base to any point of its shapes [m]
    slots: np.ndarray  # (1,) slots of the pool
    margin: float  # the depth at which a pair rests under its load [m]: gaps below it are looked at
