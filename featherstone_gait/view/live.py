"""Serve runs as a page on this machine through viser, with the full detail of their robots' meshes.

A run is drawn at its own samples, without interpolation.  All browsers that show the page share one clock.
"""

from __future__ import annotations

import math
import threading
import time
import warnings
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from ..base.arguments import real, whole
from ..dynamics import Poses, center_of_mass, contact_positions, forward_kinematics
from ..model import Ground
from ..robot_file.report import RobotFileWarning
from ..run.sensors import in_world
from ..run.trajectory import positions
from ..scene.contact import ground_under, plane_axes
from .live_plots import Chart, Plotted
from .recorded import (
    TOUCH,
    FramePoses,
    Seen,
    channels_of,
    corners_of,
    known_channels,
    margin_of,
    pushes_of,
    quaternions,
    relief,
    sampled,
)
from .visuals import Piece, pieces, round_up

INSTALL = "a live page needs viser: pip install featherstone-gait[viser]"
RATE, PLOT_RATE = 40.0, 10.0  # frames a second at most, of the picture and of the plots
TRIANGLES = 1_000_000  # of the meshes of all runs together
CORNERS = 48  # of a circle
GHOST = 0.35  # opacity of runs that are seen through the first
SPEEDS = ("0.02", "0.05", "0.1", "0.25", "0.5", "1", "2", "5")
VIEWS = {"corner": (-1.1, 0.3), "side": (-0.5 * math.pi, 0.05), "front": (0.0, 0.05), "above": (-0.5 * math.pi, 1.5)}
FIELD_OF_VIEW = 0.7  # upright [rad]
LIGHTEST = 1e-9  # least mass by whose weight arrows of forces are scaled [kg]
FORCE, MASS, FAILURE = (213, 94, 0), (204, 121, 167), (150, 150, 150)
RAY, WATER = (194, 65, 12), (40, 120, 190)
FLOOR, SQUARE, RISE = (238, 236, 229), (214, 211, 200), (186, 178, 160)
BAD = "#a3160f"
MOST_NOTES = 5  # in a warning about what could not be read
HEIGHT = 620  # in a notebook [pixel]
PANEL = 360  # width of the plots [pixel]


