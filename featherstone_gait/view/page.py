"""Write pages that any browser shows, with nothing from the network: motions of robots, plots, and reports.

`page.html`, `page.css` and `page.js` make every page; what it shows is data in JSON: of runs `recorded.page_data`, of a
report `gait_page.report_data`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from ..base.arguments import instance
from ..base.files import FilePath, complete
from ..model import Ground, Model
from ..run.trajectory import Trajectory
from .recorded import MESHES, Seen, page_data

HEIGHT = 620  # of a page in a notebook [pixel]
MOST_BYTES = 5_000_000  # of a page without its full meshes


class Page:
    """An HTML page, which a notebook shows.

    Attributes
    ----------
    html : str
        The whole page.
    path : Path or None
        The file that it was saved to.
    """

    def __init__(self, html: str, path: Path | None = None) -> None:
        self.html, self.path = html, path

    def __repr__(self) -> str:
        where = "not saved" if self.path is None else str(self.path)
        return f"<page of {len(self.html.encode()) / 1e6:.2g} MB, {where}>"

    def _repr_html_(self) -> str:
        return (
            f'<iframe title="motion" srcdoc="{escape(self.html)}" '
            f'style="width:100%;height:{HEIGHT}px;border:0" allow="fullscreen"></iframe>'
        )

    def save(self, path: FilePath) -> Path:
        """Write the page to a file, whole or not at all, and return its path.  Raises OSError."""
        with complete(path) as temporary:
            temporary.write_text(self.html, encoding="utf-8")
        self.path = Path(path)
        return self.path


def render(title: str, data: Mapping[str, Any], more: str = "") -> str:
    """Make the page of some data, with more script.  Raises ValueError for a page that would be too large."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    files = (Path(__file__).with_name(f"page.{kind}") for kind in ("html", "css", "js"))
    html, style, script = (file.read_text("utf-8") for file in files)
    page = Template(html).substitute(title=escape(title), style=style, script=script + more, data=text)
    size = len(page.encode()) - sum(len(model["full"]["data"]) for model in data.get("models", ()) if model["full"])
    if size > MOST_BYTES:
        raise ValueError(
            f"the page would have {size} bytes beside full meshes; at most {MOST_BYTES}: show fewer runs or robots at "
            "once"
        )
    return page


def page_html(
    runs: Mapping[str, Seen], title: str, plots: Sequence[str] = (), ghosts: bool = False, together: bool = False,
    mesh_limit: float = MESHES,
) -> str:  # fmt: skip
    """Make the page of runs by caption.  Raises ValueError as `recorded.page_data` and `render`."""
    for caption in runs:
        instance("runs: caption", caption, str, "give a text")
    if not runs:
        raise ValueError("runs is empty; give one run at least")
    return render(title, page_data(runs, plots, ghosts, together, mesh_limit))


def write_animation(path: FilePath, model: Model, runs: Mapping[str, Trajectory], title: str = "") -> None:
    """Write the page of some runs of one robot, which are named by their captions.

    The trajectories need the channel q, and base_q of a floating base; what else they have is drawn as well: forces on
    contact points, loads of servos, any channel over time.  A floating robot with contact points is on a level floor.
    Raises ValueError where these are missing, and for a robot that has neither shapes nor inertia.
    """
    ground = Ground() if model.base == "floating" and model.contacts else None
    seen = {caption: Seen(model, run, ground) for caption, run in runs.items()}
    Page(page_html(seen, title or model.name)).save(path)
