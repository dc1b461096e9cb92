"""Numbers of the pages, as they are quoted there: worked out anew, or read from what a command has left in
`docs/reproduction/`.  `docs/remake.py` writes and compares them.
"""

from __future__ import annotations

import csv
import functools
import json
import math
import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from featherstone_gait.base.files import FilePath, Format, read_csv
from featherstone_gait.benchmark.table import TABLE

if TYPE_CHECKING:
    from featherstone_gait.walking import WalkingCost
    from featherstone_gait.walking.cheapest_plan import CheapestPlan, States

ROOT = Path(__file__).resolve().parents[1]
GAIT = ROOT / "robots" / "humanoid" / "optimized_gait.json"
KEPT = ROOT / "docs" / "reproduction"
SEEDS = {0: GAIT} | {k: KEPT / f"gait_seed_{k}.json" for k in (1, 2)}
NOMINAL = KEPT / "gait_nominal.json"
ENERGY_ONLY = {k: KEPT / f"gait_energy_only_{k}.json" for k in (0, 1, 2)}
CORRECTED = {k: KEPT / f"gait_ax12a_{k}.json" for k in (0, 1, 2)}
FROM_CHEAPEST = {k: KEPT / f"gait_from_cheapest_{k}.json" for k in (0, 1)}
WORLDS_COST, OTHER_ROBOTS = KEPT / "worlds_cost.csv", KEPT / "other_robots.csv"
OTHER_WORLDS, IN_BULLET = KEPT / "other_robots_worlds.csv", KEPT / "in_bullet.csv"
SEARCHES = KEPT / "searches.csv"
UNITS = KEPT / "unit_study_sensitivity.csv"
BENCHMARKS = KEPT / "benchmarks"
WALKS = "energy per distance, speed"


class Cells(NamedTuple):
    """Cells of a row of a page's table, None where they are not of this part."""

    page: str
    row: str  # its first cell
    cells: tuple[str | None, ...]  # after that
    below: str = ""  # how a line begins, of which the next table is meant; else there is one such row in the page

    def put(self, text: str) -> str:
        """The page with these cells in their row; raises ValueError unless there is one such row."""
        lines = text.split("\n")
        first, last = _next_table(lines, self.below) if self.below else (0, len(lines))
        rows = [k for k in range(first, last) if lines[k].startswith(f"| {self.row} |")]
        if len(rows) != 1:
            raise ValueError(f"{self.page} has {len(rows)} rows that begin with {self.row!r}; there should be one")
        old = lines[rows[0]].split("|")  # nothing, the row's name, the cells, nothing
        if len(old) != 3 + len(self.cells):
            raise ValueError(f"{self.page}, row {self.row!r}: {len(old) - 3} cells, not {len(self.cells)}")
        for k, now in enumerate(self.cells, start=2):
            if now is not None:
                old[k] = f" {_with_rest(old[k].strip(), now)} " if now else " "
        lines[rows[0]] = "|".join(old)
        return "\n".join(lines)

    def __str__(self) -> str:
        return f"{self.page}: {self.row}: {' | '.join(x for x in self.cells if x is not None)}"


class Words(NamedTuple):
    """What a page says in a line, between other words of it."""

    page: str
    before: str
    now: str
    after: str

    def put(self, text: str) -> str:
        """The page with these words; raises ValueError unless there is one such place."""
        place = re.compile(f"({re.escape(self.before)})[^\n]*?({re.escape(self.after)})")
        if len(place.findall(text)) != 1:
            count = len(place.findall(text))
            raise ValueError(f"{self.page} says {self.before!r} ... {self.after!r} {count} times; it should once")
        return place.sub(lambda found: found[1] + self.now + found[2], text)

    def __str__(self) -> str:
        return f"{self.page}: {self.before}{self.now}{self.after}"


def _next_table(lines: Sequence[str], below: str) -> tuple[int, int]:
    """First line and end of the table that follows a line; nothing of it where there is none."""
    start = next((k for k, line in enumerate(lines) if line.startswith(below)), len(lines))
    first = next((k for k in range(start, len(lines)) if lines[k].startswith("|")), len(lines))
    return first, next((k for k in range(first, len(lines)) if not lines[k].startswith("|")), len(lines))


def _with_rest(was: str, now: str) -> str:
    """The cell; what the page says after it, behind a comma or in brackets, stays."""
    return was if was == now or was.startswith((now + ",", now + " (", now + " each")) else now


# ---------------------------------------------------------------------------------------------- what commands have left


def kept(path: Path) -> dict[str, Any]:
    """What is kept of a gait's report."""
    return json.loads(path.read_text("utf-8"))


def walks(measures: dict[str, Any]) -> str:
    return f"{measures['cost']:.1f} J/m, {1e3 * measures['speed']:.0f} mm/s"


def elsewhere(found: dict[str, Any], form: str = ".1f") -> str:
    """In how many other worlds a gait walks, and its 5th and 95th percentile there."""
    return f"{100 * found['walks']:.3g} %, {found['cost'][0]:{form}} to {found['cost'][2]:{form}} J/m"


