"""An integrator: a record of its properties, and kernels chosen by the type of its workspace.

A new integrator is one file with a workspace (a NamedTuple of arrays), a kernel registered for it, and an `Integrator`;
`__init__.py` lists it; nothing else depends on its name.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..compile.by_type import by_type, overridable
from ..compile.jit import address_of
from ..effects.contact import SCRATCH as CONTACT_SCRATCH
from ..effects.element import OF_TREES
from ..effects.joint import SCRATCH as JOINT_SCRATCH
from ..effects.pair import COLUMNS as PAIR_SCRATCH
from ..effects.pair import OLD, SHAPE_POSE, Pool
from ..shapes.manifold import contacts_at
from ..step.closure import Closing
from ..step.context import Scratch
from ..step.pool import KEPT, Renewal
from ..tree.loop import Loops
from ..tree.rows import Rows, make_rows

RTOL = 1e-8  # error allowed of a step, where none is given


class Sizes(NamedTuple):
    """Sizes on which the workspace of an integrator depends."""

    n: int  # joints
    inputs: int  # columns of references and torques: joints, then driven tendons
    bodies: int
    bases: int  # that have coordinates
    balls: int  # ball joints
    points: int  # contact points
    rolling: int  # contact points, if any resists rolling
    workspace: tuple[int, int]  # of the tree
    offsets: np.void  # STATE
    motors: int  # rows of the table of decays, 0 without
    driven: bool  # by torques from outside
    stiff: bool  # something that an implicit step takes in limits explicit steps
    pairs: tuple | None  # Pairs of the scene
    bench: tuple | None  # Bench of the largest shapes: scratch of the narrow phase
    trees: int
    largest: int  # bodies of the largest tree
    loops: Loops | None  # of the scene
    couplings: int = 0
    tendons: int = 0
    immersed: int = 0  # shapes in a medium


class Integrator(NamedTuple):
    """Properties of a method of integration."""

    name: str
    order: int
    workspace: Callable[[Sizes, Callable], tuple]  # (sizes, zeros) -> arrays; zeros(shape) makes one
    stages: int = 1  # evaluations a step
    theta: float = 1.0  # of the linearly implicit step: where in the step forces are taken
    adaptive: bool = False  # chooses its steps by their error
    rtol: float = RTOL
    strictest: float = 0.0  # tolerance below which another method is taken where none is named
    least_step: float = 1e-15  # that error control may take [s]
    second_run: bool = False  # at ten times the tolerance of a first run, whose error it estimates
    stability: float = math.inf  # largest stable step over the limit of semi-implicit Euler, of dampers and of springs
    folds_spring: bool = False  # takes springs of joints and continuous servos at the end of the step always
    soft: bool = False  # takes all forces explicitly: dry friction cannot be steep
    rings: bool = False  # alternates about the right mean after an impact
    drives: tuple[type, ...] = ()  # actuators that it applies by itself, viscous friction included; no others
    closes: bool = True  # keeps loops closed

    @property
    def explicit(self) -> bool:
        """Return whether fixed steps are limited by what is stiff."""
        return self.stability < math.inf


@by_type
def take_step(work, run, y, t, theta):
    """Move the state y over a step of fixed length from t [s]; theta: see `Plan`."""


@overridable
def thetas(work, theta, end):
    """Return theta of a run's first step and of the others [-]; end: how long the run has gone on before [s]."""
    return theta, theta


@overridable
def hold_solution(work, run, plain, y, t, theta):
    """Bring the scratch of a run of taped numbers to the solution that the same step of `plain` has left in its own.

    y: its state before the step; its own scratch then holds the factors of the step.
    """


@by_type
def take_adaptive_step(work, run, y, t, length):
    """Move y over a step of at most `length` [s] from t; return the step, 0 if the tolerance needs one too small."""


@overridable
def begin_run(work, run):
    """Make the workspace ready for the first adaptive step of a run."""


@by_type
def begin_interval(work, run, y, t):
    """Take note that something has changed at t [s] since the last step."""


@overridable
def take_up_again(work, run, y, t):
    """Make the workspace ready to step once more from the state y at t [s]."""


@overridable
def record_within(work, run, y, interval, record, out):
    """Record what lies within the last step, if it lies there; interval: its start, its length, the next grid step.

    Returns the next record.
    """
    return record


@overridable
def ends_on_records(work):
    """Return True if steps end on records, None if records lie anywhere within."""
    return True


