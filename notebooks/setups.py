"""Robots, runs and colors that several notebooks share."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from featherstone_gait import (
    Reference,
    Trajectory,
    compile_scene,
    initial_state,
    load_robot,
    mass_matrix,
    simulate_batch,
)
from featherstone_gait.model import Gearbox, Model
from featherstone_gait.optimize.planning import walking_cost
from featherstone_gait.robot_file import gearbox_presets
from featherstone_gait.scene.compile import GearboxKind, IntegratorName
from featherstone_gait.view.style import look
from featherstone_gait.walking.cost import WalkingCost

COLORS = {"standard": "C1", "mipsd": "C0", "rotor": "C2"}  # of servo models, the same in all figures


def scale_masses(model: Model, times: ArrayLike) -> Model:
    """Scale the masses and inertias of the links; times: a factor, or one for each link."""
    links = [
        replace(x, mass=float(m) * x.mass, inertia=tuple(float(m) * i for i in x.inertia))
        for x, m in zip(model.links, np.broadcast_to(times, len(model.links)))
    ]
    return replace(model, links=tuple(links))


def draw_angles(panels: dict, sharey: bool = True, ylabel: str = "angle [deg]"):
    """Draw the first joint of runs over time, with legends below; panels: title -> label -> run.  Return the axes."""
    with look():
        _, axes = plt.subplots(1, len(panels), figsize=(10.5, 3.4), sharey=sharey, layout="constrained")
        for one, (title, runs) in zip(axes, panels.items()):
            for (label, run), style in zip(runs.items(), ("-", "--", ":", "-.")):
                one.plot(run["time"], np.degrees(run["q"][:, 0]), style, label=label)
            one.set(title=title, xlabel="time [s]")
            one.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)
        axes[0].set_ylabel(ylabel)
    return axes


# ------------------------------------------------------- the paper's arm of seven joints, Figs. 7 to 10

Link = float | tuple[float, float]  # mass [kg] and length [m] of the links; one number stands for both
AX12 = (0.055, 0.05)  # of the size of a bare AX-12
TILTS = np.random.default_rng(0).standard_normal((3, 10))  # directions of tilts, the same for all arms
FALLEN = 100.0  # [deg^2] an arm whose lowest joint is farther off does not stand


@functools.cache
def _parts() -> tuple[Model, dict[str, Gearbox]]:
    return load_robot("arm7"), gearbox_presets("ax12")


def arm(
    link: Link = 0.1,
    Kp: float = 61.0,
    ratio: float = 254.0,
    joints: int = 7,
    rotor_inertia: float = 1e-7,
    preset: str = "physical",
) -> Model:
    """Return the robot `arm7` with other links and servos; the defaults are its own.

    Parameters
    ----------
    link
        Mass [kg] and length [m] of each link; one number stands for both.
    Kp
        Gain of the servos [V/rad].
    ratio, rotor_inertia
        Of the gears [-], and of the rotors before them [kg m^2].
    joints
        From the base on; from the eighth on each is like the seventh.
    preset
        Spring and damper of the gears: a name in `robots/servos/ax12.toml`.
    """
    robot, presets = _parts()
    mass, length = np.broadcast_to(link, 2) / 0.1  # over those of the robot, 0.1 kg and 0.1 m
    links = [
        replace(
            part,
            mass=float(mass * part.mass),
            center_of_mass=_times(length, part.center_of_mass),
            inertia=_times(mass * length**2, part.inertia),
        )
        for part in robot.links
    ]
    axes = [replace(axis, xyz=_times(length, axis.xyz)) for axis in robot.joints]
    for k in range(len(axes) + 1, joints + 1):
        links.append(replace(links[-1], name=f"link{k}"))
        axes.append(replace(axes[-1], name=f"joint{k}", parent=links[-2].name, child=links[-1].name))
    servo = next(iter(robot.servos.values()))  # the same in every joint
    gearbox = replace(presets[preset], ratio=ratio, rotor_inertia=rotor_inertia)
    servo = replace(servo, controller=replace(servo.controller, Kp=Kp), gearbox=gearbox)
    servos = {axis.name: servo for axis in axes[:joints]}
    return replace(robot, links=tuple(links[: joints + 1]), joints=tuple(axes[:joints]), servos=servos)


def without_static_friction(robot: Model) -> Model:
    """Return an arm whose servos have only viscous friction."""
    return replace(robot, servos={name: replace(x, coulomb_friction=1e-30) for name, x in robot.servos.items()})


def _times(factor: float, numbers: Sequence[float]) -> tuple[float, ...]:
    return tuple(float(factor * x) for x in numbers)


def release(
    arms: Sequence[Model],
    starts: ArrayLike,
    gearbox: GearboxKind = "standard",
    step: float = 1e-3,
    integrator: IntegratorName = "simtwo",
    duration: float = 20.0,
) -> list[list[Trajectory]]:
    """Release arms that are to stand upright, all in one batch.

    Parameters
    ----------
    arms
        Robots that `arm` returns.
    starts
        Angles (starts, joints) at the start [rad]; each arm takes the first of its number of joints.
    gearbox, step, integrator
        As `compile_scene` takes them; "simtwo" at 1 ms is the paper's program.
    duration
        Of each run [s].

    Returns
    -------
    list of list of Trajectory
        For each arm the run from each start.
    """
    scenes = [compile_scene(one, gearbox, integrator=integrator, timestep=step) for one in arms]
    jobs = [(scene, np.asarray(q)[: len(scene.model.joint_names)]) for scene in scenes for q in starts]
    runs = simulate_batch(
        [scene for scene, _ in jobs],
        duration,
        [initial_state(scene, q) for scene, q in jobs],
        [Reference([0.0], np.zeros((1, len(q)))) for _, q in jobs],
        record=("q",),
        estimate_error=False,
    )
    return [runs[k : k + len(starts)] for k in range(0, len(runs), len(starts))]


def hold(
    arms: Sequence[Model], *how: Any, tilts: Sequence[float] = (0.01,), duration: float = 20.0, directions: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """Hold arms upright from random tilts.

    Parameters
    ----------
    arms, *how
        Robots, gearbox, step and integrator, as `release` takes them.
    tilts
        Standard deviations of the joints' angles at the start [rad].
    duration
        Of a run [s]; its second half is measured.
    directions
        Number of `TILTS` from which each arm is released.

    Returns
    -------
    squares : ndarray (arms, tilts)
        Mean square of the lowest joint's angle [deg^2], median over the directions; infinite where runs end early.
    shakes : ndarray (arms, tilts) of bool
        Whether speeds alternate from step to step, or a run ends early, in any direction.
    """
    starts = np.multiply.outer(tilts, TILTS[:directions]).reshape(-1, 10)
    runs = release(arms, starts, *how, duration=duration)
    squares = [[_square(run, duration) for run in of_arm] for of_arm in runs]
    shakes = [[run.status != "ok" for run in of_arm] for of_arm in runs]
    shape = len(arms), len(tilts), directions
    return np.median(np.reshape(squares, shape), axis=2), np.reshape(shakes, shape).any(axis=2)


def _square(run: Trajectory, duration: float) -> float:
    late = run["q"][run["time"] > 0.5 * duration, 0]
    return float(np.mean(np.degrees(late) ** 2)) if run.status in ("ok", "chatter") else np.inf


def holds(arms: Sequence[Model], *how: Any, **more: Any) -> np.ndarray:
    """Return which arms (arms,) stand and do not shake; arguments as for `hold`."""
    squares, shakes = hold(arms, *how, **more)
    return ((squares < FALLEN) & ~shakes).all(axis=1)


def stand(arms: Sequence[Model], **how: Any) -> np.ndarray:
    """Return which arms (arms, tilts) their servos can hold: they stand with the standard gear and an implicit step."""
    return hold(arms, "standard", 1e-3, "implicit_euler", **how)[0] < FALLEN


def least_inertia(robot: Model) -> float:
    """Return the least eigenvalue of the mass matrix of an upright arm [kg m^2]."""
    return float(np.linalg.eigvalsh(mass_matrix(robot, np.zeros(len(robot.joint_names))))[0])


def needed_inertia(robot: Model, step: float) -> float:
    """Return the least inertia [kg m^2] with which an explicit step [s] is stable against the motor's brake.

    The back-EMF brakes a joint like a damper B = (G k)^2 / R: I > h B / 2, less if the step resolves the current.
    """
    servo = robot.servos["joint1"]
    brake = (servo.gearbox.ratio * servo.motor_constant) ** 2 / servo.resistance
    return 0.5 * step * brake * np.tanh(0.5 * step * servo.resistance / servo.inductance)


def onsets(
    pairs: Sequence[tuple[Link, float]], cause: str, values: Sequence[float], steps: Sequence[float]
) -> dict[str, bool | None]:
    """Return whether arms shake with the standard gear from some gear ratio or number of joints on, and not before.

    Parameters
    ----------
    pairs
        Link and gain of each arm.
    cause, values
        "ratio" or "joints", and its values in order.  Those count with which the arm stands.
    steps
        Of the program [s].

    Returns
    -------
    dict
        By the name of the arm; None where it never stands.
    """
    arms = [arm(*pair, **{cause: value}) for pair in pairs for value in values]
    stands = stand(arms, duration=8.0, directions=1).reshape(len(pairs), -1)
    found = {}
    for step in steps:
        shakes = hold(arms, "standard", step, duration=4.0, directions=1)[1].reshape(len(pairs), -1)
        for pair, x in zip(pairs, [one[so] for one, so in zip(shakes, stands)]):
            so = bool(x[-1] and (np.diff(x.astype(int)) >= 0).all()) if len(x) else None
            found[arm_name(*pair, step=step)] = so
    return found


def passed_on(arms: Sequence[Model], joint: int, gearbox: GearboxKind) -> np.ndarray:
    """Put 1e-9 rad on one joint; return by how much each other joint comes to differ in 2 s, at least, over that."""
    start = 0.01 * TILTS[0, :7]
    runs = release(arms, [start, start + 1e-9 * np.eye(7)[joint]], gearbox, duration=2.0)
    apart = [np.abs(nudged["q"] - run["q"]).max(axis=0) / 1e-9 for run, nudged in runs]
    return np.delete(apart, joint, axis=1).min(axis=1)


def draw_line(panel: Axes, step: float) -> None:
    """Draw the least inertia of arms, without and with rotors, and what standard model and MIPSD need at a step [s]."""
    lengths, gear = np.linspace(0.05, 0.15, 40), _parts()[1]["physical"]
    least = np.array([least_inertia(arm(length)) for length in lengths])
    panel.semilogy(lengths, least, color=COLORS["standard"], label="arm")
    panel.semilogy(lengths, least + gear.rotor_inertia * 254.0**2, color=COLORS["rotor"], label="arm with rotors")
    panel.plot(AX12[1], least_inertia(arm(AX12)), "o", color=COLORS["standard"], label="of an AX-12's size")
    needed = {"standard": needed_inertia(arm(), step), "mipsd": 0.25 * step**2 * gear.stiffness}
    for name, inertia in needed.items():
        panel.axhline(inertia, color=COLORS[name], ls="--", lw=1, label=f"{name} needs")
    panel.set(xlabel="link [kg and m]", ylabel="inertia [kg m²]", ylim=(1e-6, 1), title=f"steps of {1e3 * step:g} ms")
    panel.legend(ncols=2, fontsize=8, frameon=False)


def within(found: Sequence[float], paper: Sequence[float], factor: float = 3.0) -> bool:
    """Return whether each number is the paper's within a factor."""
    return bool(np.abs(np.log(np.divide(found, paper))).max() < np.log(factor))


def arm_name(link: Link, Kp: float, *more: str, tilt: float = 0.01, step: float = 1e-3) -> str:
    """Return an arm and how it was held in words."""
    return ", ".join((f"{np.ravel(link)[0]:g} kg, {Kp:g} V/rad, {tilt:g} rad, {1e3 * step:g} ms", *more))


def planned_walk(**how: Any) -> WalkingCost:
    """Plan the walk of the paper's ten-joint humanoid; how: options of `walking_cost`."""
    return walking_cost(load_robot("humanoid", locked="simplified"), **how)


def recompiled(cost: WalkingCost, model: Model | None = None, **arguments: Any) -> WalkingCost:
    """Return the walk with another model or other arguments of `compile_scene`."""
    return replace(cost, scene=cost.scene.recompiled(model, **arguments))