def on_floors(told: dict[str, Any]) -> list[str]:
    """Of the floors, each with both kinds of soles, how many: in MuJoCo, and here."""
    found = re.findall(r"on (\d+) of 24 floors, ([0-9.]+ to [0-9.]+) J/m", told["crosscheck"])
    assert len(found) == 2, told["crosscheck"]
    return [f"{int(n) // 2}, {costs} J/m" for n, costs in found]


def floors(name: str) -> dict[str, dict[str, str]]:
    """Rows of a crosscheck's table, soles as spheres, by floor."""
    with (KEPT / f"floors_{name}.csv").open(encoding="utf-8", newline="") as file:
        next(file)  # the format
        return {row["floor"]: row for row in csv.DictReader(file) if row["soles"] == "spheres"}


def of_floors(name: str, digits: int) -> str:
    """On how many of MuJoCo's floors it walks, and what that takes."""
    costs = [float(row["mujoco_cost_J_per_m"]) for row in floors(name).values() if row["mujoco_walks"] == "True"]
    return f"{len(costs)}, {min(costs):.{digits}f} to {max(costs):.{digits}f} J/m"


def stored_gait() -> Iterable[Cells]:
    """README and docs/optimize.md quote what stands beside the gaits that are kept."""
    told, cheap, nominal = kept(GAIT), kept(ENERGY_ONLY[0]), kept(NOMINAL)
    gaits = [(told, "before"), (told, "after"), (cheap, "after")]
    one_floor = f"{walks(nominal['after'])}, from {nominal['before']['cost']:.1f}"
    limits = [{limit["name"]: limit for limit in t["plausible"][key]["limits"]} for t, key in gaits]
    energy = [walks(t[key]) for t, key in gaits]
    forms = zip([*gaits, (nominal, "after")], (".0f", ".1f", ".0f", ".0f"))
    worlds = [elsewhere(t["elsewhere"][key], form) for (t, key), form in forms]
    count = [f"{sum(limit['kept'] for limit in each.values())} of {len(each)} limits" for each in limits]
    worst = [f"{1e3 * x['swing']['value']:.1f} mm, {math.degrees(x['tilt']['value']):.1f}°" for x in limits]
    on = of_floors("planned", 0), on_floors(told)[0], on_floors(cheap)[0], of_floors("nominal", 0)
    yield Cells("README.md", f"{WALKS} on its own floor", (*energy, one_floor))
    yield Cells("README.md", "walks 20 strides in 200 other worlds", tuple(worlds))
    yield Cells("README.md", "walks 20 strides on MuJoCo's twelve floors", on)
    yield Cells("README.md", "keeps to what a real robot asks for, on its own floor", (*count, None))
    yield Cells("README.md", "least clearance of a fast foot, largest tilt of a loaded sole", (*worst, None))
    page = "docs/optimize.md"
    yield Cells(page, WALKS, tuple(energy))
    rows = {
        "clearance of a fast foot: worst, samples below 5 mm": ("swing", "{0:.1f} mm", 1e3),
        "tilt of a loaded sole: worst, samples above 5°": ("tilt", "{0:.1f}°", math.degrees(1.0)),
        "voltage taken: worst, samples above 80 %": ("line", "{0:.0f} %", 1e2),
    }
    for row, (name, form, scale) in rows.items():
        each = [x[name] for x in limits]
        yield Cells(page, row, tuple(f"{form.format(scale * x['value'])}, {_share(x['share'])}" for x in each))
    yield Cells(page, "limbs apart", tuple(f"{1e3 * x['apart']['value']:.1f} mm" for x in limits))
    yield Cells(page, "torque over stall torque", tuple(f"{1e2 * x['torque']['value']:.0f} %" for x in limits))
    there = told["elsewhere"]["after"]
    shares = (f"{100 * told['elsewhere'][key]['walks']:.3g} %" for key in ("before", "after"))
    both = [f"{share}, {walked.partition(',')[0]}" for share, walked in zip(shares, on)]
    yield Cells(page, "200 other worlds, MuJoCo's twelve floors", (*both, None))
    drift = f"{100 * there['mean_sideways']:.1f} %, {100 * there['sideways']:.0f} %"
    yield Cells(page, "drift in 200 other worlds: mean with its sign, largest", (None, drift, None))


