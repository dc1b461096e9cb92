"""`featherstone-gait optimize`: a cheaper gait."""

from __future__ import annotations

from argparse import Namespace

from ..scene.gearbox_kinds import SERVO_KINDS
from .arguments import Commands, add_command, telling_extras

TAKES = (
    "two and a half minutes on two cores, compiling included, and with --crosscheck a minute or two more; the time "
    "grows in proportion to the numbers of candidates and worlds, and is printed before the search"
)


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(
        commands,
        "optimize",
        run,
        "plan a biped's walk, and search for a gait that takes less energy per distance; Ctrl-C keeps the best so far",
        "ROBOT_gait.json (measures before and after), _report.html (the same as a page), .npz (arrays), "
        "_animation.html, _convergence.png, _angles.png, "
        "_angles.csv [deg], _goal_positions.csv (AX-12, every 40 ms), _history.jsonl and _limits_history.jsonl (the "
        "search, for --resume), with --feedback _feedback_history.jsonl, and with --crosscheck _crosscheck.json and "
        ".csv",
        examples=(
            "featherstone-gait optimize",
            "featherstone-gait optimize --seed 3 --out third --crosscheck",
            "featherstone-gait optimize --robot my_biped.urdf --servo xl330",
            "featherstone-gait optimize --robot g1.urdf --servo generic --legs-only",
        ),
        takes=TAKES,
    )
    parser.add_argument("--robot", default="humanoid", help="name or robot file (default: humanoid, ten leg joints)")
    parser.add_argument("--servos", choices=SERVO_KINDS, default="mipsd", help="gearbox model (default: mipsd)")
    what = "servo of all joints that turn: a name that `featherstone-gait servos` lists, a .toml file, or generic, an "
    what += "AX-12 scaled to the robot's weight and twice as strong (generic:4: four times)"
    parser.add_argument("--servo", metavar="NAME", help=f"{what} (default: as the robot's file says; humanoid: ax12)")
    parser.add_argument("--iterations", type=int, default=800, metavar="N", help="number of candidates (default: 800)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the search (default: 0)")
    what = "worlds that each candidate walks in, with floors, servos and links that differ"
    parser.add_argument("--worlds", type=int, metavar="N", help=f"{what} (default: 8)")
    what = "whether the four poses describe a step, mirrored for the other leg, or a whole stride (default: step, if "
    what += "the robot is symmetric)"
    parser.add_argument("--states", choices=("step", "stride"), help=what)
    what = "search on one floor with the poses of a stride, as in the paper: the same as --worlds 0 --states stride"
    parser.add_argument("--nominal", action="store_true", help=what)
    parser.add_argument("--unseen", type=int, metavar="N", help="other worlds to test both gaits in (default: 200)")
    what = "minimize energy alone, without the limits of a real robot (docs/optimize.md)"
    parser.add_argument("--energy-only", action="store_true", help=what)
    what = "the electronics of all servos (default: assumed, 0.05 A per servo)"
    parser.add_argument(
        "--electronics", type=float, metavar="W", help=f"power [W] of {what}; reported apart from the motors'"
    )
    what = "power [W] of the locked servos, holding still; reported apart from the motors' (default: 0)"
    parser.add_argument("--holding", type=float, metavar="W", help=what)
    what = "plan that the search starts from: the plain one, or the cheapest of many (docs/walking.md; default: plain, "
    what += "or cheapest if the plain one falls)"
    parser.add_argument("--plan", choices=("plain", "cheapest"), help=what)
    what = "do not compare with the cheapest plan; saves some 15 s"
    parser.add_argument("--no-fair", action="store_true", help=what)
    what = "afterwards also search the gains of feedback from an IMU, with pushes (docs/feedback.md)"
    parser.add_argument("--feedback", action="store_true", help=what)
    what = "lock all joints but those of the legs"
    parser.add_argument("--legs-only", action="store_true", help=what)
    parser.add_argument(
        "--resume", action="store_true", help="continue the search whose history is in the output folder"
    )
    parser.add_argument("--crosscheck", action="store_true", help="also walk the gait in MuJoCo, on twelve floors")


def run(args: Namespace) -> int:
    from ..optimize.job import UNSEEN, WORLDS, main_job

    if args.nominal and (args.worlds is not None or args.states is not None):
        raise ValueError("--nominal says what --worlds and --states say; give one of them")
    with telling_extras():
        report = main_job(
            args.robot,
            servos=args.servos,
            servo=args.servo,
            iterations=args.iterations,
            seed=args.seed,
            out=args.out,
            resume=args.resume,
            states="stride" if args.nominal else args.states,
            worlds=0 if args.nominal else WORLDS if args.worlds is None else args.worlds,
            unseen=UNSEEN if args.unseen is None else args.unseen,
            crosscheck=2 if args.crosscheck else 0,
            limits=not args.energy_only,
            electronics=args.electronics,
            holding=args.holding,
            plan=args.plan,
            fair=not args.no_fair,
            feedback=args.feedback,
            legs_only=args.legs_only,
        )
    return 130 if report["search"]["message"].startswith("interrupted") else 0
