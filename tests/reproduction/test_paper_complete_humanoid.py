"""The complete humanoid: its planned gait walks, and a search makes it cheaper."""

from dataclasses import replace

import pytest

from featherstone_gait.reproduction import complete_humanoid


@pytest.mark.long
def test_the_complete_humanoid_walks_and_gains():
    result = complete_humanoid.run(replace(complete_humanoid.QUICK, iterations=30, searches=1))
    assert len(result.joints) == 19
    assert result.best.shape == (1, 31)
    assert result.first.measures.status == "ok"
    assert (result.gains < 0.0).all()
    for figure in complete_humanoid.plot(result).values():
        figure.draw_without_rendering()
    (claim,) = complete_humanoid.check(result)
    assert (claim.item, claim.verdict) == ("Section 6", "reproduced")