def seeds() -> Iterable[Cells | Words]:
    """docs/optimize.md, crosscheck.md and walking.md tell what other seeds, and another plan, come to."""
    for seed, path in SEEDS.items():
        told = kept(path)
        limits = told["plausible"]["after"]["limits"]
        found = re.search(r"on (\d+ of \d+) floors, ([0-9.]+ to [0-9.]+) J/m", told["crosscheck"])
        assert found, told["crosscheck"]
        yield Cells(
            "docs/optimize.md", f"seed {seed}",
            (walks(told["after"]), f"{sum(limit['kept'] for limit in limits)} of {len(limits)}",
             elsewhere(told["elsewhere"]["after"]), f"{found[1]}, {found[2]} J/m"),
        )  # fmt: skip
    first, *found = [(kept(CORRECTED[0]), "before"), *((kept(path), "after") for path in CORRECTED.values())]
    for name, (told, key) in {"first gait": first, **{f"seed {k}": one for k, one in enumerate(found)}}.items():
        limits = told["plausible"][key]["limits"]
        count = f"{sum(limit['kept'] for limit in limits)} of {len(limits)}"
        cells = walks(told[key]), count, elsewhere(told["elsewhere"][key])
        yield Cells("docs/servos.md", f"{name}, `ax12a`", cells)
    others = " and ".join(f"{kept(SEEDS[k])['after']['cost']:.1f}" for k in (1, 2))
    yield Words("README.md", "Seeds 1 and 2 find ", others, " J/m, within")
    drift, tilt, line = (_limit(kept(GAIT), name) for name in ("drift", "tilt", "line"))
    yield Words("docs/optimize.md", "(drift there: ", f"{100 * drift:.1f} %", "),")
    yield Words("docs/optimize.md", "just so, at ", f"{math.degrees(tilt):.1f}° and {100 * line:.1f} %", ". In")
    for paths, plan in ((ENERGY_ONLY, "the plain plan"), (FROM_CHEAPEST, "the cheapest plan")):
        for seed, path in paths.items():
            if path.exists():
                told = kept(path)
                cells = walks(told["after"]), elsewhere(told["elsewhere"]["after"]), *on_floors(told)
                if paths is ENERGY_ONLY:
                    yield Cells("docs/crosscheck.md", f"{seed}", cells, "What `optimize --energy-only` finds")
                if seed == 0:  # the second row of a plan does not name it again
                    yield Cells("docs/walking.md", plan, ("0", *cells), "## The search from either plan")


def worlds_cost() -> Iterable[Cells]:
    """docs/optimize.md tells what it costs to walk in other worlds, a number a seed."""
    from featherstone_gait.reproduction.what_worlds_cost import METHODS, TABLE

    names = {"0": "the own floor", "1": "one world", "2": "two", "4": "four", "8": "eight"}
    rows = _records(WORLDS_COST, TABLE)
    for worlds, name in names.items():
        cells: list[str | None] = []
        for method in METHODS:
            own = [row for row in rows if (row["method"], row["worlds"]) == (method, worlds)]
            cells.append(", ".join(f"{100.0 * float(row['walks']):.3g}" for row in own) + " %")
            for column in ("cost_50", "own"):
                cells.append(", ".join(f"{float(row[column]):.1f}" for row in own) + " J/m")
        yield Cells("docs/optimize.md", name, tuple(cells))


def searches() -> Iterable[Cells]:
    """docs/paper.md tells where searches stop, a number a seed."""
    from featherstone_gait.reproduction.what_stops import CONDITIONS, TABLE

    percent = lambda text: f"{100.0 * float(text):+.0f} %"  # noqa: E731
    told = (
        lambda row: f"{float(row['first']):.1f} to {float(row['best']):.1f}",
        lambda row: percent(row["cost"]) + (f" ({row['fell']} fall)" if int(row["fell"]) else ""),
        lambda row: percent(row["longer"]),
        lambda row: f"{row['passed']}, {percent(row['longer_then'])}" if int(row["passed"]) >= 0 else "never",
    )
    kept = _records(SEARCHES, TABLE)
    kinds = {field.name: type(getattr(CONDITIONS[0], field.name)) for field in fields(CONDITIONS[0])}
    for condition in CONDITIONS:
        rows = [row for row in kept if all(kind(row[name]) == getattr(condition, name) for name, kind in kinds.items())]
        yield Cells("docs/paper.md", str(condition), tuple("; ".join(map(each, rows)) for each in told))


def units() -> Iterable[Cells | Words]:
    """docs/tutorials/study.md tells which difference between units matters."""
    from featherstone_gait.study.sensitivity import SENSITIVITY

    names = {
        "zeros of the joints, 0.03 rad": "reference.offset", "torque constant, 10 %": "servos.motor_constant",
        "gain, 10 %": "servos.Kp", "resistance, 10 %": "servos.resistance",
        "the floor's sinking, a factor 1.6": "ground.sinking", "mass of each link, 10 %": "links.mass",
        "supply, 10 %": "servos.voltage_limit", "friction of the floor": "ground.friction",
        "stiffness of the gears, 10 %": "servos.stiffness", "viscous friction, 10 %": "servos.viscous_friction",
    }  # fmt: skip
    found = {(row["measure"], row["parameter"]): row for row in _records(UNITS, SENSITIVITY)}
    for what, name in names.items():
        rows = [found[measure, f"worlds.{name}"] for measure in ("cost_J_m", "speed_m_s", "walks")]
        cells = tuple(f"{float(row['first']):.2f}, {float(row['total']):.2f}".replace("-0.00", "0.00") for row in rows)
        yield Cells("docs/tutorials/study.md", what, cells)
    notes = [line[2:] for line in UNITS.read_text("utf-8").splitlines() if line.startswith("# ")]
    spread = {note.partition(":")[0]: note for note in reversed(notes)}  # of two about one measure the first
    quantiles = re.findall(r"(?:below|median|above) (\S+?)(?:,|$)", spread["cost_J_m"])
    low, middle, high = (float(text) for text in quantiles)
    walks = 100.0 * float(re.findall(r"mean (\S+?),", spread["walks"])[0])
    said = f"{walks:.1f} % walk to the end, at {middle:.1f} J/m in the median ({low:.1f} to {high:.1f}"
    yield Words("docs/tutorials/study.md", "Of these units ", said, ", the 5th and 95th")
    counts = [re.findall(r"indices of (\d+) base samples of (\d+)", note) for note in notes if "cost_J_m" in note]
    yield Words("docs/tutorials/study.md", "are told of the ", " of ".join(counts[1][0]), " base samples")


