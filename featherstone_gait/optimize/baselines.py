"""Planned walks that a gait is compared with, and what was measured of them before.

    python -m featherstone_gait.optimize.baselines        # measures those of the humanoid, a minute of two cores

They depend on robot and servos, not on a search.  Those of the humanoid are stored in full precision for the servos of
`SERVOS` (`stored`), with the settings of the cheapest plan, which a search that needs it starts from; a long test
measures them again.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TypeAlias

from ..base.files import complete
from ..base.progress import progress_bar
from ..robot_file import load_robot
from ..robot_file.servos import with_servo
from ..walking.cheapest_plan import ACCURATE, PlanKind, States, cheapest_plan
from ..walking.cost import Measures, WalkingCost
from ..walking.cost_in_worlds import in_worlds
from .options import OptimizeOptions
from .planning import walking_cost
from .quality import TEST_WORLDS, measure_in_test_worlds
from .stored import CHEAPEST, FILE, FORMAT, SERVOS, Row, is_measured, stored_rows

Stored: TypeAlias = Mapping[str, Row]  # rows by name, the first gait first

BASELINES: dict[str, Row] = {  # plans that the gait is compared with, by what they change of the walk
    "plain plan": {},
    "plan of 35 mm": {"step_length": 0.035},
}
BASELINE_WORLDS = 50  # of plans that are not the first gait, which walks in all


def measure_baselines(
    cost: WalkingCost, plan: PlanKind, test_worlds: int, progress: bool, cheapest: bool, stored: Stored
) -> list[Row]:
    """Measure each of `BASELINES` like the optimized gait; of one that cannot be planned or falls, give the reason.

    The first row is the first gait, that of `plan`; cheapest: search for the cheapest plan too; stored: rows that were
    measured before.
    """
    found, count = [], min(test_worlds, BASELINE_WORLDS)
    asked: dict[str, Row] = BASELINES | ({CHEAPEST: {"plan": "cheapest"}} if cheapest else {})
    if plan == "cheapest":
        asked = {CHEAPEST: {}} | {name: walk for name, walk in asked.items() if walk}
    for name, walk in progress_bar(asked.items(), "baselines", progress=progress and count > 0, unit="plan"):
        known = stored.get(name)
        if known and (not walk or not count or known["elsewhere"] is None or known["elsewhere"]["worlds"] == count):
            row = {key: value for key, value in known.items() if key != "settings"}
            found.append(row if walk and count else row | {"elsewhere": None})
        else:
            found.append(_measured(cost, name, walk, count, progress, known))
    return found


def _measured(cost: WalkingCost, name: str, walk: Row, count: int, progress: bool, known: Row | None) -> Row:
    """Measure a baseline, of a plan that is known or searched."""
    scene, one = cost.scene, cost
    row: Row = {"name": name, "walk": walk, "status": "ok", "elsewhere": None}
    try:
        assert scene.gearbox is not None
        if walk:
            states: States = "stride" if cost.gait.mirror is None else "step"
            how = walk if known is None else known["settings"]
            one = walking_cost(
                scene.model, scene.gearbox, scene.ground, scene.gravity, states=states, progress=progress, **how
            )
    except ValueError as error:
        return row | {"status": str(error)}
    x = one.gait.to_vector()
    row |= one.measure([x])[0].as_dict()
    if walk and count and row["status"] == "ok":  # those of the first gait are known
        (row["elsewhere"],) = measure_in_test_worlds(one, [x], count, False)
    return row


def stored_baselines(first: Measures) -> Stored:
    """Return the stored rows whose first gait has the measures `first`; none if no first gait has."""
    for rows in stored_rows().values():
        if is_measured(rows[0], first):
            return {row["name"]: row for row in rows}
    return {}


def stored_anew(servo: str | None) -> Sequence[Row]:
    """Measure the humanoid's baselines with a servo, as they are stored: with the settings of each plan.

    The first row is the plain plan, or the cheapest one if the plain plan does not walk in the worlds of a search.
    """
    own = load_robot("humanoid", locked="simplified")
    cost = walking_cost(own if servo is None else with_servo(own, servo), states="step")
    plain = math.isfinite(in_worlds(cost, OptimizeOptions().worlds)(cost.gait.to_vector())[0])
    found = cheapest_plan(cost.scene, "step")
    cheapest = {"followed": ACCURATE, **asdict(found.plan.walk)}
    first = cost if plain else found.cost
    rows = measure_baselines(first, "plain" if plain else "cheapest", TEST_WORLDS, False, False, {})
    (rows[0]["elsewhere"],) = measure_in_test_worlds(first, [first.gait.to_vector()], TEST_WORLDS, False)
    if plain:
        rows.append(_measured(cost, CHEAPEST, {"plan": "cheapest"}, BASELINE_WORLDS, False, {"settings": cheapest}))
    return [row | {"settings": cheapest if row["name"] == CHEAPEST else row["walk"]} for row in rows]


def main() -> None:
    """Write `FILE`."""
    servos = {servo or "own": stored_anew(servo) for servo in SERVOS}
    with complete(FILE) as path:
        path.write_text(json.dumps({"format": str(FORMAT), "servos": servos}) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
