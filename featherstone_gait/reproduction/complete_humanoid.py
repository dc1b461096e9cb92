"""The gait of the complete humanoid, arms included, against that of the simplified one.

The paper optimizes a simplified humanoid, ten joints of the legs, and names the complete model as future work.  Here
both are searched in the same way: four poses of all joints of the robot, by adaptive simulated annealing, with the same
number of iterations.  Both robots have the same links and masses.  The other nine joints are locked in the simplified
one; in the complete one they are servos that the planned walk keeps at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from ..base.progress import progress_bar
from ..optimize.planning import walking_cost
from ..optimize.quality import Quality, measure_quality
from ..optimize.search import optimize_gait
from ..robot_file import load_robot
from ..view.style import BLUE, ORANGE, look
from .claim import Claim, classify, question, span
from .common import subplots
from .walks import finished

ROBOTS = {"simplified": "simplified", "complete": None}  # name -> what is locked


@dataclass(frozen=True)
class CompleteHumanoidSettings:
    """Numbers of iterations and searches."""

    iterations: int  # of each search
    searches: int  # of each robot, by different seeds


QUICK = CompleteHumanoidSettings(iterations=150, searches=2)
FULL = CompleteHumanoidSettings(iterations=800, searches=3)


@dataclass(frozen=True, eq=False)
class Walk:
    """The searches of one robot."""

    joints: tuple[str, ...]
    best: np.ndarray  # (searches, iterations + 1) least cost so far [J/m]
    poses: np.ndarray  # (searches, 4, joints) of the gaits found [rad]
    planned_poses: np.ndarray  # (4, joints) [rad]
    first: Quality  # of the planned gait
    found: tuple[Quality, ...]  # of the gaits found
    without: np.ndarray  # (searches,) cost with all joints but the simplified robot's as planned [J/m]

    @property
    def costs(self) -> np.ndarray:
        """Costs of the gaits found [J/m]."""
        return self.best[:, -1]

    @property
    def gains(self) -> np.ndarray:
        return self.costs / self.best[:, 0] - 1.0

    @property
    def changes(self) -> np.ndarray:
        """Largest change of each joint from the plan over the poses (joints,) [rad], median of the searches."""
        return np.median(np.abs(self.poses - self.planned_poses).max(axis=1), axis=0)


@dataclass(frozen=True, eq=False)
class CompleteHumanoidResult:
    settings: CompleteHumanoidSettings
    walks: dict[str, Walk]  # by robot


def run(settings: CompleteHumanoidSettings = QUICK, seed: int = 0, progress: bool = False) -> CompleteHumanoidResult:
    """Run the searches of both robots, seeded by `seed` and the numbers that follow."""
    with progress_bar(progress=progress, total=len(ROBOTS) * settings.searches, unit="search") as bar:
        walks = {name: _walk(settings, locked, seed, bar) for name, locked in ROBOTS.items()}
    return CompleteHumanoidResult(settings, walks)


def _walk(settings: CompleteHumanoidSettings, locked: str | None, seed: int, bar: tqdm) -> Walk:
    model = load_robot("humanoid", locked=locked)
    cost = walking_cost(model)
    n, results = settings.iterations, []
    for k in range(settings.searches):
        results.append(finished(optimize_gait(cost, iterations=n, seed=seed + k, no_progress=n)))
        bar.update()
    best = np.array([np.minimum.accumulate(result.history["f"]) for result in results])
    poses = np.array([cost.gait.from_vector(result.x).poses for result in results])
    first, *found = (measure_quality(cost, x) for x in (cost.gait.to_vector(), *(result.x for result in results)))
    legs = np.isin(model.joint_names, load_robot("humanoid", locked="simplified").joint_names)
    as_planned = np.where(legs, poses, cost.gait.poses)
    _, _, *without = cost.measure([cost.gait.to_vector()] * 2 + [each.ravel() for each in as_planned])
    return Walk(
        model.joint_names, best, poses, cost.gait.poses, first, tuple(found), np.array([m.cost for m in without])
    )


# ---------------------------------------------------------------------------------------------- claims


def check(result: CompleteHumanoidResult) -> list[Claim]:
    """Return the claims about the paper's future work."""
    return [_walks(result), _cheaper(result), _arms(result), _safe(result)]


def _walks(result: CompleteHumanoidResult) -> Claim:
    """Return the claim: reproduced if all gaits walk, also at a quarter of the step, and those found are cheaper."""
    walk = result.walks["complete"]
    qualities = (walk.first, *walk.found)
    walks = all(m.status == "ok" for q in qualities for m in (q.measures, q.finer))
    fine = [q.finer.cost / q.measures.cost - 1.0 for q in qualities]
    return Claim(
        claim="The complete humanoid walks and its gait can be optimized",
        item="Section 6",
        paper="",
        ours=f"{len(walk.joints)} joints, {walk.poses[0].size} angles: {walk.best[0, 0]:.1f} J/m as planned, "
        f"{span(walk.costs, '.1f')} J/m after {result.settings.iterations} iterations "
        f"({span(walk.gains, '+.0%')})",
        holds=True,
        verdict=classify(walks and (walk.gains < 0.0).all()),
        why="Rule: the planned gait and all gaits found walk, also at a quarter of the step, and all are cheaper. A "
        f"quarter of the step changes the cost by {span(fine, '+.1%')}",
    )


