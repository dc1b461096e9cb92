"""Motions as one HTML page that any browser plays, with nothing from the network: runs side by side, in one clock.

`page.html`, `page.css` and `page.js` make the page; its numbers are `recorded.page_data`, as JSON.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from ..base.arguments import instance
from ..base.files import FilePath, complete
from ..model import Ground, Model
from .recorded import Seen, page_data

if TYPE_CHECKING:
    from ..run.trajectory import Trajectory

MOST_BYTES = 5_000_000  # of a page


def write_animation(path: FilePath, model: Model, runs: Mapping[str, Trajectory], title: str = "") -> None:
    """Write the page: one picture for each of `runs`, which are named by their captions.

    The trajectories need the channel q, and base_q of a floating base; what else they have is drawn as well: forces on
    contact points, loads of servos, any channel over time.  A floating robot with contact points is on a level floor.
    Raises ValueError where these are missing, and for a robot that has neither shapes nor inertia.
    """
    ground = Ground() if model.base == "floating" and model.contacts else None
    page = page_html({caption: Seen(model, run, ground) for caption, run in runs.items()}, title or model.name)
    with complete(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def page_html(runs: Mapping[str, Seen], title: str, plots: Sequence[str] = (), ghosts: bool = False) -> str:
    """The page of runs by caption; raises as `recorded.page_data`, and ValueError for one that would be too large."""
    for caption in runs:
        instance("runs: caption", caption, str, "give a text")
    if not runs:
        raise ValueError("runs is empty; give one run at least")
    data = json.dumps(page_data(runs, plots, ghosts), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    parts = {"title": escape(title), "style": _part("css"), "script": _part("js"), "data": data}
    page = _part("html")
    for name, text in parts.items():
        page = page.replace(f"@{name}@", text)
    if len(page.encode()) > MOST_BYTES:
        raise ValueError(
            f"the page would have {len(page.encode())} bytes; at most {MOST_BYTES}: show fewer runs or robots at once"
        )
    return page


def _part(kind: str) -> str:
    return Path(__file__).with_name(f"page.{kind}").read_text("utf-8")
