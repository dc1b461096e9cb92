"""ARS(3,4,3): a Runge-Kutta pair of order 3 whose stages are linearly implicit steps, with error control.

What is stiff (servos, gears, friction, stops, contacts) is taken by an L-stable diagonally implicit method of three
stages, what is not (inertia, bias forces) by an explicit one of four with the same weights: U. M. Ascher, S. J. Ruuth,
R. J. Spiteri, Implicit-explicit Runge-Kutta methods for time-dependent partial differential equations, Applied
Numerical Mathematics 25 (1997), section 2.7.  Both act in one equation M(q) a = T(q, v) - b(q, v) whose M and b are
taken at explicit values of their arguments and T at implicit ones: S. Boscarino, F. Filbet, G. Russo, High order
semi-implicit schemes for time dependent partial differential equations, Journal of Scientific Computing 68 (2016).

A stage is therefore one step of newton.py, of Euler's kind, whose start is the sum of the slopes before it and whose
predicted velocity is that of the explicit method.  The last stage ends in the step's result, and its acceleration is
the first of the next step, unless something has changed between: then a step of Euler gives it, which hides what is
stiff where an evaluation would not.

The error is that of the positions and velocities by weights of order 2 on the four slopes.  The tolerance is one of
speeds; positions, which may grow without bound, are held to an absolute share of it.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import apart, inline
from ..compile.lanes import sqrt
from ..compile.optional import any_present
from ..compile.structure import structure
from ..effects.actuator import controller_of, motor_of, motor_speed, rotor_of
from ..effects.energies import DRIVER, ENERGIES, METER, SUPPLY
from ..effects.motor_stage import COLUMNS as MOTOR_COLUMNS
from ..effects.motor_stage import MID_SPEED, NOW, USED, MotorStage, begin_stage, bend, missed
from ..step.advance import step_trees
from ..step.closure import project
from ..step.context import Scratch, Step
from ..step.pace import COLUMNS, EVALUATIONS, LAST, REJECTED, SINCE, SIZE, STEP, STEPS, UNTIL, in_time, root, scaled
from ..step.signals import inputs
from ..tree.ball import ball_rates
from ..tree.forest import base_count, joint_count
from ..tree.kinematics import quaternion_rate
from .integrator import Integrator, begin_interval, scratch, take_adaptive_step

G = 0.4358665215084590  # root of x^3 - 3 x^2 + 3/2 x - 1/6: of the implicit diagonal
B1, B2 = -1.5 * G * G + 4.0 * G - 0.25, 1.5 * G * G - 5.0 * G + 1.25
NODES = np.array([0.0, G, 0.5 * (1.0 + G), 1.0])
A43 = 0.5529291480359398  # as ARS(3,4,3) has it: a42 = a43
A32 = (1.0 / 6.0 - G * A43 * (NODES[1] + NODES[2])) / (B2 * NODES[1])
IMPLICIT = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.5 * (1.0 - G), 0.0], [0.0, B1, B2]])
EXPLICIT = np.array([[0.0, 0.0, 0.0], [G, 0.0, 0.0], [NODES[2] - A32, A32, 0.0], [1.0 - 2.0 * A43, A43, A43]])
# Weights without effect on 1 and t that make 1/6 of t^2, of least size: h^3 y''' / 12 of a smooth y'.  As numbers,
# since the last bits of a linear system's solution depend on the processor.
ERROR = np.array([0.33060998456247276, -0.4442419286503062, -0.28361458098566894, 0.3972465250735038])
SAFETY, LEAST_FACTOR, LARGEST_FACTOR = 0.85, 0.2, 4.0  # of the step's factor
AFTER_EVENT = COLUMNS  # in the pace: the step to try after an event [s]
POSITION_SHARE = 1e-3  # [s] of the tolerance of speeds, that positions are held to, whatever their size
NEWTON_SHARE = 1e-2  # of the tolerance, that Newton's iteration may leave of the forces
BETA = 0.08  # share of the last error in it
COARSER = 2.15  # steps of a second run at ten times the tolerance, by those of the first


@structure
class Ars343(NamedTuple):
    """Workspace."""

    scratch: Scratch
    start: np.ndarray  # (length of the state,) at the start of the step
    slopes: np.ndarray  # (4, what is integrated): of the start, known of the coordinates alone, and of the stages
    predicted: np.ndarray  # (nq + nv,) where inertia and bias are taken
    motors: MotorStage | None  # None without motors
    norms: np.ndarray  # (bases,) lengths of the quaternions at the start of a stage
    stale: np.ndarray  # (1,) 1 where the slope at the start is to be found
    fresh: np.ndarray  # (1,) 1 of the first step after an event
    pace: np.ndarray  # (SIZE,)


@begin_interval.of(Ars343)
def _something_changed(work, run, y, t):
    """Shorten the next step to the one that followed the last event."""
    work.pace[STEP] = min(work.pace[STEP], work.pace[AFTER_EVENT])
    work.fresh[0] = 1.0
    if t == 0.0 or _jumps(work.motors, run):
        work.stale[0] = 1.0


@inline
def _jumps(motors, run):
    """Return whether accelerations may jump at events: not at records, nor at ticks if currents are slow."""
    if motors is None:
        return any_present(run.scene.push, any_present(run.signals.torques, run.signals.continuous)) is not None
    motor = motor_of(run.scene.actuator)
    for i in range(len(motor)):
        if motor[i].torque_constant > 0.0 and motor[i].inductance == 0.0:
            return True
    return any_present(run.scene.push, run.signals.torques) is not None


@take_adaptive_step.of(Ars343)
def ars343(work, run, y, t, length):
    """Take a step that meets the tolerance."""
    offsets, pace, start = run.offsets[0], work.pace, work.start
    for i in range(offsets.step_control):
        start[i] = y[i]
    rejected, first = False, work.fresh[0] > 0.0
    while True:
        h = in_time(min(pace[STEP], _longest(run.plan.second_run, pace)), length)
        _stages(run, y, t, h)
        error = _error(run, y, h)
        if error <= 1.0:
            _finish(run, y, h)
            factor = SAFETY * root(pace[LAST], 1.0 / BETA) / root(error, 1.0 / (1.0 / 3.0 - 0.2 * BETA))
            # Events hold a second run's steps far below its tolerance.
            most = 16.0 if run.plan.second_run else LARGEST_FACTOR
            factor = max(LEAST_FACTOR, min(1.0 if rejected else most, factor))
            pace[STEPS] += 1.0
            pace[LAST] = max(error, 1e-4)
            if h < length or factor < 1.0:
                pace[STEP] = h * factor
            if first:
                pace[AFTER_EVENT] = h * factor
            work.fresh[0] = work.stale[0] = 0.0
            return h
        rejected = True
        pace[REJECTED] += 1.0
        pace[STEP] = h * max(LEAST_FACTOR, min(0.9, SAFETY / root(error, 3)))
        if not pace[STEP] > run.plan.least_step:
            for i in range(offsets.step_control):
                y[i] = start[i]
            return 0.0


@inline
def _longest(second_run, pace):
    """Return the longest step [s]: a second run takes two or three steps where events let the first take one or two.

    Otherwise both would take the same steps there, and differ by no error.
    """
    interval = pace[UNTIL] - pace[SINCE]
    own = pace[STEP] / COARSER
    if second_run and own > 0.4 * interval:
        return (0.5 if own > 0.999 * interval else 0.34) * interval
    return interval


@apart
def _stages(run, y, t, h):
    """Solve all stages of the step h from t: fill their slopes, and y with the state after the last."""
    scene, u, work, offsets = run.scene, run.signals, run.work, run.offsets[0]
    scratch, pace, d = work.scratch, work.pace, G * h
    _start_slope(scene.floating, run)
    _store_motors(work.motors, rotor_of(scene.actuator), offsets, work.start, NOW)
    y[offsets.newton_iterations + 1] = work.start[offsets.newton_iterations + 1]
    for k in range(0 if work.stale[0] > 0.0 else 1, 4):
        _begin_stage(scene.floating, scene.contact, scene.pairs, run, y, h, k)
        _begin_motors(work.motors, run, y, h, k)
        inputs(u, min(t + max(NODES[k], G) * h, pace[UNTIL]))
        at = Step(
            scene=scene, actuator=scene.actuator, decay=work.motors, offsets=offsets, y=y, tau=u.tau, drive=u.drive,
            predicted=work.predicted, t=pace[SINCE], span=0.0, h=d, h_implicit=d, theta=1.0, extrapolation_ratio=None,
            tolerance=NEWTON_SHARE * run.plan.rtol, W=scratch.W, Z=scratch.Z, C=scratch.C, F=scratch.F, N=scratch.N,
            pool=scratch.pool, part=None, rows=scratch.rows, closing=scratch.closing,
        )  # fmt: skip
        step_trees(at)
        pace[EVALUATIONS] += 1.0
        _end_stage(scene.floating, run, y, d, k)
        if k == 2:
            _store_motors(work.motors, rotor_of(scene.actuator), offsets, y, MID_SPEED)
    project(scene.loops, scene, offsets, scratch, y)


@inline
def _begin_stage(floating, contact, pairs, run, y, h, k):
    """Fill y and the slopes with the state from which stage k steps, and accelerations that predict its end.

    The lengths of the quaternions of floating bases, which the step makes 1, are kept.
    """
    work, offsets = run.work, run.offsets[0]
    start, slopes = work.start, work.slopes
    for i in range(offsets.after_integrated):
        y[i] = start[i]
        for j in range(1, k):
            y[i] += (h * IMPLICIT[k, j]) * slopes[j, i]
        if k > 0:
            slopes[k, i] = y[i]
    for i in range(joint_count(run.scene.trees, run.scene.tree)):
        _expect(run, y, h, k, offsets.qd + i, offsets.qdd + i)
    if contact is not None:
        for i in range(3 * len(contact.points)):
            y[offsets.contact_force + i] = 0.0  # friction is limited by the predicted normal force
    if pairs is not None:
        for i in range(len(work.scratch.pool.old)):
            y[offsets.pair_normal_force + i] = 0.0
    if floating is not None:
        for i in range(6 * base_count(run.scene.trees)):
            _expect(run, y, h, k, offsets.base_qd + i, offsets.base_qdd + i)
        for base in range(base_count(run.scene.trees)):
            quaternion, norm = offsets.base_q + 7 * base + 3, 0.0
            for i in range(quaternion, quaternion + 4):
                norm += y[i] * y[i]
            work.norms[base] = sqrt(norm)
    _ball_norms(run.scene.balls, run, y)


@inline
def _ball_norms(balls, run, y):
    """Keep the lengths of the quaternions of ball joints, behind those of bases."""
    if balls is not None:
        norms, start = run.work.norms, run.offsets[0].ball_q
        for ball in range(len(balls)):
            norm = 0.0
            for i in range(start + 4 * ball, start + 4 * ball + 4):
                norm += y[i] * y[i]
            norms[len(norms) - len(balls) + ball] = sqrt(norm)


@inline
def _expect(run, y, h, k, speed, acceleration):
    """Set the acceleration with which a stage's step reaches the speed of the explicit method."""
    expected = 0.0
    for j in range(k):
        expected += EXPLICIT[k, j] * run.work.slopes[j, speed]
        if j > 0:
            expected -= IMPLICIT[k, j] * run.work.slopes[j, speed]
    y[acceleration] = expected / G


