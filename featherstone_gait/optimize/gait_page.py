"""Write the report of a gait search as a page, from the report's JSON and the costs of the candidates.

`report_data` arranges these as tiles, tables, texts and charts, which `page.js` draws.  A cell of a table is a text, or
`_cell`.  In texts **words** are bold and `words` are code.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any
from urllib.parse import quote

import numpy as np

from ..base.files import FilePath
from ..view.page import Page, render
from ..walking.feedback import Feedback

Report = Mapping[str, Any]
Part = dict[str, Any]  # of a section: a text, a table or a chart
UNITS = {"m": ("mm", 1e3), "rad": ("°", math.degrees(1.0)), "-": ("%", 100.0)}  # of limits, as they are shown
NONE = "–"
FILES = {
    "report": "all results, JSON", "arrays": "gait vectors, poses and costs, NumPy", "convergence": "the search, plot",
    "angles_plot": "joint angles, plot", "animation": "both gaits, to play", "angles": "joint angles over time, CSV",
    "goal_positions": "goal positions of AX-12 servos, CSV", "history": "every candidate, to resume from",
    "limits_history": "every step with limits", "crosscheck": "walks in MuJoCo, JSON",
    "crosscheck_table": "walks in MuJoCo, CSV",
}  # fmt: skip
SIDES = ("before", "after")
TOWARDS = ("ahead", "ahead, left", "left", "behind, left", "behind", "behind, right", "right", "ahead, right")


def write_gait_page(path: FilePath, report: Report, costs: np.ndarray) -> None:
    """Write the page of a report.

    Parameters
    ----------
    path : path
        Of the HTML file.
    report : mapping
        What `main_job` returns.
    costs : ndarray, shape (n,)
        Energy per distance of the candidates [J/m], infinite if they fall.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    Page(render(f"A gait for {report['robot']}", {"report": report_data(report, costs)})).save(path)


def report_data(report: Report, costs: np.ndarray) -> dict[str, Any]:
    """Arrange a report for `page.js`: its lead, tiles (name, value, note), and sections of parts."""
    settings = report["settings"]
    where = f"{settings['worlds']} worlds at once" if settings["worlds"] else "one floor"
    sections = [
        ("The gait found", _compared(report)),
        ("In other worlds", _elsewhere(report)),
        ("Limits of a real robot", _limits(report)),
        ("Currents of the servos", _currents(report)),
        ("With standing power", _standby(report)),
        ("At equal speed", _at_equal_speed(report)),
        ("Pushes with and without feedback", _feedback(report)),
        ("In MuJoCo", _in_mujoco(report)),
        ("The search", _search(report, costs)),
        ("Files", _files(report["files"])),
    ]
    return {
        "lead": f"{report['search']['candidates']} candidates, each on {where}, seed {settings['seed']}; servo "
        f"{settings['servo']}; four poses of a {settings['states']}. Version {report['version']}.",
        "tiles": [*_tiles(report)],
        "sections": [{"title": title, "parts": parts} for title, parts in sections if parts],
    }


def _tiles(report: Report) -> Iterable[tuple[str, str, str]]:
    before, after = report["before"], report["after"]
    yield "energy per distance", _number(after["cost"], " J/m"), _change(before["cost"], after["cost"])
    yield "speed", _number(after["speed"], " mm/s", 1e3), _change(before["speed"], after["speed"])
    if report["elsewhere"]:
        there = report["elsewhere"]["after"]
        yield "walks in other worlds", _number(there["walks"], " %", 100.0), f"of {there['worlds']}, 20 strides"
    found = report["plausible"]["after"]["limits"] or []
    missed = [one["name"] for one in found if not one["kept"]]
    note = f"not: {', '.join(missed)}" if missed else "on its own floor"
    yield "limits of a real robot met", f"{len(found) - len(missed)} of {len(found)}", note


