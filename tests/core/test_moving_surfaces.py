"""Grounds whose surface moves, and wheels with rollers, against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import (
    Box,
    ContactPoint,
    Ground,
    HeightField,
    Joint,
    Link,
    Model,
    body,
    compile_scene,
    initial_state,
    simulate,
    simulate_batch,
)

G = 9.81


def box(friction=0.4):
    return body(Box((0.2, 0.2, 0.02)), 1.0, friction=friction)


@pytest.mark.long
def test_a_box_on_a_belt_slides_until_it_moves_along():
    """Its speed is mu g t up to the belt's; the belt's work is that and what friction takes."""
    mu, v = 0.4, 1.0
    scene = compile_scene(box(mu), ground=Ground(velocity=(v, 0.0), penetration=1e-5), fall_height=-1e6)
    run = simulate(scene, 0.6, initial_state(scene), record=("base_q", "base_qd", "contact_work"), rtol=1e-6)
    speed, t = run["base_qd"][:, 0], run["time"]
    sliding = (t > 0.02) & (t < 0.23)
    assert np.diff(speed[sliding]) / np.diff(t[sliding]) == pytest.approx(mu * G, rel=1e-4)
    assert speed[-1] == pytest.approx(v, rel=1e-6)
    reached = v / (mu * G)
    assert run["base_q"][-1, 0] == pytest.approx(v * (0.6 - 0.5 * reached), rel=1e-3)
    # On the body the ground did the work of its kinetic energy alone; the other half of the belt's is friction's.
    assert run["contact_work"][-1, 0] == pytest.approx(0.5 * v * v, rel=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_turntable_carries_a_box_while_friction_can(share):
    mu, r = 0.3, 0.5
    w = math.sqrt(share * mu * G / r)
    cube = body(Box((0.02, 0.02, 0.002)), 1.0, friction=mu)
    scene = compile_scene(cube, ground=Ground(turning=w, penetration=1e-5), fall_height=-1e6, fall_tilt=math.pi)
    y = initial_state(scene)
    view = scene.state_view(y)
    view.base_q[0], view.base_qd[1], view.base_qd[5] = r, r * w, w
    run = simulate(scene, 2.0, y, record=("base_q", "base_qd"))
    away = np.hypot(run["base_q"][:, 0], run["base_q"][:, 1])
    if share < 1.0:
        assert away == pytest.approx(r, rel=1e-3)
        turned = np.unwrap(np.arctan2(run["base_q"][:, 1], run["base_q"][:, 0]))
        assert turned[-1] == pytest.approx(2.0 * w, rel=1e-3)
    else:
        assert away[-1] > 1.5 * r


def wheel(angle, friction=0.8):
    """Return a wheel on an axle along y, which slides along all axes and is held upright."""
    links = (
        Link("ground"), Link("x"), Link("y"), Link("z"),
        Link("wheel", 1.0, (0.0, 0.0, 0.0), (2e-3, 0.0, 0.0, 4e-3, 0.0, 2e-3)),
    )  # fmt: skip
    joints = (
        Joint("along", "prismatic", "ground", "x", axis=(1.0, 0.0, 0.0), lower=-1e3, upper=1e3),
        Joint("across", "prismatic", "x", "y", axis=(0.0, 1.0, 0.0), lower=-1e3, upper=1e3),
        Joint("up", "prismatic", "y", "z", axis=(0.0, 0.0, 1.0), lower=-1e3, upper=1e3),
        Joint("axle", "continuous", "z", "wheel", axis=(0.0, 1.0, 0.0)),
    )
    rim = ContactPoint(
        "wheel", (0.0, 0.0, 0.0), circle_radius=0.1, axis=(0.0, 1.0, 0.0), friction=friction, roller_angle=angle
    )
    return Model("cart", links, joints, contacts=(rim,))


@pytest.mark.long
@pytest.mark.parametrize("angle", [math.pi / 2, math.pi / 4, -math.pi / 4])
def test_a_wheel_with_rollers_slips_across_their_axis_alone(angle):
    """Along the rollers' axis d nothing slips, d.(v - w r x) = 0, and across it there is no force."""
    scene = compile_scene(wheel(angle), ground=Ground(penetration=1e-5))
    y = initial_state(scene)
    scene.state_view(y).q[2] = 0.1 - 1e-5
    # pushed at 45 degrees to the axle
    run = simulate(scene, 0.5, y, tau=[1.0, 1.0, 0.0, 0.0], record=("q", "qd", "contact_force"), rtol=1e-6)
    assert run.success
    d = np.array([-math.sin(angle), math.cos(angle)])  # from the axle, along y, about z
    vx, vy, _, w = run["qd"][-1]
    slip = np.array([vx - 0.1 * w, vy])
    assert abs(slip @ d) < 1e-5 * np.hypot(vx, vy)
    force = run["contact_force"][-1, 0, 1:]
    assert abs(force @ [-d[1], d[0]]) < 1e-9
    # of m v' = push + f d, J w' = -r f d.x and d.(v' - w' r x) = 0
    effective = 1.0 + 0.01 * d[0] ** 2 / 4e-3
    assert force @ d == pytest.approx(-(d[0] + d[1]) / effective, rel=1e-3, abs=1e-6)


@pytest.mark.long
def test_runs_on_a_turntable_have_the_same_bits_in_lanes_as_alone():
    model = replace(wheel(math.pi / 4), name="wheel")
    scene = compile_scene(model, ground=Ground(turning=0.5, velocity=(0.1, 0.2)), integrator="implicit_euler")
    starts = []
    for k in range(9):
        y = initial_state(scene)
        scene.state_view(y).q[:3] = 0.1 * k, 0.0, 0.1
        starts.append(y)
    together = simulate_batch(scene, 0.3, starts, estimate_error=False)
    for start, run in zip(starts, together):
        assert simulate(scene, 0.3, start, estimate_error=False).final.tobytes() == run.final.tobytes()


@pytest.mark.parametrize(("changes", "words"), [({"velocity": (1.0,)}, "velocity"), ({"turning": math.inf}, "turning")])
def test_motions_of_a_ground_that_make_no_sense_are_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        Ground(**changes)


def test_fields_and_shapes_refuse_a_surface_that_moves():
    field = HeightField(np.zeros((3, 3)), (1.0, 1.0))
    with pytest.raises(ValueError, match="height field"):
        Ground(field=field, turning=1.0)
    bare = replace(box(), contacts=())
    with pytest.raises(ValueError, match="contact points"):
        compile_scene(bare, ground=Ground(turning=1.0), pairs="all")
