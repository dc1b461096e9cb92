"""The report of a gait search as one HTML page: nothing from the network, for phones, dark rooms and paper.

It shows what the report's JSON holds and the costs of the candidates, and works out nothing that is not in them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from ..base.files import FilePath, complete
from ..walking.feedback import Feedback

Report = Mapping[str, Any]
WIDTH, HEIGHT, LEFT, RIGHT, FOOT = 420, 220, 40, 12, 32  # of a picture, and its margins [px]
UNITS = {"m": ("mm", 1e3), "rad": ("°", math.degrees(1.0)), "-": ("%", 100.0)}  # of limits, as they are shown
NONE = "–"
TOWARDS = ("ahead", "ahead, left", "left", "behind, left", "behind", "behind, right", "right", "ahead, right")


def write_gait_page(path: FilePath, report: Report, costs: np.ndarray) -> None:
    """Write the page of a report as `main_job` returns it; costs (n,) of the candidates [J/m], infinite if they fall.

    Raises OSError if the file cannot be written.
    """
    settings = report["settings"]
    where = f"{settings['worlds']} worlds at once" if settings["worlds"] else "one floor"
    parts = [
        ("What was found", _compared(report)),
        ("In other worlds", _elsewhere(report)),
        ("What a real robot asks for", _limits(report)),
        ("Currents of the servos", _currents(report)),
        ("With what is drawn all the time", _standby(report)),
        ("At equal speed", _at_equal_speed(report)),
        ("Pushes, and the feedback that answers them", _feedback(report)),
        ("In MuJoCo", _in_mujoco(report)),
        ("The search", _search(report, costs)),
    ]
    template = Template(Path(__file__).with_suffix(".html").read_text("utf-8"))
    page = template.substitute(
        title=escape(f"A gait for {report['robot']}"),
        lead=escape(
            f"{report['search']['candidates']} candidates, each on {where}, seed {settings['seed']}; servo "
            f"{settings['servo']}; four poses of a {settings['states']}. Version {report['version']}."
        ),
        tiles="".join(_tiles(report)),
        sections="".join(f"<section><h2>{escape(name)}</h2>{body}</section>" for name, body in parts if body),
    )
    with complete(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _tiles(report: Report) -> Iterable[str]:
    before, after = report["before"], report["after"]
    yield _tile("energy per distance", _number(after["cost"], " J/m"), _change(before["cost"], after["cost"], "first"))
    yield _tile("speed", _number(after["speed"], " mm/s", 1e3), _change(before["speed"], after["speed"], "first"))
    elsewhere = report["elsewhere"]
    if elsewhere:
        there = elsewhere["after"]
        yield _tile("walks in other worlds", _number(there["walks"], " %", 100.0), f"of {there['worlds']}, 20 strides")
    found = report["plausible"]["after"]["limits"] or []
    missed = [one["name"] for one in found if not one["kept"]]
    told = f"not: {', '.join(missed)}" if missed else "on its own floor"
    yield _tile("limits of a real robot kept", f"{len(found) - len(missed)} of {len(found)}", told)


def _tile(name: str, value: str, note: str) -> str:
    name, note = escape(name), escape(note)
    return f'<div class="tile"><span class="soft">{name}</span><b>{value}</b><small>{note}</small></div>'


def _compared(report: Report) -> str:
    """The gaits side by side, baselines first."""
    rows = [*report["baselines"], report["after"] | {"name": "found"}]
    measures = (
        ("energy per distance", "cost", "J/m", 1.0, 1),
        ("cost of transport", "cost_of_transport", "", 1.0, 2),
        ("step length", "stride_length", "mm", 500.0, 1),
        ("speed", "speed", "mm/s", 1e3, 0),
    )
    body = [
        [f"{name}<small>{unit}</small>", *(_number(row.get(key), "", scale, digits) for row in rows)]
        for name, key, unit, scale, digits in measures
    ]
    finer, own = report["after"]["at_a_quarter_of_the_step"]["cost"], report["after"]["cost"]
    first = report["before"]["at_a_quarter_of_the_step"]["cost"]
    error = f"{100.0 * (own / finer - 1.0):+.2f} %" if finer and own else "it does not walk"
    safe, first_safe = (100.0 * report[side]["safe"] for side in ("after", "before"))
    reasons = [
        f"<p><b>{escape(row['name'])}</b>: {escape(row['status'])}</p>" for row in rows if row["status"] != "ok"
    ]
    return (
        _table(["", *(escape(row["name"]) for row in rows)], body)
        + "".join(reasons)
        + f"<p>Error of the time step: {error}; at a quarter of it the gait takes {_number(finer)} J/m (first gait "
        f"{_number(first)}). Walks with all joint angles off by up to 1°: {safe:.0f} % "
        f"(first gait {first_safe:.0f} %).</p>"
    )


def _elsewhere(report: Report) -> str:
    """Shares and percentiles in unseen worlds."""
    rows = [
        (row["name"], row["elsewhere"]) for row in report["baselines"] if row["elsewhere"]
    ] + ([("found", report["elsewhere"]["after"])] if report["elsewhere"] else [])
    if not rows:
        return "<p>Not tried.</p>"
    body = [
        [
            f"{escape(name)}<small>{there['worlds']} worlds</small>",
            _number(there["walks"], " %", 100.0),
            *(_spread(there[key], scale) for key, scale in (("cost", 1.0), ("speed", 1e3))),
        ]
        for name, there in rows
    ]
    head = ["", "walks", "J/m<small>5 to 95 % of them</small>", "mm/s<small>5 to 95 % of them</small>"]
    return (
        "<p>Floors, servos, links and starts that the search has not seen; 20 strides at a quarter of the step.</p>"
        + _table(head, body)
        + _intervals([(name, there["cost"]) for name, there in rows if there["cost"]])
        + "".join(
            f"<p>Sideways drift of {escape(name)}: mean {100.0 * there['mean_sideways']:+.1f} % of the distance, "
            f"at most {100.0 * there['sideways']:.0f} %.</p>"
            for name, there in rows
            if there["sideways"] is not None
        )
    )


def _limits(report: Report) -> str:
    """The worst values, where and when."""
    sides = [{one["name"]: one for one in report["plausible"][side]["limits"] or []} for side in ("before", "after")]
    body = []
    for name in sides[1] or sides[0]:
        one = (sides[1] or sides[0])[name]
        unit, scale = UNITS[one["unit"]]
        bound = f"{'at most' if one['most'] else 'at least'} {scale * one['bound']:g} {unit}"
        body.append([f"{escape(one['what'])}<small>{bound}</small>", *(_worst(side.get(name)) for side in sides)])
    if not body:
        return "<p>Not measured: neither gait walks on its own floor.</p>"
    return "<p>The worst value on the robot's own floor, every 10 ms.</p>" + _table(["", "first", "found"], body)


def _worst(one: Mapping[str, Any] | None) -> str:
    if one is None or one["value"] is None:
        return NONE
    unit, scale = UNITS[one["unit"]]
    mark = '<span class="good">kept</span>' if one["kept"] else '<span class="bad">not kept</span>'
    share = "" if one["kept"] or not one["share"] else f", {100.0 * one['share']:.1f} % of the samples"
    where = f"{escape(one['where'].replace('_', ' '))}, {one['time']:.2f} s{share}" if one["time"] is not None else ""
    return f"{scale * one['value']:.1f} {unit} {mark}<small>{where}</small>"


def _currents(report: Report) -> str:
    sides = [report["plausible"][side]["current"] for side in ("before", "after")]
    if None in sides:
        return ""
    rows = (
        ("peak of the most loaded motor", "peak", "A", 2), ("root mean square of that motor", "rms", "A", 2),
        ("all servos together, mean", "drawn_mean", "A", 2), ("all servos together, peak", "drawn_peak", "A", 2),
    )  # fmt: skip
    body = [[f"{name}<small>{unit}</small>", *(_number(side[key], "", 1.0, digits) for side in sides)]
            for name, key, unit, digits in rows]  # fmt: skip
    where = sides[1]
    servo = report["plausible"]["servo"]
    return _table(["", "first", "found"], body) + (
        f"<p>The peak of the gait found is that of the {escape(where['where'].replace('_', ' '))} at "
        f"{where['time']:.2f} s. {escape(servo)}</p>"
    )


def _standby(report: Report) -> str:
    standby = report["standby"]
    rows = [["motors alone<small>the paper's cost</small>", *(_number(standby[s]["motors"]) for s in SIDES)]]
    rows += [
        [f"+ {escape(name)}<small>{watts:.2f} W</small>", *(_number(standby[s][name]) for s in SIDES)]
        for name, watts in standby["watts"].items()
        if watts
    ]
    note = "Assumed: 0.05 A per servo at its supply." if standby["assumed"] else "Powers as given."
    return _table(["J/m", "first", "found"], rows) + f'<p class="soft">{note} The search does not count it.</p>'


SIDES = ("before", "after")


def _at_equal_speed(report: Report) -> str:
    """Against each baseline the cheapest gait on the search's way that is as fast."""
    rows = []
    for row in report["at_equal_speed"]:
        found = row["found"]
        cells = ["none on the way"] if found is None else [
            f"{_number(found['cost'])} J/m<small>{_number(found['speed'], ' mm/s', 1e3, 0)}</small>"
        ]  # fmt: skip
        gain = NONE if found is None else f"{-100.0 * row['gain']:+.0f} %"
        own = f"{_number(row['cost'])} J/m<small>{_number(row['speed'], ' mm/s', 1e3, 0)}</small>"
        rows.append([escape(row["baseline"]), own, *cells, gain])
    if not rows:
        return ""
    return _table(["", "the plan", "found at its speed", ""], rows) + (
        '<p class="soft">The cheapest gait that the search tried within 5 % of the plan&#39;s speed; with equal '
        "periods, equal speeds are equal steps. The search did not aim at this speed, so the gain is at least this. In "
        "the first half of a search with limits, gaits need not keep them.</p>"
    )