def other_robots() -> Iterable[Cells]:
    """docs/crosscheck.md tells how other robots walk in MuJoCo, docs/walking.md how in other worlds."""
    from featherstone_gait.crosscheck import FLOORS
    from featherstone_gait.reproduction.other_robots import ROBOTS, TABLE, WORLDS_TABLE

    rows = _records(OTHER_ROBOTS, TABLE)
    each: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in rows:
        each.setdefault((row["robot"], row["gait"]), []).append(row)
    page = "docs/crosscheck.md"
    for (robot, gait), found in each.items():
        own = f"{float(found[0]['own_ground_J_per_m']):.1f} J/m, {1e3 * float(found[0]['own_ground_m_per_s']):.0f} mm/s"
        yield Cells(page, f"{robot}, {gait}", (own, *(_floors_told(found, side) for side in ("mujoco", "here"))))
    unfinished = (None,) * (sum(4 if robot.feedback else 2 for robot in ROBOTS.values()) - len(each))
    for name, (time_constant, friction) in FLOORS.items():
        on = [next(row for row in found if row["floor"] == name) for found in each.values()]
        walks = tuple(_walk_told(row, "mujoco") for row in on)
        yield Cells(page, f"{1e3 * time_constant:g} ms, {friction:g}", (*walks, *unfinished))
    for row in _records(OTHER_WORLDS, WORLDS_TABLE):
        x = {name: float(row[name]) for name in row if name not in ("robot", "gait", "pushes_N_s")}
        own = f"{x['own_ground_J_per_m']:.1f} J/m ({x['own_ground_cost_of_transport']:.2f}), " \
              f"{1e3 * x['own_ground_m_per_s']:.0f} mm/s"  # fmt: skip
        there = f"{x['p50_J_per_m']:.0f}, {x['p5_J_per_m']:.0f} to {x['p95_J_per_m']:.0f} J/m"
        cells = (own, f"{x['searched_worlds_J_per_m']:.0f} J/m", f"{100 * x['walks']:g} %", there)
        yield Cells("docs/walking.md", f"{row['robot']}, {row['gait']}", cells)
        if row["pushes_N_s"]:
            yield Cells("docs/feedback.md", f"{row['robot']}, {row['gait']}", (f"{float(row['pushes_N_s']):.1f} N s",))


def in_bullet() -> Iterable[Cells]:
    """docs/crosscheck.md tells how gaits walk in Bullet."""
    from featherstone_gait.reproduction.in_bullet import FLOORS, FRICTIONS, GAITS, TABLE

    rows = {(row["gait"], row["floor"], float(row["friction"])): row for row in _records(IN_BULLET, TABLE)}
    for gait in GAITS:
        on = [rows[gait, floor, friction] for floor in FLOORS for friction in FRICTIONS]
        cells = tuple(
            f"{float(row['cost_J_per_m']):.1f}, {1e3 * float(row['speed_m_per_s']):.0f}"
            if row["walks"] == "True"
            else f"falls, {float(row['end_s']):.1f} s"
            for row in on
        )
        yield Cells("docs/crosscheck.md", f"{gait}, in Bullet", cells)


def _floors_told(rows: Sequence[dict[str, str]], side: str) -> str:
    walks = [row for row in rows if row[f"{side}_walks"] == "True"]
    if not walks:
        return f"0 of {len(rows)}"
    costs, speeds = ([float(row[f"{side}_{x}"]) for row in walks] for x in ("cost_J_per_m", "speed_m_per_s"))
    return (f"{len(walks)} of {len(rows)}, {min(costs):.1f} to {max(costs):.1f} J/m, "
            f"{1e3 * min(speeds):.0f} to {1e3 * max(speeds):.0f} mm/s")  # fmt: skip


def _walk_told(row: dict[str, str], side: str) -> str:
    if row[f"{side}_walks"] != "True":
        return f"falls, {float(row[f'{side}_end_s']):.1f} s"
    return f"{float(row[f'{side}_cost_J_per_m']):.1f}, {1e3 * float(row[f'{side}_speed_m_per_s']):.0f}"


def _records(path: FilePath, form: Format) -> list[dict[str, str]]:
    (_, names), *rows = read_csv(path, form)
    return [dict(zip(names, cells)) for _, cells in rows]