def _compared(report: Report) -> list[Part]:
    """Compare the gaits, baselines first."""
    rows = [*report["baselines"], report["after"] | {"name": "found"}]
    measures = (
        ("energy per distance", "cost", "J/m", 1.0, 1),
        ("cost of transport", "cost_of_transport", "", 1.0, 2),
        ("step length", "stride_length", "mm", 500.0, 1),
        ("speed", "speed", "mm/s", 1e3, 0),
    )
    body = [
        _row(name, unit, [row.get(key) for row in rows], scale, digits) for name, key, unit, scale, digits in measures
    ]
    finer, own = report["after"]["at_a_quarter_of_the_step"]["cost"], report["after"]["cost"]
    first = report["before"]["at_a_quarter_of_the_step"]["cost"]
    error = f"{100.0 * (own / finer - 1.0):+.2f} %" if finer and own else "it does not walk"
    safe, first_safe = (100.0 * report[side]["safe"] for side in ("after", "before"))
    return [
        _table(["", *(row["name"] for row in rows)], body),
        *(_text(f"**{row['name']}**: {row['status']}") for row in rows if row["status"] != "ok"),
        _text(
            f"Error of the time step: {error}; at a quarter of it the gait takes {_number(finer)} J/m (first gait "
            f"{_number(first)}). Walks with all joint angles off by up to 1°: {safe:.0f} % "
            f"(first gait {first_safe:.0f} %)."
        ),
    ]


def _elsewhere(report: Report) -> list[Part]:
    """Show in how many unseen worlds each gait walks, and percentiles of its cost and speed there."""
    rows = [(row["name"], row["elsewhere"]) for row in report["baselines"] if row["elsewhere"]]
    rows += [("found", report["elsewhere"]["after"])] if report["elsewhere"] else []
    if not rows:
        return [_text("Not tested.")]
    body = [
        [
            _cell(name, f"{there['worlds']} worlds"),
            _number(there["walks"], " %", 100.0),
            *(_spread(there[key], scale) for key, scale in (("cost", 1.0), ("speed", 1e3))),
        ]
        for name, there in rows
    ]
    bars = [(name, *there["cost"]) for name, there in rows if there["cost"]]
    what = "Energy per distance in other worlds [J/m]: 5th to 95th percentile, median"
    return [
        _text("Floors, servos, links and starts that the search did not use; 20 strides at a quarter of the step."),
        _table(["", "walks", *(_cell(unit, "5 to 95 % of them") for unit in ("J/m", "mm/s"))], body),
        *([{"chart": "intervals", "what": what, "rows": bars}] if bars else []),
        *(
            _text(
                f"Sideways drift of {name}: mean {100.0 * there['mean_sideways']:+.1f} % of the distance, at most "
                f"{100.0 * there['sideways']:.0f} %."
            )
            for name, there in rows
            if there["sideways"] is not None
        ),
    ]


def _limits(report: Report) -> list[Part]:
    """Show the worst value of each limit, where and when it was reached."""
    sides = [{one["name"]: one for one in report["plausible"][side]["limits"] or []} for side in SIDES]
    body = []
    for name, one in (sides[1] or sides[0]).items():
        unit, scale = UNITS[one["unit"]]
        bound = f"{'at most' if one['most'] else 'at least'} {scale * one['bound']:g} {unit}"
        body.append([_cell(one["what"], bound), *(_worst(side.get(name)) for side in sides)])
    if not body:
        return [_text("Not measured: neither gait walks on its own floor.")]
    head = ["", "first", "found"]
    return [_text("The worst value on the robot's own floor, every 10 ms."), _table(head, body)]


def _worst(one: Mapping[str, Any] | None) -> Any:
    if one is None or one["value"] is None:
        return NONE
    unit, scale = UNITS[one["unit"]]
    share = "" if one["kept"] or not one["share"] else f", {100.0 * one['share']:.1f} % of the samples"
    where = f"{one['where'].replace('_', ' ')}, {one['time']:.2f} s{share}" if one["time"] is not None else ""
    mark = ("good", "met") if one["kept"] else ("bad", "not met")
    return _cell(f"{scale * one['value']:.1f} {unit} ", where, mark)


def _currents(report: Report) -> list[Part]:
    sides = [report["plausible"][side]["current"] for side in SIDES]
    if None in sides:
        return []
    rows = (
        ("peak of the most loaded motor", "peak"),
        ("root mean square of that motor", "rms"),
        ("all servos together, mean", "drawn_mean"),
        ("all servos together, peak", "drawn_peak"),
    )
    body = [_row(name, "A", [side[key] for side in sides], digits=2) for name, key in rows]
    where = sides[1]["where"].replace("_", " ")
    text = f"The peak of the gait found is that of the {where} at {sides[1]['time']:.2f} s."
    return [_table(["", "first", "found"], body), _text(f"{text} {report['plausible']['servo']}")]


