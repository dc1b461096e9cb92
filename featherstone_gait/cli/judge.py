"""Judge a policy or a gait: in how many worlds it walks, for how many joules, and what it breaks on.

Worlds differ in floors, servos, masses, battery, zeros, sensors and delays.

Writes POLICY_judgment.json (what the table says, and more), .csv (a row for each world) and .html (all of it for a
browser, with the robot in the median world and in the worst one).  Of several policies a last table compares them in
the same worlds.

Takes about a minute for 200 worlds of 10 s on two cores, compiling aside.

  featherstone-gait judge humanoid_gait.npz --robot humanoid --worlds 16
  featherstone-gait judge my_gait.csv --robot my_biped.urdf --servo ax12a
"""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

from .arguments import (
    Commands,
    add_command,
    add_policy,
    add_quiet,
    add_setup,
    announce,
    gearbox_line,
    telling_extras,
    velocities,
)


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    what = "an ONNX file, a gait's .npz, or joint angles as .csv; several are compared"
    parser.add_argument("policies", type=Path, metavar="POLICY", nargs="+", help=what)
    parser.option("--robot", "name or robot file (default: humanoid)", "humanoid")
    parser.option("--locked", "set of joints to lock, named in the robot's TOML file", metavar="SET")
    add_setup(parser)
    add_policy(parser)
    parser.option("--worlds", "number of worlds", 200, metavar="N")
    parser.option("--seed", "seed of all draws", 0, metavar="N")
    parser.option("--doubts", "TOML file of what differs between worlds (default: that of the package)", metavar="FILE")
    parser.option("--timestep", "time step of the midpoint rule [s]", 1e-3, metavar="S")
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..base.files import complete
    from ..judge import compare, judge
    from ..judge.run import scene_of
    from ..scene.actuator import servo_gearbox
    from ..walking.walker import driven, load_walker

    with telling_extras():
        model = load_walker(args.robot, base=args.base, contacts=args.contacts, locked=args.locked)
        if args.servo is not None:
            model = driven(model, args.servo)
        gearbox = servo_gearbox(model, args.gearbox)
        scene = scene_of(model, gearbox, args.timestep)
        if args.gearbox is None:
            print(gearbox_line(gearbox))
        announce(args, "a minute for 200 worlds of 10 s, compiling aside")
        asked, records = velocities(args.velocities), []
        stems = [policy.stem for policy in args.policies]
        for k, policy in enumerate(args.policies):
            how: dict[str, Any] = {"description": args.description, "doubts": args.doubts}
            record = judge(policy, scene, args.worlds, args.seconds, asked, args.seed, **how)
            stem = policy.stem + f"_{k + 1}" * (stems.count(policy.stem) > 1)
            files = [args.out / f"{stem}_judgment{ending}" for ending in (".json", ".csv", ".html")]
            with complete(files[0]) as temporary:
                temporary.write_text(json.dumps(record.as_dict(), indent=1), "utf-8")
            record.write_csv(files[1])
            record.page(files[2])
            records.append(record)
            print(record.table(), f"files: {', '.join(map(str, files))}", sep="\n\n", end="\n\n")
    if len(records) > 1:
        print(compare(records))
    return 0
