"""Section 2: the kinds of robots that the paper's simulator can define, each beside its closed form.

The paper lists wheeled and legged robots, conveyor belts, lighter-than-air and underwater vehicles, with no number.  So
scenes of the package (`robots/`) are compared with what can be solved by hand: speeds at which thrust is drag, the
depth and period of what floats, thrust against weight, turning radii, slip of rollers, a box on a belt, distances of
rays, and the poles of a balanced pendulum.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.linalg import expm

from ..base.rotation import rotation_from_quaternion
from ..geometry.body import body
from ..model.placed import Placed
from ..model.sensor import RangeSensor
from ..model.shapes import Box
from ..robot_file.scene import load_scene
from ..run.program import load_controller
from ..run.range_sensor import ranges
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene, compile_scene
from ..view.style import BLUE, ORANGE, look
from .claim import Claim, classify
from .common import subplots

G = 9.81  # [m/s^2]
DEFAULT, TIGHT = 1e-3, 1e-5  # error that a row may have, relative, by default and by error control
LONG = 1e3  # of references that go on [s]


@dataclass(frozen=True)
class SimulatorsWorldSettings:
    """Our choices for what the paper does not state."""

    rtol: float = 1e-8  # of runs by error control, beside those with the default tolerance
    timestep: float = 5e-4  # [s] of the kick in its second run; the first has 1 ms
    patience: float = 1.0  # how much longer than needed vehicles travel to their last speeds


QUICK = SimulatorsWorldSettings()
FULL = SimulatorsWorldSettings(rtol=1e-10, timestep=2.5e-4, patience=1.5)


class Row(NamedTuple):
    """A quantity beside its closed form."""

    robot: str
    quantity: str
    unit: str
    exact: float
    default: float  # as a run with the default tolerance has it
    tight: float  # by error control, or in a shorter step
    bar: float = TIGHT  # relative error that the second may have
    scale: float = 0.0  # by which errors are divided; 0 is the exact value

    @property
    def errors(self) -> tuple[float, float]:
        """Relative errors of both runs."""
        scale = self.scale or abs(self.exact)
        return abs(self.default - self.exact) / scale, abs(self.tight - self.exact) / scale

    @property
    def agrees(self) -> bool:
        """Whether both errors are within what they may be."""
        return self.errors[0] <= DEFAULT and self.errors[1] <= self.bar


class Course(NamedTuple):
    """What a panel shows: a quantity over another, and its closed form."""

    title: str
    across: str
    along: str
    found: tuple[np.ndarray, np.ndarray]
    exact: tuple[np.ndarray, np.ndarray]


Found = tuple[list[Row], list[Course]]


@dataclass(frozen=True, eq=False)
class SimulatorsWorldResult:
    """Rows of all scenes, and courses to draw."""

    settings: SimulatorsWorldSettings
    rows: tuple[Row, ...]
    courses: tuple[Course, ...]


def run(settings: SimulatorsWorldSettings = QUICK) -> SimulatorsWorldResult:
    """Simulate all scenes."""
    cases = (line_follower, omni_robot, rays, balancer, conveyor, blimp, vehicle, humanoid_and_ball)
    found = [case(settings) for case in cases]
    rows = tuple(row for rows, _ in found for row in rows)
    return SimulatorsWorldResult(settings, rows, tuple(course for _, courses in found for course in courses))


def _both(settings: SimulatorsWorldSettings, *arguments: Any, **options: Any) -> list[Trajectory]:
    """Simulate with the default tolerance and by error control."""
    return [simulate(*arguments, **options, estimate_error=False, rtol=rtol) for rtol in (None, settings.rtol)]


def _speeds(*values: float) -> Reference:
    """Return what servos follow that keep speeds [rad/s]."""
    return Reference([0.0, LONG], [np.zeros(len(values)), LONG * np.array(values)])


def _places(run: Trajectory) -> np.ndarray:
    """Return positions and quaternions (samples, 7) of the robot."""
    return run["base_q"].reshape(-1, 7)


def _velocities(run: Trajectory) -> np.ndarray:
    """Return velocities (samples, 6) of the robot."""
    return run["base_qd"].reshape(-1, 6)


def _in_its_axes(run: Trajectory) -> np.ndarray:
    """Return the last velocity along the robot's x and y [m/s], and about z [rad/s]."""
    v = _velocities(run)[-1]
    return np.array([*(rotation_from_quaternion(_places(run)[-1, 3:]).T @ v[:3])[:2], v[5]])


