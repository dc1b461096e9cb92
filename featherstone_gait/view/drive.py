"""Drive a robot by hand: keys of a page command it, a pointer pulls at its links, and all inputs are recorded.

A server of the standard library sends poses to the page as events (WHATWG HTML, server-sent events) and takes held keys
and the pointer by POST, under a path that nobody else knows.  What is held is released when the page says so, closes,
or is not heard of for `SILENCE`.
"""

from __future__ import annotations

import json
import math
import re
import secrets
import signal
import threading
import time
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np

from ..base import arguments
from ..base.arguments import instance, real, shown, texts, whole
from ..base.files import FilePath
from ..model.placed import link_name
from ..run.driven import DriveAction, Driven, names_of
from ..run.measure import What
from ..run.program import CompiledController
from ..run.range_sensor import link_poses
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from .page import render
from .recorded import TURN, page_data, quaternions
from .shown import one_or_many, title_of

RATE = 30.0  # of pictures [1/s]
SILENCE = 0.5  # [s] after which a page that holds something counts as closed
REACH = 0.5  # of the robot's size, by which a pointer must be off for the largest force
SOFT = 0.1  # largest stiffness by mass of a link over the square of a tick: a force held for a tick stays stable
DAMPING = 2.0  # ticks: damping by stiffness, beyond the half that a held force feeds
GRAVITY = 9.81  # [m/s^2]
TRIES = 100  # ports
MOST_BYTES = 10_000  # of a message
PARTS = ("points", "feet", "forces", "pairs", "rays", "energy", "load")  # of a run in a page, which are not sent

Command = Callable[[frozenset[str], dict[str, Any]], Any]


def drive(
    scene: CompiledScene,
    keys: Mapping[str, Mapping[str, float]] | Iterable[str] = (),
    *,
    command: Command | None = None,
    action: DriveAction | None = None,
    controller: CompiledController | None = None,
    record: Iterable[What] = (),
    state: Any = None,
    duration: float | None = None,
    push_limit: float | None = None,
    path: FilePath | None = None,
    port: int = 8080,
    open: bool = False,
) -> Trajectory:
    """Drive a robot in real time from a page that is served on this machine, until Ctrl-C, and store the run.

    Keys that are held command it, and a pointer pulls at its links.  Real time that is lost is not caught up; the page
    and the run's info say how much it was.

    Parameters
    ----------
    scene : CompiledScene
        The robot, or a scene of several.
    keys : dict of dict
        What each key adds while it is held, by the name of a joint, of a driven tendon or of a drive of surfaces, such
        as ``{"ArrowUp": {"left_wheel": 6.0, "right_wheel": 6.0}}``.  Keys have their names in browsers; of letters the
        case does not count.  With `command` a list of keys.
    command : callable, optional
        Called at each tick with the keys that are held, a frozenset, and q, qd, base_q and base_qd of (1, ...) by name;
        returns the action of the tick (joints,) in place of a sum over `keys`.
    action : {"speed", "reference", "voltage", "pwm", "torque"}, optional
        What is commanded: speeds, which servos of any law follow [rad/s or m/s]; or as in `Session`.  By default
        speeds where there are servos and no controller.
    controller : CompiledController, optional
        As in `Session`; its references are what is commanded.
    record : list of str
        More channels and sensors to record, beside positions and inputs.
    state : ndarray or Trajectory, optional
        Where to begin; None: `initial_state`.
    duration : float, optional
        Time after which to end [s]; None: at Ctrl-C, at the button of the page, or when the robot fails.
    push_limit : float, optional
        Largest force of the pointer [N]; None: the weight of the robot; 0: nobody pulls.
    path : path, optional
        File of the run, with or without .npz; None: ROBOT_drive.npz in the current folder.
    port : int
        Port of this machine, or the first free one after it; 0: any.
    open : bool
        Open the page in a browser.

    Returns
    -------
    Trajectory
        The run, also in the file, with its inputs; `replay` repeats it.

    Raises
    ------
    ValueError
        Keys, action, state and scene do not fit each other.
    OSError
        There is no free port, or `path` cannot be written, which is seen before the robot is driven.
    """
    instance("scene", scene, CompiledScene, "give what compile_scene returns")
    mass = sum(model.mass for model in _models(scene))
    limit = GRAVITY * mass if push_limit is None else push_limit
    limit = real("push_limit", limit, 0.0, 1e9, "the largest force [N]; 0: none")
    duration = math.inf if duration is None else real("duration", duration, 0.0, 1e9, "[s]")
    port = whole("port", port, 0, "0 is any that is free", 65535)
    name = re.sub(r"[^\w.-]+", "_", scene.model.name)
    path = Path(f"{name}_drive") if path is None else arguments.path("path", path)
    _check_place(path)
    table = _keys(names_of(scene), keys, command)
    driven = Driven(scene, action, controller, record, state, pushable=limit > 0.0, pace=True)
    driven.warm_up()
    chosen = command or _adding(driven, table)
    with driven.session:
        page = _Page(driven, [*table], limit)
        try:
            with page.served(port) as url, _interrupts(page):
                span = "" if math.isinf(duration) else f"for {duration:g} s or "
                print(f"page        {url} {span}until Ctrl-C", flush=True)
                if open:
                    webbrowser.open(url)
                page.run(chosen, duration)
        finally:  # what has been driven is stored, also where `command` raises an exception
            run = driven.trajectory()
            run.info["lost_time"] = page.lost
            run.save(path)
    late = f"; {page.lost:.2g} s of real time were lost" if page.lost > 0.0 else ""
    print(f"file        {path}.npz, {run.end_time:.4g} s: {run.status}{late}", flush=True)
    return run


