"""The status of a run, an enumeration whose members are also plain text."""

from __future__ import annotations

from enum import StrEnum

from ..core.effects.pair import FULL
from ..core.integrate import rollout
from ..core.step.depth import TOO_DEEP


class Status(StrEnum):
    """The status of a run; each member equals its text, as in ``run.status == "ok"``.

    Attributes
    ----------
    OK
        "ok": the run came to its end, and nothing speaks against its result.
    FELL
        "fell": the robot fell, and the run ended there.
    DIVERGED
        "diverged": the state grew beyond all bounds, and the run ended there.
    CHATTER
        "chatter": velocities alternated from step to step, so the result is wrong however bounded it is.
    STEP_TOO_SMALL
        "step too small": error control asked for a shorter step than it may take, and the run ended there.
    NOT_CONVERGED
        "not converged": an implicit step missed its tolerance, a step left a loop open, the step is larger than what
        the integrator allows, or an explicit integrator met a joint stop that it does not resolve, or may have
        carried a body over a thin one.
    INACCURATE
        "inaccurate": the estimated error is larger than `simulate` allows.
    DOUBTFUL
        "doubtful": of a gradient alone: events within steps, such as contacts made, make it differ from differences.
    TOO_COSTLY
        "too costly": error control took as many steps as it may, and the run ended there.
    TOO_MANY_CONTACTS
        "too many contacts": more pairs came near than the pool has slots for, and the run ended there.
    TOO_DEEP
        "too deep": a body sank into another or the ground by more than half of its thickness (a thin foot: deeper than
        its weight on few points explains), and the run ended there.
    """

    OK = "ok"
    FELL = "fell"
    DIVERGED = "diverged"
    CHATTER = "chatter"
    STEP_TOO_SMALL = "step too small"
    NOT_CONVERGED = "not converged"
    INACCURATE = "inaccurate"
    DOUBTFUL = "doubtful"
    TOO_COSTLY = "too costly"
    TOO_MANY_CONTACTS = "too many contacts"
    TOO_DEEP = "too deep"

    @property
    def complete(self) -> bool:
        """Return whether the run came to its end."""
        went_on = (Status.OK, Status.CHATTER, Status.NOT_CONVERGED, Status.INACCURATE)
        return self in went_on

    @property
    def remedy(self) -> str:
        """Remedy to try, empty for "ok"."""
        return REMEDIES[self]


REMEDIES = {
    Status.OK: "",
    Status.FELL: "change the motion or the controller, or allow more: compile_scene(fall_height=..., fall_tilt=...)",
    Status.DIVERGED: "use a smaller timestep or an implicit integrator, and check masses, gains and contact stiffness",
    Status.CHATTER: "use a smaller timestep, or the integrator that compile_scene chooses by default",
    Status.STEP_TOO_SMALL: "raise rtol, or use implicit_euler or midpoint at a fixed step",
    Status.NOT_CONVERGED: "use a smaller timestep or an implicit integrator",
    Status.INACCURATE: "give a smaller timestep or rtol; if that does not help, the motion is chaotic",
    Status.DOUBTFUL: "give a smaller timestep or softer contacts, or search without gradients",
    Status.TOO_COSTLY: "raise rtol, or use implicit_euler or midpoint at a fixed step",
    Status.TOO_MANY_CONTACTS: "allow more: compile_scene(pairs=PairContact(max_points=...)), or choose fewer pairs",
    Status.TOO_DEEP: "give contacts a smaller penetration (of the ground: Ground), or PairContact the load to bear",
}
OF_CODE = {  # status of a state, as the kernels write it
    rollout.OK: Status.OK,
    rollout.FELL: Status.FELL,
    rollout.DIVERGED: Status.DIVERGED,
    rollout.TOO_SMALL: Status.STEP_TOO_SMALL,
    rollout.TOO_COSTLY: Status.TOO_COSTLY,
    int(FULL): Status.TOO_MANY_CONTACTS,
    int(TOO_DEEP): Status.TOO_DEEP,
}