@inline
def _end_stage(floating, run, y, d, k):
    """Set the slope of stage k by what its step d has changed; of the start the accelerations alone.

    Euler's step shortens the quaternion of a floating base.
    """
    offsets, slopes = run.offsets[0], run.work.slopes
    if k > 0:
        for i in range(offsets.after_integrated):
            slopes[k, i] = (y[i] - slopes[k, i]) * (1.0 / d)
        if floating is not None:
            for base in range(base_count(run.scene.trees)):
                position, speed = offsets.base_q + 7 * base, offsets.base_qd + 6 * base
                x, v = y[position : position + 7], y[speed : speed + 6]
                turn = 0.25 * d * d * (v[3] * v[3] + v[4] * v[4] + v[5] * v[5])
                quaternion_rate(x, v, slopes[k, position + 3 : position + 7])
                for i in range(position + 3, position + 7):
                    slopes[k, i] *= run.work.norms[base] / sqrt(1.0 + turn)
        _end_balls(run.scene.balls, run, y, d, slopes[k])
    else:
        for i in range(joint_count(run.scene.trees, run.scene.tree)):
            slopes[0, offsets.qd + i] = y[offsets.qdd + i]
        if floating is not None:
            for i in range(6 * base_count(run.scene.trees)):
                slopes[0, offsets.base_qd + i] = y[offsets.base_qdd + i]


