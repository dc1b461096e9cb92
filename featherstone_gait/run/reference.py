"""Describe references and torques over time by knots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, instance, one_of
from ..base.brief import brief
from ..core.step.signals import Knots

LATEST = 1e12  # knot [s]

ReferenceKind = Literal["hold", "linear", "cubic"]


@dataclass(frozen=True, eq=False)
class Reference:
    """A signal of n components over time, given at knots.

    Outside its knots a signal keeps its end values, unless it is cyclic.

    Attributes
    ----------
    times : ndarray
        Rising times of the knots (k,) [s].
    values : ndarray
        Values at the knots (k, n) [rad or m, N m or N].
    kind : {"linear", "hold", "cubic"}
        "hold" keeps each value until the next knot; "linear" and "cubic" (a C2 spline, natural at its ends)
        interpolate.
    cyclic : bool
        Repeat the signal after the last knot, whose value must be that of the first.

    Raises
    ------
    ValueError
        For shapes that do not fit, times that do not rise, and values that are not finite.

    Examples
    --------
    >>> Reference([0.0, 1.0], [[0.0, 0.0], [0.5, -0.5]], kind="cubic")
    """

    times: np.ndarray
    values: np.ndarray
    kind: ReferenceKind = "linear"
    cyclic: bool = False

    __repr__ = brief

    if TYPE_CHECKING:

        def __init__(
            self, times: ArrayLike, values: ArrayLike, kind: ReferenceKind = "linear", cyclic: bool = False
        ) -> None: ...

    def __post_init__(self) -> None:
        times, values = np.array(floats("times", self.times)), np.array(floats("values", self.values))
        if times.ndim != 1 or values.ndim != 2 or len(times) != len(values) or len(times) == 0:
            raise ValueError(f"reference: times {times.shape} and values {values.shape}; give (k,) and (k, n), k > 0")
        if not ((np.abs(times) <= LATEST).all() and np.isfinite(values).all()):
            raise ValueError(f"reference: a time or value is not finite, or a time beyond {LATEST:g} s; correct it")
        if (np.diff(times) <= 0).any():
            k = int(np.argmax(np.diff(times) <= 0))
            raise ValueError(f"reference: time {times[k + 1]:g} s follows {times[k]:g} s; times must rise")
        one_of("kind", self.kind, ("hold", "linear", "cubic"))
        instance("cyclic", self.cyclic, (bool, np.bool_), "give True or False")
        if self.cyclic and (len(times) < 2 or not np.array_equal(values[0], values[-1])):
            raise ValueError("reference: a cyclic one needs two knots or more and the same values at both ends")
        for name, array in (("times", times), ("values", values)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def knots(self) -> Knots:
        """Return the signal as the kernels read it."""
        times, values = np.array(self.times), np.array(self.values)  # read-only ones are another type to compile for
        if len(times) == 1:
            times, values = np.array([times[0], times[0] + 1.0]), np.repeat(values, 2, axis=0)
        cubics = np.zeros((len(times) - 1, values.shape[1], 4))
        cubics[..., 0] = values[:-1]
        with np.errstate(all="ignore"):
            if self.kind == "linear":
                cubics[..., 1] = np.diff(values, axis=0) / np.diff(times)[:, None]
            if self.kind == "cubic":
                cubics[..., 1:] = _spline(times, values, self.cyclic)
        if not np.isfinite(cubics).all():
            raise ValueError("reference: a slope between two knots is not finite; give them values closer together")
        if self.kind == "hold" and not self.cyclic:  # the last value is held too
            times = np.append(times, times[-1] + 1.0)
            cubics = np.concatenate([cubics, np.zeros((1, *cubics.shape[1:]))])
            cubics[-1, :, 0] = values[-1]
        return Knots(times, cubics, float(times[-1] - times[0]) if self.cyclic else 0.0)


def _spline(times: np.ndarray, values: np.ndarray, cyclic: bool) -> np.ndarray:
    """Compute the coefficients c1, c2, c3 (k, n, 3) of the C2 spline through k + 1 knots.

    Its second derivatives M solve h_(i-1) M_(i-1) + 2 (h_(i-1) + h_i) M_i + h_i M_(i+1) = 6 (d_i - d_(i-1)), with the
    gaps h between knots and the slopes d across them (C. de Boor, "A Practical Guide to Splines", chapter IV).
    """
    h = np.diff(times)[:, None]
    d = np.diff(values, axis=0) / h
    M = _inner_derivatives(h, 6.0 * np.diff(d, axis=0), np.zeros_like(d[0]))
    if cyclic:  # add what one and the same M at both ends makes, so that the equation holds there too
        ones = _inner_derivatives(h, np.zeros_like(d[1:]), np.ones_like(d[0]))
        missing = 6.0 * (d[0] - d[-1]) - (h[-1] * M[-2] + h[0] * M[1])
        M = M + missing / (2.0 * (h[-1] + h[0]) + h[-1] * ones[-2] + h[0] * ones[1]) * ones
    return np.stack([d - h * (2.0 * M[:-1] + M[1:]) / 6.0, 0.5 * M[:-1], np.diff(M, axis=0) / (6.0 * h)], axis=-1)


def _inner_derivatives(h: np.ndarray, right: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Solve for M (k + 1, n) with M = `end` (n,) at both ends: Thomas's elimination, in a fixed order of operations."""
    M = np.concatenate([end[None], right, end[None]])
    pivot, above = np.ones_like(h), np.concatenate([np.zeros_like(h[:1]), h[1:]])
    for i in range(1, len(h)):
        share = h[i - 1] / pivot[i - 1]
        pivot[i] = 2.0 * (h[i - 1] + h[i]) - share * above[i - 1]
        M[i] -= share * M[i - 1]
    for i in reversed(range(1, len(h))):
        M[i] = (M[i] - h[i] * M[i + 1]) / pivot[i]
    return M