# ---------------------------------------------------------------------------------------------- wheels


def line_follower(settings: SimulatorsWorldSettings) -> Found:
    """Drive a circle with two wheels, and follow the line."""
    scene = compile_scene(load_scene("line_follower"), "rotor")
    left, right, track, ahead, bend, v, steer = 2.0, 4.0, 0.16, 0.06, 0.4, 0.1, 25.0
    runs = _both(settings, scene, 5.0, None, _speeds(left, right), record=("base_q", "base_qd"))
    radii = [float(end[0] / end[2]) for end in map(_in_its_axes, runs)]
    lap = simulate(scene, 45.0, None, None, record=("base_q",), controller=load_controller("line_follower"))
    x, y = _places(lap)[:, :2].T
    # the line is R - sqrt(bend^2 - ahead^2) to the left of the middle spot: steer u = v / R
    near = math.sqrt(bend**2 - ahead**2)
    R = 0.5 * (near + math.sqrt(near**2 + 4.0 * v / steer))
    angle = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 100)
    arc = np.concatenate([0.4 + R * np.cos(angle), -0.4 - R * np.cos(angle)])
    oval = np.append(arc, arc[0]), R * np.append(np.concatenate([np.sin(angle), -np.sin(angle)]), np.sin(angle[0]))
    exact = 0.5 * track * (right + left) / (right - left)
    return (
        [Row("two driven wheels", "turning radius", "m", exact, *radii)],
        [Course("line follower: its way", "x [m]", "y [m]", (x, y), oval)],
    )


def omni_robot(settings: SimulatorsWorldSettings) -> Found:
    """Drive in all directions while rims slip along their axles, and in a circle."""
    scene = compile_scene(load_scene("omni_robot"), "rotor")
    radius, arm, v, turn, record = 0.05, 0.125, 0.15, 0.5, ("base_q", "base_qd", "qd")
    axles = np.array([0.0, 2.0, -2.0]) * math.pi / 3.0
    along = np.column_stack([-np.sin(axles), np.cos(axles)])  # of the rims

    def driven(heading: float, w: float, duration: float = 3.0) -> list[Trajectory]:
        way = v * np.array([math.cos(heading), math.sin(heading)])
        wheels = -(along @ way + arm * w) / radius
        return _both(settings, scene, duration, None, _speeds(*wheels.tolist()), record=record)

    def slip(run: Trajectory) -> float:
        return float(np.hypot(*(_in_its_axes(run)[:2] + radius * run["qd"][-1, 0] * along[0])))

    headings = np.radians([0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0])
    ahead = [driven(heading, 0.0) for heading in headings]
    ends = [_in_its_axes(run) for run in driven(0.0, turn, 4.0 * math.pi)]
    rows = [
        Row("three omni wheels", "speed at 45°", "m/s", v, *(float(np.hypot(*_in_its_axes(x)[:2])) for x in ahead[3])),
        Row("three omni wheels", "slip of a rim at 45°", "m/s", v * math.cos(headings[3]), *map(slip, ahead[3])),
        Row("three omni wheels", "turning radius", "m", v / turn, *(float(np.hypot(*x[:2]) / x[2]) for x in ends)),
    ]
    fine = np.linspace(0.0, 90.0, 91)
    found = np.degrees(headings), np.array([slip(runs[0]) for runs in ahead])
    exact = fine, v * np.cos(np.radians(fine))
    return rows, [Course("omni robot: slip of a rim", "heading [deg]", "slip [m/s]", found, exact)]


