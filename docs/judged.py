"""Judge published policies: `python docs/judged.py MICRODUCK PLAYGROUND OPEN_DUCK WALK`, of public repositories.

MICRODUCK is apirrone/microduck_runtime at 718cb2e, PLAYGROUND google-deepmind/mujoco_playground at d5e6b47 with the
meshes that it fetches (they are drawn only), OPEN_DUCK apirrone/Open_Duck_Playground at f82b5e7, and WALK a folder with
BEST_WALK_ONNX_2.onnx of apirrone/Open_Duck_Mini (SHA-256 3c606f93...).  Writes judged_policies.csv, judged_duck.csv and
judged_rough.csv of docs/reproduction in some fifteen minutes.

Each policy drives its robot in 100 worlds of 8 s, at a command of 0.5 m/s ahead.  Where the servos are the position
actuators of the robot's file, it also drives it on a floor without any draw, here and in MuJoCo, at the file's step and
at 0.2 ms.  Three policies walk on rough ground too, in worlds that are otherwise the same.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from featherstone_gait import Ground, Model, Servo, Session, compile_scene, load_robot, load_servo, standing_state
from featherstone_gait.base.files import FilePath, Format, write_csv
from featherstone_gait.judge import Policy, judge, load_policy
from featherstone_gait.judge.doubts import DEFAULT, draw_worlds
from featherstone_gait.judge.observation import Observer
from featherstone_gait.judge.run import HARD
from featherstone_gait.robot_file.servos import without_actuators
from featherstone_gait.robot_file.toml import read_toml

OUT = Path(__file__).parent / "reproduction"
COMMAND, WORLDS, SECONDS, AGAIN = (0.5, 0.0, 0.0), 100, 8.0, 16
FINE, SAMPLE, FALLEN = 2e-4, 0.02, 0.7  # [s], [s], cosine of the tilt
PLAIN = {"worlds": {"ground": {"friction": {"kind": "uniform", "scale": 1e-9}}}}  # eight times the same world
DUCKS = {"new": "walking", "m6": "new_policies/m6_rollback_walk", "rollback": "new_policies/walk_rollback_2000",
         "rough": "new_policies/walk_rough_1500", "old": "old_policies/walking"}  # fmt: skip
OTHERS = {"go1": ("Unitree Go1", "go1"), "berkeley_humanoid": ("Berkeley Humanoid", "bh"), "g1": ("Unitree G1", "g1"),
          "t1": ("Booster T1", "t1"), "apollo": ("Apptronik Apollo", "apollo")}  # fmt: skip
PRESET = load_servo("xl330")
HALVED = replace(PRESET, controller=replace(PRESET.controller, Kp=0.5 * PRESET.controller.Kp))
SERVOS = {"of the file": None, "xl330, P gain 400": PRESET, "xl330, P gain 200": HALVED}
DUCK_SERVOS = {"of the file": None, "sts3215": load_servo("sts3215")}
DUCK_SERVOS |= {f"sts3215, {ms} ms late": load_servo("sts3215", delay=1e-3 * ms) for ms in (20, 40)}
PITCHING = "hip_pitch", "knee", "ankle"  # joints of which the builder states how they follow
ROUGH = {"new": (0.005, 0.01), "rough": (0.005, 0.01), "go1": (0.02, 0.04)}  # by policy: roughness up to [m]
DUCK_SPEEDS, DUCK_WORLDS = (0.15, 0.08), 200  # [m/s]: the most that it was trained for, and what a builder asked of it


def nominal(one: Published) -> dict[str, float]:
    """Return speed [m/s] and energy by way [J/m] on a plain floor, here and in MuJoCo."""
    model, m = load_robot(one.xml, contacts="feet"), mujoco.MjModel.from_xml_path(str(one.xml))
    policy = load_policy(one.network, model, one.description)
    floor = Ground(friction=float(m.geom("floor").friction[0]), penetration=HARD)
    own = judge(policy, compile_scene(model, "rotor", floor, "midpoint", 1e-3), 8, SECONDS, COMMAND, doubts=PLAIN,
                again=0).worlds  # fmt: skip
    found = {"own_speed": own["speed"][0], "own_J_per_m": own["energy_per_way"][0], "file_ms": 1e3 * m.opt.timestep}
    for name, h in (("file", m.opt.timestep), ("fine", FINE)):
        found |= {f"{name}_{what}": x for what, x in zip(("speed", "J_per_m"), in_mujoco(m, h, model, policy))}
    return found


def in_mujoco(m: Any, h: float, model: Model, policy: Policy) -> tuple[float, float]:
    """Return speed [m/s] and energy by way [J/m] of a policy in MuJoCo at a step h [s]; NaN if it falls."""
    m.opt.timestep = h
    d, said, joints = mujoco.MjData(m), policy.description, [m.joint(name) for name in model.joint_names]
    q, v = (np.array([getattr(one, name)[0] for one in joints]) for name in ("qposadr", "dofadr"))
    by_joint = {int(m.actuator_trnid[k, 0]): k for k in range(m.nu)}
    drives = [by_joint[m.joint(name).id] for name in said.joints]
    scene = compile_scene(model, "rotor", Ground(penetration=HARD), "midpoint", 1e-3)
    pose = np.zeros(len(joints))
    pose[[model.joint_names.index(name) for name in said.joints]] = said.pose
    d.qpos[:7], d.qpos[q] = scene.state_view(standing_state(scene, pose, True))["base_q"], pose
    observer = Observer(said, scene, draw_worlds(scene, 1, 0, {}), SAMPLE, SAMPLE)
    actions, way, energy = np.zeros((1, len(said.joints))), 0.0, 0.0
    mujoco.mj_forward(m, d)
    for k in range(round(SECONDS / SAMPLE)):
        seen = {"q": d.qpos[q], "qd": d.qvel[v], "base_q": d.qpos[:7], "base_qd": d.qvel[:6]}
        targets = np.array([said.pose]) + np.asarray(said.action.scale) * actions
        seen = {name: values[None].copy() for name, values in seen.items()}
        observer.sample(seen)
        actions = policy.actions(observer.look(seen, k, actions, targets, np.array(COMMAND)), k * SAMPLE)
        d.ctrl[drives] = np.array(said.pose) + np.asarray(said.action.scale) * actions[0]
        place, heading = d.qpos[:2] @ (1, 1j), turned(d.qpos)
        for _ in range(round(SAMPLE / h)):
            mujoco.mj_step(m, d)
            energy += h * np.maximum(d.qfrc_actuator[v] * d.qvel[v], 0.0).sum()
        half = 0.5 * np.angle(turned(d.qpos) / heading)
        way += ((d.qpos[:2] @ (1, 1j) - place) / (heading * np.exp(1j * half))).real
        if 1.0 - 2.0 * (d.qpos[4] ** 2 + d.qpos[5] ** 2) < FALLEN:
            return np.nan, np.nan
    return way / SECONDS, energy / way


def turned(q: np.ndarray) -> complex:
    """Return the heading of a base with this position and quaternion, as a complex number of length 1."""
    w, x, y, z = q[3:7]
    number = complex(1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y))
    return number / abs(number)


class Published(NamedTuple):
    """A policy of others: where it and its robot are, what it observes, and the speed that is asked of it [m/s]."""

    robot: str
    label: str
    xml: Path
    network: Path
    description: str
    speed: float = COMMAND[0]


def published(
    microduck: FilePath, playground: FilePath, duck: FilePath | None = None, walk: FilePath | None = None
) -> list[Published]:
    """Return all policies, from folders of the four repositories; without the Open Duck's where its two are None."""
    ducks, root = Path(microduck), Path(playground) / "mujoco_playground"
    found = [
        Published("Microduck", label, ducks / "fk" / "scene.xml", ducks / "policies" / f"{name}.onnx", "microduck")
        for label, name in DUCKS.items()
    ]
    for robot, (name, short) in OTHERS.items():
        xml = root / "_src" / "locomotion" / robot / "xmls" / "scene_mjx_feetonly_flat_terrain.xml"
        network = root / "experimental" / "sim2sim" / "onnx" / f"{short}_policy.onnx"
        found.append(Published(name, short, xml, network, robot))
    if duck is not None and walk is not None:
        xml = Path(duck) / "playground" / "open_duck_mini_v2" / "xmls" / "scene_flat_terrain.xml"
        name, best = "Open Duck Mini v2", "BEST_WALK_ONNX_2"
        found.append(Published(name, best, xml, Path(walk) / f"{best}.onnx", "open_duck_mini_v2", DUCK_SPEEDS[0]))
    return found


