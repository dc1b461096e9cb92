"""The paper rerun: its statements with the rule that judges them, and the report of the notebooks that do.

The paper is J. Lima et al., "Humanoid gait optimization resorting to an improved simulation model", Int. J. Advanced
Robotic Systems 10 (2013), doi 10.5772/54766.
"""

from .statements import STATEMENTS, Judged, Row, Statement, judge

__all__ = ["STATEMENTS", "Judged", "Row", "Statement", "judge"]
