"""Check states of a model, and lay them out as kernels read them.

Every argument may have a leading axis of states, ``(n, nv)``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import HUGE, floats, instance, vector
from ..core.compile.elementary import SINCOS_LIMIT
from ..core.tree.layout import Motion, Robot
from ..model import Model
from ..model.degrees import ball_name, is_first
from .tree import Tree, compile_tree, joint_armature


def check_model(model: Model) -> Model:
    """Check that an argument is a model.

    Parameters
    ----------
    model : Model
        The robot.

    Returns
    -------
    Model
        The same.

    Raises
    ------
    TypeError
        For anything else.
    """
    instance("model", model, Model, "give what load_robot returns")
    return model


def as_rows(model: Model, **arrays: ArrayLike) -> dict[str, np.ndarray]:
    """Return the arguments as rows (n, width); raise ValueError for wrong shapes and values."""
    check_model(model)
    rows = {}
    for name, value in arrays.items():
        width = model.nq if name == "q" else model.nv
        a = floats(name, value)
        if a.ndim not in (1, 2) or a.shape[-1] != width:
            raise ValueError(f"{model.name}: {name} has shape {a.shape}; it must be ({width},) or (n, {width})")
        if not (np.abs(a) <= HUGE).all():
            wrong = a[~(np.abs(a) <= HUGE)][0]
            text = "is beyond 1e50: correct it" if np.isfinite(wrong) else "is not finite"
            raise ValueError(f"{model.name}: {name} has a value that {text}: {wrong}")
        rows[name] = np.atleast_2d(a)
    n = max(len(a) for a in rows.values())
    for name, a in rows.items():
        if len(a) not in (1, n):
            raise ValueError(f"{model.name}: {name} has {len(a)} rows where another argument has {n}; give 1 or {n}")
    _check_positions(model, rows["q"])
    return {name: np.broadcast_to(a, (n, a.shape[-1])) for name, a in rows.items()}


def _check_positions(model: Model, q: np.ndarray) -> None:
    """Raise ValueError for angles too large to be reduced exactly and quaternions without a direction."""
    if model.base == "floating":
        largest = np.abs(q[:, 3:7]).max(axis=1)
        if not ((largest > 5e-7) & (largest < 1e6)).all():
            raise ValueError(
                f"{model.name}: the base's quaternion q[3:7] is zero or beyond 1e6; [1, 0, 0, 0] is no rotation"
            )
    for place, joint in zip(model.position_slices, model.moving_joints):
        k = place.start
        if is_first(joint):
            largest = np.abs(q[:, place]).max(axis=1)
            if not ((largest > 5e-7) & (largest < 1e6)).all():
                raise ValueError(
                    f"{model.name}: the quaternion of ball joint {ball_name(joint)}, q[{k}:{k + 4}], is zero or beyond "
                    "1e6; [1, 0, 0, 0] is no rotation"
                )
        elif joint.type not in ("prismatic", "ball") and (np.abs(q[:, k]) > SINCOS_LIMIT).any():
            raise ValueError(
                f"{model.name}: q: angle of {joint.name} is {q[np.abs(q[:, k]).argmax(), k]:g} rad; "
                f"at most {SINCOS_LIMIT:.0f} rad: subtract whole turns"
            )


def as_given(out: np.ndarray, *arguments: ArrayLike) -> np.ndarray:
    """Return one state for one state, rows for rows."""
    return out[0] if all(np.ndim(a) == 1 for a in arguments) else out


def positions_of(model: Model, q: ArrayLike) -> np.ndarray:
    """Return positions (nq,) or (n, nq) as an array; raise ValueError for wrong shapes and values."""
    return as_given(as_rows(model, q=q)["q"], q)


def split_base(tree: Tree, a: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
    """Copy the columns of base and joints (a read-only array is another type to compile for); the base may be None."""
    k = a.shape[1] - tree.n
    return (np.array(a[:, :k], order="C") if k else None), np.array(a[:, k:], order="C")


def at_rest(tree: Tree, q: np.ndarray) -> Motion:
    """Make states at rest."""
    return motion_of(tree, q, np.zeros((len(q), tree.n + (6 if tree.floating else 0))))


def motion_of(tree: Tree, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray | None = None) -> Motion:
    """Lay states (n, nq), (n, nv) out as kernels read them."""
    (base_qd, rates), first = split_base(tree, qd), 7 if tree.floating else 0
    base_q, (joints, ball_q) = np.array(q[:, :first], order="C"), tree.split_positions(q[:, first:])
    base_qdd, accelerations = (None, None) if qdd is None else split_base(tree, qdd)
    joints = np.array(joints, order="C")
    return Motion(base_q if first else None, base_qd, base_qdd, joints, rates, accelerations, ball_q)


def robot_of(model: Model, armature: ArrayLike | None, gravity: ArrayLike) -> Robot:
    """Lay a model out as kernels read it; armature None takes the model's."""
    tree = compile_tree(model)
    added = joint_armature(model) if armature is None else vector("armature", armature, tree.n)
    return Robot(tree.bodies, added, vector("gravity", gravity, 3, "[m/s^2]"))


def workspace_of(tree: Tree) -> np.ndarray:
    """Make the scratch array of a tree."""
    return np.zeros((1, *tree.workspace_shape()))
