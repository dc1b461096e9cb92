"""The least-squares core of both fits: errors and their slopes, covariances, and what a fit found.

Covariances allow for residuals that are correlated over time; `identification.fit` describes the method.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.brief import brief
from ..view.style import BLUE, ORANGE, look

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Blocks = list[np.ndarray]  # errors of each recording


class Errors:
    """Errors of all recordings as a function of the parameters, with slopes by finite differences.

    `simulated` takes points (n,) and returns the errors of each recording at each of them; `progress` is called once
    for each new point.
    """

    def __init__(
        self, simulated: Callable[[Sequence[np.ndarray]], list[Blocks]], progress: Callable[[], object]
    ) -> None:
        self._simulated, self._progress = simulated, progress
        self._known: dict[bytes, Blocks] = {}  # of the last points
        self.evaluations = 0

    def simulated(self, points: Sequence[np.ndarray]) -> list[Blocks]:
        """Return the errors of each recording at each point."""
        self.evaluations += len(points)
        self._progress()
        return self._simulated(points)

    def blocks(self, x: np.ndarray) -> Blocks:
        """Return the errors of each recording at a point; those of the last points are kept."""
        key = x.tobytes()
        if key not in self._known:
            (errors,) = self.simulated([x])
            self._known = dict(list(self._known.items())[-2:]) | {key: errors}
        return self._known[key]

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the errors of all recordings at a point (errors,)."""
        return np.concatenate(self.blocks(x))

    def slopes(self, x: np.ndarray, steps: np.ndarray, central: bool = False, own: int = 0) -> np.ndarray:
        """Return the Jacobian (errors, n) by differences with steps (n,), forward or central.

        The last `own` parameters move one recording each, so one step of all of them together is enough.
        """
        from scipy.linalg import block_diag  # slow to import

        shared = len(x) - own
        moves = [*(np.diag(steps)[:shared]), *([steps * (np.arange(len(x)) >= shared)] if own else [])]
        ahead = self.simulated([x + move for move in moves])
        behind = self.simulated([x - move for move in moves]) if central else [self.blocks(x)] * len(moves)
        differences = [[a - b for a, b in zip(*both)] for both in zip(ahead, behind)]
        width = (2.0 if central else 1.0) * steps
        columns = [np.concatenate(blocks) / width[k] for k, blocks in enumerate(differences[:shared])]
        starts = [block_diag(*(b[:, None] for b in differences[-1])) / width[shared:]] if own else []
        return np.column_stack([*columns, *starts])


def covariances(J: np.ndarray, e: np.ndarray, lengths: Sequence[int]) -> tuple[np.ndarray, np.ndarray, float]:
    """Return covariances for independent and for autocorrelated residuals, and the number of independent samples.

    J (errors, parameters); e (errors,), whose parts of these lengths are signals over time.
    """
    # A parameter without effect has no finite variance: a tiny eigenvalue makes it huge instead of failing.
    Z, scale = _scaled(J)
    bread = np.linalg.pinv(Z.T @ Z + 1e-14 * np.eye(J.shape[1]), hermitian=True)
    degrees = max(len(e) - J.shape[1], 1)
    meat, independent = _meat(Z, e, lengths)
    outer = np.outer(scale, scale)
    textbook = bread * (e @ e) / degrees / outer
    robust = bread @ meat @ bread * (len(e) / degrees) / outer
    return textbook, robust, independent


def information(J: np.ndarray, e: np.ndarray, lengths: Sequence[int]) -> tuple[np.ndarray, float]:
    """Return the inverse of the covariance for autocorrelated residuals, and the number of independent samples.

    It is zero in directions about which the errors say nothing, where a covariance would be infinite.
    """
    Z, scale = _scaled(J)
    meat, independent = _meat(Z, e, lengths)
    H = Z.T @ Z
    share = max(len(e) - J.shape[1], 1) / len(e)
    return share * H @ np.linalg.pinv(meat, hermitian=True) @ H * np.outer(scale, scale), independent


def _scaled(J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return columns of norm one, and their norms; those of columns of zeros are one."""
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    return J / scale, scale


def _meat(Z: np.ndarray, e: np.ndarray, lengths: Sequence[int]) -> tuple[np.ndarray, float]:
    """Return the sum of e_i e_j Z_i'Z_j over neighbors, and the number of independent samples."""
    signals = np.split(e, np.cumsum(lengths)[:-1])
    scores = np.split(Z * e[:, None], np.cumsum(lengths)[:-1])
    bandwidth = _bandwidth([_autocorrelation([s[:, k] for s in scores], 1) for k in range(Z.shape[1])], lengths)
    meat, sum_of_rho = sum(s.T @ s for s in scores), 0.0
    for lag in range(1, bandwidth + 1):
        weight = 1.0 - lag / (bandwidth + 1.0)
        cross = sum(s[lag:].T @ s[:-lag] for s in scores)
        meat = meat + weight * (cross + cross.T)
        sum_of_rho += weight * _autocorrelation(signals, lag)
    return np.asarray(meat), len(e) / max(1.0 + 2.0 * sum_of_rho, 1.0)


def _autocorrelation(signals: Sequence[np.ndarray], lag: int) -> float:
    power = sum(s @ s for s in signals)
    return float(sum(s[lag:] @ s[:-lag] for s in signals) / power) if power > 0 else 0.0


def _bandwidth(correlations: Sequence[float], lengths: Sequence[int]) -> int:
    """Return the lags to keep: Andrews (1991), (6.2) and (6.4), for first-order processes and Bartlett's weights."""
    rho = np.minimum(np.abs(correlations), 0.97)
    alpha = float(np.mean(4.0 * rho**2 / (1.0 - rho**2) ** 2))
    return min(math.ceil(1.1447 * (alpha * sum(lengths)) ** (1.0 / 3.0)), min(lengths) // 4)


def quantile(confidence: float, degrees: float) -> float:
    """Return the two-sided quantile of Student's t for so many degrees of freedom."""
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * confidence, max(degrees, 1.0)))


