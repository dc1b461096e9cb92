"""Independent deviations of a state, and how they move it.

A floating base's quaternion has one number too many: its deviation is a rotation vector r [rad] in body axes, to first
order.  Of coupled joints only the leaders count.  Loops tie deviations to each other: some of them are independent, and
the others follow, so that the loops stay closed to rounding (`ClosedChart`).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from ..base.fixed_order import applied, total
from ..core.effects.actuator import motor_of
from ..core.effects.pd_servo import PDServo
from ..core.step.state import ALL, BY_NAME, OWNERS
from ..dynamics import coupling_matrix
from ..dynamics.loops import eliminated, leaders_of, loop_measures
from ..run.start import loop_rows, positions_in
from ..scene.compile import CompiledScene
from ..scene.contact import by_body
from ..scene.friction import sticks

BASE = {
    "base_q": ("x", "y", "z", "rx", "ry", "rz"),
    "base_qd": ("vx", "vy", "vz", "wx", "wy", "wz"),
    "base_qdd": ("ax", "ay", "az", "dwx", "dwy", "dwz"),
}

# First width of a deviation: where nothing sticks, where joints stick, and on the ground, by how far it moves a point.
SMOOTH, STICKING = 1e-4, 2e-6  # [rad, m, rad/s, m/s]
OF_SINKING, LEVER = 0.04, 0.2  # [-], [m]
OTHER = {"voltage": 100.0, "duty": 10.0, "bus_voltage": 100.0, "delayed": 100.0, "current": 10.0}  # [V, -, V, V, A]
DEFLECTION = 1e-6  # first width of a contact's tangential deflection [m]
MOVES, CLOSED = 20, 1e-11  # by which deviations close loops, and what may be left of gaps [m or rad]


class Chart:
    """Map deviations to a state and back: which numbers of it they move, and which of them read a deviation."""

    def __init__(self, scene: CompiledScene, channels: Sequence[str], held: Sequence[str] = ()) -> None:
        """Chart the channels of the states; those in `held` move with them, but are no states."""
        self.channels = (*channels, *held)
        self.names: list[str] = []
        self.widths: list[float] = []
        turns: list[int] = []
        reads: list[int] = []
        moves: list[tuple[int, int, float]] = []  # number of the state, deviation, factor
        self.states, sticky = 0, sticks(scene.constants.friction, scene.constants.tendons)
        for name in self.channels:
            for label, at, moved in coordinates_of(scene, name):
                k = len(self.names)
                self.names.append(f"{name} {label}".strip())
                self.widths.append(width_of(scene, sticky, name, label))
                reads.append(at)
                moves.extend((number, k, factor) for number, factor in moved)
                if not moved:
                    turns.append(k)
            if name in channels:
                self.states = len(self.names)
        self.turns = np.array(turns, dtype=int).reshape(-1, 3)  # deviations that turn each base and ball joint
        self.quaternions = [at for name in self.channels for at in _quaternions(scene, name)]
        self.reads = np.array(reads[: self.states], dtype=int)  # number of the state that is a deviation's
        self._moves = [np.array(column) for column in zip(*moves)] if moves else [np.zeros(0, int)] * 3

    def moved(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return states (size, k) at the deviations x (states, k) from y (size,)."""
        Y = np.repeat(y[:, None], x.shape[1], axis=1)
        numbers, columns, factors = self._moves
        kept = columns < len(x)
        Y[numbers[kept]] += factors[kept, None] * x[columns[kept]]
        for at, turns in zip(self.quaternions, self.turns):
            Y[at] = _turned(y[at], x[turns])
        return Y

    def move_each(self, Y: np.ndarray, y: np.ndarray, which: np.ndarray, steps: np.ndarray) -> None:
        """Move the states Y (blocks, size, lanes), all of them y, each in one deviation, which (k,), by a step (k,)."""
        numbers, columns, factors = self._moves
        lanes = Y.shape[2]
        move, run = _pairs(columns, which)
        Y[run // lanes, numbers[move], run % lanes] += factors[move] * steps[run]
        for at, turns in zip(self.quaternions, self.turns):
            turn, run = _pairs(turns, which)
            x = np.where(turn == np.arange(3)[:, None], steps[run], 0.0)
            Y[run // lanes, at, run % lanes] = _turned(y[at], x).T

    def pulled(self, y: np.ndarray, by_state: np.ndarray) -> np.ndarray:
        """Return derivatives (deviations,) by deviations from y (size,), from those by its numbers (size,)."""
        found = np.zeros(len(self.names))
        numbers, columns, factors = self._moves
        np.add.at(found, columns, factors * by_state[numbers])
        for at, turns in zip(self.quaternions, self.turns):
            found[turns] = total(0.5 * _after(y[at])[:, 1:] * by_state[at][:, None], axis=0)
        return found

    def difference(self, Y: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return deviations (states, ...) of the states Y (size, ...) from y (size,)."""
        X = Y[self.reads] - beside(y[self.reads], Y)
        for at, turns in zip(self.quaternions, self.turns):
            turn = total(_after(y[at]).T.reshape(4, 4, *[1] * (Y.ndim - 1)) * Y[at], axis=1)  # the inverse of `_turned`
            X[turns] = 2.0 * turn[1:] / turn[0]
        return X


_POSITIONS, _RATES, _ACCELERATIONS = ("base_q", "ball_q", "q"), ("base_qd", "qd"), ("base_qdd", "qdd")


class ClosedChart:
    """A `Chart` of a scene with loops: its deviations are independent, and the others follow so that loops stay closed.

    Dependent deviations of positions, velocities and accelerations are found by the chord method, with the inverse of
    the loops' Jacobian at the state y (size,).  Joints with motors are independent where they can be.
    """

    def __init__(self, scene: CompiledScene, channels: Sequence[str], held: Sequence[str], y: np.ndarray) -> None:
        moving = (*_POSITIONS, *_RATES, *_ACCELERATIONS)
        inner = (*moving, *(name for name in channels if name not in moving))
        self._scene, self._inner = scene, chart_of(scene, inner, tuple(held))
        view, name_of = scene.state_view(y), [name.split()[0] for name in self._inner.names]
        self._places = view.loop_place.ravel()
        self._rows = np.repeat(view.loop_closed > 0.0, [loop.rows for loop in scene.model.loops])
        self._residual = np.zeros((3, 1, int(self._rows.sum())))
        self._residual[2] = self._measured(y[:, None])[2]  # of accelerations of the last step, or zero at the start
        families = [np.flatnonzero(np.isin(name_of, one)) for one in (_POSITIONS, _RATES, _ACCELERATIONS)]
        A = self._jacobian(y, families[1])
        dependent = eliminated(A, np.zeros(len(A)), driven_columns(scene))[0]
        self._inverse = np.linalg.pinv(A[:, dependent])
        self._dependent = [family[dependent] for family in families]
        left = np.delete(np.arange(len(name_of)), np.concatenate(self._dependent))
        self.channels = (*channels, *held)
        self._which = np.array([k for name in self.channels for k in left if name_of[k] == name], dtype=int)
        self.states = len(self._which) - sum(name_of[k] in held for k in self._which)
        self.names = [self._inner.names[k] for k in self._which]
        self.widths = [self._inner.widths[k] for k in self._which]
        self.reads = self._inner.reads[self._which[: self.states]]

    def _jacobian(self, y: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Compute how fast gaps grow by each independent rate, which (k,) of the inner chart's deviations (rows, k)."""
        still = y.copy()
        for name in _RATES:
            still[slice(*self._scene.part(name))] = 0.0
        X = np.zeros((len(self._inner.names), len(rates)))
        X[rates, np.arange(len(rates))] = 1.0
        return self._measured(self._inner.moved(still, X))[1].T

    def _measured(self, Y: np.ndarray) -> np.ndarray:
        """Compute gaps of positions, rates and accelerations (3, k, rows) in states (size, k)."""
        scene = self._scene
        if scene.members:
            found = np.array([loop_rows(scene, y) for y in np.ascontiguousarray(Y.T)]).swapaxes(0, 1)
            moved = Y.copy()
            for rate, acceleration in zip(_RATES, _ACCELERATIONS):
                moved[slice(*scene.part(rate))] = Y[slice(*scene.part(acceleration))]
            found[2] += [loop_rows(scene, y)[1] for y in np.ascontiguousarray(moved.T)]
            return found[:, :, self._rows]
        q = np.array([positions_in(scene, y) for y in Y.T])
        rates, accelerations = (
            np.concatenate([Y[slice(*scene.part(name))] for name in names]).T for names in (_RATES, _ACCELERATIONS)
        )
        measures, J = loop_measures(scene.model, q, rates, self._places)
        measures[:, 2] += applied(J, accelerations)
        return measures.swapaxes(0, 1)[:, :, self._rows]

    def moved(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return states (size, k) at the deviations x (states, k) from y (size,).

        Raises ValueError where no dependent deviations close the loops.
        """
        X = np.zeros((len(self._inner.names), x.shape[1]))
        X[self._which[: len(x)]] = x
        for _ in range(MOVES):
            gaps = self._measured(self._inner.moved(y, X)) - self._residual
            for dependent, gap in zip(self._dependent, gaps):
                X[dependent] -= self._inverse @ gap.T
            if np.abs(gaps).max(initial=0.0) <= CLOSED:  # the last move leaves rounding
                return self._inner.moved(y, X)
        raise ValueError(
            f"{self._scene.model.name}: loops do not close at these deviations; take smaller ones, or a state farther "
            "from postures in which loops depend on each other"
        )

    def move_each(self, Y: np.ndarray, y: np.ndarray, which: np.ndarray, steps: np.ndarray) -> None:
        """Move the states Y (blocks, size, lanes), all of them y, each in one deviation, which (k,), by a step (k,)."""
        run = np.flatnonzero(which < len(self.names))
        x = np.zeros((len(self.names), len(run)))
        x[which[run], np.arange(len(run))] = steps[run]
        Y[run // Y.shape[2], :, run % Y.shape[2]] = self.moved(y, x).T

    def difference(self, Y: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return deviations (states, ...) of the states Y (size, ...) from y (size,)."""
        return self._inner.difference(Y, y)[self._which[: self.states]]


AnyChart: TypeAlias = "Chart | ClosedChart"


def driven_columns(scene: CompiledScene) -> np.ndarray:
    """Return which independent coordinates (k,) have motors, or might have: those of bases, and all without servos."""
    bases = 6 * len(_free_bases(scene)) if scene.members else 0  # of which the scene's model knows nothing
    model, actuator = scene.model, scene.constants.actuator
    driven = np.ones(model.nv, dtype=bool)
    if actuator is not None:
        strength = actuator.pd.Kp if isinstance(actuator, PDServo) else motor_of(actuator).torque_constant
        driven[model.nv - scene.tree.n :] = strength > 0.0
    return np.concatenate([np.ones(bases, dtype=bool), driven[leaders_of(model)]])


def _pairs(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find where numbers of a (k,) and of b (m,) are equal; return places in a and in b."""
    return np.divmod(np.flatnonzero(a[:, None] == b), len(b))


def beside(y: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """Shape numbers (size,) so that they broadcast with arrays (size, ...)."""
    return y.reshape(-1, *[1] * (Y.ndim - 1))


def _quaternions(scene: CompiledScene, name: str) -> list[slice]:
    """Return where in the state the quaternions of a channel stand, those of ball joints with the channel q."""
    if name == "base_q":
        first = scene.part(name)[0]
        return [slice(first + 7 * b + 3, first + 7 * b + 7) for b in _free_bases(scene)]
    first = scene.part("ball_q")[0]
    return [slice(first + 4 * k, first + 4 * k + 4) for k in range(len(scene.model.balls))] if name == "q" else []


@functools.lru_cache(maxsize=128)
def chart_of(scene: CompiledScene, channels: tuple[str, ...], held: tuple[str, ...] = ()) -> Chart:
    """Return the `Chart` of a scene's channels, one object for the same arguments."""
    return Chart(scene, channels, held)


def coordinates_of(scene: CompiledScene, name: str) -> list[tuple[str, int, list[tuple[int, float]]]]:
    """Return for each deviation of a channel its label, the number that reads it, and those that it moves with factors.

    A rotation of the base or of a ball joint moves none: see `_turned`.
    """
    first, end = scene.part(name)
    joints = scene.model.joint_names
    if name == "ball_q":  # its deviations are turns, those of q
        return []
    if name in BASE and end > first:
        turn, width = ((3, 4, 5), 7) if name == "base_q" else ((), 6)
        places = [(b, first + width * b + k, k) for b in _free_bases(scene) for k in range(6)]
        whose = [f"{member.name} " for member in scene.members] or [""]
        return [(whose[b] + BASE[name][k], at, [] if k in turn else [(at, 1.0)]) for b, at, k in places]
    if name in ("q", "qd", "qdd"):
        G = coupling_matrix(scene.model).matrix[scene.model.nv - len(joints) :, scene.model.nv - len(joints) :]
        leading = []
        for column in G.T:
            moved = [(first + int(k), float(column[k])) for k in np.flatnonzero(column)]
            leader = next(number for number, factor in moved if factor == 1.0)
            turns = name == "q" and scene.model.moving_joints[leader - first].type == "ball"
            leading.append((joints[leader - first], leader, [] if turns else moved))
        return leading
    channel, width = BY_NAME[name], BY_NAME[name].width
    labels: list[str] = [str(k) for k in range((end - first) // width)]
    if len(labels) == len(joints) and channel.of != "point":
        labels = list(joints)
    if channel.of == "point":
        order = by_body(scene.model, scene.tree)
        labels = [f"{scene.model.contacts[k].link} {k}" for k in order]
    if OWNERS[channel.of].share == ALL:
        labels = [""] * len(labels)
    parts = channel.labels if width > 1 else ("",)
    found = [f"{label} {part}".strip() for label in labels for part in parts]
    return [(label, first + k, [(first + k, 1.0)]) for k, label in enumerate(found)]


def _free_bases(scene: CompiledScene) -> list[int]:
    """Return which bases of the scene can move."""
    if scene.members:
        return [k for k, member in enumerate(scene.members) if member.scene.tree.floating]
    return [0] if scene.tree.floating else []


def width_of(scene: CompiledScene, sticky: bool, name: str, label: str) -> float:
    """Return the first width of a deviation, so small that joints go on to stick and contacts stay as they are."""
    if name == "tangential_deflection":
        return DEFLECTION
    width = STICKING if sticky else SMOOTH
    if scene.ground is not None:
        slip = OF_SINKING * scene.ground.penetration
        width = min(width, slip if label.rpartition(" ")[2] in ("x", "y", "z") else slip / LEVER)
    return width * OTHER.get(name, 1.0)


def _turned(quaternion: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Rotate a unit quaternion w x y z by r (3, k) in body axes, r / 2 the tangent of half the angle; return (4, k)."""
    new = quaternion[:, None] + total(_after(quaternion)[:, 1:, None] * (0.5 * turn), axis=1)
    return new / np.sqrt(total(new * new, axis=0))


def _after(quaternion: np.ndarray) -> np.ndarray:
    """Return the matrix (4, 4) of a quaternion's product with others from the left; its transpose is the inverse."""
    w, x, y, z = quaternion.tolist()
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
