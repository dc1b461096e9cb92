"""Options of a gait search: of `main_job`, and of the command line, which is made from them.

Nothing heavy is imported, so that `featherstone-gait --help` answers at once.
"""

# ruff: noqa: RUF009  (`_option` is `dataclasses.field` with what the command line needs)
from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..base.brief import brief

if TYPE_CHECKING:
    from ..base.files import FilePath
    from ..geometry.contact_choice import Choice
    from ..model import Base
    from ..scene.gearbox_kinds import GearboxKind
    from ..walking.cheapest_plan import PlanKind, States


def _option(default: Any, help: str, flag: str | None = None, **argument: Any) -> Any:
    """Declare a field of `OptimizeOptions` with its option of the command line; `argument`: of `add_argument`."""
    if isinstance(default, bool):
        argument["action"] = "store_false" if default else "store_true"
    elif isinstance(default, int) and "action" not in argument:
        argument |= {"type": int, "metavar": "N"}
        help += f" (default: {default})"
    return field(default=default, metadata={"flag": flag, "argument": {"help": help, **argument}})


def _numbers(text: str) -> dict[str, float]:
    """Read NAME=NUMBER,...; raise ArgumentTypeError for other text."""
    try:
        return {name.strip(): float(value) for name, _, value in (part.partition("=") for part in text.split(","))}
    except ValueError:
        raise ArgumentTypeError(f"{text!r} is no NAME=NUMBER,..., as in step_length=0.03,com_height=0.24") from None


@dataclass(frozen=True, kw_only=True)
class OptimizeOptions:
    """Options of a gait search.

    Attributes
    ----------
    base : {"fixed", "floating"} or None
        As in `load_robot`; None: floating, for a robot that does not come with the package.
    contacts : str, sequence of str or None
        What touches the ground, as in `load_robot`; None: as the robot's files say, else its feet.
    gearbox : {"mipsd", "rotor", "standard"} or None
        Gearbox model: motor inertia plus spring-damper (MIPSD), rigid with the rotor's inertia, or rigid without.
        None: "mipsd" if all gears are elastic, else "rotor".
    servo : str, path or None
        Servo of all joints that turn: a name or a TOML file, as in `load_servo`, or "generic", an AX-12 scaled to the
        robot.  The first gait is then also measured with the robot's own servos.
    iterations : int
        Number of candidates.  In worlds, the second half is spent on a descent that meets the limits.
    seed : int
        Seed of the search and of its worlds.
    worlds : int
        Number of worlds that each candidate walks in; 0: only the robot's own ground, as in the paper.
    states : {"step", "stride"} or None
        Whether the four poses are those of a step, mirrored for the other leg, or of a stride; None: of a step if the
        legs are mirror images.
    test_worlds : int
        Number of further worlds, never seen by the search, in which the first and the optimized gait are tested.
    limits : bool
        Whether the search, when it runs in worlds, also meets the limits of a real robot.
    electronics_power : float or None
        Power of the electronics of all servos [W]; None: 0.05 A per servo.  Reported apart from the motors' energy.
    holding_power : float or None
        Power of the locked servos while they hold still [W]; None: 0.
    plan : {"plain", "cheapest"} or None
        Plan that the search starts from; None: the plain plan, or the cheapest one if the plain plan fails.
    walk : mapping of str to float or None
        Settings of `walking.WalkSettings` that the plan keeps, such as ``{"com_height": 0.24}`` [SI].
    baselines : bool
        Whether a search in worlds is also compared with the cheapest plan.
    feedback : bool
        Whether half as many candidates again search for feedback gains, with the poses, under pushes.
    legs_only : bool
        Whether all joints but those of the legs are locked.
    resume : bool
        Whether to continue the search whose history is in `out`.
    crosscheck : int
        Number of processes that walk the optimized gait in MuJoCo; 0: no crosscheck.
    out : str or path
        Output folder.
    progress : bool
        Whether to print progress and a summary.
    """

    base: Base | None = None
    contacts: Choice | None = None
    gearbox: GearboxKind | None = None
    servo: FilePath | None = None
    iterations: int = _option(800, "number of candidates")
    seed: int = _option(0, "seed of the search")
    worlds: int = _option(8, "worlds that each candidate walks in, with different floors, servos and link masses")
    states: States | None = _option(
        None, "whether the four poses describe a step, mirrored for the other leg, or a whole stride (default: step if "
        "the robot is symmetric)", choices=("step", "stride"),
    )  # fmt: skip
    test_worlds: int = _option(200, "other worlds in which the first and the optimized gait are tested")
    limits: bool = _option(
        True, "minimize energy alone, without the limits of a real robot (docs/optimize.md)", "--energy-only"
    )
    electronics_power: float | None = _option(
        None, "power [W] of the electronics of all servos, reported apart from the motors' (default: 0.05 A per "
        "servo)", type=float, metavar="W",
    )  # fmt: skip
    holding_power: float | None = _option(
        None, "power [W] of the locked servos while they hold still (default: 0)", type=float, metavar="W",
    )  # fmt: skip
    plan: PlanKind | None = _option(
        None, "plan that the search starts from (docs/walking.md; default: plain, or cheapest if the plain plan falls)",
        choices=("plain", "cheapest"),
    )  # fmt: skip
    walk: Mapping[str, Any] | None = _option(
        None, "settings that the plan keeps, in SI units: step_length, step_time, com_height, half_width, lift, "
        "double_support (docs/walking.md)", type=_numbers, metavar="NAME=NUMBER,...",
    )  # fmt: skip
    baselines: bool = _option(
        True, "do not compare with the cheapest plan; saves 13 s where it is not stored",
        "--no-baselines",
    )  # fmt: skip
    feedback: bool = _option(
        False, "afterwards also search for feedback gains for an IMU, under pushes (docs/feedback.md)"
    )
    legs_only: bool = _option(False, "lock all joints but those of the legs")
    resume: bool = _option(False, "continue the search whose history is in the output folder")
    crosscheck: int = _option(
        0, "also walk the optimized gait in MuJoCo, on twelve floors", action="store_const", const=2
    )
    out: FilePath = "."
    progress: bool = True

    __repr__ = brief