# ---------------------------------------------------------------------------------------------- what a fit found


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters that were fitted to recordings; dictionaries and arrays are in the order of the parameters.

    Attributes
    ----------
    values, start : dict of str to float
        Fitted values, and values at which the search started [SI].
    intervals : dict of str to (float, float)
        Confidence intervals of the values.
    units : dict of str to str
    confidence : float
        Probability of the intervals.
    correlation : (parameters, parameters) ndarray
        Correlation of the estimates.
    recordings : tuple
    angles : tuple of (k,) ndarray
        Simulated angle at the times of each recording [rad].
    message : str
        How the search ended.
    """

    values: dict[str, float]
    start: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    units: dict[str, str]
    confidence: float
    correlation: np.ndarray
    recordings: tuple[Any, ...]
    angles: tuple[np.ndarray, ...]
    message: str

    __repr__ = brief

    @property
    def residuals(self) -> tuple[np.ndarray, ...]:
        """Simulated less recorded angle of each recording [rad]."""
        return tuple(angle - recording.angle for angle, recording in zip(self.angles, self.recordings))

    @property
    def rms(self) -> np.ndarray:
        """Root mean square of the residuals of each recording [rad]."""
        return np.array([math.sqrt(np.mean(e**2)) for e in self.residuals])

    @property
    def errors(self) -> np.ndarray:
        """Mean absolute residual of each recording [rad]."""
        return np.array([np.abs(e).mean() for e in self.residuals])

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters about which the recordings say little."""
        return ()

    def correlated(self, most: int = 3) -> list[tuple[str, str, float]]:
        """Return the pairs of parameters with the largest correlations."""
        names = list(self.values)
        pairs = [(a, b, float(self.correlation[i, j])) for j, b in enumerate(names) for i, a in enumerate(names[:j])]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))[:most]

    def table(self) -> list[str]:
        """Return the parameters as lines of text."""
        lines = [f"{'parameter':24} {'start':>10} {'value':>10} {f'{self.confidence:.0%} interval':>24}  unit"]
        for name, value in self.values.items():
            low, high = self.intervals[name]
            interval = "not determined" if name in self.undetermined else f"{low:.4g} to {high:.4g}"
            lines.append(f"{name:24} {self.start[name]:10.4g} {value:10.4g} {interval:>24}  {self.units[name]}")
        return lines

    def plot(self) -> Figure:
        """Draw reference, recorded and simulated angle of each recording, and the residual below."""
        return plot_rollouts(self.recordings, self.angles)


@look()
def plot_rollouts(recordings: Sequence[Any], angles: Sequence[np.ndarray]) -> Figure:
    """Draw reference, recorded and simulated angle of each recording [deg], and simulated less recorded below.

    Parameters
    ----------
    recordings : sequence of Recording or BenchRecording
    angles : sequence of (k,) ndarray
        Simulated angles at the times of each recording [rad], such as those of a fit or of `ServoFit.predict`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    columns = min(4, len(recordings))
    rows = -(-len(recordings) // columns)
    figure = Figure(figsize=(3.4 * columns, 2.9 * rows), layout="constrained")
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=[2.0, 1.0] * rows)
    for k, (r, angle) in enumerate(zip(recordings, angles)):
        row, column = divmod(k, columns)
        above = figure.add_subplot(grid[2 * row, column])
        below = figure.add_subplot(grid[2 * row + 1, column], sharex=above)
        above.plot(r.time, np.degrees(r.reference), color="0.7", linewidth=1.0, label="reference")
        above.plot(r.time, np.degrees(r.angle), color=BLUE, linewidth=2.4, label="recorded")
        above.plot(r.time, np.degrees(angle), color=ORANGE, linewidth=1.0, label="simulated")
        below.plot(r.time, np.degrees(angle - r.angle), color="0.3", linewidth=0.7)
        above.set_title(f"{r.name}\n{1e3 * np.abs(angle - r.angle).mean():.1f} mrad", fontsize=8, parse_math=False)
        above.tick_params(labelbottom=False)
        if column == 0:
            above.set_ylabel("angle [deg]")
            below.set_ylabel("error [deg]")
        if row == rows - 1:
            below.set_xlabel("time [s]")
        if k == 0:
            figure.legend(*above.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
