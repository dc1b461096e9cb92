"""Define the arguments that several commands share, and name their files."""

from __future__ import annotations

import argparse
import difflib
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeAlias

from ..scene.gearbox_kinds import GEARBOX_KINDS, why_chosen

if TYPE_CHECKING:
    from ..model import Ground, Model
    from ..scene.actuator import GearboxKind
    from ..scene.compile import CompiledScene

Commands: TypeAlias = "argparse._SubParsersAction[Parser]"

LINE = 79  # columns of what is printed
OWN_SERVO = "as in the robot's files"
OWN_GEARBOX = "mipsd for elastic gears, rotor for rigid ones"


class Help(argparse.HelpFormatter):
    """Help text whose paragraphs are filled, but those with examples, which stay as they are."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=20)

    def add_usage(
        self, usage: str | None, actions: Iterable[argparse.Action], groups: Iterable[Any], prefix: str | None = None
    ) -> None:
        """Show what must be given; the options are listed below."""
        needed = [action for action in actions if action.required or not action.option_strings]
        super().add_usage(usage, needed, [], prefix)

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        parts = (
            part if "\n  " in part else textwrap.fill(part, width, break_on_hyphens=False)
            for part in text.split("\n\n")
        )
        return "\n\n".join(parts)


class Parser(argparse.ArgumentParser):
    """A parser whose errors say in one line what is wrong, what may be meant, and where to read on."""

    def error(self, message: str) -> NoReturn:
        """Print the error and exit with code 2."""
        print(f"error: {message}; `{self.prog} --help` lists what there is", file=sys.stderr)
        raise SystemExit(2)

    def unknown(self, arguments: Sequence[str]) -> NoReturn:
        """Report arguments that the command does not have."""
        known = [option for action in self._actions for option in action.option_strings]
        options = [each.partition("=")[0] for each in arguments if each.startswith("-")]
        if options:
            self.error(", ".join(f"there is no option {each}{_meant(each, known)}" for each in options))
        self.error(f"{' '.join(arguments)!r} was not expected")

    def in_options(self, text: str) -> str:
        """Return a message with the command's options in place of keywords of Python: --base floating for base=..."""
        for action in self._actions:
            flag, name = (action.option_strings or [""])[0], action.dest
            if flag.startswith("--") and action.nargs == 0:
                text = re.sub(rf"\b{name}=True\b", flag, text)
            elif flag.startswith("--"):
                text = re.sub(rf"\b{name}=None\b", f"{flag} none", text)
                text = re.sub(rf"\b{name}=(['\"]?)([\w.+:/-]*\w)\1", rf"{flag} \2", text)
        return text

    def option(self, flag: str, help: str, default: Any = None, **how: Any) -> None:
        """Add an option, whose default may say more: False makes a switch, a number its type and a note in the help.

        how: as in `add_argument`.
        """
        if default is False:
            how["action"] = "store_true"
        elif isinstance(default, (int, float)):
            help, how["type"] = f"{help} (default: {default:g})", type(default)
        self.add_argument(flag, help=help, default=default, **how)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            names = [str(each) for each in action.choices]
            if isinstance(action, argparse._SubParsersAction):
                raise argparse.ArgumentError(None, f"there is no command {value!r}{_meant(value, names)}")
            raise argparse.ArgumentError(action, f"{value!r} is none of {', '.join(names)}{_meant(value, names)}")


