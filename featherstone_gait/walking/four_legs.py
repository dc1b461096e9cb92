"""Strides of robots on four legs: a trot or a walk, by inverse kinematics of point feet.

    mirror = mirror_by_place(robot, posture)
    stride = four_legged_stride(robot, posture, Pattern(period=0.48, step=0.05, lift=0.03))
    gait = fit_gait(stride, 8, mirror=mirror).gait
    cost = WalkingCost(scene, gait, posture, blend_strides=2)

The trunk goes forward evenly, upright and level.  A foot on the ground stays there; in the air it rises and falls on a
half sine and comes forward on a cubic that leaves and meets the ground with the speed of the ground.  The footfalls are
those of the trot (diagonal pairs together) or of the walk (one after the other: left hind, left fore,
right hind, right fore; M. Hildebrand, "Symmetrical gaits of horses", Science 150 (1965)), in which the trunk sways
away from the side that steps.  The second half of either stride is the first one's mirror image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, is_real, listed, one_of, shown
from ..base.fixed_order import applied
from ..base.portable_math import sincos
from ..dynamics import check_model, contact_positions_at
from ..model import Model
from .gait import TICK, Mirror, joint_places, mirrored_cosines, partner_by_place
from .inverse_kinematics import check_limits, reach
from .kinematics import link_index, link_poses
from .plan import Stride

Footfalls: TypeAlias = Literal["trot", "walk"]
PHASES = {"trot": (0.0, 0.5, 0.5, 0.0), "walk": (0.25, 0.75, 0.0, 0.5)}  # of a stride, lift-off of LF, RF, LH, RH
SAMPLES = 4  # a tick


@dataclass(frozen=True)
class Pattern:
    """Settings of a stride on four legs.

    Attributes
    ----------
    period : float
        Time of a stride [s].
    step : float
        Distance that the trunk travels in a stride [m].
    lift : float
        Height to which a foot is lifted [m].
    ground : float
        Duty factor: share of the stride for which a foot is on the ground [-].
    footfalls : {"trot", "walk"}
        Order of the feet.
    sway : float
        Sway of the trunk to either side [m].
    ahead : float
        Position of the trunk relative to the feet, ahead of that in the posture [m].
    """

    period: float = 0.48
    step: float = 0.05
    lift: float = 0.03
    ground: float = 0.6
    footfalls: Footfalls = "trot"
    sway: float = 0.0
    ahead: float = 0.0

    def __post_init__(self) -> None:
        one_of("pattern: footfalls", self.footfalls, get_args(Footfalls))
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "footfalls" and not (is_real(value) and abs(value) < 1e3):
                raise ValueError(f"pattern: {field.name} = {shown(value)} must be a finite number")
        if not (self.period > 0.0 and self.lift > 0.0):
            raise ValueError(f"pattern: period = {self.period} s and lift = {self.lift} m must be > 0")
        if not 0.0 < self.ground < 1.0:
            raise ValueError(f"pattern: ground = {self.ground} must lie between 0 and 1")
        if abs(round(self.period / (2 * TICK)) * 2 * TICK - self.period) > 1e-9:
            raise ValueError(f"pattern: period = {self.period} s must be a whole number of {2 * TICK:g} s")


def four_legged_stride(
    model: Model, posture: ArrayLike, pattern: Pattern | None = None, feet: Sequence[str] | None = None
) -> Stride:
    """Plan a stride of a robot on four legs.

    Parameters
    ----------
    model : Model
        The robot.
    posture : array_like, shape (nj,)
        Posture in which it stands [rad].
    pattern : Pattern, optional
        The settings.
    feet : sequence of str, optional
        Links of the left and right fore foot and the left and right hind foot; by default the four links with contact
        points, ordered by their positions.

    Returns
    -------
    Stride
        The stride, for `fit_gait`.

    Raises
    ------
    ValueError
        For a robot that does not have four feet, and for a stride out of reach.
    """
    pattern = pattern or Pattern()
    posture = finite("posture", posture, (len(check_model(model).joint_names),), "[rad]")
    links, places, points = _feet(model, posture, feet)
    n = SAMPLES * round(pattern.period / TICK)
    times = pattern.period / n * np.arange(n)
    turned = 2.0 * np.pi * times / pattern.period
    trunk = np.zeros((n, 3))
    trunk[:, 0], trunk[:, 1] = pattern.ahead, -pattern.sway * sincos(turned)[0]
    angles = np.tile(posture, (n, 1))
    for link, place, point, phase in zip(links, places, points, PHASES[pattern.footfalls]):
        target = place + _path(pattern, np.mod(times / pattern.period - phase, 1.0)) - trunk
        angles = reach(model, link, target, point=point, start=angles, times=times)
    check_limits(model, angles, times)
    return Stride(model.joint_names, times, angles, pattern.period, 0.0)


def mirror_by_place(model: Model, posture: ArrayLike | None = None) -> Mirror:
    """Pair the joints of `model` left to right by their positions, and compare their axes; see `mirror_of`.

    Parameters
    ----------
    model : Model
        The robot.
    posture : array_like, shape (nj,), optional
        Posture in which left and right are mirror images [rad]; by default zero.

    Returns
    -------
    Mirror
        The mirror image of its postures.

    Raises
    ------
    ValueError
        For a joint without a partner.
    """
    names = check_model(model).joint_names
    angles = finite("posture", np.zeros(len(names)) if posture is None else posture, (len(names),), "[rad]")
    places, axes = joint_places(model, angles)
    index, sign = [], []
    for k, name in enumerate(names):
        partner = partner_by_place(k, places, axes)
        if partner is None:
            raise ValueError(
                f"{model.name}: joint {name!r} in this posture has no partner that mirrors its position and axis"
            )
        index.append(partner)
        sign.append(float(np.sign(mirrored_cosines(axes[[partner]], axes[k])[0])))
    return Mirror(np.array(index), np.array(sign))


def _feet(
    model: Model, posture: np.ndarray, feet: Sequence[str] | None
) -> tuple[list[str], list[np.ndarray], list[np.ndarray]]:
    """Return the four feet, the positions of their points seen from the root (3,) and in the links' axes (3,)."""
    poses = link_poses(model, posture)
    points = contact_positions_at(model, poses)[0]
    owners = np.array([contact.link for contact in model.contacts])
    where = {str(link): points[owners == link].mean(axis=0) for link in dict.fromkeys(owners.tolist())}
    if feet is None:
        by_x = sorted(where, key=lambda link: -where[link][0])
        feet = [link for pair in (by_x[:2], by_x[2:]) for link in sorted(pair, key=lambda link: -where[link][1])]
    links = listed("feet", feet, "give the names of four links")
    if len(links) != 4 or not all(link in where for link in links):
        raise ValueError(f"model {model.name!r}: four feet with contact points are needed, got {links} of {[*where]}")
    rows = [link_index(model, link) for link in links]
    places = [where[link] for link in links]
    local = [applied(poses.rotation[0, row].T, place - poses.position[0, row]) for row, place in zip(rows, places)]
    return links, places, local


def _path(pattern: Pattern, phase: np.ndarray) -> np.ndarray:
    """Return a foot's path (n, 3) [m] about its position, seen from the moving trunk; in the air from phase 0."""
    air = 1.0 - pattern.ground
    stance = pattern.step * pattern.ground  # path of a foot under the trunk
    s = np.clip(phase / air, 0.0, 1.0)
    slope = -pattern.step * air  # of the swing by s, where it meets the ground's own speed
    swing = 2.0 * s * s * s - 3.0 * s * s
    x_air = stance * (-0.5 - swing) + slope * (2.0 * s * s * s - 3.0 * s * s + s)
    x_ground = stance * (0.5 - (phase - air) / pattern.ground)
    flies = phase < air
    path = np.zeros((len(phase), 3))
    path[:, 0] = np.where(flies, x_air, x_ground)
    path[:, 2] = np.where(flies, pattern.lift * sincos(np.pi * s)[0], 0.0)
    return path
