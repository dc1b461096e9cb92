"""`featherstone-gait crosscheck`: a gait in MuJoCo."""

from __future__ import annotations

from argparse import Namespace

from ..build.kinds import SERVO_KINDS
from .arguments import Commands, add_command, add_gait, announce, gait_stem, telling_extras

TAKES = "a minute or two on two cores; Ctrl-C keeps finished floors"


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(
        commands,
        "crosscheck",
        run,
        "walk a gait in MuJoCo, with the same servos and its own contact, on twelve floors; started again it goes on",
        "GAIT_crosscheck.json (a row a floor, in MuJoCo and here) and .csv",
        examples=(
            "featherstone-gait crosscheck humanoid_gait.npz",
            "featherstone-gait crosscheck humanoid_gait.npz --floors 2ms_0.9 --strides 5",
        ),
        takes=TAKES,
    )
    add_gait(parser)
    parser.add_argument("--no-feedback", action="store_true", help="leave out the feedback that a gait's file has")
    parser.add_argument("--servos", choices=SERVO_KINDS, default="mipsd", help="gearbox")
    parser.add_argument("--servo", metavar="NAME", help="of all joints, as of optimize (default: the robot's own)")
    parser.add_argument("--floors", metavar="NAMES", help="with commas: 2ms_0.9,20ms_0.6 (default: all; a wrong name "
                        "lists them)")  # fmt: skip
    soles = "of spheres,boxes with commas (default: both)"
    parser.add_argument("--soles", metavar="KINDS", default="spheres,boxes", help=soles)
    parser.add_argument("--strides", type=int, default=20, metavar="N", help="measured, after two (default: 20)")
    parser.add_argument("--timestep", type=float, default=2.5e-4, metavar="S", help="of MuJoCo [s] (default: 0.00025)")
    parser.add_argument("--processes", type=int, default=2, metavar="N", help="at a time (default: 2)")


def run(args: Namespace) -> int:
    from ..crosscheck import crosscheck, summary
    from ..crosscheck.run import files
    from ..robot_file import load_robot
    from ..walking.feedback import read_walk
    from ..walking.motion import read_motion

    model = load_robot(args.robot, locked="simplified" if args.robot == "humanoid" else None)
    plain = args.first or args.no_feedback
    motion = read_motion(args.gait, model.joint_names, first=args.first) if plain else read_walk(
        args.gait, model.joint_names
    )
    out = args.out / f"{gait_stem(args)}_crosscheck"
    announce(TAKES)
    with telling_extras():
        report = crosscheck(
            motion, args.robot, servos=args.servos, servo=args.servo, floors=args.floors and args.floors.split(","),
            soles=args.soles.split(","), strides=args.strides, timestep=args.timestep, out=out,
            processes=args.processes, progress=True,
        )  # fmt: skip
    print(summary(report))
    print("files:", *files(out))
    return 0
