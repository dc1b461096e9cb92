"""The record of a judgment: how many worlds a policy walks in, what it takes, and what it breaks on."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..base.files import FilePath, Format, write_csv
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from .meter import FIGURES
from .statistics import DOUBT, FEWEST, NEEDED, Cause, causes, wilson

if TYPE_CHECKING:
    from ..view.page import Page

TABLE = Format("judgment", 1)
AGREES = 0.99  # share of worlds whose verdict half the step keeps, from which on the step is called short enough
UNITS = {  # of joints, as columns of the table
    "peak_torque": "peak [N m]", "rms_torque": "rms [N m]", "saturated": "saturated",
    "peak_current": "peak [A]", "rms_current": "rms [A]",
}  # fmt: skip
LINE = 79


class Agreement(NamedTuple):
    """Compare the verdicts with those at half the step."""

    worlds: int  # that were simulated again
    same: int  # in how many of them the verdict is the same
    energy_per_way: float  # median relative difference, of the worlds that walk both times


@dataclass(frozen=True, eq=False)
class Judgment:
    """Record how a policy did in many worlds.

    Attributes
    ----------
    policy, robot, servo : str
        Names.
    settings : dict
        Command [m/s, m/s, rad/s], seconds, seed, integrator, timestep [s], rate [Hz], and what the energy is.
    verdicts : ndarray of str, shape (worlds,)
        "walks", "stands" (upright, less than `settings["least"]` of the way that was commanded), "falls", or "unknown":
        the simulation ended otherwise, and is not to be trusted.
    worlds : dict of ndarray, shape (worlds,)
        Numbers of each world, by name: time until the end or the fall [s], way along the command [m], speed [m/s],
        energy [J], power [W], energy_per_way [J/m] and so on.
    joints : dict of ndarray, shape (worlds, joints)
        Torques [N m], currents [A] and share of saturated ticks of each joint.
    joint_names : tuple of str
        Names of the joints.
    factors : dict of ndarray, shape (worlds,)
        What was drawn for each world.
    agreement : Agreement or None
        With half the step.
    left_out : dict of str
        What of the distributions does not apply to this robot, and why.
    note : str
        What the robot's file keeps references to, and what of the servos does not fit the training; "" of none.
    unsound : str
        Why the first world of which the verdict is unknown ended, "" of none.
    seconds : dict of float
        How long it took [s], of the clock and of processors, and the policy's share; not part of the results.
    scene : CompiledScene
        The robot on its floor, before anything is drawn.
    runs, scenes : callable
        Simulates worlds of these numbers again and returns their trajectories, to the same bits; and their scenes.
    """

    policy: str
    robot: str
    servo: str
    settings: dict[str, Any]
    verdicts: np.ndarray
    worlds: dict[str, np.ndarray]
    joints: dict[str, np.ndarray]
    joint_names: tuple[str, ...]
    factors: dict[str, np.ndarray]
    agreement: Agreement | None = None
    left_out: dict[str, str] = field(default_factory=dict)
    note: str = ""
    unsound: str = ""
    seconds: dict[str, float] = field(default_factory=dict)
    scene: CompiledScene | None = None
    runs: Callable[[Sequence[int]], list[Trajectory]] | None = None
    scenes: Callable[[Sequence[int]], list[CompiledScene]] | None = None

    def __repr__(self) -> str:
        low, high = self.interval
        share = f"walks in {self.walking} of {len(self.verdicts)} worlds ({100 * low:.0f} to {100 * high:.0f} %)"
        return f"<judgment of {self.policy} on {self.robot}: {share}, {self.verdict}>"

    @property
    def walking(self) -> int:
        """Number of worlds in which it walks."""
        return int((self.verdicts == "walks").sum())

    @property
    def unknown(self) -> int:
        """Number of worlds of which the verdict is unknown."""
        return int((self.verdicts == "unknown").sum())

    @property
    def share(self) -> float:
        """Share in which it walks of the worlds with a verdict, NaN of none."""
        known = len(self.verdicts) - self.unknown
        return self.walking / known if known else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the share, by Wilson, in whatever worlds of unknown verdict it walks."""
        count = len(self.verdicts)
        return wilson(self.walking, count)[0], wilson(self.walking + self.unknown, count)[1]

    @property
    def verdict(self) -> str:
        """Return "holds" or "breaks", or "undecided" where the interval of the share holds `NEEDED`."""
        low, high = self.interval
        return "holds" if low >= NEEDED else "breaks" if high < NEEDED else "undecided"

    @property
    def causes(self) -> list[Cause]:
        """Factors that differ between the worlds where it walks and the others, largest effect first; [] of too few."""
        known = self.verdicts != "unknown"
        factors = {name: values[known] for name, values in self.factors.items()}
        return causes(factors, self.verdicts[known] != "walks")

    def spread(self, name: str) -> tuple[float, float, float]:
        """Return median and quartiles of a number over the worlds in which it walks, NaN of none."""
        values = self.worlds[name][self.verdicts == "walks"]
        values = values[np.isfinite(values)]
        if not len(values):
            return (math.nan,) * 3
        low, middle, high = np.quantile(values, (0.25, 0.5, 0.75)).tolist()
        return middle, low, high

    @property
    def saturates_first(self) -> str | None:
        """The joint that is the first to be saturated in most of the worlds in which any is; None of none."""
        first = self.joints["first_saturated"]
        some = np.isfinite(first).any(axis=1)
        if not some.any():
            return None
        return self.joint_names[int(np.bincount(first[some].argmin(axis=1), minlength=first.shape[1]).argmax())]

    def why(self) -> str:
        """Say what it breaks on, in a sentence."""
        joint = self.saturates_first
        return f"{self._differs()}; {'no joint is saturated' if joint is None else f'{joint} is saturated first'}"

    def _differs(self) -> str:
        """Say by what the worlds in which it fails differ from the others, or why that is not known."""
        falls, stands = ((self.verdicts == name) for name in ("falls", "stands"))
        failing, walking, count, found = int((falls | stands).sum()), self.walking, len(self.verdicts), self.causes
        if not failing:
            return "no world fails" if walking else "no verdict is known"
        if not found:
            said = "it walks in no world" if not walking else "no factor was drawn by which worlds could be compared"
            if 0 < walking < FEWEST:
                said = f"it walks in only {walking} of {count} worlds, too few to compare with those in which it fails"
            elif failing < FEWEST <= walking:
                said = f"it fails in only {failing} of {count} worlds, too few to compare with the others"
            how = [f"it stands in {stands.sum()}"] if stands.any() else []
            if falls.any():
                how.append(f"it falls in {falls.sum()}, after {np.median(self.worlds['time'][falls]):.2g} s (median)")
            return f"{said}: {', '.join(how)}"
        if found[0].chance > DOUBT:
            return f"no factor stands out; {found[0].name} differs most (delta {found[0].effect:+.2f})"
        return (
            f"{found[0].name}: median {found[0].failing:.4g} where it fails, {found[0].others:.4g} where it walks "
            f"(Cliff's delta {found[0].effect:+.2f})"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return what was found, as a dictionary of plain numbers and texts, None for what is no number."""
        counts = {name: int((self.verdicts == name).sum()) for name in ("walks", "stands", "falls", "unknown")}
        found = {
            "policy": self.policy, "robot": self.robot, "servo": self.servo, **self.settings,
            "worlds": len(self.verdicts), "verdict": self.verdict, "share": self.share, "interval": [*self.interval],
            **counts, "median_and_quartiles": {name: [*self.spread(name)] for name in FIGURES},
            "causes": [cause._asdict() for cause in self.causes[:5]], "saturates_first": self.saturates_first,
            "joints": {name: dict(zip(self.joint_names, row)) for name, row in self.by_joint().items()},
            "half_the_step": self.agreement and self.agreement._asdict(), "left_out": self.left_out,
            "note": self.note, "unsound": self.unsound,
        }  # fmt: skip
        return _plain(found)

    def by_joint(self) -> dict[str, list[float]]:
        """Return the largest peak of all worlds, and medians of the others, of each joint."""
        found = {}
        for name, values in self.joints.items():
            if name != "first_saturated":
                of = np.max if name.startswith("peak") else np.median
                found[name] = of(values, axis=0).tolist()
        return found

    def table(self) -> str:
        """Return what was found as text."""
        low, high = self.interval
        command = ", ".join(f"{x:g}" for x in self.settings["command"])
        count = {name: (self.verdicts == name).sum() for name in ("falls", "stands")}
        text = {
            "policy": f"{self.policy} on {self.robot}, servo {self.servo}, command {command}",
            "verdict": f"{self.verdict}: walks in {self.walking} of {len(self.verdicts)} worlds of "
            f"{self.settings['seconds']:g} s, {100 * self.share:.1f} % (95 %: {100 * low:.1f} to {100 * high:.1f} %), "
            f"falls in {count['falls']}, stands in {count['stands']}",
            "because": self.why(),
            "energy": self.settings["energy"],
        }
        text |= self.reservations()
        wrapped = [textwrap.fill(f"{name:12}{said}", LINE, subsequent_indent=" " * 12) for name, said in text.items()]
        return "\n".join([*wrapped, *self._figures(), *self._of_joints()])

    def reservations(self) -> dict[str, str]:
        """Return by topic how far the judgment is to be trusted, and what it leaves out."""
        text = {}
        if self.agreement is not None:
            again, same, by = self.agreement
            enough = "the step is short enough" if same >= AGREES * again else "THE STEP DECIDES: take a shorter one"
            text["half step"] = f"{same} of {again} verdicts are the same, J/m differ by {100 * by:.1f} %: {enough}"
        if self.unknown:
            text["unknown"] = f"{self.unknown} worlds, which count as either; the first: {self.unsound}"
        if self.note:
            text["servos"] = self.note
        if self.left_out:
            text["not drawn"] = ", ".join(self.left_out)
        return text

    def _figures(self) -> list[str]:
        if not self.walking:
            return []
        lines = ["", f"{'where it walks':42}{'median':>11}{'quartiles':>24}"]
        for name, (unit, what) in FIGURES.items():
            middle, first, last = self.spread(name)
            known = math.isfinite(middle)  # clearance is not where no foot swings
            cells = (f"{middle:.4g}", f"{first:.4g} to {last:.4g}") if known else ("-", "-")
            lines.append(f"{what + f' [{unit}]':42}{cells[0]:>11}{cells[1]:>24}")
        return lines

    def _of_joints(self) -> list[str]:
        """Return a row for each joint: the largest peaks of all worlds, medians of the others."""
        rows = self.by_joint()
        found = ["", f"{'joint':19}" + "".join(f"{UNITS[name]:>12}" for name in rows)]
        for k, name in enumerate(self.joint_names):
            found.append(f"{name[:18]:19}" + "".join(f"{row[k]:12.3g}" for row in rows.values()))
        return found

    def shown_worlds(self) -> dict[str, int]:
        """Return the numbers of the median and the worst world, by their captions."""
        found, per_way = {}, self.worlds["energy_per_way"]
        walking = np.flatnonzero(self.verdicts == "walks")
        failing = np.flatnonzero((self.verdicts == "falls") | (self.verdicts == "stands"))
        ranked = walking[np.argsort(per_way[walking], kind="stable")]
        if len(ranked):
            median = int(ranked[(len(ranked) - 1) // 2])
            found[f"world {median}, the median: {per_way[median]:.3g} J/m"] = median
        if len(failing):
            worst = int(failing[np.argmin(self.worlds["time"][failing])])
            found[f"world {worst}, the worst: {self.verdicts[worst]}, {self.worlds['time'][worst]:.3g} s"] = worst
        elif len(ranked) > 1:
            found[f"world {ranked[-1]}, the highest energy: {per_way[ranked[-1]]:.3g} J/m"] = int(ranked[-1])
        return found

    def page(self, path: FilePath) -> Page:
        """Write a page with the verdict, the robot in the median world and in the worst one, charts and tables."""
        from .page import write_page

        return write_page(self, path)

    def write_csv(self, path: FilePath) -> None:
        """Write a row for each world: its verdict, what was measured, what was drawn."""
        names, drawn = [*self.worlds], [*self.factors]
        rows = (
            [k, self.verdicts[k], *(self.worlds[name][k] for name in names), *(self.factors[name][k] for name in drawn)]
            for k in range(len(self.verdicts))
        )
        write_csv(path, TABLE, ["world", "verdict", *names, *drawn], rows, end="\n")


def _plain(value: Any) -> Any:
    """Return a value in which numbers that are not finite are None."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
