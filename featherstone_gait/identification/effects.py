"""Measure what each effect of a servo model contributes: the error on recordings that were not fitted.

    for row in effects(recordings, XL330, log=log, progress=True):
        print(row.line())

Each row is a fit to all recordings, and one without each group of them in turn that predicts it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .bench import Bench, BenchRecording, fit_servo, leave_out
from .log import FitLog

COUNT = 2.0 * math.pi / 4096  # of the encoder [rad]
GEAR = ("stiffness", "damping")


class Effect(NamedTuple):
    """A model to fit."""

    name: str
    friction: str = "m4p"
    more: tuple[str, ...] = ()
    held: Mapping[str, float] = {}
    nominal: bool = False  # supply in place of the measured one


EFFECTS = (
    Effect("M1, Coulomb and viscous", "m1"),
    Effect("M2, Stribeck", "m2"),
    Effect("M3, load", "m3"),
    Effect("M4, both", "m4"),
    Effect("M4 and the product of loads"),
    Effect("the same, no delay", held={"angle_age": 0.0}),
    Effect("the same, nominal supply", nominal=True),
    Effect("the same, rod without mass", held={"rod_mass": 0.0}),
    Effect("the same, encoder's counts", held={"encoder_resolution": COUNT}),
    Effect("the same, gear compliance", more=GEAR),
    Effect("the same, compliance and backlash", more=(*GEAR, "backlash")),
    Effect("M5, directional", "m5"),
    Effect("M6, quadratic", "m6"),
)


class EffectRow(NamedTuple):
    """Mean absolute errors of a model [rad], and the time of its fit."""

    effect: Effect
    fitted: float  # of all recordings, fitted to all
    left_out: dict[object, float]  # of each group, fitted to the others
    seconds: float  # of the fit to all

    @property
    def mean(self) -> float:
        """Mean error of the groups that were not fitted."""
        return float(np.mean([*self.left_out.values()]))

    def line(self) -> str:
        """Return the row as text."""
        groups = ", ".join(f"{group:g}" if isinstance(group, float) else str(group) for group in self.left_out)
        errors = " ".join(f"{1e3 * error:6.1f}" for error in self.left_out.values())
        return (
            f"{self.effect.name:34} fitted {1e3 * self.fitted:5.1f} mrad, left out {1e3 * self.mean:5.1f} "
            f"({groups}: {errors}), {self.seconds:.0f} s"
        )


def effects(
    recordings: Sequence[BenchRecording],
    bench: Bench,
    by: Callable[[BenchRecording], object] = lambda r: r.gain,
    chosen: Sequence[Effect] = EFFECTS,
    *,
    log: FitLog | None = None,
    progress: bool = False,
) -> Iterator[EffectRow]:
    """Yield the rows of the table: each model fitted to all recordings, and to all but each group in turn.

    Parameters
    ----------
    recordings : sequence of BenchRecording
    bench : Bench
    by : callable
        Returns the group of a recording, by default its gain.
    chosen : sequence of Effect
        Models to fit.
    log : FitLog, optional
        Where finished rounds are stored, so that an interrupted table resumes.
    progress : bool
        Show a progress bar.

    Yields
    ------
    EffectRow

    Raises
    ------
    ValueError
        If there are fewer than two groups.
    """
    for effect in chosen:
        own = [replace(r, supply=bench.supply) for r in recordings] if effect.nominal else list(recordings)
        options = {"more": effect.more, "held": effect.held, "log": log, "progress": progress}
        held = leave_out(own, bench, effect.friction, by, **options)
        fit = fit_servo(own, bench, effect.friction, **options)  # type: ignore[arg-type]
        left_out = {group: float(errors.mean()) for group, (_, _, errors) in held.items()}
        yield EffectRow(effect, float(fit.errors.mean()), left_out, fit.seconds)
