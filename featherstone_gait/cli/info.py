"""Print a robot's masses, joints, servos and contact points, and which integrator simulates it.

Writes ROBOT_info.txt, the same text, if --out is given.

  featherstone-gait info humanoid
  featherstone-gait info my_robot.urdf --all --out results
"""

from __future__ import annotations

import dataclasses
import math
import shutil
import textwrap
from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from ..base.files import complete
from ..scene.gearbox_kinds import GEARBOX_KINDS
from .arguments import LINE, Commands, add_command, add_robot, choice, gearbox_of, ground, output, robot_of
from .scenes import add_pairs, compiled, described, scene_in

if TYPE_CHECKING:
    from ..model import Controller, Gearbox, Joint, Model, Servo
    from ..scene.actuator import GearboxKind
    from ..scene.compile import CompiledScene
    from ..scene.preflight import Preflight

TORQUE_GAINS = {"Kp": "N m/rad", "Kd": "N m s/rad"}
GAINS = {  # of the laws that differ
    "pid_speed": {"Kp": "V s/rad", "Ki": "V/rad", "Kd": "V s^2/rad"},
    "pd": TORQUE_GAINS,
    "pd_clamped": TORQUE_GAINS,
}


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__, unasked=False)
    add_robot(parser)
    parser.option("--all", "also list links, contact points, and all numbers of joints and servos", False)
    add_pairs(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..scene.actuator import usual_gearbox

    scene_model = scene_in(args, args.robot)
    if scene_model is not None:
        return _told(args, described(scene_model, compiled(args, scene_model), args.all))
    model, _, said = robot_of(args, args.robot)
    suited = usual_gearbox(model)
    kind = gearbox_of(args, suited)
    fitting = [each for each in GEARBOX_KINDS if suited and (each != "mipsd" or each in (suited, kind))]
    scenes = {each: _compiled(args, model, each) for each in (None, *fitting)}
    scene = scenes[kind]
    check = None if isinstance(scene, str) else scene.preflight
    points = [(point.link, _numbers(point.position)) for point in model.contacts]
    lines = [
        f"{model.name}  {model.source}",
        f"{model.mass:.4g} kg, {model.base} base, {len(model.joint_names)} moving joints, {len(model.held)} locked",
        *_filled(_servo_lines(model)),
        *_filled(said),
        *_filled([_ground_line(model)]),
        *_choice_table(scenes, suited if model.base == "floating" or args.servo else None),
        "",
        *_filled([] if isinstance(scene, str) else [_explicit_line(scene), f"chosen: {choice(scene)}"]),
        *_filled([] if isinstance(scene, str) else [f"note: {note}" for note in scene.notes]),
        *_filled(f"note: {args.command.in_options(note)}" for note in model.notes),
        *(_joint_table(model, check) if args.all else _short_joint_table(model)),
    ]
    if args.all:
        lines += [*_link_table(model), *_servo_table(model)]
        lines += table(("contact point on", "position [m]"), points) if points else []
    else:
        lines += ["", "links, contact points, and all numbers of joints and servos: --all"]
    return _told(args, lines)


def _told(args: Namespace, lines: Sequence[str]) -> int:
    """Print lines, and write them to the file that is asked for; return the exit code."""
    text = "\n".join(lines) + "\n"
    print(text, end="")
    if args.out is not None:
        with complete(output(args, "info.txt")) as path:
            path.write_text(text, encoding="utf-8")
        print(f"\nfiles: {output(args, 'info.txt')}")
    return 0


def _link_table(model: Model) -> list[str]:
    head = ("link", "mass [kg]", "center of mass [m]", "ixx, iyy, izz [kg m^2]")
    rows = [
        (link.name, f"{link.mass:.5g}", _numbers(link.center_of_mass), _numbers(link.inertia[k] for k in (0, 3, 5)))
        for link in model.links
    ]
    return table(head, rows)


def _compiled(args: Namespace, model: Model, kind: GearboxKind | None) -> CompiledScene | str:
    """Compile the scene of `simulate` with a kind of gearbox, or return why it is none."""
    from ..scene.compile import compile_scene

    try:
        return compile_scene(model, kind, ground(model))
    except ValueError as error:
        return str(args.command.in_options(str(error)))


def _short_joint_table(model: Model) -> list[str]:
    """List the joints that move, with their limits, and those that are locked."""
    held, rows = model.held, []
    for joint in model.degrees.joints:
        if joint.type != "fixed":
            limits = _limits(joint)
            where = f"locked at {_angle(joint, held[joint.name])}" if joint.name in held else limits
            rows.append((joint.name, joint.type, where, _spring(joint)))
    columns = 4 if any(row[3] for row in rows) else 3
    return table(("joint", "type", "limits", "spring")[:columns], [row[:columns] for row in rows]) if rows else []


def _spring(joint: Joint) -> str:
    unit = "N/m" if joint.type == "prismatic" else "N m/rad"
    return f"{joint.stiffness:.4g} {unit} about {_angle(joint, joint.spring_reference)}" if joint.stiffness else ""


def _joint_table(model: Model, check: Preflight | None) -> list[str]:
    """List the joints, with the largest step that an explicit integrator could take."""
    head = ("joint", "type", "parent", "child", "axis", "limits", "effort", "speed", "explicit step [ms]")
    found = check.limits if check is not None else ()
    largest = {x.joint: f"{1e3 * x.step:.3g}" if x.step < math.inf else "any" for x in found}
    steps = {x.joint: f"{largest[x.joint]}, {x.cause}" for x in found}
    held = model.held
    steps |= {j.name: f"locked at {_angle(j, held[j.name])}" for j in model.degrees.joints if j.name in held}
    rows = []
    for joint in model.degrees.joints:
        names = joint.name, joint.type, joint.parent, joint.child
        if joint.type == "fixed":
            rows.append((*names, *"-----"))
            continue
        force, rate = ("N", "m/s") if joint.type == "prismatic" else ("N m", "rad/s")
        effort, speed = f"{joint.effort:.4g} {force}", f"{joint.velocity:.4g} {rate}"
        rows.append((*names, _numbers(joint.axis), _limits(joint), effort, speed, steps.get(joint.name, "")))
    return table(head, rows)


def _limits(joint: Joint) -> str:
    if joint.lower == -math.inf and joint.upper == math.inf:
        return "none"
    return f"{_angle(joint, joint.lower)} to {_angle(joint, joint.upper)}"


def _angle(joint: Joint, value: float) -> str:
    return f"{value:.4g} m" if joint.type == "prismatic" else f"{math.degrees(value):.4g} deg"


def _servos(model: Model) -> dict[Servo, str]:
    """Return each kind of servo with the joints that have it."""
    kinds: dict[Servo, list[str]] = {}
    for joint, servo in model.servos.items():
        kinds.setdefault(servo, []).append(joint)
    alone = len(kinds) == 1 and {*model.joint_names} <= model.servos.keys()
    return {servo: "all joints" if alone else ", ".join(joints) for servo, joints in kinds.items()}


def _servo_lines(model: Model) -> Iterator[str]:
    """Describe each kind of servo."""
    from ..identification.curve import torque_speed
    from ..model.servo import TORQUE_LAWS
    from ..scene.actuator import is_elastic, stall_torque

    for servo, joints in _servos(model).items():
        law, gear = servo.controller.law, "elastic" if is_elastic(servo) else "rigid"
        motor = law not in TORQUE_LAWS and servo.resistance > 0
        stall = torque_speed(servo, points=2).stall_torque if motor else stall_torque(servo)  # what its friction leaves
        yield f"servo of {joints}: law {law}, {stall:.3g} N m, {gear} gear {servo.gearbox.ratio:g} : 1"
    if not model.servos:
        yield "no servos; --servo NAME gives all joints one"


def _servo_table(model: Model) -> list[str]:
    """List each kind of servo once, with its joints."""
    lines = []
    for servo, joints in _servos(model).items():
        parts: list[tuple[str, Servo | Controller | Gearbox]]
        parts = [("motor", servo), ("controller", servo.controller), ("gearbox", servo.gearbox)]
        rows = [(part, name, value, unit) for part, record in parts for name, value, unit in _fields(record)]
        lines += ["", *_filled([f"servo of {joints}"]), *table(("part", "parameter", "value", "unit"), rows)[1:]]
    if model.supply is not None:
        lines += ["", f"supply of all servos: {model.supply.voltage:g} V, {model.supply.resistance:g} Ohm"]
    return lines


def _fields(record: Servo | Controller | Gearbox) -> Iterator[tuple[str, str, str]]:
    """Yield name, value and unit of the numbers of a servo, controller or gearbox."""
    from ..model import SERVO_UNITS

    units = SERVO_UNITS | GAINS.get(getattr(record, "law", ""), {})
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if not dataclasses.is_dataclass(value):
            text = str(value) if isinstance(value, (str, bool)) else f"{value:.6g}"
            yield field.name, text, units.get(field.name, "")


def _ground_line(model: Model) -> str:
    """Describe what carries the robot, and the default ground of `simulate`."""
    under, links = ground(model), len({point.link for point in model.contacts})
    if under is not None:
        return (
            f"stands with {len(model.contacts)} contact points of {links} links on ground that gives way by "
            f"{1e3 * under.penetration:g} mm under its weight, friction {under.friction:g} (by default)"
        )
    if model.base == "fixed":
        return "its base is fixed; `simulate` puts no ground under it"
    shapes = len(model.shapes)
    more = (
        f"--contacts takes them from its {shapes} collision shapes"
        if shapes
        else "it has no collision shapes to take them from; type them into its TOML"
    )
    return f"no contact points, so `simulate` lets it fall without ground: {more}"


def _choice_table(scenes: Mapping[GearboxKind | None, CompiledScene | str], usual: GearboxKind | None) -> list[str]:
    """List the integrator and the explicit limit for each kind of gearbox; usual: the default of `simulate`."""
    rows: list[tuple[str, str, str]] = []
    refused: dict[str, str] = {}
    for kind, each in scenes.items():
        if isinstance(each, str):
            refused.setdefault(each, kind or "none")
            continue
        worst, largest = each.preflight.worst, each.preflight.largest_explicit_step
        limit = f"{1e3 * largest:.3g} ms, {worst.joint}: {worst.cause}" if worst is not None else "any"
        steps = "" if each.adaptive else f", {1e3 * each.timestep:g} ms"
        rows.append(((kind or "none") + " *" * (kind == usual), limit, each.integrator + steps))
    listed = [*table(("servos", "explicit steps up to", "integrator"), rows), "* default of `simulate`"] if rows else []
    if "rotor" in scenes and "mipsd" not in scenes:
        listed.append("mipsd needs a finite stiffness and a rotor inertia of every servo's gearbox")
    return [*listed, *_filled(f"{kind} is refused: {why}" for why, kind in refused.items())]


def _filled(lines: Iterable[str]) -> list[str]:
    return [textwrap.fill(line, LINE, subsequent_indent="  ", break_on_hyphens=False) for line in lines]


def _explicit_line(scene: CompiledScene) -> str:
    """Describe the largest step that an explicit integrator could take."""
    check, limited = scene.preflight, "nothing limits an explicit step"
    if check.worst is not None:
        alone = f"{check.worst.joint} alone {1e3 * check.worst.step:.3g} ms, by its {check.worst.cause}"
        limited = f"explicit steps up to {1e3 * check.largest_explicit_step:.3g} ms, all joints together ({alone})"
    return f"with {scene.gearbox or 'no'} servos, {'on the ground' if scene.ground else 'without ground'}: {limited}"


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(f"{value + 0.0:.4g}" for value in values)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Format an empty line, the headings and the rows in aligned columns.

    Columns that do not fit the terminal follow in tables of their own, again behind the first column; a last cell that
    is too long goes on in further lines.
    """
    room = shutil.get_terminal_size().columns - 1
    widths = [max(len(str(row[k])) for row in [head, *rows]) for k in range(len(head))]
    lines: list[str] = []
    left = [*range(1, len(head))]
    while left or not lines:
        shown = [0]
        while left and (len(shown) == 1 or sum(widths[k] + 2 for k in shown) + widths[left[0]] <= room):
            shown.append(left.pop(0))
        lines.append("")
        for row in [head, *rows]:
            *before, last = (f"{row[k]!s:{widths[k]}}" for k in shown)
            start = "".join(f"{cell}  " for cell in before)
            parts = textwrap.wrap(last.rstrip(), max(room - len(start), 20), break_on_hyphens=False) or [""]
            lines += [(start + parts[0]).rstrip(), *(" " * len(start) + part for part in parts[1:])]
    return lines
