"""The report of a gait search as a table to read in a terminal."""

from __future__ import annotations

import math

from ..walking.limits import LIMITS

SHOWN_IN = {"m": ("mm", 1e3), "rad": ("deg", math.degrees(1.0)), "-": ("%", 100.0)}  # units of limits in tables
NOT_CHECKED = "not run; how the gait walks in MuJoCo is not known (optimize --crosscheck)"


def summary(report: dict) -> str:
    """Format a report as a table.

    Parameters
    ----------
    report : dict
        What `main_job` returns, or its JSON file holds.

    Returns
    -------
    str
        Lines of text.
    """
    search, work, lanes = report["search"], report["evaluations"], report["evaluations"]["lane_occupancy"]
    pushes = []
    if report.get("feedback"):
        with_it, without = (math.fsum(report["feedback"]["pushes"][side]) / 8 for side in ("with", "without"))
        pushes.append(
            f"push survived in half of the cases, mean of eight directions: {with_it:.3g} N s with feedback, "
            f"{without:.3g} without; other worlds and the crosscheck are walked with feedback"
        )
    return "\n".join([
        *_heading(report),
        *_measures(report),
        *_limits(report["plausible"]),
        *_comparisons(report),
        f"{search['candidates']} candidates in {report['seconds']['search']:.1f} s, in total "
        f"{report['seconds']['all']:.1f} s: {search['message']}",
        f"{work['begun']} evaluations begun, {work['wasted']} of them wasted by speculation"
        + (f"; lanes {100.0 * lanes:.1f} % occupied" if lanes is not None else ""),
        *pushes,
        f"crosscheck: {report.get('crosscheck') or NOT_CHECKED}",
        *(f"{kind:16} {path}" for kind, path in report["files"].items()),
    ])  # fmt: skip


def _heading(report: dict) -> list[str]:
    settings, own = report["settings"], report.get("with_own_servos")
    where = f"{settings['worlds']} worlds" if settings["worlds"] else "one floor"
    lines = [f"servo {settings['servo']}, poses of a {settings['states']}, {where}"]
    if own is not None and own["servo"] != "none":
        with_it, with_own = (
            f"{x['cost']:.1f} J/m at {1e3 * x['speed']:.0f} mm/s" if x["status"] == "ok" else x["status"]
            for x in (report["before"], own)
        )
        lines.append(f"first gait with this servo: {with_it}; with the robot's own, {own['servo']}: {with_own}")
    return lines


def _measures(report: dict) -> list[str]:
    """Format the measures of both gaits, a line a measure."""
    before, after = (
        report[side] | {"finer_cost": report[side]["at_a_quarter_of_the_step"]["cost"]} for side in ("before", "after")
    )
    rows = [
        ("energy per distance", "cost", "J/m", 1.0, 1),
        ("... at a quarter of the step", "finer_cost", "J/m", 1.0, 1),
        ("cost of transport", "cost_of_transport", "", 1.0, 2),
        ("step length", "stride_length", "mm", 500.0, 1),
        ("speed", "speed", "mm/s", 1e3, 1),
        ("slip a stride", "slip", "mm", 1e3, 1),
        ("walks with angles off by 1 deg", "safe", "%", 100.0, 0),
    ]
    if (elsewhere := report["elsewhere"]) is not None:
        before, after = (
            side | {"walks": there["walks"], "sideways_share": there["sideways"]}
            | dict(zip(("cost_5", "cost_50", "cost_95"), there["cost"] or [None] * 3))
            for side, there in ((before, elsewhere["before"]), (after, elsewhere["after"]))
        )  # fmt: skip
        rows += [
            (f"walks in {elsewhere['after']['worlds']} other worlds", "walks", "%", 100.0, 1),
            ("energy there: median", "cost_50", "J/m", 1.0, 1),
            ("... 5th percentile", "cost_5", "J/m", 1.0, 1),
            ("... 95th percentile", "cost_95", "J/m", 1.0, 1),
            ("largest sideways drift there", "sideways_share", "%", 100.0, 1),
        ]
    lines = [f"{'':30} {'first':>10} {'optimized':>10} {'change':>8}"]
    for name, key, unit, scale, digits in rows:
        a, b = (math.nan if side[key] is None else scale * side[key] for side in (before, after))
        change = f"{100.0 * (b / a - 1.0):+.0f} %" if a > 0.0 and b > 0.0 and unit != "%" else ""
        cells = ["fails" if math.isnan(x) else f"{x:.{digits}f}" for x in (a, b)]
        lines.append(f"{name:30} {cells[0]:>10} {cells[1]:>10} {change:>8} {unit}".rstrip())
    return lines


def _limits(plausible: dict) -> list[str]:
    """Format the limits of a real robot, a line a limit."""
    sides = [{one["name"]: one for one in plausible[side]["limits"] or []} for side in ("before", "after")]
    lines = ["limits of a real robot, worst values on its own ground (! beyond the limit)"] if any(sides) else []
    for limit in LIMITS:
        unit, scale = SHOWN_IN[limit.unit]
        cells, where = [], ""
        for side in sides:
            one = side.get(limit.name)
            known = one is not None and one["value"] is not None
            cells.append(f"{scale * one['value']:.1f}{'' if one['kept'] else '!'}" if one and known else "none")
            if one and known and one["time"] is not None:
                where = f"{one['where']} at {one['time']:.2f} s"
        if any(sides):
            bound = f"{'at most' if limit.most else 'at least'} {scale * limit.bound:g} {unit}"
            lines.append(f"{limit.what:30} {cells[0]:>10} {cells[1]:>10} {bound}")
            lines += [f"    worst: {where}"] if where else []
    return lines


def _comparisons(report: dict) -> list[str]:
    """Compare with the baselines, with the power of the electronics, and at equal speed."""
    standby, found = report["standby"], report["after"]["cost"]
    lines = []
    for row in report["baselines"][1:]:
        if row["status"] == "ok" and found is not None:
            walk, gain = f"{row['cost']:.1f} J/m, {1e3 * row['speed']:.0f} mm/s", 100.0 * (found / row["cost"] - 1.0)
            lines.append(f"compared with the {row['name']} ({walk}): {gain:+.0f} %")
    for name in standby["watts"]:
        a, b = standby["before"][name], standby["after"][name]
        if a is not None and b is not None and standby["watts"][name]:
            watts = f"J/m, {standby['watts'][name]:.1f} W{' assumed' if standby['assumed'] else ''}"
            what = "+ " + name.replace("electronics of the ", "electronics: ")
            lines.append(f"{what:31}{a:10.1f} {b:10.1f} {100.0 * (b / a - 1.0):+6.0f} % {watts}")
    for row in report["at_equal_speed"]:
        what = f"as fast as the {row['baseline']} ({1e3 * row['speed']:.0f} mm/s, {row['cost']:.1f} J/m)"
        if row["found"] is None:
            lines.append(f"{what}: none on the search's path")
        else:
            lines.append(f"{what}: {row['found']['cost']:.1f} J/m, {-100.0 * row['gain']:+.0f} %")
    return lines
