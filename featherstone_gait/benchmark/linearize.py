"""Time `linearize` beside MuJoCo's `mjd_transitionFD`, by column and simulated millisecond, with the errors.

The humanoid goes to MuJoCo as MJCF (`robot_file.mjcf`).  Falling freely under torques, without friction, both make the
same steps of semi-implicit Euler.  The matrices are compared with the extrapolation of MuJoCo's differences from two
larger widths, which both must meet.  Standing, each robot stands on its own ground, by its own servos.  There
MuJoCo's error is counted from its own extrapolation, and ours is its own estimate.  An error is that of an entry by the
largest in its row, where columns count by the radian, meter, newton meter, and their rates; the table has the worst.

All is timed in turn in one process, on one thread, everything that a call of `linearize` does included: medians of CPU
time.  `mjd_transitionFD` is called centered (one-sided it takes half the time and is wrong by the width) with its usual
1e-6, and without the Python package's clock.

    featherstone-gait benchmark linearize        two minutes
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..analysis.equilibrium import trim
from ..analysis.linearization import Linearization, linearize
from ..model import Ground, Model
from ..robot_file import load_robot
from ..robot_file.mjcf.write import mjcf_text
from ..run.simulate import initial_state
from ..scene.compile import GearboxKind, IntegratorName, compile_scene
from .engines import check_order, disable, mujoco, quick_mujoco
from .table import in_turn, installed, machine, spread, tabulate

REPEATS, REPEATS_FULL = 11, 41
METHODS: tuple[IntegratorName, ...] = ("implicit_euler", "midpoint")
GEARBOXES: tuple[GearboxKind, ...] = ("rotor", "mipsd")
STEP = 1e-3  # [s]
USUAL, WIDE = 1e-6, 2e-4  # widths of MuJoCo's differences, as usual and of the larger one that is extrapolated from
STIFF_WIDE = 2e-6  # the same on the ground
SETTLING = 3000  # steps in which MuJoCo's robot comes to rest
WITHOUT = "no MuJoCo: install it with pip install featherstone-gait[mjcf]"


class Row(NamedTuple):
    """One line of the table."""

    scene: Annotated[str, "scene", "<11"]
    method: Annotated[str, "method", "<33"]
    columns: Annotated[int, "columns", "7"]  # states and inputs
    period: Annotated[float, "ms", "4.0f"]  # [ms]
    error: Annotated[float, "error", "9.1e"]
    time: Annotated[float, "us", "8.2f"] = math.nan  # of a column and simulated millisecond, median [us]
    spread: Annotated[float, "spread", "7.0%"] = math.nan  # of the quartiles, relative to the median
    ratio: Annotated[float, "ratio", "6.2f"] = math.nan  # time by that of MuJoCo, NaN without


Prepared = tuple[Row, Callable[[], object]]  # a row without times, and what is to be timed


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Time everything, print the table, write linearize.csv; `full` repeats more."""
    host, model, repeats = machine(), load_robot("humanoid"), REPEATS_FULL if full else REPEATS
    print(host)
    if not installed("mujoco"):
        print(WITHOUT)
    rows = (row for prepared in (_falling, _standing) for row in _timed(prepared(model), repeats))
    return tabulate(out_dir / "linearize.csv", Row, rows, host)


