"""Preparation of a gait search: the robot, the output folder, and checks of what can fail before the search."""

from __future__ import annotations

import math
import tempfile
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from ..base.arguments import real, whole
from ..base.files import FilePath, claim, parse_json
from ..base.line_file import REMEDY as HISTORY_REMEDY
from ..crosscheck.in_mujoco import mujoco_version
from ..model import Model
from ..scene.actuator import build_drive, servo_gearbox
from ..scene.gearbox_kinds import why_chosen
from ..walking.cost_in_worlds import MOST_WORLDS
from ..walking.walker import GENERIC, driven, load_walker
from .options import OptimizeOptions
from .stored import SERVOS

MOST_ITERATIONS = 10**7
WALK = {"step_length", "step_time", "com_height", "half_width", "lift", "double_support"}  # of `WalkSettings`
# Seconds of two cores of an AMD EPYC, compiled before (docs/optimize.md, docs/walking.md, docs/feedback.md):
SECONDS = {
    "first gait": 2.5, "candidate in a world": 0.0045, "selection": 3.5, "test world": 0.026, "files": 2.0,
    "crosscheck": 48.0, "plans": 13.0, "feedback": 0.2,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Job:
    """A gait search that was asked for."""

    options: OptimizeOptions
    robot: FilePath
    own: Model  # the robot with its own servos
    model: Model  # the same with the servos of the options
    stem: Path  # of the output files, without their endings

    @property
    def history(self) -> Path:
        """The file of the search's history."""
        return self.stem.with_name(self.stem.name + "_history.jsonl")

    @property
    def crosscheck(self) -> Path:
        """The crosscheck's files, without their endings."""
        return self.stem.with_name(self.stem.name + "_crosscheck")

    @property
    def seconds(self) -> dict[str, float]:
        """Estimate how long each stage takes on two cores, without compiling; of another robot the shares [s]."""
        options, one = self.options, SECONDS["candidate in a world"]
        stored = self.robot == "humanoid" and options.servo in SERVOS and options.states != "stride"
        compared = options.baselines and options.worlds > 0
        plans = SECONDS["plans"] * ((options.plan == "cheapest") + compared) * (not stored)
        worlds = SECONDS["test world"] * options.test_worlds * (1.0 if stored else 2.5)
        return {
            "first gait": SECONDS["first gait"],
            "search": one * options.iterations * max(options.worlds, 1),
            "selection": SECONDS["selection"] * (options.worlds > 0 and options.limits)
            + SECONDS["feedback"] * (options.iterations // 2) * options.feedback,
            "measurement": worlds + SECONDS["crosscheck"] * (options.crosscheck > 0) + plans,
            "files": SECONDS["files"],
        }

    @property
    def timed(self) -> bool:
        """True if `SECONDS` are of this robot with these servos; others take up to twice as long."""
        return self.robot == "humanoid" and self.model.servos == self.own.servos

    def print(self, text: str) -> None:
        """Print a message, if progress is shown."""
        if self.options.progress:
            tqdm.write(folded(text))  # above a bar


def prepare(robot: FilePath, options: OptimizeOptions) -> Job:
    """Load the robot and check all that can be checked before the search; print how long it takes."""
    own = load_walker(robot, legs_only=options.legs_only, base=options.base, contacts=options.contacts)
    model = own if options.servo is None else driven(own, options.servo)
    if not model.servos:
        raise ValueError(f"{own.name} has no servos; name one (--servo): {GENERIC!r} is an AX-12 scaled to the robot")
    gearbox = servo_gearbox(model, options.gearbox)
    build_drive(model, gearbox)  # raises what the servos do not have
    job = Job(options, robot, own, model, Path(options.out) / f"{Path(robot).stem}_gait")
    whole("worlds", options.worlds, 0, "0 is the robot's own ground alone", MOST_WORLDS)
    whole("test_worlds", options.test_worlds, 0, "0 tests in none", MOST_WORLDS)
    whole("iterations", options.iterations, 1, "it is the number of candidates", MOST_ITERATIONS)
    if unknown := sorted({*(options.walk or {})} - WALK):
        raise ValueError(f"walk: {unknown[0]!r} is no setting that a plan can keep; they are {', '.join(sorted(WALK))}")
    if options.feedback and not options.worlds:
        raise ValueError(
            "feedback is searched in worlds, and worlds is 0; leave out feedback, or --one-world and --worlds 0"
        )
    if options.crosscheck:
        mujoco_version()
    for name in ("electronics_power", "holding_power"):
        if (power := getattr(options, name)) is not None:
            real(name, power, 0.0, 1e6, "it is a power [W]")
    folder = job.stem.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"0")
    except OSError as error:
        why = f"{folder}: no file can be written here ({error.strerror}); give another folder (--out)"
        raise OSError(why) from error
    if options.resume and not job.history.exists():
        raise FileNotFoundError(
            f"{job.history}: there is no such file, so no search to resume; leave out --resume, or give the folder of "
            "the search (--out)"
        )
    if job.history.exists():
        if not options.resume:
            raise FileExistsError(
                f"{job.history} exists; resume (--resume) to continue it, or give another folder (--out)"
            )
        with claimed(job.history):  # another process at work there is reported before the first gait is planned
            pass
    if options.gearbox is None:
        job.print(f"gearbox: {why_chosen(gearbox)}")
    if job.timed:
        duration = estimate_in_words(sum(job.seconds.values()))
    else:
        duration = "how long is estimated from the first gait"
    job.print(f"duration: {duration}; half a minute more where kernels must be compiled")
    return job


def estimate_in_words(seconds: float) -> str:
    """Describe an estimated duration on two cores: "about 50 s on two cores"; seconds: [s]."""
    about = f"{10.0 * math.ceil(0.1 * seconds):.0f} s" if seconds <= 90.0 else f"{seconds / 60.0:.0f} min"
    return f"about {about} on two cores"


def check_history(path: Path, first: float) -> None:
    """Raise ValueError if the first gait of a history had another cost [J/m]; the search compares the rest."""
    lines = path.read_bytes().split(b"\n")[:-1] if path.exists() else []
    if len(lines) < 2:
        return
    cost = parse_json(lines[1], f"{path}, line 2", HISTORY_REMEDY).get("f")
    if (math.inf if cost is None else cost) != first:
        raise ValueError(
            f"{path}, line 2: the first gait cost {cost} J/m, but costs {first} now; the history is of another robot, "
            "other servos or another version: give another folder, or delete it"
        )


@contextmanager
def claimed(history: Path) -> Iterator[None]:
    """Keep other processes from a history and the files beside it; raise OSError if one is at work there."""
    with history.open("r+b") as file:
        claim(file, history)
        yield


def beside(history: Path, search: str) -> Path:
    """Return the file of another search's history ("limits", "feedback") beside that of the gait's search."""
    return history.with_name(history.name.replace("_history", f"_{search}_history"))


def folded(text: str) -> str:
    """Fold lines that are too long for a terminal; continued lines are indented."""
    lines = (textwrap.wrap(line, 79, subsequent_indent="    ", break_long_words=False) for line in text.split("\n"))
    return "\n".join(part for line in lines for part in line)