PRECISION = {  # row of docs/accuracy.md -> problem, integrator, step and tolerance of the benchmark
    "free arm, 1 s, chaotic: `dop853`, tolerance 1e-6": ("arm, free", "dop853", "", "1e-06"),
    "free arm: `extrapolation`, tolerance 1e-8": ("arm, free", "extrapolation", "", "1e-08"),
    "free arm: `rk4`, 1 ms": ("arm, free", "rk4", "0.001", ""),
    "stiff servos without rotor, 0.5 s: `implicit_euler`, 10 ms": ("arm, stiff servos", "implicit_euler", "0.01", ""),
    "stiff servos: `midpoint`, 10 ms": ("arm, stiff servos", "midpoint", "0.01", ""),
    "stiff servos: `extrapolation`, tolerance 1e-4": ("arm, stiff servos", "extrapolation", "", "0.0001"),
    "geared servos (MIPSD), sampled: `midpoint`, 1 ms": ("arm, geared servos", "midpoint", "0.001", ""),
    "humanoid standing on the ground: `midpoint`, 1 ms": ("humanoid, standing", "midpoint", "0.001", ""),
    "humanoid walking, one stride: `midpoint`, 1 ms": ("humanoid, walking a stride", "midpoint", "0.001", ""),
    "humanoid walking: `ars343`, tolerance 1e-2": ("humanoid, walking a stride", "ars343", "", "0.01"),
    "flyball governor (IFToMM A05), 10 s: `dop853`, tolerance 1e-8": (
        "IFToMM A05, flyball governor", "dop853", "", "1e-08",
    ),
}  # fmt: skip
SESSION = {  # row of docs/session.md -> that of the benchmark
    "rate of 64 robots in a session, over that of one call of `simulate_batch` for 1 s": (
        "rate of 64 in a session, over that of simulate_batch"
    ),
    "the same by CPU time, on one core": "rate of 64 in a session, by CPU time, over that of simulate_batch",
    "overhead of a step of one robot, CPU time beyond that of its kernel": "overhead of a tick of one robot",
    "CPU time of one robot with a compiled controller, by that without": (
        "CPU time of 1 with a compiled controller, by that without"
    ),
    "CPU time of 64, likewise": "CPU time of 64 with a compiled controller, by that without",
    "actions a second of 64 in `StandVector`, over those of MuJoCo's threaded rollout of the same robot (5 turns)": (
        "that rate, over MuJoCo's rollout's"
    ),
}

LINEARISED = {  # row of docs/control.md -> scene and method of the benchmark
    "falling under torques, 10 steps": ("falling", "linearize, 10 steps"),
    "falling under torques, 1 step": ("falling", "linearize, 1 step"),
    "standing, rigid servos, a controller period of 10 ms": ("standing", "linearize, rotor, implicit_euler"),
    "standing, spring-damper servos, a controller period of 10 ms": ("standing", "linearize, mipsd, implicit_euler"),
}


def benchmarked() -> Iterable[Cells | Words]:
    """Times on one machine, from what `featherstone-gait benchmark` left there."""
    yield from _speeds()
    timed = {tuple(row[k] for k in ("problem", "integrator", "step_s", "rtol")): row for row in _benchmark("precision")}
    for name, key in PRECISION.items():
        row = timed[key]
        meters = f", {1e3 * float(row['error_m']):.1g} mm" if float(row["error_m"] or 0.0) > 1e-5 else ""
        error = _short(float(row["error_rad"]))
        yield Cells("docs/accuracy.md", name, (f"{_two(float(row['run_ms_per_s']))} ms", f"{error} rad{meters}"))
    yield from _beside_peers()
    measured = {row["what"]: row for row in _benchmark("session")}
    for name, key in SESSION.items():
        middle, low, high = (f"{float(measured[key][k]):.3g}" for k in ("value", "low", "high"))
        unit = " µs" * (measured[key]["unit"] == "us")
        yield Cells("docs/session.md", name, (f"{middle}{unit}", f"{low} to {high}{unit}"))
    columns = {(row["scene"], row["method"]): row for row in _benchmark("linearize")}
    for name, (scene, method) in LINEARISED.items():
        ours, theirs = columns[scene, method], columns[scene, "mjd_transitionFD, centered"]
        errors = (f"{float(row['error']):.1e}".replace("e-0", "e-") for row in (ours, theirs))
        yield Cells("docs/control.md", name, (f"{float(ours['ratio']):.2g}", *errors))
    firsts = {row["kind"]: row for row in _benchmark("first")}
    kinds = "free arm", "arm with rotors", "humanoid on the ground", "the same in lanes", "the same, rtol 1e-9"
    free, rotors, humanoid, lanes, strict = (f"{float(firsts[kind]['cold']):.1f}" for kind in kinds)
    page = "docs/architecture.md"
    yield Words(page, "it is ", free, " CPU seconds for the free arm")
    yield Words(page, "import included, ", rotors, " with rotors")
    yield Words(page, "with rotors, ", humanoid, " for the humanoid on the ground")
    yield Words(page, "the humanoid on the ground, ", lanes, " for it in lanes")
    yield Words(page, "the strictest error control takes ", strict, ",")


def _speeds() -> Iterable[Cells]:
    """Forward dynamics of the complete humanoid."""
    rows = {(r["algorithm"], r["width"]): r for r in _benchmark("speed") if r["robot"] == "humanoid"}
    one, eight, theirs = (rows[key] for key in (("ABA", "float64"), ("ABA", "8 lanes"), ("mj_forward", "float64")))
    time = {id(row): f"{float(row['time_us']):.2f} µs" for row in (one, eight, theirs)}
    for name, row in (("ABA, one robot", one), ("ABA, eight robots at once, per robot", eight)):
        yield Cells("docs/accuracy.md", name, (time[id(row)], _short(float(row["error"]))))
    name = "MuJoCo's `mj_forward`, no contact, limits or friction, its clock switched off"
    yield Cells("docs/accuracy.md", name, (time[id(theirs)], None))
    here = f"{time[id(one)]}; of eight at once {time[id(eight)]} each"
    yield Cells("README.md", "forward dynamics of a humanoid", (here, time[id(theirs)], None))


