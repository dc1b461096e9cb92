"""Makes the numbers and pictures of README, docs and notebooks anew.

    python docs/remake.py --list            what there is: command, files, minutes
    python docs/remake.py --quick           what takes minutes; cells of tables are written where they stand
    python docs/remake.py --quick --check   writes nothing; fails where a number that is stored is another one
    python docs/remake.py gait notebooks    parts by name; without names all, in some four hours

A part either works its numbers out here, in the digits in which pages quote them, or runs a command and puts its
files in their places.  The former are the same on every machine.  `docs/reproduction/remade.json` says of which sources
each is.  Times and ratios of times, in `docs/accuracy.md`, `control.md` and `session.md`, are the machine's, and their
commands print them for whoever writes the page.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from featherstone_gait import __version__
from featherstone_gait.experiments import EXPERIMENTS
from featherstone_gait.experiments.sources import PACKAGE, digest
from featherstone_gait.files import Format, complete, parse_json

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "docs" / "reproduction" / "remade.json"
FORMAT = Format("remade parts")
QUICK = 5.0  # minutes of two cores, compiled before
NOTEBOOKS = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "notebooks").glob("*.ipynb"))
REPORT = tuple(f"experiments/{name}.py" for name in ("report", *EXPERIMENTS))
COMMANDS = ("optimize", "reproduce", "benchmark")  # of `featherstone-gait`; what begins otherwise is Python's
GAIT = ROOT / "robots" / "humanoid" / "optimized_gait.json"
SEEDS = {0: GAIT} | {k: ROOT / "docs" / "reproduction" / f"gait_seed_{k}.json" for k in (1, 2)}
TOLD = ("settings", "search", "before", "after", "elsewhere", "crosscheck", "plausible")  # of a gait's report


class Cells(NamedTuple):
    """Cells of a row of a page's table, None where they are not of this part."""

    page: str
    row: str  # its first cell
    cells: tuple[str | None, ...]  # after that


class Part(NamedTuple):
    """What is made anew in one go."""

    what: str
    minutes: float
    command: tuple[str, ...] = ()  # of the package, with "{out}" for a folder of its own
    files: tuple[tuple[str, str], ...] = ()  # of these there: name, and where it goes; "" for the whole folder
    cells: Callable[[], Iterable[Cells]] | None = None  # what is worked out here
    modules: tuple[str, ...] = ("optimize.py",)  # of the package, on which it depends


# ---------------------------------------------------------------------------------------------- worked out here


def stored_gait() -> Iterable[Cells]:
    """README and docs/optimize.md quote what stands beside the stored gait."""
    told = json.loads(GAIT.read_text("utf-8"))
    gaits = [(told[key], told["elsewhere"][key], told["plausible"][key]["limits"]) for key in ("before", "after")]
    limits = [{limit["name"]: limit for limit in each} for _, _, each in gaits]
    energy = [f"{m['cost']:.1f} J/m, {1e3 * m['speed']:.0f} mm/s" for m, _, _ in gaits]
    forms = (".0f", ".1f")
    worlds = [
        f"{100 * e['walks']:.3g} %, {e['cost'][0]:{form}} to {e['cost'][2]:{form}} J/m"
        for (_, e, _), form in zip(gaits, forms)
    ]
    kept = [f"{sum(limit['kept'] for limit in each.values())} of {len(each)} limits" for each in limits]
    worst = [f"{1e3 * x['swing']['value']:.1f} mm, {math.degrees(x['tilt']['value']):.1f}°" for x in limits]
    yield Cells("README.md", "energy per distance, speed on its own floor", (*energy, None, None))
    yield Cells("README.md", "walks 20 strides in 200 other worlds", (*worlds, None, None))
    yield Cells("README.md", "keeps to what a real robot asks for, on its own floor", (*kept, None, None))
    yield Cells("README.md", "least clearance of a fast foot, largest tilt of a loaded sole", (*worst, None, None))
    page = "docs/optimize.md"
    yield Cells(page, "energy per distance, speed", (*energy, None))
    rows = {
        "clearance of a fast foot: worst, samples below 5 mm": ("swing", "{0:.1f} mm", 1e3),
        "tilt of a loaded sole: worst, samples above 5°": ("tilt", "{0:.1f}°", math.degrees(1.0)),
        "voltage taken: worst, samples above 80 %": ("line", "{0:.0f} %", 1e2),
    }
    for row, (name, form, scale) in rows.items():
        each = [x[name] for x in limits]
        yield Cells(page, row, (*(f"{form.format(scale * x['value'])}, {_share(x['share'])}" for x in each), None))
    yield Cells(page, "limbs apart", (*(f"{1e3 * x['apart']['value']:.1f} mm" for x in limits), None))
    yield Cells(page, "torque over stall torque", (*(f"{1e2 * x['torque']['value']:.0f} %" for x in limits), None))


