"""The paper's own simulator: free bodies held together by constraints, solved by sweeps in random order.

`simulate` takes the scenes of `compile_scene` and gives trajectories; see docs/maximal.md.
"""

from ...core.compile.jit import add_sources
from .layout import EXACT, Engine
from .run import simulate, simulate_seeds

add_sources(__name__, __file__)

__all__ = ["EXACT", "Engine", "simulate", "simulate_seeds"]
