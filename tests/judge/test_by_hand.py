"""Worlds followed by hand: all numbers of a judgment, from the channels that a session of its own has recorded."""

from dataclasses import replace

import numpy as np
import pytest
from feet import steps_of

from featherstone_gait import Controller, Ground, Servo, Session, compile_scene, load_robot, standing_state
from featherstone_gait.benchmark.little_biped import little_biped
from featherstone_gait.judge import Policy, PolicyDescription, judge
from featherstone_gait.judge.description import Action, Block
from featherstone_gait.judge.doubts import draw_worlds
from featherstone_gait.judge.run import scene_of
from featherstone_gait.model import Gearbox

WIDE = {"kind": "uniform", "scale": 0.1}
DOUBTS = {
    "worlds": {
        "ground": {"friction": {"kind": "uniform", "scale": 0.3}, "penetration": {"kind": "lognormal", "scale": 1.0}},
        "servos": {"Kp": WIDE, "voltage_limit": WIDE, "stiffness": WIDE},
        "links": {"mass": {"kind": "lognormal", "scale": 0.05}},
        "reference": {"offset": {"kind": "uniform", "scale": 0.01}},
    },
}
CHANNELS = ("q", "qd", "base_q", "torque", "voltage", "current", "contact_force", "energy")


def waving(scene, size, lean):
    """A blind policy of 50 Hz, which waves all joints and leans ever more, and its references (steps, joints) [rad]."""
    joints = scene.model.joint_names
    actions = size * np.sin(0.3 * np.arange(100)[:, None] + np.arange(len(joints)))
    actions[:, [k for k, name in enumerate(joints) if "ankle" in name]] += lean * np.arange(100)[:, None] / 50
    blocks = (Block("time"),)
    description = PolicyDescription(joints, (0.0,) * len(joints), 50.0, blocks, Action(scale=0.5), "waving")
    return Policy(lambda x: actions[np.rint(50.0 * x[:, 0]).astype(int)], description, "waving"), 0.5 * actions


def followed(scene, drawn, references, seconds, channels=CHANNELS, interval=None):
    """Runs of all worlds, driven by references (steps, joints) of 50 Hz in the robots' own zeros."""
    limits = np.array([(one.lower, one.upper) for one in scene.model.moving_joints]).T
    with Session(scene, record=channels, record_interval=interval, worlds=drawn.worlds) as session:
        starts = [standing_state(one, -off, True) for one, off in zip(session.scenes, drawn.sensing.offset)]
        session.reset(state=starts)
        for values in references[: round(50 * seconds)]:
            for _ in range(round(0.02 / session.tick)):
                session.step(np.clip(values, *limits) - drawn.sensing.offset)
        return [session.trajectory(k) for k in range(session.n)], session.scenes


def by_hand(run, scene, direction):
    """The numbers of a world and of its joints, of the samples until it ended, 5 ms or a longer tick apart."""
    there = np.flatnonzero(run["time"] <= run.end_time + 1e-9)
    held = np.abs(run["voltage"][there][:-1])  # recorded from when it acts, and judged at the end of its tick
    every = max(1, round(5e-3 / run["time"][1]))
    looked = {name: run[name][there[:: max(1, round(1e-2 / run["time"][1]))]] for name in CHANNELS}
    there, held = there[::every], held[every - 1 :: every]
    times, seen = run["time"][there], {name: run[name][there] for name in CHANNELS}
    w, x, y, z = seen["base_q"][:, 3:].T
    heading = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    moved = np.diff(seen["base_q"][:, :2] @ (1, 1j)) / np.exp(0.5j * (heading[1:] + heading[:-1]))
    way = moved.sum() / (direction @ (1, 1j))
    up = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1) @ scene.upright
    links = [point.link for point in scene.model.contacts]
    under = {link: np.array([one == link for one in links]) for link in links}
    forces = [seen["contact_force"][1:, points, 0].sum(axis=1).max() for points in under.values()]
    mass, time = sum(link.mass for link in scene.model.links), run.end_time
    servos = [scene.model.servos[name] for name in scene.model.joint_names]
    limit = np.array([one.voltage_limit for one in servos])
    full = held >= (1 - 1e-9) * limit
    spent, copper = (run.column("energy", name)[there][-1] for name in ("electrical_no_regeneration", "copper"))
    spent = spent.sum()
    torque, current = np.abs(seen["torque"][1:]), np.abs(seen["current"][1:])
    first = [times[1:][column][0] if column.any() else np.inf for column in full.T]
    swings, slip, near = steps_of(looked, scene)
    world = {
        "time": time, "way": way.real, "aside": way.imag, "turned": heading[-1] - heading[0], "speed": way.real / time,
        "energy": spent, "power": spent / time, "energy_per_way": spent / way.real if way.real > 0 else np.nan,
        "cost_of_transport": spent / way.real / mass / 9.81 if way.real > 0 else np.nan,
        "clearance": np.median(swings) if swings else np.nan, "least_clearance": min(swings, default=np.nan),
        "slip": slip / way.real if way.real > 0 else np.nan, "near_fall": near,
        "saturated": full.mean(), "largest_tilt": np.arccos(up[1:].min()), "largest_force": max(forces) / mass / 9.81,
    }  # fmt: skip
    joints = {
        "peak_torque": torque.max(axis=0), "rms_torque": np.sqrt((torque**2).mean(axis=0)),
        "saturated": full.mean(axis=0), "first_saturated": np.array(first), "peak_current": current.max(axis=0),
        "rms_current": np.sqrt(copper / [one.resistance for one in servos] / time),
    }  # fmt: skip
    return world, joints


