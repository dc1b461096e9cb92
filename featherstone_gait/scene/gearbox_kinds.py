"""Kinds of gearboxes and integrators that a scene can be compiled with; imports nothing heavy, for the command line."""

from __future__ import annotations

from typing import Literal, get_args

GearboxKind = Literal[
    "mipsd",  # spring-damper gearbox with rotor
    "rotor",  # rigid gearbox with the rotor's reflected inertia
    "standard",  # rigid gearbox without
]
IntegratorName = Literal[
    "implicit_euler", "midpoint", "rk4", "ars343", "extrapolation", "dop853",
    "simtwo",  # the order of updates of another program, for comparison
]  # fmt: skip
GEARBOX_KINDS: tuple[GearboxKind, ...] = get_args(GearboxKind)


def why_chosen(kind: GearboxKind) -> str:
    """Say in words of the command line why a kind was chosen where none is named."""
    return f"{kind}: {'all' if kind == 'mipsd' else 'not all'} gears are elastic (--gearbox)"
