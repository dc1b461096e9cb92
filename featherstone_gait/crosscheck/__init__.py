"""Crosscheck of a gait in another simulator: MuJoCo's bodies and contact on twelve floors, with this package's servos.

    motion = read_motion("humanoid_gait.npz")
    report = crosscheck(motion, out="humanoid_gait_crosscheck")
    print(summary(report))

    print(crosscheck_policy("walking.onnx", load_robot("scene.xml", contacts="feet")).table())

A gait that was optimized on one ground may walk only there.  `docs/crosscheck.md` says how the replay was validated and
how the stored gaits walk.  MuJoCo is an extra: `pip install featherstone-gait[mjcf]`.
"""

from ..walking.motion import Motion as Motion
from ..walking.motion import motion_of as motion_of
from ..walking.motion import read_motion as read_motion
from .floors import FLOORS as FLOORS
from .floors import Outcome as Outcome
from .floors import WalkResult as WalkResult
from .floors import walk_on as walk_on
from .in_mujoco import Floor as Floor
from .in_mujoco import replay as replay
from .in_mujoco import sinking as sinking
from .in_mujoco import standing as standing
from .policy import PolicyCheck as PolicyCheck
from .policy import crosscheck_policy as crosscheck_policy
from .run import crosscheck as crosscheck
from .run import summary as summary
from .run import verdict as verdict

# the others are those of `featherstone_gait.walking`
__all__ = [
    "FLOORS", "Floor", "Outcome", "PolicyCheck", "WalkResult", "crosscheck", "crosscheck_policy", "replay", "sinking",
    "standing", "summary", "verdict", "walk_on",
]  # fmt: skip
