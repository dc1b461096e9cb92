"""Simulate a robot, and plot its motion.

One with a fixed base swings freely, or with --servo or --gearbox is pulled to zero; one with a floating base stands on
the ground.

Writes ROBOT_simulation.npz (recorded channels), .json (status, settings, measures) and .png (motion and plots).  Of a
scene's file, or with --pairs, all members are simulated from where they stand, and a page, .html, shows them.

Takes a second or two, and the first time that a kind of robot is simulated up to half a minute to compile.

  featherstone-gait simulate arm7 --gearbox mipsd
  featherstone-gait simulate humanoid --duration 5 --out standing
  featherstone-gait simulate dog.urdf --base floating --servo generic
  featherstone-gait simulate bench.toml --pairs all
"""

from __future__ import annotations

import math
import re
import textwrap
import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ..base.files import complete
from .arguments import (
    LINE,
    Commands,
    add_command,
    add_robot,
    choice,
    gearbox_line,
    gearbox_of,
    ground,
    output,
    robot_of,
)
from .scenes import add_pairs, scene_in, simulate_scene

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from ..model import Model
    from ..run.trajectory import Trajectory
    from ..scene.compile import CompiledScene

SWING, PULL = 0.5 * math.pi, 0.1  # where the first joint starts, without and with servos [rad]
AT_REST = 1e-6  # acceleration of a robot that balances [rad/s^2 or m/s^2]
SAMPLE = 2e-3  # time between records, in whole steps [s]


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    add_robot(parser, "; none for a fixed base without --servo or --gearbox")
    duration = "simulated time [s] (default: 2; without servos and ground 1)"
    parser.option("--duration", duration, type=float, metavar="S")
    integrator = "name of the integrator (default: chosen for the robot; a wrong name lists all)"
    parser.option("--integrator", integrator, metavar="NAME")
    parser.option("--timestep", "time step [s] (default: chosen, and printed)", type=float, metavar="S")
    parser.option("--rtol", "error allowed in a step (default: chosen for the robot)", type=float, metavar="R")
    add_pairs(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    start = time.perf_counter()
    from ..scene.actuator import usual_gearbox
    from ..scene.compile import compile_scene
    from ..view.style import look

    scene_model = scene_in(args, args.robot)
    if scene_model is not None:
        return simulate_scene(args, scene_model)
    model, contacts, said = robot_of(args, args.robot)
    gearbox = gearbox_of(args, usual_gearbox(model) if model.base == "floating" or args.servo else None)
    if gearbox is not None and args.gearbox is None:
        said.append(gearbox_line(gearbox))
    scene = compile_scene(model, gearbox, ground(model), args.integrator, args.timestep)
    for line in said:
        print(_filled(line))
    duration = args.duration if args.duration is not None else (1.0 if _is_free(scene) else 2.0)
    text, simulated = _experiment(scene, args.rtol)
    simulated(scene, scene.timestep)  # compiles, or loads what an earlier process compiled
    ready = time.perf_counter()
    simulated(scene, duration)
    done = time.perf_counter()
    trajectory = simulated(scene, duration, estimate_error=True)
    measures = _measures(scene, trajectory) | {
        "seconds_until_ready": ready - start,
        "seconds_per_simulated_second": (done - ready) / max(trajectory.end_time, scene.timestep),
    }
    trajectory.info.update(start=text, joints=model.joint_names, measures=measures, source=model.source)
    trajectory.info.update(contacts=contacts, locked=dict(model.locked), ground=scene.ground and asdict(scene.ground))
    path = output(args, "simulation")
    trajectory.save(path)
    plotting = time.perf_counter()
    with look(), complete(output(args, "simulation.png")) as temporary:
        _figure(scene, trajectory, text).savefig(temporary, dpi=120)
    measures["seconds_of_plotting"] = time.perf_counter() - plotting
    lines = [*_summary(scene, trajectory, duration), f"files       {path}.npz, .json, .png"]
    print("\n".join(_filled(line) for line in lines))
    return 0 if trajectory.ok else 1


def _filled(line: str) -> str:
    """Wrap a line for a terminal; units stay with their numbers."""
    kept = re.sub(r"(?<=\d) (?=(ms|mm|s|J|rad)\b)", "\N{NO-BREAK SPACE}", line)
    text = textwrap.fill(kept, LINE, subsequent_indent=" " * 12, break_long_words=False)
    return text.replace("\N{NO-BREAK SPACE}", " ")


def _is_free(scene: CompiledScene) -> bool:
    """Return whether only gravity, friction and stops act; then energy shows how exact the run is."""
    return scene.gearbox is None and scene.ground is None


def _experiment(scene: CompiledScene, rtol: float | None) -> tuple[str, Callable[..., Trajectory]]:
    """Describe the experiment, and make the function run(scene, duration) that simulates it."""
    from ..dynamics.inverse_kinematics import close_loops
    from ..model.rest_posture import nearest_posture
    from ..run.reference import Reference
    from ..run.simulate import initial_state, simulate
    from ..scene.contact import standing_height

    model, reference = scene.model, None
    home = model.single_positions(nearest_posture(model))
    if scene.ground is not None:
        q, where = _standing(model, home)
        q[2] = standing_height(model, scene.ground, q)
        doing = f"servos hold all joints {where}" if scene.gearbox else f"all joints limp, at first {where}"
        text, state = f"{model.name} stands on the ground, {doing}", initial_state(scene, q)
    else:
        q, posture = _swinging(scene, home, PULL if scene.gearbox else SWING)
        moves = "falls" if model.base == "floating" else "swings"
        text = f"{model.name} {moves} freely from rest, {posture}"
        if scene.gearbox:
            goal = "the posture nearest to zero" if home.any() else "zero"
            does = "falls freely, and is pulled" if model.base == "floating" else "is pulled"
            reference, text = Reference([0.0], home[None]), f"{model.name}, {posture}, {does} to {goal} by its servos"
        state = initial_state(scene, close_loops(model, q, hold_base=True) if model.loops else q)
    sample = max(1, round(SAMPLE / scene.timestep)) * scene.timestep
    record = ["q", "qd", "torque", "energy"]
    record += ["base_q", "base_qd"] if model.base == "floating" else []
    record += ["contact_force"] if scene.ground else []

    def run(scene: CompiledScene, duration: float, **how: Any) -> Trajectory:
        return simulate(scene, duration, state, reference, record=record, record_interval=sample, rtol=rtol, **how)

    return text, run


def _standing(model: Model, home: np.ndarray) -> tuple[np.ndarray, str]:
    """Choose the posture (nq,) of a robot on the ground, over the origin, and say where the joints are."""
    import numpy as np

    from ..model.numpy_dynamics import at_joints
    from ..model.rest_posture import standing_keyframe

    q = standing_keyframe(model)
    if q is not None:
        return np.array([0.0, 0.0, *q[2:]]), "as in its keyframe"
    return at_joints(model, home), _where(home)


def _where(home: np.ndarray) -> str:
    return "as near to zero as their limits allow" if home.any() else "at zero"


def _swinging(scene: CompiledScene, home: np.ndarray, angle: float) -> tuple[np.ndarray, str]:
    """Choose the start: the first joint, if it turns, at `angle` or its limit, the others at home."""
    import numpy as np

    from ..dynamics import forward_dynamics

    model, still, posture = scene.model, np.zeros(scene.model.nv), f"all joints {_where(home)}"
    if not model.moving_joints or model.moving_joints[0].type == "prismatic":
        return _first_at(scene, home, None), posture
    joint = model.moving_joints[0]
    first = min(max(angle, joint.lower), joint.upper)
    q = _first_at(scene, home, first)
    if model.base == "fixed" and np.abs(forward_dynamics(model, q, still, still)).max() < AT_REST:
        first = min(max(0.5 * angle, joint.lower), joint.upper)  # it would not move from upright
        q = _first_at(scene, home, first)
    posture = f"{joint.name} at {math.degrees(first):.4g} deg, all others {_where(home)}"
    if scene.tree.coupling is not None and (model.single_positions(q)[1:] != home[1:]).any():
        posture += " or as they follow others"
    return q, posture


def _first_at(scene: CompiledScene, home: np.ndarray, angle: float | None) -> np.ndarray:
    """Return q (nq,) with the first joint at an angle [rad], a ball joint turned by it about x, the others at home."""
    from ..dynamics.tree import followed
    from ..model.numpy_dynamics import at_joints

    joints = home.copy()
    if angle is not None and scene.model.moving_joints[0].type != "ball":
        joints[0] = angle
    q = at_joints(scene.model, followed(scene.tree.coupling, joints))
    if angle is not None and scene.model.moving_joints[0].type == "ball":
        q[scene.model.position_slices[0]] = math.cos(0.5 * angle), math.sin(0.5 * angle), 0.0, 0.0
    return q


def _measures(scene: CompiledScene, trajectory: Trajectory) -> dict[str, Any]:
    """Measure how exact the run is, and what it shows."""
    import numpy as np

    error = trajectory.error or {}
    measures: dict[str, Any] = {"error_estimate": float(error["q"].max(initial=0.0))}
    if _is_free(scene):
        drift, kinetic = _drift(scene, trajectory)
        measures |= {"energy_error_J": float(np.abs(drift).max()), "kinetic_energy_J": float(kinetic.max())}
    if scene.gearbox:
        from ..core.step.state import BY_NAME

        spent = trajectory["energy"][-1].sum(axis=0)
        measures["energy_J"] = dict(zip(BY_NAME["energy"].labels, map(float, spent)))
    if scene.ground:
        shift = np.linalg.norm(trajectory["base_q"][:, :3] - trajectory["base_q"][0, :3], axis=1)
        weight = scene.model.mass * float(np.linalg.norm(scene.gravity))
        measures["base_shift_m"] = float(shift.max())
        measures["ground_force_by_weight"] = float(trajectory["contact_force"][-1, :, 0].sum() / weight)
    return measures


def _drift(scene: CompiledScene, trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Compute the energy change that friction and stops do not explain, and the kinetic energy, at each sample [J]."""
    import numpy as np

    from ..core.effects.energies import FRICTION, STOPS
    from ..dynamics import energy
    from ..run.trajectory import positions

    base = [trajectory["base_qd"]] if scene.model.base == "floating" else []
    kinetic, potential = energy(scene.model, positions(trajectory), np.hstack([*base, trajectory["qd"]])).T
    spent = trajectory["energy"].sum(axis=1)
    total = kinetic + potential + spent[:, FRICTION] + spent[:, STOPS]
    return total - total[0], kinetic


def _summary(scene: CompiledScene, trajectory: Trajectory, duration: float) -> list[str]:
    m = trajectory.info["measures"]
    lines = [
        f"simulated   {trajectory.info['start']}: {duration:g} s",
        f"status      {trajectory.status}{': ' if trajectory.message else ''}{trajectory.message}",
        f"integrator  {choice(scene)}",
        *(f"note        {note}" for note in scene.notes),
    ]
    if "energy_error_J" in m:
        share = f", {m['energy_error_J'] / m['kinetic_energy_J']:.1e} of" if m["kinetic_energy_J"] > 0 else ";"
        lines.append(
            f"energy      off by at most {m['energy_error_J']:.1e} J{share} the largest kinetic energy, "
            f"{m['kinetic_energy_J']:.3g} J"
        )
    if "energy_J" in m:
        lines.append("energy      " + ", ".join(f"{k} {v:.3g}" for k, v in m["energy_J"].items()) + " J")
    if "base_shift_m" in m:
        shift, force = 1e3 * m["base_shift_m"], m["ground_force_by_weight"]
        lines.append(f"ground      base moves by at most {shift:.3g} mm; ground carries {force:.4f} of the weight")
    return [
        *lines,
        f"error       of the joints, estimated by {'a tenth of the tolerance' if scene.adaptive else 'half the step'}: "
        f"at most {m['error_estimate']:.1e} rad or m",
        f"time        {1e3 * m['seconds_per_simulated_second']:.2f} ms per simulated second; ready to run after "
        f"{m['seconds_until_ready']:.2f} s, plot {m['seconds_of_plotting']:.2f} s",
    ]


def _figure(scene: CompiledScene, trajectory: Trajectory, text: str) -> Figure:
    """Plot the motion on the left, and joints and energy error or forces on the right."""
    from matplotlib.figure import Figure

    from ..view.plotting import plot, plot_motion
    from ..view.style import BAD, BLUE

    figure = Figure(figsize=(11.0, 5.5), layout="constrained")
    left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=(1.0, 1.2))[0]
    motion = left.subplots()
    plot_motion(scene.model, trajectory, motion, view="xz")
    motion.set_title("dark: start, light: end")
    if scene.ground:
        motion.axhline(scene.ground.height, color="0.2", linewidth=0.8)
    panels = right.subplots(2, sharex=True)
    if _is_free(scene):
        plot(trajectory, "q", axes=panels[0])
        drift, kinetic = _drift(scene, trajectory)
        panels[1].plot(trajectory["time"], drift / (kinetic.max() or 1.0), color=BLUE)
        panels[1].set(xlabel="time [s]", ylabel="energy error by\nlargest kinetic energy")
    else:
        plot(trajectory, "q", "contact_force" if scene.ground else "torque", axes=panels)
    panels[0].set(xlabel="", ylabel="joints [rad or m]")
    wrong = "" if trajectory.ok else f": {trajectory.status}"
    ended = f" at {trajectory.end_time:.3g} s" if trajectory.failed else ""
    figure.suptitle(f"{text}{wrong}{ended}", color="black" if trajectory.ok else BAD, parse_math=False)
    return figure
