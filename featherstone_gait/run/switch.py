"""Make and break loops in a state, and command surfaces, between two runs or steps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import real, shown, truth
from ..core.step.closure import make_loop
from ..model import LARGEST
from ..scene.compile import CompiledScene
from .start import check_scene, checked_state, gaps_and_speeds, loop_names, scratch_of_loops
from .trajectory import Trajectory

WITHIN = 1e-3  # gap at which a loop is made [m or rad]


def switch_loop(
    scene: CompiledScene, state: ArrayLike | Trajectory, name: str, closed: bool, within: float = WITHIN
) -> np.ndarray:
    """Make or break a loop in a state, from which a run then goes on.

    A loop that is made takes the place where it is: what was open of it stays.  A weld with ``within=math.inf`` so
    holds what a gripper has got hold of.  Velocities change as in a plastic impact, and the energy that it takes is
    added to the channel `loop_loss`.

    Parameters
    ----------
    scene
        A compiled scene.
    state
        State (size,), or a run that has ended.
    name
        Name of the loop; of a robot of several "robot/loop".
    closed
        Whether to make it or to break it.  A loop that is so already stays as it is.
    within
        Largest gap at which it is made [m or rad]; of a rod the difference from its length.

    Returns
    -------
    ndarray
        State (size,).

    Raises
    ------
    ValueError
        For unknown names, a gap that is too large, and loops that cannot all be closed there.
    """
    check_scene(scene)
    y = checked_state(scene, state).copy()
    loop_names(scene, [name], "name")
    truth("closed", closed)
    within = real("within", within, 0.0, math.inf, "1e-3 is usual, math.inf closes it anywhere")
    model, view = scene.model, scene.state_view(y)
    c = next(k for k, loop in enumerate(model.loops) if loop.name == name)
    if bool(view.loop_closed[c]) == closed:
        return y
    view.loop_closed[c] = 0.0
    if not closed:
        return y
    fluid = scene.constants.fluid
    if fluid is not None and fluid.added is not None:
        raise ValueError(
            f"{model.name}: loop {name!r} would be made by an impact that knows no added mass of a fluid; begin with "
            "it closed, or leave added_mass, added_inertia and added_matrix out"
        )
    first = sum(loop.rows for loop in model.loops[:c])
    gap = float(np.abs(gaps_and_speeds(scene, y)[0, first : first + model.loops[c].rows]).max())
    if not gap <= within:
        raise ValueError(
            f"{model.name}: loop {name!r} is open by {gap:.6g} m or rad, more than within={within:g}: bring its ends "
            "together, or allow more"
        )
    constants, missed = scene.constants, scene.part("newton_iterations")[0] + 1
    before = y[missed]
    make_loop(c, constants.loops, constants, scene.places, scratch_of_loops(scene), y)
    if y[missed] > before:
        raise ValueError(f"{model.name}: loop {name!r} does not close beside the other loops; break one of these first")
    return y


def command_surface(scene: CompiledScene, state: ArrayLike | Trajectory, drive: str, command: float) -> np.ndarray:
    """Set the command of a drive of surfaces in a state, from which a run then goes on.

    Parameters
    ----------
    scene
        A compiled scene.
    state
        State (size,), or a run that has ended.
    drive
        Name of the drive, one of `CompiledScene.surface_drives`; of a scene of several "name/drive".
    command
        What the motion of its surfaces is multiplied by [-].

    Returns
    -------
    ndarray
        State (size,).

    Raises
    ------
    ValueError
        For unknown names, and commands that are not finite.
    """
    check_scene(scene)
    y = checked_state(scene, state).copy()
    k = drive_number(scene, drive)
    scene.state_view(y).surface_command[k] = checked_command(command)
    return y


def checked_command(command: Any) -> float:
    """Return the command of a drive of surfaces; ValueError unless it is a finite number."""
    return real("command", command, -LARGEST, LARGEST, "1 moves surfaces as stated, 0 holds them")


def drive_number(scene: CompiledScene, drive: str) -> int:
    """Return the number of a drive of surfaces; ValueError where the scene has none of that name."""
    if drive not in scene.surface_drives:
        known = ", ".join(map(repr, scene.surface_drives)) or "none: give shapes a Surface"
        raise ValueError(f"{scene.model.name}: there is no drive of surfaces {shown(drive)}; there are {known}")
    return scene.surface_drives.index(drive)
