"""Check that servos, fluids and integrators suit the models of a scene."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from ..base.flaws import quoted
from ..core.effects.gear_friction import GearFriction
from ..core.integrate import INTEGRATORS
from ..core.integrate.integrator import Integrator
from ..model import Loop, Model
from .actuator import Drive
from .forest import Member
from .friction import Friction


def follows_references(model: Model) -> bool:
    """Return whether drives of tendons follow references."""
    return any(one.controller is not None and one.controller.Kp > 0 for one in model.tendons)


def check_drives(name: str, models: Iterable[Model], sampled: bool) -> None:
    """Raise ValueError where drives of tendons follow references that sampled servos see at ticks only."""
    if sampled and any(follows_references(model) for model in models):
        raise ValueError(
            f"{name}: controllers of tendons follow their references at every instant, and the servos of joints are "
            "sampled; give the joints torque laws ('pd', 'pd_clamped'), or the tendons Kp=0 and their forces as tau"
        )


def check_immersed(name: str, models: Iterable[Model], fluid: Any) -> None:
    """Raise ValueError for a fluid in which nothing is immersed."""
    if fluid is not None and not any(model.immersed for model in models):
        raise ValueError(
            f"{name}: the fluid acts on nothing, since no robot has immersed shapes; give Model.immersed, or "
            "[[immersed]] in the file beside the robot, or leave the fluid out"
        )


def check_ticks(members: Sequence[Member]) -> None:
    """Raise ValueError unless all sampled controllers have one period and lag."""
    found = {(m.scene.tick_steps * m.scene.timestep, m.scene.lag): m.name for m in members if m.scene.sampled}
    if len(found) > 1:
        each = ", ".join(f"{name!r} {period:g} s and {lag:g} s" for (period, lag), name in found.items())
        raise ValueError(f"scene: controllers differ in period and lag: {each}; give them the same")


def method_of(name: str, model: Model, drive: Drive, friction: Friction | None) -> Integrator:
    """Look up an integrator; raise ValueError if it does not suit the loops, the servos or their friction."""
    method = INTEGRATORS[name]
    open_tree = "simulate the open tree with dataclasses.replace(model, loops=())"
    check_closes(method, model.name, model.loops, open_tree)
    if method.drives and not isinstance(drive.actuator, method.drives):
        raise ValueError(f"{name} is the update order of sampled servos; use implicit_euler for other scenes")
    if method.drives and isinstance(friction, GearFriction):
        raise ValueError(f"{name} knows no friction that depends on load or speed; use another integrator")
    slow = drive.slow_current if method.soft else None
    if slow is not None:
        raise ValueError(
            f"{name} takes a current without inductance as being there at once, so a current_slew of {slow:g} A/s "
            "would have no effect; give the servo an inductance, or use ars343"
        )
    return method


def check_closes(method: Integrator, what: str, loops: Sequence[Loop], remedy: str) -> None:
    """Raise ValueError for an integrator that does not keep loops closed."""
    if loops and not method.closes:
        others = quoted([one.name for one in INTEGRATORS.values() if one.closes])
        raise ValueError(
            f"{what}: integrator {method.name!r} does not keep loops {quoted([loop.name for loop in loops])} closed; "
            f"use one of {others}, or {remedy}"
        )