def _models(scene: CompiledScene) -> list[Any]:
    return [member.model for member in scene.members] or [scene.model]


def _check_place(path: Path) -> None:
    """Raise OSError unless a file can be written there, before a run is driven that would be lost."""
    if not path.parent.is_dir():
        raise FileNotFoundError(f"path is {path}: there is no folder {path.parent}; make it, or give another path")
    try:
        with TemporaryFile(dir=path.parent):
            return
    except OSError as error:
        why = f"path is {path}: its folder cannot be written ({error.strerror}); give another path"
        raise type(error)(why) from error


def _adding(driven: Driven, table: Mapping[str, np.ndarray]) -> Command:
    return lambda held, seen: sum((table[key] for key in sorted(held)), driven.at_rest)


def _keys(names: Sequence[str], keys: Any, command: Command | None) -> dict[str, np.ndarray]:
    """Return what each key adds to the numbers of a command; zero where a function makes it."""
    if command is not None:
        if not callable(command):
            raise ValueError(f"command is {shown(command)}; give a function of the held keys and what is seen")
        return {_named(key): np.zeros(len(names)) for key in texts("keys", list(keys), "give a list of keys")}
    if not keys:
        keys = {}
    instance("keys", keys, Mapping, "give what each key commands, such as {'ArrowUp': {'wheel': 6.0}}")
    table = {}
    for key, adds in keys.items():
        instance("keys: key", key, str, "give the name of a key")
        instance(f"keys: {key}", adds, Mapping, "give numbers by name of a joint or drive")
        row = table[_named(key)] = np.zeros(len(names))
        for name, number in adds.items():
            if name not in names:
                known = ", ".join(names) or "none"
                raise ValueError(f"keys: {key}: there is no {shown(name)} to command; there are {known}")
            row[names.index(name)] = real(f"keys: {key}: {name}", number, -1e50, 1e50, "a number")
    return table


def _named(key: str) -> str:
    return key.lower() if len(key) == 1 else key