def _beside_peers() -> Iterable[Cells | Words]:
    """How many times as long the best peer takes at equal error."""
    times = {row["line"]: row["measured"].removesuffix(" x") for row in _benchmark("peers_lines")}
    free, stiff = "arm, free: less CPU time at error", "arm, stiff servos: less CPU time at error"
    standing = "humanoid, standing: step {}, faster at no larger error"
    for before, line, after in (
        ("the free arm to 1e-6 takes 1/", f"{free} 1e-06", " and"),
        ("and to 1e-8 1/", f"{free} 1e-08", " of MuJoCo RK4's"),
        ("the stiff arm to 1e-6 1/", f"{stiff} 1e-06", " of the best peer's"),
        ("over Pinocchio), to 1e-4 1/", f"{stiff} 1e-04", " of MuJoCo's"),
        ("standing humanoid takes 1/", standing.format("float64"), " of MuJoCo's"),
        ("of its error, in lanes 1/", standing.format("lanes"), " of it"),
    ):
        yield Words("docs/accuracy.md", before, times[line], after)
    coarse, fine = times[f"{stiff} 1e-04"], times[f"{stiff} 1e-06"]
    best = f"{fine} to 1e-6 rad (with SciPy's LSODA, the best peer there)"
    yield Cells("README.md", "stiff servo arm, time at equal error", (None, f"{coarse} to 1e-4 rad", best))
    coarse, fine = times[f"{free} 1e-06"], times[f"{free} 1e-08"]
    theirs = f"{coarse} to 1e-6, {fine} to 1e-8 rad (RK4)"
    yield Cells("README.md", "free arm, time at equal error", (None, theirs, None))
    walks = [row for row in _benchmark("walk") if row["threads"] == "1"]
    rates = {(row["robot"], row["engine"].split()[0]): float(row["per_core"]) for row in walks}
    ten, nineteen = (rates[x, "featherstone_gait"] / rates[x, "mujoco"] for x in ("10 joints", "19 joints"))
    ours = f"{rates['10 joints', 'featherstone_gait']:.0f}"
    yield Words("docs/accuracy.md", "AVX-512): ", ours, " rollouts a second")
    yield Words("docs/accuracy.md", "on one core, ", f"{ten:.0f}", " times (nineteen joints: ")
    yield Words("docs/accuracy.md", " times (nineteen joints: ", f"{nineteen:.0f}", " times) what MuJoCo's")
    found = [row["verdict"] for row in _benchmark("stress")]
    counts = f"{len(found)} runs {found.count('held')} are right, {found.count('flagged')}"
    yield Words("docs/accuracy.md", "says so: of ", counts, " wrong, or not known to the end, and say so")
    if (found.count("alarm"), found.count("silent")) != (1, 2):
        raise ValueError("docs/accuracy.md says which runs are wrong and silent, or called wrong; correct that by hand")


def _benchmark(name: str) -> list[dict[str, str]]:
    return _records(BENCHMARKS / f"{name}.csv", TABLE)


def _short(x: float) -> str:
    """A digit and a power of ten."""
    return f"{x:.0e}".replace("e-0", "e-")


def _two(x: float) -> str:
    """Two digits that mean something."""
    return f"{x:.2g}"


def crosschecked() -> Iterable[Cells]:
    """The tables by floor of docs/crosscheck.md and docs/feedback.md."""
    tables = [floors(name) for name in ("planned_stride", "nominal")]
    for name, row in tables[0].items():
        sinks = f"{1e3 * float(row['sinking_m']):.3f}"
        cells = [_cost(table[name], side) for table in tables for side in ("mujoco", "own")]
        yield Cells("docs/crosscheck.md", f"`{name}`", (sinks, *cells), "The humanoid (`simplified`), J/m over 20")
    for name, row in floors("balanced").items():
        yield Cells("docs/feedback.md", f"`{name}`", (_cost(row, "mujoco"), _cost(row, "own")), "## In MuJoCo")


def _cost(row: dict[str, str], side: str) -> str:
    if row[f"{side}_walks"] == "True":
        return f"{float(row[f'{side}_cost_J_per_m']):.1f}"
    return f"falls, {float(row[f'{side}_end_s']):.1f} s"


def _limit(told: dict[str, Any], name: str) -> float:
    """What the gait that is found makes of a limit."""
    return next(limit["value"] for limit in told["plausible"]["after"]["limits"] if limit["name"] == name)


def _share(share: float) -> str:
    return f"{100.0 * share:.1f} %" if share else "none"


# ---------------------------------------------------------------------------------------------- worked out here


def walked_gait() -> Iterable[Cells]:
    """The stored gait, walked again."""
    import numpy as np

    from featherstone_gait import load_robot
    from featherstone_gait.optimize import walking_cost

    cost = walking_cost(load_robot("humanoid", locked="simplified"), states="step")
    with np.load(GAIT.with_suffix(".npz")) as data:
        measures = cost.measure([data["first"], data["x"]])
    energy = [walks(m.as_dict()) for m in measures]
    yield Cells("README.md", f"{WALKS} on its own floor", (*energy, None, None))


