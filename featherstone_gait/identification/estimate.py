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
LAGS, DENSE = 24, 0.95  # of autocorrelations that are estimated; one from which on every second lag is enough
RANK = 1e-10  # of singular values relative to the largest, below which they count as zero


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
    meat, independent = _meat(Z, e, lengths)
    outer = np.outer(scale, scale)
    textbook = bread * (e @ e) / max(len(e) - J.shape[1], 1) / outer
    return textbook, bread @ meat @ bread / outer, independent


def information(J: np.ndarray, e: np.ndarray, lengths: Sequence[int]) -> tuple[np.ndarray, float]:
    """Return the inverse of the covariance for autocorrelated residuals, and the number of independent samples.

    It is zero in directions about which the errors say nothing, where a covariance would be infinite.
    """
    Z, scale = _scaled(J)
    meat, independent = _meat(Z, e, lengths)
    H = Z.T @ Z
    return H @ np.linalg.pinv(meat, hermitian=True) @ H * np.outer(scale, scale), independent


def _scaled(J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return columns of norm one, and their norms; those of columns of zeros are one."""
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    return J / scale, scale


def _meat(Z: np.ndarray, e: np.ndarray, lengths: Sequence[int]) -> tuple[np.ndarray, float]:
    """Return Z'VZ, V the covariance of the noise, and how many independent samples tell its variance as well.

    All signals have one autocorrelation, and the variance of all together, or their own where that is larger.
    """
    from scipy.signal import fftconvolve  # slow to import

    U, s, _ = np.linalg.svd(Z, full_matrices=False)
    Q, cuts = U[:, s > RANK * s.max(initial=0.0)], np.cumsum(lengths)[:-1]
    degrees = [max(len(q) - float(np.sum(q * q)), 1.0) for q in np.split(Q, cuts)]
    variances = np.array([x @ x for x in np.split(e, cuts)]) / degrees
    whole = (e @ e) / max(len(e) - Q.shape[1], 1)
    if not whole > 0.0:
        return 0.0 * (Z.T @ Z), float(len(e))
    each = np.repeat(np.sqrt(np.maximum(variances, whole)), lengths)[:, None]
    g = _autocovariance(e / each[:, 0], Q / each, Q * each, lengths)
    kernel = np.concatenate([g[:0:-1], g])[:, None]
    meat = sum(x.T @ fftconvolve(kernel, x, axes=0)[len(g) - 1 :][: len(x)] for x in np.split(Z * each, cuts))
    return np.asarray(meat), len(e) / (1.0 + 2.0 * float(np.sum((g[1:] / g[0]) ** 2)))


def _autocovariance(u: np.ndarray, A: np.ndarray, B: np.ndarray, lengths: Sequence[int]) -> np.ndarray:
    """Return autocovariances of the noise (longest,) of which a fit has left the residuals u = (I - A B') noise.

    A fit takes away the slow part of the noise most of all.  So autocovariances g of the noise at the first lags solve
    u'T_i u = sum over j of trace(T_i (I - A B') T_j (I - A B')') g_j, T_i the matrix of lag i (K. Worsley et al.,
    NeuroImage 15 (2002), doi 10.1006/nimg.2001.0933); those of longer lags go on as an autoregression, whose order has
    the least value of Akaike's criterion.
    """
    cuts, count = np.cumsum(lengths)[:-1], len(u)

    def lagged(x: np.ndarray, lag: int) -> np.ndarray:
        found = np.zeros_like(x)
        for part, one in zip(np.split(found, cuts), np.split(x, cuts)):
            part[lag:] += one[: max(len(one) - lag, 0)]
            part[: max(len(one) - lag, 0)] += one[lag:]
        return found if lag else x

    def raw(lag: int) -> float:
        return float(u @ lagged(u, lag) / (u @ u) / 2.0)

    stride = 1  # what is sampled far more often than it changes is looked at less often
    while raw(2 * stride) > DENSE and 2 * stride * LAGS < max(lengths):
        stride *= 2
    lags = [k * stride for k in range(LAGS + 1) if k == 0 or k * stride < max(lengths)]
    At, Bt = ([lagged(X, lag) for lag in lags] for X in (A, B))
    pairs = [sum(2.0 * max(n - lag, 0) for n in lengths) if lag else float(count) for lag in lags]
    G = np.diag(pairs) - 2.0 * np.array([[np.sum(a * b) for b in Bt] for a in At])
    G += np.array([[np.sum((A.T @ a) * (B.T @ b).T) for b in Bt] for a in At])
    g = np.linalg.lstsq(G, np.array([u @ lagged(u, lag) for lag in lags]), rcond=RANK)[0]
    g = _continued(g, count / stride, -(-max(lengths) // stride) + 1)
    return np.interp(np.arange(max(lengths)), stride * np.arange(len(g)), g)


def _continued(g: np.ndarray, count: float, length: int) -> np.ndarray:
    """Return autocovariances (length,) that go on from the first ones as a stable autoregression."""
    from scipy.linalg import solve_toeplitz

    best, found = count * math.log(max(g[0], 1e-300)), np.zeros(0)
    for order in range(1, 2 * len(g) // 3):
        try:
            phi = solve_toeplitz(g[:order], g[1 : order + 1])
        except np.linalg.LinAlgError:
            break
        left = float(g[0] - phi @ g[1 : order + 1])
        if left <= 0.0 or np.abs(np.roots([1.0, *-phi])).max() >= 1.0:
            break
        criterion = count * math.log(left) + 2.0 * order
        if criterion < best:
            best, found = criterion, phi
    whole = np.zeros(length)
    whole[: len(found) + 1] = g[: len(found) + 1][:length]
    for k in range(len(found) + 1, length if len(found) else 0):
        whole[k] = found @ whole[k - len(found) : k][::-1]
    return whole


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