@contextmanager
def _interrupts(page: _Page) -> Iterator[None]:
    """Let Ctrl-C end the run after its tick; a second one raises KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> None:
        page.ended.set()
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class _Page:
    """The page of a driven robot: what it shows, and what it holds."""

    def __init__(self, driven: Driven, keys: Sequence[str], limit: float) -> None:
        self.driven, self.keys, self.limit = driven, frozenset(keys), limit
        self.scene = scene = driven.session.scene
        self.ended, self._news = threading.Event(), threading.Condition()
        self._frame, self._closed, self.lost = "", False, 0.0
        self._held, self._heard, self._number = frozenset[str](), -math.inf, -1
        self._grab: tuple[int, np.ndarray, np.ndarray] | None = None  # a link, where on it, and the pointer [m]
        self._before: np.ndarray | None = None  # where the grabbed point was a tick ago [m]
        run = driven.trajectory()
        together, (seen, *_) = one_or_many([run], scene, (), (), False)
        data = page_data(seen, together=together)
        names = link_poses(scene, driven.seen)[0]
        self._rows: list[list[int] | None] = []  # of the bodies of each run; None of what never moves
        moving = {member.name for member in scene.members}
        for caption, one in zip(seen, data["runs"]):
            links = data["models"][one["model"]]["links"]
            own = [link_name(caption, link) if together else link for link in links]
            known = not together or caption in moving
            self._rows.append([names.index(link) for link in own] if known else None)
            one |= dict.fromkeys(PARTS) | {"prints": [], "channels": {}}
        self._names, self._unit = names, data["unit"]
        self.size = float(data["span"]) / 1.5
        data["live"] = {"keys": list(keys), "limit": limit}
        script = Path(__file__).with_suffix(".js").read_text("utf-8")
        self.html = render(f"{title_of(scene)}: drive", data, script).encode()
        self._stiffness = limit / (REACH * self.size)

    # ------------------------------------------------------------------------------------------------ the run

    def run(self, command: Command, duration: float) -> None:
        """Step until the end, in real time; add what is lost of it to `lost` [s]."""
        session, shown_at = self.driven.session, -math.inf
        self._show(None)
        while not self.ended.is_set() and session.time[0] < duration - 1e-9 and session.active[0]:
            with self._news:
                if time.monotonic() - self._heard > SILENCE:
                    self._held, self._grab = frozenset(), None
                held, grab = self._held, self._grab
            push = self._pull(grab)
            self.driven.step(np.asarray(command(held, self.driven.seen), float), push)
            self.lost += session.lag
            now = time.monotonic()
            if now - shown_at > 1.0 / RATE:
                self._show(push)
                shown_at = now
        self._show(None, "ended" if session.active[0] else f"ended: {session.status[0]}")

    def _pull(self, grab: Any) -> np.ndarray | None:
        """Return the push of a spring from a grabbed point to the pointer, held for a tick."""
        if grab is None:
            self._before = None
            return None
        row, point, target = grab
        _, rotation, position = link_poses(self.scene, self.driven.seen)
        at = position[0, row] + rotation[0, row] @ point
        moved = np.zeros(3) if self._before is None else at - self._before
        self._before = at
        mass = max(self._mass(row), 1e-9)
        stiffness = min(self._stiffness, SOFT * mass / self.driven.session.tick**2)
        force = stiffness * (target - at - DAMPING * moved)
        size = float(np.sqrt(force @ force))
        force *= min(1.0, self.limit / max(size, 1e-300))
        return np.r_[self.driven.links.index(self._names[row]), point, force]

    def _mass(self, row: int) -> float:
        """Return the mass of a link [kg]; of one without mass, that of the lightest that has some."""
        masses = {}
        for member in self.scene.members or [None]:
            model = self.scene.model if member is None else member.model
            for link in model.links:
                masses[link.name if member is None else link_name(member.name, link.name)] = link.mass
        own = masses.get(self._names[row], 0.0)
        return own if own > 0.0 else min((mass for mass in masses.values() if mass > 0.0), default=0.0)

    def _show(self, push: np.ndarray | None, ended: str = "") -> None:
        """Publish the present poses and the force."""
        _, rotation, position = link_poses(self.scene, self.driven.seen)
        turns = np.round(quaternions(rotation) / TURN)
        numbers = np.concatenate([np.round(position / self._unit), turns], axis=2)[0]
        known = np.isfinite(numbers).all()
        moving = [rows if known else None for rows in self._rows]
        frames = [None if rows is None else numbers[rows].astype(int).ravel().tolist() for rows in moving]
        frame: dict[str, Any] = {"t": round(float(self.driven.session.time[0]), 4), "lost": round(self.lost, 3)}
        frame |= {"frames": frames, "ended": ended, "force": None}
        if push is not None and push[4:].any():
            row = self._names.index(self.driven.links[int(push[0])])
            at = position[0, row] + rotation[0, row] @ push[1:4]
            frame["force"] = [float(f"{x:.5g}") for x in (*at, *push[4:])]
        with self._news:
            self._frame = json.dumps(frame, separators=(",", ":"))
            self._news.notify_all()

    # ------------------------------------------------------------------------------------------------ the server

    def take(self, message: dict[str, Any]) -> None:
        """Take what the page says that it holds; ValueError for what is none of its messages."""
        number, held, grab = message["n"], frozenset(message["keys"]), message["grab"]
        if not held <= self.keys:
            raise ValueError(f"keys are {shown(sorted(map(str, held)))}; known are {sorted(self.keys)}")
        found = None
        if grab is not None and self.limit > 0.0:
            rows, place = self._rows[int(grab["run"])], int(grab["body"])
            both = np.array([grab["point"], grab["target"]], float)
            if rows is None or both.shape != (2, 3) or not (np.abs(both) < 1e6).all():
                raise ValueError("grab: give a body that moves, and two places")
            found = (rows[place], *both)
        with self._news:
            if number > self._number:
                self._number, self._held, self._heard = number, held, time.monotonic()
                if found is None or self._grab is None or found[0] != self._grab[0]:
                    self._before = None
                self._grab = found
        if message.get("end"):
            self.ended.set()

    def frames(self) -> Iterator[str]:
        """Yield frames as they are published."""
        seen = ""
        while True:
            with self._news:
                if self._frame is seen:
                    self._news.wait(1.0)
                fresh, seen = self._frame is not seen, self._frame
            yield seen if fresh else ""
            if self._closed:
                return

    @contextmanager
    def served(self, port: int) -> Iterator[str]:
        """Serve the page; give its address."""
        token = secrets.token_urlsafe(12)
        server = _server(port, self, f"/{token}/")
        threading.Thread(target=server.serve_forever, args=(0.1,), name="drive", daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/{token}/"
            time.sleep(2.0 / RATE)  # the last frame reaches the page
        finally:
            self._closed = True
            server.shutdown()
            server.server_close()


class _Handler(BaseHTTPRequestHandler):
    """Answers to one connection; a subclass has the page, and the path that it is under."""

    protocol_version = "HTTP/1.1"
    page: _Page
    root: str

    def log_message(self, *_: Any) -> None:
        """Say nothing."""

    def do_GET(self) -> None:
        """Send the page or its events."""
        if self.path == self.root:
            self._answer(HTTPStatus.OK, self.page.html, "text/html; charset=utf-8")
        elif self.path == f"{self.root}events":
            self._send_events()
        elif self.path == "/favicon.ico":
            self._answer(HTTPStatus.NO_CONTENT)
        else:
            self._answer(HTTPStatus.NOT_FOUND, b"no such page")

    def do_POST(self) -> None:
        """Take what the page holds."""
        length = int(self.headers.get("Content-Length") or 0)
        if self.path != f"{self.root}input" or not 0 < length <= MOST_BYTES:
            self.close_connection = True  # what it sends is not read
            self._answer(HTTPStatus.NOT_FOUND, b"no such page")
            return
        try:
            self.page.take(json.loads(self.rfile.read(length)))
        except (ValueError, KeyError, TypeError, IndexError) as error:
            self._answer(HTTPStatus.BAD_REQUEST, str(error).encode())
        else:
            self._answer(HTTPStatus.NO_CONTENT)

    def _answer(self, status: HTTPStatus, body: bytes = b"", kind: str = "text/plain") -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _send_events(self) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.close_connection = True
        try:
            for frame in self.page.frames():
                self.wfile.write(f"data: {frame}\n\n".encode() if frame else b":\n\n")
                self.wfile.flush()
        except OSError:  # the page has closed
            return


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = False


def _server(port: int, page: _Page, root: str) -> _Server:
    """Make the server at a port, or at the first free one after it."""
    handler = type("Handler", (_Handler,), {"page": page, "root": root})
    ports = [port] if port == 0 else range(port, min(port + TRIES, 65536))
    for one in ports:
        try:
            return _Server(("127.0.0.1", one), handler)
        except OSError:
            if one == ports[-1]:
                raise
    raise AssertionError
