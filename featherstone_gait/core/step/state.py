"""The state of a simulation as one table of channels; layout, recording, units, plots and documentation read it.

The order of the table is the order in the flat state `y`, sorted by kind:

    coordinates   positions and velocities of the tree
    controlled    obeys a differential equation, and error control watches it
    integrated    obeys one too: integrals along the way, of which error control watches the meters alone
    held          changes at controller ticks, or a delay after them
    derived       output of the last step or evaluation; a smooth function of the state between discontinuities
    watched       diagnostics of the run
    run           what goes on with a run; not to be recorded
    computed      not in `y`: worked out from other channels when a run is recorded

A new channel is a row here; whatever writes it says `y[o.name + i]`.
"""

from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple

import numpy as np

from ..effects.energies import ENERGIES
from ..effects.fluid import WORKS
from ..effects.tendon import WORKS as TENDON_WORKS
from .pace import PACE

Kind = Literal["coordinates", "controlled", "integrated", "held", "derived", "watched", "run", "computed"]
ALL, NONE = "all", "none"  # of the members of a scene that have a channel


class Owner(NamedTuple):
    """The part of a scene to which the numbers of a channel belong."""

    what: str
    share: str = "joints"  # which part of a member it counts with, as in `shares` of a scene; ALL, or NONE


OWNERS = {
    "base": Owner("a floating base", "base"),
    "ball": Owner("a ball joint", "balls"),
    "joint": Owner("a joint"),
    "servo": Owner("a joint with a servo"),
    "rotor": Owner("a joint with a rotor"),
    "profile": Owner("a joint whose goal has a profile"),
    "delay": Owner("a joint whose voltages wait, as often as they do"),
    "fed": Owner("a joint that the supply feeds"),
    "source": Owner("the supply", ALL),
    "run": Owner("the run", ALL),
    "tree": Owner("a tree", "base"),
    "point": Owner("a contact point", "points"),
    "rolling": Owner("a contact point, if any resists rolling", "points"),
    "slot": Owner("a slot for a point of a pair that touches", NONE),
    "turning": Owner("a slot, if any pair resists rolling", NONE),
    "pairs": Owner("all pairs together", NONE),
    "tendon": Owner("a tendon", "tendons"),
    "loop": Owner("a loop", "loops"),
    "row": Owner("a row of a loop", "rows"),
    "fluid": Owner("a tree in a medium", "base"),
    "immersed": Owner("a shape in a medium", "immersed"),
    "surface": Owner("a drive of surfaces", "surfaces"),
}


class Channel(NamedTuple):
    """A quantity of the state or of a record."""

    name: str
    kind: Kind
    of: str  # what has it, of OWNERS
    width: int  # numbers each
    unit: str
    what: str
    labels: tuple[str, ...] = ()  # of the numbers, where there are several
    needs: tuple[str, ...] = ()  # of a computed channel: the channels that `compute` takes
    compute: Callable | None = None  # None of a computed channel: it takes the robot too, and `run` knows how


_FORCE = ("normal", "along the slope", "across")
_WORKS = ("supply", "electrical_no_regeneration", "copper", "driver_loss", "friction", "gear", "stops", "work")

