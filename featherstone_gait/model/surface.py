"""Surfaces that move on their bodies: conveyor belts, turntables and tracks."""

from __future__ import annotations

from dataclasses import dataclass

from ..base.brief import brief
from .checks import check, freeze, name_flaws, quantity, quantity_flaws, vector_flaws
from .links import Vector


@dataclass(frozen=True)
class Surface:
    """A surface that moves on its body, as that of a belt, a turntable or a track, while the body stays as it is.

    At the place x it has the velocity ``command * (velocity + turning x (x - center))``, of which friction sees the
    part along the plane of contact.  The command begins as stated; the state holds it, and it may change during a run.

    Attributes
    ----------
    velocity : tuple of float
        Velocity (3,) in the frame of the link [m/s].
    turning : tuple of float
        Angular velocity (3,) in the frame of the link [rad/s].
    center : tuple of float
        Where the velocity is `velocity` (3,), in the frame of the link [m].
    drive : str
        Name of what drives it.  Surfaces of one robot or object whose drives have one name share a command.  Empty: the
        name of the link.
    command : float
        What velocity and turning are multiplied by at the start [-].

    Raises
    ------
    ValueError
        For numbers that are not finite, and names that cannot be printed.
    """

    velocity: Vector = (0.0, 0.0, 0.0)
    turning: Vector = (0.0, 0.0, 0.0)
    center: Vector = (0.0, 0.0, 0.0)
    drive: str = ""
    command: float = quantity("finite", "-", 1.0, "1 moves as stated, 0 is at rest, -1 is backwards")

    __repr__ = brief

    def __post_init__(self) -> None:
        for name in ("velocity", "turning", "center"):
            check(vector_flaws("surface", name, getattr(self, name), 3))
        freeze(self, "velocity", "turning", "center")
        check(quantity_flaws("surface", self))
        if self.drive != "":
            check(name_flaws("surface: drive", self.drive))
