"""The compiled core: kernels that read arrays and records, and know no dataclass, no file and no randomness.

Kernels state no types: Numba infers them, for plain numbers and for eight lanes from one source.  What they call by one
name is one thing everywhere, and their docstrings explain other arguments alone:

    run, step       Run, a run and what it overwrites; Step, one step or one evaluation (step/context.py)
    scene, plan     Scene, the constants; Plan, the course of a run in steps (both of `run`)
    work            workspace of the integrator, whose type says which it is (integrate/)
    y, dy, offsets  state, its rates, and where each part of them starts: a STATE record (step/state.py)
    t, length       time, and the most to go on from there [s]
    h, h_implicit   step [s]; theta h, at whose end forces are taken [s], theta 1: Euler, 1/2: midpoint
    i, c            index of a joint, in tree/ the row of a body; index of a contact point
    v, w            speeds of joint i and, over the gear ratio, of its rotor [rad/s or m/s]
    robot, tree     Robot; its (n + 1,) BODY records, one of which is b (tree/layout.py)
    motion          Motion: positions, velocities and accelerations (tree/layout.py)
    W, Z, C, N      scratch of the tree (rows, COLUMNS), of joints (SCRATCH, n), contact points (points, SCRATCH) and
                    of Newton's iteration (trees, OF_TREES): see tree/layout.py, effects/joint.py, effects/element.py
    F               forces from outside (n + 1, 6) [moment; force] about the common origin, world axes [N m; N]
    actuator, controller, motor, gear, friction, stops, joint_springs, push, springs, contact
                    records of an effect, one a joint, push, spring or point; None where it is absent (effects/)

Forces of joints are in N m, of sliding ones in N; their slopes -dT/dv in N m s/rad or N s/m.
"""
