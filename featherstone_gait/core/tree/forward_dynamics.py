"""Forward dynamics of one robot: the passes of aba.py, with its couplings and loops."""

from ..compile.jit import kernel
from ..compile.optional import any_present, if_present
from .aba import acceleration_pass, articulated_pass
from .constrain import factor_rigid, list_rigid
from .kinematics import base_acceleration, motion_pass
from .loop import fill_loops, note_forces
from .rows import EXACT, apply_forces, solve_system


@kernel
def aba(robot, motion, base_tau, tau, wrench, scratch, base_qdd, qdd):
    """Compute forward dynamics: fill qdd (n,) [rad/s^2 or m/s^2] and, of a floating base, base_qdd (6,).

    robot a `Robot`; motion a `Motion` without accelerations; base_tau (6,) [N; N m] or None; tau (n,) [N m or N];
    wrench (n+1, 6) external [moment; force] about the common origin, world axes [N m; N] or None; scratch: W, and the
    `Rows` of couplings and loops or None.
    """
    W, rows = scratch
    motion_pass(robot.tree, None, robot.gravity, motion, W)  # pass 1
    place_loops(robot.loops, robot, motion, W, rows)
    articulated_pass(robot.tree, None, motion.base_q, base_tau, tau, robot.armature, wrench, None, W)
    constrain(any_present(robot.coupling, robot.loops), robot, W, rows)
    acceleration_pass(robot.tree, None, W, qdd)
    base_acceleration(0, base_qdd, W)


@if_present()
def place_loops(loops, robot, motion, W, rows):
    """Fill the rows of a robot's loops where the first pass has placed its bodies."""
    fill_loops(loops.table, (0, len(loops.table)), robot.held, robot.gravity, motion.base_q, W, rows.loops)


@if_present()
def constrain(rigid, robot, W, rows):
    """Make the accelerations those of couplings and loops, between the two passes; `rigid` None: there are none."""
    b, r = list_rigid(robot.coupling, robot.loops, rows.number[:1], robot.held, robot, (0, 0), rows)
    system = 0, b, 0, r
    factor_rigid(robot, system, EXACT, W, rows)
    solve_system(system, EXACT[1], rows)
    apply_forces(robot, system, W, rows)
    note_forces(robot.loops, system, rows)
