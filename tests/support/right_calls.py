"""Public functions with right arguments, which test_fuzz_calls.py spoils."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import featherstone_gait as fg
from featherstone_gait import identification, search, walking
from featherstone_gait.benchmark.scenes import unlimited
from featherstone_gait.run import sensors

# What is made by other functions and only read, and what is no function.
NO_CALLS = {
    "featherstone_gait": (
        "Clearance",
        "CompiledScene",
        "ContactHistory",
        "Coupling",
        "IndependentCoordinates",
        "Poses",
        "IKResult",
        "OverlapWarning",
        "Discontinuity",
        "Linearization",
        "Gradient",
        "RunCost",
        "RobotFileError",
        "RobotFileNotFoundError",
        "RobotFileWarning",
        "robot_names",
        "scene_names",
        "channel_table",
        "Trajectory",
        "Trim",
        "drive",
        "replay",
        "show_live",
        "Energy",
        "StateView",
        "Status",
        "Wrench",
    ),
    "identification": ("Identification",),
    # The last is for robots on four legs, of which none comes along.
    "walking": (
        "BIOLOID_WALK",
        "BalancedWalk",
        "ConstraintReport",
        "LongWalk",
        "Measures",
        "Motion",
        "Plan",
        "four_legged_stride",
    ),
    "sensors": ("in_world",),  # for whoever draws forces
}


class Call(NamedTuple):
    """A function and arguments that it takes."""

    name: str
    function: Callable[..., Any]
    arguments: dict[str, Any]
    slow: bool = False  # compiles a simulation or takes long


def arm() -> fg.Model:
    """Two links on a wall, with servos."""
    zero, inertia = (0.0, 0.0, 0.0), (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3)
    links = (fg.Link("wall", 0.0, zero, (0.0,) * 6), *(fg.Link(name, 0.1, (0.0, 0.0, -0.1), inertia) for name in "ab"))
    limits: dict[str, Any] = {"axis": (0.0, 1.0, 0.0), "lower": -2.0, "upper": 2.0}
    joints = (
        fg.Joint("one", "revolute", "wall", "a", **limits),
        fg.Joint("two", "revolute", "a", "b", xyz=(0.0, 0.0, -0.2), **limits),
    )
    shapes = tuple(fg.Shape(name, fg.Sphere(0.01)) for name in ("wall", "b"))
    return fg.Model("arm", links, joints, servos=dict.fromkeys(("one", "two"), servo()), shapes=shapes)


def servo() -> fg.Servo:
    """One with a motor."""
    control = fg.Controller("pid_position", Kp=60.0)
    return fg.Servo(control, fg.Gearbox(254.0, 1e-7), 6.0, 0.0, 0.004, 12.0)


def box() -> fg.Model:
    """A box that floats, with four corners and a lid."""
    corners = tuple(fg.ContactPoint("box", (x, y, -0.05)) for x in (-0.1, 0.1) for y in (-0.1, 0.1))
    links = (
        fg.Link("box", 1.0, (0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)),
        fg.Link("lid", 0.1, (0.0, 0.0, 0.05), (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3)),
    )
    joints = (fg.Joint("hinge", "revolute", "box", "lid", lower=-1.0, upper=1.0),)
    shape = fg.Shape("box", fg.Box((0.2, 0.2, 0.1)))
    return fg.Model("box", links, joints, "floating", contacts=corners, shapes=(shape,))


def company() -> fg.SceneModel:
    """An arm and a ball."""
    ball = fg.Placed(fg.body(fg.Sphere(0.1), 1.0, "ball"), position=(1.0, 0.0))
    return fg.SceneModel("company", (fg.Placed(arm()), ball), ground=fg.Ground())


def _all_fields(record: Any) -> dict[str, Any]:
    return {f.name: getattr(record, f.name) for f in fields(record) if f.init}


def _models() -> Iterator[Call]:
    joint = fg.Joint("one", "revolute", "a", "b", lower=-1.0, upper=1.0, mimic=fg.Mimic("two"))
    for record in (arm(), arm().links[1], joint, fg.Mimic("two")):
        yield Call(type(record).__name__, type(record), _all_fields(record))


def _parts() -> Iterator[Call]:
    field = fg.HeightField(np.zeros((3, 2)), (1.0, 1.0))
    for record in (
        servo(),
        fg.Gearbox(1.0),
        fg.Controller("pd"),
        fg.Controller("state", 60.0, compliance_margin=0.01, punch=0.3, pwm_steps=1023.0, duty_limit=0.9, delay=0.01),
        fg.Supply(11.1, 0.1),
        fg.Ground(steps=((1.0, 0.1),)),
        field,
        fg.ContactPoint("a", (0, 0, 0)),
        fg.Spring("a", "b", stiffness=1.0),
        fg.Loop("pin", "hinge", "a", "b", (0.1, 0.0, 0.0), axis=(0.0, 1.0, 0.0)),
        fg.Loop("rod", "distance", "a", distance=0.1),
        fg.Via("a", (0.1, 0.0, 0.0)),
        fg.Wrap("a", "cylinder", 0.1, (0.1, 0.0, 0.0), (0.0, 0.0, 1.0), (0.2, 0.0, 0.0)),
        fg.Tendon("strap", (), (fg.Via("a"), fg.Via("b")), 1.0),
        fg.Tendon("tendon", (("one", 1.0),), rest=(0.0, 0.1), lower=-1.0, upper=1.0),
        fg.Fluid(level=0.5),
        fg.Immersed("a", fg.Sphere(0.1), drag=1.0, added_mass=(0.1, 0.2, 0.3)),
        fg.Propeller("one", 1e-4),
        fg.Surface((0.5, 0.0, 0.0), drive="belt"),
        fg.FloorLine([(0.0, 0.0), (1.0, 0.0)], 0.02),
        fg.RangeSensor("a", [[1.0, 0.0, 0.0]], reach=2.0, curve=((0.1, 3.0), (0.8, 0.4))),
        fg.LineSensor("a", [(0.1, 0.0, 0.0)], 0.01),
        fg.ForceTorqueSensor("a", (0.1, 0.0, 0.0), (0.0, 0.0, 1.0), "wrist"),
        fg.ContactSensor("a", 0.1),
        fg.SampledSensor("q", noise=0.1, rate=50.0, delay=0.02, seed=1, name="late"),
        fg.Sphere(1.0),
        fg.Capsule(1.0, 1.0),
        fg.Cylinder(1.0, 1.0),
        fg.Box((1.0, 1.0, 1.0)),
        fg.Mesh("file.stl"),
        fg.Hull(((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))),
        fg.Shape("a", fg.Sphere(1.0)),
        fg.Placed(box(), "lid box", (0.0, 1.0)),
        fg.PairContact((("lid box", "ground"),), load=1.0, max_points=8),
        fg.PairFriction("lid box", "ground", 0.5, 0.01, 0.001),
        company(),
        fg.Distribution("normal", 0.1),
        fg.Worlds(3, servos={"Kp": fg.Distribution("uniform", 0.1)}, gravity=(0.0, 0.0, -9.81)),
    ):
        yield Call(type(record).__name__, type(record), _all_fields(record))
    yield Call(
        "Reference", fg.Reference, {"times": [0.0, 1.0], "values": [[0.0], [0.0]], "kind": "cubic", "cyclic": True}
    )
    yield Call("stairs", fg.stairs, {"count": 3, "depth": 0.2, "rise": 0.1, "start": 0.0})


def _dynamics() -> Iterator[Call]:
    for model in (arm(), box()):
        q = np.zeros(model.nq)
        q[3 if model.nq > 3 else 0] = 1.0
        v, g = np.zeros(model.nv), (0.0, 0.0, -9.81)
        n = len(model.joint_names)
        extra: dict[str, Any] = {"armature": np.zeros(n), "gravity": g}
        pushed: dict[str, Any] = {"wrench": {model.links[0].name: fg.Wrench(np.ones(3), np.ones(3))}} | extra
        pushed["stiffness"] = np.zeros(n)
        springs = [fg.Spring(model.links[0].name, model.links[1].name, (0.1, 0.0, 0.0), stiffness=10.0)]
        link, moving = model.links[-1].name, {"model": model, "q": q, "qd": v}
        yield Call("forward_dynamics", fg.forward_dynamics, moving | {"tau": v} | pushed)
        yield Call("inverse_dynamics", fg.inverse_dynamics, moving | {"qdd": v} | pushed)
        yield Call("mass_matrix", fg.mass_matrix, {"model": model, "q": q, "armature": np.zeros(n)})
        yield Call("energy", fg.energy, moving | extra)
        yield Call("momentum", fg.momentum, moving)
        for name in ("center_of_mass", "forward_kinematics", "contact_positions", "center_of_mass_jacobian"):
            yield Call(name, getattr(fg, name), {"model": model, "q": q})
        yield Call("spring_energy", fg.spring_energy, {"model": model, "springs": springs, "q": q})
        yield Call("jacobian", fg.jacobian, {"model": model, "q": q, "link": link, "point": (0, 0, 0), "frame": "body"})
        state = {"engine": "mujoco", "model": model, "q": q}
        yield Call("to_engine", fg.to_engine, state | {"qd": np.zeros(model.nv)})
        yield Call("from_engine", fg.from_engine, state | {"v": np.zeros(model.nv)})
        yield Call("coupling_matrix", fg.coupling_matrix, {"model": model})
        bound = replace(model, loops=(fg.Loop("rod", "distance", link, None, (0.1, 0.0, 0.0), distance=5.0),))
        yield Call("loop_forces", fg.loop_forces, moving | {"tau": v, "model": bound, "gravity": g})
        for name in ("loop_gaps", "loop_jacobian", "degrees_of_freedom"):
            yield Call(name, getattr(fg, name), {"model": bound, "q": q})
        free = {"model": bound, "q": q, "qd": v, "independent": [model.joint_names[0]]}
        yield Call("independent_coordinates", fg.independent_coordinates, free)
        strap = replace(model, tendons=(fg.Tendon("strap", (), (fg.Via(model.links[0].name), fg.Via(link))),))
        for name in ("tendon_lengths", "tendon_jacobian"):
            yield Call(name, getattr(fg, name), {"model": strap, "q": q})
    yield Call("clearance", fg.clearance, {"model": arm(), "q": np.zeros(2)})


def _scenes() -> Iterator[Call]:
    robot, cube = arm(), box()
    springs = [fg.Spring("wall", "b", (0.1, 0.0, 0.0), stiffness=1.0)]
    gravity, still = (0.0, 0.0, -9.81), fg.Reference([0.0, 0.1], [[0.0, 0.0], [0.1, 0.1]])
    driven = fg.compile_scene(robot, "rotor", None, "implicit_euler", 1e-3)
    over = fg.compile_scene(cube, None, fg.Ground(), "implicit_euler", 1e-3)
    start, falling = fg.initial_state(driven), fg.initial_state(over)
    some = {
        "duration": 0.01,
        "record": ("q", "qd"),
        "record_interval": 0.01,
        "rtol": None,
        "atol": None,
        "estimate_error": False,
    }
    push = [fg.Push("b", (1.0, 0.0, 0.0), end=0.01)]
    yield Call(
        "compile_scene",
        fg.compile_scene,
        {
            "model": cube,
            "gearbox": None,
            "ground": fg.Ground(),
            "integrator": "midpoint",
            "timestep": 1e-3,
            "gravity": gravity,
            "fall_height": 0.6,
            "fall_tilt": 0.7,
            "springs": [],
        },
    )
    yield Call(
        "compile_scene", fg.compile_scene, {"model": robot, "gearbox": "rotor", "timestep": 1e-3, "springs": springs}
    )
    several = [fg.Placed(cube, position=(0.0, 0.0, 1.0)), fg.Placed(company().members[1].model, position=(0.0, 2.0))]
    both = fg.compile_scene(several, None, fg.Ground(), "implicit_euler", 1e-3)
    yield Call("compile_scene", fg.compile_scene, {"model": several, "ground": fg.Ground(), "timestep": 1e-3})
    touching = {"model": replace(company(), pairs="all"), "pairs": [["arm", "ball/body"]], "timestep": 1e-3}
    yield Call("compile_scene", fg.compile_scene, touching)
    yield Call("initial_state", fg.initial_state, {"scene": both, "q": {"ball": [0, 0, 1, 1, 0, 0, 0]}, "qd": {}})
    free = fg.Placed(unlimited(robot))
    far = (fg.Box((0.1, 0.1, 0.1)), fg.Cylinder(0.1, 0.1))
    far = tuple(fg.Placed(fg.body(one, base="fixed"), f"far{k}", (k, 0.0, 9.0)) for k, one in enumerate(far))
    lone = replace(company(), members=(free, company().members[1]), obstacles=far, ground=None, pairs="all")
    close = fg.compile_scene(lone, None, None, "extrapolation", 1e-3)
    seen = fg.RangeSensor("arm/b", [[1.0, 0.0, 0.3]])  # at the ball
    run = fg.simulate(close, 0.01, estimate_error=False)
    yield Call("ranges", fg.ranges, {"scene": close, "trajectory": run, "sensor": seen})
    late = fg.SampledSensor(seen, noise=0.1, delay=0.01)
    yield Call("measure", fg.measure, {"scene": close, "trajectory": run, "sensor": late, "robot": 1})
    yield Call("overlaps", fg.overlaps, {"scene": close, "state": fg.initial_state(close)})
    yield Call("Push", lambda **push: fg.simulate(driven, 0.01, pushes=[fg.Push(**push)]), push[0]._asdict(), True)
    begin = {"scene": driven, "q": [0.1, 0.1], "qd": [0.0, 0.0], "allow_limit_violation": False}
    yield Call("initial_state", fg.initial_state, begin)
    tied = replace(robot, loops=(fg.Loop("rod", "distance", "b", None, (0.1, 0.0, 0.0), distance=5.0),))
    bound = fg.compile_scene(tied, "rotor", None, "implicit_euler", 1e-3)
    free = {"scene": bound, "q": [0.1, 0.1], "open_loops": ["rod"]}
    yield Call("initial_state", fg.initial_state, free)
    switch = {"scene": bound, "state": fg.initial_state(**free), "name": "rod", "closed": True, "within": 10.0}
    yield Call("switch_loop", fg.switch_loop, switch)
    belt = fg.body(fg.Box((0.1, 0.1, 0.1)), 1.0, surface=fg.Surface((1.0, 0.0, 0.0), drive="belt"))
    moving = fg.compile_scene(replace(belt, contacts=()))
    driving = {"scene": moving, "state": fg.initial_state(moving), "drive": "belt", "command": 0.5}
    yield Call("command_surface", fg.command_surface, driving)
    yield Call("reset_time", fg.reset_time, {"scene": driven, "state": fg.initial_state(driven)})
    yield Call("initial_state", fg.initial_state, {"scene": over, "q": [0.0, 0, 1, 1, 0, 0, 0, 0], "qd": np.zeros(7)})
    yield Call("standing_state", fg.standing_state, {"scene": over, "angles": [0.0], "allow_limit_violation": False})
    chosen = {"n": 2, "action": "reference", "observe": ("q", "encoders"), "seed": 0, "record_interval": None}
    yield Call("Session", lambda **how: fg.Session(driven, **how).close(), chosen, True)
    yield Call("controller", lambda **how: fg.controller(_follow, **how), {"memory": 1, "period": 0.01})
    held = {"state": start, "reference": [0.1, 0.1], "tau": None, "inputs": ("reference",), "outputs": ("torque",)}
    counts = {"states": ("q", "qd"), "steps": 3, "rtol": None, "threads": 1}
    yield Call("linearize", fg.linearize, {"scene": driven} | held | counts, True)
    yield Call("linearize", fg.linearize, {"scene": over, "state": falling, "tau": [0.0], "inputs": ("torque",)}, True)
    given = {"cost": _last, "parameters": ("reference", "servos.resistance"), "record": ("q",), "record_interval": None}
    one = {"scene": driven, "duration": 0.01}
    yield Call("gradient", fg.gradient, one | {"state": start, "reference": still} | given, True)
    several = {"states": [start] * 2, "references": [still] * 2, "taus": None, "threads": 1}
    yield Call("gradient_batch", fg.gradient_batch, one | several | given, True)
    changed = {"inputs": lambda x: {"reference": still}, "cost": _last, "record": ("q",), "threads": 1, "scale": 1.0}
    yield Call("RunObjective", fg.RunObjective, one | changed, True)
    yield Call("run_cost", fg.run_cost, {"function": _last})
    yield Call("trim", fg.trim, {"scene": driven, "q": [0.1, 0.1]}, True)
    yield Call("trim", fg.trim, {"scene": over, "q": [0.0, 0, 1, 1, 0, 0, 0, 0], "contacts": ["box"]}, True)
    yield Call(
        "simulate",
        fg.simulate,
        {"scene": driven, "state": start, "reference": still, "pushes": push, "noise": np.zeros((1, 2, 2))} | some,
        True,
    )
    yield Call("simulate", fg.simulate, {"scene": over, "state": falling, "tau": [0.1], "pushes": []} | some, True)
    yield Call(
        "simulate_batch",
        fg.simulate_batch,
        {
            "scene": driven,
            "states": [start] * 3,
            "references": [still] * 3,
            "taus": None,
            "pushes": [],
            "worlds": fg.Worlds(3, servos={"Kp": [1.0, 2.0, 3.0]}),
            "executor": None,
            "noises": None,
        }
        | some,
        True,
    )


def _files() -> Iterator[Call]:
    yield Call(
        "load_robot",
        fg.load_robot,
        {
            "name_or_path": "ax12_arm",
            "base": "fixed",
            "locked": {},
            "contacts": None,
            "strict": False,
            "mimic": "free",
            "repair_inertia": False,
            "package_dirs": (),
            "srdf": None,
        },
    )
    shape = {"shape": fg.Box((0.1, 0.1, 0.1)), "mass": 1.0, "name": "crate", "base": "floating"}
    inertia = {"inertia": (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3), "center_of_mass": (0.0, 0.0, 0.01), "friction": 0.5}
    yield Call("body", fg.body, shape | inertia)
    yield Call("save_scene", fg.save_scene, {"scene": company(), "path": "company.xml"})
    yield Call("load_scene", fg.load_scene, {"path": "company.xml", "strict": False})
    yield Call("load_controller", fg.load_controller, {"name_or_path": "balancer"})
    yield Call("save_robot", fg.save_robot, {"model": arm(), "path": "saved.urdf", "ground": None})
    yield Call("save_robot", fg.save_robot, {"model": arm(), "path": "saved.xml", "ground": fg.Ground()})
    yield Call("load_servo", fg.load_servo, {"name": "ax12", "gearbox": "physical", "Kp": 10.0, "law": "pid_position"})
    yield Call("gearbox_presets", fg.gearbox_presets, {"name": "ax12"})


def _postures() -> Iterator[Call]:
    place: dict[str, Any] = {
        "model": arm(),
        "q0": None,
        "joints": ["one", "two"],
        "hold_base": False,
        "restarts": 1,
        "seed": 0,
        "tolerance": 1e-6,
        "max_iterations": 30,
    }
    there = fg.Target("b", (0.1, 0.0, -0.2))
    yield Call("inverse_kinematics", fg.inverse_kinematics, place | {"targets": there})
    near = {name: place[name] for name in ("joints", "hold_base", "tolerance", "max_iterations")}
    bound = replace(arm(), loops=(fg.Loop("rod", "distance", "b", None, (0.1, 0.0, 0.0), distance=0.2),))
    yield Call("close_loops", fg.close_loops, near | {"model": bound, "q": np.zeros(2)})
    spoil = there._asdict() | {"rotation": (0.0, 0.0, 0.0)}
    yield Call("Target", lambda **target: fg.inverse_kinematics(arm(), fg.Target(**target)), spoil)
    yield Call("nearest_posture", fg.nearest_posture, {"model": arm()})
    yield Call("with_contacts", fg.with_contacts, {"model": box(), "choice": "all"})
    yield Call("contact_points", fg.contact_points, {"shapes": box().shapes})
    run = trajectory(box())
    yield Call(
        "plot",
        lambda trajectory, name, axes: _closed(fg.plot(trajectory, name, axes=axes)),
        {"trajectory": run, "name": "q", "axes": None},
    )
    yield Call(
        "plot_motion",
        lambda **how: _closed(fg.plot_motion(**how)),
        {"model": box(), "trajectory": run, "axes": None, "count": 3, "view": "xz"},
    )
    yield Call("tree_text", fg.tree_text, {"model": arm()})
    seen = {"trajectory": run, "robot": box()}
    yield Call("show", fg.show, seen | {"captions": ["a"], "plots": ["q"], "ghosts": False, "path": "page.html"})
    movie = {"path": "run.gif", "fps": 25.0, "speed": 1.0, "size": (64, 64)}
    yield Call("save_movie", fg.save_movie, seen | movie)


def _follow(t: float, state: Any, reference: Any, command: Any, memory: Any) -> None:
    command[0, 0] = reference[0, 0]


def _last(channels: Any) -> Any:
    """Return the last position of the first joint, and its derivatives."""
    by_q = np.zeros(channels["q"].shape)
    by_q[-1, 0] = 1.0
    return float(channels["q"][-1, 0]), {"q": by_q}


def _closed(figure: Any) -> None:
    from matplotlib import pyplot

    pyplot.close(figure)


def trajectory(model: fg.Model, samples: int = 4) -> fg.Trajectory:
    """A robot that rests over the origin, as if simulated."""
    q = np.tile([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0], (samples, 1))
    channels = {
        "time": 0.01 * np.arange(samples),
        "base_q": q,
        "q": np.zeros((samples, 1)),
        "base_qd": np.zeros((samples, 6)),
        "base_qdd": np.zeros((samples, 6)),
        "contact_force": np.ones((samples, 4, 3)),
    }
    return fg.Trajectory(channels, "ok", "", 0.03, np.zeros(3), {"robot": model.name})


def _walking() -> Iterator[Call]:
    robot = fg.load_robot("humanoid", locked="simplified")
    posture = np.zeros(len(robot.joint_names))
    yield Call("WalkSettings", walking.WalkSettings, _all_fields(walking.WalkSettings()))
    settings = {"n_steps": 4, "step_time": 0.32, "com_height": 0.205, "step_length": 0.02}
    yield Call("walking_plan", walking.walking_plan, {"model": robot, "feet": None, "posture": None} | settings, True)
    control = {"T": 0.01, "z_c": 0.2, "N": 50, "Q": 1.0, "R": 1e-6, "g": 9.81}
    yield Call("preview_controller", walking.preview_controller, control)
    yield Call("plan_com", walking.plan_com, {"zmp_ref": np.zeros((60, 2))} | control)
    yield Call(
        "solve_leg",
        walking.solve_leg,
        {"model": robot, "foot": "left_foot", "target": [[0.0, 0.04, -0.2]], "times": None},
    )
    yield Call(
        "multibody_zmp",
        walking.multibody_zmp,
        {"model": robot, "angles": np.tile(posture, (9, 1)), "base_position": np.zeros((9, 3)), "T": 0.01, "g": 9.81},
    )
    yield Call("mirror_of", walking.mirror_of, {"model": robot})
    yield Call("mirror_by_place", walking.mirror_by_place, {"model": robot, "posture": posture})
    scaled = {"model": robot, "leg": 0.2, "servo": None, "margin": 1.0}
    yield Call("with_generic_servos", walking.with_generic_servos, scaled)
    yield Call("Pattern", walking.Pattern, _all_fields(walking.Pattern()))
    scene = fg.compile_scene(robot, "mipsd", fg.Ground(), "midpoint", 1e-3)
    yield Call("first_gait", walking.first_gait, {"scene": scene, "plan": "plain", "states": "step"}, True)
    few = {"scene": scene, "states": "step", "box": None, "count": (1,), "searched": None, "seed": 0}
    known = {"step_length": 0.03, "step_time": 0.26, "lift": 0.014, "com_height": 0.206, "half_width": 0.0365}
    yield Call("cheapest_plan", walking.cheapest_plan, few | known | {"double_support": 0.12}, True)
    yield Call("Constraints", walking.Constraints, _all_fields(walking.Constraints(1.0, 0.1, 0.1, 0.1, 0.1)))


def _gaits() -> Iterator[Call]:
    robot = fg.load_robot("humanoid", locked="simplified")
    names, n = robot.joint_names, len(robot.joint_names)
    gait = walking.Gait(names, np.zeros((4, n)), 0.64, walking.mirror_of(robot))
    times, angles = walking.references(gait, 1, np.zeros(n))
    stride = fg.walking.plan.Stride(names, times[:16], angles[:16], 0.64, 0.0)
    yield Call("Gait", walking.Gait, _all_fields(gait))
    yield Call("Gait.from_vector", gait.from_vector, {"x": gait.to_vector()})
    yield Call("Gait.angles", gait.angles, {"times": [0.0, 0.1]})
    yield Call("fit_gait", walking.fit_gait, {"stride": stride, "n_poses": 4, "mirror": gait.mirror, "fit_phase": True})
    start = {"gait": gait, "n_strides": 1, "start": np.zeros(n), "tick": 0.04, "blend_strides": 1}
    yield Call("references", walking.references, start)
    yield Call("bounds", walking.bounds, {"model": robot, "gait": gait})
    scene = fg.compile_scene(robot, "mipsd", fg.Ground(), "midpoint", 1e-3)
    cost = walking.WalkingCost(scene, gait, np.zeros(n), 0, 1, 1)
    yield Call(
        "WalkingCost", lambda **how: walking.WalkingCost(**how).reference(gait.to_vector(), 1), _all_fields(cost)
    )
    slope = {"cost": cost, "x": gait.to_vector(), "threads": 1}
    yield Call("cost_and_gradient", walking.cost_and_gradient, slope, True)
    yield Call("ConstrainedCost", walking.ConstrainedCost, {"walking": cost, "constraints": walking.Constraints()})
    table: dict[str, Any] = {"path": "angles.csv", "times": times, "angles": angles, "joint_names": names}
    walking.write_angles(**table)
    yield Call("write_angles", walking.write_angles, table | {"path": "more.csv"})
    yield Call("write_goal_positions", walking.write_goal_positions, table | {"path": "goals.csv"})
    yield Call("read_angles", walking.read_angles, {"path": "angles.csv", "joint_names": names})
    yield Call(
        "cost_of_motion",
        walking.cost_of_motion,
        {"scene": scene, "path": "angles.csv", "start": 0.0, "strides": 1},
        True,
    )


def _balanced() -> Iterator[Call]:
    robot = fg.load_robot("humanoid", locked="simplified")
    names, n = robot.joint_names, len(robot.joint_names)
    gait = walking.Gait(names, np.zeros((4, n)), 0.64, walking.mirror_of(robot))
    scene = fg.compile_scene(robot, "mipsd", fg.Ground(), "midpoint", 1e-3)
    yield Call("Feedback", walking.Feedback, _all_fields(walking.Feedback()))
    yield Call("Imu", walking.Imu, _all_fields(walking.Imu()))
    yield Call("motion_of", walking.motion_of, {"gait": gait, "start": np.zeros(n), "blend_strides": 1})
    shutil.copyfile(Path(robot.source).parent / "balanced_gait.npz", "walk.npz")
    file: dict[str, Any] = {"path": "walk.npz", "joint_names": names}
    yield Call("read_motion", walking.read_motion, file | {"first": False})
    yield Call("read_walk", walking.read_walk, file)
    yield Call("servo_of", walking.servo_of, {"path": "walk.npz"})
    walk = walking.read_walk(**file)
    assert isinstance(walk, walking.BalancedWalk)
    yield Call("add_feedback", walking.add_feedback, {"path": "walk.npz", "walk": walk})
    parts = {"motion": walk.motion, "feedback": walk.feedback, "imu": walk.imu, "mirror": gait.mirror}
    yield Call("balanced", walking.balanced, {"scene": scene} | parts, True)
    field = {"height": 3e-3, "seed": 0, "length": 2.0, "width": 1.0, "spacing": 0.1}
    yield Call("rough_field", walking.rough_field, field)
    far = {"scene": scene, "walk": walk, "ground": None, "strides": 1, "feedback": True, "seed": 0}
    yield Call("walk_far", walking.walk_far, far, True)
    pushed = {"scene": scene, "walk": walk, "worlds": 1, "feedback": True, "seed": 0}
    yield Call("generic_feedback", walking.generic_feedback, {"model": scene.model})
    yield Call("pushes_survived", walking.pushes_survived, pushed, True)


def square(x: np.ndarray) -> float:
    """A cost."""
    return float(np.sum(np.square(x)))


def _searches() -> Iterator[Call]:
    start: dict[str, Any] = {"x0": [1.0, 2.0], "amplitude": 0.5, "bounds": [[-5.0, 5.0]] * 2, "seed": 1}
    paper = start | {"max_miss": 20, "max_iterations": 5, "no_progress": 4}
    yield Call("AdaptiveSimulatedAnnealing", search.AdaptiveSimulatedAnnealing, paper)
    yield Call(
        "minimize",
        search.minimize,
        paper
        | {
            "fun": square,
            "map": map,
            "batch": 1,
            "evaluate": None,
            "callback": None,
            "history": None,
            "resume": False,
            "progress": False,
        },
    )
    yield Call("cma_es", search.cma_es, start | {"population": 5})
    box = {"bounds": start["bounds"], "seed": start["seed"], "x0": start["x0"]}
    yield Call("differential_evolution", search.differential_evolution, start | {"population": 5})
    yield Call("dual_annealing", search.dual_annealing, box | {"initial_temp": 5230.0, "local_search": False})
    many = {"fun": square, "map": map, "batch": 1, "progress": False}
    yield Call("run", lambda **how: search.run(**_made(how)), many | {"search": paper, "evaluations": 4})
    yield Call(
        "run_together", lambda **how: search.run_together(**_made(how)), many | {"searches": [paper], "evaluations": 4}
    )
    yield Call(
        "minimize_noisy",
        lambda **how: search.minimize_noisy(**_made(how)),
        {
            "fun": lambda x, draw: square(x),
            "search": paper,
            "repeats": 2,
            "seed": 1,
            "map": map,
            "batch": 1,
            "progress": False,
        },
    )


def _made(how: dict[str, Any]) -> dict[str, Any]:
    """The arguments with a fresh search: one that is over cannot be run again."""
    made = search.AdaptiveSimulatedAnnealing
    if isinstance(how.get("search"), dict) and "x0" in how["search"]:
        return how | {"search": made(**how["search"])}
    if isinstance(how.get("searches"), list):
        return how | {"searches": [made(**s) if isinstance(s, dict) and "x0" in s else s for s in how["searches"]]}
    return how


def _recordings() -> Iterator[Call]:
    one = fg.load_robot("ax12_arm")
    time = 0.01 * np.arange(20)
    recording = identification.Recording("one", time, 0.1 * (time > 0.05), np.zeros(20), np.zeros(20), {"Kp": 20.0})
    identification.write_recording("one.csv", recording)
    yield Call("Recording", identification.Recording, _all_fields(recording))
    yield Call("read_recording", identification.read_recording, {"path": "one.csv", "Kp": 20.0})
    yield Call("write_recording", identification.write_recording, {"path": "two.csv", "recording": recording})
    yield Call("changed", identification.changed, {"model": one, "Kp": 20.0, "resistance": 5.0})
    common = {"model": one, "recordings": [recording], "gearbox": "standard"}
    yield Call("predict", identification.predict, common | {"starts": [0.0], "timestep": 1e-3}, True)
    yield Call("prediction_error", identification.prediction_error, common, True)
    yield Call(
        "identify",
        identification.identify,
        common
        | {
            "parameters": ["motor_constant"],
            "confidence": 0.95,
            "start_range": 0.0,
            "voltage_weight": 0.0,
            "timestep": 1e-3,
        },
        True,
    )


def _sensors() -> Iterator[Call]:
    cube = box()
    seen = {"scene": fg.compile_scene(cube, None, fg.Ground(), "implicit_euler", 1e-3), "trajectory": trajectory(cube)}
    for name in ("encoders", "gyroscope", "sole_forces", "contact_positions"):
        yield Call(f"sensors.{name}", getattr(sensors, name), seen)
    yield Call("sensors.accelerometer", sensors.accelerometer, seen | {"position": (0.1, 0.0, 0.0)})
    yield Call("sensors.center_of_pressure", sensors.center_of_pressure, seen | {"link": "box"})


PARTS: dict[str, Callable[[], Iterator[Call]]] = {
    part.__name__.removeprefix("_"): part
    for part in (
        _models, _parts, _dynamics, _scenes, _files, _postures, _walking, _gaits, _balanced, _searches, _recordings,
        _sensors,
    )
}  # fmt: skip
