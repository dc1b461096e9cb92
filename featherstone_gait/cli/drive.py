"""Drive a robot by the keys of a page, and pull at its links, in real time until Ctrl-C.

Writes ROBOT_drive.npz (positions and all inputs) and .json, which `featherstone-gait view` shows and `replay` repeats.

Takes a second or two to begin, and the first time that a kind of robot is driven up to half a minute to compile.

  featherstone-gait drive humanoid
  featherstone-gait drive arm7 --key a=joint1:0.5 --key d=joint1:-0.5
  featherstone-gait drive omni_robot --key ArrowUp=axle_2:5,axle_3:-5 --open
"""

from __future__ import annotations

from argparse import Namespace

from .arguments import Commands, add_command, add_robot, choice, gearbox_of, ground, output, robot_of
from .scenes import add_pairs, compiled, scene_in


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    add_robot(parser)
    add_pairs(parser)
    key = "what a key of the page commands while it is held; may be repeated: ArrowUp=left_wheel:6,right_wheel:6"
    parser.option("--key", key, [], action="append", metavar="KEY=JOINT:X,...")
    actions = ("speed", "reference", "voltage", "pwm", "torque")
    parser.option("--action", "what the numbers are (default: speed where there are servos)", choices=actions)
    parser.option("--duration", "end after this time [s] (default: at Ctrl-C)", type=float, metavar="S")
    limit = "largest force of the pointer [N]; 0: none (default: the robot's weight)"
    parser.option("--push-limit", limit, type=float, metavar="F")
    parser.option("--port", "port of the page, or the first free one after it", 8080, metavar="N")
    parser.option("--open", "open the page in a browser", False)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..scene.actuator import usual_gearbox
    from ..scene.compile import compile_scene
    from ..view.drive import drive

    several = scene_in(args, args.robot)
    if several is not None:
        scene = compiled(args, several)
    else:
        model = robot_of(args, args.robot).model
        scene = compile_scene(model, gearbox_of(args, usual_gearbox(model)), ground(model))
    print(f"integrator  {choice(scene)}")
    keys = dict(_key(text) for text in args.key)
    done = drive(
        scene, keys, action=args.action, duration=args.duration, push_limit=args.push_limit,
        path=output(args, "drive"), port=args.port, open=args.open,
    )  # fmt: skip
    return 0 if done.ok else 1


def _key(text: str) -> tuple[str, dict[str, float]]:
    """Read KEY=JOINT:X,JOINT:X."""
    key, equals, adds = text.rpartition("=") if text.startswith("=") else text.partition("=")
    table = {}
    for part in adds.split(","):
        name, colon, number = part.rpartition(":")
        try:
            table[name] = float(number)
        except ValueError:
            equals = ""
        if not (key and equals and colon and name):
            raise ValueError(f"--key {text!r}: give KEY=JOINT:X,JOINT:X, such as ArrowUp=left_wheel:6,right_wheel:6")
    return key, table