def rays(settings: SimulatorsWorldSettings) -> Found:
    """Measure a wall to which the omni robot drives, at angles."""
    wall, angle, v = 1.0, 0.5, 0.15
    block = Placed(body(Box((0.2, 4.0, 0.5)), name="wall", base="fixed"), position=(wall + 0.1, 0.0, 0.25))
    scene = compile_scene(replace(load_scene("omni_robot"), obstacles=(block,)), "rotor")
    wheels = _speeds(0.0, v * math.sin(2.0 * math.pi / 3.0) / 0.05, -v * math.sin(2.0 * math.pi / 3.0) / 0.05)
    ray = np.array([[math.cos(angle), math.sin(angle), 0.0]])
    sensor = RangeSensor("omni_robot/base", ray, position=(0.0, 0.0, 0.1))
    found, exact = [], []
    for run in _both(settings, scene, 4.0, None, wheels, record=("q", "base_q")):
        place = _places(run)
        direction = np.array([rotation_from_quaternion(q) @ sensor.directions[0] for q in place[:, 3:]])
        found.append(ranges(scene, run, sensor)[:, 0])
        exact.append((wall - place[:, 0]) / direction[:, 0])
    time = run["time"]
    # the second run is measured where the first one was, so that its row is of the ray alone
    row = Row("range sensor", "distance to a wall at an angle", "m", float(exact[1][-1]),
              float(found[0][-1] - exact[0][-1] + exact[1][-1]), float(found[1][-1]))  # fmt: skip
    return [row], [Course("range sensor: a wall", "time [s]", "distance [m]", (time, found[0]), (time, exact[1]))]


def balancer(settings: SimulatorsWorldSettings) -> Found:
    """Let the pendulum on wheels right itself."""
    scene, pitch, steps = compile_scene(load_scene("balancer"), "rotor"), 1e-3, 400
    place = [0.0, 0.0, 0.04 - 1e-5, math.cos(0.5 * pitch), 0.0, math.sin(0.5 * pitch), 0.0]
    start = initial_state(scene, {"balancer": [*place, -pitch, -pitch]})
    law, upright = load_controller("balancer"), Reference([0.0], [[0.0, 0.0]])
    runs = _both(settings, scene, 0.005 * steps, start, upright, record=("base_q",), controller=law)
    x, step = np.array([0.0, pitch, 0.0, 0.0]), _regulated()
    course = [x[1], *((x := step @ x)[1] for _ in range(steps))]
    found = [2.0 * np.arcsin(_places(run)[:, 5]) for run in runs]
    default, tight = (float(one[20]) for one in found)
    row = Row("pendulum on wheels", "pitch after 0.1 s", "rad", course[20], default, tight, DEFAULT, pitch)
    time = runs[0]["time"]
    return [row], [
        Course("pendulum on wheels", "time [s]", "pitch [mrad]", (time, 1e3 * found[0]), (time, 1e3 * np.array(course)))
    ]


def _regulated(period: float = 0.005) -> np.ndarray:
    """Return the matrix (4, 4) of way, pitch and their rates from tick to tick, from Lagrange's equations."""
    mass, wheel, spin, r, l, inertia = 0.9, 0.05, 4e-5, 0.04, 0.09, 2.7e-3
    k, resistance, viscous, rotor = 20.0 * 0.0115, 2.5, 0.002, 20.0**2 * 5e-7  # of a gear motor, at the wheel
    along = mass + 2.0 * wheel + 2.0 * (spin + rotor) / r**2
    across = mass * l - 2.0 * rotor / r
    M = np.array([[along, across], [across, mass * l**2 + inertia + 2.0 * rotor]])
    push = np.array([1.0 / r, -1.0])  # of the torque of both motors
    A = np.zeros((5, 5))  # the last is the voltage, which a period holds
    A[:2, 2:4] = np.eye(2)
    A[2:4, :2] = np.linalg.solve(M, np.diag([0.0, mass * G * l]))
    A[2:4, 2:4] = -np.linalg.solve(M, 2.0 * (k * k / resistance + viscous) * np.outer(push, push))
    A[2:4, 4] = np.linalg.solve(M, 2.0 * k / resistance * push)
    whole = expm(period * A)
    return whole[:4, :4] + whole[:4, 4:] @ np.array([[21.2, 26.7, 19.9, 3.6]])


# ---------------------------------------------------------------------------------------------- belts


