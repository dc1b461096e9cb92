"""Coordinates of other engines: states of a robot with a floating base as MuJoCo, Pinocchio and Drake write them.

===========================  =====================  ======================================================
engine                       q                      velocity
===========================  =====================  ======================================================
this package, MuJoCo         x y z, qw qx qy qz     v in world axes, omega in body axes
Pinocchio                    x y z, qx qy qz qw     v in body axes, omega in body axes
Drake                        qw qx qy qz, x y z     omega in world axes, v in world axes
===========================  =====================  ======================================================

v is the velocity of the origin of the base's frame.  The coordinates of the joints follow in the order of
`Model.joint_names`; an engine may list them in another order.  Quaternions of ball joints are w x y z, in Pinocchio
x y z w; their rates are angular velocities in the child's axes.  For a fixed base without ball joints all four agree.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, floats, one_of
from ..base.fixed_order import applied, total
from ..base.rotation import rotation_from_quaternion
from ..model import Model
from .states import check_model

Engine = Literal["mujoco", "pinocchio", "drake"]


class _Convention(NamedTuple):
    """The convention of an engine for the base: its numbers in terms of ours."""

    q: list[int]  # (7,) which of our numbers stand where
    angular_first: bool
    linear_axes: str  # "world" or "body"
    angular_axes: str


_CONVENTIONS = {
    "mujoco": _Convention([0, 1, 2, 3, 4, 5, 6], False, "world", "body"),
    "pinocchio": _Convention([0, 1, 2, 4, 5, 6, 3], False, "body", "body"),
    "drake": _Convention([3, 4, 5, 6, 0, 1, 2], True, "world", "world"),
}


def to_engine(engine: Engine, model: Model, q: ArrayLike, qd: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Write states of this package in the coordinates of another engine.

    Joints stay in the order of `Model.joint_names`.  An engine may list them in another one: Pinocchio takes the
    branches of a URDF by the alphabet, so compare the names.

    Parameters
    ----------
    engine : {"mujoco", "pinocchio", "drake"}
        The engine whose convention is used; it need not be installed.
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].
    qd : array_like
        Velocities (nv,) or (n, nv) [m/s, rad/s or m/s].

    Returns
    -------
    q, v : numpy.ndarray
        Positions and velocities of the engine, of the same shapes.

    Raises
    ------
    ValueError
        For an unknown engine, wrong shapes and values that are not finite.
    """
    law, q, qd = _checked(engine, model, q, "qd", qd)
    q = _balls(engine, model, q, [1, 2, 3, 0])
    if model.base == "fixed":
        return q, qd
    R = _rotation(q[..., 3:7])
    linear, angular = qd[..., :3], qd[..., 3:6]
    if law.linear_axes == "body":
        linear = applied(R.swapaxes(-1, -2), linear)
    if law.angular_axes == "world":
        angular = applied(R, angular)
    parts = [angular, linear] if law.angular_first else [linear, angular]
    return np.concatenate([q[..., law.q], q[..., 7:]], axis=-1), np.concatenate([*parts, qd[..., 6:]], axis=-1)


def from_engine(engine: Engine, model: Model, q: ArrayLike, v: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Read states that are written in the coordinates of another engine; the inverse of `to_engine`.

    Parameters
    ----------
    engine : {"mujoco", "pinocchio", "drake"}
        The engine whose convention is used; it need not be installed.
    model : Model
        The robot.
    q : array_like
        Positions of the engine (nq,) or (n, nq).
    v : array_like
        Velocities of the engine (nv,) or (n, nv).

    Returns
    -------
    q, qd : numpy.ndarray
        Positions and velocities of this package, of the same shapes.

    Raises
    ------
    ValueError
        For an unknown engine, wrong shapes and values that are not finite.
    """
    law, q, v = _checked(engine, model, q, "v", v)
    q = _balls(engine, model, q, [3, 0, 1, 2])
    if model.base == "fixed":
        return q, v
    q = np.concatenate([q[..., np.argsort(law.q)], q[..., 7:]], axis=-1)
    R = _rotation(q[..., 3:7])
    linear, angular = (v[..., 3:6], v[..., :3]) if law.angular_first else (v[..., :3], v[..., 3:6])
    if law.linear_axes == "body":
        linear = applied(R, linear)
    if law.angular_axes == "world":
        angular = applied(R.swapaxes(-1, -2), angular)
    return q, np.concatenate([linear, angular, v[..., 6:]], axis=-1)


def _check_free(engine: str, model: Model) -> None:
    """Raise ValueError for free joints within a tree, whose velocities other engines state in other axes."""
    names = [joint.name for joint in model.joints if joint.type == "free"]
    if names and engine != "mujoco":
        raise ValueError(
            f"{model.name}: free joints {', '.join(names)} within the tree have other velocities in {engine}, which "
            "are not converted; build them there as three sliding joints and a ball joint"
        )


def _balls(engine: str, model: Model, q: np.ndarray, order: list[int]) -> np.ndarray:
    """Write the quaternions of ball joints in another order, if the engine has one: Pinocchio's is x y z w."""
    for k in model.balls if engine == "pinocchio" else ():
        place = model.position_slices[k]
        q[..., place] = q[..., place][..., order]
    return q


def _checked(
    engine: str, model: Model, q: ArrayLike, name: str, v: ArrayLike
) -> tuple[_Convention, np.ndarray, np.ndarray]:
    one_of("engine", engine, _CONVENTIONS)
    _check_free(engine, check_model(model))
    rows = (None,) * (floats(f"{model.name}: q", q).ndim == 2)
    q = np.array(finite(f"{model.name}: q", q, (*rows, model.nq)))
    return _CONVENTIONS[engine], q, np.array(finite(f"{model.name}: {name}", v, (*q.shape[:-1], model.nv), "as q has"))


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Compute rotations (..., 3, 3), body -> world, of quaternions (..., 4) w x y z of any length above zero."""
    length = np.sqrt(total(quaternion * quaternion))[..., None]
    if not (length > 0).all():
        raise ValueError("the base's quaternion is zero; [1, 0, 0, 0] is no rotation")
    R = rotation_from_quaternion(np.moveaxis(quaternion / length, -1, 0))
    return np.moveaxis(R, (0, 1), (-2, -1))
