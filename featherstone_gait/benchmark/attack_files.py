"""Damaged files of every type that is read: what comes back must be what the file holds, or an error that names it.

    rows = attack_files(1000, seed=1)

Each attack changes a sound file in one to three ways and reads it.  A row is a fault: another exception than
ValueError, TypeError or OSError, one that comes from inside NumPy, Numba or Python, a message that does not name the
file, or a reader that takes too long.
"""

from __future__ import annotations

import contextlib
import io
import logging
import math
import random
import re
import shutil
import tempfile
import traceback
import warnings
import zipfile
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..core.compile.sealed import SealedFiles
from ..identification.fit import Recording, read_recording, write_recording
from ..robot_file import load_robot, load_servo, save_robot
from ..robot_file.source import robots_folder
from ..run.trajectory import Trajectory
from ..search import minimize
from ..study import read_study
from ..study.run import Log
from ..walking import read_angles, write_angles
from . import precision
from .time_limit import TooLong, time_limit

LIMIT = 10.0  # of a reader [s]
PACKAGE = str(Path(__file__).parents[1])
STUDY = """robot = "ax12_arm"
experiment = "hold"
duration = 0.1  # [s]
[scene]
servos = "mipsd"
[sampling]
method = "latin_hypercube"
count = 3
seed = 1
[vary]
servo.Kp = {from = 10.0, to = 100.0, scale = "log"}
posture.tilt = [-0.1, 0.1]
"""
ROW = {"variance_deg2": 0.25, "offset_deg": 1e-3, "chatter_rad_s": None, "energy_J": 3.5, "end_s": 0.1}
TOKEN = re.compile(rb"[A-Za-z_]\w*|[-+]?\d[\d.eE+-]*|[^\w\s]")
NUMBER = re.compile(rb"(?<![\w.])[-+]?\d[\d.eE+-]*")
VALUES = b"1e400 -1e308 1e308 1e200 1e-320 nan -inf 1_0 0x10 0 -1 1e30 1e9 0.5.5 - true null [] {} '' 1,5".split()
VALUES += ["\u0663".encode(), b"9" * 400, b"9" * 5000, b"[" * 3000]
BYTES = (b"\0", b"\xff", b"\xef\xbb\xbf", b'"', b"'", b"<", b"&", b"\r", b"\x1a", b"\xe2\x80\xa8", b",", b"#", b"=")


class Row(NamedTuple):
    """A fault."""

    kind: str  # of the file
    attack: int  # its number; with the seed it comes again
    fault: str
    message: str


class Target(NamedTuple):
    """A sound file, which is damaged, and what reads it."""

    kind: str
    path: Path
    read: Callable[[Path], Any]


def attack_files(count: int, seed: int, kinds: tuple[str, ...] | None = None) -> list[Row]:
    """Read `count` damaged files of each kind (None: all kinds); return the faults."""
    before = logging.root.manager.disable
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logging.disable(logging.WARNING)  # what is said of a last line that was cut off
        try:
            chosen = [target for target in targets(Path(folder)) if kinds is None or target.kind in kinds]
            return [row for target in chosen for row in _attacked(target, count, seed)]
        finally:
            logging.disable(before)


def _attacked(target: Target, count: int, seed: int) -> Iterator[Row]:
    sound = target.path.read_bytes()
    for k in range(count):
        rng, data = random.Random(f"{seed} {target.kind} {k}"), sound
        for _ in range(rng.randint(1, 3)):
            data = damaged(rng, data)
        target.path.write_bytes(data)
        fault = _judged(target)
        if fault:
            yield Row(target.kind, k, *fault)
    target.path.write_bytes(sound)


def _judged(target: Target) -> tuple[str, str] | None:
    """What is wrong with the outcome, and the message; None if nothing is."""
    try:
        with time_limit(LIMIT):
            target.read(target.path)
    except TooLong:
        return "too long", f"more than {LIMIT:g} s"
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{Path(last.filename).name}:{last.lineno}: {error}"[:300]
        if not isinstance(error, ValueError | TypeError | OSError):
            return type(error).__name__, text
        if target.path.stem not in str(error):
            return "not named", text
        opened = isinstance(error, OSError) and error.filename is not None
        return None if opened or last.filename.startswith(PACKAGE) else ("from inside", text)
    return None


# ---------------------------------------------------------------------------------------------- damage


def damaged(rng: random.Random, data: bytes) -> bytes:
    """The content of a file, changed in one way; of an archive also of what is in it."""
    if data[:2] == b"PK" and rng.random() < 0.6:
        with contextlib.suppress(Exception):  # it may be damaged already
            return _repacked(rng, data)
    ways = (_bits, _cut, _moved_lines, _swapped, _value, _value, _inserted, _encoded)
    return rng.choice(ways)(rng, data)


def _repacked(rng: random.Random, data: bytes) -> bytes:
    """An archive that is sound, but for the content of one of its files."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(sorted(files))
    content = files.pop(name)
    if rng.random() < 0.8:
        files[rng.choice([name, "final.npy", "other"])] = damaged(rng, content)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return packed.getvalue()


def _bits(rng: random.Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.randint(1, 8) if data else 0):
        changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _cut(rng: random.Random, data: bytes) -> bytes:
    """A piece left out: the end, the beginning, or in the middle."""
    a, b = sorted(rng.randint(0, len(data)) for _ in range(2))
    return rng.choice((data[:a], data[a:], data[:a] + data[b:], b""))


def _moved_lines(rng: random.Random, data: bytes) -> bytes:
    """A line doubled, deleted or put elsewhere."""
    lines = data.split(b"\n")
    line = lines.pop(rng.randrange(len(lines)))
    for _ in range(rng.randint(0, 2)):
        lines.insert(rng.randint(0, len(lines)), line)
    return b"\n".join(lines)


def _swapped(rng: random.Random, data: bytes) -> bytes:
    """Two words, numbers or signs, each in the other's place."""
    found = list(TOKEN.finditer(data))
    if len(found) < 2:
        return data
    a, b = sorted(rng.sample(found, 2), key=lambda match: match.start())
    return data[: a.start()] + b[0] + data[a.end() : b.start()] + a[0] + data[b.end() :]