def _feedback(report: Report) -> str:
    """What pushes are survived with the feedback that was searched for and without, and its gains."""
    found = report.get("feedback")
    if not found:
        return ""
    sides = [found["pushes"][side] for side in ("without", "with")]
    pushes = [[name, *(_number(side[k], " N s", 1.0, 2) for side in sides)] for k, name in enumerate(TOWARDS)]
    pushes.append(["mean", *(_number(math.fsum(side) / len(side), " N s", 1.0, 2) for side in sides)])
    gains = [
        [f"{escape(one.metadata['what'])}<small>{one.metadata['unit']}</small>", f"{found['gains'][one.name]:.3g}"]
        for one in fields(Feedback)
    ]
    return (
        "<p>The impulse on the trunk, within 0.1 s, at which half of the robots fall, in the worlds of the search, at "
        "four phases of the stride. The figures for other worlds and for MuJoCo are with feedback.</p>"
        + _table(["toward", "without", "with feedback"], pushes)
        + _table(["gain", ""], gains)
    )


def _in_mujoco(report: Report) -> str:
    told = report.get("crosscheck")
    if not told:
        return (
            "<p><b>Not run</b>: whether the gait walks on MuJoCo's floors is not known. "
            "<code>featherstone-gait optimize --crosscheck</code> or <code>featherstone-gait crosscheck</code> tells."
            "</p>"
        )
    body = [
        [f"{escape(row['floor'].replace('_', ', friction '))}<small>{escape(row['soles'])}</small>",
         *(_number(row[side]) if row[side] is not None else '<span class="bad">falls</span>'
           for side in ("mujoco", "own"))]
        for row in report.get("crosscheck_floors") or []
    ]  # fmt: skip
    table = _table(["floor", "MuJoCo, J/m", "here, J/m"], body) if body else ""
    return f"<p>{escape(told[:1].upper() + told[1:])}.</p>{table}"


