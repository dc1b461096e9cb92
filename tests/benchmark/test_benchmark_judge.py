"""How fast policies are judged: shares that belong together, and half the step."""

import pytest

from featherstone_gait.benchmark.judge import measured
from featherstone_gait.benchmark.little_biped import NETWORK, little_biped
from featherstone_gait.judge import load_policy


@pytest.mark.long
def test_shares_belong_together_and_half_the_step_changes_little():
    pytest.importorskip("onnxruntime")
    model = little_biped()
    row = measured(load_policy(NETWORK, model, NETWORK.with_suffix(".toml")), model, 1, worlds=8, seconds=2.0)
    assert (row.robot, row.policy, row.walks, row.same) == ("little_biped", "little_biped_walk", 1.0, 1.0)
    shares = row.policy_share, row.observed, row.prepared, row.steps, row.kernel
    assert all(0.0 < share < 0.8 for share in shares)
    assert 0.5 < sum(shares) <= 1.0
    assert 0.0 < row.contact < row.servos < 1.0  # 14 servos with friction, and 8 points
    assert 0.0 < row.energy_error < 0.05
    assert 0.0 < row.speed_error < 0.05
    assert row.real_time > 0.0
