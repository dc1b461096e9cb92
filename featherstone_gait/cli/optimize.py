"""Plan a biped's walk, and search for a gait that takes less energy per distance; Ctrl-C keeps the best so far.

Writes ROBOT_gait.json (measures before and after), _report.html (the same as a page), .npz (arrays), _animation.html,
_convergence.png, _angles.png, _angles.csv [deg], _goal_positions.csv (AX-12, every 40 ms), _history.jsonl and
_limits_history.jsonl (the search, for --resume), with --feedback _feedback_history.jsonl, and with --crosscheck
_crosscheck.json and .csv.

Takes about a minute on two cores, half a minute more where kernels must be compiled, with --crosscheck a minute more;
the time grows in proportion to the numbers of candidates and worlds, and is printed before the search.

  featherstone-gait optimize
  featherstone-gait optimize --seed 3 --out third --crosscheck
  featherstone-gait optimize --servo xm430
  featherstone-gait optimize --robot my_biped.urdf --servo generic --legs-only
"""

from __future__ import annotations

from argparse import SUPPRESS, Namespace
from dataclasses import fields

from ..optimize.options import OptimizeOptions
from .arguments import OWN_SERVO, Commands, add_command, add_quiet, add_setup, telling_extras


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    parser.add_argument("--robot", default="humanoid", help="name or robot file (default: humanoid, ten leg joints)")
    add_setup(parser, servo=f"{OWN_SERVO}; humanoid: ax12")
    for option in fields(OptimizeOptions):
        if option.metadata:
            flag = option.metadata["flag"] or f"--{option.name.replace('_', '-')}"
            how = {"dest": option.name, "default": SUPPRESS, **option.metadata["argument"]}
            parser.option(flag, **how)
    what = "search on one floor with the poses of a stride, as in the paper: the same as --worlds 0 --states stride"
    parser.option("--one-world", what, False)
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..optimize.job import main_job
    from ..optimize.preparation import folded
    from ..optimize.summary_table import summary

    names = [option.name for option in fields(OptimizeOptions) if option.name in args]
    given = {name: value for name in names if (value := getattr(args, name)) is not None}
    if args.one_world:
        if "worlds" in given or "states" in given:
            raise ValueError("--one-world sets --worlds and --states; give one of them")
        given |= {"worlds": 0, "states": "stride"}
    with telling_extras():
        report = main_job(args.robot, OptimizeOptions(**given, progress=not args.quiet))
    if args.quiet:
        print(folded(summary(report)))
    return 130 if report["search"]["message"].startswith("interrupted") else 0
