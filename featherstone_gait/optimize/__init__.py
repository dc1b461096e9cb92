"""The gait optimizer: search, selection, measurement and report."""

from .job import (
    AMPLITUDE,
    BASELINES,
    main_job,
    optimize_gait,
    optimize_with_limits,
    plot_angles,
    plot_convergence,
    summary,
    walking_cost,
    write_results,
)

__all__ = [
    "AMPLITUDE",
    "BASELINES",
    "main_job",
    "optimize_gait",
    "optimize_with_limits",
    "plot_angles",
    "plot_convergence",
    "summary",
    "walking_cost",
    "write_results",
]