# Of the arm: time [s], its turn [rad] and the height of its cup [m].  It lowers the cup, waits for the heavy box, lifts
# it, and sets it on the table.
TURNED, DOWN = 0.5 * math.pi, -0.049
POSTURES = (
    (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, DOWN), (3.1, 0.0, DOWN), (3.9, 0.0, 0.0),
    (5.0, TURNED, 0.0), (5.5, TURNED, 0.0), (6.3, TURNED, DOWN), (6.9, TURNED, DOWN), (7.7, TURNED, 0.0),
)  # fmt: skip
# The belt stops when the box is under the cup, 0.55 m from its start: as long as it speeds up it slows down.
STOPS, GRIPS, STARTS, DROPS = 0.55 / 0.2, 3.0, 4.0, 6.8  # [s]
SWITCHES: tuple[Any, ...] = (
    (STOPS, "belt/motor", 0.0), (GRIPS, "suction", True, math.inf),
    (STARTS, "belt/motor", 1.0), (DROPS, "suction", False),
)  # fmt: skip


def conveyor(settings: SimulatorsWorldSettings) -> Found:
    """Put boxes on the belt, and sort them."""
    scene, friction, v = compile_scene(load_scene("conveyor"), "rotor"), 0.5, 0.2
    start, name, record = initial_state(scene, open_loops=["suction"]), "box on a belt", ("base_q", "base_qd")
    runs = _both(settings, scene, 0.2, start, record=record, record_interval=1e-3)
    time, moved = runs[0]["time"], [_velocities(run["heavy"])[:, 0] for run in runs]
    late = (time > 0.02) & (time < 0.039)  # after it tilts on its contacts, before it moves along
    rows = [
        Row(name, "acceleration", "m/s²", friction * G, *(float(np.polyfit(time[late], x[late], 1)[0]) for x in moved)),
        Row(name, "last speed", "m/s", v, *(float(x[-1]) for x in moved)),
    ]
    at, *postures = (np.array(column) for column in zip(*POSTURES))
    sort = Reference(at, np.stack(postures, axis=1))
    runs = _both(settings, scene, 8.0, start, sort, record=record, switches=SWITCHES)
    stopped = [float(_places(run["heavy"])[np.searchsorted(run["time"], 2.9), 0]) for run in runs]
    rows.append(Row(name, "place where it stops", "m", 0.2, *stopped))
    shown = time < 0.08
    exact = np.minimum(friction * G * time[shown], v)
    x, y = _places(runs[0]["heavy"])[:, :2].T
    angle = np.linspace(-0.5 * math.pi, 0.0, 50)
    way = np.append(-0.35, 0.2 + 0.3 * np.cos(angle)), np.append(0.0, 0.3 + 0.3 * np.sin(angle))
    return rows, [
        Course(name, "time [s]", "speed [m/s]", (time[shown], moved[0][shown]), (time[shown], exact)),
        Course("heavy box: its way to the table", "x [m]", "y [m]", (x, y), way),
    ]


# ---------------------------------------------------------------------------------------------- fluids


def _turning(scene: CompiledScene, height: float, velocity: float, angles: list[float], qd: list[float]) -> np.ndarray:
    """Return the state of a vehicle whose propellers turn at qd [rad/s], which the integrals of their laws hold."""
    (member,) = scene.members
    drag = {one.joint: one.torque for one in member.model.propellers}
    place, motion = [0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0, *angles], [velocity, *[0.0] * 5, *qd]
    state = initial_state(scene, {member.name: place}, {member.name: motion})
    for k, (joint, w) in enumerate(zip(member.model.joint_names, qd)):
        if joint in drag:
            servo = member.model.servos[joint]
            voltage = servo.motor_constant * w + servo.resistance * drag[joint] * w * abs(w) / servo.motor_constant
            scene.state_view(state).integral[k] = voltage / servo.controller.Ki
    return state


