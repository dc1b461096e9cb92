"""Read which links of a robot do not touch each other from SRDF (http://wiki.ros.org/srdf), which MoveIt writes.

``<disable_collisions link1 link2>`` names two links, ``<disable_default_collisions link>`` one and all others, except
those of an ``<enable_collisions link1 link2>``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from ..base.flaws import quoted
from .markup import read_markup, unread
from .report import Report, RobotFileNotFoundError, blamed_on


def find_srdf(path: Path) -> Path | None:
    """Return the SRDF of a URDF's name: beside it, or in a folder srdf beside its own; None if there is none."""
    places = (path.with_suffix(".srdf"), path.parent.parent / "srdf" / f"{path.stem}.srdf")
    return next((place for place in places if place.is_file()), None)


def read_excluded(path: Path, given: Path | None, links: Iterable[str], report: Report) -> tuple[tuple[str, str], ...]:
    """Return the pairs of links that the SRDF of a URDF keeps from touching.

    given: path of the SRDF; None for the one beside the URDF, which is left out with a warning if it cannot be read.
    Raises RobotFileError for one that is given and wrong, RobotFileNotFoundError for one that is not there.
    """
    srdf = find_srdf(path) if given is None else given
    if srdf is None:
        return ()
    if not srdf.is_file():
        raise RobotFileNotFoundError(f"{srdf}: there is no such SRDF file; correct the path given as srdf=")
    try:
        with blamed_on(srdf):
            pairs, unknown, skipped = _read(srdf, dict.fromkeys(links))
    except ValueError as error:
        if given is not None:
            raise
        report.doubt(f"ignored the SRDF beside it: {error}")
        return ()
    if unknown:
        report.remark(f"{srdf.name}: skipped collisions of links that are not there: {quoted(unknown)}")
    if skipped:
        report.remark(f"{srdf.name}: skipped {', '.join(skipped)}, which say nothing of what touches")
    return pairs


def _read(path: Path, links: Iterable[str]) -> tuple[tuple[tuple[str, str], ...], list[str], list[str]]:
    """Return the pairs, the links that the robot does not have, and the elements that are not read."""
    root = read_markup(path).root
    if root.tag != "robot":
        raise ValueError(f"root element is <{root.tag}>; expected <robot> of an SRDF: give another file")
    order = {name: k for k, name in enumerate(links)}
    named = [*_pairs(root, "disable_collisions")]
    enabled = {frozenset(pair) for pair in _pairs(root, "enable_collisions")}
    for element in root.iterfind("disable_default_collisions"):
        link = _attribute(element, "link")
        named += [(link, other) for other in order if other != link and frozenset((link, other)) not in enabled]
    unknown = [name for name in dict.fromkeys(name for pair in named for name in pair) if name not in order]
    known = (pair for pair in named if pair[0] in order and pair[1] in order and pair[0] != pair[1])
    ordered = ((a, b) if order[a] < order[b] else (b, a) for a, b in known)
    skipped = [f"<{child.tag}>" for _, _, child in unread(root) if child is not None]
    return tuple(dict.fromkeys(ordered)), unknown, [*dict.fromkeys(skipped)]


def _pairs(root: Element, tag: str) -> Iterator[tuple[str, str]]:
    for element in root.iterfind(tag):
        yield _attribute(element, "link1"), _attribute(element, "link2")


def _attribute(element: Element, name: str) -> str:
    value = element.get(name)
    if not value:
        raise ValueError(f"<{element.tag}> has no attribute {name!r}; it names a link: add it")
    return value
