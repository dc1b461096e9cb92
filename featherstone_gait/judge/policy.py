"""Load what drives a robot, whatever it is: a network in ONNX, a gait, a table of angles, a function.

A policy answers observations (n, size) of all worlds by actions (n, joints), a row a world.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arguments import functions, instance
from ..base.brief import brief
from ..base.files import FilePath
from ..model import Model
from ..run.program import CompiledController
from ..scene.compile import CompiledScene
from ..walking.feedback import BalancedWalk, read_walk
from ..walking.motion import Motion
from .description import Action, Block, PolicyDescription, packaged_descriptions, read_description

ROWS = 64  # a network is evaluated so many worlds at once, the last ones filled up: a world keeps its bits among others
MISSING = "policies in ONNX need onnx and onnxruntime: pip install featherstone-gait[policy]"


@dataclass(frozen=True, eq=False)
class Policy:
    """Map observations to actions, with the description of both.

    Attributes
    ----------
    act : callable
        Maps observations (n, size) to actions (n, joints).
    description : PolicyDescription
        What is observed, and what actions mean.
    name : str
        Its name in tables.
    controller : CompiledController, callable or None
        A compiled controller that turns the references into what the servos follow, or a function of the scene that
        returns one.
    """

    act: Callable[[np.ndarray], np.ndarray]
    description: PolicyDescription
    name: str = "policy"
    controller: CompiledController | Callable[[CompiledScene], CompiledController] | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        functions(act=self.act)
        instance("policy: description", self.description, PolicyDescription, "give what read_description returns")

    def controller_in(self, scene: CompiledScene) -> CompiledController | None:
        """Return the compiled controller for a scene."""
        own = self.controller
        return own if own is None or isinstance(own, CompiledController) else own(scene)

    def actions(self, observations: np.ndarray, time: float) -> np.ndarray:
        """Return actions (n, joints) for observations (n, size); raise ValueError for what are none."""
        found = np.asarray(self.act(observations), float)
        joints = self.description.joints
        if found.shape != (len(observations), len(joints)):
            raise ValueError(
                f"{self.name}: it answers {found.shape} to observations {observations.shape}; expected "
                f"({len(observations)}, {len(joints)}), a number for each joint: correct joints of its description"
            )
        if not np.isfinite(found).all():
            world, joint = np.argwhere(~np.isfinite(found))[0].tolist()
            value = found[world, joint]
            raise ValueError(
                f"{self.name}: its action of joint {joints[joint]!r} in world {world} at {time:g} s is {value}; "
                "actions are finite numbers: look at what it observes there, or correct the policy"
            )
        return found


def load_policy(source: Any, model: Model, description: FilePath | PolicyDescription | None = None) -> Policy:
    """Make a policy of a file, a gait, a function or a compiled controller.

    Parameters
    ----------
    source
        An ONNX file; a gait's .npz, played with its feedback if it has any, or its angles as .csv; a `Motion`; a
        function of observations (n, size) that returns actions (n, joints); a compiled controller, which acts about the
        pose; a `Policy`.
    model
        The robot.
    description
        A `PolicyDescription`, a TOML file, or the name of one of the package; of an ONNX file whose metadata say all,
        and of gaits, None.

    Returns
    -------
    Policy
        The policy, under the name of the file or function.

    Raises
    ------
    ValueError
        For files that are none, for what the description lacks, and for joints that the robot does not have.
    ImportError
        For an ONNX file without onnx and onnxruntime.
    """
    instance("model", model, Model, "give what load_robot returns")
    if isinstance(source, Policy):
        found = source
    elif isinstance(source, CompiledController):
        found = Policy(_nothing, _described(description) or _still(model), source.name, source)
    elif isinstance(source, Motion | BalancedWalk):
        found = _open_loop(source, "gait")
    elif isinstance(source, (str, Path)):
        path = Path(source)
        if path.suffix == ".onnx":
            found = _of_network(path, model, description)
        elif path.suffix in (".npz", ".csv"):
            found = _open_loop(read_walk(path), path.stem)
        else:
            raise ValueError(f"policy {path}: give an .onnx file, or a gait as .npz or .csv")
    else:
        functions(policy=source)
        own = _described(description)
        if own is None:
            raise ValueError("policy: a function needs its description: name a TOML file, or one of the package")
        found = Policy(source, own, getattr(source, "__name__", "policy"))
    unknown = [one for one in found.description.joints if one not in model.joint_names]
    if unknown:
        known = ", ".join(model.joint_names)
        raise ValueError(
            f"{found.name}: its joint {unknown[0]!r} is none of {model.name}, which has {known}: correct joints of its "
            "description, or take another robot"
        )
    return found


def _described(given: FilePath | PolicyDescription | None) -> PolicyDescription | None:
    return given if given is None or isinstance(given, PolicyDescription) else read_description(given)


def _nothing(observations: np.ndarray) -> np.ndarray:
    return np.zeros((len(observations), 0))


def _still(model: Model) -> PolicyDescription:
    """Return the description of what drives no joint: all stay in the robot's pose."""
    return PolicyDescription((), (), math.inf, (), name=model.name)