def blimp(settings: SimulatorsWorldSettings) -> Found:
    """Climb with thrust upward, and fly level with thrust that bears the weight."""
    scene, density, thrust, r, record = compile_scene(load_scene("blimp"), "rotor"), 1.2, 9e-8, 0.3, ("base_qd",)
    weight = (0.345 - density * math.pi * r * r * (0.6 + 4.0 / 3.0 * r)) * G
    rows, courses = [], []
    for quantity, w, tilt, of in (
        ("thrust that bears its weight in a climb", 600.0, 0.5 * math.pi, 2),
        ("speed in level flight", 700.0, math.asin(weight / (2.0 * thrust * 700.0**2)), 0),
    ):
        up = 2.0 * thrust * w * w * math.sin(tilt) - weight
        level = 2.0 * thrust * w * w * math.cos(tilt)
        across = 0.5 * density * 0.8 * (2.0 * r * 0.6 + math.pi * r * r), 0.5 * density * 0.2 * math.pi * r * r
        v = math.sqrt(up / across[0]) if of == 2 else math.sqrt(level / across[1])
        start = _turning(scene, 2.0, 0.5 * v * (of == 0), [tilt, 0.0, 0.0], [0.0, w, -w])
        held = Reference([0.0, LONG], [[tilt, 0.0, 0.0], [tilt, LONG * w, -LONG * w]])
        runs = _both(settings, scene, 120.0 * settings.patience, start, held, record=record, record_interval=0.5)
        found = [_velocities(run)[:, of] for run in runs]
        if of == 2:
            # of the thrust, what drag does not hold
            borne = [float(2.0 * thrust * w * w - across[0] * one[-1] ** 2) for one in found]
            rows.append(Row("blimp", quantity, "N", weight, *borne))
        else:
            rows.append(Row("blimp", quantity, "m/s", v, *(float(one[-1]) for one in found)))
            time = runs[0]["time"]
            courses.append(Course("blimp: level flight", "time [s]", "speed [m/s]", (time, found[0]),
                                  (time[[0, -1]], np.array([v, v]))))  # fmt: skip
    return rows, courses


def vehicle(settings: SimulatorsWorldSettings) -> Found:
    """Drive the underwater vehicle to its last speed, and let it float and bob."""
    scene, thrust, w, mass = compile_scene(load_scene("rov"), "rotor"), 3.75e-4, 200.0, 10.64
    name, (long, wide, high) = "underwater vehicle", (0.40, 0.28, 0.10)
    down = -math.sqrt((1000.0 * long * wide * high - mass) * G / (2.0 * thrust))  # holds what the water lifts
    each = [w, -w, down, -down]
    start, record = _turning(scene, -2.0, 0.0, [0.0] * 4, each), ("base_q", "base_qd")
    runs = _both(settings, scene, 30.0 * settings.patience, start, _speeds(*each), record=record, record_interval=0.1)
    v = math.sqrt(2.0 * thrust * w * w / (0.5 * 1000.0 * wide * high))
    rows = [Row(name, "terminal speed", "m/s", v, *(float(_velocities(one)[-1, 0]) for one in runs))]

    depth, small, still = mass / (1000.0 * long * wide), 1e-4, [0.0] * 4
    start = _turning(scene, 0.5 * high - depth + small, 0.0, still, still)
    runs = _both(settings, scene, 6.0, start, _speeds(*still), record=record, record_interval=5e-3)
    period = 2.0 * math.pi * math.sqrt(1.5 * mass / (1000.0 * G * long * wide))  # with the added mass
    heights = [_places(one)[:, 2] - 0.5 * high + depth for one in runs]
    time = runs[0]["time"]
    middles = [float(depth - 0.5 * (z.max() + z.min())) for z in heights]
    rows.append(Row(name, "depth at which it floats", "m", depth, *middles))
    rows.append(Row(name, "period of bobbing", "s", period, *(_period(time, z) for z in heights)))
    shown = time < 2.5
    exact = 1e3 * small * np.cos(2.0 * math.pi / period * time[shown])
    found = time[shown], 1e3 * heights[0][shown]
    return rows, [Course("vehicle afloat", "time [s]", "height [mm]", found, (time[shown], exact))]


def _period(time: np.ndarray, z: np.ndarray) -> float:
    """Return the mean time between rises through zero."""
    up = np.flatnonzero((z[:-1] < 0.0) & (z[1:] >= 0.0))
    crossed = time[up] - z[up] * (time[up + 1] - time[up]) / (z[up + 1] - z[up])
    return float(np.diff(crossed).mean())


# ---------------------------------------------------------------------------------------------- legs