def serve(
    runs: Mapping[str, Seen], title: str, plots: Sequence[str] = (), *, ghosts: bool = False, together: bool = False,
    port: int = 8080,
) -> Live:  # fmt: skip
    """Serve a page of runs by caption, at `port` of this machine or the first free port after it; 0: any free port.

    together: the runs are those of members of one scene, which stand where they are.

    Raises ImportError without viser, and ValueError as `recorded.page_data`.
    """
    port = whole("port", port, 0, "0 is any that is free", 65535)
    try:
        import viser
    except ImportError as error:
        raise ImportError(INSTALL) from error
    looks: dict[int, list[Piece]] = {}
    notes: list[str] = []
    for seen in runs.values():
        if id(seen.model) not in looks:
            looks[id(seen.model)], remarks = pieces(seen.model, TRIANGLES // len(runs), CORNERS)
            notes += [f"{seen.model.source}: {note}" for note in remarks]
    if notes:
        rest = f"; and {len(notes) - MOST_NOTES} more" if len(notes) > MOST_NOTES else ""
        text = f"{'; '.join(notes[:MOST_NOTES])}{rest}: collision shapes or boxes of the inertia are drawn instead"
        warnings.warn(text, RobotFileWarning, stacklevel=3)
    actors = [_Actor(caption, seen, looks[id(seen.model)]) for caption, seen in runs.items()]
    known_channels([actor.plotted.channels for actor in actors], plots)
    return Live(viser.ViserServer("127.0.0.1", port, label=title, verbose=False), actors, ghosts, plots, together)


class Live:
    """A page at `url` that plays runs until `stop` or the end of the program; a notebook shows it.

    The program can play the page too.  As a context manager it stops at the end of the block.

    Attributes
    ----------
    server : viser.ViserServer
        The server, to draw more in the scene.
    start, end : float
        Times of the first and last sample [s].
    """

    def __init__(
        self, server: Any, actors: Sequence[_Actor], ghosts: bool, plots: Sequence[str], together: bool = False
    ) -> None:
        self.server = server
        self._actors, self._lock, self._stopped = actors, threading.RLock(), threading.Event()
        self.start = min(actor.start for actor in actors)
        self.end = max(actor.end for actor in actors)
        self._time, self._speed, self._playing = self.start, 1.0, self.end > self.start
        self._stage, self._charts, self._plotted = _Stage(server, actors, ghosts, together), list[Chart](), -math.inf
        self._controls: dict[str, Any] = {}
        with server.atomic():
            self._add_controls()
            if plots:
                self._add_plots(plots)
            self._draw()
        self._thread = threading.Thread(target=self._play, name="live page", daemon=True)
        self._thread.start()

    def __repr__(self) -> str:
        return f"<live page, {'stopped' if self._stopped.is_set() else self.url}>"

    def _repr_html_(self) -> str:
        return f'<iframe title="motion" src="{self.url}" style="width:100%;height:{HEIGHT}px;border:0"></iframe>'

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def url(self) -> str:
        """The address of the page for browsers on this machine."""
        return f"http://localhost:{self.server.get_port()}"

    @property
    def time(self) -> float:
        """The time that the page shows [s]."""
        return self._time

    def seek(self, time: float) -> None:
        """Show a time and pause; runs that have ended by then stay at their end.

        Parameters
        ----------
        time : float
            Time of the runs [s].

        Raises
        ------
        ValueError
            The time is not a finite number.
        """
        time = real("time", time, -math.inf, math.inf, "[s]")
        with self._lock:
            self._time, self._playing = min(max(time, self.start), self.end), False
            self._draw()

    def play(self) -> None:
        """Play, from the start if the end was reached."""
        with self._lock:
            self._time = self.start if self._time >= self.end else self._time
            self._playing = self.end > self.start
            self._draw()

    def pause(self) -> None:
        """Pause at the time that is shown."""
        self.seek(self._time)

    def stop(self) -> None:
        """Stop the page and its server."""
        if not self._stopped.is_set():
            self._stopped.set()
            self._thread.join()
            self.server.stop()

    def wait(self) -> None:
        """Wait until the page is stopped; Ctrl-C stops it."""
        try:
            while not self._stopped.wait(0.5):
                pass
        except KeyboardInterrupt:
            self.stop()

    def _play(self) -> None:
        """Advance the clock while a browser shows the page."""
        before = time.perf_counter()
        while not self._stopped.wait(1.0 / RATE):
            now = time.perf_counter()
            with self._lock:
                if self._playing and self.server.get_clients():
                    self._time = min(self._time + self._speed * (now - before), self.end)
                    self._playing = self._time < self.end
                    self._draw()
            before = now

    def _draw(self) -> None:
        with self._lock, self.server.atomic():
            self._stage.draw(self._time)
            if not self._playing or time.perf_counter() - self._plotted > 1.0 / PLOT_RATE:
                for chart in self._charts:
                    chart.draw(self._time)
                self._plotted = time.perf_counter()
            if self._controls:
                self._controls["time"].value = self._time
                self._controls["play"].label = "Pause" if self._playing else "Play"

    def _add_controls(self) -> None:
        gui, stage = self.server.gui, self._stage
        gui.configure_theme(show_logo=False, show_share_button=False)
        for actor in self._actors:
            gui.add_html(actor.status_html())
        if self.end > self.start:
            self._add_clock()
        view = gui.add_button_group("view", tuple(VIEWS))
        view.on_click(lambda event: stage.look(event.client.camera, event.target.value) if event.client else None)
        switches = [("follow", not stage.together and any(actor.moves for actor in self._actors))]
        forces = any(actor.force is not None or actor.pushed for actor in self._actors)
        traced = any(actor.traced is not None for actor in stage.actors)
        switches += [("forces", forces), ("center of mass", True), ("rays", traced)]
        switches += [("ghosts", not stage.together and len(self._actors) > 1)]
        for name, needed in switches:
            if needed:
                box = gui.add_checkbox(name, stage.shown[name])
                box.on_update(lambda event, name=name: self._switch(name, event.target.value))

    def _add_plots(self, plots: Sequence[str]) -> None:
        gui, runs = self.server.gui, [actor.plotted for actor in self._actors]
        names = known_channels([run.channels for run in runs], plots)
        panel = gui.add_panel()
        with panel.add_tab("Plots"):
            self._charts = [Chart(gui, self._lock, runs, names, name) for name in plots]
        panel.dock_left()
        panel.set_width(PANEL)

    def _add_clock(self) -> None:
        gui = self.server.gui
        step = 10.0 ** math.floor(math.log10(min(self.end - self.start, 0.01)))
        button = gui.add_button("Pause")
        button.on_click(lambda _: self.pause() if self._playing else self.play())
        slider = gui.add_slider("time [s]", min=self.start, max=self.end, step=step, initial_value=self.start)
        slider.on_update(lambda event: self.seek(event.target.value) if event.client is not None else None)
        steps = gui.add_button_group("step", ("start", "-1", "+1", "end"))
        steps.on_click(lambda event: self._step(event.target.value))
        speed = gui.add_dropdown("speed", SPEEDS, initial_value="1")
        speed.on_update(lambda event: setattr(self, "_speed", float(event.target.value)))
        self._controls |= {"play": button, "time": slider}

    def _step(self, how: str) -> None:
        ends = {"start": self.start, "end": self.end}
        first = self._actors[0]
        row = first.row(self._time) + (0 if how in ends else int(how))
        self.seek(ends.get(how, float(first.samples[min(max(row, 0), len(first.samples) - 1)])))

    def _switch(self, name: str, on: bool) -> None:
        with self._lock:
            self._stage.shown[name] = on
            self._stage.arrange()
            self._draw()


class _Actor:
    """A run in the scene: its robot at any time, contact forces and the center of mass."""

    def __init__(self, caption: str, seen: Seen, found: list[Piece]) -> None:
        self.caption, self.model, self.ground, self.found = caption, seen.model, seen.ground, found
        run = self.run = seen.trajectory
        frames = sampled(seen)
        self.box = corners_of(seen.model, frames, found)  # (frames, n, 3) [m]
        self.q, self.samples, self.last = positions(run, seen.model), run["time"], frames.last
        self.plotted = Plotted(caption, run.status, channels_of(seen.model, run, frames.last))
        self.start, self.end = float(self.samples[0]), float(self.samples[-1])
        self.moves = seen.model.base == "floating"
        touches = "contact_force" in run and seen.ground is not None and len(seen.model.contacts) > 0
        self.force = np.nan_to_num(run["contact_force"], posinf=0.0, neginf=0.0) if touches else None
        self.pushed = pushes_of(seen.model, run, frames) is not None  # by other bodies or propellers
        self.level, self.traced = seen.level, seen.rays  # of a fluid, and rays of sensors
        self.rows = {link.name: k for k, link in enumerate(seen.model.links)}
        self.size = float(np.ptp(self.box[0], axis=0).max())  # [m]
        over = self.box[..., 2].max() if not self.moves else self.box[0, :, 2].max()
        root = frames.position[0, self.rows[seen.model.root]]
        self.over = np.array([0.0, 0.0, float(over - root[2]) + 0.08 * self.size])  # of the label
        self.drawn: tuple[int, bool, bool, bool] | None = None

    def status_html(self) -> str:
        """Write how the run ended as HTML."""
        run = self.run
        if run.status == "ok":
            return f'<div style="margin:0.2em 1em"><b>{escape(self.caption)}</b>: ok</div>'
        when = f" at {run.end_time:.4g} s" if run.failed else ""
        text = f"<b>{escape(self.caption)}: {escape(run.status)}{when}</b><br>{escape(run.message)}"
        return f'<div style="color:{BAD};margin:0.2em 1em">{text}</div>'

    def row(self, t: float) -> int:
        """Find the last sample up to a time [s]."""
        return min(max(int(np.searchsorted(self.samples, t + 1e-9, side="right")) - 1, 0), self.last)

    def enter(self, scene: Any, name: str) -> None:
        """Add the robot to the scene, each link as a frame with its pieces in it."""
        self.place = scene.add_frame(name, show_axes=False)
        names = dict.fromkeys(piece.link for piece in self.found)
        self.links = {link: scene.add_frame(f"{name}/{link.replace('/', '_')}", show_axes=False) for link in names}
        self.meshes = [
            scene.add_mesh_simple(
                f"{self.links[piece.link].name}/{k}", piece.points, piece.triangles, color=piece.color, side="double"
            )
            for k, piece in enumerate(self.found)
        ]
        r = 0.012 * self.size
        self.label = scene.add_label(f"{name}/label", self.caption, anchor="bottom-center")
        self.mass = scene.add_icosphere(f"{name}/center_of_mass", 2.0 * r, color=MASS)
        self.under = scene.add_cylinder(f"{name}/under_it", 2.0 * r, 0.2 * r, color=MASS)
        self.arrows = scene.add_arrows(
            f"{name}/forces", np.zeros((1, 2, 3)), FORCE, shaft_radius=r, head_radius=2.0 * r, head_length=4.0 * r
        )
        if self.traced is not None:
            ends = self.traced[0, :, :6].reshape(-1, 2, 3).astype(np.float32)
            self.rays = scene.add_line_segments(f"{name}/rays", ends, RAY, thickness=0.3 * r)
        if self.level is not None:
            low, high = self.box.min(axis=(0, 1)), self.box.max(axis=(0, 1))
            far = 1.5 * float((high - low).max())
            (x0, y0), (x1, y1) = (low - far)[:2], (high + far)[:2]
            edge = np.array([(x, y, self.level) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))])
            scene.add_mesh_simple(
                f"{name}/water",
                edge,
                np.array([[0, 1, 2], [0, 2, 3]]),
                color=WATER,
                opacity=0.35,
                side="double",
                cast_shadow=False,
            )

    def draw(self, t: float, shown: Mapping[str, bool]) -> None:
        """Draw the run at a time [s]."""
        row, run = self.row(t), self.run
        over = run.failed and t >= min(run.end_time, self.samples[self.last]) - 1e-9
        state = (row, over, shown["forces"], shown["rays"])
        if state == self.drawn:
            return
        before, self.drawn = self.drawn, state
        q = self.q[row]
        poses = forward_kinematics(self.model, q)
        at = [self.rows[link] for link in self.links]
        turns = quaternions(poses.rotation[None, at])[0][:, [3, 0, 1, 2]]
        for frame, turn, position in zip(self.links.values(), turns, poses.position[at]):
            frame.wxyz, frame.position = turn, position
        self.label.position = poses.position[self.rows[self.model.root]] + self.over
        self.mass.position = mass = center_of_mass(self.model, q)
        if self.ground is not None:
            self.under.position = mass - [0.0, 0.0, float(ground_under(self.ground, mass[None])[0, 6])]
        self._draw_forces(q, row, poses, shown["forces"])
        if self.traced is not None:
            self.rays.visible = shown["rays"]
            self.rays.points = self.traced[row, :, :6].reshape(-1, 2, 3).astype(np.float32)
        if before is None or before[1] != over:
            when = f": {run.status} at {run.end_time:.4g} s"
            doubtful = f": {run.status}" * (not (run.failed or run.ok))
            self.label.text = self.caption + (when if over else doubtful)
            for mesh, piece in zip(self.meshes, self.found):
                mesh.color = FAILURE if over else piece.color

    def _draw_forces(self, q: np.ndarray, row: int, poses: Poses, wanted: bool) -> None:
        points, pushes = np.zeros((0, 3)), np.zeros((0, 3))
        if self.force is not None and self.ground is not None:
            points = contact_positions(self.model, q)
            pushes = in_world(self.ground, self.force[row], points if self.ground.field is not None else None)
        at = FramePoses(np.array([row]), row, poses.rotation[None], poses.position[None])
        if self.pushed and (others := pushes_of(self.model, self.run, at)) is not None:
            place, force, on = (part[0] for part in others)
            points, pushes = np.concatenate([points, place[on]]), np.concatenate([pushes, force[on]])
        weight = 9.81 * max(self.model.mass, LIGHTEST)
        felt = np.sqrt((pushes * pushes).sum(axis=1)) > TOUCH * weight
        self.arrows.visible = bool(wanted and felt.any())
        if self.arrows.visible:
            ends = points + 0.8 * self.size / weight * pushes
            self.arrows.points = np.stack([points, ends], axis=1)[felt].astype(np.float32)

    def look(self, ghost: bool) -> None:
        """Draw the robot transparent, or not."""
        for mesh, piece in zip(self.meshes, self.found):
            opacity = GHOST * piece.opacity if ghost else piece.opacity
            mesh.opacity = None if opacity >= 1.0 else opacity


