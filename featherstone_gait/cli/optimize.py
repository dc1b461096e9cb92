"""`featherstone-gait optimize`: a cheaper gait."""

from __future__ import annotations

from argparse import Namespace

from ..build.kinds import SERVO_KINDS
from .arguments import Commands, add_command, telling_extras


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(
        commands,
        "optimize",
        run,
        "plan a biped's walk and search for a gait that takes less energy per distance; Ctrl-C keeps the best so far",
        "ROBOT_gait.json (measures before and after), .npz (arrays), _animation.html, _convergence.png, _angles.png, "
        "_angles.csv [deg], _goal_positions.csv (AX-12, every 40 ms), _history.jsonl and with --crosscheck "
        "_crosscheck.json and .csv",
    )
    parser.add_argument("--robot", default="humanoid", help="name or .urdf file (default: humanoid, simplified)")
    parser.add_argument("--servos", choices=SERVO_KINDS, default="mipsd", help="gearbox")
    what = "of all joints that turn: a name that `featherstone-gait servos` lists, or a .toml file"
    parser.add_argument("--servo", metavar="NAME", help=f"{what} (default: the robot's own, of the humanoid ax12)")
    parser.add_argument("--iterations", type=int, default=800, metavar="N", help="candidates (default: 800)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the search (default: 0)")
    parser.add_argument("--resume", action="store_true", help="go on from the history in the folder")
    parser.add_argument("--crosscheck", action="store_true", help="also walk the gait in MuJoCo, on twelve floors")


def run(args: Namespace) -> int:
    from ..optimize import main_job

    with telling_extras():
        main_job(
            args.robot,
            servos=args.servos,
            servo=args.servo,
            iterations=args.iterations,
            seed=args.seed,
            out=args.out,
            resume=args.resume,
            crosscheck=2 if args.crosscheck else 0,
        )
    return 0
