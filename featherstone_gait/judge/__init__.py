"""Judge a policy or a gait before it is on the robot: whether it walks on its servos, and for how many joules.

    record = judge("walking.onnx", load_robot("scene.xml", contacts="feet"), command=(0.5, 0.0, 0.0))
    print(record.table())

Worlds differ in floors, servos, masses, batteries, zeros, sensors and delays (domain randomization); all of them run in
the lanes of one session, and the policy is evaluated for all at once.  `pip install featherstone-gait[policy]` reads
ONNX files.
"""

from .comparison import compare
from .description import PolicyDescription, packaged_descriptions, read_description
from .judgment import Judgment
from .policy import Policy, load_policy
from .run import judge

__all__ = [
    "Judgment", "Policy", "PolicyDescription", "compare", "judge", "load_policy", "packaged_descriptions",
    "read_description",
]  # fmt: skip