def check(scene, doubts, size, lean, seconds, command):
    """Compare all numbers of eight worlds; return the judgment."""
    policy, references = waving(scene, size, lean)
    found = judge(policy, scene, 8, seconds, command, again=0, doubts=doubts)
    runs, scenes = followed(scene, draw_worlds(scene, 8, 0, doubts), references, seconds)
    direction = np.array(command[:2]) / np.hypot(*command[:2])
    for k, (run, own) in enumerate(zip(runs, scenes)):
        world, joints = by_hand(run, own, direction)
        for numbers, measured in ((world, found.worlds), (joints, found.joints)):
            for name, value in numbers.items():
                np.testing.assert_allclose(measured[name][k], value, rtol=1e-9, atol=1e-12, err_msg=f"{name} of {k}")
        assert (found.verdicts[k] == "falls") == (run.status == "fell")
    return found


@pytest.mark.long
def test_all_numbers_of_a_judgment_are_those_of_the_recorded_channels():
    """Some worlds fall on the way, some joints are saturated, and the way is neither straight nor ahead."""
    scene = compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)
    found = check(scene, DOUBTS, 0.2, 0.2, 0.92, (0.3, 0.4, 0.0))
    assert 0 < (found.verdicts == "falls").sum() < 8
    assert 0.0 < found.joints["saturated"].mean() < 0.5
    assert np.isfinite(found.joints["first_saturated"]).any()


@pytest.mark.long
def test_so_are_those_of_a_biped_with_rigid_gears():
    doubts = {"worlds": {name: DOUBTS["worlds"][name] for name in ("ground", "links", "reference")}}
    check(scene_of(little_biped()), doubts, 0.1, 0.0, 1.0, (0.1, 0.0, 0.0))


@pytest.mark.long
def test_energy_of_servos_without_a_motor_is_their_positive_work():
    """The reference is the sum of powers sampled every 1 ms; the sum of those of every 10 ms is off by a tenth."""
    robot, doubts = little_biped(), {"worlds": {"ground": DOUBTS["worlds"]["ground"]}}
    law = Servo(Controller("pd_clamped", 4.0, Kd=0.1, torque_limit=0.4), Gearbox(1.0, rotor_inertia=1e-3))
    scene = scene_of(replace(robot, servos=dict.fromkeys(robot.servos, law)))
    policy, references = waving(scene, 0.1, 0.0)
    found = judge(policy, scene, 8, 1.0, again=0, doubts=doubts)
    runs, _ = followed(scene, draw_worlds(scene, 8, 0, doubts), references, 1.0, ("torque", "qd"), 1e-3)
    for energy, run in zip(found.worlds["energy"], runs, strict=True):
        assert energy == pytest.approx(1e-3 * np.maximum(run["torque"] * run["qd"], 0.0).sum(), rel=0.02)
