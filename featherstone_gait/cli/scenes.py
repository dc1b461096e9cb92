"""Scenes of several models on the command line: find that a file is one, describe it, simulate it, show its runs."""

from __future__ import annotations

import textwrap
import webbrowser
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .arguments import LINE, Parser, choice, gearbox_of, output, robot_of

if TYPE_CHECKING:
    from ..model.placed import SceneModel
    from ..run.trajectory import Trajectory
    from ..scene.compile import CompiledScene

PARTS = ("robots", "objects", "obstacles")  # of a TOML file that is a scene
SHOWN = 12  # pairs that are listed
SAMPLE = 2e-3  # time between records, or less [s]
RECORD = ("q", "qd", "base_q", "base_qd", "contact_force")
OF_PAIRS = ("pair", "pair_force", "pair_normal_force", "pair_gap", "pair_position")


def add_pairs(parser: Parser) -> None:
    """Add the option that says what touches what, and that a file of MJCF is a scene and not a robot."""
    pairs = "load a scene, in which bodies touch each other (all), or the ground alone (none); of a robot's file its "
    pairs += "links (default of a scene in TOML or SimTwo: as it says; MJCF is a robot without this option)"
    parser.option("--pairs", pairs, choices=("all", "none"))


def scene_in(args: Namespace, file: str) -> SceneModel | None:
    """Load the scene of a file, or of a robot alone where --pairs is given; None for a robot."""
    from ..model.placed import Placed, SceneModel
    from ..robot_file.scene import load_scene
    from .arguments import ground

    path = Path(file)
    if _is_scene(path) or (args.pairs is not None and path.suffix in (".xml", ".mjcf") and path.is_file()):
        for option in ("base", "contacts", "locked", "servo"):
            if getattr(args, option):
                raise ValueError(f"{file} is a scene, whose file says {option} of each robot: leave --{option} out")
        return load_scene(path)
    if args.pairs is None:
        return None
    model = robot_of(args, file).model
    return SceneModel(model.name, (Placed(model),), ground=ground(model), source=str(model.source))


def _is_scene(path: Path) -> bool:
    """Return whether a file is a scene in TOML, or of SimTwo."""
    import tomllib

    if not path.is_file():
        return False
    if path.suffix == ".toml":
        try:
            return any(part in tomllib.loads(path.read_text("utf-8")) for part in PARTS)
        except ValueError:
            return False  # said by whoever reads it
    return path.suffix == ".xml" and "<scene" in path.read_text("utf-8", errors="replace")[:4096]


def compiled(args: Namespace, scene: SceneModel, **how: Any) -> CompiledScene:
    """Compile a scene with the gearbox and the pairs that are asked for."""
    from ..scene.actuator import usual_gearbox
    from ..scene.compile import compile_scene

    driven = [one.model for one in scene.members if any(name in one.model.servos for name in one.model.joint_names)]
    kind = gearbox_of(args, usual_gearbox(driven[0]) if driven else None)
    return compile_scene(scene, kind, pairs=args.pairs, **how)


def described(scene: SceneModel, found: CompiledScene, all_pairs: bool = True) -> list[str]:
    """Say what is in a scene and what touches what."""
    lines = [f"{scene.name}  {scene.source}"]
    for placed in scene.members:
        model = placed.model
        kind = f"{model.base} base, {len(model.joint_names)} moving joints" if model.joint_names else "object"
        at = ", ".join(f"{x:.4g}" for x in placed.position)
        lines.append(f"{placed.name}: {model.mass:.4g} kg, {kind}, at {at} m")
    if scene.obstacles:
        lines.append(f"obstacles: {', '.join(placed.name for placed in scene.obstacles)}")
    ground = found.ground
    lines.append("no ground" if ground is None else f"ground of friction {ground.friction:g}")
    lines += pair_lines(found, all_pairs)
    lines += [f"note: {note}" for note in (*scene.notes, *found.notes)]
    return [*map(filled, lines), filled(f"chosen: {choice(found)}")]


