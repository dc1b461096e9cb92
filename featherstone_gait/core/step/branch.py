"""On which branches of their laws the forces of a step are: where one changes, motion has a kink."""

from ..compile.jit import inline, kernel
from ..effects.actuator import actuator_branch, rotor_of
from ..effects.contact import U0, UN, contact_branch, place_contacts
from ..effects.friction import friction_branch
from ..effects.stop import stop_branch
from .newton import VN, VP, WK, WN, predict, rotor_speed

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
        key = key + _weight(3 * i + 2) * friction_branch(s.scene.friction, i, v)
    return _with_contacts(s.scene.contact, s, key)


@kernel
def branches_at_start(s):
    """The same where the step s starts."""
    predict(s.predicted, rotor_of(s.actuator), s)
    place_contacts(s.scene.contact, s, 0.0)
    for i in range(len(s.scene.tree) - 1):
        s.Z[VN, i], s.Z[WN, i] = s.Z[VP, i], s.Z[WK, i]
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
