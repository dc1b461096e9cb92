"""The gradient of the cost of walking by the poses of the gait, from one run forwards and one backwards a world.

    best = scipy.optimize.minimize(lambda x: cost_and_gradient(cost, x), x0, jac=True, method="L-BFGS-B")

The reference is linear in the poses, so that its derivatives by them are exact; those of a posture at the start, where
it depends on the poses, are extrapolated differences of `standing_state` (analysis/run_inputs.py).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.gradient import Along, Doubter, Gradient, differentiated, warn_of_doubts
from ..analysis.gradient_check import Given, How
from ..analysis.run_inputs import CENTRAL, WIDTH, slope
from ..base.arguments import instance, vector
from ..core.effects.energies import METER
from ..run.simulate import standing_state
from ..scene.compile import CompiledScene
from .cost import WalkingCost, measured, window_of
from .cost_in_worlds import RECORD, CostInWorlds, with_chatter
from .gait import TICK


def cost_and_gradient(
    cost: WalkingCost | CostInWorlds, x: ArrayLike, threads: int | None = None
) -> tuple[float, np.ndarray]:
    """Compute energy per distance of a gait, and its gradient by the gait vector.

    Parameters
    ----------
    cost
        The cost on one ground, or in several worlds: the mean, and a share of what the worst exceeds it by.
    x
        Gait vector (D,) [rad].
    threads
        Number of threads, over which worlds are spread; None: one for each core.

    Returns
    -------
    value : float
        The cost [J/m], as `costs` gives it: infinite for a gait that does not walk, in all worlds.
    gradient : ndarray, shape (D,)
        Its derivatives [J/m/rad]; nan where it is infinite.

    Raises
    ------
    ValueError
        For a vector of another length, and scenes without gradients.

    Warns
    -----
    RuntimeWarning
        At the first gradient of a cost that is doubtful: see `featherstone_gait.gradient`.
    """
    instance("cost", cost, (WalkingCost, CostInWorlds), "give a WalkingCost, or what in_worlds makes of one")
    one = cost if isinstance(cost, WalkingCost) else cost.cost
    x = vector("x", x, len(one.gait.to_vector()), "[rad]")
    signal, by_pose = one.reference(x, one.warm_up + one.strides), _slopes_of_reference(one)
    scenes = [one.scene] if isinstance(cost, WalkingCost) else [*cost.scenes]
    offsets = np.zeros((1, len(signal.values[0]))) if isinstance(cost, WalkingCost) else cost.offsets
    states = [_standing(scene, signal.values[0] + off) for scene, off in zip(scenes, offsets)]
    moves = bool(by_pose[:, 0].any())  # the first posture, and with it the state at the start
    runs = [Given(scene, state, signal) for scene, state in zip(scenes, states)]
    how, names = How(one.end, (), RECORD, TICK), ["reference", *["state"] * moves]
    found = differentiated(runs, how, _meter_of(one), names, threads)
    values, slopes = [], []
    for scene, off, each in zip(scenes, offsets, found):
        run = each.trajectory if isinstance(cost, WalkingCost) or cost.strict else with_chatter(each.trajectory)
        values.append(measured(scene, run, one.mark, one.end, one.strides, slip=False).cost)
        slopes.append(np.einsum("xki,ki->x", by_pose, each["reference"]))
        if moves:
            slopes[-1] += _by_posture(scene, signal.values[0] + off, by_pose[:, 0], each)
    doubted = []
    for scene, off, each, by in zip(scenes, offsets, found, slopes):

        def moved(step: np.ndarray, scene: CompiledScene = scene, off: np.ndarray = off) -> Given:
            other = one.reference(x + step, one.warm_up + one.strides)
            return Given(scene, _standing(scene, other.values[0] + off), other)

        doubted.append(replace(each, _along=Along(by, moved)))
    doubter = _doubter_of(cost)
    doubter.found |= warn_of_doubts(doubter.fresh(doubted, threads), threads)
    if isinstance(cost, WalkingCost):
        value, total = values[0], slopes[0]
    else:
        value, worst = cost.combined(values)[0], slopes[int(np.argmax(values))]
        mean = np.mean(slopes, axis=0)
        total = mean + cost.penalty * (worst - mean)
    return value, total if np.isfinite(value) else np.full(len(x), np.nan)


def _standing(scene: CompiledScene, angles: np.ndarray) -> np.ndarray:
    return standing_state(scene, angles, allow_limit_violation=True)


def _by_posture(scene: CompiledScene, angles: np.ndarray, by_pose: np.ndarray, found: Gradient) -> np.ndarray:
    """Return the derivatives by the vector by way of the first posture: by_pose (D, joints)."""
    middle, by_angle = _standing(scene, angles), np.zeros(len(angles))
    for k in range(len(angles)):
        each = [_standing(scene, angles + share * WIDTH * (np.arange(len(angles)) == k)) for share in CENTRAL[0]]
        by_angle[k] = np.sum(slope(each, middle, WIDTH) * found["state"])
    return np.einsum("xi,i->x", by_pose, by_angle)


@functools.lru_cache(maxsize=8)
def _doubter_of(cost: WalkingCost | CostInWorlds) -> Doubter:
    """Return what looks for doubts in all gradients of a cost."""
    return Doubter()


@functools.lru_cache(maxsize=8)
def _slopes_of_reference(cost: WalkingCost) -> np.ndarray:
    """Return the derivatives (D, knots, joints) of the reference by the gait vector, in which it is linear."""
    x, strides = np.zeros(len(cost.gait.to_vector())), cost.warm_up + cost.strides
    base = cost.reference(x, strides).values
    return np.array([cost.reference(row, strides).values - base for row in np.eye(len(x))])


@functools.lru_cache(maxsize=8)
def _meter_of(cost: WalkingCost) -> Callable[[Mapping[str, np.ndarray]], Any]:
    """Return energy per distance and its derivatives by channel, as `measured` computes it."""

    def energy_per_distance(channels: Mapping[str, np.ndarray]) -> tuple[float, dict[str, np.ndarray]]:
        window = window_of(channels, cost.mark, cost.end)  # type: ignore[arg-type]
        ends, signs = (window.start, window.stop - 1), (-1.0, 1.0)
        spent = np.sum(channels["energy"][ends[1], :, METER] - channels["energy"][ends[0], :, METER])
        ahead = channels["base_q"][ends[1], 0] - channels["base_q"][ends[0], 0]
        by_energy, by_base = np.zeros(channels["energy"].shape), np.zeros(channels["base_q"].shape)
        for end, sign in zip(ends, signs):
            by_energy[end, :, METER] = sign / ahead
            by_base[end, 0] = -sign * spent / ahead**2
        return float(spent / ahead), {"energy": by_energy, "base_q": by_base}

    return energy_per_distance