def _falling(model: Model) -> list[Prepared]:
    """Prepare the humanoid in the air, bent and moving, under torques."""
    free = tuple(replace(joint, damping=0.0, friction=0.0) for joint in model.joints)
    model = replace(model, joints=free, servos={}, contacts=())
    scene = compile_scene(model, integrator="implicit_euler", timestep=STEP)
    rng, n = np.random.default_rng(0), scene.tree.n
    lower, upper = np.array([(joint.lower, joint.upper) for joint in model.moving_joints]).T
    margin = 0.1 * (upper - lower)  # no stop is met
    bent = np.clip(0.3 * rng.normal(size=n), lower + margin, upper - margin)
    q = np.concatenate([[0.1, 0.2, 0.3, 0.9, 0.1, 0.3, -0.2], bent])
    q[3:7] /= np.linalg.norm(q[3:7])
    qd, tau = rng.normal(size=n + 6), 0.1 * rng.normal(size=n)
    state = initial_state(scene, q, qd)

    prepared, exact = [], None
    if installed("mujoco"):
        m, d = _mujoco(model, None)
        m.opt.integrator = 0  # semi-implicit Euler
        disable(m, "CONTACT", "CONSTRAINT", "DAMPER", "ACTUATION")
        d.qpos[:], d.qvel[:], d.qfrc_applied[6:] = q, qd, tau
        timer, exact = _mujoco_timer("falling", m, d, WIDE)
        prepared.append(timer)
    for steps in (1, 10):
        call = partial(linearize, scene, state, tau=tau, steps=steps, threads=1)
        method = f"linearize, {steps} step{'s' * (steps > 1)}"
        prepared.append(_own("falling", method, call, exact if steps == 1 else None))
    return prepared


def _standing(model: Model) -> list[Prepared]:
    """Prepare the humanoid on both soles, held by servos; ours with gearboxes, motors, bristles and ticks."""
    prepared = []
    if installed("mujoco"):
        m, d = _mujoco(model, Ground())
        m.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        d.qpos[2] = trim(compile_scene(model, "mipsd", Ground(), "midpoint", STEP)).q[2]
        for _ in range(SETTLING):
            mujoco.mj_step(m, d)
        prepared.append(_mujoco_timer("standing", m, d, STIFF_WIDE)[0])
    for gearbox, integrator in product(GEARBOXES, METHODS):
        scene = compile_scene(model, gearbox, Ground(), integrator, STEP)
        rest = trim(scene)
        call = partial(linearize, scene, rest.state, rest.reference, threads=1)
        prepared.append(_own("standing", f"linearize, {gearbox}, {integrator}", call))
    return prepared


def _own(scene: str, method: str, call: Callable[[], Linearization], exact: np.ndarray | None = None) -> Prepared:
    """Prepare `linearize`, whose error is its own estimate where the exact matrix is not known."""
    found = call()
    error = _relative(found.A_error, found.A) if exact is None else _relative(found.A - exact, exact)
    return Row(scene, method, len(found.states) + len(found.inputs), 1e3 * found.period, error), call


def _mujoco(model: Model, ground: Ground | None) -> tuple[Any, Any]:
    m = check_order(mujoco.MjModel.from_xml_string(mjcf_text(model, ground)[0]), model)
    m.opt.timestep = STEP
    return m, mujoco.MjData(m)


def _mujoco_timer(scene: str, m: Any, d: Any, wide: float) -> tuple[Prepared, np.ndarray]:
    """Prepare `mjd_transitionFD`; return it with its extrapolation from two larger widths."""
    size = 2 * m.nv + m.na
    A, B = np.zeros((size, size)), np.zeros((size, m.nu))

    def call(width: float = USUAL) -> np.ndarray:
        mujoco.mjd_transitionFD(m, d, width, True, A, B, None, None)
        return A.copy()

    coarse, fine = call(wide), call(0.5 * wide)
    exact = (4.0 * fine - coarse) / 3.0
    error = _relative(call() - exact, exact)
    return (Row(scene, "mjd_transitionFD, centered", size + m.nu, 1e3 * STEP, error), call), exact


def _relative(error: np.ndarray, A: np.ndarray) -> float:
    """Return the largest error of an entry, by the largest entry in its row."""
    return float((np.abs(error) / np.abs(A).max(axis=1, keepdims=True)).max())


def _timed(prepared: list[Prepared], repeats: int) -> list[Row]:
    """Time all in turn."""
    rows, calls = zip(*prepared)
    with quick_mujoco() if installed("mujoco") else nullcontext():
        times = in_turn(calls, repeats, time.process_time).T
    medians, spreads = spread(times * 1e6 / np.array([[row.columns * row.period] for row in rows]))
    ratios = np.array(medians) / (medians[0] if installed("mujoco") else math.nan)
    return [row._replace(time=a, spread=b, ratio=float(c)) for row, a, b, c in zip(rows, medians, spreads, ratios)]