def _meant(word: str, known: Sequence[str]) -> str:
    """Suggest a known word for an unknown one."""
    near = difflib.get_close_matches(word, known, n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def add_command(
    commands: Commands,
    run: Callable[[argparse.Namespace], int],
    text: str | None,
    *,
    unasked: bool = True,
    where: str = "",
) -> Parser:
    """Register a command, named like its module, and its option --out.

    text: the docstring of the module, which says what the command does and writes, and how long it takes; indented
    lines at its end are examples; None as python -OO leaves it.  unasked: whether files are written without --out.
    where: what --out is, None by default, if it is another folder.
    """
    description, _, examples = (text or "").strip().partition("\n\n  ")
    does = description.partition("\n")[0].partition(";")[0].partition(":")[0].rstrip(".")
    parser = commands.add_parser(
        run.__module__.rpartition(".")[2].replace("_", "-"), help=does[:1].lower() + does[1:], description=description,
        epilog=f"examples:\n  {examples}", formatter_class=Help,
    )  # fmt: skip
    usual = "output folder (default: the current one)" if unasked else "output folder; without it nothing is written"
    parser.add_argument(
        "--out", type=Path, default=Path() if unasked and not where else None, metavar="DIR", help=where or usual
    )
    parser.set_defaults(run=run, command=parser)
    return parser


def add_quiet(parser: Parser) -> None:
    """Add --quiet."""
    parser.option("--quiet", "print results and errors alone: no progress bars, and not how long it takes", False)


def announce(args: argparse.Namespace, takes: str) -> None:
    """Print how long work takes, once the arguments have been checked, unless --quiet is given."""
    if not args.quiet:
        print(textwrap.fill(f"takes {takes}", LINE), flush=True)


def add_robot(parser: Parser, but: str = "") -> None:
    """Add the arguments that say which robot to load; but: robots for which the default gearbox differs."""
    parser.add_argument("robot", metavar="ROBOT", help="name of a robot of the package, or a .urdf or .xml file")
    parser.option("--locked", "set of joints to lock, named in the robot's TOML file", metavar="SET")
    add_setup(parser, (*GEARBOX_KINDS, "none"), gearbox=OWN_GEARBOX + but)


def add_setup(
    parser: Parser, kinds: Sequence[str] = GEARBOX_KINDS, servo: str = OWN_SERVO, gearbox: str = OWN_GEARBOX
) -> None:
    """Add base, contacts, servo and, where kinds of gearboxes are given, gearbox of a robot.

    servo, gearbox: what the defaults are.
    """
    bases = "whether the base moves (default: as in the file; floating to walk)"
    parser.option("--base", bases, choices=("fixed", "floating"))
    contacts = "collision shapes that can touch the ground: feet, all, or names of links with commas (default: the "
    contacts += "points in the robot's files, else the feet of a floating robot)"
    parser.option("--contacts", contacts, type=_contacts, metavar="WHAT")
    servos = "servo of all joints that turn: a name that `featherstone-gait servos` lists, a .toml file, or generic, "
    servos += "an AX-12 scaled to the robot's weight and twice as strong (generic:4: four times)"
    parser.option("--servo", f"{servos} (default: {servo})", metavar="NAME")
    models = "gearbox model: motor inertia plus spring-damper (mipsd), rigid with the rotor's inertia (rotor), or "
    models += f"rigid without (standard) (default: {gearbox})"
    if kinds:
        parser.option("--gearbox", models, choices=kinds)


def _contacts(text: str) -> str | list[str]:
    return text if text in ("feet", "all") else text.split(",")


class Setup(NamedTuple):
    """A robot as the command line sets it up."""

    model: Model
    contacts: str | list[str] | None  # that were taken from its shapes
    said: list[str]  # what was taken, and what was not


@contextmanager
def telling_extras() -> Iterator[None]:
    """Turn a missing package into an error of the call, like a wrong argument."""
    try:
        yield
    except ImportError as error:
        raise ValueError(str(error)) from error


@telling_extras()
def robot_of(args: argparse.Namespace, robot: str) -> Setup:
    """Load a robot with the options of `add_setup`; one that floats without contact points gets those of its feet."""
    from ..robot_file import load_robot

    model, contacts, said = load_robot(robot, args.base, args.locked, contacts=args.contacts), args.contacts, []
    if model.base == "floating" and not model.contacts and model.shapes:
        from ..geometry.contact_choice import with_contacts

        try:
            model, contacts = with_contacts(model, "feet"), "feet"
            said = [f"contacts    {len(model.contacts)} points of its feet, from its collision shapes"]
        except (ValueError, ImportError) as error:
            said = [f"contacts    none: {args.command.in_options(str(error))}"]
    if args.servo is not None:
        from ..walking.walker import driven

        model = driven(model, args.servo)
    if args.gearbox not in (None, "none") and not any(name in model.servos for name in model.joint_names):
        file = Path(model.source).with_suffix(".toml").name
        raise ValueError(
            f"{model.name} has no servos; name one (--servo), or several under [servos] in {file} beside it, or omit "
            "--gearbox"
        )
    return Setup(model, contacts, said)


def gearbox_of(args: argparse.Namespace, default: GearboxKind | None) -> GearboxKind | None:
    """Return the value of --gearbox; default: what is meant without it."""
    return default if args.gearbox is None else None if args.gearbox == "none" else args.gearbox


def gearbox_line(kind: GearboxKind) -> str:
    """Say which gearbox model was chosen, and why."""
    return f"gearbox     {why_chosen(kind)}"


def output(args: argparse.Namespace, ending: str) -> Path:
    """Return the path of a file of a command about a robot."""
    return args.out / f"{Path(args.robot).stem}_{ending}"


def ground(model: Model) -> Ground | None:
    """Return flat ground for a robot that can stand on it."""
    from ..model import Ground

    return Ground() if model.base == "floating" and model.contacts else None


def choice(scene: CompiledScene) -> str:
    """Describe integrator and step, and why they were chosen."""
    steps = "steps by their error" if scene.adaptive else f"step {1e3 * scene.timestep:g} ms"
    return f"{scene.integrator}, {steps} ({scene.preflight.reason})"


def add_gait(parser: Parser, kinds: Sequence[str] = GEARBOX_KINDS) -> None:
    """Add the arguments that say which gait, of which robot; kinds: as in `add_setup`."""
    parser.add_argument("gait", type=Path, metavar="GAIT", help="ROBOT_gait.npz, or joint angles as .csv")
    parser.option("--first", "take the gait that the search started from, instead of the one it found", False)
    parser.option("--robot", "name or robot file (default: humanoid)", "humanoid")
    what = "set of joints to lock, named in the robot's TOML file, or none (default of the humanoid: simplified)"
    parser.option("--locked", what, metavar="SET")
    add_setup(parser, kinds, servo=f"the one that the .npz names, else {OWN_SERVO}")


@telling_extras()
def robot_of_gait(args: argparse.Namespace) -> Model:
    """Load the robot that `add_gait` asks for, with its own servos."""
    from ..robot_file import robot_names
    from ..walking.motion import read_motion
    from ..walking.walker import load_walker

    how: dict[str, Any] = {"base": args.base, "contacts": args.contacts}
    if args.locked is not None:
        how["locked"] = {} if args.locked == "none" else args.locked
    elif args.robot not in robot_names():
        how["joints"] = read_motion(args.gait, first=args.first).joint_names
    return load_walker(args.robot, **how)


def servo_of_gait(args: argparse.Namespace) -> str | None:
    """Return the servo of `--servo`, else that of the gait's file; None for the robot's own."""
    from ..robot_file import load_servo
    from ..walking.motion import servo_of
    from ..walking.walker import GENERIC

    if args.servo is not None:
        return str(args.servo)
    servo = servo_of(args.gait)
    if servo is not None and not servo.startswith(GENERIC):
        try:
            load_servo(servo)
        except (ValueError, OSError) as error:
            problem = f"{args.gait} was found with a servo that is not there ({error}); name it (--servo)"
            raise ValueError(problem) from None
    return servo


def gait_stem(args: argparse.Namespace) -> str:
    """Return the beginning of file names of a command about a gait."""
    return args.gait.stem.removesuffix("_angles") + ("_first" if args.first else "")


def add_policy(parser: Parser, of: str = "") -> None:
    """Add the options of a policy: its description, what it is commanded and for how long; `of` begins their help."""
    described = "what the policy observes and drives: a TOML file or a name that the package knows (default: by the "
    parser.option("--description", f"{of}{described}metadata of the ONNX file)", metavar="WHAT")
    asked = f"{of}velocities ahead, to the left [m/s] and about the vertical [rad/s] (default: 0.1,0,0)"
    parser.option("--command", asked, "0.1,0,0", dest="velocities", metavar="VX,VY,WZ")
    parser.option("--seconds", f"{of}how long it walks [s]", 10.0, metavar="S")


def velocities(text: str) -> list[float]:
    """Return the three velocities of `--command`; raise ValueError for others."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != 3:
        raise ValueError(f"--command is {text!r}; expected three numbers with commas: give 0.1,0,0")
    return found
