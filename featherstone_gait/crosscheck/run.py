"""A motion on many floors, in several processes; finished floors are kept in a file, so that a run can be continued."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, wait
from pathlib import Path
from typing import Any

from .. import __version__
from ..base.arguments import instance, one_of, real, texts, whole
from ..base.brief import in_full
from ..base.files import FilePath, Format, complete, read_json, write_csv
from ..base.processes import process_pool
from ..base.progress import progress_bar
from ..model import Ground, Model
from ..scene.actuator import servo_gearbox
from ..scene.compile import CompiledScene, GearboxKind, compile_scene
from ..walking.feedback import BalancedWalk
from ..walking.gait import MOST_STRIDES
from ..walking.motion import Motion
from ..walking.walker import driven, load_walker
from .floors import FLOORS, STRIDES, WARM_UP, walk_on
from .in_mujoco import SOLES, TIMESTEP, Floor, Soles, mujoco_version, soles_of

REPORT, TABLE = Format("crosscheck", 1), Format("crosscheck table", 1)
MEASURES = {"walks": "walks", "end": "end_s", "cost": "cost_J_per_m", "speed": "speed_m_per_s",
            "sideways": "sideways_m", "status": "status"}  # fmt: skip


def crosscheck(
    motion: Motion | BalancedWalk,
    robot: FilePath | Model = "humanoid",
    *,
    gearbox: GearboxKind | None = None,
    servo: FilePath | None = None,
    floors: Iterable[str] | None = None,
    soles: Iterable[str] | None = None,
    strides: int = STRIDES,
    timestep: float = TIMESTEP,
    out: FilePath | None = None,
    processes: int = 1,
    progress: bool = False,
) -> dict[str, Any]:
    """Walk a motion on floors in MuJoCo, and here.

    With several processes a script must be guarded by ``if __name__ == "__main__"``, as `multiprocessing` requires.

    Parameters
    ----------
    motion : Motion or BalancedWalk
        The gait, with feedback or without.
    robot : Model, str or path
        A model, or a robot as in `load_robot`; "humanoid" is the simplified one.
    gearbox : {"mipsd", "rotor", "standard"}, optional
        Gearbox model; None: "mipsd" if all gears are elastic, else "rotor".
    servo : str, path or None
        Servo in place of the robot's own, as in `load_servo`.
    floors : iterable of str, optional
        Names of `FLOORS`; by default all twelve.
    soles : iterable of {"spheres", "boxes"}, optional
        Shapes of the soles; by default all that the feet can have.
    strides : int
        Number of measured strides.
    timestep : float
        Time step of both engines [s].
    out : path, optional
        Path of the files (.json, .csv) without an ending.  Floors that are in the .json with the same settings are not
        walked again.
    processes : int
        Number of processes.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    dict
        Settings and a row for each floor, as in the JSON file.

    Raises
    ------
    ImportError
        Without MuJoCo.
    ValueError
        For unknown names, for what `replay` lacks, for a robot that does not stand and for a damaged file in `out`.
    OSError
        If a file cannot be written or a process is lost.
    """
    instance("motion", motion, (Motion, BalancedWalk), "give what read_motion, motion_of or balanced returns")
    model = robot if isinstance(robot, Model) else load_walker(robot)
    walked = model if servo is None else driven(model, servo)
    gearbox = servo_gearbox(walked, gearbox)
    names = texts("floors", [*FLOORS] if floors is None else floors)
    kinds = texts("soles", soles_of(model) if soles is None else soles)
    for name in names:
        one_of("floors", name, FLOORS)
    for kind in kinds:
        one_of("soles", kind, SOLES)
    strides, timestep, processes = checked_sizes(strides, timestep, processes)
    parts = (model.links, model.joints, model.base, dict(model.held), dict(model.servos), model.contacts, model.supply)
    digest = hashlib.sha256(in_full(parts).encode()).hexdigest()
    settings = {
        "motion": motion.digest(), "robot": f"{model.name} {digest[:16]}", "servos": gearbox,
        "servo": None if servo is None else str(servo), "strides": strides, "warm_up": WARM_UP, "timestep": timestep,
        "version": __version__, "mujoco": mujoco_version(),
    }  # fmt: skip
    asked = [(name, kind) for name in FLOORS if name in names for kind in SOLES if kind in kinds]
    rows = _kept(out, settings)
    scene = compile_scene(walked, gearbox, Ground(), "midpoint", 1e-3)
    tasks = [(*key, scene, motion, strides, timestep) for key in asked if key not in rows]
    with progress_bar(total=len(asked), initial=len(asked) - len(tasks), progress=progress, unit="floor") as bar:
        for row in _evaluated(tasks, processes):
            rows[row["floor"], row["soles"]] = row
            _write(out, settings, rows)
            bar.update()
    return {"settings": settings, "floors": [rows[key] for key in asked]}


def checked_sizes(strides: int, timestep: float, processes: int) -> tuple[int, float, int]:
    """Return numbers of strides and processes and the time step of a crosscheck; raise ValueError if they cannot be."""
    return (
        whole("strides", strides, 1, "give the strides to measure", MOST_STRIDES),
        real("timestep", timestep, 1e-6, 1e-2, "give seconds, 2.5e-4 is usual"),
        whole("processes", processes, 1, "give the number of processes", 1024),
    )


def _evaluated(tasks: list[tuple], processes: int) -> Iterator[dict]:
    """Yield rows in order of completion; no task waits in a process, so that an interrupt only ends running ones."""
    if processes == 1 or len(tasks) < 2:
        yield from itertools.starmap(_row, tasks)
        return
    waiting = iter(tasks)
    with process_pool(min(processes, len(tasks))) as pool:
        try:
            running = {pool.submit(_row, *task) for task in itertools.islice(waiting, processes)}
            while running:
                done, running = wait(running, return_when=FIRST_COMPLETED)
                running |= {pool.submit(_row, *task) for task in itertools.islice(waiting, len(done))}
                yield from (future.result() for future in done)
        except BrokenExecutor as error:
            raise OSError("a process of the crosscheck ended unexpectedly; start it again to continue") from error


def _row(
    name: str, soles: Soles, scene: CompiledScene, motion: Motion | BalancedWalk, strides: int, timestep: float
) -> dict:
    return {"floor": name} | walk_on(scene, motion, Floor(*FLOORS[name], soles), strides, timestep).as_dict()


def summary(report: dict[str, Any]) -> str:
    """Format a report as a table with a verdict.

    Parameters
    ----------
    report : dict
        What `crosscheck` returns.

    Returns
    -------
    str
        Lines of text.
    """
    rows = report["floors"]
    lines = [
        f"{'':10} {'':8} {'sinks':>7} | {'MuJoCo':>8} {'':>6} {'':>6} | {'here':>8} {'':>6} {'':>6}",
        f"{'floor':10} {'soles':8} {'[mm]':>7} | {'[J/m]':>8} {'[mm/s]':>6} {'y [mm]':>6} | "
        f"{'[J/m]':>8} {'[mm/s]':>6} {'y [mm]':>6}",
    ]
    for row in rows:
        cells = " | ".join(_cells(row[engine]) for engine in ("mujoco", "own"))
        lines.append(f"{row['floor']:10} {row['soles']:8} {1e3 * row['sinking']:7.4f} | {cells}")
    return "\n".join([*lines, verdict(report)])


def _cells(walk: dict[str, Any]) -> str:
    if walk["walks"]:
        return f"{walk['cost']:8.1f} {1e3 * walk['speed']:6.0f} {1e3 * walk['sideways']:6.0f}"
    failed = "falls at" if "fell" in walk["status"] else "fails at"
    return f"{failed} {walk['end']:.1f} s".ljust(22)


def verdict(report: dict[str, Any]) -> str:
    """Say on how many floors a gait walks and at which cost, in MuJoCo and here.

    Parameters
    ----------
    report : dict
        What `crosscheck` returns.

    Returns
    -------
    str
        A sentence.
    """
    parts = []
    for engine, name in (("mujoco", "in MuJoCo"), ("own", "here, on ground that sinks alike,")):
        costs = [row[engine]["cost"] for row in report["floors"] if row[engine]["walks"]]
        cost = f", {min(costs):.1f} to {max(costs):.1f} J/m" if costs else ""
        parts.append(f"{name} it walks {report['settings']['strides']} strides on {len(costs)} of "
                     f"{len(report['floors'])} floors{cost}")  # fmt: skip
    return "; ".join(parts)


# ---------------------------------------------------------------------------------------------- files


def files(out: FilePath) -> tuple[Path, Path]:
    """Return the paths of the JSON file and the CSV."""
    path = Path(out)
    return path.with_name(path.name + ".json"), path.with_name(path.name + ".csv")


def _kept(out: FilePath | None, settings: dict[str, Any]) -> dict[tuple[str, str], dict]:
    """Read the rows of an earlier run with these settings, by floor and soles."""
    if out is None or not files(out)[0].exists():
        return {}
    found = read_json(files(out)[0], REPORT)
    rows = found.get("floors", []) if found.get("settings") == settings else []
    return {(row["floor"], row["soles"]): row for row in rows}


def _write(out: FilePath | None, settings: dict[str, Any], rows: dict[tuple[str, str], dict]) -> None:
    if out is None:
        return
    data, table = files(out)
    ordered = [rows[name, kind] for name in FLOORS for kind in SOLES if (name, kind) in rows]
    with complete(data) as temporary:
        text = json.dumps({"format": str(REPORT), "settings": settings, "floors": ordered}, indent=2)
        temporary.write_text(text, encoding="utf-8")
    columns = ["floor", "soles", "time_constant_s", "friction", "sinking_m"]
    columns += [f"{engine}_{name}" for engine in ("mujoco", "own") for name in MEASURES.values()]
    cells = [
        [*(row[key] for key in ("floor", "soles", "time_constant", "friction", "sinking")),
         *(row[engine][key] for engine in ("mujoco", "own") for key in MEASURES)]
        for row in ordered
    ]  # fmt: skip
    write_csv(table, TABLE, columns, cells)
