"""The actuators of the joints: the functions that a step calls, which each kind implements in a file of its own.

An actuator acts on its joint and may have a rotor, whose speed w (over the gear ratio) is eliminated from each linear
system.  Of its torque T on the joint and F on the rotor a step needs, besides the values, the slopes

    c = -dT/dv without the coupling,   cg = dT/dw = -dT/dv = coupling of both,   cr = -dF/dw without the coupling.

Each kind is a NamedTuple of arrays of records, one record a joint; its class names in `PARTS` which parts of the state
it has (see step/state.py).  A scene without actuator has None, for which the functions are implemented here.
"""

from ..compile.by_type import NoneType, by_type, overridable
from ..compile.jit import inline


@by_type
def actuator_force(actuator, step, i, v, w, T, c):
    """Return T and c plus what drives joint i at the speeds v, w of joint and rotor, at the end of the step.

    Returns T [N m], F [N m], c, cg and cr [N m s/rad].
    """


@by_type
def actuator_rates(actuator, step, dy, i, v):
    """Fill the rates of the actuator's own state and energies in dy, friction's added to the joint's that stands there.

    Returns the torque on the joint [N m].
    """


@overridable
def move_actuator(actuator, step, i, v, w):
    """Move the actuator's own state to the end of the step, whose speeds were v and w, with its energies.

    An actuator without a state of its own need not implement it.
    """


@overridable
def actuator_branch(actuator, step, i, v, w):
    """Return a number for each way in which limits and teeth act at the speeds v and w, and 0 where none does.

    An actuator whose torque is smooth need not implement it.
    """
    return 0.0 * v


@overridable
def rotor_of(actuator):
    """Return records of the rotors with a field `inertia` [kg m^2]; None for most kinds, which have none."""
    return None


@overridable
def motor_of(actuator):
    """Return the MOTOR records (the field `motor`), None where there are none."""
    return actuator.motor


@overridable
def controller_of(actuator):
    """Return the CONTROLLER records of what is sampled (the field `controller`), None where nothing is."""
    return actuator.controller


actuator_force.of(NoneType)(lambda actuator, step, i, v, w, T, c: (T, 0.0, c, 0.0, 0.0))
actuator_rates.of(NoneType)(lambda actuator, step, dy, i, v: 0.0 * v)
motor_of.of(NoneType)(lambda actuator: None)
controller_of.of(NoneType)(lambda actuator: None)


@inline
def motor_speed(rotor, offsets, y, i):
    """Return a motor's speed at the output [rad/s]."""
    if rotor is None:
        return y[offsets.qd + i]
    return y[offsets.rotor_speed + i]
