"""Let the humanoid kick the ball with its right foot."""

from featherstone_gait import controller

TIMES = (0.0, 0.4, 0.58, 0.74)  # at which postures are reached: standing, lean, leg back, leg forward [s]
LEAN = (0.0, 0.22, 0.22, 0.22)  # of the hips over the left foot, and against it of the ankles [rad]
HIP = (0.0, 0.0, 0.52, 0.4)  # right front [rad]
KNEE = (0.0, 0.0, 0.5, -0.42)
ANKLE = (0.0, 0.0, -1.02, -0.28)


@controller
def kick(t, state, reference, command, memory):
    """Move the references on straight lines from posture to posture; joints are those of the set "simplified"."""
    k = 0
    while k < len(TIMES) - 2 and t >= TIMES[k + 1]:
        k += 1
    share = min((t - TIMES[k]) / (TIMES[k + 1] - TIMES[k]), 1.0)
    lean = LEAN[k] + share * (LEAN[k + 1] - LEAN[k])
    command[0, 0] = command[5, 0] = lean
    command[4, 0] = command[9, 0] = -lean
    command[6, 0] = HIP[k] + share * (HIP[k + 1] - HIP[k])
    command[7, 0] = KNEE[k] + share * (KNEE[k + 1] - KNEE[k])
    command[8, 0] = ANKLE[k] + share * (ANKLE[k + 1] - ANKLE[k])
