"""From a compiled scene to bodies, joints and contacts in maximal coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...base.fixed_order import applied, product
from ...base.portable_math import exp, sincos
from ...core.effects.ground import Plane
from ...core.effects.mipsd_servo import MipsdServo
from ...core.effects.rigid_servo import RigidServo
from ...core.effects.touch import Spheres
from ...core.tree.layout import PRISMATIC
from ...scene.compile import CompiledScene
from ...scene.records import records
from .engine import Engine
from .layout import AXIS, BODY, COLUMNS, DRIVE, HINGE, INTEGERS, JOINT, NUMBERS, POINT, TURN, UNIVERSAL, WELD

CROSS = 0.1  # a body lighter than this share of both its neighbors may be the cross of a universal joint
NOMINAL = 1e-3  # [s] the step to which slew and filter of a step belong
LIKE = "featherstone_gait.simulate has it"


def assembled(scene: CompiledScene, engine: Engine, welded: Sequence[str] = (), y: np.ndarray | None = None) -> tuple:
    """Return the arrays of `World` for a scene; y: the state in which `welded` joints are held (zero if None).

    A body is read as the cross of a universal joint if it carries one joint, touches nothing, is lighter than a tenth
    of both bodies beside it and the axes meet at right angles in it; its mass goes to the body that it carries.
    Raises ValueError for what this engine has not: joints that slide or follow others, rotors on rigid gearboxes and
    armature, friction that depends on load, springs, pushes, a supply, ground with steps or of a height field, rims.
    """
    _check(scene, welded)
    tree = scene.constants.tree
    crosses = _crosses(scene, welded)
    number = _numbers(scene, crosses)
    bodies = _bodies(scene, number, crosses)
    joints, axes = _joints(scene, (bodies, number, crosses), welded, y)
    assert len(axes) == len(tree) - 1
    return (bodies, joints, axes, _points(scene, bodies, number), engine.record(), _drive(scene, engine, welded))


def _check(scene: CompiledScene, welded: Sequence[str]) -> None:
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
        "contacts with a rim": contact is not None and not isinstance(contact.contact_geometry, Spheres | None),
        "an integrator of free steps": scene.adaptive,
    }
    for what, there in lacking.items():
        if there:
            raise ValueError(f"{name}: {what}: bodies and constraints are not made for it here; {LIKE}")
    for joint in welded:
        if joint not in scene.model.joint_names:
            known = ", ".join(scene.model.joint_names)
            raise ValueError(f"{name}: welded: there is no moving joint {joint!r}; there are {known}")


def _crosses(scene: CompiledScene, welded: Sequence[str]) -> dict[int, int]:
    """Return the rows of the tree that are crosses of universal joints, and the row that each carries."""
    tree, names = scene.constants.tree, scene.model.joint_names
    touching = set() if scene.constants.contact is None else {p.body for p in scene.constants.contact.points}
    found: dict[int, int] = {}
    for k in range(1, len(tree)):
        carried = [i for i in range(1, len(tree)) if tree[i].parent == k]
        if len(carried) != 1 or k in touching or tree[k].parent in found:
            continue
        body, child, parent = tree[k], tree[carried[0]], tree[tree[k].parent]
        heavy = tree[k].parent == 0 and not scene.tree.floating
        light = body.m <= CROSS * child.m and (heavy or body.m <= CROSS * parent.m)
        meet = np.abs(child.r).max() < 1e-9 and abs(child.E[8]) < 1e-9
        if light and meet and not {names[body.dof], names[child.dof]} & {*welded}:
            found[k] = carried[0]
    return found


def _numbers(scene: CompiledScene, crosses: dict[int, int]) -> dict[int, int]:
    """Return the number of the body of each row of the tree; the world is body 0."""
    rows = [k for k in range(len(scene.constants.tree)) if k not in crosses]
    return {row: k + int(scene.tree.floating) for k, row in enumerate(rows)}


def _symmetric(J: np.ndarray) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = J
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _six(J: np.ndarray) -> np.ndarray:
    return np.array([J[0, 0], J[0, 1], J[0, 2], J[1, 1], J[1, 2], J[2, 2]])


def _inverse(J: np.ndarray) -> np.ndarray:
    """Invert a symmetric 3 x 3 matrix by its minors, with the same bits everywhere; infinite if it is singular."""
    (a, b, c), (_, d, e), (_, _, f) = J
    minors = np.array([d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b])
    determinant = a * minors[0] + b * minors[1] + c * minors[2]
    return minors / determinant if determinant > 0.0 else np.full(6, np.inf)


def _bodies(scene: CompiledScene, number: dict[int, int], crosses: dict[int, int]) -> np.recarray:
    tree = scene.constants.tree
    table = records(1 + max(number.values()), BODY)
    table.row = -1
    for row, k in number.items():
        body = table[k]
        body.row = row
        if k == 0:
            continue
        m, c, J = tree[row].m, np.array(tree[row].c), _symmetric(tree[row].J)
        if tree[row].parent in crosses and crosses[tree[row].parent] == row:
            m, c, J = _with_cross(tree[tree[row].parent], tree[row], (m, c, J))
        inverse = _inverse(J)
        if not (m > 0.0 and np.isfinite(inverse).all() and inverse[[0, 3, 5]].min() > 0.0):
            raise ValueError(
                f"{scene.model.name}: body {scene.tree.names[row]!r} of {m:g} kg has not an inertia against every "
                f"motion; bodies in maximal coordinates need both: give it some; {LIKE}"
            )
        body.mass, body.inverse_mass, body.center = m, 1.0 / m, c
        body.inertia, body.inverse_inertia = _six(J), inverse
    return table


def _with_cross(cross: Any, child: Any, own: tuple[float, np.ndarray, np.ndarray]) -> tuple[float, Any, Any]:
    """Return mass, center and inertia of the child with the cross, the joint between them at zero."""
    E = np.array(child.E).reshape(3, 3).T  # cross -> child
    parts = [own, (cross.m, applied(E, np.array(cross.c)), product(product(E, _symmetric(cross.J)), E.T))]
    m = parts[0][0] + parts[1][0]
    center = (parts[0][0] * parts[0][1] + parts[1][0] * parts[1][1]) / m
    total = np.zeros((3, 3))
    for mass, c, J in parts:
        d = c - center
        total = total + J + mass * ((d * d).sum() * np.eye(3) - d[:, None] * d)
    return m, center, total


def _joints(
    scene: CompiledScene, of: tuple[np.recarray, dict, dict], welded: Sequence[str], y: np.ndarray | None
) -> tuple[np.recarray, np.recarray]:
    (bodies, number, crosses), tree = of, scene.constants.tree
    rows = [k for k in range(1, len(tree)) if k not in crosses]
    joints, axes, at = records(len(rows), JOINT), records(len(tree) - 1, AXIS), 0
    for joint, row in zip(joints, rows):
        hung = tree[row].parent
        cross = hung if crosses.get(hung) == row else None
        chain = [row] if cross is None else [cross, row]
        first = tree[chain[0]]
        joint.a, joint.b, joint.axis = number[first.parent], number[row], at
        joint.anchor_a = np.array(first.r) - bodies[joint.a].center
        joint.anchor_b = -bodies[joint.b].center
        joint.first, joint.second = first.E, np.eye(3).ravel()
        joint.kind, joint.phase_cosine = HINGE, 1.0
        if cross is not None:
            joint.kind, joint.second = UNIVERSAL, tree[row].E
            joint.phase_cosine, joint.phase_sine = tree[row].E[2], tree[row].E[5]
        for k in chain:
            _fill_axis(scene, axes[at], int(tree[k].dof))
            at += 1
        name = scene.model.joint_names[tree[row].dof]
        if name in welded:
            joint.kind = WELD
            angle = 0.0 if y is None else float(y[scene.layout["q"] + tree[row].dof])
            s, c = sincos(angle)
            turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            joint.first = product(np.array(first.E).reshape(3, 3), turned).ravel()
    return joints, axes


def _fill_axis(scene: CompiledScene, axis: Any, dof: int) -> None:
    joint = scene.model.moving_joints[dof]
    servo = scene.model.servos.get(joint.name) if scene.gearbox else None
    axis.dof, axis.lower, axis.upper, axis.damping = dof, joint.lower, joint.upper, joint.damping
    axis.dry = joint.friction + (servo.coulomb_friction if servo else 0.0)


def _drive(scene: CompiledScene, engine: Engine, welded: Sequence[str]) -> np.recarray:
    table, h = records(len(scene.model.joint_names), DRIVE), scene.timestep
    per_step = NOMINAL if engine.per_step else h
    for row, joint in zip(table, scene.model.moving_joints):
        servo = scene.model.servos.get(joint.name) if scene.gearbox else None
        row.on = joint.name not in welded
        if servo is None:
            continue
        row.viscous, row.voltage_limit = servo.viscous_friction, servo.voltage_limit
        row.filter_left = float(exp(np.array([-per_step / servo.speed_filter]))[0]) if servo.speed_filter > 0 else 0.0
        row.slew = servo.current_slew * per_step
        row.hardening = engine.hardening
        row.damper_limit = engine.damper_share * servo.gearbox.ratio * servo.gearbox.rotor_inertia / h
    return table


def _points(scene: CompiledScene, bodies: np.recarray, number: dict[int, int]) -> np.recarray:
    contact = scene.constants.contact
    if contact is None:
        return records(0, POINT)
    plane, table = contact.ground.plane[0], records(len(contact.points), POINT)
    for k, (row, point) in enumerate(zip(table, contact.points)):
        row.a, row.b, row.place = number[int(point.body)], 0, k
        row.position = np.array(point.position) - bodies[row.a].center
        row.radius = 0.0 if contact.contact_geometry is None else contact.contact_geometry.radius[k]
        row.normal, row.first, row.second, row.height = plane.normal, plane.first, plane.second, plane.height
        row.friction = point.friction
    return table


def work_of(world: tuple, seed: int, scene: CompiledScene | None = None) -> tuple:
    """Return the arrays of `Work` for a world, and the tree's workspace; bodies at the origin, at rest."""
    bodies, joints, axes, points, engine, _ = world
    rows = 6 * len(joints) + 2 * len(axes) + 3 * len(points)
    direct = rows if engine[0].iterations == 0 else 0
    X = np.zeros((len(bodies), COLUMNS))
    X[:, TURN] = 1.0
    words = np.random.SeedSequence(seed).generate_state(2)
    random = np.array([1 + int(words[0]) % 2147483562, 1 + int(words[1]) % 2147483398])
    return (
        X,
        np.zeros((rows, 12)),
        np.zeros((rows, 12)),
        np.zeros((rows, NUMBERS)),
        np.zeros((rows, INTEGERS), np.int64),
        np.zeros((len(bodies), 6)),
        np.zeros(rows, np.int64),
        np.zeros((direct + 1, direct + 1)),
        np.zeros((len(axes), 3)),
        random,
        np.zeros(4, np.int64),
        np.zeros((1, 1)) if scene is None else np.zeros(scene.tree.workspace_shape()),
    )
