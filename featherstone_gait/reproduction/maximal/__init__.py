"""The paper's own simulator: free bodies held together by constraints, solved by sweeps in random order.

`simulate` takes the scenes of `compile_scene` and gives trajectories; see docs/maximal.md.
"""

from .engine import EXACT, Engine
from .run import simulate, simulate_seeds

__all__ = ["EXACT", "Engine", "simulate", "simulate_seeds"]
