"""Derivatives of falls of robots that others publish: differences of runs, and adjoints against tangents."""

import numpy as np
import published
import pytest

from featherstone_gait import RobotFileError, compile_scene, load_robot
from featherstone_gait.run import adjoint
from featherstone_gait.run.compiled_run import Vector
from featherstone_gait.run.prepare import prepare

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
WIDTHS = (1e-3, 1e-4, 1e-5)


def one_of_each(root):
    """Yield a run of the first robot of each folder that loads and moves, and its start."""
    for place in sorted(path for path in root.iterdir() if path.is_dir()):
        for file in sorted(place.rglob("*.urdf")):
            try:
                scene = compile_scene(load_robot(file), integrator="implicit_euler", timestep=1e-3)
                run = prepare(scene, 0.02, ("q", "qd"))
                start = run.start()
            except (RobotFileError, ValueError):  # what has no meaning: see tests/robot_file
                continue
            yield place.name, run, start
            break


@pytest.mark.long
def test_gradients_of_falls_of_published_robots():
    count, generator = 0, np.random.default_rng(1)
    for name, run, start in one_of_each(published.folder("example-robot-data")):
        first, end = run.scene.part("qd")
        along = np.zeros(len(start.y))
        along[first:end] = generator.standard_normal(end - first)
        start.y[first:end] = 0.3 * generator.standard_normal(end - first)
        weights = generator.standard_normal((run.samples, len(run.channels)))
        derivatives = adjoint.Adjoint(run, start)
        derivatives.run()
        found = derivatives.pull(weights)

        def result(way, run=run, start=start, along=along, weights=weights):
            one = Vector.of(run, [start._replace(y=start.y + way * along)], 1)
            one.step()
            return float(np.sum(weights * one.out))

        slopes = [(result(width) - result(-width)) / (2.0 * width) for h in WIDTHS for width in (h, 0.5 * h)]
        errors = [abs((4.0 * narrow - wide) / 3.0 - found @ along) for wide, narrow in zip(slopes[::2], slopes[1::2])]
        assert min(errors) < 1e-8 * abs(found @ along), name
        tangents = generator.standard_normal((derivatives.length, 2))
        out, _ = derivatives.push(tangents, np.zeros((derivatives.entries, 2)))
        there = np.einsum("rc,rcp->p", weights, out)
        assert np.abs(there - found @ tangents).max() < 1e-12 * np.abs(there).max(), name
        count += 1
    assert count >= 20
