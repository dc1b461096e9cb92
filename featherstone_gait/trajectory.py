"""The result of a simulation: recorded channels, how the run ended, and where its energy went."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import renamed
from .channels import column_of
from .files import FilePath, Format, complete_together

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMAT = Format("trajectory")

@dataclass(frozen=True, eq=False)
class Trajectory(Mapping[str, np.ndarray]):
    """Channels by name, arrays (samples, ...); `time` (samples,) [s] is one of them.

    status is "ok", "fell" or "diverged" (the run ended there, at `end_time`; later samples repeat the last sound
    state), "chatter" (velocities alternated from step to step: the step is too large for the integrator and the
    result is wrong, however bounded), "step too small" (error control asked for less than it may take, and the run
    ended there), "too costly" (error control has taken as many steps as it may, and the run ended there)
    or "not converged" (an implicit step missed its tolerance,
    or rk4 went beyond its stability interval or into a stop that it does not resolve at that step).
    """

    channels: dict[str, np.ndarray]
    status: str
    message: str
    end_time: float  # [s]
    final: np.ndarray  # the whole state at the end; to go on from it give `simulate` the trajectory, or this array
    info: dict[str, Any] = field(default_factory=dict)
    error: dict[str, np.ndarray] | None = None  # estimate for each channel, in its unit and shape; see `with_error`
    parts: dict[str, tuple[int, int]] | None = None  # of `final`: where each begins and ends; None: not known

    def __getitem__(self, name: str) -> np.ndarray:
        return self.channels[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def __len__(self) -> int:
        return len(self.channels)

    def __repr__(self) -> str:
        named = ", ".join(f"{name} {values.shape[1:]}" for name, values in self.items() if name != "time")
        samples = max((len(values) for values in self.values()), default=0)
        return f"<trajectory: {self.status} to {self.end_time:g} s, {samples} samples of {named or 'nothing'}>"

    @property
    def ok(self) -> bool:
        return self.status == "ok"

    def column(self, name: str, label: str) -> np.ndarray:
        """One number of a channel by its label, of each joint or contact point (samples, ...).

        `column("energy", "meter")` is the energy that each servo has drawn [J], `column("contact_force", "normal")` the
        normal force on each contact point [N]; `channel_table()` lists the labels.  Raises ValueError for a label that
        there is not, or there is twice, and for a channel that was not recorded.
        """
        column = column_of(name, label)
        if name not in self:
            known = ", ".join(self)
            raise ValueError(f"channel {name!r} is not recorded, {known} are: name it in simulate(record=...)")
        return self[name][..., column]

    def save(self, path: FilePath) -> None:
        """Write PATH.npz (channels and final state) and PATH.json (status and settings), whole or not at all."""
        described = {"format": str(FORMAT), "status": self.status, "message": self.message, "end_time": self.end_time}
        described |= {"info": self.info, "parts": self.parts}
        arrays: dict[str, Any] = {f"channel_{k}": v for k, v in self.channels.items()}
        arrays |= {f"error_{k}": v for k, v in (self.error or {}).items()}
        with complete_together(*_files(path)) as (data, text):
            with data.open("xb") as file:
                np.savez_compressed(file, format=str(FORMAT), final=self.final, **arrays)
            text.write_text(json.dumps(described, indent=2, default=float), encoding="utf-8")

    @classmethod
    def load(cls, path: FilePath) -> Trajectory:
        """Read what `save` wrote.  Raises ValueError for a file of a format that this version does not read."""
        arrays, text = _files(path)
        described = json.loads(text.read_text("utf-8"))
        FORMAT.check(text, described.pop("format", None))
        parts = described.pop("parts", None)
        with np.load(arrays) as data:
            channels, error = (
                {k.removeprefix(kind): data[k] for k in data.files if k.startswith(kind)}
                for kind in ("channel_", "error_")
            )
            final = data["final"]
        parts = parts and {name: (int(start), int(stop)) for name, (start, stop) in parts.items()}
        return cls(channels, final=final, error=error or None, parts=parts, **described)

    def plot(self, *names: str, axes: Axes | Sequence[Axes] | np.ndarray | None = None) -> Figure:
        """Draw channels against time, one panel each; return the figure."""
        from .view.plotting import plot_trajectory

        return plot_trajectory(self, names or tuple(k for k in self if k != "time"), axes)


def with_error(run: Trajectory, finer: Trajectory, factor: float) -> Trajectory:
    """`run` with the difference to a finer run, times `factor`, as its error (step doubling).

    With half the step a method of order p leaves 1 / (1 - 2**-p) of the difference: 2 holds from order 1 on, and where
    kinks cost a higher method its order.  A tenth of the tolerance leaves a tenth of the error: 1.1.  Where the finer
    run ended otherwise, or the run failed, the error is infinite.
    """
    failed = run.status in ("diverged", "step too small", "too costly")
    same = not failed and run.status == finer.status and abs(run.end_time - finer.end_time) <= 0.02 * run.end_time
    error = {
        name: factor * np.abs(values - finer[name]) if same else np.full(values.shape, np.inf)
        for name, values in run.channels.items()
        if name != "time"
    }
    return replace(run, error=error)


def _files(path: FilePath) -> tuple[Path, Path]:
    """PATH.npz and PATH.json, of a path with or without one of these endings; other dots belong to the name."""
    path = Path(path)
    path = path.with_suffix("") if path.suffix in (".npz", ".json") else path
    return path.with_name(path.name + ".npz"), path.with_name(path.name + ".json")


def __getattr__(name: str) -> Any:
    return renamed.lookup(__name__, name)