def pair_lines(found: CompiledScene, all_pairs: bool = False) -> list[str]:
    """Say which links can touch each other."""
    links = [f"{one} - {two}" for one, two in dict.fromkeys(found.pairs)]
    if not links:
        return ["pairs: none; bodies pass through each other"]
    shown = links if all_pairs else links[:SHOWN]
    more = f", and {len(links) - len(shown)} more" if len(shown) < len(links) else ""
    return [f"pairs: {len(links)} can touch each other: {', '.join(shown)}{more}"]


def filled(line: str) -> str:
    """Wrap a line for a terminal."""
    return textwrap.fill(line, LINE, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)


def simulate_scene(args: Namespace, scene: SceneModel) -> int:
    """Simulate a scene from where its members stand, servos holding their joints; return the exit code."""
    from ..run.simulate import simulate
    from ..view.shown import show

    found = compiled(args, scene, integrator=args.integrator, timestep=args.timestep)
    print("\n".join(described(scene, found, False)))
    duration = 2.0 if args.duration is None else args.duration
    most = max(1, round(SAMPLE / found.timestep))
    every = next(k for k in range(most, 0, -1) if found.tick_steps % k == 0) * found.timestep
    record = [name for name in RECORD if name != "contact_force" or found.constants.contact is not None]
    record += OF_PAIRS if found.pairs else ()
    run = simulate(found, duration, record=record, record_interval=every, rtol=args.rtol)
    run.info.update(start=f"{scene.name}, from where its members stand", source=scene.source, pairs_of_file=args.pairs)
    path = output(args, "simulation")
    run.save(path)
    page = show(run, found, path=output(args, "simulation.html"), plots=["pair_normal_force"] if touches(run) else [])
    lines = [
        f"simulated   {run.end_time:.4g} s",
        f"status      {run.status}{': ' if run.message else ''}{run.message}",
        f"touched     {', '.join(' - '.join(pair) for pair in touches(run)) or 'no bodies each other'}",
        f"files       {path}.npz, .json, {page.path}",
    ]
    print("\n".join(map(filled, lines)))
    return 0 if run.ok else 1


def show_scene(args: Namespace, seen: SceneModel | Trajectory, name: str) -> int:
    """Write a page of a scene where its members stand, or of a run of one; return the exit code."""
    from ..run.trajectory import Trajectory
    from ..view.shown import show

    refused = ("keyframe", "caption", "ghosts", "live", "movie", "gif", "png")
    for option in refused:
        if getattr(args, option):
            raise ValueError(f"{name}: a scene of several is shown as a page; leave --{option} out")
    if isinstance(seen, Trajectory):
        source = args.robot or seen.info.get("source")
        args.pairs = args.pairs or seen.info.get("pairs_of_file")
        scene = scene_in(args, source) if source else None
        if scene is None:
            raise ValueError(f"{name}: the run is of several models; give the file of their scene (--robot)")
        run, found = seen, compiled(args, scene)
    else:
        found = compiled(args, seen)
        run = at_start(found)
        print("\n".join(map(filled, pair_lines(found))))
    page = show(run, found, path=args.out / f"{name}_view.html", plots=args.plot)
    print(f"file        {page.path}, {len(page.html) / 1e6:.2g} MB")
    if args.open:
        webbrowser.open(Path(str(page.path)).resolve().as_uri())
    return 0


def at_start(scene: CompiledScene) -> Trajectory:
    """Make a run without duration of a scene where its members stand."""
    import numpy as np

    from ..run.classify import to_trajectory
    from ..run.prepare import prepare
    from ..run.simulate import initial_state

    tick, y = scene.tick_steps * scene.timestep, initial_state(scene, allow_limit_violation=True)
    run = prepare(scene, tick, ("q", "base_q"))
    return to_trajectory(run, y, np.tile(y[run.channels], (run.samples, 1)))


def touches(run: Trajectory) -> tuple[tuple[str, str], ...]:
    """Return which links touched each other in a run, of a scene with pairs or without."""
    return run.touched() if run.info.get("pairs") else ()
