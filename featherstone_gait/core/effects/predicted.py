"""The predicted state: that for which the bias of a step is taken, and to which the poses in W belong.

It is the start of the step (predicted None), or of the midpoint rule and stages the state in `predicted`: positions and
speeds of joints, positions and velocities of bases, quaternions of ball joints.
"""

from ..compile.jit import inline
from ..compile.optional import slice_if
from ..tree.ball import ball_positions, last_balls
from ..tree.forest import base_count, base_of, joint_count


@inline
def lookahead(predicted, h):
    """Return how long after the step's start the poses are those of W [s]."""
    if predicted is None:
        return 0.0
    return h


@inline
def base_at(predicted, step):
    """Return the position of the tree's base (7,), None if none floats."""
    scene = step.scene
    if predicted is None:
        return base_of(scene.floating, step.part, step.y, step.offsets.base_q, 7)
    return base_of(scene.floating, step.part, predicted, 2 * joint_count(scene.trees, scene.tree), 7)


@inline
def bases_at(predicted, step):
    """Return the positions of all bases (7 bases,); None if none floats."""
    scene = step.scene
    if predicted is None:
        return slice_if(scene.floating, step.y, step.offsets.base_q, 7 * base_count(scene.trees))
    return slice_if(scene.floating, predicted, 2 * joint_count(scene.trees, scene.tree), 7 * base_count(scene.trees))


@inline
def balls_at(predicted, step):
    """Return the quaternions of ball joints, None without ball joints."""
    if predicted is None:
        return ball_positions(step.scene.balls, step.y, step.offsets.ball_q)
    return last_balls(step.scene.balls, predicted)