def _cheaper(result: CompleteHumanoidResult) -> Claim:
    """Return the claim: reproduced if every complete search ends below every simplified one; in direction: medians."""
    simple, complete = (result.walks[name] for name in ROBOTS)
    apart = complete.costs.max() < simple.costs.min()
    lower = np.median(complete.costs) < np.median(simple.costs)
    joints = len(complete.joints) - len(simple.joints)
    fine = [q.finer.cost / q.measures.cost - 1.0 for walk in (simple, complete) for q in walk.found]
    return question(
        claim="The complete humanoid walks more cheaply than the simplified after equally many iterations",
        ours=f"complete {span(complete.costs, '.1f')} J/m, simplified {span(simple.costs, '.1f')} J/m",
        verdict=classify(apart, lower),
        why="Rule: every search ends below every one of the simplified robot; in direction if the median is lower; "
        f"{len(simple.costs)} searches each. The arms can save energy, but {joints} more servos hold arms and neck, "
        f"and there are {complete.poses[0].size} angles to search instead of {simple.poses[0].size}. Before the "
        f"search the complete robot costs {complete.best[0, 0]:.1f} J/m, the simplified {simple.best[0, 0]:.1f} J/m. "
        f"A quarter of the step changes the costs of the gaits found by {span(fine, '+.1%')}",
    )


def _arms(result: CompleteHumanoidResult) -> Claim:
    """Return the claim: reproduced if every gait costs 1 % more without; in direction if the median does."""
    walk = result.walks["complete"]
    legs = np.isin(walk.joints, result.walks["simplified"].joints)
    change = np.degrees(walk.changes)
    more = walk.without / walk.costs - 1.0
    return question(
        claim="The search uses arms, hip yaw and neck",
        ours=f"with these joints as planned the gaits found cost {span(more, '+.1%')}",
        verdict=classify(more.min() > 0.01, np.median(more) > 0),
        why="Rule: every gait costs over 1 % more; in direction if the median costs more; a fall counts as infinite. "
        f"These joints differ from the plan by {np.median(change[~legs]):.1f} deg, the ten of the simplified robot by "
        f"{np.median(change[legs]):.1f} deg (median of the largest change)",
    )


def _safe(result: CompleteHumanoidResult) -> Claim:
    """Return the claim: reproduced if the median shares of safe gaits differ by less than a tenth."""
    shares = {name: [q.safe for q in walk.found] for name, walk in result.walks.items()}
    simple, complete = (float(np.median(shares[name])) for name in ROBOTS)
    return question(
        claim="The complete humanoid's gaits are as safe: they walk with errors of up to 1 deg in all angles",
        ours=f"complete {span(shares['complete'], '.0%')}, simplified {span(shares['simplified'], '.0%')}",
        verdict=classify(abs(simple - complete) < 0.1),
        why="Rule: medians differ by less than 10 points. Each share is of 63 gaits, accurate to 6 points; as planned "
        f"{result.walks['complete'].first.safe:.0%} and {result.walks['simplified'].first.safe:.0%}",
    )


# ---------------------------------------------------------------------------------------------- figures

COLORS = {"simplified": BLUE, "complete": ORANGE}


@look()
def plot(result: CompleteHumanoidResult) -> dict[str, Figure]:
    """Draw the searches, and how far each joint moved."""
    return {
        "Energy per distance of the best gait so far: each search, and the median of each robot (thick).":
            _progress(result),
        "How far each joint of the complete humanoid moved from the plan: the largest change over its four poses, "
        "median of the searches.": _changes(result),
    }  # fmt: skip


def _progress(result: CompleteHumanoidResult) -> Figure:
    figure, axes = subplots(7.0, 4.0)
    for name, walk in result.walks.items():
        axes.plot(walk.best.T, color=COLORS[name], linewidth=0.7, alpha=0.6)
        label = f"{name}, {len(walk.joints)} joints"
        axes.plot(np.median(walk.best, axis=0), color=COLORS[name], linewidth=2.2, label=label)
    axes.set(xlabel="iteration", ylabel="energy per distance [J/m]", xlim=(0, result.settings.iterations))
    axes.set_ylim(bottom=0.0)
    axes.legend(loc="lower left")
    return figure


def _changes(result: CompleteHumanoidResult) -> Figure:
    walk = result.walks["complete"]
    legs = result.walks["simplified"].joints
    order = np.argsort(walk.changes)
    figure, axes = subplots(7.0, 5.0)
    for k, joint in enumerate(order):
        color = COLORS["simplified" if walk.joints[joint] in legs else "complete"]
        axes.barh(k, math.degrees(walk.changes[joint]), color=color)
    axes.set_yticks(range(len(order)), [walk.joints[k].replace("_", " ") for k in order])
    axes.set_xlabel("largest change of a pose from the plan [deg]")
    for name, label in (("simplified", "joint of the simplified robot too"), ("complete", "locked in the simplified")):
        axes.barh(0, 0.0, color=COLORS[name], label=label)
    axes.legend(loc="lower right")
    return figure