def seeds() -> Iterable[Cells]:
    """docs/optimize.md tells what other seeds come to."""
    for seed, path in SEEDS.items():
        told = json.loads(path.read_text("utf-8"))
        found, worlds, limits = told["after"], told["elsewhere"]["after"], told["plausible"]["after"]["limits"]
        floors = re.search(r"on (\d+ of \d+) floors, ([0-9.]+ to [0-9.]+) J/m", told["crosscheck"])
        assert floors, told["crosscheck"]
        yield Cells(
            "docs/optimize.md", f"seed {seed}",
            (f"{found['cost']:.1f} J/m, {1e3 * found['speed']:.0f} mm/s",
             f"{sum(limit['kept'] for limit in limits)} of {len(limits)}",
             f"{100 * worlds['walks']:.3g} %, {worlds['cost'][0]:.1f} to {worlds['cost'][2]:.1f} J/m",
             f"{floors[1]}, {floors[2]} J/m"),
        )  # fmt: skip


def _share(share: float) -> str:
    return f"{100.0 * share:.1f} %" if share else "none"


def walked_gait() -> Iterable[Cells]:
    """The stored gait, walked again."""
    import numpy as np

    from featherstone_gait import load_robot
    from featherstone_gait.optimize import walking_cost

    cost = walking_cost(load_robot("humanoid", locked="simplified"), states="step")
    with np.load(GAIT.with_suffix(".npz")) as data:
        measures = cost.measure([data["first"], data["x"]])
    energy = [f"{m.cost:.1f} J/m, {1e3 * m.speed:.0f} mm/s" for m in measures]
    yield Cells("README.md", "energy per distance, speed on its own floor", (*energy, None, None))


def first_gaits() -> Iterable[Cells]:
    """The table of plans in docs/walking.md, without its 200 worlds."""
    from featherstone_gait import load_robot
    from featherstone_gait.optimize import walking_cost
    from featherstone_gait.walking.cost_in_worlds import in_worlds

    robot = load_robot("humanoid", locked="simplified")
    for states in ("step", "stride"):
        for plan in ("plain", "cheapest"):
            cost = walking_cost(robot, states=states, plan=plan)
            x = cost.gait.to_vector()
            own, (eight, _) = cost.measure([x])[0], in_worlds(cost, 8)(x)
            cells = f"{eight:.1f} J/m", f"{own.cost:.1f} J/m, {1e3 * own.speed:.0f} mm/s", None, None
            yield Cells("docs/walking.md", f"{plan} plan, poses of a {states}", cells)


def scatter() -> Iterable[Cells]:
    """The walks of docs/maximal.md in the paper's kind of program."""
    from featherstone_gait import load_robot
    from featherstone_gait.experiments.solver_scatter import FULL, SERVOS, Setting, nudge, walk
    from featherstone_gait.optimize import walking_cost

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
    from featherstone_gait.experiments.solver_scatter import FULL, hold_arm, hold_posture

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


