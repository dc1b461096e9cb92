"""Time gradients of whole runs beside differences, MuJoCo's and Pinocchio's derivatives of steps, with the errors.

The humanoid falls freely for 0.2 s under torques that are linear between knots; the result is a weighted sum of its
joint positions and velocities at the end, the parameters are the torques at the knots.  All programs make steps of 1 ms
of semi-implicit Euler.  MuJoCo and Pinocchio have no gradients of runs: theirs are put together in Python from
`mjd_transitionFD`, or `computeABADerivatives` and `dIntegrate`, step by step from the end, and MuJoCo's by central
differences of whole runs too.  The walk is that of `walking_cost`: energy per distance by the 40 angles of its poses.

An error is the largest of a component, by the largest component, against extrapolated differences of the same program's
runs.  All is timed in turn in one process, by CPU time; a run is one call that simulates and records the end.

    featherstone-gait benchmark gradients        five minutes
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..analysis.gradient import gradient
from ..model import Model
from ..optimize import walking_cost
from ..robot_file import load_robot
from ..robot_file.mjcf.write import mjcf_text
from ..run.prepare import prepare
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate_batch
from ..scene.compile import compile_scene
from ..walking.cost_gradient import cost_and_gradient
from .engines import bounded, check_order, disable, in_pinocchio, mujoco, pin, quick_mujoco
from .table import in_turn, installed, machine, spread, tabulate

REPEATS, REPEATS_FULL = 3, 11
STEP, STEPS = 1e-3, 200  # [s]
KNOTS = (2, 21)  # of torques of 19 joints: 38 and 399 parameters
USUAL, WIDE, WALKING = 1e-6, 1e-4, (1e-4, 1e-7)  # widths [N m], of the walk [rad]

Gradients = Callable[[], np.ndarray]


class Row(NamedTuple):
    """One line of the table."""

    problem: Annotated[str, "problem", "<8"]
    method: Annotated[str, "method", "<40"]
    parameters: Annotated[int, "par.", "4"]
    error: Annotated[float, "error", "8.1e"]
    time: Annotated[float, "ms", "9.2f"] = math.nan  # median [ms]
    spread: Annotated[float, "spread", "7.0%"] = math.nan  # of the quartiles, relative to the median
    runs: Annotated[float, "runs", "8.1f"] = math.nan  # time by that of one run of the program


class Timed(NamedTuple):
    """A gradient to be timed, beside one run of its program."""

    row: Row
    call: Gradients
    one: Callable[[], object]


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Time everything, print the table, write gradients.csv; `full` repeats more."""
    host, repeats = machine(), REPEATS_FULL if full else REPEATS
    print(host)
    with quick_mujoco() if installed("mujoco") else nullcontext():
        rows = (row for timed in (*map(falling, KNOTS), _walk()) for row in _times(timed, repeats))
        return tabulate(out_dir / "gradients.csv", Row, rows, host)


def _times(timed: list[Timed], repeats: int) -> list[Row]:
    calls = [call for each in timed for call in (each.call, each.one)]
    middle, spreads = spread(1e3 * in_turn(calls, repeats, time.process_time, warm=1).T)
    return [
        each.row._replace(time=middle[2 * k], spread=spreads[2 * k], runs=middle[2 * k] / max(middle[2 * k + 1], 1e-9))
        for k, each in enumerate(timed)
    ]


def _row(problem: str, method: str, call: Gradients, exact: np.ndarray, one: Callable[[], object]) -> Timed:
    found = call()
    error = float(np.abs(found - exact).max() / np.abs(exact).max())
    return Timed(Row(problem, method, found.size, error), call, one)


def _differences(values: Callable[[np.ndarray], np.ndarray], x: np.ndarray, width: float) -> np.ndarray:
    """Return central differences by each number of x; values(X (n, ...)): of several."""
    steps = width * np.eye(x.size).reshape(x.size, *x.shape)
    ends = values(np.concatenate([x + steps, x - steps]))
    return (ends[: x.size] - ends[x.size :]).reshape(x.shape) / (2.0 * width)


def _extrapolated(values: Callable[[np.ndarray], np.ndarray], x: np.ndarray, width: float) -> np.ndarray:
    return (4.0 * _differences(values, x, 0.5 * width) - _differences(values, x, width)) / 3.0


# ---------------------------------------------------------------------------------------------- the fall


