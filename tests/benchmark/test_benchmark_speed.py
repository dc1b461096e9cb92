"""The benchmark of speed: what it times runs."""

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.benchmark import engines, scenes, speed


def test_a_batch_of_runs_is_timed_step_by_step():
    problem = scenes.geared_arm()._replace(duration=0.02)
    run = problem.ready("implicit_euler", 1e-3)
    wall, cpu = speed._batch_time(run, 8, 1)
    assert wall > 0.0
    assert cpu > 0.0


def test_mujoco_s_humanoid_stands_on_its_soles_and_nothing_else_of_it_touches():
    mujoco = pytest.importorskip("mujoco")
    model = load_robot("humanoid", locked="simplified")
    m = engines.humanoid_of(model)
    data = mujoco.MjData(m)
    mujoco.mj_setState(m, data, engines.standing_on(m, data, np.zeros(m.nu)), mujoco.mjtState.mjSTATE_FULLPHYSICS)
    height = data.qpos[2]
    m.opt.timestep = 1e-3
    for _ in range(1000):
        mujoco.mj_step(m, data)
    assert data.ncon == len(model.contacts)
    assert {int(contact.geom1) for contact in data.contact} == {0}  # the floor
    assert data.qpos[2] == pytest.approx(height, abs=5e-3)
    assert m.body_mass.sum() == pytest.approx(model.mass)


def test_engines_agree_on_accelerations():
    pytest.importorskip("mujoco")
    pytest.importorskip("pinocchio")
    rows = {row.algorithm: row for row in speed.time_robot(scenes.chain(10), repeats=1)}
    for name in (speed.MUJOCO, speed.PINOCCHIO, "ABA"):
        assert rows[name].error < 1e-12, rows[name]