PARTS: dict[str, Part] = {
    "stored-gait": Part("the tables of README and docs/optimize.md from the file of the gait", 0.0, cells=stored_gait),
    "seeds": Part("the table of seeds in docs/optimize.md from their files", 0.0, cells=seeds),
    "walked-gait": Part("the energy and speed of that gait, walked again", 0.1, cells=walked_gait),
    "first-gaits": Part("the table of plans in docs/walking.md, without its 200 worlds", 1.0, cells=first_gaits),
    "scatter": Part("the walks of docs/maximal.md", 1.0, cells=scatter, modules=("experiments/solver_scatter.py",)),
    "held": Part("arm and posture of docs/maximal.md", 3.0, cells=held, modules=("experiments/solver_scatter.py",)),
    "gait": Part(
        "the gait of the README", 6, ("optimize", "--crosscheck", "--out", "{out}"),
        (("humanoid_gait.npz", "robots/humanoid/optimized_gait.npz"),
         ("humanoid_gait.json", "robots/humanoid/optimized_gait.json")),
    ),
    **{
        f"seed-{k}": Part(
            f"the gait of seed {k} in docs/optimize.md", 5,
            ("optimize", "--seed", f"{k}", "--crosscheck", "--no-fair", "--out", "{out}"),
            (("humanoid_gait.json", f"docs/reproduction/gait_seed_{k}.json"),),
        )
        for k in (1, 2)
    },
    "energy-only": Part(
        "the column `--energy-only` of README and docs/optimize.md, printed", 6,
        ("optimize", "--energy-only", "--crosscheck", "--out", "{out}"),
    ),
    "nominal": Part(
        "the column `--nominal` of README, printed", 5, ("optimize", "--nominal", "--crosscheck", "--out", "{out}"),
    ),
    "walk.gif": Part(
        "the picture of the README", 1, ("docs/images/walk.py", "robots/humanoid/optimized_gait.npz", "{out}/walk.gif"),
        (("walk.gif", "docs/images/walk.gif"),),
    ),
    "solver-map": Part(
        "the map of docs/maximal.md", 5, ("-m", "featherstone_gait.experiments.solver_scatter", "{out}/solver_map.csv"),
        (("solver_map.csv", "docs/reproduction/solver_map.csv"),), modules=("experiments/solver_scatter.py",),
    ),
    "searches": Part(
        "where searches stop, for docs/paper.md", 100,
        ("-m", "featherstone_gait.experiments.what_stops", "{out}/searches.csv"),
        (("searches.csv", "docs/reproduction/searches.csv"),), modules=("experiments/what_stops.py",),
    ),
    "reproduction": Part(
        "the paper at full size, for docs/paper.md", 58, ("reproduce", "--full", "--out", "{out}"),
        (("reproduction.html", "docs/reproduction/reproduction.html"),
         ("reproduction.csv", "docs/reproduction/reproduction.csv")), modules=REPORT,
    ),
    "notebooks": Part(
        "what the notebooks print and draw", 25,
        ("-m", "jupyter", "nbconvert", "--to", "notebook", "--execute", "--inplace", *NOTEBOOKS),
    ),
    **{
        f"benchmark-{name}": Part(f"numbers of {page}, printed", minutes, ("benchmark", name, "--out", "{out}"))
        for name, page, minutes in (
            ("speed", "docs/accuracy.md", 3), ("precision", "docs/accuracy.md", 8), ("peers", "docs/accuracy.md", 8),
            ("stress", "docs/accuracy.md", 5), ("walk", "docs/accuracy.md", 3), ("linearise", "docs/control.md", 2),
            ("session", "docs/session.md", 2), ("skip", "docs/servos.md and docs/worlds.md", 5),
            ("first", "docs/architecture.md", 5),
        )
    },
}  # fmt: skip


# ---------------------------------------------------------------------------------------------- tables of pages


def put(cells: Cells, text: str) -> str:
    """The page with these cells in their row; raises ValueError unless there is one such row."""
    lines = text.split("\n")
    rows = [k for k, line in enumerate(lines) if line.startswith(f"| {cells.row} |")]
    if len(rows) != 1:
        raise ValueError(f"{cells.page} has {len(rows)} rows that begin with {cells.row!r}; there should be one")
    old = lines[rows[0]].split("|")  # nothing, the row's name, the cells, nothing
    if len(old) != 3 + len(cells.cells):
        raise ValueError(f"{cells.page}, row {cells.row!r}: {len(old) - 3} cells, not {len(cells.cells)}")
    for k, now in enumerate(cells.cells, start=2):
        if now is not None:
            old[k] = f" {_with_rest(old[k].strip(), now)} "
    lines[rows[0]] = "|".join(old)
    return "\n".join(lines)


def _with_rest(was: str, now: str) -> str:
    """The cell; what the page says after it, behind a comma or in brackets, stays."""
    return was if was == now or was.startswith((now + ",", now + " (", now + " each")) else now


def worked_out(part: Part, check: bool) -> list[str]:
    """Work out the numbers of a part; write them into their pages, or only say where a page has others."""
    assert part.cells is not None
    differing = []
    for cells in part.cells():
        path = ROOT / cells.page
        old = path.read_text("utf-8")
        new = put(cells, old)
        if new != old:
            differing.append(f"{cells.page}: {cells.row}: {' | '.join(x for x in cells.cells if x is not None)}")
            if not check:
                with complete(path) as temporary:
                    temporary.write_text(new, "utf-8")
    return differing