@inline
def _end_balls(balls, run, y, d, slope):
    if balls is not None:
        norms, q, v = run.work.norms, run.offsets[0].ball_q, y[run.offsets[0].qd :]
        ball_rates(balls, None, y[q:], v, slope[q:])
        for ball in range(len(balls)):
            k = balls[ball]
            turn = 0.25 * d * d * (v[k] * v[k] + v[k + 1] * v[k + 1] + v[k + 2] * v[k + 2])
            for i in range(q + 4 * ball, q + 4 * ball + 4):
                slope[i] *= norms[len(norms) - len(balls) + ball] / sqrt(1.0 + turn)


@inline
def _start_slope(floating, run):
    """Fill the rates of positions and velocities at the start, as the last stage left them."""
    offsets, start, slope = run.offsets[0], run.work.start, run.work.slopes[0]
    for i in range(joint_count(run.scene.trees, run.scene.tree)):
        slope[offsets.q + i] = start[offsets.qd + i]
        slope[offsets.qd + i] = start[offsets.qdd + i]
    ball_rates(run.scene.balls, None, start[offsets.ball_q :], start[offsets.qd :], slope[offsets.ball_q :])
    if floating is not None:
        for base in range(base_count(run.scene.trees)):
            position, speed = offsets.base_q + 7 * base, offsets.base_qd + 6 * base
            for i in range(3):
                slope[position + i] = start[speed + i]
            quaternion_rate(
                start[position : position + 7], start[speed : speed + 6], slope[position + 3 : position + 7]
            )
        for i in range(6 * base_count(run.scene.trees)):
            slope[offsets.base_qd + i] = start[offsets.base_qdd + i]


