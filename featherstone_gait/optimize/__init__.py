"""The gait optimizer: `main_job` and its stages (planning, search, selection, measurement, report).

The names are loaded when they are first used, so that the command line can read `OptimizeOptions` at no cost.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what `__getattr__` finds
    from .baselines import BASELINES as BASELINES
    from .job import main_job as main_job
    from .options import OptimizeOptions as OptimizeOptions
    from .planning import walking_cost as walking_cost
    from .plots import plot_angles as plot_angles
    from .plots import plot_convergence as plot_convergence
    from .report import write_results as write_results
    from .search import AMPLITUDE as AMPLITUDE
    from .search import optimize_gait as optimize_gait
    from .search import optimize_with_limits as optimize_with_limits
    from .summary_table import summary as summary

_MODULES = {
    "baselines": ["BASELINES"], "job": ["main_job"], "options": ["OptimizeOptions"], "planning": ["walking_cost"],
    "plots": ["plot_angles", "plot_convergence"], "report": ["write_results"],
    "search": ["AMPLITUDE", "optimize_gait", "optimize_with_limits"], "summary_table": ["summary"],
}  # fmt: skip
_HOME = {name: module for module, names in _MODULES.items() for name in names}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
