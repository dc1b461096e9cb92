"""A source with a resistance R_s that feeds all servos: V = V0 - R_s sum_j d_j I_j, d_j = V_j / V their duty cycles.

Whenever duty cycles change, once a tick, V is found from the currents that they come to at the speeds of that moment,

    I_j = clamp((d_j V - K_j w_j) / R_j, +- current_limit),

and held until they change again: as each voltage it is then a constant of the steps between, which no integrator needs
to know of.  With the currents as they are V would be late by a tick, for they follow their voltage within a fraction of
one, and alternate from tick to tick where R_s sum d_j^2 / R_j > 1.  What a speed changes meanwhile is left out, and so
are inductance and slew.  Each d_j I_j grows with V: there is one V.

Currents that are driven back, d_j I_j < 0, feed the other servos and charge the source, V > V0.  V is not below 0.
"""

from ..compile.jit import inline, kernel
from ..compile.lanes import any_lane, clamp, invert, select
from ..compile.structure import record
from .actuator import controller_of, motor_of, motor_speed, rotor_of

SUPPLY = record(
    voltage=float,  # V0 [V]
    resistance=float,  # R_s [Ohm]
)
PASSES = 100  # at most: each halves the bracket, unless Newton's is better; two or three are usual
TOLERANCE = 1e-13  # of V0, that the equation may miss


@kernel
def feed(supply, actuator, offsets, y):
    """Turn the voltages that controllers ask for, at their nominal supply, into those that the source supplies."""
    if supply is None:
        return
    controller, motor = controller_of(actuator), motor_of(actuator)
    for i in range(len(motor)):
        nominal, u = controller[i].voltage_limit, y[offsets.voltage + i]
        one = 1.0 + 0.0 * u
        y[offsets.duty + i] = select(nominal > 0.0, u / select(nominal > 0.0, nominal * one, one), 0.0 * u)
    V = _bus(supply[0], motor, rotor_of(actuator), offsets, y)
    y[offsets.bus_voltage] = V
    for i in range(len(motor)):
        y[offsets.voltage + i] = y[offsets.duty + i] * V


@inline
def _bus(source, motor, rotor, offsets, y):
    """Return V by Newton's method, within a bracket: the slope of the residual is at least 1."""
    V0, R = source.voltage + 0.0 * y[offsets.bus_voltage], source.resistance
    V, none = V0, 0.0 * V0
    drawn, slope = _drawn(motor, rotor, offsets, y, V)
    miss = R * drawn
    low = V0 - select(miss > 0.0, miss, none)
    high = V0 - select(miss < 0.0, miss, none)
    for _ in range(PASSES):
        found = abs(miss) <= TOLERANCE * V0
        if not any_lane(invert(found)):
            break
        better = V - miss / (1.0 + R * slope)
        better = select((better > low) & (better < high), better, 0.5 * (low + high))
        V = select(found, V, better)
        drawn, slope = _drawn(motor, rotor, offsets, y, V)
        miss = (V - V0) + R * drawn
        low, high = select(miss < 0.0, V, low), select(miss > 0.0, V, high)
    return select(V > 0.0, V, none)


@inline
def _drawn(motor, rotor, offsets, y, V):
    """Return the current that the servos draw from a bus at V [A], and its slope [A/V]."""
    drawn, slope = 0.0 * V, 0.0 * V
    for i in range(len(motor)):
        m, d = motor[i], y[offsets.duty + i]
        free = (d * V - m.torque_constant * motor_speed(rotor, offsets, y, i)) / m.resistance
        I = clamp(free, -m.current_limit, m.current_limit)
        drawn = drawn + d * I
        slope = slope + select(I == free, d * d / m.resistance, 0.0 * V)
    return drawn, slope


@inline
def move_source(supply, step, i, I):
    """Add the loss in the source's resistance over the step that the mean current I of servo i causes [A]."""
    if supply is not None:
        step.y[step.offsets.source_loss] += step.h * _lost(supply, step, i, I)


@inline
def source_rate(supply, step, dy, i, I):
    """Add the same as a rate to dy, summed from the first servo to this one."""
    if supply is not None:
        power = _lost(supply, step, i, I)
        dy[step.offsets.source_loss] = power if i == 0 else dy[step.offsets.source_loss] + power


@inline
def _lost(supply, step, i, I):
    return (supply[0].voltage - step.y[step.offsets.bus_voltage]) * (step.y[step.offsets.duty + i] * I)