def with_servo(model: Model, servo: Servo | None) -> Model:
    """Return a robot with a servo in place of all actuators of its file; None: with these."""
    own = model.servos if servo is None else dict.fromkeys(model.servos, servo)
    return replace(without_actuators(model, own), servos=own)


def row(one: Published, kind: str, servo: Servo | None, worlds: int = WORLDS, height: float = 0.0) -> dict[str, Any]:
    """Judge one policy on one robot with one kind of servo, on ground of a roughness up to a height [m]."""
    model = load_robot(one.xml, contacts="feet")
    policy = load_policy(one.network, model, one.description)
    driven = with_servo(model, servo)
    tables = read_toml(DEFAULT)
    tables["roughness"]["height"] = height
    record = judge(policy, driven, worlds, SECONDS, (one.speed, 0.0, 0.0), again=AGAIN, doubts=tables)
    counts = {name: int((record.verdicts == name).sum()) for name in ("walks", "stands", "falls", "unknown")}
    low, high = record.interval
    figures = {"speed": "speed", "power": "power", "J_per_m": "energy_per_way", "transport": "cost_of_transport"}
    found = {"robot": one.robot, "policy": one.label, "servo": kind, "command": one.speed, "worlds": worlds,
             "verdict": record.verdict, **counts, "low": low, "high": high, "same": record.agreement.same,
             "again": AGAIN, "why": record.why(), "time": float(np.median(record.worlds["time"])),
             **{name: "" if record.walking == 0 else record.spread(figure)[0] for name, figure in figures.items()}}
    for cause in record.causes if height else ():
        if cause.name == "roughness":
            found |= {"delta": cause.effect, "failing": cause.failing, "others": cause.others}
    found |= {"height": height} if height else {}
    print({name: value for name, value in found.items() if name != "why"}, flush=True)
    return found


