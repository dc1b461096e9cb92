"""Running a compiled scene: one simulation or many, from the state at the start to a trajectory with its verdict."""
