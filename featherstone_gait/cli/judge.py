"""Judge a policy or a gait: in how many worlds it walks, for how many joules, and what it breaks on.

Worlds differ in floors, servos, masses, battery, zeros, sensors and delays.

Writes POLICY_judgment.json (what the table says, and more), .csv (a row for each world) and .html (all of it for a
browser, with the robot in the median world and in the worst one).  Several policies, or one on several servos, or
both, are judged in the same worlds, and a last table compares them; files of several servos are POLICY_SERVO_judgment.

Takes about a minute for 200 worlds of 10 s on two cores, compiling aside.

  featherstone-gait judge humanoid_gait.npz --robot humanoid --worlds 16
  featherstone-gait judge my_gait.csv --robot my_biped.urdf --servo ax12a
  featherstone-gait judge walk.onnx --robot scene.xml --servo xl330,mine.toml
"""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .arguments import (
    OWN_SERVO,
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

if TYPE_CHECKING:
    from ..judge import Judgment
    from ..scene.compile import CompiledScene


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    what = "an ONNX file, a gait's .npz, or joint angles as .csv; several are compared"
    parser.add_argument("policies", type=Path, metavar="POLICY", nargs="+", help=what)
    parser.option("--robot", "name or robot file (default: humanoid)", "humanoid")
    parser.option("--locked", "set of joints to lock, named in the robot's TOML file", metavar="SET")
    add_setup(parser, servo=f"{OWN_SERVO}; several with commas are compared")
    add_policy(parser)
    parser.option("--worlds", "number of worlds", 200, metavar="N")
    parser.option("--seed", "seed of all draws", 0, metavar="N")
    parser.option("--doubts", "TOML file of what differs between worlds (default: that of the package)", metavar="FILE")
    parser.option("--timestep", "time step of the midpoint rule [s]", 1e-3, metavar="S")
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..judge import compare, judge

    with telling_extras():
        scenes = _scenes(args)
        announce(args, "a minute for 200 worlds of 10 s, compiling aside")
        asked, records = velocities(args.velocities), []
        pairs = [(policy, servo) for policy in args.policies for servo in scenes]
        stems = [policy.stem + (f"_{_stem(servo)}" if len(scenes) > 1 else "") for policy, servo in pairs]
        for k, ((policy, servo), stem) in enumerate(zip(pairs, stems)):
            record = judge(
                policy, scenes[servo], args.worlds, args.seconds, asked, args.seed, description=args.description,
                doubts=args.doubts,
            )  # fmt: skip
            records.append(record if servo is None else replace(record, servo=_stem(servo)))
            _write(records[-1], args.out, stem + f"_{k + 1}" * (stems.count(stem) > 1))
    if len(records) > 1:
        print(compare(records))
    return 0


def _scenes(args: Namespace) -> dict[str | None, CompiledScene]:
    """Return the robot on its floor with each of the servos, by their names; None: its own servos."""
    from ..judge.run import scene_of
    from ..scene.actuator import servo_gearbox
    from ..walking.walker import driven, load_walker

    model = load_walker(args.robot, base=args.base, contacts=args.contacts, locked=args.locked)
    found: dict[str | None, CompiledScene] = {}
    for servo in [None] if args.servo is None else dict.fromkeys(args.servo.split(",")):
        own = model if servo is None else driven(model, servo)
        gearbox = servo_gearbox(own, args.gearbox)
        found[servo] = scene_of(own, gearbox, args.timestep)
        if args.gearbox is None:
            print(gearbox_line(gearbox) + (f" ({_stem(servo)})" if servo and "," in args.servo else ""))
    return found


def _stem(servo: str | None) -> str:
    """Return the name of a servo as it is in names of files."""
    return str(servo).replace(":", "_") if not str(servo).endswith(".toml") else Path(str(servo)).stem


def _write(record: Judgment, out: Path, stem: str) -> None:
    """Write the files of a judgment, and print its table and their names."""
    from ..base.files import complete

    files = [out / f"{stem}_judgment{ending}" for ending in (".json", ".csv", ".html")]
    with complete(files[0]) as temporary:
        temporary.write_text(json.dumps(record.as_dict(), indent=1), "utf-8")
    record.write_csv(files[1])
    record.page(files[2])
    print(record.table(), f"files: {', '.join(map(str, files))}", sep="\n\n", end="\n\n")