class _Stage:
    """The ground with the runs on it: side by side along a level line, or all in one place."""

    def __init__(self, server: Any, actors: Sequence[_Actor], ghosts: bool, together: bool) -> None:
        self.actors, self.together = actors, together
        self.shown = {"follow": not together, "forces": True, "center of mass": True}
        self.shown |= {"ghosts": ghosts and len(actors) > 1, "rays": True}
        scene, grounds = server.scene, [actor.ground for actor in actors]
        self.world = scene.add_frame("/world", show_axes=False)
        for k, actor in enumerate(actors):
            actor.enter(scene, f"/world/run{k + 1}")
        self.across = np.array([0.0, 1.0, 0.0])
        if grounds[0] is not None and grounds[0].field is None:
            self.across = plane_axes(grounds[0])[2]
        wide = [actor.box @ self.across for actor in actors]
        self.gap = 0.25 * max(actor.size for actor in actors) + max(float(np.ptp(x, axis=1).max()) for x in wide)
        fields = any(ground is not None and ground.field is not None for ground in grounds)
        self.floors: list[Any] = []  # of each run, where there is not one for all
        if not together and (fields or any(ground != grounds[0] for ground in grounds)):
            self.gap = max(float(np.ptp(x)) for x in wide) + 2.2 * max(margin_of(actor.box) for actor in actors)
            self.floors = [_floor(scene, f"/world/run{k + 1}/ground", a.ground, a.box) for k, a in enumerate(actors)]
        else:
            boxes = [a.box.reshape(-1, 3) + x for a in actors for x in (np.zeros(3), *self._offsets())]
            _floor(scene, "/world/ground", grounds[0], np.concatenate(boxes)[None])
        self.arrange()
        first = np.concatenate([actor.box[0] + actor.place.position for actor in actors])
        self.middle = 0.5 * (first.min(axis=0) + first.max(axis=0))
        self.span = 1.15 * float(np.ptp(first, axis=0).max())
        server.initial_camera.fov = FIELD_OF_VIEW
        self.look(server.initial_camera, "corner")

    def _offsets(self) -> list[np.ndarray]:
        n = len(self.actors)
        if self.together:
            return [np.zeros(3)] * n
        return [self.gap * (0.5 * (n - 1) - k) * self.across for k in range(n)]

    def arrange(self) -> None:
        """Place the runs side by side or as ghosts, and show what is switched on."""
        ghosts = self.shown["ghosts"]
        for k, (actor, offset) in enumerate(zip(self.actors, self._offsets())):
            actor.place.position = np.zeros(3) if ghosts else offset
            actor.look(ghosts and k > 0)
            actor.mass.visible = self.shown["center of mass"]
            actor.under.visible = self.shown["center of mass"] and actor.ground is not None
            for mesh in self.floors[k] if self.floors else ():
                mesh.visible = k == 0 or not ghosts

    def draw(self, t: float) -> None:
        """Draw all runs at a time [s]; if the camera follows, the first robot stays in place."""
        for actor in self.actors:
            actor.draw(t, self.shown)
        first = self.actors[0]
        away = np.zeros(3)
        if self.shown["follow"] and first.moves:
            away[:2] = first.q[first.row(t), :2] - first.q[0, :2]
        self.world.position = -away

    def look(self, camera: Any, view: str) -> None:
        """Turn a camera to one of VIEWS."""
        yaw, pitch = VIEWS[view]
        far = self.span / (2.0 * math.tan(0.5 * FIELD_OF_VIEW)) + 0.3 * self.span
        level = far * math.cos(pitch)
        away = np.array([level * math.cos(yaw), level * math.sin(yaw), far * math.sin(pitch)])
        camera.position, camera.look_at = self.middle + away, self.middle


