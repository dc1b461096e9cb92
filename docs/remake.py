"""Makes the numbers and pictures of README, docs and notebooks anew.

    python docs/remake.py --list            what there is: command, files, minutes
    python docs/remake.py --quick           what takes minutes; cells of tables are written where they stand
    python docs/remake.py --quick --check   writes nothing; fails where a number that is stored is another one
    python docs/remake.py gait notebooks    parts by name; without names all, in some four hours

A part either works its numbers out here, in the digits in which pages quote them, or runs a command and puts its
files in their places.  The former are the same on every machine.  `docs/reproduction/remade.json` says of which sources
each is.  Times and ratios of times are the machine's, and the commands that stand beside them, benchmarks or
`docs/timings.py`, print them for whoever writes the page.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parent))

import cells as pages
import numpy as np
from cells import Cells, Words

from featherstone_gait import __version__
from featherstone_gait.base.files import Format, complete, parse_json
from featherstone_gait.reproduction import EXPERIMENTS
from featherstone_gait.reproduction.sources import PACKAGE, digest

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "docs" / "reproduction" / "remade.json"
FORMAT = Format("remade parts")
KEPT_IN = "docs/reproduction"
QUICK = 5.0  # minutes of two cores, compiled before
NOTEBOOKS = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "notebooks").glob("*.ipynb"))
REPORT = tuple(f"reproduction/{name}.py" for name in ("report", *EXPERIMENTS))
COMMANDS = ("optimize", "crosscheck", "reproduce", "benchmark", "study")  # of the package; others are Python's
TOLD = ("settings", "search", "before", "after", "elsewhere", "crosscheck", "plausible")  # of a gait's report


class Part(NamedTuple):
    """What is made anew in one go."""

    what: str
    minutes: float
    command: tuple[str, ...] = ()  # of the package, with "{out}" for a folder of its own
    files: tuple[tuple[str, str], ...] = ()  # of these there: name, and where it goes; "" for the whole folder
    cells: Callable[[], Iterable[Cells | Words]] | None = None  # what is worked out here
    modules: tuple[str, ...] = ("optimize/job.py",)  # of the package, on which it depends


PARTS: dict[str, Part] = {
    "stored-gait": Part("tables of README and docs/optimize.md, from the gaits' files", 0.0, cells=pages.stored_gait),
    "seeds": Part("tables of seeds in docs/optimize.md, crosscheck.md, walking.md, from files", 0.0, cells=pages.seeds),
    "floors": Part("tables by floor of docs/crosscheck.md and feedback.md, from files", 0.0, cells=pages.crosschecked),
    "worlds-cost-table": Part(
        "the table of worlds in docs/optimize.md from its file", 0.0, cells=pages.worlds_cost,
        modules=("reproduction/what_worlds_cost.py",),
    ),
    "searches-table": Part(
        "the table of docs/paper.md from its file", 0.0, cells=pages.searches, modules=("reproduction/what_stops.py",),
    ),
    "other-robots-table": Part(
        "the tables of other robots in docs/crosscheck.md and walking.md from their files", 0.0,
        cells=pages.other_robots, modules=("reproduction/other_robots.py",),
    ),
    "in-bullet-table": Part(
        "the table of Bullet in docs/crosscheck.md from its file", 0.0, cells=pages.in_bullet,
        modules=("reproduction/in_bullet.py",),
    ),
    "units-table": Part(
        "the table of units in docs/tutorials/study.md from its file", 0.0, cells=pages.units,
        modules=("study/sensitivity.py",),
    ),
    "benchmark-pages": Part(
        "what benchmarks took, in README, docs/accuracy.md, architecture.md, control.md, session.md, from files", 0.0,
        cells=pages.benchmarked, modules=("benchmark/table.py",),
    ),
    "walked-gait": Part("the energy and speed of that gait, walked again", 0.1, cells=pages.walked_gait),
    "caption": Part("what stands under the picture of README and site", 0.1, cells=pages.caption),
    "first-gaits": Part("the table of plans in docs/walking.md, without its 200 worlds", 1.0, cells=pages.first_gaits),
    "first-gaits-elsewhere": Part("its 200 worlds", 2.0, cells=pages.first_gaits_elsewhere),
    "previews": Part(
        "the table of preview controllers in docs/walking.md", 1.0, cells=pages.previews,
        modules=("walking/plan.py", "walking/preview_control.py", "walking/auxiliary_zmp.py"),
    ),
    "feedback-far": Part(
        "slopes and rough ground of docs/feedback.md", 0.2, cells=pages.feedback_far,
        modules=("walking/disturbed.py", "walking/feedback.py"),
    ),
    "feedback-pushes": Part(
        "pushes of docs/feedback.md", 2.0, cells=pages.feedback_pushes,
        modules=("walking/disturbed.py", "walking/feedback.py"),
    ),
    "scatter": Part("walks of docs/maximal.md", 1.0, cells=pages.scatter, modules=("reproduction/solver_scatter.py",)),
    "held": Part("arm, posture of docs/maximal.md", 3.0, cells=pages.held, modules=("reproduction/solver_scatter.py",)),
    "gait": Part(
        "the gait of the README", 6, ("optimize", "--crosscheck", "--out", "{out}"),
        (("humanoid_gait.npz", "robots/humanoid/optimized_gait.npz"),
         ("humanoid_gait.json", "robots/humanoid/optimized_gait.json")),
    ),
    **{
        f"seed-{k}": Part(
            f"the gait of seed {k} in docs/optimize.md", 5,
            ("optimize", "--seed", f"{k}", "--crosscheck", "--no-fair", "--out", "{out}"),
            (("humanoid_gait.json", f"{KEPT_IN}/gait_seed_{k}.json"),
             ("humanoid_gait.npz", f"{KEPT_IN}/gait_seed_{k}.npz")),
        )
        for k in (1, 2)
    },
    **{
        f"energy-only-{k}": Part(
            f"the gait of seed {k} for energy alone, in README, docs/optimize.md, crosscheck.md and walking.md", 4,
            ("optimize", "--energy-only", "--seed", f"{k}", "--crosscheck", "--no-fair", "--out", "{out}"),
            (("humanoid_gait.json", f"{KEPT_IN}/gait_energy_only_{k}.json"),),
        )
        for k in (0, 1, 2)
    },
    **{
        f"from-cheapest-{k}": Part(
            f"seed {k} from the cheapest plan in docs/walking.md", 4,
            ("optimize", "--energy-only", "--plan", "cheapest", "--seed", f"{k}", "--crosscheck", "--out", "{out}"),
            (("humanoid_gait.json", f"{KEPT_IN}/gait_from_cheapest_{k}.json"),),
        )
        for k in (0, 1)
    },
    **{
        f"ax12a-{k}": Part(
            f"the gait of seed {k} with the corrected AX-12 in docs/servos.md", 5,
            ("optimize", "--servo", "ax12a", "--seed", f"{k}", "--no-fair", "--out", "{out}"),
            (("humanoid_gait.json", f"{KEPT_IN}/gait_ax12a_{k}.json"),),
        )
        for k in (0, 1, 2)
    },
    "nominal": Part(
        "the column `--nominal` of README, and its floors in docs/crosscheck.md", 2,
        ("optimize", "--nominal", "--crosscheck", "--no-fair", "--out", "{out}"),
        (("humanoid_gait.json", "docs/reproduction/gait_nominal.json"),
         ("humanoid_gait.npz", "docs/reproduction/gait_nominal.npz"),
         ("humanoid_gait_crosscheck.csv", "docs/reproduction/floors_nominal.csv")),
    ),
    **{
        f"floors-{name}": Part(
            what, 1, ("crosscheck", gait, *first, "--soles", "spheres", "--out", "{out}"),
            ((f"{Path(gait).stem}{'_first' * len(first)}_crosscheck.csv", f"{KEPT_IN}/floors_{name}.csv"),),
            modules=("crosscheck/run.py",),
        )
        for name, what, gait, *first in (
            ("planned", "README's first gait on the floors", "robots/humanoid/optimized_gait.npz", "--first"),
            ("planned_stride", "that of `--nominal`, in docs/crosscheck.md", f"{KEPT_IN}/gait_nominal.npz", "--first"),
            ("balanced", "the gait with feedback there, in docs/feedback.md", "robots/humanoid/balanced_gait.npz"),
        )
    },
    "walk.gif": Part(
        "the picture of the README", 1, ("docs/images/walk.py", "robots/humanoid/optimized_gait.npz", "{out}/walk.gif"),
        (("walk.gif", "docs/images/walk.gif"),),
    ),
    "solver-map": Part(
        "the map of docs/maximal.md", 5,
        ("-m", "featherstone_gait.reproduction.solver_scatter", "{out}/solver_map.csv"),
        (("solver_map.csv", "docs/reproduction/solver_map.csv"),), modules=("reproduction/solver_scatter.py",),
    ),
    "searches": Part(
        "where searches stop, for docs/paper.md", 60,
        ("-m", "featherstone_gait.reproduction.what_stops", "{out}/searches.csv", "--searches", "2"),
        (("searches.csv", "docs/reproduction/searches.csv"),), modules=("reproduction/what_stops.py",),
    ),
    "worlds-cost": Part(
        "what it costs to walk in other worlds, for docs/optimize.md", 15,
        ("-m", "featherstone_gait.reproduction.what_worlds_cost", "{out}/worlds_cost.csv", "{out}/worlds_cost.png"),
        (("worlds_cost.csv", "docs/reproduction/worlds_cost.csv"), ("worlds_cost.png", "docs/images/worlds_cost.png")),
        modules=("reproduction/what_worlds_cost.py",),
    ),
    "units": Part(
        "98 304 walks of units that differ, for docs/tutorials/study.md", 8,
        ("study", "notebooks/unit_study.toml", "--out", "{out}"),
        (("unit_study_sensitivity.csv", "docs/reproduction/unit_study_sensitivity.csv"),
         ("unit_study_sensitivity.png", "docs/images/unit_study.png")),
        modules=("study/sensitivity.py", "study/draws.py", "study/measures.py"),
    ),
    "other-robots": Part(
        "other robots in MuJoCo and in unseen worlds, for docs/crosscheck.md, walking.md and feedback.md", 30,
        ("-m", "featherstone_gait.reproduction.other_robots", "{out}/other_robots.csv"),
        (("other_robots.csv", "docs/reproduction/other_robots.csv"),
         ("other_robots_worlds.csv", "docs/reproduction/other_robots_worlds.csv")),
        modules=("reproduction/other_robots.py",),
    ),
    "in-bullet": Part(
        "gaits in Bullet, for docs/crosscheck.md", 10,
        ("-m", "featherstone_gait.reproduction.in_bullet", "{out}/in_bullet.csv"),
        (("in_bullet.csv", "docs/reproduction/in_bullet.csv"),), modules=("reproduction/in_bullet.py",),
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
        f"benchmark-{name}": Part(
            f"numbers of {page}", minutes, ("benchmark", name, "--out", "{out}"),
            tuple((f"{table}.csv", f"{KEPT_IN}/benchmarks/{table}.csv") for table in tables),
            modules=(f"benchmark/{name}.py",),
        )
        for name, page, minutes, *tables in (
            ("speed", "docs/accuracy.md", 3, "speed"), ("precision", "docs/accuracy.md", 8, "precision"),
            ("peers", "docs/accuracy.md", 8, "peers_lines"), ("stress", "docs/accuracy.md", 5, "stress"),
            ("walk", "docs/accuracy.md", 3, "walk"), ("linearize", "docs/control.md", 2, "linearize"),
            ("session", "docs/session.md", 2, "session"), ("skip", "docs/servos.md and docs/worlds.md", 5, "skip"),
            ("first", "docs/architecture.md", 5, "first"),
        )
    },
}  # fmt: skip


# ---------------------------------------------------------------------------------------------- cells and commands


def worked_out(part: Part, check: bool) -> list[str]:
    """Work out the numbers of a part; write them into their pages, or only say where a page has others."""
    assert part.cells is not None
    differing = []
    for cells in part.cells():
        path = ROOT / cells.page
        old = path.read_text("utf-8")
        new = cells.put(old)
        if new != old:
            differing.append(str(cells))
            if not check:
                with complete(path) as temporary:
                    temporary.write_text(new, "utf-8")
    return differing


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
    done = subprocess.run([sys.executable, *package, *words], cwd=ROOT, check=False)
    if done.returncode and (words[0], done.returncode) != ("study", 1):  # in which some robots fall
        done.check_returncode()
    for name, place in part.files:
        if name == "humanoid_gait.json":
            put_gait(out / name, ROOT / place, shown(part))
        elif name == "humanoid_gait.npz":
            put_arrays(out / name, ROOT / place)
        else:
            shutil.copyfile(out / name, ROOT / place)


def put_gait(report: Path, place: Path, command: str) -> None:
    """Keep of a gait's report what is of no machine, and what made it."""
    told = json.loads(report.read_text("utf-8"))
    kept = {"format": told["format"], "command": command, "version": told["version"]}
    text = json.dumps(kept | {key: told[key] for key in TOLD})
    with complete(place) as temporary:
        temporary.write_text(text + "\n", "utf-8")


def put_arrays(arrays: Path, place: Path) -> None:
    """Keep a gait without the candidates on the way to it."""
    with np.load(arrays) as found:
        gait = {key: found[key] for key in found.files if key not in ("costs", "visited")}
    with complete(place) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **gait)


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
        elif not all((ROOT / place).exists() for _, place in part.files):
            state = ", not kept yet"
        lines += [f"{name:20} {took:>7}  {part.what}{state}", f"{'':29} {shown(part)}"]
        lines += [f"{'':29} -> {place}" for _, place in part.files]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="make the numbers and pictures of the pages anew")
    parser.add_argument("names", metavar="NAME", nargs="*", help="parts (default: all)")
    parser.add_argument("--list", action="store_true", help="say what there is")
    parser.add_argument("--quick", action="store_true", help="numbers that are worked out here, in some ten minutes")
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