@inline
def _error(run, y, h):
    """Return the largest error of positions and velocities over the tolerance; infinite if a stage was not solved."""
    offsets, start, slopes, worst = run.offsets[0], run.work.start, run.work.slopes, 0.0
    if y[offsets.newton_iterations + 1] > start[offsets.newton_iterations + 1]:
        return 1e60
    for i in range(offsets.base_qd):
        worst = _worse(worst, _estimate(slopes, i, h) / (POSITION_SHARE * run.plan.atol))
    for i in range(offsets.base_qd, offsets.after_coordinates):
        worst = _worse(worst, scaled(run.plan, _estimate(slopes, i, h), start[i], y[i]))
    return _current_error(run.work.motors, rotor_of(run.scene.actuator), run, y, h, worst)


@inline
def _current_error(motors, rotor, run, y, h, worst):
    """Include the error of currents on which limits act."""
    if motors is not None:
        offsets, start, motor = run.offsets[0], run.work.start, motor_of(run.scene.actuator)
        for i in range(len(motor)):
            k = offsets.current + i
            w, last = motor_speed(rotor, offsets, y, i), (1.0 - NODES[2]) * h
            e = missed(motor[i], motors, i, y[offsets.voltage + i], y[k], w, last)
            worst = _worse(worst, scaled(run.plan, e, start[k], y[k]))
    return worst


