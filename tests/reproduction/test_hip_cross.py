"""The universal hip joint is two joints with a small body between: what that body weighs must not matter."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait.model import Ground
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import simulate
from featherstone_gait.scene.compile import compile_scene


def with_cross(mass):
    """The simplified humanoid with hip crosses of another mass [kg], taken from or given to the thighs."""
    model = load_robot("humanoid", locked="simplified")
    cross = {link.name: link for link in model.links}["left_hip_cross"].mass

    def changed(link):
        if link.name.endswith("hip_cross"):
            return replace(link, mass=mass, inertia=tuple(mass / cross * x for x in link.inertia))
        if link.name.endswith("thigh"):
            return replace(link, mass=link.mass + cross - mass)
        return link

    return replace(model, links=tuple(changed(link) for link in model.links))


def squat(mass):
    """Knees bend and the trunk sways for a second on the ground; angles, base and energy drawn."""
    model = with_cross(mass)
    scene = compile_scene(model, gearbox="mipsd", ground=Ground(), timestep=1e-3)
    names = model.joint_names
    times = np.linspace(0.0, 1.0, 101)
    bend, sway = 0.3 * (1 - np.cos(2 * np.pi * times)) / 2, 0.1 * np.sin(2 * np.pi * times)
    angles = np.zeros((len(times), len(names)))
    for side in ("left", "right"):
        angles[:, names.index(f"{side}_hip_front")] = bend
        angles[:, names.index(f"{side}_knee")] = -2 * bend
        angles[:, names.index(f"{side}_ankle_front")] = bend
        angles[:, names.index(f"{side}_hip_lateral")] = sway
        angles[:, names.index(f"{side}_ankle_lateral")] = -sway
    run = simulate(scene, 1.0, reference=Reference(times, angles, "cubic"), record=("q", "base_q", "energy"))
    assert run.status == "ok", run.message
    return run["q"], run["base_q"], run["energy"][-1, :, 1].sum()


def test_total_mass_stays():
    assert with_cross(0.001).mass == pytest.approx(2.423, abs=1e-12)
    assert with_cross(0.010).mass == pytest.approx(2.423, abs=1e-12)


@pytest.mark.parametrize("mass", [0.0005, 0.010])
def test_motion_and_energy_do_not_depend_on_the_cross(mass):
    """From 0.5 to 10 g: joint angles within 0.05 deg, the trunk within 0.2 mm, the energy drawn within 0.5 %."""
    q, base, energy = squat(0.005)
    other_q, other_base, other_energy = squat(mass)
    assert np.degrees(np.abs(q - other_q).max()) < 0.05
    assert np.abs(base[:, :3] - other_base[:, :3]).max() < 2e-4
    assert other_energy == pytest.approx(energy, rel=5e-3)
    assert np.degrees(np.ptp(q, axis=0).max()) > 25  # the legs did move
