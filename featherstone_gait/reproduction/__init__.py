"""The paper's figures and tables as experiments.

Each module has the settings `QUICK` and `FULL`, `run(settings, seed, progress)`, which returns a result (without a seed
where nothing is random, without progress where nothing takes long), `check(result) -> list[Claim]` and `plot(result) ->
dict[caption, Figure]`; `featherstone-gait reproduce` runs them.  The paper is J. Lima et al., "Humanoid gait
optimization resorting to an improved simulation model", Int. J. Advanced Robotic Systems 10 (2013), doi
10.5772/54766.
"""

from .claim import Claim, ClaimTable, Verdict, classify, format_claims, number, question

EXPERIMENTS = (  # modules, in the paper's order
    "servo_step",
    "arm_fall",
    "seven_joint_arm",
    "ratio_and_joints",
    "gait_optimization",
    "noisy_searches",
    "what_stops",
    "complete_humanoid",
)

__all__ = ["EXPERIMENTS", "Claim", "ClaimTable", "Verdict", "classify", "format_claims", "number", "question"]