@functools.cache
def _planned(states: States, plan: str) -> WalkingCost:
    """What the gait of a plan costs."""
    from featherstone_gait import load_robot
    from featherstone_gait.optimize import walking_cost

    if plan == "cheapest":
        return _cheapest(states).cost
    return walking_cost(load_robot("humanoid", locked="simplified"), states=states)


@functools.cache
def _cheapest(states: States) -> CheapestPlan:
    from featherstone_gait.walking import cheapest_plan

    return cheapest_plan(_planned(states, "plain").scene, states)


def first_gaits() -> Iterable[Cells | Words]:
    """The table of plans in docs/walking.md, without its 200 worlds."""
    from featherstone_gait.walking.cost_in_worlds import in_worlds

    for states in ("step", "stride"):
        for plan in ("plain", "cheapest"):
            cost = _planned(states, plan)
            x = cost.gait.to_vector()
            own, (eight, _) = cost.measure([x])[0], in_worlds(cost, 8)(x)
            cells = f"{eight:.1f} J/m", walks(own.as_dict()), None, None
            yield Cells("docs/walking.md", f"{plan} plan, poses of a {states}", cells)
            if (plan, states) == ("cheapest", "step"):
                saved = f"{100.0 * (1.0 - kept(GAIT)['after']['cost'] / own.cost):.0f} %"
                takes = walks(own.as_dict()).replace(", ", " at ")
                yield Words("README.md", "plans takes ", takes, ", and walks in all")
                yield Words("README.md", "what is found saves ", saved, ".")


def previews() -> Iterable[Cells]:
    """The table of preview controllers in docs/walking.md: two plans, each with either form."""
    from dataclasses import asdict, replace

    import numpy as np

    from featherstone_gait.walking import BIOLOID_WALK, Walk, WalkingCost, walking_plan
    from featherstone_gait.walking.cheapest_plan import fit_states
    from featherstone_gait.walking.cost_in_worlds import in_worlds

    scene = _planned("step", "plain").scene
    cheapest = _cheapest("step").plan.walk
    plans = ("plain", Walk(**BIOLOID_WALK), (1e-7, 1e-5, 1e-4)), ("cheapest", cheapest, (1e-7, 1e-5))
    for name, walk, weights in plans:
        previewed = {f"{name}, 2003": replace(walk, preview="cart_table")}
        previewed |= {
            f"{name}, 2006, R = 1e{round(math.log10(R))}": replace(walk, preview="auxiliary_zmp", R=R) for R in weights
        }
        for row, one in previewed.items():
            plan = walking_plan(scene.model, **asdict(one))
            ahead, sideways = 1e3 * np.sqrt(np.mean((plan.zmp - plan.zmp_reference) ** 2, axis=0))
            cost = WalkingCost(scene, fit_states(scene.model, plan, "step").gait, plan.start_up(1))
            x = cost.gait.to_vector()
            own, (eight, _) = cost.measure([x])[0], in_worlds(cost, 8)(x)
            error, margin = f"{ahead:.1f}, {sideways:.1f} mm", f"{1e3 * plan.margin().min():.1f} mm"
            yield Cells("docs/walking.md", row, (error, margin, f"{own.cost:.1f} J/m", f"{eight:.1f} J/m"))


def first_gaits_elsewhere() -> Iterable[Cells]:
    """The 200 worlds of that table."""
    from featherstone_gait.walking.worth import UNSEEN, worth_elsewhere

    for states in ("step", "stride"):
        for plan in ("plain", "cheapest"):
            cost = _planned(states, plan)
            (found,) = worth_elsewhere(cost, [cost.gait.to_vector()], UNSEEN, False)
            low, median, high = found["cost"]
            cells = None, None, f"{100 * found['walks']:.3g} %", f"{median:.1f}, {low:.1f} to {high:.1f} J/m"
            yield Cells("docs/walking.md", f"{plan} plan, poses of a {states}", cells)


def caption() -> Iterable[Words]:
    """What stands under the picture of the README, which is that of the site too."""
    sys.path.insert(0, str(ROOT / "docs" / "images"))
    import walk

    (far, spent), (far_found, spent_found) = (
        (1e2 * (q[-1, 0] - q[0, 0]), energy[-1]) for _, q, energy in walk.walked(GAIT.with_suffix(".npz"))
    )
    said = f"{walk.DURATION:g} s: {far:.0f} and {far_found:.0f} cm for {spent:.0f} and {spent_found:.0f} J"
    for page in ("README.md", "docs/index.md"):
        yield Words(page, "The planned gait and the optimized one over ", said, "](")


