"""From a compiled scene to bodies, joints and contacts in maximal coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...base.fixed_order import applied
from ...base.portable_math import exp
from ...base.records import filled, records
from ...core.effects.mipsd_servo import MipsdServo
from ...core.effects.rigid_servo import RigidServo
from ...core.shapes.ground import Plane
from ...core.tree.layout import PRISMATIC
from ...model import Joint
from ...model.rigid_bodies import inertia_matrix, turned_inertia
from ...scene.compile import CompiledScene
from .layout import AXIS, BODY, COLUMNS, ENGINE, JOINT, POINT, ROW, TURN, Engine, Work, World
from .solve import P1, P2

CROSS = 0.1  # a body lighter than this share of both its neighbors may be the cross of a universal joint
NOMINAL = 1e-3  # [s] the step to which slew and filter of a step belong
LIKE = "featherstone_gait.simulate has it"


def assembled(scene: CompiledScene, engine: Engine) -> World:
    """Return the world of a scene.

    A body is read as the cross of a universal joint if it carries one joint, touches nothing, is lighter than a tenth
    of both bodies beside it and the axes meet at right angles in it; its mass goes to the body that it carries.
    Raises ValueError for what this engine lacks.
    """
    _check(scene)
    crosses = _crosses(scene)
    rows = [k for k in range(len(scene.constants.tree)) if k not in crosses]
    number = {row: k + int(scene.tree.floating) for k, row in enumerate(rows)}  # of bodies; the world is body 0
    bodies = _bodies(scene, number, crosses)
    axes = records(len(scene.model.joint_names), AXIS)
    for axis, joint in zip(axes, scene.model.moving_joints):
        _fill_axis(scene, engine, axis, joint)
    joints, points = _joints(scene, bodies, number, crosses), _points(scene, bodies, number)
    return World(bodies, joints, axes, points, filled(ENGINE, [(engine,)]))


def _check(scene: CompiledScene) -> None:
    c, name = scene.constants, scene.model.name
    contact = c.contact
    lacking = {
        "a joint that slides": any(body.kind == PRISMATIC for body in c.tree[1:]),
        "a ball joint": c.balls is not None,
        "a screw joint": any(body.pitch != 0.0 for body in c.tree[1:]),
        "joints that follow others": c.coupling is not None,
        "inertia of a rotor or armature on a joint": c.armature is not None,
        f"{scene.gearbox} servos": c.actuator is not None and not isinstance(c.actuator, RigidServo | MipsdServo),
        "friction that depends on load": isinstance(c.friction, tuple),
        "springs": c.tendons is not None or c.joint_springs is not None or c.stiffening is not None,
        "nonlinear damping": c.drag is not None,
        "pushes": c.push is not None or c.lifts is not None,
        "a supply": c.supply is not None,
        "ground that is no plane": contact is not None
        and (not isinstance(contact.ground, Plane) or len(contact.ground.steps) > 0),
        "contacts that are no points": contact is not None and contact.contact_geometry is not None,
        "an integrator of free steps": scene.adaptive,
    }
    for what, there in lacking.items():
        if there:
            raise ValueError(f"{name}: {what}: bodies and constraints are not made for it here; {LIKE}")


def _crosses(scene: CompiledScene) -> set[int]:
    """Return the rows of the tree that are crosses of universal joints."""
    tree, contact, found = scene.constants.tree, scene.constants.contact, set[int]()
    touching = set() if contact is None else {point.body for point in contact.points}
    for k in range(1, len(tree)):
        carried = [i for i in range(1, len(tree)) if tree[i].parent == k]
        if len(carried) == 1 and k not in touching and tree[k].parent not in found:
            body, child, parent = tree[k], tree[carried[0]], tree[tree[k].parent]
            held = body.parent == 0 and not scene.tree.floating
            light = body.m <= CROSS * child.m and (held or body.m <= CROSS * parent.m)
            if light and np.abs(child.r).max() < 1e-9 and abs(child.E[8]) < 1e-9:
                found.add(k)
    return found


def _inverse(J: np.ndarray) -> np.ndarray:
    """Invert a symmetric 3 x 3 matrix by its minors, with the same bits everywhere; infinite if it is singular."""
    (a, b, c), (_, d, e), (_, _, f) = J
    minors = np.array([d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b])
    determinant = a * minors[0] + b * minors[1] + c * minors[2]
    return minors / determinant if determinant > 0.0 else np.full(6, np.inf)


def _bodies(scene: CompiledScene, number: dict[int, int], crosses: set[int]) -> np.recarray:
    tree = scene.constants.tree
    table = records(1 + max(number.values()), BODY)
    for row, k in number.items():
        body = table[k]
        body.row = row
        if k == 0:
            continue
        m, c, J = tree[row].m, np.array(tree[row].c), inertia_matrix(tree[row].J)
        if tree[row].parent in crosses:
            m, c, J = _with_cross(tree[tree[row].parent], tree[row], (m, c, J))
        inverse = _inverse(J)
        if not (m > 0.0 and np.isfinite(inverse).all() and inverse[[0, 3, 5]].min() > 0.0):
            raise ValueError(
                f"{scene.model.name}: body {scene.tree.names[row]!r} of {m:g} kg has not an inertia against every "
                f"motion; bodies in maximal coordinates need both: give it some; {LIKE}"
            )
        body.mass, body.inverse_mass, body.center = m, 1.0 / m, c
        body.inertia, body.inverse_inertia = J[np.triu_indices(3)], inverse
    return table


def _with_cross(cross: Any, child: Any, own: tuple[float, np.ndarray, np.ndarray]) -> tuple[float, Any, Any]:
    """Return mass, center and inertia of the child with the cross, the joint between them at zero."""
    E = np.array(child.E).reshape(3, 3).T  # cross -> child
    parts = [own, (cross.m, applied(E, np.array(cross.c)), turned_inertia(E, cross.J))]
    m = parts[0][0] + parts[1][0]
    center = (parts[0][0] * parts[0][1] + parts[1][0] * parts[1][1]) / m
    total = np.zeros((3, 3))
    for mass, c, J in parts:
        d = c - center
        total = total + J + mass * ((d * d).sum() * np.eye(3) - d[:, None] * d)
    return m, center, total


def _joints(scene: CompiledScene, bodies: np.recarray, number: dict[int, int], crosses: set[int]) -> np.recarray:
    tree, joints = scene.constants.tree, records(len(number) - 1, JOINT)
    for joint, row in zip(joints, list(number)[1:]):
        last, first = tree[row], tree[row]
        if last.parent in crosses:
            first = tree[last.parent]
            joint.universal, joint.second, joint.second_axis = 1, last.E, last.dof
        joint.a, joint.b, joint.axis, joint.first = number[first.parent], number[row], first.dof, first.E
        joint.anchor_a, joint.anchor_b = np.array(first.r) - bodies[joint.a].center, -bodies[joint.b].center
    return joints


def _fill_axis(scene: CompiledScene, engine: Engine, axis: Any, joint: Joint) -> None:
    axis.lower, axis.upper, axis.damping, axis.dry = joint.lower, joint.upper, joint.damping, joint.friction
    servo, h = scene.model.servos.get(joint.name) if scene.gearbox else None, scene.timestep
    if servo is not None:
        per_step = NOMINAL if engine.per_step else h
        axis.dry += servo.coulomb_friction
        axis.viscous, axis.voltage_limit = servo.viscous_friction, servo.voltage_limit
        axis.filter_left = float(exp(np.array([-per_step / servo.speed_filter]))[0]) if servo.speed_filter > 0 else 0.0
        axis.slew, axis.hardening = servo.current_slew * per_step, engine.hardening
        axis.damper_limit = engine.damper_share * servo.gearbox.ratio * servo.gearbox.rotor_inertia / h


def _points(scene: CompiledScene, bodies: np.recarray, number: dict[int, int]) -> np.recarray:
    contact = scene.constants.contact
    if contact is None:
        return records(0, POINT)
    plane, table = contact.ground.plane[0], records(len(contact.points), POINT)
    table.body = [number[int(row)] for row in contact.points.body]
    table.position = contact.points.position - bodies.center[table.body]
    table.axes = np.concatenate([plane.normal, plane.first, plane.second])
    table.height, table.friction = plane.height, contact.points.friction
    return table


def work_of(world: World, seed: int, scene: CompiledScene, y: np.ndarray) -> Work:
    """Return what the steps of a world overwrite, with views of the state y."""
    bodies, axes = len(world.bodies), len(world.axes)
    rows = 6 * len(world.joints) + 2 * axes + 3 * len(world.points)
    direct = rows if world.engine[0].iterations == 0 else 0
    X = np.zeros((bodies, COLUMNS))
    X[:, TURN] = 1.0
    words = np.random.SeedSequence(seed).generate_state(2)
    return Work(
        q=y[slice(*scene.part("q"))],
        qd=y[slice(*scene.part("qd"))],
        torque=np.zeros(axes),
        X=X,
        rows=records(rows, ROW),
        J=np.zeros((rows, 12)),
        M=np.zeros((rows, 12)),
        S=np.zeros((bodies, 6)),
        order=np.zeros(rows, np.int64),
        D=np.zeros((direct, direct + 1)),
        random=np.array([1 + int(words[0]) % (P1 - 1), 1 + int(words[1]) % (P2 - 1)]),
        unsolved=np.zeros(1, np.int64),
        tree=np.zeros(scene.tree.workspace_shape()),
    )