def _value(rng: random.Random, data: bytes) -> bytes:
    """A number, or something in its place, that is huge or none."""
    found = list(NUMBER.finditer(data)) or list(TOKEN.finditer(data))
    if not found:
        return data
    place = rng.choice(found)
    return data[: place.start()] + rng.choice(VALUES) + data[place.end() :]


def _inserted(rng: random.Random, data: bytes) -> bytes:
    at = rng.randint(0, len(data))
    return data[:at] + rng.choice(BYTES) * rng.choice((1, 1, 2, 200_000)) + data[at:]


def _encoded(rng: random.Random, data: bytes) -> bytes:
    """The text in an encoding that is not the one it states."""
    text = data.decode("utf-8", "replace")
    at = rng.randint(0, len(text))
    text = text[:at] + rng.choice(("\u00e9", "\U0001f916", "")) + text[at:]
    return text.encode(rng.choice(("utf-16", "utf-16-be", "utf-32", "latin-1", "utf-8-sig", "utf-7")), "replace")


# ---------------------------------------------------------------------------------------------- files


def targets(folder: Path) -> list[Target]:
    """Sound files of every kind, each in a folder of its own."""
    made = {name: folder / name for name in "robot mjcf servo study table log history run cache".split()}
    for place in made.values():
        place.mkdir()
    return [
        *_robots(made["robot"], made["mjcf"], made["servo"]),
        *_studies(made["study"], made["log"], made["history"]),
        *_tables(made["table"]),
        *_runs(made["run"]),
        *_caches(made["cache"]),
    ]


def _robots(robot: Path, mjcf: Path, servo: Path) -> Iterator[Target]:
    for ending in ("urdf", "toml"):
        shutil.copy(robots_folder() / "humanoid" / f"humanoid.{ending}", robot / f"attacked.{ending}")
    urdf = shutil.copy(robots_folder() / "arm7" / "arm7.urdf", robot / "attacked_arm.urdf")
    yield Target("urdf", Path(urdf), load_robot)
    yield Target("robot toml", robot / "attacked.toml", lambda path: load_robot(path.with_suffix(".urdf")))
    shutil.copy(robots_folder() / "servos" / "ax12.toml", servo / "attacked.toml")
    yield Target("servo toml", servo / "attacked.toml", load_servo)
    if find_spec("mujoco"):
        save_robot(load_robot("arm7"), mjcf / "attacked.xml")
        yield Target("mjcf", mjcf / "attacked.xml", load_robot)


def _studies(toml: Path, log: Path, history: Path) -> Iterator[Target]:
    (toml / "attacked.toml").write_text(STUDY, encoding="utf-8")
    study = read_study(toml / "attacked.toml")
    yield Target("study toml", toml / "attacked.toml", read_study)

    def rows(path: Path) -> None:
        with Log(path, study) as found:
            if found.count == len(study):
                list(found.rows())

    with Log(log / "attacked.jsonl", study) as begun:
        begun.append([2, 0, 1], [{"status": "ok", **ROW, "message": ""}] * 3)
    yield Target("study log", log / "attacked.jsonl", rows)

    def resume(path: Path) -> None:
        minimize(_sphere, [1.0, 1.0], amplitude=0.3, max_iterations=8, seed=7, history=path, resume=True)

    resume(history / "attacked.jsonl")
    yield Target("history", history / "attacked.jsonl", resume)


def _sphere(x: np.ndarray) -> float:
    return float((x**2).sum())


def _tables(folder: Path) -> Iterator[Target]:
    time = 0.01 * np.arange(12)
    write_angles(folder / "attacked_angles.csv", time, np.column_stack([time, -time]), ("hip", "knee"))
    yield Target("angles csv", folder / "attacked_angles.csv", read_angles)
    write_recording(folder / "attacked_recording.csv", Recording("attacked", time, time, time, time))
    yield Target("recording csv", folder / "attacked_recording.csv", read_recording)
    row = precision.Row("free arm", "rk4", 1e-3, math.nan, 1e-5, math.nan, 1e-12, 3.4, 3.5, 4000, "ok")
    precision.write(folder / "attacked_precision.csv", [row] * 3, "processor")
    yield Target("benchmark csv", folder / "attacked_precision.csv", precision.read)


def _runs(folder: Path) -> Iterator[Target]:
    q, info = np.ones((3, 2)), {"joints": ["a", "b"]}
    run = Trajectory({"time": np.arange(3.0), "q": q}, "ok", "", 2.0, np.zeros(5), info, {"q": q}, {"q": (0, 2)})
    run.save(folder / "attacked")
    for ending in ("npz", "json"):
        yield Target(f"trajectory {ending}", folder / f"attacked.{ending}", lambda path: repr(Trajectory.load(path)))


def _caches(folder: Path) -> Iterator[Target]:
    SealedFiles(str(folder), "attacked", "stamp").save("key", ["code"])

    def load(_: Path) -> None:
        if SealedFiles(str(folder), "attacked", "stamp").load("key") not in (None, ["code"]):
            raise RuntimeError("damaged code was taken for sound")

    yield Target("cache index", folder / "attacked.nbi", load)
    yield Target("cache data", folder / "attacked.1.nbc", load)
