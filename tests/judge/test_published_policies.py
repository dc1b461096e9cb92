"""Policies that others publish load, fit their descriptions, and drive their robots: those of `docs/judged.py`.

PUBLISHED_POLICIES names a folder with copies of the repositories, each in a folder of its name, and the Open Duck's
BEST_WALK_ONNX_2.onnx in Open_Duck_Mini; what is not in it is skipped.
"""

import importlib
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.judge import judge, load_policy

pytest.importorskip("onnxruntime")
pytest.importorskip("mujoco")
sys.path.append(str(Path(__file__).parents[2] / "docs"))
judged = importlib.import_module("judged")
pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning"),
]

POLICIES = judged.published("microduck_runtime", "mujoco_playground", "Open_Duck_Playground", "Open_Duck_Mini")


def copy(path):
    """Return the copy of a file of a repository; skip the test where no folder of copies is named."""
    folder = os.environ.get("PUBLISHED_POLICIES")
    if "PUBLISHED_ROBOTS" not in os.environ or folder is None:
        pytest.skip("these are files of others, in no package: set PUBLISHED_ROBOTS=1 and PUBLISHED_POLICIES=FOLDER")
    found = Path(folder) / path
    if not found.exists():
        pytest.fail(f"{found} is not there: copy the repository to PUBLISHED_POLICIES, as docs/judged.py says")
    return found


@pytest.mark.parametrize("one", POLICIES, ids=lambda one: f"{one.robot}-{one.label}")
def test_a_published_policy_fits_its_description_and_drives_its_robot(one):
    model = load_robot(copy(one.xml), contacts="feet")
    policy = load_policy(copy(one.network), model, one.description)
    own = policy.description
    assert own.name == one.description
    assert set(own.joints) <= set(model.joint_names)
    assert len(own.pose) == len(own.joints)
    assert policy.actions(np.zeros((3, own.size)), 0.0).shape == (3, len(own.joints))
    found = judge(policy, model, 8, 2.0, (one.speed, 0.0, 0.0), again=0)
    assert set(found.verdicts.tolist()) <= {"walks", "stands", "falls", "unknown"}
    upright = found.verdicts != "unknown"
    for values in (found.worlds, found.joints):
        for name, numbers in values.items():
            if name not in ("energy_per_way", "cost_of_transport", "first_saturated"):  # of no way, and of none
                assert np.isfinite(numbers[upright]).all(), name
    assert (found.worlds["energy"][upright] > 0.0).all()
    assert (found.joints["peak_torque"] < 1e4).all()