def _open_loop(walk: Motion | BalancedWalk, name: str) -> Policy:
    """Return the policy that plays a motion, on straight lines between its ticks, with the feedback that it has."""
    motion = walk if isinstance(walk, Motion) else walk.motion
    period, end = motion.period, motion.begin(0)
    values = np.concatenate([motion.start, motion.stride, motion.stride[:1]])
    times = motion.tick * np.arange(len(values))

    def act(observations: np.ndarray) -> np.ndarray:
        time = observations[:, 0]
        late = np.where(time > end, end + np.fmod(time - end, period), time)
        k = np.clip((late / motion.tick).astype(int), 0, len(times) - 2)
        share = (late / motion.tick - k)[:, None]
        return values[k] + share * (values[k + 1] - values[k])

    joints = motion.joint_names
    pose = tuple(values[0].tolist())
    observed = (Block("time"),)
    description = PolicyDescription(joints, pose, math.inf, observed, Action(limits=False), name)
    feedback = walk.controller if isinstance(walk, BalancedWalk) else None
    return Policy(lambda observations: act(observations) - values[0], description, name, feedback)


# ------------------------------------------------------------------------------------------------ networks


def _of_network(path: Path, model: Model, given: FilePath | PolicyDescription | None) -> Policy:
    """Return the policy of an ONNX file, of one input (1 or any, size) and one output (1 or any, joints)."""
    try:
        import onnx
        from onnxruntime import InferenceSession, SessionOptions
    except ImportError as error:
        raise ImportError(MISSING) from error
    if not path.exists():
        raise ValueError(f"{path}: there is no such file; correct the path")
    try:
        network = onnx.load(path)
        (inputs,) = network.graph.input
        output = network.graph.output[0]
        for one in (inputs, output):  # any number of worlds
            one.type.tensor_type.shape.dim[0].dim_param = "worlds"
        options = SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # errors are raised, and need not be printed too
        session = InferenceSession(network.SerializeToString(), options, providers=["CPUExecutionProvider"])
        size, answers = (one.type.tensor_type.shape.dim[1].dim_value for one in (inputs, output))
    except Exception as error:
        raise ValueError(
            f"{path}: no network with one input and one output ({clean(error)}); export the policy alone, as one that "
            "maps observations to actions"
        ) from error
    metadata = {one.key: one.value for one in network.metadata_props}
    description = given if isinstance(given, PolicyDescription) else _of_metadata(path, metadata, model, given)
    for what, number, own in (("observes", size, description.size), ("answers", answers, len(description.joints))):
        if number and number != own:
            raise ValueError(
                f"{path}: it {what} {number} numbers, its description {description.name} has {own}: correct its "
                f"{'observation' if what == 'observes' else 'joints'}"
            )

    def answer(observations: np.ndarray) -> np.ndarray:
        return session.run([output.name], {inputs.name: observations})[0]

    rows = _most_rows(answer, description, path)

    def act(observations: np.ndarray) -> np.ndarray:
        n = len(observations)
        padded = np.zeros((-(-n // rows) * rows, observations.shape[1]), np.float32)
        padded[:n] = observations
        return np.concatenate([answer(padded[k : k + rows]) for k in range(0, n, rows)])[:n].astype(float)

    return Policy(act, description, path.stem)


def _most_rows(answer: Callable[[np.ndarray], np.ndarray], description: PolicyDescription, path: Path) -> int:
    """Return how many observations a network answers at once: some keep the one row of their export."""
    for rows in (ROWS, 1):
        try:
            if len(answer(np.zeros((rows, description.size), np.float32))) == rows:
                return rows
            said = "not as many answers"
        except Exception as error:  # of its library, which has no common class for them
            said = clean(error)
    raise ValueError(
        f"{path}: it does not answer {description.size} numbers, which {description.name} observes ({said}): correct "
        "the description, or export the policy with an input (1, size) of float32 and an output (1, joints)"
    )


def clean(error: Exception) -> str:
    """Return the message of an error in a line, cut short."""
    return " ".join(str(error).split())[:200]


def _of_metadata(path: Path, metadata: dict[str, str], model: Model, given: FilePath | None) -> PolicyDescription:
    """Return the description of a network, of what is given and of its metadata."""
    table: dict[str, Any] = {}
    lists = {key: text.split(",") for key, text in metadata.items()}
    if "joint_names" in lists:
        table["joints"] = lists["joint_names"]
    if "default_joint_pos" in lists:
        table["pose"] = _numbers(path, "default_joint_pos", lists)
    if "observation_names" in lists:
        table["observation"] = [{"name": name} for name in lists["observation_names"]]
    if "action_scale" in lists:
        scale = _numbers(path, "action_scale", lists)
        table["action"] = {"scale": scale if len(scale) > 1 else scale[0]}
    if given is None:
        fits = [name for name in packaged_descriptions() if _same_joints(name, table, model)]
        if not fits:
            has = f"its metadata say {', '.join(table)}" if table else "it has no metadata that say so"
            raise ValueError(
                f"{path}: what it observes and drives is not known: {has}; give its description, a TOML file or one of "
                f"{', '.join(packaged_descriptions())}"
            )
        given = fits[0]
    return read_description(given, table)


def _numbers(path: Path, key: str, lists: dict[str, list[str]]) -> list[float]:
    try:
        return [float(number) for number in lists[key]]
    except ValueError as error:
        said = f"its metadata has {key} = {','.join(lists[key])[:80]!r}"
        raise ValueError(f"{path}: {said}; expected numbers with commas between: export it anew") from error


def _same_joints(name: str, table: dict[str, Any], model: Model) -> bool:
    joints = read_description(name).joints
    return list(joints) == table["joints"] if "joints" in table else joints == model.joint_names
