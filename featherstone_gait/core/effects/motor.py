"""DC motor: L dI/dt = V - K omega - R I, with limits on the current and on its rate.

All quantities at the output side: the torque constant is G K, so that with the joint's speed it gives the back-EMF and
with the current the torque.  For constant V and omega the current approaches (V - GK omega)/R exponentially; the step
uses that solution, its end and its mean, exactly, with what `decay.py` says is left of a current after the step.
"""

from ..compile.by_type import overridable
from ..compile.jit import inline
from ..compile.lanes import clamp, invert, select
from ..compile.structure import record
from .decay import MEAN, MOTOR_DECAY
from .energies import COPPER, DRIVER, ENERGIES, METER, SUPPLY
from .motor_stage import USED, MotorStage, stage_current
from .supply import move_source, source_rate

MOTOR = record(
    torque_constant=float,  # G K [N m/A] = [V s/rad]
    resistance=float,  # R [Ohm]
    inductance=float,  # L [H]
    current_limit=float,  # [A]
    current_slew=float,  # [A/s]
    viscous_friction=float,  # of the servo [N m s/rad], as the update order of SimTwo applies it
)


@inline
def current_step(m, decay, i, current, voltage, speed, h):
    """Return the current after h, its mean over the step [A] and the slope -d mean/d speed [A s/rad] of motor m.

    A limit that acts makes the current independent of the speed: the slope is then zero.
    """
    steady = (voltage - m.torque_constant * speed) / m.resistance
    left, mean = decay[i, MOTOR_DECAY], decay[i, MEAN]
    free = steady + (current - steady) * left
    end = clamp(free, current - m.current_slew * h, current + m.current_slew * h)
    end = clamp(end, -m.current_limit, m.current_limit)
    slope = select(end == free, (1.0 - mean) * m.torque_constant / m.resistance, 0.0 * free)
    steady = (end - left * current) / (1.0 - left)
    return end, (1.0 - mean) * steady + mean * current, slope


@inline
def square_mean(decay, i, current, end):
    """Return the mean of I^2 over the step in which the current went from `current` to `end` [A^2]."""
    left, mean = decay[i, MOTOR_DECAY], decay[i, MEAN]
    steady = (end - left * current) / (1.0 - left)
    d = current - steady
    return steady * steady + d * (2.0 * steady * mean + d * (0.5 * mean * (1.0 + left)))


@inline
def current_rate(m, current, voltage, speed):
    """Return the current [A] and its rate [A/s]; without inductance the current is algebraic."""
    driving = voltage - m.torque_constant * speed
    inductive = m.inductance > 0.0
    steady = clamp(driving / m.resistance, -m.current_limit, m.current_limit)
    I = select(inductive, current, steady)
    rate = (driving - m.resistance * I) / select(inductive, m.inductance, 1.0)
    rate = clamp(rate, -m.current_slew, m.current_slew)
    outward = ((I >= m.current_limit) & (rate > 0.0)) | ((I <= -m.current_limit) & (rate < 0.0))
    return I, select(invert(outward) & inductive, rate, 0.0 * rate)


@overridable
def motor_torque(decay, motor, step, i, w):
    """Return the mean torque over the step at the motor's speed w [N m] and its slope [N m s/rad]."""
    m, y, offsets = motor[i], step.y, step.offsets
    _, mean, slope = current_step(m, decay, i, y[offsets.current + i], y[offsets.voltage + i], w, step.h)
    return m.torque_constant * mean, m.torque_constant * slope


@motor_torque.of(MotorStage)
def _torque_of_stage(decay, motor, step, i, w):
    m = motor[i]
    _, mean, slope = stage_current(m, decay, i, step.y[step.offsets.voltage + i], w)
    return m.torque_constant * mean, m.torque_constant * slope


@overridable
def motor_branch(decay, motor, step, i, w):
    """Return what limits the current at the speed w: 1 its rate, 2 the current itself, of either sign, or 0."""
    m, I = motor[i], step.y[step.offsets.current + i]
    end, _, slope = current_step(m, decay, i, I, step.y[step.offsets.voltage + i], w, step.h)
    one = 1.0 + 0.0 * end
    size = select(abs(end) < m.current_limit, one, 2.0 * one)
    return select(slope == 0.0, select(end > I, size, -size), 0.0 * end)


@motor_branch.of(MotorStage)
def _branch_of_stage(decay, motor, step, i, w):
    """Return the same of a stage, in which a limited rate has an exact course."""
    end, _, _ = stage_current(motor[i], decay, i, step.y[step.offsets.voltage + i], w)
    if abs(end) < motor[i].current_limit:
        return 0.0
    return 2.0 if end > 0.0 else -2.0


@inline
def add_electrical(y, E, supply, copper, driver):
    """Add electrical energies of a step [J] to those of a joint, which start at y[E]."""
    y[E + SUPPLY] += supply
    y[E + METER] += select(supply > 0.0, supply, 0.0 * supply)
    y[E + COPPER] += copper
    y[E + DRIVER] += driver


@overridable
def move_motor(decay, motor, step, i, w):
    """Move the current to the end of the step, with the electrical energies; w the motor's speed."""
    m, y, offsets, h = motor[i], step.y, step.offsets, step.h
    E, I, V = offsets.energy + ENERGIES * i, y[offsets.current + i], y[offsets.voltage + i]
    end, mean, _ = current_step(m, decay, i, I, V, w, h)
    supply, copper = h * (V * mean), h * (m.resistance * square_mean(decay, i, I, end))
    driver = supply - copper - h * (m.torque_constant * w * mean) - 0.5 * m.inductance * (end * end - I * I)
    add_electrical(y, E, supply, copper, driver)
    move_source(step.scene.supply, step, i, mean)
    y[offsets.current + i] = end


@move_motor.of(MotorStage)
def _move_stage(decay, motor, step, i, w):
    """Do the same for a stage, without the magnetic energy, which the integrator counts over the whole step."""
    m, y, offsets, h = motor[i], step.y, step.offsets, step.h
    E, V = offsets.energy + ENERGIES * i, y[offsets.voltage + i]
    end, used, _ = stage_current(m, decay, i, V, w)
    supply, copper = h * (V * used), h * (m.resistance * (end * end))
    add_electrical(y, E, supply, copper, supply - copper - h * (m.torque_constant * w * used))
    move_source(step.scene.supply, step, i, used)
    y[offsets.current + i] = end
    decay.table[i, USED + int(decay.time[2])] = used


@inline
def motor_rates(motor, step, dy, i, w):
    """Fill the rates of current and electrical energies; return the torque [N m]."""
    m, y, offsets = motor[i], step.y, step.offsets
    E, V = offsets.energy + ENERGIES * i, y[offsets.voltage + i]
    I, rate = current_rate(m, y[offsets.current + i], V, w)
    dy[offsets.current + i] = rate
    supply, copper = V * I, m.resistance * (I * I)
    dy[E + SUPPLY] = supply
    dy[E + METER] = select(supply > 0.0, supply, 0.0 * supply)
    dy[E + COPPER] = copper
    dy[E + DRIVER] = supply - copper - m.torque_constant * w * I - m.inductance * I * rate
    source_rate(step.scene.supply, step, dy, i, I)
    return m.torque_constant * I


def explicit_limits(motor):
    """Return dampers [N m s/rad] and springs [N m/rad] of each joint that limit an explicit step, by name."""
    return {"back-EMF": motor["torque_constant"] ** 2 / motor["resistance"]}, {}