@inline
def _estimate(slopes, i, h):
    e = 0.0
    for j in range(4):
        e += ERROR[j] * slopes[j, i]
    return abs(h * e)


@inline
def _worse(worst, e):
    if not e < 1e60:
        return 1e60
    return max(worst, e)


@inline
def _finish(run, y, h):
    """Restore the watch on chatter, and add what the motors' stages leave out."""
    offsets, start = run.offsets[0], run.work.start
    for watch in (offsets.velocity_change, offsets.chatter, offsets.worst_chatter):
        for i in range(watch, watch + joint_count(run.scene.trees, run.scene.tree)):
            y[i] = start[i]
    _finish_motors(run.work.motors, rotor_of(run.scene.actuator), run, y, h)


@inline
def _store_motors(motors, rotor, offsets, y, column):
    """Store speeds at y in a column of the motors' table, and currents in the next."""
    if motors is not None:
        for i in range(len(motors.table)):
            motors.table[i, column] = motor_speed(rotor, offsets, y, i)
            motors.table[i, column + 1] = y[offsets.current + i]


@inline
def _begin_motors(motors, run, y, h, k):
    """Set time and past of stage k; the start's is a stage for itself."""
    if motors is not None:
        motor, controller, offsets = motor_of(run.scene.actuator), controller_of(run.scene.actuator), run.offsets[0]
        T, d = max(NODES[k], G) * h, G * h
        motors.time[0], motors.time[1], motors.time[2] = T, 1.0 / G if k == 3 else 0.0, 1.0 * k
        for i in range(len(motor)):
            past = 0.0
            for j in range(1, k):
                past += IMPLICIT[k, j] * motors.table[i, USED + j]
            begin_stage(motor[i], motors, i, y[offsets.voltage + i], T, past / G, controller[i].speed_filter, d)
            y[offsets.current + i] = run.work.start[offsets.current + i]


@inline
def _finish_motors(motors, rotor, run, y, h):
    """Add the effect of the speeds' curvature, which no stage knows, to the currents at the end.

    Takes the magnetic energy from the drivers' losses [J], and keeps the meter from running backwards.
    """
    if motors is not None:
        motor, offsets, slopes, start = motor_of(run.scene.actuator), run.offsets[0], run.work.slopes, run.work.start
        for i in range(len(motor)):
            k = (offsets.qd if rotor is None else offsets.rotor_speed) + i
            rate = (slopes[3, k] - slopes[1, k]) / (h * (1.0 - G))
            V, I = y[offsets.voltage + i], y[offsets.current + i]
            y[offsets.current + i] += bend(motor[i], motors, i, V, I, y[k], rate, h)
            I0, I1 = start[offsets.current + i], y[offsets.current + i]
            E = offsets.energy + ENERGIES * i
            y[E + DRIVER] -= 0.5 * motor[i].inductance * (I1 * I1 - I0 * I0)
            metered, supplied = y[E + METER] - start[E + METER], y[E + SUPPLY] - start[E + SUPPLY]
            y[E + METER] = start[E + METER] + max(metered, supplied, 0.0)


def _workspace(sizes, zeros):
    offsets = sizes.offsets
    return Ars343(
        scratch=scratch(sizes, zeros),
        start=zeros(int(offsets["length"])),
        slopes=zeros((4, int(offsets["after_integrated"]))),
        predicted=zeros(2 * sizes.n + 13 * sizes.bases + 4 * sizes.balls),
        motors=MotorStage(zeros((sizes.motors, MOTOR_COLUMNS)), zeros(3)) if sizes.motors else None,
        norms=zeros(max(sizes.bases + sizes.balls, 1)),
        stale=np.zeros(1),
        fresh=np.zeros(1),
        pace=zeros(SIZE),
    )


ARS343 = Integrator("ars343", 3, _workspace, stages=3, adaptive=True, folds_spring=True, rtol=1e-2, strictest=1e-4)
