"""Write a judgment as a page: verdict, the robot in two worlds, distributions, and what it breaks on.

`report_of` arranges it as tiles, tables, texts and charts, which `view/page.js` draws as it draws those of a search.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.files import FilePath
from ..view.page import Page, render
from ..view.recorded import Seen, page_data
from .meter import FIGURES
from .statistics import DOUBT, NEEDED, wilson

if TYPE_CHECKING:
    from .judgment import Judgment

MOST_BARS, BEYOND = 24, 3.0  # of the histogram; how many quartile ranges above the upper quartile it goes
CAUSES = 5  # in the table
NONE = "–"


def write_page(judgment: Judgment, path: FilePath) -> Page:
    """Write the page of a judgment, and return it."""
    assert judgment.runs is not None
    assert judgment.scenes is not None
    worlds = judgment.shown_worlds()
    numbers = [*worlds.values()]
    data: dict[str, Any] = {}
    if numbers:
        scenes, runs = judgment.scenes(numbers), judgment.runs(numbers)
        data = page_data({caption: Seen(one.model, run, one.ground) for caption, one, run in zip(worlds, scenes, runs)})
    page = Page(render(f"{judgment.policy} on {judgment.robot}", data | {"report": report_of(judgment)}))
    page.save(path)
    return page


def report_of(judgment: Judgment) -> dict[str, Any]:
    """Arrange a judgment for `page.js`: its lead, tiles (name, value, note), and sections of parts."""
    settings = judgment.settings
    command = ", ".join(f"{x:g}" for x in settings["command"])
    sections = [
        ("In how many worlds it walks", _verdicts(judgment)),
        ("Energy", _energy(judgment)),
        ("What it breaks on", _causes(judgment)),
        ("Where it walks", _figures(judgment)),
        ("Joints", _joints(judgment)),
        ("How far to trust this", _trust(judgment)),
    ]
    return {
        "lead": f"Servo {judgment.servo}. Commanded {command} (m/s ahead, m/s to the left, rad/s), for "
        f"{settings['seconds']:g} s in each of {len(judgment.verdicts)} worlds, seed {settings['seed']}.",
        "tiles": [*_tiles(judgment)],
        "sections": [{"title": title, "parts": parts} for title, parts in sections if parts],
    }


def _tiles(judgment: Judgment) -> list[tuple[str, str, str]]:
    low, high = judgment.interval
    share = _number(100.0 * judgment.share)
    found = [
        ("verdict", judgment.verdict, f"{judgment.walking} of {len(judgment.verdicts)} worlds"),
        ("walks", f"{share} %", f"95 %: {_number(100.0 * low)} to {_number(100.0 * high)} % (Wilson)"),
    ]
    for name, what, unit in (("energy_per_way", "energy", "J/m"), ("speed", "speed", "m/s")):
        middle, first, last = judgment.spread(name)
        if math.isfinite(middle):
            found.append((what, f"{_number(middle)} {unit}", f"median; quartiles {_number(first)} to {_number(last)}"))
    return found


def _verdicts(judgment: Judgment) -> list[dict[str, Any]]:
    meant = {
        "walks": "upright, far enough", "stands": "upright, not far enough", "falls": "tilted or sunk",
        "unknown": "the simulation ended otherwise",
    }  # fmt: skip
    rows, count = [], len(judgment.verdicts)
    for name, what in meant.items():
        hits = int((judgment.verdicts == name).sum())
        low, high = judgment.interval if name == "walks" else wilson(hits, count)
        spread = f"{100.0 * low:.0f} to {100.0 * high:.0f}\N{NO-BREAK SPACE}%"
        rows.append([_cell(name, what), str(hits), f"{100.0 * hits / count:.0f} %", spread])
    rule = f"It holds where the interval of the share that walks begins at {100 * NEEDED:g} % or above."
    return [_table(["", "worlds", "share", "95 % (Wilson)"], rows), {"text": rule, "soft": True}]


def _energy(judgment: Judgment) -> list[dict[str, Any]]:
    values = judgment.worlds["energy_per_way"][judgment.verdicts == "walks"]
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return []
    first, middle, last = np.quantile(values, (0.25, 0.5, 0.75))
    shown = values[values <= last + BEYOND * (last - first)]
    edges = np.histogram_bin_edges(shown, min(MOST_BARS, max(5, math.ceil(2.0 * len(shown) ** (1.0 / 3.0)))))
    counts = np.histogram(shown, edges)[0]
    beyond = len(values) - len(shown)
    what = f"Energy by way in the {len(values)} worlds in which it walks; the line is the median, {middle:.3g} J/m"
    what += f"; {beyond} beyond {edges[-1]:.3g} J/m" * (beyond > 0)
    chart = {"chart": "histogram", "what": what, "x": "J/m", "y": "worlds", "edges": np.round(edges, 4).tolist(),
             "counts": counts.tolist(), "median": float(middle)}  # fmt: skip
    return [chart, {"text": f"Energy is {judgment.settings['energy']}.", "soft": True}]


def _causes(judgment: Judgment) -> list[dict[str, Any]]:
    parts: list[dict[str, Any]] = [{"text": f"{judgment.why()}.", "soft": False}]
    rows = [
        [_cell(_broken(one.name), "stands out" * (one.chance <= DOUBT)), f"{one.effect:+.2f}", _number(one.failing),
         _number(one.others)]
        for one in judgment.causes[:CAUSES]
    ]  # fmt: skip
    if rows:
        note = (
            "Cliff's delta: the chance that the factor is larger in a world that fails, less the chance that it is "
            "smaller. A factor stands out where so large a delta would come by chance in fewer than one of 20 "
            "judgments."
        )
        parts += [_table(["factor", "delta", "median, fails", "median, walks"], rows), {"text": note, "soft": True}]
    return parts


def _figures(judgment: Judgment) -> list[dict[str, Any]]:
    if not judgment.walking:
        return []
    rows = []
    for name, (unit, what) in FIGURES.items():
        middle, first, last = judgment.spread(name)
        spread = f"{_number(first)} to {_number(last)}"
        rows.append([_cell(what, "" if unit == "-" else unit), _number(middle), spread])
    return [_table(["", "median", "quartiles"], rows)]


def _joints(judgment: Judgment) -> list[dict[str, Any]]:
    found, rows = judgment.by_joint(), []
    motor = "peak_current" in found
    for k, name in enumerate(judgment.joint_names):
        row = [_broken(name), _cell(_number(found["peak_torque"][k]), _number(found["rms_torque"][k]))]
        row += [_cell(_number(found["peak_current"][k]), _number(found["rms_current"][k]))] if motor else []
        rows.append([*row, f"{100.0 * found['saturated'][k]:.1f} %"])
    rms = "rms below"
    head = ["", _cell("peak, N m", rms), *([_cell("peak, A", rms)] if motor else []), "saturated"]
    return [_table(head, rows), {"text": "Peaks of all worlds, medians of the rest.", "soft": True}]


def _trust(judgment: Judgment) -> list[dict[str, Any]]:
    words = judgment.reservations()
    return [{"text": f"**{name}**: {said}.", "soft": False} for name, said in words.items()]


def _table(head: Sequence[Any], rows: Sequence[Sequence[Any]]) -> dict[str, Any]:
    return {"head": head, "rows": rows}


def _cell(text: str, small: str = "") -> dict[str, Any]:
    return {"text": text, "small": small}


def _broken(name: str) -> str:
    """Return a name that a narrow column may break after dots and underscores."""
    return name.replace("_", " ").replace(".", ".\N{ZERO WIDTH SPACE}")


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else NONE
