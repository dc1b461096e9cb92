"""The arguments of `compile_scene`, checked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.arguments import instance, listed, real, vector
from ..base.rotation import dot
from ..dynamics.tree import GRAVITY
from ..model import Fluid, Ground, Loop, Model, Spring
from ..model.pair_contact import PairContact
from ..model.tree_checks import check_springs
from .gearbox_kinds import GearboxKind

LOWEST = 1e9  # standing heights: a limit at which nothing falls


class SceneOptions(NamedTuple):
    """The arguments of `compile_scene`, after the model; None where they are not given."""

    gearbox: GearboxKind | None
    ground: Ground | None
    integrator: str | None
    timestep: float | None  # [s]
    gravity: Sequence[float] | np.ndarray  # (3,) [m/s^2]
    fall_height: float  # share of the standing height
    fall_tilt: float  # [rad]
    springs: Sequence[Spring]
    pairs: PairContact | None = None
    loops: Sequence[Loop] = ()  # of a scene, between its members
    fluid: Fluid | None = None

    @property
    def g(self) -> float:
        """Strength of gravity [m/s^2]."""
        return math.sqrt(dot(self.gravity, self.gravity))

    @property
    def pressing(self) -> float:
        """Strength of the gravity whose weights make contacts as stiff as asked [m/s^2]: without any, the Earth's."""
        return self.g or math.sqrt(dot(GRAVITY, GRAVITY))


def check_options(model: Model, options: SceneOptions) -> SceneOptions:
    """Return the options with numbers as floats and arrays; raise ValueError where they make no sense."""
    instance("model", model, Model, "give what load_robot returns")
    if not model.nv:
        raise ValueError(
            f"{model.name}: its base is fixed and no joint moves; load it with base='floating', or lock fewer joints"
        )
    if options.ground is not None and not isinstance(options.ground, Ground):
        given = f"ground is {options.ground!r}; expected a Ground or None"
        raise ValueError(f"{model.name}: {given}: write ground=Ground()")
    if options.fluid is not None:
        instance(f"{model.name}: fluid", options.fluid, Fluid, "write fluid=Fluid(), or None")
    tilt, height = options.fall_tilt, options.fall_height
    tilt = real("fall_tilt", tilt, 0.0, 2.0 * math.pi, "give radians, as math.radians(45); pi disables it")
    height = real("fall_height", height, -LOWEST, 1.0, "it is a fraction of the standing height; 0 disables it")
    gravity = vector("gravity", options.gravity, 3, f"[m/s^2], on Earth {GRAVITY}")
    springs = tuple(listed("springs", options.springs, "give a list of Spring"))
    check_springs(model.links, springs)
    return options._replace(gravity=gravity, fall_height=height, fall_tilt=tilt, springs=springs)


def implicit_where_stiff(options: SceneOptions) -> SceneOptions:
    """Return the options of a scene whose bodies touch each other, which is stiff, with the integrator that is."""
    chosen = options.pairs is not None and options.integrator is None
    return options._replace(integrator="ars343") if chosen else options
