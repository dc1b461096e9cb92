"""On which branches of their laws the forces of a step are: where one changes, motion has a kink."""

from ..compile.by_type import by_type
from ..compile.jit import inline, kernel
from ..effects.actuator import actuator_branch, rotor_of
from ..effects.contact import U0, UN, contact_branch, place_contacts
from ..effects.friction import friction_branch
from ..effects.gear_friction import GearFriction, gear_branch
from ..effects.stop import stop_branch
from .newton import VN, VP, WK, WN, loads, predict, rotor_speed

GOLDEN = 0.6180339887498949  # multiples of it, less whole numbers, have no sum in common


@kernel
def branches(s):
    """A number that tells the branches at the solution of the step s from any others."""
    key = 0.0 * s.Z[VN, 0]
    for i in range(len(s.scene.tree) - 1):
        v = s.Z[VN, i]
        w = rotor_speed(rotor_of(s.actuator), s.Z, WN, i, v)
        key = key + _weight(3 * i) * actuator_branch(s.actuator, s, i, v, w)
        key = key + _weight(3 * i + 1) * stop_branch(s.scene.stops, i, s.y[s.o.q + i], v, s.sub)
        key = key + _weight(3 * i + 2) * _of_friction(s.scene.friction, s, i, v, w)
    return _with_contacts(s.scene.contact, s, key)


@by_type
def _of_friction(friction, s, i, v, w):
    """Which way dry friction acts in full."""


@_of_friction.otherwise
def _its_own(friction, s, i, v, w):
    return friction_branch(friction, i, v)


@_of_friction.of(GearFriction)
def _and_that_of_loads(friction, s, i, v, w):
    t_m, t_e = loads(friction, s, i, v, w)
    return gear_branch(friction.table[i], v, t_m, t_e)


@kernel
def branches_at_start(s):
    """The same where the step s starts."""
    predict(s.predicted, rotor_of(s.actuator), s)
    place_contacts(s.scene.contact, s, 0.0)
    for i in range(len(s.scene.tree) - 1):
        s.Z[VN, i], s.Z[WN, i] = s.Z[VP, i], s.Z[WK, i]
        s.Z[VP, i] = s.Z[VP, i] - s.sub * s.y[s.o.qdd + i]  # what loads depend on: the last acceleration
    _contacts_at_start(s.scene.contact, s)
    return branches(s)


@inline
def _contacts_at_start(contact, s):
    if contact is not None:
        for c in range(len(contact.points)):
            for k in range(3):
                s.C[c, UN + k] = s.C[c, U0 + k]


@inline
def _with_contacts(contact, s, key):
    if contact is not None:
        for c in range(len(contact.points)):
            key = key + _weight(3 * (len(s.scene.tree) - 1) + c) * contact_branch(contact, s, c)
    return key


@inline
def _weight(k):
    x = (k + 1) * GOLDEN
    return x - int(x)
