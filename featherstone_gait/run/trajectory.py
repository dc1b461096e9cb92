"""The result of a simulation: recorded channels, how the run ended, and its final state."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arguments import shown
from ..base.brief import some
from ..base.files import FilePath, Format, check_sound, complete_together, is_number, read_arrays, read_json
from ..core.step.state import BY_NAME, NONE, OWNERS, shaped
from ..model import Model
from ..scene.channels import Share, StateView, column_of, owned
from . import contacts, tables
from .contacts import is_of_slots
from .status import Status

FORMAT = Format("trajectory")


@dataclass(frozen=True, eq=False)
class Trajectory(Mapping[str, np.ndarray]):
    """Hold the result of a simulation: a mapping from channel names to arrays (samples, ...).

    Attributes
    ----------
    channels : dict of ndarray
        Recorded channels by name, each (samples, ...); `time` (samples,) [s] is one of them.
    status : Status
        "ok", or how the run went wrong:

        - "fell", "diverged": the run ended there, at `end_time`; later samples repeat the last sound state.
        - "chatter": velocities alternate from step to step; the step is too large for the integrator and the result is
          wrong, even where it is bounded.
        - "inaccurate": the estimated error exceeds 1e-3 (see `simulate`).
        - "not converged": an implicit step missed its tolerance, the step exceeds what the method
          allows, or rk4 met a joint stop that it does not resolve at that step.
        - "step too small": error control asked for a step below its minimum, and the run ended there.
        - "too costly": error control reached its maximal number of steps, and the run ended there.
        - "too many contacts": more pairs were near each other than have room, and the run ended there.
        - "too deep": a body sank into another or the ground by more than half of the thinner one, and the run
          ended there.
    message : str
        What happened, where and when; empty for a run that is "ok".
    end_time : float
        Time that the run reached [s].
    final : ndarray
        The whole state at the end.  To continue, give `simulate` the trajectory or this array.
    info : dict
        Settings of the run and counts, such as the joints' names, the integrator and its steps.
    error : dict of ndarray or None
        Estimated error of each channel, in its unit and shape; those of the slots of pairs, which two runs may use
        differently, have none.
    parts : dict of (int, int) or None
        First and past-the-last index in `final` of each part of the state; None if they are not known.
    second_final : ndarray or None
        Final state of the coarser second run, from which the error was estimated and can be estimated further.
    """

    channels: dict[str, np.ndarray]
    status: Status
    message: str
    end_time: float
    final: np.ndarray
    info: dict[str, Any] = field(default_factory=dict)
    error: dict[str, np.ndarray] = None  # type: ignore[assignment]  # a run without an estimate is the exception
    parts: dict[str, tuple[int, int]] | None = None
    second_final: np.ndarray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "status", Status(self.status))

    def __getitem__(self, name: str) -> Any:
        """Return a channel (samples, ...), or the run of one robot or object, as `of` does."""
        return self.of(name) if name in self.info.get("members", ()) else self.channels[name]

    def of(self, name: str) -> Trajectory:
        """Return the run of one robot or object of a scene of several, as if it had been alone.

        Parameters
        ----------
        name : str
            Its name in the scene.

        Returns
        -------
        Trajectory
            Its channels, errors and final state; status, message and counts are those of the whole run.  Channels of
            pairs, which are of two members, stay with the whole run: see `contact`.

        Raises
        ------
        ValueError
            If there is no such member.
        """
        shares = self.info.get("members", {})
        if name not in shares:
            known = ", ".join(shares) or "none, for the run is of one robot"
            raise ValueError(f"trajectory: there is no robot or object {shown(name)}; there are {known}")
        share = shares[name]
        first, end = share["joints"]
        whole = ("members", "pairs", "positions", "loops", "loop_rows")
        info = {key: value for key, value in self.info.items() if key not in whole}
        info |= {"robot": share["robot"], "joints": share["joints_of"], "joint_types": info["joint_types"][first:end]}
        info |= {"positions": share["positions_of"]} if "positions_of" in share else {}
        info |= {"loops": share["loops_of"], "loop_rows": share["rows_of"]} if "loops_of" in share else {}
        channels = {key: values for key, values in _own(self.channels, share).items()}
        errors = None if self.error is None else _own(self.error, share)
        parts, indices = _own_parts(self.parts, share)
        second = None if self.second_final is None else self.second_final[indices]
        return Trajectory(
            channels, self.status, self.message, self.end_time, self.final[indices], info, errors, parts, second
        )

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def __len__(self) -> int:
        return len(self.channels)

    def __repr__(self) -> str:
        named = some(f"{name} {values.shape[1:]}" for name, values in self.items() if name != "time")
        samples = max((len(values) for values in self.values()), default=0)
        return f"<trajectory: {self.status} to {self.end_time:g} s, {samples} samples of {named or 'nothing'}>"

    @property
    def ok(self) -> bool:
        """Return whether the status is "ok"."""
        return self.status is Status.OK

    success = ok  # SciPy's name

    @property
    def failed(self) -> bool:
        """Return whether the run ended before its time."""
        return not self.status.complete

    @property
    def state(self) -> StateView:
        """The channels of the final state by name, as writable views of `final`: `state.q`, `state["base_q"]`.

        Raises ValueError for a trajectory without `parts`, such as one made by hand.
        """
        if self.parts is None:
            raise ValueError("the parts of the trajectory's final state are not known; simulate it again")
        return StateView(self.final, self.parts)

    def column(self, name: str, label: str) -> np.ndarray:
        """Select one number of a channel by its label.

        Parameters
        ----------
        name : str
            Name of a recorded channel.
        label : str
            One of the channel's labels, which `channel_table()` lists.

        Returns
        -------
        ndarray, shape (samples, ...)
            The number for each joint or contact point.  `column("energy", "electrical_no_regeneration")` is the energy
            that each servo has drawn [J], `column("contact_force", "normal")` the normal force on each contact point
            [N].

        Raises
        ------
        ValueError
            The label does not exist or is not unique, or the channel was not recorded.
        """
        column = column_of(name, label)
        if name not in self:
            raise ValueError(_not_recorded(self, name))
        return self[name][..., column]

    def save(self, path: FilePath) -> None:
        """Save to PATH.npz (channels and final state) and PATH.json (status and settings), atomically.

        Parameters
        ----------
        path : path
            With or without one of these endings.
        """
        described = {"format": str(FORMAT), **self.described(), "parts": self.parts}
        arrays: dict[str, Any] = {f"channel_{k}": v for k, v in self.channels.items()}
        arrays |= {f"error_{k}": v for k, v in (self.error or {}).items()}
        arrays |= {} if self.second_final is None else {"second_final": self.second_final}
        with complete_together(*files(path)) as (data, text):
            with data.open("xb") as file:
                np.savez_compressed(file, format=str(FORMAT), final=self.final, **arrays)
            text.write_text(json.dumps(described, indent=2, default=float), encoding="utf-8")

    @classmethod
    def load(cls, path: FilePath) -> Trajectory:
        """Load a trajectory that `save` wrote.

        Parameters
        ----------
        path : path
            With or without the ending .npz or .json.

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError
            A file is damaged, holds something else, or has a format that this version does not read.  So is one with
            NaN, or with infinity where a run has none; distances of sensors and of shapes may be infinite, errors too.
        OSError
            A file cannot be opened.
        """
        data, text = files(path)
        described = read_json(text, FORMAT)
        arrays = read_arrays(data, FORMAT, lambda declared: _check_arrays(data, declared))
        final, second = arrays.pop("final"), arrays.pop("second_final", None)
        parts = described.pop("parts", None)
        _check_described(text, described)
        channels, error = (
            {name.removeprefix(kind): values for name, values in arrays.items() if name.startswith(kind)}
            for kind in ("channel_", "error_")
        )
        _check_numbers(data, channels, error, [final] if second is None else [final, second])
        parts = None if parts is None else _parts(text, parts, len(final))
        estimated: Any = error or None
        return cls(channels, final=final, error=estimated, parts=parts, second_final=second, **described)

    contact, touched = contacts.contact, contacts.touched

    to_pandas, to_xarray, to_parquet = tables.to_pandas, tables.to_xarray, tables.to_parquet

    def described(self) -> dict[str, Any]:
        """Return the status, the message, the end time and the info."""
        return {"status": self.status, "message": self.message, "end_time": float(self.end_time), "info": self.info}


def positions(trajectory: Mapping[str, np.ndarray], model: Model | None = None) -> np.ndarray:
    """Join base_q and q to positions (samples, nq), as the functions of `dynamics` take them.

    Raises ValueError if the model is given and one of its channels was not recorded.
    """
    floating = model is not None and model.base == "floating"
    for name in ("base_q",) * floating + ("q",) * (model is not None):
        if name not in trajectory:
            raise ValueError(_not_recorded(trajectory, name))
    return np.hstack([trajectory["base_q"], trajectory["q"]]) if "base_q" in trajectory else trajectory["q"]


def of_second_run(state: Any) -> Any:
    """Return where the second run of a run begins that goes on from a state: where the other's second run ended."""
    if isinstance(state, Trajectory) and state.second_final is not None:
        return replace(state, final=state.second_final)
    return state