def feedback_far() -> Iterable[Cells]:
    """The first table of docs/feedback.md: a hundred strides on slopes and rough ground."""
    from featherstone_gait.model import Ground
    from featherstone_gait.walking.disturbed import rough_field, walk_far

    scene, walk = _balanced()
    slope, right = math.radians(3.0), -0.5 * math.pi
    grounds = {
        "level": None, "down 3°": Ground(slope=-slope), "up 3°": Ground(slope=slope),
        "3° down to the left": Ground(slope=slope, heading=right),
        "3° down to the right": Ground(slope=-slope, heading=right),
        "3 mm rough": Ground(field=rough_field(3e-3)), "3 mm rough, seed 1": Ground(field=rough_field(3e-3, 1)),
        "6 mm rough": Ground(field=rough_field(6e-3)),
    }  # fmt: skip
    for name, ground in grounds.items():
        alone = [walk_far(scene, walk, ground, feedback=False)]
        cells = (*_far(alone), *_far([walk_far(scene, walk, ground, seed=seed) for seed in range(4)]))
        yield Cells("docs/feedback.md", name, cells)


def _far(walks: Sequence[Any]) -> tuple[str, str]:
    """Strides and J/m, and how far off the heading was, of walks that differ in the seed of the sensors."""
    fell = [far for far in walks if not far.walked]
    if fell:
        strides = f"falls at {_range([far.strides for far in fell], 0)}"
        seeds = f", {len(fell)} of {len(walks)}" if len(fell) < len(walks) else ""
    else:
        strides, seeds = f"{walks[0].strides:.0f}, {_range([far.energy for far in walks], 1)}", ""
    off = [math.degrees(far.heading) for far in walks if far.strides > 10.0]
    return strides + seeds, f"{_range(off, 1 if max(off) < 10.0 else 0)}°" if off else ""


def _range(values: Sequence[float], digits: int) -> str:
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return low if low == high else f"{low} to {high}"


def feedback_pushes() -> Iterable[Cells | Words]:
    """The pushes of docs/feedback.md."""
    from featherstone_gait.walking.disturbed import pushes_survived

    scene, walk = _balanced()
    found = [pushes_survived(scene, walk, 16, feedback=feedback) for feedback in (False, True)]
    for name, each in zip(("without", "with feedback"), found):
        yield Cells("docs/feedback.md", name, tuple(f"{x:.2f}" for x in (*each, each.mean())))
    ratio = f"{found[1].mean() / found[0].mean():.2f}"
    yield Words("docs/feedback.md", "So feedback is worth ", ratio, " times the impulse on average")


def _balanced() -> tuple[Any, Any]:
    """The scene and the walk with feedback of docs/feedback.md."""
    from featherstone_gait import Ground, compile_scene, load_robot
    from featherstone_gait.walking import read_walk

    scene = compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)
    return scene, read_walk(GAIT.with_name("balanced_gait.npz"), scene.model.joint_names)


def scatter() -> Iterable[Cells]:
    """The walks of docs/maximal.md in the paper's kind of program."""
    from featherstone_gait import load_robot
    from featherstone_gait.optimize import walking_cost
    from featherstone_gait.reproduction.solver_scatter import FULL, SERVOS, Setting, nudge, walk

    planned = walking_cost(load_robot("humanoid", locked="simplified"))
    found = {h: [walk(FULL, planned, Setting(s, h), FULL.runs)[1] for s in SERVOS] for h in (1e-3, 2e-3)}
    fell = " and ".join(str(row.fell) for row in found[2e-3])
    names = "1 ms, 10 sweeps, the documented setting, 200 runs", f"2 ms, 10 sweeps, 200 runs, of which {fell} fall"
    for name, rows in zip(names, found.values()):
        cells = tuple(f"{1e2 * r.cycle:.1f} % ({1e2 * r.repeat:.1f}, {1e2 * r.run:.1f})" for r in rows)
        yield Cells("docs/maximal.md", name, cells)
    solved = [walk(FULL, planned, Setting(s, iterations=0), 2)[1].repeat for s in SERVOS]
    yield Cells("docs/maximal.md", "1 ms, solved: from run to run", tuple(f"{x:.2g}" for x in solved))
    standard, mipsd = (nudge(FULL, planned, s) for s in SERVOS)
    row = "1 ms, solved, double precision, starts off by 1e-9 rad: the same cycle"
    yield Cells("docs/maximal.md", row, (f"{1e2 * standard:.1f} %", f"{mipsd:.1e}".replace("e-0", "e-")))


def held() -> Iterable[Cells]:
    """The arm and the standing humanoid of docs/maximal.md."""
    from featherstone_gait.reproduction.solver_scatter import FULL, hold_arm, hold_posture

    def arm(servos: str, sweeps: int, link: tuple[float, float]) -> float:
        return float(hold_arm(FULL, servos, sweeps, link, 0).typical)

    for link in FULL.links:
        standard = ", ".join(f"{arm('standard', n, link):.2g}" for n in (10, 20, 0))
        yield Cells("docs/maximal.md", f"{link[0]:g} kg, {link[1]:g} m", (standard, None))
    rows = {f"{n} sweeps": (n, 1.0) for n in (10, 20, 50)} | {"10 sweeps, 0.8 of the masses": (10, 0.8)}
    for name, (n, mass) in rows.items():
        both = [hold_posture(FULL, servos, n, mass, 0).typical for servos in ("standard", "mipsd")]
        cells = tuple(", ".join(f"{x:.{d}f}" for x in each) for each, d in zip(both, (2, 3)))
        yield Cells("docs/maximal.md", name, cells)