class Fall(NamedTuple):
    """The humanoid in the air, bent and moving, and what is asked of its end."""

    model: Model
    q: np.ndarray
    qd: np.ndarray
    times: np.ndarray  # (knots,) [s]
    torques: np.ndarray  # (knots, joints) [N m]
    weights: np.ndarray  # (2, joints)

    def in_steps(self) -> np.ndarray:
        """Return what each knot adds to the torques of each step (steps, knots)."""
        middle = STEP * (np.arange(STEPS) + 0.5)
        return np.array([np.interp(middle, self.times, one) for one in np.eye(len(self.times))]).T


def falling(knots: int) -> list[Timed]:
    """Prepare gradients by torques at so many knots."""
    model = load_robot("humanoid")
    free = tuple(replace(joint, damping=0.0, friction=0.0) for joint in model.joints)
    model = bounded(replace(model, joints=free, servos={}, contacts=()))
    rng, n = np.random.default_rng(0), len(model.joint_names)
    lower, upper = np.array([(joint.lower, joint.upper) for joint in model.moving_joints]).T
    bent = 0.5 * (lower + upper) + 0.05 * (upper - lower) * rng.uniform(-1.0, 1.0, n)
    q = np.concatenate([[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], bent])
    fall = Fall(
        model, q, 0.1 * rng.normal(size=n + 6), np.linspace(0.0, STEP * STEPS, knots),
        1e-3 * rng.normal(size=(knots, n)), rng.normal(size=(2, n)),
    )  # fmt: skip
    timed = _own(fall)
    timed += _of_mujoco(fall) if installed("mujoco") else []
    return timed + (_of_pinocchio(fall) if installed("pinocchio") else [])


def _own(fall: Fall) -> list[Timed]:
    scene = compile_scene(fall.model, integrator="implicit_euler", timestep=STEP)
    state, span = initial_state(scene, fall.q, fall.qd), STEP * STEPS
    compiled = prepare(scene, span, ("q", "qd"), span)

    def cost(channels: Any) -> tuple[float, dict[str, np.ndarray]]:
        by = {name: np.zeros(channels[name].shape) for name in ("q", "qd")}
        by["q"][-1], by["qd"][-1] = fall.weights
        return float(sum(np.sum(by[name] * channels[name]) for name in by)), by

    def exact() -> np.ndarray:
        tau = Reference(fall.times, fall.torques)
        return gradient(scene, span, cost, ["tau"], state, None, tau, (), ("q", "qd"), span)["tau"]

    def values(torques: np.ndarray) -> np.ndarray:
        taus = [Reference(fall.times, one) for one in torques]
        runs = simulate_batch(
            scene, span, [state] * len(taus), None, taus, record=("q", "qd"), record_interval=span, estimate_error=False
        )
        return np.array([cost(one)[0] for one in runs])

    def one() -> object:
        return compiled.run([compiled.start(state, None, Reference(fall.times, fall.torques))])

    true = _extrapolated(values, fall.torques, WIDE)
    return [
        _row("fall", "gradient", exact, true, one),
        _row("fall", "differences in lanes", lambda: _differences(values, fall.torques, USUAL), true, one),
    ]


def _of_mujoco(fall: Fall) -> list[Timed]:
    m = check_order(mujoco.MjModel.from_xml_string(mjcf_text(fall.model)[0]), fall.model)
    m.opt.timestep, m.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_EULER
    disable(m, "CONTACT", "CONSTRAINT", "DAMPER", "ACTUATION")
    d, share, n = mujoco.MjData(m), fall.in_steps(), len(fall.model.joint_names)
    A, B = np.zeros((2 * m.nv, 2 * m.nv)), np.zeros((2 * m.nv, 0))

    def value(torques: np.ndarray, each: Callable[[], None] = lambda: None) -> float:
        mujoco.mj_resetData(m, d)
        d.qpos[:], d.qvel[:] = fall.q, fall.qd
        for tau in share @ torques:
            d.qfrc_applied[6:] = tau
            each()
            mujoco.mj_step(m, d)
        return float(np.sum(fall.weights[0] * d.qpos[7:]) + np.sum(fall.weights[1] * d.qvel[6:]))

    def values(torques: np.ndarray) -> np.ndarray:
        return np.array([value(one) for one in torques])

    def by_steps() -> np.ndarray:
        found: list[tuple[np.ndarray, np.ndarray]] = []

        def note() -> None:
            mujoco.mjd_transitionFD(m, d, USUAL, True, A, B, None, None)
            inverse = np.zeros((m.nv, m.nv))
            mujoco.mj_forward(m, d)
            mujoco.mj_solveM(m, d, inverse, np.eye(m.nv))
            found.append((A.copy(), inverse))

        value(fall.torques, note)
        adjoint = np.concatenate([np.zeros(6), fall.weights[0], np.zeros(6), fall.weights[1]])
        by_tau = np.zeros((STEPS, n))
        for k in reversed(range(STEPS)):
            step, inverse = found[k]
            by_tau[k] = STEP * (inverse @ (adjoint[m.nv :] + STEP * adjoint[: m.nv]))[6:]
            adjoint = step.T @ adjoint
        return share.T @ by_tau

    true = _extrapolated(values, fall.torques, WIDE)
    one = lambda: value(fall.torques)  # noqa: E731
    return [
        _row("fall", "MuJoCo, differences of runs", lambda: _differences(values, fall.torques, USUAL), true, one),
        _row("fall", "MuJoCo, mjd_transitionFD backwards", by_steps, true, one),
    ]