@overridable
def looks_ahead(work):
    """Return True if a step takes forces at its end, so that it feels contacts that it makes; None if it does not."""
    return True


def scratch(sizes: Sizes, zeros) -> Scratch:
    """Make what every step overwrites; zeros(shape) makes its arrays."""
    return Scratch(
        zeros(sizes.workspace),
        zeros((JOINT_SCRATCH, max(sizes.n, 1))),
        zeros((max(sizes.points + 2 * sizes.immersed + sizes.rolling, 1), CONTACT_SCRATCH)),
        zeros((sizes.bodies, 6)),
        zeros((max(sizes.trees, 1), OF_TREES)),
        pool_of(sizes, zeros),
        rows_of(sizes, zeros),
        closing_of(sizes, zeros),
    )


def closing_of(sizes: Sizes, zeros) -> Closing | None:
    """Make the scratch arrays with which loops are closed, None without."""
    if sizes.loops is None:
        return None
    return Closing(factors=zeros((sizes.bodies, 6)), move=zeros(sizes.n + 6), moved=zeros(7 + 4 * sizes.balls))


def rows_of(sizes: Sizes, zeros) -> Rows | None:
    """Make the scratch arrays of rows, None of a scene that can have none."""
    numbers = 0 if sizes.loops is None else int(sizes.loops.rows[0])
    blocks, rows = _touching(sizes.pairs)
    alone = sizes.couplings + sizes.tendons + numbers
    if rows + alone == 0:
        return None
    return make_rows(blocks + alone, rows + alone, (max(sizes.trees, 1), sizes.largest), numbers, zeros)


SPARE = 64  # pairs that have six rows though one point of theirs pushes, for which there is room


def _touching(pairs: Any) -> tuple[int, int]:
    """Return how many pairs of bodies that can move act at once, and how many rows they have."""
    if pairs is None:
        return 0, 0
    points = int(pairs.slots[1])
    if pairs.turning is not None:
        rows = 6 * points
    elif (pairs.pairs["slots"] > 1).any():
        rows = 3 * (points + min(points, SPARE))
    else:
        rows = 3 * points
    return rows // 3, rows  # a pair has three rows at least


def pool_of(sizes: Sizes, zeros) -> Pool | None:
    """Make the scratch arrays of pairs, None without."""
    if sizes.pairs is None:
        return None
    slots, trees = int(sizes.pairs.slots[0]), sizes.trees
    placed = slots * (1 if sizes.pairs.turning is None else 2)

    def whole(size):
        return np.zeros(size, np.int64)

    return Pool(
        C=zeros((placed, PAIR_SCRATCH)), pair=whole(placed), count=whole(4), placed=whole(placed), parent=whole(trees),
        trees=whole(trees), first_tree=whole(trees + 1), points=whole(placed), first_point=whole(trees + 1),
        island=whole(trees), label=zeros(trees), old=np.zeros((slots, OLD)), **_narrow_phase(sizes, zeros),
    )  # fmt: skip


def renewal_of(sizes: Sizes, zeros) -> Renewal | None:
    """Make the arrays with which the pool is renewed, None without pairs."""
    if sizes.pairs is None:
        return None
    coordinates = int(sizes.offsets["base_qd"])
    return Renewal(
        last=zeros(7 * sizes.trees + sizes.n), ways=zeros((4, sizes.bodies + 1)),
        weights=zeros(sizes.trees + sizes.n), due=zeros(len(sizes.pairs.pairs)),
        frames=zeros(sizes.workspace), kept=zeros((int(sizes.pairs.slots[0]), KEPT)),
        before=zeros(int(sizes.offsets["length"])), rates=zeros((2, coordinates)), within=zeros(coordinates),
        **_narrow_phase(sizes, zeros),
    )  # fmt: skip


def _narrow_phase(sizes: Sizes, zeros) -> dict[str, Any]:
    """Make the scratch arrays of the narrow phase; return them with its address, by their names in `Pool`."""
    assert sizes.pairs is not None
    manifold, poses = np.zeros((8, 8)), np.zeros((2, SHAPE_POSE))
    narrow = address_of(contacts_at, sizes.pairs.shapes, 0, 0, poses, 0.0, sizes.bench, manifold)
    return {
        "placing": zeros((4, SHAPE_POSE)), "poses": poses, "manifold": manifold, "bench": sizes.bench, "narrow": narrow
    }  # fmt: skip