def targets(one: Published, servo: Servo) -> np.ndarray:
    """Return the references (steps, joints) [rad] that a policy sends on a plain floor."""
    model, kept = load_robot(one.xml, contacts="feet"), []
    policy = load_policy(one.network, model, one.description)
    said, act = policy.description, policy.act
    noted = replace(policy, act=lambda x: kept.append(act(x)) or kept[-1])
    judge(noted, with_servo(model, servo), 8, SECONDS, (one.speed, 0.0, 0.0), doubts=PLAIN, again=0)
    found, most = [np.array(said.pose)], said.action.max_speed / said.rate
    for actions in kept:
        wanted = said.pose + np.asarray(said.action.scale) * actions[0]
        found.append(np.clip(wanted, found[-1] - most, found[-1] + most))
    return np.array(found[1:])


def following(one: Published, servo: Servo | None, sent: np.ndarray) -> dict[str, float]:
    """Return how pitching joints follow references (steps, joints) on a robot that is hung up.

    Of the joints the least and the largest: 95th percentile of the error [rad], and lag in steps of the policy.
    """
    model = load_robot(one.xml, base="fixed")
    scene = compile_scene(with_servo(model, servo), "rotor", None, "midpoint", 1e-3)
    joints = load_policy(one.network, model, one.description).description.joints
    columns = [scene.model.joint_names.index(name) for name in joints]
    given, seen = np.zeros((len(sent), len(columns))), []
    given[:, columns] = sent
    with Session(scene, 1, observe=("q",)) as session:
        for values in given:
            seen.append(session.step(values[None], ticks=round(SAMPLE / session.tick))["q"][0].copy())
    pitching = [k for k, name in enumerate(scene.model.joint_names) if any(part in name for part in PITCHING)]
    wanted, did, begin = given[:, pitching], np.array(seen)[:, pitching], 50
    late = [((wanted[begin - k : len(wanted) - k] - did[begin:]) ** 2).mean(axis=0) for k in range(10)]
    errors, lags = np.quantile(np.abs(wanted - did)[begin:], 0.95, axis=0), np.argmin(late, axis=0)
    return {"error_low": errors.min(), "error_high": errors.max(), "lag_low": lags.min(), "lag_high": lags.max()}


def write(name: str, rows: list[dict[str, Any]]) -> None:
    """Write rows as a table of docs/reproduction."""
    columns = [*dict.fromkeys(name for one in rows for name in one)]
    cells = ([one.get(name, "") for name in columns] for one in rows)
    write_csv(OUT / name, Format("judged policies", 1), columns, cells, end="\n")


def main(*folders: str) -> None:
    """Judge all policies, and write the tables: the Open Duck's also as late as a builder measured its servos."""
    warnings.simplefilter("ignore")  # of what the readers leave out
    *others, duck = published(*folders)
    sent = targets(duck, DUCK_SERVOS["sts3215"])
    followed = {kind: following(duck, servo, sent) for kind, servo in DUCK_SERVOS.items()}
    asked = [(duck._replace(speed=speed), *servo) for speed in DUCK_SPEEDS for servo in DUCK_SERVOS.items()]
    write("judged_duck.csv", [row(*each, DUCK_WORLDS) | followed[each[1]] for each in asked])
    servos = {one: SERVOS if one.robot == "Microduck" else {"of the file": None} for one in others}
    rows = {
        (one, kind): row(one, kind, own[kind]) | (nominal(one) if own[kind] is None else {})
        for kind in SERVOS for one, own in servos.items() if kind in own
    }  # fmt: skip
    write("judged_policies.csv", sorted(rows.values(), key=lambda own: own["robot"] != "Microduck"))
    rough = []
    for one in others:
        if one.label in ROUGH:
            kind = [*servos[one]][-1]
            rough.append(rows[one, kind] | {"height": 0.0})
            rough += [row(one, kind, servos[one][kind], height=height) for height in ROUGH[one.label]]
    write("judged_rough.csv", rough)


if __name__ == "__main__":
    main(*sys.argv[1:])
