"""A URDF as other tools export it: meshes, frames without mass, fixed joints, foreign tags, damping and friction."""

import numpy as np
import pytest
from mujoco_oracle import Oracle
from random_tree import random_states

from featherstone_gait.core.effects import energies
from featherstone_gait.dynamics import energy, forward_dynamics
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

URDF = """<?xml version="1.0"?>
<robot name="pan_tilt" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <material name="gray"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="world"/>
  <joint name="mount" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0 0 0.1"/></joint>
  <link name="base">
    <visual><geometry><mesh filename="package://pan_tilt/base.stl" scale="0.001 0.001 0.001"/></geometry></visual>
    <collision><geometry><mesh filename="package://pan_tilt/meshes/base.stl"/></geometry></collision>
    <inertial><mass value="0.5"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial>
  </link>
  <joint name="pan" type="continuous">
    <parent link="base"/><child link="yoke"/><origin xyz="0 0 0.05" rpy="0.2 0 0"/><axis xyz="0 0 2"/>
    <dynamics damping="0.001" friction="0.002"/>
  </joint>
  <link name="yoke">
    <inertial>
      <origin xyz="0.01 0 0.02" rpy="0 0.3 0"/><mass value="0.12"/>
      <inertia ixx="8e-5" ixy="1e-6" ixz="0" iyy="9e-5" iyz="0" izz="5e-5"/>
    </inertial>
  </link>
  <joint name="tilt" type="revolute">
    <parent link="yoke"/><child link="cradle"/><origin xyz="0 0 0.06"/><axis xyz="0 1 0"/>
    <limit lower="-1.2" upper="1.2" effort="2" velocity="5"/><dynamics damping="0.0005"/>
    <safety_controller k_velocity="1"/>
  </joint>
  <link name="cradle"/>
  <joint name="cradle_camera" type="fixed">
    <parent link="cradle"/><child link="camera"/><origin xyz="0.02 0 0.01" rpy="0 0 1.5"/>
  </joint>
  <link name="camera">
    <inertial>
      <origin xyz="0.03 0 0"/><mass value="0.08"/>
      <inertia ixx="2e-5" ixy="0" ixz="0" iyy="3e-5" iyz="0" izz="3e-5"/>
    </inertial>
  </link>
  <joint name="optical" type="fixed">
    <parent link="camera"/><child link="optical_frame"/><origin rpy="-1.57 0 -1.57"/>
  </joint>
  <link name="optical_frame"/>
  <transmission name="t1"><type>SimpleTransmission</type></transmission>
  <gazebo reference="camera"><sensor type="camera" name="c"/></gazebo>
</robot>
"""


@pytest.fixture
def model(tmp_path):
    (tmp_path / "pan_tilt.urdf").write_text(URDF)
    return load_robot(tmp_path / "pan_tilt.urdf")


def test_what_is_skipped_is_noted(model):
    notes = " ".join(model.notes)
    assert model.joint_names == ("pan", "tilt")
    for word in ("transmission", "gazebo", "visual", "collision", "safety_controller", "axis"):
        assert word in notes, word


def test_dynamics_agree_with_mujoco(model):
    q, qd, tau = random_states(model, 100, 5)
    ours = forward_dynamics(model, q, qd, tau)
    theirs = Oracle(model).forward_dynamics(q, qd, tau)
    error = np.abs(ours - theirs).max(axis=1) / np.abs(theirs).max(axis=1)
    assert error.max() < 1e-10


@pytest.mark.long
def test_it_swings_and_loses_what_damping_and_friction_take(model):
    scene = compile_scene(model, integrator="rk4", timestep=1e-5)
    state = initial_state(scene, [0.3, 0.8], [2.0, 0.0])
    run = simulate(scene, 0.3, state, record=("q", "qd", "energy"))
    total = energy(model, run["q"], run["qd"]).sum(axis=1)
    lost = run["energy"][..., [energies.FRICTION, energies.STOPS]].sum(axis=(1, 2))
    assert run.status == "ok"
    assert lost[-1] > 1e-4
    assert np.abs(total + lost - total[0]).max() < 1e-8  # the stop's spring is part of STOPS
