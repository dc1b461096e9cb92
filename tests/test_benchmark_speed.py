"""The benchmark of speed: what it times runs."""

from featherstone_gait.benchmark import precision, speed


def test_a_batch_of_runs_is_timed_step_by_step():
    problem = precision.free_arm()._replace(duration=0.02)
    run = problem.run("midpoint", 1e-3)
    wall, cpu = speed._batch_time(problem, run, 8, 1)
    assert wall > 0.0
    assert cpu > 0.0
