"""Actuators of a compiled MJCF file: servos, and limits of joints.

Of a joint, an actuator of gear g has the length g q and turns a force F into the torque g F.

position
    F = kp u - kp l - kv dl/dt, limited by forcerange: the law pd_clamped with Kp = g^2 kp, Kd = g^2 kv.  The reference
    of a servo is the joint's angle, u / g.
dcmotor with the input "pos"
    U = R/K (kp (u - l) - kd dl/dt) + K dl/dt, limited by Vmax: the law state with Kp = R/K kp g, Kd = (R/K kd - K) g
    and Ki = R/K ki g; its current follows R I + L dI/dt = U - K dl/dt, limited by the torque over K.
motor
    F = u: the product of gear and control limit is the most it gives the joint; the sum over the joint's motors is its
    `effort`, which limits no torque given as `tau`.
of a tendon, with a force F = g u + b0 - kp l - kv dl/dt
    the tendon's drive has the law pd_clamped with Kp = kp and Kd = kv.  Its reference is the length (g u + b0) / kp;
    with kp = 0 the force g u + b0 is that of `tau`.

An actuatorfrcrange limits the sum of g F on a joint and the sum of F on a tendon.  Here a joint or tendon has one
actuator, whose own limit that is: of the torque of a position actuator, of the current of a dcmotor.

An actuator of a fixed tendon whose joints all follow one, or are one, is an actuator of that joint: the tendon's length
is g' q and a constant.

Source: MuJoCo's XML reference and technical note on its dcmotor.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ...base.flaws import quoted
from ...model import TORQUE_LAWS, Controller, Gearbox, Joint, Servo
from ...model.servo import ONE_KIND
from .equalities import couplings, held_joints, joints_of
from .tree import BALL, Tree, actuator_count

JOINT_TRANSMISSIONS, TENDON = (0, 1), 3  # mjTRN_JOINT, mjTRN_JOINTINPARENT, mjTRN_TENDON
NO_DYNAMICS, DC_DYNAMICS, FILTERS = 0, 5, (2, 3)  # mjtDyn
FIXED_GAIN, NO_BIAS, AFFINE_BIAS = 0, 0, 1  # mjtGain, mjtBias
POSITION_INPUT = 1  # mjtCtrlInput
NO_CLAMP, NO_ACTUATION = 1 << 8, 1 << 11  # mjtDisableBit
NO_LIMIT = 1e6  # voltage [V] of a motor that has none

OWN_ANGLE = "took the joint's angle, u/gear, as the reference of actuators with a gear"
SCALED = "took the joint's angle as the reference of actuators whose control is scaled"
LEFT_OUT = "ignored actuators that are neither on one joint nor on a tendon that is taken"
TAKEN_ALREADY = "ignored actuators on a joint or tendon that has one already"
OWN_LENGTH = "took the tendon's length as the reference of actuators on tendons whose control is scaled"
OWN_FORCE = "took actuators on tendons as drives without Kp, whose forces (gear gain control) are those of tau"
FREE_FORCE = "ignored the ctrlrange of actuators on tendons, for forces of tau"
RANGED = (
    "ignored the ctrlrange of actuators on tendons, since references have no limits: keep references [rad or m] where "
    "MuJoCo clamps them: "
)
KEPT = (
    "took the ctrlrange of actuators as `Model.references`: `judge` keeps references [rad or m] there, where MuJoCo "
    "clamps them, and other runs do not: "
)
FREE_TORQUE = "took limits of motors as efforts, which limit no tau: keep tau [N m or N] where MuJoCo clamps it: "
LARGER_END = "took the larger end of forcerange of actuators, or of actuatorfrcrange of tendons, either way"
INFINITE = (-math.inf, math.inf)


class Actuators(NamedTuple):
    """The actuators of a file."""

    servos: dict[str, Servo]  # by joint
    joints: tuple[Joint, ...]  # with what actuators add to them
    doubts: list[str]
    remarks: list[str]
    drives: dict[int, Controller]  # by tendon
    references: dict[str, tuple[float, float]]  # ranges, by joint


class _Read(NamedTuple):
    """One actuator of a file."""

    servo: Servo | None = None
    effort: float | None = None  # of a motor, the most that it gives the joint
    reasons: tuple[str, ...] = ()  # what of it is taken otherwise, or not at all
    reference: tuple[float, float] = INFINITE


class _Row(NamedTuple):
    """An actuator of a joint."""

    name: str
    gear: float
    kind: tuple[int, int, int]  # dynamics, gain, bias
    dyn: list[float]
    gain: list[float]
    bias: list[float]
    controls: tuple[float, float]  # range in which MuJoCo keeps the control
    control: float  # most of it, either way
    force: float  # most of the force, either way
    forces: tuple[float, float]  # range in which MuJoCo keeps the force
    uneven: tuple[bool, bool]  # whether the limits of control and force differ between the two ways
    armature: float
    damping: float
    inputs: int  # which controls it has
    off: bool  # whether it is switched off
    more: tuple[str, ...]  # what else it has that has no like here


def read_actuators(
    m: Any, tree: Tree, joints: tuple[Joint, ...], tendons: Mapping[int, bool], known: Container[str] = ()
) -> Actuators:
    """Read servos, limits and drives from the actuators, and what of them is ignored.

    tendons: of the tree, and whether they are taken; known: joints whose servos are stated elsewhere.
    """
    by_name = {joint.name: joint for joint in joints}
    servos: dict[str, Servo] = {}
    references: dict[str, tuple[float, float]] = {}
    drives: dict[int, Controller] = {}
    efforts: dict[str, float] = {}
    left: dict[str, list[str]] = {}
    for k in range(actuator_count(m)):
        joint, gear = turned(m, k)
        if joint >= 0 and not tree.holds(m, int(m.jnt_bodyid[joint])):
            continue  # of another tree
        name = tree.joint_names[joint] if gear and m.jnt_type[joint] != BALL else ""
        tendon = int(m.actuator_trnid[k, 0])
        on_tendon = m.actuator_trntype[k] == TENDON and joint < 0
        if on_tendon and tendon not in tendons:
            continue  # of another tree
        if on_tendon and tendons[tendon]:
            row = _row(m, k, float(m.actuator_gear[k, 0]))
            drive, reasons = _tendon_drive(row)
            if drive is not None and drives.setdefault(tendon, drive) is not drive:
                reasons = (TAKEN_ALREADY,)
            for reason in reasons:
                left.setdefault(reason, []).append(row.name)
            continue
        if name not in by_name:
            left.setdefault(LEFT_OUT, []).append(m.actuator(k).name or str(k))
            continue
        if name in known:
            continue
        row = _row(m, k, gear)
        if row.kind[0] != DC_DYNAMICS or row.off:  # armature and damping of a dcmotor belong to its servo
            before, g2 = by_name[name], row.gear * row.gear
            damping, armature = before.damping + g2 * row.damping, before.armature + g2 * row.armature
            by_name[name] = replace(before, armature=armature, damping=damping)
        servo, effort, reasons, reference = _read(row, float(m.opt.timestep))
        if effort is not None:
            efforts[name] = efforts.get(name, 0.0) + effort
        if servo is not None and servos.setdefault(name, servo) is not servo:
            reasons, reference = (TAKEN_ALREADY,), INFINITE
        if reference != INFINITE:
            references[name] = reference
        for reason in reasons:
            left.setdefault(reason, []).append(row.name)
    for name, effort in efforts.items():
        by_name[name] = replace(by_name[name], effort=min(by_name[name].effort, effort))
    doubts, remarks = _sentences(left)
    torques = [name for name, servo in servos.items() if servo.controller.law in TORQUE_LAWS]
    if len(torques) not in (0, len(servos)):
        remarks.append(
            f"servos of joints {quoted(torques)} have a torque law, the others are sampled; compile_scene takes one "
            f"kind: {ONE_KIND}"
        )
    return Actuators(servos, tuple(by_name[joint.name] for joint in joints), doubts, remarks, drives, references)


def _sentences(left: dict[str, list[str]]) -> tuple[list[str], list[str]]:
    """Return doubts and remarks about what is taken otherwise, by reason and names of actuators."""
    remarks = [f"{one}: {quoted(left.pop(one))}" for one in (OWN_FORCE, FREE_FORCE) if one in left]
    gathered: dict[str, list[str]] = {RANGED: [], KEPT: remarks, FREE_TORQUE: remarks}
    doubts = [f"{one}: {quoted(names)}" for one, names in left.items() if not one.startswith((*gathered,))]
    gathered[RANGED] = doubts
    for head, said in gathered.items():
        ranges = [f"{one.removeprefix(head)} of {quoted(names)}" for one, names in left.items() if one.startswith(head)]
        said += [f"{head}{'; '.join(ranges)}"] if ranges else []
    return doubts, remarks


def turned(m: Any, k: int) -> tuple[int, float]:
    """Return the joint that an actuator turns, and the change of its length by the joint's position.

    It is 0 for an actuator of no joint or of several.
    """
    kind, target, gear = m.actuator_trntype[k], int(m.actuator_trnid[k, 0]), float(m.actuator_gear[k, 0])
    if kind in JOINT_TRANSMISSIONS:
        return target, gear
    turned: dict[int, float] = {}
    follow, held = couplings(m), held_joints(m)
    for joint, c in joints_of(m, target).items() if kind == TENDON else ():
        for _ in follow:  # to the end of a chain
            if joint in follow and joint not in held:
                joint, c = follow[joint].leader, c * follow[joint].b
        if joint not in held:
            turned[joint] = turned.get(joint, 0.0) + c
    (joint, c), *others = turned.items() or [(-1, 0.0)]
    return (-1, 0.0) if others else (joint, gear * c)


def _most(m: Any, k: int) -> tuple[float, tuple[float, float]]:
    """Return what the force of an actuator is limited to by its joint, either way, and by its tendon."""
    kind, target, gear, forces = m.actuator_trntype[k], int(m.actuator_trnid[k, 0]), m.actuator_gear[k, 0], INFINITE
    arms = {target: 1.0} if kind in JOINT_TRANSMISSIONS else {}
    if kind == TENDON:
        arms = joints_of(m, target) if turned(m, k)[0] >= 0 else {}
        if getattr(m, "tendon_actfrclimited", np.zeros(m.ntendon))[target]:  # not in older versions of MuJoCo
            forces = (float(m.tendon_actfrcrange[target, 0]), float(m.tendon_actfrcrange[target, 1]))
    limited = {j: abs(gear * c) for j, c in arms.items() if m.jnt_actfrclimited[j] and gear * c}
    limits = (float(np.abs(m.jnt_actfrcrange[j]).max() / arm) for j, arm in limited.items())
    return min(limits, default=math.inf), forces


def _row(m: Any, k: int, gear: float) -> _Row:
    control = int(m.actuator_ctrladr[k]) if hasattr(m, "actuator_ctrladr") else k
    limited = 0 <= control < m.nu and m.actuator_ctrllimited[control] and not m.opt.disableflags & NO_CLAMP
    controls = m.actuator_ctrlrange[control] if limited else (-math.inf, math.inf)
    most, (weakest, strongest) = _most(m, k)
    own = m.actuator_forcerange[k].tolist() if m.actuator_forcelimited[k] else INFINITE
    forces = (max(own[0], weakest), min(own[1], strongest))
    group = int(m.actuator_group[k])
    more = {  # which only newer versions of MuJoCo have
        "ignored the nonlinear damping of actuators": np.any(getattr(m, "actuator_dampingpoly", np.zeros(k + 1))[k]),
        "ignored the delay of actuators, which act without delay": getattr(m, "actuator_delay", np.zeros(k + 1))[k],
    }
    return _Row(
        name=m.actuator(k).name or str(k),
        gear=gear,
        kind=(int(m.actuator_dyntype[k]), int(m.actuator_gaintype[k]), int(m.actuator_biastype[k])),
        dyn=m.actuator_dynprm[k].tolist(),
        gain=m.actuator_gainprm[k].tolist(),
        bias=m.actuator_biasprm[k].tolist(),
        controls=(float(controls[0]), float(controls[1])),
        control=float(np.abs(controls).max()),
        force=min(float(np.abs(forces).max()), most),
        forces=forces,
        uneven=(bool(controls[0] != -controls[1]), bool(forces[0] != -forces[1])),
        armature=float(m.actuator_armature[k]) if hasattr(m, "actuator_armature") else 0.0,
        damping=float(m.actuator_damping[k]) if hasattr(m, "actuator_damping") else 0.0,
        inputs=int(m.actuator_ctrlspec[k]) if hasattr(m, "actuator_ctrlspec") else 0,
        off=bool(m.opt.disableflags & NO_ACTUATION or (0 <= group < 31 and m.opt.disableactuator >> group & 1)),
        more=tuple(what for what, holds in more.items() if holds),
    )


def _read(row: _Row, timestep: float) -> _Read:
    """Read an actuator as servo or effort, and what of it is ignored."""
    if row.off:
        return _Read(reasons=("ignored actuators that the file switches off", *row.more))
    if row.kind[0] == DC_DYNAMICS:
        servo, reasons = _dc_motor(row, timestep)
        turned = (OWN_ANGLE,) * (row.gear < 0)
        kept = _range(row, 1.0) if row.gear and row.inputs & POSITION_INPUT else INFINITE
        ignored = (f"ignored actuators {reason}" for reason in reasons)
        return _Read(servo, None, (*ignored, *_said(KEPT, kept), *turned, *row.more), kept)
    if row.kind == (NO_DYNAMICS, FIXED_GAIN, NO_BIAS):
        return _motor(row)
    linear = row.kind[1:] == (FIXED_GAIN, AFFINE_BIAS) and row.gain[0] > 0 and row.bias[1] < 0 and not row.bias[0]
    if not linear or not row.gear or row.kind[0] not in (NO_DYNAMICS, *FILTERS):
        return _Read(reasons=("ignored actuators of an unsupported kind", *row.more))
    return _position(row)


def _motor(row: _Row) -> _Read:
    """Return the largest torque of a motor on its joint."""
    g, gain = abs(row.gear), abs(row.gain[0])
    most = min(gain * row.control if gain else 0.0, row.force)
    low, high = (gain * u if gain else 0.0 for u in row.controls)
    uneven = max(low, row.forces[0]) != -min(high, row.forces[1])
    reasons = ("took the larger limit of motors either way, for a joint has one effort",) * uneven
    most = g * most if g else 0.0
    free = (f"{FREE_TORQUE}{-most:.6g} to {most:.6g}",) * (most < math.inf)
    return _Read(effort=most, reasons=(*reasons, *free, *row.more))


def _position(row: _Row) -> _Read:
    g = abs(row.gear)
    law = Controller("pd_clamped", Kp=-g * g * row.bias[1], Kd=-g * g * row.bias[2], torque_limit=g * row.force)
    found = {
        "took activations of actuators as being at once, though they are filtered": row.kind[0] != NO_DYNAMICS,
        OWN_ANGLE: row.gear != 1,
        SCALED: row.gain[0] != -row.bias[1],
        LARGER_END: row.uneven[1],
    }
    kept, reasons = _range(row, row.gain[0] / -row.bias[1]), (reason for reason, holds in found.items() if holds)
    return _Read(Servo(law), None, (*reasons, *_said(KEPT, kept), *row.more), kept)


def _tendon_drive(row: _Row) -> tuple[Controller | None, tuple[str, ...]]:
    """Read an actuator of a tendon as the law of a drive, and what of it is ignored."""
    if row.off:
        return None, ("ignored actuators that the file switches off", *row.more)
    bias = row.bias[:3] if row.kind[2] == AFFINE_BIAS else (0.0, 0.0, 0.0)
    plain = row.kind[0] in (NO_DYNAMICS, *FILTERS) and row.kind[1] == FIXED_GAIN and row.kind[2] <= AFFINE_BIAS
    if not plain or not row.gear or max(bias[1:]) > 0:
        return None, ("ignored actuators of an unsupported kind", *row.more)
    g = abs(row.gear)
    Kp, Kd = (-g * g * x for x in bias[1:])
    law = Controller("pd_clamped", Kp=abs(Kp), Kd=abs(Kd), torque_limit=g * row.force)
    found = {
        "took activations of actuators as being at once, though they are filtered": row.kind[0] != NO_DYNAMICS,
        "ignored the force limit of actuators on tendons, for forces of tau": not Kp and row.force < math.inf,
        FREE_FORCE: not Kp and row.control < math.inf,
        LARGER_END: row.uneven[1],
        OWN_FORCE: not Kp,
    }
    if Kp:
        found[OWN_LENGTH] = row.gear != 1 or bias[0] != 0 or row.gain[0] != -bias[1]
        found |= dict.fromkeys(_said(RANGED, _range(row, row.gain[0] / -bias[1], bias[0] / -bias[1])), True)
    return law, (*(reason for reason, holds in found.items() if holds), *row.more)


def _range(row: _Row, gain: float, offset: float = 0.0) -> tuple[float, float]:
    """Return where MuJoCo keeps a reference, whose angle or length times the gear is gain u + offset."""
    low, high = sorted((gain * u + offset) / row.gear for u in row.controls)
    return (low, high) if math.isfinite(high - low) else INFINITE


def _said(head: str, reference: tuple[float, float]) -> tuple[str, ...]:
    """Return the words about a range, none about an infinite one."""
    low, high = reference
    return (f"{head}{low:.6g} to {high:.6g}",) if math.isfinite(high - low) else ()


def _dc_motor(row: _Row, timestep: float) -> tuple[Servo | None, list[str]]:
    """Read a motor with the voltage law of its controller; without gains if it has none."""
    g, (R, K), (kp, ki, kd, most) = abs(row.gear), row.gain[:2], row.gain[4:8]
    if not (g > 0 and R > 0 and K > 0):
        return None, ["without gear, resistance or motor constant"]
    more = any([*row.dyn[2:9], *row.bias[:6], *row.gain[2:4]])
    reasons = ["whose cogging, friction (lugre), heat, slewmax or Imax is left out"] * more
    gains: dict[str, Any] = {"Kp": R / K * kp * g, "Ki": R / K * ki * g, "Kd": max(0.0, (R / K * kd - K) * g)}
    if not row.inputs & POSITION_INPUT:
        gains, reasons = {}, [*reasons, "that take no position: their gains are zero here, give them a controller"]
        most = most or row.control  # which is a voltage
    elif R / K * kd < K:
        reasons.append("whose kd is below K^2/R: Kd is 0 here, and the back-EMF damps more than in MuJoCo")
    servo = Servo(
        Controller("state", **gains, period=timestep, lag=0.0),
        Gearbox(g, rotor_inertia=row.armature),
        resistance=R,
        inductance=row.dyn[0] * R,
        motor_constant=K,
        voltage_limit=min(most or NO_LIMIT, NO_LIMIT),
        current_limit=row.force / K,
        current_slew=row.dyn[1] or math.inf,
        viscous_friction=g * g * row.damping,
    )
    return servo, reasons
