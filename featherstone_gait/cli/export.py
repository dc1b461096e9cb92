"""`featherstone-gait export`: a gait as files that others can play."""

from __future__ import annotations

from argparse import Namespace

from .arguments import Commands, add_command, add_gait, gait_stem, robot_of_gait, servo_of_gait


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(
        commands,
        "export",
        run,
        "write a gait as files for a real robot or another simulator; all three, unless options name some",
        "GAIT_angles.csv [deg], GAIT_goal_positions.csv (AX-12, 0 to 1023 over 300 deg) and GAIT.xml (MJCF)",
        examples=(
            "featherstone-gait export humanoid_gait.npz",
            "featherstone-gait export humanoid_gait.npz --csv --strides 4 --out robot",
        ),
    )
    add_gait(parser)
    what = "servo of all joints, in the MJCF file (default: the one that the .npz names, else the robot's own)"
    parser.add_argument("--servo", metavar="NAME", help=what)
    parser.add_argument("--csv", action="store_true", help="joint angles over time [deg], as CSV")
    parser.add_argument("--goal-positions", action="store_true", help="the same in counts of AX-12 servos")
    parser.add_argument("--mjcf", action="store_true", help="the robot on a floor, with the gait's poses as keyframes")
    parser.add_argument("--strides", type=int, default=12, metavar="N", help="strides in the tables (default: 12)")


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..model import Ground
    from ..robot_file import save_robot
    from ..walking.gait_file import write_angles, write_goal_positions
    from ..walking.motion import read_motion, with_poses
    from ..walking.walker import driven

    model = robot_of_gait(args)
    motion = read_motion(args.gait, model.joint_names, first=args.first)
    reference = motion.reference(args.strides)
    every = not (args.csv or args.goal_positions or args.mjcf)
    stem = args.out / gait_stem(args)
    paths = {kind: stem.with_name(stem.name + ending) for kind, ending in
             (("csv", "_angles.csv"), ("goals", "_goal_positions.csv"), ("mjcf", ".xml"))}  # fmt: skip
    written = []
    for kind, write in (("csv", write_angles), ("goals", write_goal_positions)):
        if every or (args.csv if kind == "csv" else args.goal_positions):
            if paths[kind].exists() and paths[kind].samefile(args.gait):
                raise ValueError(f"{paths[kind]}: is the gait itself; give another folder (--out)")
            write(paths[kind], reference.times, reference.values, model.joint_names)
            written.append(paths[kind])
    if every or args.mjcf:
        servo = servo_of_gait(args)
        model = model if servo is None else driven(model, servo)
        save_robot(with_poses(model, motion), paths["mjcf"], Ground())
        written.append(paths["mjcf"])
    print("files:", *written)
    return 0
