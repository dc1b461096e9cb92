"""Write a gait as files for a real robot or another simulator; all three, unless options name some.

Writes GAIT_angles.csv [deg], GAIT_goal_positions.csv (AX-12, 0 to 1023 over 300 deg) and GAIT.xml (MJCF).

  featherstone-gait export humanoid_gait.npz
  featherstone-gait export humanoid_gait.npz --csv --strides 4 --out robot
"""

from __future__ import annotations

from argparse import Namespace

from .arguments import Commands, add_command, add_gait, gait_stem, robot_of_gait, servo_of_gait


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    add_gait(parser, ())
    parser.option("--csv", "joint angles over time [deg], as CSV", False)
    parser.option("--goal-positions", "the same in counts of AX-12 servos", False)
    parser.option("--mjcf", "the robot on a floor, with the gait's poses as keyframes", False)
    parser.option("--strides", "strides in the tables", 12, metavar="N")


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
    tables = (args.csv, "_angles.csv", write_angles), (args.goal_positions, "_goal_positions.csv", write_goal_positions)
    written = []
    for wanted, ending, write in tables:
        path = stem.with_name(stem.name + ending)
        if every or wanted:
            if path.exists() and path.samefile(args.gait):
                raise ValueError(f"{path}: is the gait itself; give another folder (--out)")
            write(path, reference.times, reference.values, model.joint_names)
            written.append(path)
    if every or args.mjcf:
        servo = servo_of_gait(args)
        model = model if servo is None else driven(model, servo)
        written.append(stem.with_name(f"{stem.name}.xml"))
        save_robot(with_poses(model, motion), written[-1], Ground())
    print("files:", *written)
    return 0
