"""Rows of `robots/humanoid/baselines.json`: plans of the humanoid that were searched and measured before.

`python -m featherstone_gait.optimize.baselines` writes the file.  A row is used only where its gait has the same
measures on its own ground today, to the last bit.  Robot, servos, step and plan all change these.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from ..base.files import Format, read_json
from ..robot_file.source import robots_folder
from ..walking.cost import Measures

Row: TypeAlias = dict[str, Any]

CHEAPEST = "cheapest plan"  # name of the row of the plan that `walking.cheapest_plan` finds
FILE, FORMAT = robots_folder() / "humanoid" / "baselines.json", Format("measured baselines")
SERVOS: tuple[str | None, ...] = (None, "ax12a")  # servos whose rows are stored; None: the humanoid's own


def stored_rows() -> Mapping[str, list[Row]]:
    """Return the stored rows of each servo, the first gait first."""
    rows: Mapping[str, list[Row]] = read_json(FILE, FORMAT)["servos"] if FILE.exists() else {}
    return rows


def is_measured(row: Row, measures: Measures) -> bool:
    """Check whether a row has these measures, to the last bit."""
    found = measures.as_dict()
    return {key: row.get(key) for key in found} == found