def _not_recorded(trajectory: Mapping[str, np.ndarray], name: str) -> str:
    return f"channel {name!r} was not recorded; recorded were {', '.join(trajectory)}: name it in simulate(record=...)"


def _own(channels: Mapping[str, np.ndarray], share: Share) -> dict[str, np.ndarray]:
    """Return the channels (samples, ...) of one member."""
    found = {}
    for name, values in channels.items():
        channel, flat = BY_NAME.get(name), values.reshape(len(values), -1)
        if channel is None:  # time
            found[name] = values
        elif channel.of in ("loop", "row") and "loops" not in share:
            continue
        elif OWNERS[channel.of].share != NONE and not (channel.of == "base" and share["fixed"]):
            found[name] = shaped(channel, flat[:, owned(channel, share, flat.shape[1])])
    return found


def _own_parts(parts: Mapping[str, tuple[int, int]] | None, share: Share) -> tuple[Any, np.ndarray]:
    """Return the parts of a member's state, and where its numbers stand in that of all."""
    at, found, indices = 0, {}, []
    for name, (first, end) in (parts or {}).items():
        own = first + owned(BY_NAME[name], share, end - first)
        found[name], at = (at, at + len(own)), at + len(own)
        indices.append(own)
    return found or None, np.concatenate(indices) if indices else np.arange(0)