# ---------------------------------------------------------------------------------------------- commands


def shown(part: Part) -> str:
    """Its command as one would type it."""
    if not part.command:
        return "worked out here"
    words = " ".join(part.command).replace(" --out {out}", "").replace("{out}/", "")
    words = words.replace(" ".join(NOTEBOOKS), "notebooks/*.ipynb")
    return f"{'featherstone-gait' if part.command[0] in COMMANDS else 'python'} {words}"


def commanded(part: Part, out: Path) -> None:
    """Run a part's command, which writes into a folder or goes on there, and put its files in their places."""
    words = [word.format(out=out) for word in part.command]
    package = ["-m", "featherstone_gait"] if words[0] in COMMANDS else []
    subprocess.run([sys.executable, *package, *words], cwd=ROOT, check=True)
    for name, place in part.files:
        if name == "humanoid_gait.json":
            put_gait(out / name, ROOT / place, shown(part))
        else:
            shutil.copyfile(out / name, ROOT / place)


def put_gait(report: Path, place: Path, command: str) -> None:
    """Keep of a gait's report what is of no machine, and what made it."""
    told = json.loads(report.read_text("utf-8"))
    kept = {"format": told["format"], "command": command, "version": told["version"]}
    text = json.dumps(kept | {key: told[key] for key in TOLD})
    with complete(place) as temporary:
        temporary.write_text(text + "\n", "utf-8")


def sources(part: Part) -> str:
    """Digest of what a part is made with."""
    return digest(*(PACKAGE / file for file in part.modules))


def remade() -> dict[str, Any]:
    """By part: command, program and sources of what is stored."""
    if not KEPT.exists():
        return {}
    content = parse_json(KEPT.read_text("utf-8"), str(KEPT), "delete it")
    FORMAT.check(KEPT, content.pop("format", None))
    return content


def note(name: str, part: Part) -> None:
    """Note of which sources a part now is."""
    content = remade() | {name: {"command": shown(part), "version": __version__, "sources": sources(part)}}
    text = json.dumps({"format": str(FORMAT)} | dict(sorted(content.items())), indent=1)
    with complete(KEPT) as temporary:
        temporary.write_text(text + "\n", "utf-8")


def listing() -> str:
    """All parts as text."""
    known, lines = remade(), []
    for name, part in PARTS.items():
        took, state = f"{part.minutes:g} min", ""
        if name in known:
            state = ", of these sources" if known[name]["sources"] == sources(part) else ", of other sources"
        lines += [f"{name:20} {took:>7}  {part.what}{state}", f"{'':29} {shown(part)}"]
        lines += [f"{'':29} -> {place}" for _, place in part.files]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="make the numbers and pictures of the pages anew")
    parser.add_argument("names", metavar="NAME", nargs="*", help="parts (default: all)")
    parser.add_argument("--list", action="store_true", help="say what there is")
    parser.add_argument("--quick", action="store_true", help="numbers that are worked out here, in some five minutes")
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 where pages differ")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where commands write and go on (default: temporary)")
    args = parser.parse_args(arguments)
    if args.list:
        print(listing())
        return 0
    for name in args.names:
        if name not in PARTS:
            parser.error(f"there is no part {name!r}; parts: {', '.join(PARTS)}")
    chosen = {name: part for name, part in PARTS.items() if not args.names or name in args.names}
    if args.quick or args.check:
        chosen = {name: part for name, part in chosen.items() if part.cells and part.minutes <= QUICK}
    differing = []
    for name, part in chosen.items():
        print(f"{name}: {part.what} (some {part.minutes:g} min)", flush=True)
        if part.cells is None:
            with tempfile.TemporaryDirectory() as temporary:
                commanded(part, args.out.resolve() if args.out else Path(temporary))
        else:
            found = worked_out(part, args.check)
            print("".join(f"  {'other' if args.check else 'new'}: {line}\n" for line in found), end="", flush=True)
            differing += found
        if not args.check:
            note(name, part)
    print(f"{len(differing)} rows {'differ' if args.check else 'are new'}, of {len(chosen)} parts")
    return 1 if args.check and differing else 0


if __name__ == "__main__":
    raise SystemExit(main())
