"""Actuators of a compiled MJCF file: servos, and limits of joints.

Of a joint, an actuator of gear g has the length g q and turns a force F into the torque g F.

position
    F = kp u - kp l - kv dl/dt, limited by forcerange: the law pd_clamped with Kp = g^2 kp, Kd = g^2 kv.
dcmotor with the input "pos"
    U = R/K (kp (u - l) - kd dl/dt) + K dl/dt, limited by Vmax: the law state with Kp = R/K kp g, Kd = (R/K kd - K) g
    and Ki = R/K ki g; its current follows R I + L dI/dt = U - K dl/dt, limited by the torque over K.
motor
    F = u: the product of gear and control limit is the most the joint is given, its `effort`.

Source: MuJoCo's XML reference and technical note on its dcmotor.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

from ...model import Controller, Gearbox, Joint, Servo
from .causes import listed
from .names import actuator_count
from .tree import Tree

JOINT_TRANSMISSIONS = (0, 1)  # mjTRN_JOINT, mjTRN_JOINTINPARENT
NO_DYNAMICS, DC_DYNAMICS = 0, 5  # mjtDyn
FIXED_GAIN, NO_BIAS, AFFINE_BIAS = 0, 0, 1  # mjtGain, mjtBias
POSITION_INPUT = 1  # mjtCtrlInput
NO_LIMIT = 1e6  # voltage [V] of a motor that has none


class Actuators(NamedTuple):
    """What the actuators say."""

    servos: dict[str, Servo]  # by joint
    joints: tuple[Joint, ...]  # with what actuators add to them
    doubts: list[str]


class _Row(NamedTuple):
    """An actuator of a joint."""

    name: str
    gear: float
    kind: tuple[int, int, int]  # dynamics, gain, bias
    dyn: list[float]
    gain: list[float]
    bias: list[float]
    control: float  # most of the control, either way
    force: float  # most of the force, either way
    armature: float
    damping: float
    inputs: int  # which controls it has


def read_actuators(m: Any, tree: Tree, joints: tuple[Joint, ...]) -> Actuators:
    """Servos and limits from the actuators, and what of them is passed over."""
    by_name = {joint.name: joint for joint in joints}
    servos: dict[str, Servo] = {}
    left: dict[str, list[str]] = {}
    for k in range(actuator_count(m)):
        name = tree.joint_names[m.actuator_trnid[k, 0]] if m.actuator_trntype[k] in JOINT_TRANSMISSIONS else ""
        if name not in by_name:
            left.setdefault("that are not on one joint", []).append(m.actuator(k).name or str(k))
            continue
        row = _row(m, k)
        servo, joint, reasons = _read(row, by_name[name], float(m.opt.timestep))
        by_name[name] = joint
        if servo is not None and name not in servos:
            servos[name] = servo
        elif servo is not None:
            reasons = ["on a joint that has a servo already"]
        for reason in reasons:
            left.setdefault(reason, []).append(row.name)
    doubts = [f"passed over actuators {reason}: {listed(names)}" for reason, names in left.items()]
    return Actuators(servos, tuple(by_name[joint.name] for joint in joints), doubts)


def _row(m: Any, k: int) -> _Row:
    control = int(m.actuator_ctrladr[k]) if hasattr(m, "actuator_ctrladr") else k
    limited = 0 <= control < m.nu and m.actuator_ctrllimited[control]
    return _Row(
        name=m.actuator(k).name or str(k),
        gear=float(m.actuator_gear[k, 0]),
        kind=(int(m.actuator_dyntype[k]), int(m.actuator_gaintype[k]), int(m.actuator_biastype[k])),
        dyn=m.actuator_dynprm[k].tolist(),
        gain=m.actuator_gainprm[k].tolist(),
        bias=m.actuator_biasprm[k].tolist(),
        control=float(abs(m.actuator_ctrlrange[control]).max()) if limited else math.inf,
        force=float(abs(m.actuator_forcerange[k]).max()) if m.actuator_forcelimited[k] else math.inf,
        armature=float(m.actuator_armature[k]) if hasattr(m, "actuator_armature") else 0.0,
        damping=float(m.actuator_damping[k]) if hasattr(m, "actuator_damping") else 0.0,
        inputs=int(m.actuator_ctrlspec[k]) if hasattr(m, "actuator_ctrlspec") else 0,
    )


def _read(row: _Row, joint: Joint, timestep: float) -> tuple[Servo | None, Joint, list[str]]:
    """The servo that an actuator is, the joint with what the actuator adds to it, and what is passed over."""
    if row.kind[0] == DC_DYNAMICS:
        servo, reasons = _dc_motor(row, timestep)
        return servo, joint, reasons
    g = abs(row.gear)
    joint = replace(joint, armature=joint.armature + g * g * row.armature, damping=joint.damping + g * g * row.damping)
    if row.kind == (NO_DYNAMICS, FIXED_GAIN, NO_BIAS):
        most = g * min(abs(row.gain[0]) * row.control, row.force)
        return None, replace(joint, effort=min(joint.effort, most)), []
    if row.kind[1:] != (FIXED_GAIN, AFFINE_BIAS) or not row.gain[0] == -row.bias[1] > 0 or row.bias[0]:
        return None, joint, ["of a kind that has no like here"]
    filtered = ["whose activation is filtered: it is at once here"] if row.kind[0] else []
    return _position(row), joint, filtered


def _position(row: _Row) -> Servo:
    g = abs(row.gear)
    law = Controller("pd_clamped", Kp=g * g * row.gain[0], Kd=-g * g * row.bias[2], torque_limit=g * row.force)
    return Servo(law)


def _dc_motor(row: _Row, timestep: float) -> tuple[Servo | None, list[str]]:
    """A motor with the voltage law of its controller; without gains where it has none."""
    g, (R, K), (kp, ki, kd, most) = abs(row.gear), row.gain[:2], row.gain[4:8]
    if not (g > 0 and R > 0 and K > 0):
        return None, ["without gear, resistance or motor constant"]
    reasons = ["whose cogging, friction (lugre), heat, slewmax or Imax is left out"] * _has_more(row)
    gains = {"Kp": R / K * kp * g, "Ki": R / K * ki * g, "Kd": max(0.0, (R / K * kd - K) * g)}
    if not row.inputs & POSITION_INPUT:
        gains, reasons = {}, [*reasons, "that take no position: their gains are zero here, give them a controller"]
    elif R / K * kd < K:
        reasons.append("whose kd is below K^2/R: Kd is 0 here, and the back-EMF damps more than in MuJoCo")
    servo = Servo(
        Controller("state", **gains, period=timestep, lag=0.0),
        Gearbox(g, rotor_inertia=row.armature),
        resistance=R,
        inductance=row.dyn[0] * R,
        motor_constant=K,
        voltage_limit=most or min(row.control, NO_LIMIT),
        current_limit=row.force / K,
        current_slew=row.dyn[1] or math.inf,
        viscous_friction=g * g * row.damping,
    )
    return servo, reasons


def _has_more(row: _Row) -> bool:
    """Whether a dcmotor has cogging, LuGre friction, a temperature, or limits of its setpoint or integral."""
    return any([*row.dyn[2:9], *row.bias[:6], *row.gain[2:4]])
