"""The kinds of servos that a scene can be compiled with; imports nothing, so that the command line can name them."""

from __future__ import annotations

from typing import Literal, get_args

GearboxKind = Literal[
    "mipsd",  # spring-damper gearbox with rotor
    "rotor",  # rigid gearbox with the rotor's reflected inertia
    "standard",  # rigid gearbox without
]
GEARBOX_KINDS: tuple[GearboxKind, ...] = get_args(GearboxKind)
