"""Walk a gait in MuJoCo, with the same servos and MuJoCo's contact, on twelve floors; it resumes if interrupted.

Writes GAIT_crosscheck.json (one row per floor, in MuJoCo and here) and .csv.

Takes a minute or two on two cores; Ctrl-C keeps finished floors.

In place of the gait a policy may stand, an .onnx file: its speed and energy are printed beside those here, for the
floors that are named (default: 10ms_0.9), and no file is made.

  featherstone-gait crosscheck humanoid_gait.npz
  featherstone-gait crosscheck humanoid_gait.npz --floors 2ms_0.9 --strides 5
  featherstone-gait crosscheck my_gait.csv --robot my_biped.urdf --servo generic
  featherstone-gait crosscheck walking.onnx --robot scene.xml --contacts feet
"""

from __future__ import annotations

import textwrap
from argparse import Namespace

from .arguments import (
    LINE,
    Commands,
    add_command,
    add_gait,
    add_policy,
    add_quiet,
    announce,
    gait_stem,
    gearbox_line,
    robot_of_gait,
    servo_of_gait,
    telling_extras,
    velocities,
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
    add_policy(parser, "of a policy: ")
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    if args.gait.suffix == ".onnx":
        return _policy(args)
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


def _policy(args: Namespace) -> int:
    """Let a policy walk in MuJoCo and here, and print what both say."""
    from ..base.arguments import one_of
    from ..crosscheck import FLOORS, Floor, crosscheck_policy
    from ..crosscheck.in_mujoco import SOLES
    from ..judge.run import scene_of
    from ..scene.actuator import servo_gearbox
    from ..walking.walker import driven, load_walker

    names = [one_of("floors", name, FLOORS) for name in (args.floors or "10ms_0.9").split(",")]
    asked = [one_of("soles", name, SOLES) for name in (args.soles or "spheres").split(",")]
    floors = [(name, Floor(*FLOORS[name], kind)) for name in names for kind in SOLES if kind in asked]
    command = velocities(args.velocities)
    with telling_extras():
        model = load_walker(args.robot, base=args.base, contacts=args.contacts, locked=args.locked)
        model = model if args.servo is None else driven(model, args.servo)
        scene = scene_of(model, servo_gearbox(model, args.gearbox))
        announce(args, f"about {max(1, round(0.02 * args.seconds * len(floors)))} min, compiling aside")
        for name, floor in floors:
            how = {"description": args.description, "floor": floor, "timestep": args.timestep}
            found = crosscheck_policy(args.gait, scene, args.seconds, command, **how)
            print(f"{name}, {floor.soles}", found.table(), sep="\n", end="\n\n")
    return 0