CHANNELS = (
    Channel("base_q", "coordinates", "base", 7, "m, -", "position and quaternion of the base", (*"xyz", *"wxyz")),
    Channel("ball_q", "coordinates", "ball", 4, "-", "quaternions of ball joints", tuple("wxyz")),
    Channel("q", "coordinates", "joint", 1, "rad or m", "joint positions"),
    Channel("base_qd", "coordinates", "base", 6, "m/s, rad/s", "velocity (world) and angular velocity (body axes)"),
    Channel("qd", "coordinates", "joint", 1, "rad/s or m/s", "joint velocities"),
    Channel("current", "controlled", "servo", 1, "A", "motor currents"),
    Channel("rotor", "controlled", "rotor", 1, "rad", "rotor angles over the gear ratio"),
    Channel("rotor_speed", "controlled", "rotor", 1, "rad/s", "rotor speeds over the gear ratio"),
    Channel("filtered_speed", "controlled", "servo", 1, "rad/s or m/s", "joint velocities as the controller sees them"),
    Channel("tangential_deflection", "controlled", "point", 2, "m", "tangential deflection of a contact", _FORCE[1:]),
    Channel(
        "rolling_deflection",
        "controlled",
        "rolling",
        2,
        "rad",
        "rolling of a contact before it resists fully",
        _FORCE[1:],
    ),
    Channel("pair_deflection", "controlled", "slot", 3, "m", "bristle of a pair, in its second body", tuple("xyz")),
    Channel(
        "pair_turning",
        "controlled",
        "turning",
        4,
        "rad",
        "rolling of a pair, in its second body, and spinning",
        (*"xyz", "spinning"),
    ),
    Channel("energy", "integrated", "joint", ENERGIES, "J", "where the energy of a joint went", _WORKS),
    Channel("contact_work", "integrated", "tree", 1, "J", "work of the ground on the robot"),
    Channel("pair_work", "integrated", "pairs", 1, "J", "work of the forces between bodies on both"),
    Channel(
        "fluid_work",
        "integrated",
        "fluid",
        WORKS,
        "J",
        "work of the medium on the robot",
        ("buoyancy", "drag", "added_mass", "propulsion"),
    ),
    Channel(
        "tendon_work",
        "integrated",
        "tendon",
        TENDON_WORKS,
        "J",
        "work of tendons, then springs, on the robot",
        ("spring", "damper", "stops", "drive", "friction"),
    ),
    Channel("surface_work", "integrated", "surface", 1, "J", "work of the drives of surfaces, such as belts"),
    Channel("source_loss", "integrated", "source", 1, "J", "what the resistance of the supply took"),
    Channel("voltage", "held", "servo", 1, "V", "motor voltages"),
    Channel("integral", "held", "servo", 1, "rad s or rad", "integral of the controller's error"),
    Channel("last_error", "held", "servo", 1, "rad or rad/s", "the controller's error at the last tick"),
    Channel("profiled_reference", "held", "profile", 1, "rad or m", "where the profile speed has let the goal come to"),
    Channel("duty", "held", "fed", 1, "-", "duty cycles, by which servos share the bus"),
    Channel("bus_voltage", "held", "source", 1, "V", "voltage of the supply under its load"),
    Channel("delayed", "held", "delay", 1, "V", "voltages that wait, oldest first, at the nominal supply"),
    Channel("pair", "held", "slot", 1, "-", "1 + index of the pair that has the slot, 0 of none"),
    Channel("pair_feature", "held", "slot", 1, "-", "1 + feature that touches, 0 of none"),
    Channel("surface_command", "held", "surface", 1, "-", "what the motions of surfaces are multiplied by"),
    Channel("loop_closed", "held", "loop", 1, "-", "1 of a loop that is closed, 0 of one that is open"),
    Channel(
        "loop_place",
        "held",
        "loop",
        13,
        "m, -",
        "where a loop holds its second body, as kernels see it",
        (*"xyz", *(f"{row}{column}" for row in "xyz" for column in "xyz"), "length"),
    ),
    Channel("loop_loss", "held", "loop", 1, "J", "energy that a loop has taken where it was made"),
    Channel("base_qdd", "derived", "base", 6, "m/s², rad/s²", "rates of base_qd"),
    Channel("qdd", "derived", "joint", 1, "rad/s² or m/s²", "joint accelerations"),
    Channel("torque", "derived", "joint", 1, "N m or N", "what drives a joint: actuator and torques from outside"),
    Channel("loop_force", "derived", "row", 1, "N or N m", "force of a loop on its first link, moments after forces"),
    Channel("contact_force", "derived", "point", 3, "N", "force of the ground on a contact point", _FORCE),
    Channel("pair_force", "derived", "slot", 3, "N", "force between bodies on the first, world axes", tuple("xyz")),
    Channel("pair_normal_force", "derived", "slot", 1, "N", "its part along the normal"),
    Channel("pair_gap", "derived", "slot", 1, "m", "gap of the surfaces, negative where they overlap"),
    Channel("pair_position", "derived", "slot", 3, "m", "where the force acts, world frame", tuple("xyz")),
    Channel("tendon_force", "derived", "tendon", 1, "N or N m", "of tendons, then springs, limits of ball joints"),
    Channel("immersed_share", "derived", "immersed", 1, "-", "share of a shape's volume that is immersed"),
    Channel(
        "fluid_force",
        "derived",
        "immersed",
        6,
        "N, N m",
        "force and moment of the medium at the immersed center",
        (*(f"force_{k}" for k in "xyz"), *(f"moment_{k}" for k in "xyz")),
    ),
    Channel("velocity_change", "watched", "joint", 1, "rad/s or m/s", "last change of qd"),
    Channel("chatter", "watched", "joint", 1, "rad/s or m/s", "running mean of alternating less lasting changes of qd"),
    Channel("worst_chatter", "watched", "joint", 1, "rad/s or m/s", "the largest chatter so far"),
    Channel("newton_iterations", "watched", "run", 2, "-", "Newton passes, and steps in which they did not converge"),
    Channel("step_control", "run", "run", PACE, "-", "of error control"),
    Channel("pair_budget", "run", "pairs", 1, "m", "way that bodies may move until pairs are looked for anew"),
    Channel("status", "run", "run", 1, "-", "how the run has ended"),
    Channel("end_time", "run", "run", 1, "s", "time reached, of a run that failed the time of that"),
    Channel("power", "computed", "joint", 1, "W", "mechanical power on the joint", (), ("torque", "qd"), np.multiply),
    Channel("tendon_length", "computed", "tendon", 1, "m or rad", "lengths of tendons", (), ("base_q", "q")),
    Channel("clearance", "computed", "run", 1, "m", "least distance of shapes that can meet", (), ("base_q", "q")),
)
BY_NAME = {channel.name: channel for channel in CHANNELS}
UNITS = {channel.name: channel.unit for channel in CHANNELS}
IN_STATE = tuple(channel for channel in CHANNELS if channel.kind != "computed")
# A list, so that a channel added to it is seen wherever the name was imported.
RECORDABLE = [c.name for c in CHANNELS if c.kind != "run" and c.name not in ("last_error", "delayed", "loop_place")]

