"""Planned walks and postures that are looked for have the same bits on any processor, as the kernels that read them."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from processors import PROCESSORS

from featherstone_gait.dynamics.inverse_kinematics import Target, inverse_kinematics
from featherstone_gait.optimize import walking_cost
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.reference import Reference
from featherstone_gait.walking import BIOLOID_WALK, walking_plan

ROOT = Path(__file__).parents[2]
# Of the humanoid's gait [rad], left leg and right, as first planned with LAPACK and the C library's sine.
FIRST_POSE = [
    *(-0.055939833, 0.699653712, -0.934890513, 0.235236801, 0.055939833),
    *(0.057294932, 0.584610523, -1.128553895, 0.543943372, -0.057294932),
]


def planned():
    """What is planned for the humanoid, before and after rounding, and what its servos are sent."""
    cost = walking_cost(load_robot("humanoid", locked="simplified"))
    plan = walking_plan(cost.scene.model, **BIOLOID_WALK)
    sent = cost.reference(cost.gait.to_vector(), 2)
    arm = load_robot("arm7_spatial")
    stride = np.vstack([cost.gait.poses, cost.gait.poses[:1]])
    return {
        "root": plan.base_position,
        "center of mass": plan.com,
        "angles": plan.angles,
        "gait": cost.gait.poses,
        "start": cost.start,
        "lines": sent.knots().cubics,
        "spline": Reference(sent.times, sent.values, "cubic").knots().cubics,
        "posture": inverse_kinematics(arm, Target("link7", (0.1, 0.1, 0.2), (1.0, 2.0, 3.0)), restarts=5).q,
        "periodic spline": Reference(0.16 * np.arange(5), stride, "cubic", cyclic=True).knots().cubics,
    }


def digests():
    return "\n".join(f"{name}: {hashlib.sha256(a.tobytes()).hexdigest()}" for name, a in planned().items())


@pytest.fixture(scope="module")
def here():
    return digests()


@pytest.mark.long
@pytest.mark.parametrize("core", PROCESSORS)
def test_a_plan_has_the_same_bytes_whatever_the_linear_algebra(core, here):
    environment = os.environ | {"OPENBLAS_CORETYPE": core}
    if core == "Sandybridge":  # and of the C library and of NumPy what an old processor gets
        found = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
        environment |= {"NPY_DISABLE_CPU_FEATURES": " ".join(found), "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA"}
    command = [sys.executable, "-c", "import test_plan_reproducibility as t; print(t.digests())"]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == here


def test_the_gait_is_the_one_first_planned():
    assert planned()["gait"][0] == pytest.approx(FIRST_POSE, rel=0, abs=1e-9)
