"""Find robot files and read their bytes."""

from __future__ import annotations

import os
from pathlib import Path

from .report import RobotFileNotFoundError

MAX_BYTES = 10_000_000  # of one file
SUFFIXES = (".urdf", ".xml", ".mjcf")  # of robots


def robot_names() -> tuple[str, ...]:
    """Return the names of the robots that come with the package.

    Returns
    -------
    tuple of str
        Names for `load_robot`, sorted.
    """
    return tuple(sorted(p.stem for p in robots_folder().glob("*/*.urdf") if p.stem == p.parent.name))


def scene_names() -> tuple[str, ...]:
    """Return the names of the scenes that come with the package.

    Returns
    -------
    tuple of str
        Names for `load_scene`, sorted.
    """
    return tuple(sorted(p.parent.name for p in robots_folder().glob("*/*_scene.toml")))


def robots_folder() -> Path:
    """Return the folder of robots: inside the installed package, or beside it in a source tree."""
    installed = Path(__file__).parents[1] / "robots"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "robots"


def robot_path(name_or_path: str | os.PathLike) -> Path:
    """Return the file of a packaged robot, or the path as given; raise RobotFileNotFoundError for other names."""
    text = os.fspath(name_or_path)
    if isinstance(name_or_path, os.PathLike) or text.endswith(SUFFIXES) or Path(text).name != text:
        return Path(text)
    if text not in robot_names():
        raise RobotFileNotFoundError(
            f"{robots_folder()}: there is no robot {text!r}; expected one of {', '.join(robot_names())}: "
            "use one of these, or the path of a .urdf, .mjcf or .xml file"
        )
    return robots_folder() / text / f"{text}.urdf"


def scene_path(name_or_path: str | os.PathLike) -> Path:
    """Return the file of a packaged scene, or the path as given; raise RobotFileNotFoundError for other names."""
    text = os.fspath(name_or_path)
    if isinstance(name_or_path, os.PathLike) or Path(text).suffix or Path(text).name != text:
        return Path(text)
    if text not in scene_names():
        raise RobotFileNotFoundError(
            f"{robots_folder()}: there is no scene {text!r}; expected one of {', '.join(scene_names())}: "
            "use one of these, or the path of an .xml, .mjcf or .toml file"
        )
    return robots_folder() / text / f"{text}_scene.toml"


def read_bytes(path: Path) -> bytes:
    """Read a file; raise ValueError if it is none, is empty or larger than MAX_BYTES."""
    if path.is_dir():
        raise ValueError(f"is a directory; give the {path.suffix or '.urdf'} file in it")
    if not path.exists():
        raise RobotFileNotFoundError(f"{path}: there is no such file; correct the path")
    if not path.is_file():
        raise ValueError("is not a regular file; copy its contents into one")
    with path.open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise ValueError(f"is larger than {MAX_BYTES} bytes; reduce it: a robot's links and joints take far less")
    if not data.strip():
        raise ValueError("is empty; write the robot into it, or remove it")
    return data
