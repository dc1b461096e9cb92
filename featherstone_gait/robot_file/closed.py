"""Find what says that a URDF, which states trees alone, is of a robot with closed loops.

A YAML file beside it lists pairs of frames under `closed_loop`, or links and joints have names such as closed_loop_1_A.
Frames are links, or the links at the ends of fixed joints.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from ..base.flaws import quoted
from .robot import Robot

LISTED = re.compile(r"^closed_loops?\s*:(.*?)(?=^\w|\Z)", re.MULTILINE | re.DOTALL)
FRAME = re.compile(r"[A-Za-z_][\w./-]*")
NAMED = re.compile(r"closed_?loop|loop_?clos|fermeture|^closing_", re.IGNORECASE)
REMEDY = "state each in the TOML file beside it: [[loops]] with name, kind, a and b"
MOST_FILES, MOST_BYTES = 50, 100_000


def open_loops(path: Path, robot: Robot) -> Iterator[str]:
    """Yield which loops of a robot its file leaves open."""
    ends = {link.name: link.name for link in robot.links} | {joint.name: joint.child for joint in robot.joints}
    listed = [pair for file in _beside(path) for pair in _pairs(file) if any(end in ends for end in pair)]
    if listed:
        pairs = "; ".join(f"{ends.get(a, a)!r} and {ends.get(b, b)!r}" for a, b in dict.fromkeys(listed))
        yield f"left open the loops that a YAML file beside it closes between links {pairs}: {REMEDY}"
    elif named := list(dict.fromkeys(link for name, link in ends.items() if NAMED.search(name))):
        yield f"left open the loops at whose ends links {quoted(named)} are, by their names: {REMEDY}"


def _beside(path: Path) -> list[Path]:
    return sorted(file for file in path.parent.iterdir() if file.suffix in (".yaml", ".yml"))[:MOST_FILES]


def _pairs(file: Path) -> list[tuple[str, str]]:
    """Return the pairs of names that a YAML file lists, in any of its styles."""
    try:
        with file.open(encoding="utf-8", errors="replace") as stream:
            text = stream.read(MOST_BYTES)
    except OSError:
        return []
    found = LISTED.search(re.sub("#.*", "", text))
    names = FRAME.findall(found[1]) if found else []
    return [*zip(names[::2], names[1::2])]