def humanoid_and_ball(settings: SimulatorsWorldSettings) -> Found:
    """Kick the ball, which then has the momentum of the impulses and rolls."""
    record = ("base_q", "base_qd", "contact_force", "pair", "pair_force", "pair_normal_force", "pair_gap")
    law, mass, radius = load_controller("humanoid_and_ball"), 0.2, 0.05
    momenta, speeds, rolling = [], [], []
    for h in (1e-3, settings.timestep):
        scene = compile_scene(load_scene("humanoid_and_ball"), "mipsd", integrator="midpoint", timestep=h)
        run = simulate(scene, 1.2, record=record, record_interval=h, controller=law, estimate_error=False)
        ball, time = run["ball"], run["time"]
        speed = _velocities(ball)[:, 0]
        ground = np.trapezoid(ball["contact_force"].reshape(-1, 3)[:, 1], time)
        momenta.append(float(run.contact("ball", "humanoid").impulse[-1, 0] + ground) / mass / float(speed[-1]))
        spin = rotation_from_quaternion(_places(ball)[-1, 3:]) @ _velocities(ball)[-1, 3:]
        rolling.append(float(radius * spin[1] / speed[-1]))
        speeds.append((time, speed))
    rows = [
        Row("humanoid and ball", "sum of impulses over momentum", "", 1.0, momenta[0], momenta[1], DEFAULT),
        Row("humanoid and ball", "radius times spin over speed", "", 1.0, *rolling),
    ]
    time, speed = speeds[0]
    last = time[[0, -1]], np.full(2, momenta[0] * speed[-1])
    return rows, [Course("kicked ball", "time [s]", "speed [m/s]", speeds[0], last)]


# ---------------------------------------------------------------------------------------------- report


def check(result: SimulatorsWorldResult) -> list[Claim]:
    """Return a claim for each robot that the paper says can be simulated, with the errors of its quantities."""
    return [_claim(robot, [row for row in result.rows if row.robot == robot]) for robot in _robots(result.rows)]


def _robots(rows: Iterable[Row]) -> list[str]:
    return list(dict.fromkeys(row.robot for row in rows))


def _claim(robot: str, rows: list[Row]) -> Claim:
    text = "; ".join(
        f"{row.quantity} {row.exact:.4g} {row.unit}".rstrip() + f" to {row.errors[0]:.0e}, {row.errors[1]:.0e}"
        for row in rows
    )
    bar = max(row.bar for row in rows)
    return Claim(
        claim=f"SimTwo defines many kinds of robots: {robot}",
        item="Section 2",
        paper="no number",
        ours=text,
        holds=True,
        verdict=classify(all(row.agrees for row in rows)),
        why=f"Rule: the run with the default tolerance is within {DEFAULT:g} of the closed form, that by error control "
        f"within {bar:g}; both errors stand in this order. featherstone-gait reproduce simulators_world",
    )


@look()
def plot(result: SimulatorsWorldResult) -> dict[str, Figure]:
    """Draw each scene beside its closed form, and the errors of all rows."""
    return {
        "Scenes of the package (points, default tolerance) and their closed forms (lines).": _courses(result.courses),
        "Errors of all quantities, relative to the closed form; bars: what they may be.": _errors(result.rows),
    }


def _courses(courses: tuple[Course, ...]) -> Figure:
    figure, panels = subplots(10.0, 5.2, 2, (len(courses) + 1) // 2)
    for axes, course in zip(panels.flat, courses):
        every = max(1, len(course.found[0]) // 40)
        axes.plot(*course.exact, color=BLUE, linewidth=1.5)
        axes.plot(course.found[0][::every], course.found[1][::every], ".", color=ORANGE, markersize=4)
        axes.set(title=course.title, xlabel=course.across, ylabel=course.along)
    for axes in panels.flat[len(courses) :]:
        axes.set_visible(False)
    panels.flat[0].set_aspect("equal", adjustable="box")
    return figure


def _errors(rows: tuple[Row, ...]) -> Figure:
    figure, axes = subplots(8.0, 0.6 + 0.25 * len(rows))
    places = np.arange(len(rows))
    for k, (color, label, bars) in enumerate(
        ((ORANGE, "default tolerance", [DEFAULT] * len(rows)), (BLUE, "error control", [row.bar for row in rows]))
    ):
        how: dict[str, Any] = {"color": color, "markersize": 8 - 4 * k, "markerfacecolor": color if k else "none"}
        axes.plot([max(row.errors[k], 1e-13) for row in rows], places, "o", label=label, **how)
        axes.plot(bars, places, "|", color=color, markersize=11)
    axes.set(xscale="log", xlim=(5e-14, 1e-2), xlabel="relative error, at least 1e-13")
    axes.set_yticks(places, [f"{row.robot}: {row.quantity}" for row in rows])
    axes.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=2)
    return figure