def _standby(report: Report) -> list[Part]:
    standby = report["standby"]
    powers = {f"+ {name}": (name, f"{watts:.2f} W") for name, watts in standby["watts"].items() if watts}
    powers = {"motors alone": ("motors", "the paper's cost")} | powers
    rows = [_row(text, small, [standby[side][name] for side in SIDES]) for text, (name, small) in powers.items()]
    note = "Assumed: 0.05 A per servo at its supply." if standby["assumed"] else "Powers as given."
    return [_table(["J/m", "first", "found"], rows), _text(f"{note} The search does not include it.", soft=True)]


def _at_equal_speed(report: Report) -> list[Part]:
    """Compare each baseline with the cheapest gait of the search that is as fast."""
    rows = [
        [
            row["baseline"],
            _at_speed(row),
            "none in the search" if row["found"] is None else _at_speed(row["found"]),
            NONE if row["found"] is None else f"{-100.0 * row['gain']:+.0f} %",
        ]
        for row in report["at_equal_speed"]
    ]
    text = (
        "The cheapest gait that the search tried within 5 % of the plan's speed; with equal periods, equal speeds mean "
        "equal steps. The search did not aim at this speed, so the gain is at least this. In the first half of a "
        "search with limits, gaits need not meet them."
    )
    return [_table(["", "the plan", "found at its speed", ""], rows), _text(text, soft=True)] if rows else []


def _at_speed(gait: Mapping[str, Any]) -> Any:
    return _cell(f"{_number(gait['cost'])} J/m", _number(gait["speed"], " mm/s", 1e3, 0))


def _feedback(report: Report) -> list[Part]:
    """Show the pushes that are survived with the feedback that was searched for and without, and its gains."""
    found = report.get("feedback")
    if not found:
        return []
    sides = [found["pushes"][side] for side in ("without", "with")]
    pushes = [[name, *(_number(side[k], " N s", digits=2) for side in sides)] for k, name in enumerate(TOWARDS)]
    pushes.append(["mean", *(_number(math.fsum(side) / len(side), " N s", digits=2) for side in sides)])
    gains = [
        [_cell(one.metadata["what"], one.metadata["unit"]), f"{found['gains'][one.name]:.3g}"]
        for one in fields(Feedback)
    ]
    return [
        _text(
            "The impulse on the trunk, within 0.1 s, at which half of the robots fall, in the worlds of the search, at "
            "four phases of the stride. Results in other worlds and in MuJoCo are with feedback."
        ),
        _table(["toward", "without", "with feedback"], pushes),
        _table(["gain", ""], gains),
    ]


def _in_mujoco(report: Report) -> list[Part]:
    result = report.get("crosscheck")
    if not result:
        commands = "`featherstone-gait optimize --crosscheck` or `featherstone-gait crosscheck`"
        return [_text(f"**Not run**: it is not known whether the gait walks on MuJoCo's floors. {commands} tests it.")]
    falls = _cell("", mark=("bad", "falls"))
    body = [
        [
            _cell(row["floor"].replace("_", ", friction "), row["soles"]),
            *(falls if row[side] is None else _number(row[side]) for side in ("mujoco", "own")),
        ]
        for row in report.get("crosscheck_floors") or []
    ]
    text = _text(f"{result[:1].upper() + result[1:]}.")
    return [text, _table(["floor", "MuJoCo, J/m", "here, J/m"], body)] if body else [text]


