"""The command line, `featherstone-gait COMMAND`.

A command is one function from its arguments to an exit code, registered in `_parser`; what it needs is imported where
it is used, so that `--help` answers at once.  Exit codes: 0 done, 1 the simulation ended with another status than
"ok", 2 an argument or a file is wrong (one line says which), 130 interrupted.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
import time
from importlib import import_module
from pathlib import Path

from . import __version__

BENCHMARKS = ("speed",)  # modules of `featherstone_gait.benchmark`
SWING, PULL = 0.5 * math.pi, 0.1  # where the first joint starts, without and with servos [rad]
SAMPLE = 2e-3  # time between records, in whole steps [s]
UNITS = {
    "resistance": "Ohm",
    "inductance": "H",
    "motor_constant": "V s/rad",
    "voltage_limit": "V",
    "current_limit": "A",
    "current_slew": "A/s",
    "viscous_friction": "N m s/rad",
    "coulomb_friction": "N m",
    "encoder_resolution": "rad",
    "speed_filter": "s",
    "Kp": "V/rad",
    "Ki": "V/(rad s)",
    "Kd": "V s/rad",
    "Kf": "V/rad",
    "period": "s",
    "lag": "s",
    "torque_limit": "N m",
    "rotor_inertia": "kg m^2",
    "rotor_damping": "N m s/rad",
    "stiffness": "N m/rad",
    "damping": "N m s/rad",
    "backlash": "rad",
}


def main(argv: list[str] | None = None) -> int:
    """Run a command; return its exit code."""
    args = _parser().parse_args(argv)
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        return args.run(args)
    except (ValueError, OSError) as error:
        print("error:", " ".join(str(error).split()), file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="featherstone-gait", description="Simulate servo-driven robots.")
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    info = _command(commands, "info", _info, "print a robot's masses, joints, servos and step limits", "ROBOT_info.txt")
    _add_robot(info)

    simulation = _command(
        commands,
        "simulate",
        _simulate,
        "simulate a robot: a fixed one swings, or with servos is pulled upright; a floating one stands on the ground",
        "ROBOT_simulation.npz (channels), .json (status, settings, measures) and .png",
    )
    _add_robot(simulation)
    simulation.add_argument("--duration", type=float, metavar="S", help="[s] (default: 1, with servos or ground 2)")
    simulation.add_argument("--integrator", metavar="NAME", help="implicit_euler, midpoint, rk4 or simtwo")
    simulation.add_argument("--timestep", type=float, metavar="S", help="[s] (default: chosen, and stated)")

    benchmark = _command(commands, "benchmark", _benchmark, "run a benchmark", "NAME.csv and NAME.png")
    benchmark.add_argument("name", metavar="NAME", choices=BENCHMARKS, help=", ".join(BENCHMARKS))
    benchmark.add_argument("--full", action="store_true", help="repeat everything more often")
    return parser


def _command(commands, name: str, run, does: str, writes: str) -> argparse.ArgumentParser:
    """Register a command and its option --out."""
    parser = commands.add_parser(name, help=does, description=f"{does[0].upper()}{does[1:]}.  Writes {writes}.")
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR", help=f"folder for {writes} (default: here)")
    parser.set_defaults(run=run)
    return parser


def _add_robot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("robot", metavar="ROBOT", help="name of a robot that comes with the package, or a .urdf file")
    parser.add_argument("--locked", metavar="SET", help="set of joints to hold, from the robot's TOML file")
    parser.add_argument("--servos", choices=("mipsd", "rotor", "standard", "none"), help="gearbox of the servos")


def _output(args, kind: str) -> Path:
    """Path of the files of a command about a robot, without suffix."""
    return args.out / f"{Path(args.robot).stem}_{kind}"


def _ground(model):
    """Flat ground for a robot that can stand on it."""
    from .model import Ground

    return Ground() if model.base == "floating" and model.contacts else None


# ---------------------------------------------------------------------------------------------- info


def _info(args) -> int:
    from .robot_file import load_robot
    from .scene import compile_scene

    model = load_robot(args.robot, locked=args.locked)
    servos = args.servos or ("mipsd" if any(name in model.servos for name in model.joint_names) else None)
    scene = compile_scene(model, None if servos == "none" else servos, _ground(model))
    lines = [
        f"{model.name}  {model.source}",
        f"{model.mass:.4g} kg, {model.base} base, {len(model.joint_names)} moving joints, {len(model.locked)} locked",
        *_link_table(model),
        *_joint_table(model, scene.preflight),
        *_servo_table(model),
        *_contact_table(model),
        *(f"note: {note}" for note in model.notes),
        "",
        *_preflight_lines(scene),
    ]
    text = "\n".join(lines) + "\n"
    print(text, end="")
    _output(args, "info").with_suffix(".txt").write_text(text, encoding="utf-8")
    return 0


def _link_table(model) -> list[str]:
    head = ("link", "mass [kg]", "centre of mass [m]", "ixx, iyy, izz [kg m^2]")
    rows = [
        (link.name, f"{link.mass:.5g}", _numbers(link.center_of_mass), _numbers(link.inertia[k] for k in (0, 3, 5)))
        for link in model.links
    ]
    return _table(head, rows)


def _joint_table(model, check) -> list[str]:
    """The joints, with the largest step that an explicit integrator could take."""
    head = ("joint", "type", "parent", "child", "axis", "limits", "effort", "speed", "explicit step [ms]")
    steps = {limit.joint: f"{1e3 * limit.step:.3g}, {limit.cause}" for limit in check.limits}
    rows = []
    for joint in model.joints:
        held = joint.name in model.locked
        step = f"locked at {_angle(joint, model.locked[joint.name])}" if held else steps.get(joint.name, "")
        if joint.type == "fixed":
            rows.append((joint.name, joint.type, joint.parent, joint.child, *"-----"))
            continue
        limits = f"{_angle(joint, joint.lower)} to {_angle(joint, joint.upper)}"
        axis, torque = _numbers(joint.axis), "N" if joint.type == "prismatic" else "N m"
        effort, speed = f"{joint.effort:.4g} {torque}", f"{joint.velocity:.4g} {torque and _rate(joint)}"
        rows.append((joint.name, joint.type, joint.parent, joint.child, axis, limits, effort, speed, step))
    return _table(head, rows)


def _angle(joint, value: float) -> str:
    return f"{value:.4g} m" if joint.type == "prismatic" else f"{math.degrees(value):.4g} deg"


def _rate(joint) -> str:
    return "m/s" if joint.type == "prismatic" else "rad/s"


def _servo_table(model) -> list[str]:
    """Each kind of servo once, with the joints that have it."""
    kinds: dict = {}
    for joint, servo in model.servos.items():
        kinds.setdefault(servo, []).append(joint)
    lines = []
    for servo, joints in kinds.items():
        parts = {"motor": servo, "controller": servo.controller, "gearbox": servo.gearbox}
        rows = [(part, name, value, unit) for part, record in parts.items() for name, value, unit in _fields(record)]
        lines += ["", f"servo of {', '.join(joints)}", *_table(("part", "parameter", "value", "unit"), rows)[1:]]
    return lines


def _fields(record):
    """Name, value and unit of the numbers of a servo, controller or gearbox."""
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if not dataclasses.is_dataclass(value):
            yield field.name, value if isinstance(value, str) else f"{value:.6g}", UNITS.get(field.name, "")


def _contact_table(model) -> list[str]:
    rows = [(point.link, _numbers(point.position)) for point in model.contacts]
    return _table(("contact point on", "position [m]"), rows) if rows else []


def _preflight_lines(scene) -> list[str]:
    check, servos = scene.preflight, f"{scene.servos} servos" if scene.servos else "no servos"
    worst = min(check.limits, key=lambda limit: limit.step, default=None)
    limited = "nothing limits an explicit step"
    if worst is not None and worst.step < math.inf:
        limited = f"explicit steps up to {1e3 * worst.step:.3g} ms ({worst.joint}: {worst.cause})"
    where = "on the ground" if scene.ground else "without ground"
    return [f"with {servos}, {where}: {limited}", f"chosen: {_choice(scene)}"]


def _choice(scene) -> str:
    return f"{scene.integrator}, step {1e3 * scene.timestep:g} ms ({scene.preflight.reason})"


def _numbers(values) -> str:
    return ", ".join(f"{value + 0.0:.4g}" for value in values)


def _table(head, rows) -> list[str]:
    """An empty line, the headings and the rows, in aligned columns."""
    widths = [max(len(str(row[k])) for row in [head, *rows]) for k in range(len(head))]
    return ["", *("  ".join(f"{cell:{width}}" for cell, width in zip(row, widths)).rstrip() for row in [head, *rows])]


# ---------------------------------------------------------------------------------------------- simulate


def _simulate(args) -> int:
    start = time.perf_counter()
    from .robot_file import load_robot
    from .scene import compile_scene

    model = load_robot(args.robot, locked=args.locked)
    driven = model.base == "floating" and bool(model.servos)
    servos = None if args.servos == "none" else args.servos or ("mipsd" if driven else None)
    scene = compile_scene(model, servos, _ground(model), args.integrator, args.timestep)
    duration = args.duration or (1.0 if servos is None and scene.ground is None else 2.0)
    text, run = _experiment(scene)
    run(scene, scene.timestep)  # compiles, or loads what an earlier process compiled
    ready = time.perf_counter()
    trajectory = run(scene, duration)
    done = time.perf_counter()
    finer = run(compile_scene(model, servos, scene.ground, scene.integrator, 0.5 * scene.timestep), duration)
    measures = _measures(scene, trajectory, finer) | {
        "seconds_until_ready": ready - start,
        "seconds_per_simulated_second": (done - ready) / trajectory.end_time,
    }
    trajectory.info.update(start=text, joints=model.joint_names, measures=measures)
    path = _output(args, "simulation")
    trajectory.save(path)
    plotting = time.perf_counter()
    _plot_simulation(scene, trajectory, text, path.with_suffix(".png"))
    measures["seconds_of_plotting"] = time.perf_counter() - plotting
    print("\n".join(_summary(scene, trajectory, duration)))
    print(f"files       {path}.npz, .json, .png")
    return 0 if trajectory.ok else 1
