"""Linear models by tangents: those of differences within their errors, mirror images, and the same discontinuities."""

import numpy as np
import pytest

from featherstone_gait import Ground, compile_scene, initial_state, linearize, load_robot, trim

pytestmark = pytest.mark.long


@pytest.mark.parametrize(("gearbox", "integrator"), [("mipsd", "midpoint"), (None, "rk4")])
def test_tangents_agree_with_differences(gearbox, integrator):
    scene = compile_scene(load_robot("arm7"), gearbox, integrator=integrator)
    by_differences, exact = linearize(scene, outputs=("qdd",)), linearize(scene, outputs=("qdd",), exact=True)
    for name in "ABCD":
        one, other = getattr(by_differences, name), getattr(exact, name)
        allowed = getattr(by_differences, f"{name}_error") + getattr(exact, f"{name}_error")
        assert (np.abs(one - other) <= 4.0 * allowed).all(), name
        assert getattr(exact, f"{name}_error").max() < 1e-7
    assert exact.states == by_differences.states
    assert exact.inputs == by_differences.inputs
    assert np.array_equal(exact.change, by_differences.change)


def test_a_standing_humanoid_moves_alike_on_both_sides():
    scene = compile_scene(load_robot("humanoid"), "mipsd", Ground(friction=0.8), integrator="midpoint")
    model = linearize(scene, trim(scene).state, steps=1, exact=True)

    def entry(row, column):
        return model.A[model.states.index(row), model.states.index(column)]

    for row, column in (("qdd {}_ankle_front", "qd {}_hip_front"), ("qd {}_knee", "q {}_knee")):
        left, right = (entry(row.format(side), column.format(side)) for side in ("left", "right"))
        assert left == pytest.approx(right, rel=1e-9)
    assert not model.discontinuities


def test_a_hard_stop_is_named_as_by_differences():
    scene = compile_scene(load_robot("arm7"), integrator="implicit_euler")
    joint = next(joint for joint in scene.model.joints if joint.lower is not None and joint.type != "fixed")
    q = np.zeros(len(scene.model.joint_names))
    q[scene.model.joint_names.index(joint.name)] = joint.upper
    state = initial_state(scene, q)
    one, other = linearize(scene, state), linearize(scene, state, exact=True)
    assert one.discontinuities
    assert [each.column for each in one.discontinuities] == [each.column for each in other.discontinuities]