def _search(report: Report, costs: np.ndarray) -> str:
    chosen = report["search"]["chosen_among"]
    body = [
        [f"gait {row['candidate']}", _number(row["searched"]), str(row["kept"]),
         _number(row["walks"], " %", 100.0, 0),
         _number(row["cost"] if row["cost"] is not None and math.isfinite(row["cost"]) else None)]
        for row in chosen
    ]  # fmt: skip
    table = _table(["", "searched, J/m", "limits kept", "walks", "there, J/m"], body) if body else ""
    why = (
        "<p>Gaits of the descent, tested again in other worlds. Of those that walk in all worlds but one at most, the "
        "gait that keeps most limits is taken; among equals the one that walks in most worlds, then the cheapest.</p>"
    )
    return (
        _convergence(costs, report["search"]["with_limits_from"])
        + (why + table if body else "")
        + f'<p class="soft">{escape(report["search"]["message"])}. Times and numbers of evaluations, '
        "which differ from run to run, are in the JSON file.</p>"
    )


# ------------------------------------------------------------------------------------------- parts


def _table(head: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    rows = "".join(
        f'<tr><th scope="row">{row[0]}</th>' + "".join(f"<td>{cell}</td>" for cell in row[1:]) + "</tr>" for row in body
    )
    heads = "".join(f'<th scope="col">{cell}</th>' for cell in head)
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"


def _number(value: float | None, unit: str = "", scale: float = 1.0, digits: int = 1) -> str:
    return NONE if value is None else f"{scale * value:.{digits}f}{unit}".replace(" ", "\N{NO-BREAK SPACE}")


def _spread(values: Sequence[float] | None, scale: float) -> str:
    if values is None:
        return NONE
    low, middle, high = (scale * value for value in values)
    return f"{middle:.1f}<small>{low:.1f} to {high:.1f}</small>"


def _change(before: float | None, after: float | None, what: str) -> str:
    if before is None or after is None:
        return f"{what}: {_number(before)}"
    return f"{100.0 * (after / before - 1.0):+.0f} % against the {what} gait"


def _intervals(rows: Sequence[tuple[str, Sequence[float]]]) -> str:
    """5th to 95th percentile and median of J/m, a bar each."""
    if not rows:
        return ""
    most, height = 1.08 * max(values[2] for _, values in rows), 44 * len(rows) + FOOT
    x = lambda value: LEFT + (WIDTH - LEFT - RIGHT) * value / most  # noqa: E731
    parts = [
        f'<text x="{x(tick):.1f}" y="{height - 12}" text-anchor="middle">{tick:g}</text>'
        f'<line class="axis" x1="{x(tick):.1f}" x2="{x(tick):.1f}" y1="6" y2="{height - FOOT + 4}"/>'
        for tick in _ticks(most)
    ]
    for k, (name, (low, middle, high)) in enumerate(rows):
        y, kind = 44 * k + 30, " found" if name == "found" else ""
        parts.append(
            f'<text x="{LEFT}" y="{y - 10}">{escape(name)}</text>'
            f'<line class="range{kind}" x1="{x(low):.1f}" x2="{x(high):.1f}" y1="{y}" y2="{y}"/>'
            f'<circle class="mid{kind}" cx="{x(middle):.1f}" cy="{y}" r="6"/>'
        )
    return _picture(height, parts, "Energy per distance in other worlds [J/m]: 5th to 95th percentile, median")


def parts_of(costs: np.ndarray, since: int | None) -> list[np.ndarray]:
    """The costs of a search, and where it changes what it asks for those before and after."""
    return [costs] if since is None else [costs[:since], costs[since:]]


def least_so_far(costs: np.ndarray) -> np.ndarray:
    """The least of the costs up to each; infinite before the first that is finite."""
    return np.minimum.accumulate(np.where(np.isfinite(costs), costs, np.inf))


def _convergence(costs: np.ndarray, since: int | None) -> str:
    """Cost of every candidate and of the best so far."""
    finite = np.isfinite(costs)
    if not finite.any() or len(costs) < 2:
        return ""
    best = np.concatenate([least_so_far(part) for part in parts_of(costs, since)])
    most = 1.15 * best[np.isfinite(best)][0]
    x = lambda k: LEFT + (WIDTH - LEFT - RIGHT) * k / (len(costs) - 1)  # noqa: E731
    y = lambda f: 8 + (HEIGHT - FOOT - 8) * (1.0 - f / most)  # noqa: E731
    parts = [
        f'<text x="{LEFT - 6}" y="{y(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>'
        f'<line class="axis" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y(tick):.1f}" y2="{y(tick):.1f}"/>'
        for tick in [0.0, *_ticks(most)]
    ]
    parts += [
        f'<text x="{x(tick):.1f}" y="{HEIGHT - 12}" text-anchor="middle">{tick:g}</text>'
        for tick in [0.0, *_ticks(len(costs) - 1)]
    ]
    shown = [k for k in np.flatnonzero(finite) if costs[k] <= most]
    parts += [f'<circle class="dot" cx="{x(k):.1f}" cy="{y(costs[k]):.1f}" r="1.6"/>' for k in shown]
    line = " ".join(f"{x(k):.1f},{y(f):.1f}" for k, f in enumerate(best) if math.isfinite(f) and f <= most)
    if since is not None:
        aside, anchor = (4.0, "start") if x(since) < 0.6 * WIDTH else (-4.0, "end")
        parts.append(f'<text x="{x(since) + aside:.1f}" y="20" text-anchor="{anchor}">keeps to limits</text>')
        parts.append(f'<line class="first" x1="{x(since):.1f}" x2="{x(since):.1f}" y1="8" y2="{HEIGHT - FOOT}"/>')
    parts.append(f'<polyline class="best" points="{line}"/>')
    return _picture(HEIGHT, parts, "Cost of each candidate [J/m] as the search sees it, and the least so far")


def _picture(height: float, parts: Iterable[str], what: str) -> str:
    return (
        f'<p class="soft">{escape(what)}</p><svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{escape(what)}">'
        + "".join(parts)
        + "</svg>"
    )


def _ticks(most: float) -> list[float]:
    """Round numbers above zero, up to six."""
    step = 10.0 ** math.floor(math.log10(most / 2.0))
    step *= next(factor for factor in (1, 2, 5, 10) if most / (factor * step) <= 6)
    return [k * step for k in range(1, int(most / step) + 1)]
