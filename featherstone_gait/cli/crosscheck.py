"""Walk a gait in MuJoCo, with the same servos and MuJoCo's contact, on twelve floors; it resumes if interrupted.

Writes GAIT_crosscheck.json (one row per floor, in MuJoCo and here) and .csv.

Takes a minute or two on two cores; Ctrl-C keeps finished floors.

  featherstone-gait crosscheck humanoid_gait.npz
  featherstone-gait crosscheck humanoid_gait.npz --floors 2ms_0.9 --strides 5
  featherstone-gait crosscheck my_gait.csv --robot my_biped.urdf --servo generic
"""

from __future__ import annotations

import textwrap
from argparse import Namespace

from .arguments import (
    LINE,
    Commands,
    add_command,
    add_gait,
    add_quiet,
    announce,
    gait_stem,
    gearbox_line,
    robot_of_gait,
    servo_of_gait,
    telling_extras,
)

ROW = 4.0  # processor seconds of one core of an AMD EPYC, for 22 strides on a floor (docs/crosscheck.md)


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    add_gait(parser)
    parser.option("--no-feedback", "walk without the feedback that the gait's file has", False)
    floors = "names with commas, as in 2ms_0.9,20ms_0.6 (default: all; a wrong name lists them)"
    parser.option("--floors", floors, metavar="NAMES")
    soles = "shapes of the soles, spheres, boxes or both with a comma (default: both; for feet made of points spheres)"
    parser.option("--soles", soles, metavar="KINDS")
    parser.option("--strides", "strides to measure, after the first two", 20, metavar="N")
    parser.option("--timestep", "MuJoCo's time step [s]", 2.5e-4, metavar="S")
    parser.option("--processes", "number of processes", 2, metavar="N")
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..base.arguments import one_of
    from ..crosscheck import FLOORS, crosscheck, summary
    from ..crosscheck.in_mujoco import SOLES, soles_of
    from ..crosscheck.run import checked_sizes, files
    from ..scene.actuator import servo_gearbox
    from ..walking.feedback import read_walk
    from ..walking.motion import read_motion
    from ..walking.walker import driven

    model, servo = robot_of_gait(args), servo_of_gait(args)
    gearbox = servo_gearbox(model if servo is None else driven(model, servo), args.gearbox)
    plain = args.first or args.no_feedback
    motion = (
        read_motion(args.gait, model.joint_names, first=args.first)
        if plain
        else read_walk(args.gait, model.joint_names)
    )
    out = args.out / f"{gait_stem(args)}_crosscheck"
    names = [*FLOORS] if args.floors is None else args.floors.split(",")
    soles = soles_of(model) if args.soles is None else args.soles.split(",")
    for what, given, known in (("floors", names, FLOORS), ("soles", soles, SOLES)):
        for name in given:
            one_of(what, name, known)
    checked_sizes(args.strides, args.timestep, args.processes)
    minutes = ROW * len(names) * len(soles) * (args.strides + 2) / 22 / max(args.processes, 1) / 60.0
    with telling_extras():
        if args.gearbox is None:
            print(gearbox_line(gearbox))
        announce(args, f"about {max(minutes, 1.0):.0f} min, compiling aside; Ctrl-C keeps finished floors")
        report = crosscheck(
            motion, model, gearbox=gearbox, servo=servo, floors=names, soles=soles, strides=args.strides,
            timestep=args.timestep, out=out, processes=args.processes, progress=True,
        )  # fmt: skip
    *rows, said = summary(report).split("\n")
    print("\n".join([*rows, textwrap.fill(said, LINE)]))
    print("files:", *files(out))
    return 0