# Where each channel starts in `y`, and where the kinds end.
_ENDS = ("after_coordinates", "after_controlled", "after_integrated", "before_derived", "after_derived")
STATE = np.dtype([(name, np.int64) for name in (*(channel.name for channel in IN_STATE), *_ENDS, "length")])


def lay_out(counts: dict[str, int]) -> np.recarray:
    """Return the offsets (1,) STATE of the channels in the state; counts: how many there are of each of OWNERS."""
    offsets, at, first, after = np.zeros(1, STATE), 0, {}, {}
    for channel in IN_STATE:
        offsets[0][channel.name] = at
        first.setdefault(channel.kind, at)
        at += channel.width * counts[channel.of]
        after[channel.kind] = at
    for kind in ("coordinates", "controlled", "integrated", "derived"):
        offsets[0][f"after_{kind}"] = after[kind]
    offsets[0]["before_derived"], offsets[0]["length"] = first["derived"], at
    return offsets.view(np.recarray)


def parts(offsets: Mapping[str, int]) -> dict[str, tuple[int, int]]:
    """Return the first and past-the-last index of each channel in the state."""
    starts = [*(offsets[channel.name] for channel in IN_STATE), offsets["length"]]
    return {channel.name: (starts[k], starts[k + 1]) for k, channel in enumerate(IN_STATE)}


def shaped(channel: Channel, values: np.ndarray) -> np.ndarray:
    """Return recorded numbers (samples, all) in their natural shape: several of a joint or point get an axis."""
    return values.reshape(len(values), -1, channel.width) if several(channel, values.shape[1]) else values


def several(channel: Channel, size: int) -> bool:
    """Return whether `size` numbers of a channel are several for each of what has it, which get an axis of their own.

    Those of the only base have none.
    """
    return channel.width > 1 and channel.of != "run" and (channel.of != "base" or size > channel.width)
