"""Show saved runs, or a robot, as a page for any browser.

Writes FILE_view.html; with --movie or --gif a movie instead, with --png the folder FILE_frames, with --live no file.

  featherstone-gait view humanoid
  featherstone-gait view dog.urdf --base floating --contacts feet
  featherstone-gait view humanoid_simulation.npz
  featherstone-gait view before.npz after.npz --ghosts
  featherstone-gait view bench.toml
  featherstone-gait view run.npz --live
  featherstone-gait view run.npz --gif --speed 0.1
  featherstone-gait view run.npz --movie run.mp4
"""

from __future__ import annotations

import errno
import logging
import webbrowser
from argparse import Namespace
from pathlib import Path

from ..scene.gearbox_kinds import GEARBOX_KINDS
from .arguments import Commands, add_command, add_setup, robot_of, telling_extras
from .scenes import add_pairs, scene_in, show_scene


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    files = "saved trajectories (.npz) of one robot, or a robot's name or file"
    parser.add_argument("files", nargs="+", metavar="FILE", help=files)
    parser.option("--robot", "robot of the runs (default: the one that their files name)", metavar="ROBOT")
    parser.option("--locked", "set of joints to lock, named in the robot's TOML file", metavar="SET")
    add_setup(parser, (*GEARBOX_KINDS, "none"))
    add_pairs(parser)
    caption = "caption of a run; give it once for each run"
    parser.option("--caption", caption, [], action="append", metavar="TEXT")
    plot = "plot this channel below the picture; may be repeated (default: contact_force, else torque, else q)"
    parser.option("--plot", plot, [], action="append", metavar="CHANNEL")
    parser.option("--ghosts", "draw all runs in one picture (default: side by side)", False)
    parser.option("--keyframe", "show a robot in this posture (default: the one nearest to zero)", metavar="NAME")
    parser.option("--live", "serve a page with the robot's full meshes until Ctrl-C (needs viser)", False)
    parser.option("--port", "port of --live", 8080, metavar="N")
    movie = "write a movie instead of a page: .mp4 or .webm (which need ffmpeg), or .gif"
    parser.option("--movie", movie, metavar="FILE")
    parser.option("--gif", "write a GIF of the first run instead of a page", False)
    parser.option("--png", "write a folder of PNG files instead of a page", False)
    parser.option("--speed", "playing speed of movies and PNG; 0.1 is slow motion", 1.0, metavar="X")
    parser.option("--fps", "frames per second of movies and PNG", 25.0, metavar="N")
    parser.option("--mesh-limit", "size of full meshes in a page [MB]; larger ones are simplified", 4.0, metavar="MB")
    parser.option("--open", "open the page in a browser", False)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..run.trajectory import Trajectory
    from ..run.trajectory import files as files_of
    from ..view.movie import save_movie
    from ..view.shown import in_posture, show, show_live

    saved = [files_of(file)[0].is_file() for file in args.files]
    scene = scene_in(args, args.files[0]) if len(saved) == 1 and not saved[0] else None
    if scene is not None:
        return show_scene(args, scene, Path(args.files[0]).stem)
    if len(saved) == 1 and not saved[0] and Path(args.files[0]).suffix not in (".npz", ".json"):
        model = robot_of(args, args.files[0]).model
        runs, names, robot = [in_posture(model, args.keyframe)], [model.name], model
    else:
        for file, is_run in zip(args.files, saved):
            if not is_run:
                if not Path(file).exists():
                    raise FileNotFoundError(errno.ENOENT, "", file)
                raise ValueError(f"{file}: is not a saved run; give files of trajectories (.npz), or one robot alone")
        runs = [Trajectory.load(file) for file in args.files]
        names, robot = [Path(file).stem for file in args.files], args.robot
        if "members" in runs[0].info:
            return show_scene(args, runs[0], names[0])
        if any((args.base, args.contacts, args.locked, args.servo, args.gearbox)):
            if robot is None:
                raise ValueError("--base, --contacts, --locked, --servo and --gearbox need a robot; name it (--robot)")
            robot = robot_of(args, robot).model
        if args.keyframe is not None:
            raise ValueError("--keyframe is for a robot without a run; leave it out, or give the robot's file")
    drawn = [args.movie] * bool(args.movie) + [f"{names[0]}.gif"] * args.gif + [f"{names[0]}_frames"] * args.png
    for name in drawn:
        with telling_extras():
            count = save_movie(runs[0], args.out / name, robot, fps=args.fps, speed=args.speed)
        print(f"file        {args.out / name}, {count} frames")
    if drawn:
        return 0
    captions = args.caption or [name if names.count(name) == 1 else f"{name} {k + 1}" for k, name in enumerate(names)]
    how = {"captions": captions, "plots": args.plot, "ghosts": args.ghosts}
    if args.live:
        with telling_extras():
            live = show_live(runs[0], robot, *runs[1:], port=args.port, **how)
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)  # browsers open connections they do not use
        print(f"page        {live.url}, until Ctrl-C", flush=True)
        if args.open:
            webbrowser.open(live.url)
        live.wait()
        return 0
    path = args.out / f"{names[0]}_view.html"
    page = show(runs[0], robot, *runs[1:], path=path, mesh_limit=args.mesh_limit, **how)
    for run, caption in zip(runs, captions):
        print(f"{caption}: {run.status}{': ' if run.message else ''}{run.message}")
    print(f"file        {path}, {len(page.html) / 1e6:.2g} MB")
    if args.open:
        webbrowser.open(path.resolve().as_uri())
    return 0