def _of_pinocchio(fall: Fall) -> list[Timed]:
    m = in_pinocchio(fall.model)
    d, share, n = m.createData(), fall.in_steps(), len(fall.model.joint_names)
    order = np.array([m.joints[m.getJointId(name)].idx_v - 6 for name in fall.model.joint_names])
    start = np.concatenate([fall.q[:3], fall.q[4:7], fall.q[3:4], np.zeros(n)])
    start[7 + order] = fall.q[7:]
    rates = np.concatenate([fall.qd[:6], np.zeros(n)])
    rates[6 + order] = fall.qd[6:]

    def path(torques: np.ndarray) -> tuple[list[Any], np.ndarray, np.ndarray]:
        q, v, states, tau = start, rates, [], np.zeros(m.nv)
        for row in share @ torques:
            tau = np.zeros(m.nv)
            tau[6 + order] = row
            next_v = v + STEP * pin.aba(m, d, q, v, tau)
            states.append((q, v, tau, next_v))
            q, v = pin.integrate(m, q, STEP * next_v), next_v
        return states, q, v

    def values(torques: np.ndarray) -> np.ndarray:
        ends = np.array([(q[7 + order], v[6 + order]) for _, q, v in map(path, torques)])
        return np.sum(fall.weights * ends, axis=(1, 2))

    def by_steps() -> np.ndarray:
        states, _, _ = path(fall.torques)
        by_q, by_v, by_tau = np.zeros(m.nv), np.zeros(m.nv), np.zeros((STEPS, n))
        by_q[6 + order], by_v[6 + order] = fall.weights
        for k in reversed(range(STEPS)):
            q, v, tau, next_v = states[k]
            by_position, by_rate, inverse = pin.computeABADerivatives(m, d, q, v, tau)
            from_q, from_v = pin.dIntegrate(m, q, STEP * next_v)
            both = by_v + STEP * (from_v.T @ by_q)
            by_tau[k] = STEP * (inverse @ both)[6 + order]
            by_q, by_v = from_q.T @ by_q + STEP * (by_position.T @ both), both + STEP * (by_rate.T @ both)
        return share.T @ by_tau

    true, one = _extrapolated(values, fall.torques, WIDE), lambda: path(fall.torques)
    return [_row("fall", "Pinocchio, computeABADerivatives backwards", by_steps, true, one)]


# ---------------------------------------------------------------------------------------------- the walk


def _walk() -> list[Timed]:
    """Prepare gradients of energy per distance by the poses of the first gait."""
    cost = walking_cost(load_robot("humanoid", locked="simplified"))
    x = cost.gait.to_vector()

    def values(vectors: np.ndarray) -> np.ndarray:
        return np.array([value for value, _ in cost.costs(vectors)])

    true = _extrapolated(values, x, WALKING[1])
    one = lambda: cost.costs([x])  # noqa: E731
    timed = [_row("walk", "cost_and_gradient", lambda: cost_and_gradient(cost, x, 1)[1], true, one)]
    for width in WALKING:
        call = functools.partial(_differences, values, x, width)
        timed.append(_row("walk", f"differences in lanes of {width:g} rad", call, true, one))
    return timed