def with_error(run: Trajectory, finer: Trajectory, factor: float) -> Trajectory:
    """Set the error of a run to its difference from a finer run, times `factor` (step doubling).

    With half the step a method of order p leaves 1 / (1 - 2**-p) of the difference: 2 holds from order 1 on, and where
    discontinuities cost a higher method its order.  A tenth of the tolerance leaves a tenth of the error: 1.1.  Where
    the finer run ended otherwise, or the run failed, the error is infinite.
    """
    broken = run.failed and run.status is not Status.FELL
    same = not broken and run.status == finer.status and abs(run.end_time - finer.end_time) <= 0.02 * run.end_time
    error = {
        name: factor * np.abs(values - finer[name]) if same else np.full(values.shape, np.inf)
        for name, values in run.channels.items()
        if name != "time" and not is_of_slots(name)
    }
    return replace(run, error=error)


def files(path: FilePath) -> tuple[Path, Path]:
    """Find PATH.npz and PATH.json for a path with or without one of these endings; other dots belong to the name."""
    path = Path(path)
    path = path.with_suffix("") if path.suffix in (".npz", ".json") else path
    return path.with_name(path.name + ".npz"), path.with_name(path.name + ".json")


def _check_described(path: Path, content: dict[str, Any]) -> None:
    """Raise ValueError unless the JSON file says how the run ended and has no unknown keys."""
    expected = {
        "status": (content.get("status") in [*Status], f"one of {', '.join(Status)}"),
        "message": (isinstance(content.get("message"), str), "a text"),
        "end_time": (is_number(content.get("end_time")), "a finite number [s]"),
        "info": (isinstance(content.get("info"), dict), "an object"),
    }
    for name, (right, what) in expected.items():
        if not right:
            found = "missing" if name not in content else repr(content[name])[:100]
            raise ValueError(f"{path}: {name} is {found}; expected {what}: take an undamaged copy, or simulate again")
    for name in content.keys() - expected:
        known = ", ".join([*expected, "parts"])
        raise ValueError(f"{path}: {name!r} is unknown; expected {known}: take an undamaged copy, or simulate again")


def _check_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Raise ValueError unless there are a final state, channels of equal length, and errors of their shapes."""
    if "final" not in arrays or arrays["final"].ndim != 1:
        raise ValueError(f"{path}: the array 'final' is missing or not a list of numbers; simulate again")
    states = ("final", "second_final")
    if arrays.get("second_final", arrays["final"]).shape != arrays["final"].shape:
        raise ValueError(f"{path}: the array 'second_final' does not have the shape of 'final'; simulate again")
    samples = {len(values) for name, values in arrays.items() if name not in states and values.ndim}
    for name, values in arrays.items():
        kind, _, channel = name.partition("_")
        alike = arrays.get(f"channel_{channel}") if kind in ("channel", "error") else None
        of_channel = alike is not None and alike.shape == values.shape and values.ndim > 0 and len(samples) == 1
        known = name in states or of_channel
        if not known or values.dtype.kind not in "iuf":
            raise ValueError(
                f"{path}: the array {name!r} of {values.dtype} has shape {values.shape}; expected channels and errors "
                "of numbers, all with equally many samples: take an undamaged copy, or simulate again"
            )


def _check_numbers(
    path: Path, channels: dict[str, np.ndarray], errors: dict[str, np.ndarray], states: list[np.ndarray]
) -> None:
    """Raise ValueError for numbers that no run has: what sensors read in the air may be none."""
    for values in states:
        check_sound(path, "the final state", values)
    for name, values in channels.items():
        if name == "time" or name in BY_NAME:
            check_sound(path, f"channel {name!r}", values, name == "clearance")
    for name, values in errors.items():
        check_sound(path, f"the error of {name!r}", values, infinite=True)


def _parts(path: Path, parts: Any, length: int) -> dict[str, tuple[int, int]]:
    """Check where the parts of a final state of that length lie.  Raises ValueError if they cannot lie there."""
    if isinstance(parts, dict):
        lists = [part for part in parts.values() if isinstance(part, list) and [*map(type, part)] == [int, int]]
        if len(lists) == len(parts) and all(0 <= start <= stop <= length for start, stop in lists):
            return {name: (start, stop) for name, (start, stop) in parts.items()}
    expected = f"the first and past-the-last index of each name in the {length} numbers of the final state"
    raise ValueError(f"{path}: parts is {repr(parts)[:100]}; expected {expected}: simulate again")