def _floor(scene: Any, name: str, ground: Ground | None, box: np.ndarray) -> list[Any]:
    """Draw the ground under corners (frames, n, 3) [m]; without ground a grid under the lowest one."""
    if ground is not None and (ground.steps or ground.field is not None):
        uneven = relief(ground, box)
        quads, shade = np.array(uneven["quads"]).reshape(-1, 4, 3), np.array(uneven["shade"])
        halves = (4 * np.arange(len(quads))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
        return [
            scene.add_mesh_simple(
                f"{name}/{k}", quads[shade == k].reshape(-1, 3), halves[: 2 * (shade == k).sum()], color=color,
                flat_shading=True, side="double", cast_shadow=False,
            )
            for k, color in enumerate((FLOOR, SQUARE, RISE)) if (shade == k).any()
        ]  # fmt: skip
    corners = box.reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = float((high - low).max())
    cell = round_up(float(np.ptp(box[0], axis=0).max()) / 8.0)
    middle = np.array([*(0.5 * (low + high))[:2], low[2]])
    turn, at = (1.0, 0.0, 0.0, 0.0), cell * np.round(middle / cell) * (1, 1, 0) + middle * (0, 0, 1)
    if ground is not None:
        axes = plane_axes(ground)
        normal, first, second = axes
        turn = quaternions(np.stack([first, second, normal], axis=1)[None, None])[0, 0][[3, 0, 1, 2]]
        at = cell * (round(middle @ first / cell) * first + round(middle @ second / cell) * second)
        at = at + ground.height * normal[2] * normal
    reach = cell * 2 * math.ceil((1.5 * size + 20.0 * cell) / cell)
    return [
        scene.add_grid(
            name, reach, reach, cell_size=cell, section_size=5.0 * cell, cell_color=SQUARE, section_color=RISE,
            plane_color=FLOOR, plane_opacity=0.0 if ground is None else 1.0, wxyz=turn, position=at,
        )
    ]  # fmt: skip