def _search(report: Report, costs: np.ndarray) -> list[Part]:
    chosen = [
        [f"gait {one['candidate']}", _number(one["searched"]), str(one["kept"]), _number(one["walks"], " %", 100.0, 0),
         _number(one["cost"])]
        for one in report["search"]["chosen_among"]
    ]  # fmt: skip
    why = (
        "Gaits of the search, tested again in other worlds. Among those that fail in at most one world, the gait that "
        "meets the most limits is chosen; among equals the one that walks in most worlds, then the cheapest."
    )
    head = ["", "searched, J/m", "limits met", "walks", "in other worlds, J/m"]
    message = (
        f"{report['search']['message']}. Times and numbers of evaluations, which vary between runs, are in the JSON "
        "file."
    )
    return [
        *_convergence(costs, report["search"]["with_limits_from"], report["search"]["candidates"]),
        *([_text(why), _table(head, chosen)] if chosen else []),
        _text(message, soft=True),
    ]


def _convergence(costs: np.ndarray, since: int | None, candidates: int) -> list[Part]:
    """Chart the cost of every candidate and of the best so far."""
    if len(costs) < 2 or not np.isfinite(costs).any():
        return []
    best = np.concatenate([least_so_far(part) for part in parts_of(costs, since)])
    what = "Cost of each candidate in the search [J/m], and the lowest so far"
    what += "; with limits that of each step, which tries several" * (since is not None)
    lines = {"at": candidate_numbers(costs, since, candidates), "costs": costs, "best": best}
    rounded = {name: _rounded(values) for name, values in lines.items()}
    return [{"chart": "search", "what": what, "since": since, **rounded}]


def candidate_numbers(costs: np.ndarray, since: int | None, candidates: int) -> np.ndarray:
    """Count the candidates up to each cost; from `since` on a cost is that of a step, which tries several."""
    first, *rest = parts_of(costs, since)
    later = [np.linspace(len(first) - 1, candidates, len(part)) for part in rest]
    return np.concatenate([np.arange(float(len(first))), *later])


def _files(files: Mapping[str, str]) -> list[Part]:
    """Link the files of the search, relative to the page."""
    folder = os.path.dirname(files["page"])
    rows = [
        [FILES.get(kind, kind.replace("_", " ")), _cell(os.path.basename(path), link=os.path.relpath(path, folder))]
        for kind, path in files.items()
        if kind != "page"
    ]
    return [_table(["", "file"], rows)]


def parts_of(costs: np.ndarray, since: int | None) -> list[np.ndarray]:
    """Split the costs of a search where limits are added to its objective, at `since`."""
    return [costs] if since is None else [costs[:since], costs[since:]]


def least_so_far(costs: np.ndarray) -> np.ndarray:
    """Compute the lowest cost so far; infinite before the first finite one."""
    return np.minimum.accumulate(np.where(np.isfinite(costs), costs, np.inf))


# ------------------------------------------------------------------------------------------- parts


def _text(words: str, soft: bool = False) -> Part:
    return {"text": words, "soft": soft}


def _table(head: Sequence[Any], rows: Sequence[Sequence[Any]]) -> Part:
    return {"head": head, "rows": rows}


def _cell(text: str, small: str = "", mark: tuple[str, str] | None = None, link: str = "") -> dict[str, Any]:
    """Make a cell with small print below; mark: "good" or "bad", and the word that says so; link: path of a file."""
    cell: dict[str, Any] = {"text": text, "small": small, "mark": mark}
    return cell | {"link": "./" + quote(link.replace(os.sep, "/"))} if link else cell


def _row(text: str, small: str, values: Sequence[float | None], scale: float = 1.0, digits: int = 1) -> list[Any]:
    return [_cell(text, small), *(_number(value, "", scale, digits) for value in values)]


def _number(value: float | None, unit: str = "", scale: float = 1.0, digits: int = 1) -> str:
    if value is None or not math.isfinite(value):
        return NONE
    return f"{scale * value:.{digits}f}{unit}".replace(" ", "\N{NO-BREAK SPACE}")


def _spread(values: Sequence[float] | None, scale: float) -> Any:
    if values is None:
        return NONE
    low, middle, high = (scale * value for value in values)
    return _cell(f"{middle:.1f}", f"{low:.1f} to {high:.1f}")


def _change(before: float | None, after: float | None) -> str:
    if before is None or after is None:
        return f"first: {_number(before)}"
    return f"{100.0 * (after / before - 1.0):+.0f} % against the first gait"


def _rounded(values: np.ndarray) -> list[float | None]:
    return [float(f"{x:.5g}") if math.isfinite(x) else None for x in values.tolist()]
