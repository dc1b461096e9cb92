"""MuJoCo's medium: accelerations of bodies that move in it are MuJoCo's, for boxes of inertia and for ellipsoids."""

import numpy as np
import pytest

from featherstone_gait import Fluid, compile_scene, initial_state, load_robot, load_scene
from featherstone_gait.core.compile.jit import entry
from featherstone_gait.core.integrate.rk4 import _evaluate
from featherstone_gait.run.prepare import prepare

mujoco = pytest.importorskip("mujoco")

ROBOT = """
<mujoco>
  <option density="{density}" viscosity="{viscosity}" wind="0.7 -0.4 0.2" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="hull" pos="0 0 1">
      <freejoint/>
      <inertial pos="0.03 -0.02 0.05" mass="1.3" diaginertia="0.02 0.03 0.025" quat="0.9 0.1 0.3 -0.2"/>
      <geom type="box" size="0.2 0.1 0.05" contype="0" conaffinity="0" {fluid}/>
      <body name="fin" pos="0.2 0.1 0" euler="20 10 -30">
        <joint name="hinge" axis="0.3 0.5 1" pos="0.02 0 0.01"/>
        <geom type="capsule" size="0.03 0.1" pos="0.1 0 0" euler="0 70 10" mass="0.4" contype="0"
              conaffinity="0" {fluid}/>
        <geom type="ellipsoid" size="0.1 0.02 0.05" pos="0.2 0.1 0" mass="0.2" contype="0" conaffinity="0" {fluid}/>
        <body name="tip" pos="0.3 0 0.1">
          <joint name="slide" type="slide" axis="0 1 0.2"/>
          <geom type="cylinder" size="0.04 0.08" mass="0.3" euler="30 0 0" contype="0" conaffinity="0" {fluid}/>
          <geom type="sphere" size="0.05" mass="0.1" pos="0 0.1 0" contype="0" conaffinity="0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
LAWS = {
    "box": (1000.0, 0.9, ""),
    "box in viscous gas": (0.0, 1.5, ""),
    "ellipsoid": (1000.0, 0.9, 'fluidshape="ellipsoid"'),
    "ellipsoid with other coefficients": (1.2, 0.01, 'fluidshape="ellipsoid" fluidcoef="0.7 0.1 1.2 0.4 2.0"'),
}


@entry
def evaluate(run, y, slope):
    """Find the accelerations at a state."""
    _evaluate(run, y, 0.0, slope)


@pytest.mark.parametrize("law", LAWS)
def test_accelerations_are_those_of_mujoco(law, tmp_path):
    density, viscosity, fluid = LAWS[law]
    path = tmp_path / "swimmer.xml"
    path.write_text(ROBOT.format(density=density, viscosity=viscosity, fluid=fluid))
    with pytest.warns(match="fluid=Fluid"):
        model = load_robot(path)
    medium = Fluid(density, viscosity, current=(0.7, -0.4, 0.2))
    assert load_scene(path).fluid == medium
    scene = compile_scene(model, fluid=medium, integrator="rk4", timestep=1e-3)
    m = mujoco.MjModel.from_xml_path(str(path))
    d, draw, ready = mujoco.MjData(m), np.random.default_rng(3), prepare(scene, 0.01)
    for _ in range(8):
        d.qpos[:3], d.qpos[3:7], d.qpos[7:] = draw.normal(size=3), draw.normal(size=4), draw.normal(size=2)
        d.qpos[3:7] /= np.linalg.norm(d.qpos[3:7])
        d.qvel[:] = 2.0 * draw.normal(size=m.nv)
        mujoco.mj_forward(m, d)
        start = initial_state(scene)
        view = scene.state_view(start)
        view.base_q[:], view.q[:], view.base_qd[:], view.qd[:] = d.qpos[:7], d.qpos[7:], d.qvel[:6], d.qvel[6:]
        run, y, _ = ready.arguments(ready.start(start))
        evaluate(run, y, np.zeros_like(y))
        found = scene.state_view(y)
        found = np.concatenate([found.base_qdd, found.qdd])
        assert np.abs(d.qfrc_fluid).max() > 1e-3
        assert np.abs(found - d.qacc).max() < 1e-10 * np.abs(d.qacc).max()
