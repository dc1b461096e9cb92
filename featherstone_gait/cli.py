"""The command line, `featherstone-gait COMMAND`.

A command is one function from its arguments to an exit code, registered in `_parser`; what it needs is imported where
it is used, so that `--help` answers at once.  Exit codes: 0 done, 1 the simulation ended with another status than
"ok" or an experiment failed, 2 an argument or a file is wrong (one line says which), 130 interrupted.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
import time
from importlib import import_module
from pathlib import Path

from . import __version__
from .experiments import EXPERIMENTS

INTEGRATORS = ("implicit_euler", "midpoint", "rk4", "simtwo", "dop853", "extrapolation")
BENCHMARKS = {  # modules of `featherstone_gait.benchmark`, and the files they write
    "speed": "speed.csv, speed_steps.csv, speed.png",
    "servo": "servo_arm.csv, servo_pd.csv, servo.png",
    "walk": "walk.csv, walk.png",
    "stress": "stress.csv, stress.png",
    "skip": "skip.csv",
    "stability": "stability.csv, stability.png",
    "precision": "precision.csv, precision.png",
    "peers": "peers.csv, peers_speed.csv, peers_lines.csv, peers.png",
}
SWING, PULL = 0.5 * math.pi, 0.1  # where the first joint starts, without and with servos [rad]
SAMPLE = 2e-3  # time between records, in whole steps [s]
SERVO_HELP = "gearbox of the servos (default: mipsd if the robot has any, but a fixed one swings without)"
TORQUE_GAINS = {"Kp": "N m/rad", "Kd": "N m s/rad"}
GAINS = {  # of the laws that differ
    "pid_speed": {"Kp": "V s/rad", "Ki": "V/rad", "Kd": "V s^2/rad"},
    "pd": TORQUE_GAINS,
    "pd_clamped": TORQUE_GAINS,
}


def main(argv: list[str] | None = None) -> int:
    """Run a command; return its exit code."""
    args = _parser().parse_args(argv)
    try:
        _make_folder(args.out)
        return args.run(args)
    except (ValueError, OSError) as error:
        print("error:", " ".join(str(error).split()), file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def _make_folder(path: Path) -> None:
    """Raises ValueError where a file, at the path or above it, is in the way."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        file = next(each for each in (path, *path.parents) if each.exists())
        raise ValueError(f"--out {path}: {file} is a file, not a folder; give another folder, or move it") from error


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="featherstone-gait", description="Simulate servo-driven robots.")
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    info = _command(commands, "info", _info, "print a robot's masses, joints, servos and step limits", "ROBOT_info.txt")
    _add_robot(info)

    simulation = _command(
        commands,
        "simulate",
        _simulate,
        "simulate a robot: a fixed one swings, or with servos is pulled upright; a floating one stands on the ground",
        "ROBOT_simulation.npz (channels), .json (status, settings, measures) and .png",
    )
    _add_robot(simulation)
    simulation.add_argument("--duration", type=float, metavar="S", help="[s] (default: 1, with servos or ground 2)")
    simulation.add_argument("--integrator", metavar="NAME", help=f"{', '.join(INTEGRATORS)} (default: chosen)")
    simulation.add_argument("--timestep", type=float, metavar="S", help="[s] (default: chosen, and stated)")

    optimization = _command(
        commands,
        "optimize",
        _optimize,
        "plan a biped's walk and search for a gait that takes less energy per distance; Ctrl-C keeps the best so far",
        "ROBOT_gait.json (measures before and after), .npz (arrays), _animation.html, _convergence.png, _angles.png, "
        "_angles.csv [deg], _goal_positions.csv (AX-12, every 40 ms) and _history.jsonl",
    )
    optimization.add_argument("--robot", default="humanoid", help="name or .urdf file (default: humanoid, simplified)")
    optimization.add_argument("--servos", choices=("mipsd", "rotor", "standard"), default="mipsd", help="gearbox")
    optimization.add_argument("--iterations", type=int, default=800, metavar="N", help="candidates (default: 800)")
    optimization.add_argument("--seed", type=int, default=0, metavar="N", help="of the search (default: 0)")
    optimization.add_argument("--resume", action="store_true", help="go on from the history in the folder")

    study = _command(
        commands,
        "study",
        _study,
        "run a parameter study, or go on with one that was interrupted",
        "FILE.csv (a row a run), .png (summary) and .jsonl (finished runs, to go on from)",
    )
    study.add_argument("file", type=Path, metavar="FILE.toml", help="what to run: help(featherstone_gait.study)")
    study.add_argument("--batch", type=int, metavar="N", help="runs handed over at a time (default: 8; of many 64)")
    study.add_argument("--cluster", metavar="ADDRESS", help="of a dask scheduler, instead of this machine's cores")
    study.add_argument("--parquet", action="store_true", help="also write FILE.parquet (needs pandas and pyarrow)")

    files = "; ".join(f"{name}: {files}" for name, files in BENCHMARKS.items())
    benchmark = _command(commands, "benchmark", _benchmark, "run a benchmark", f"tables and a picture ({files})")
    benchmark.add_argument("name", metavar="NAME", choices=BENCHMARKS, help=" or ".join(BENCHMARKS))
    benchmark.add_argument("--full", action="store_true", help="repeat everything more often")

    reproduction = _command(
        commands,
        "reproduce",
        _reproduce,
        "run the paper's experiments, or go on with them, and compare each claim with the paper",
        "reproduction.html, reproduction.md and reproduction_files (pictures, and finished experiments to go on from)",
    )
    names = ", ".join(EXPERIMENTS)
    reproduction.add_argument("names", metavar="NAME", nargs="*", help=f"{names} (default: all)")
    reproduction.add_argument("--full", action="store_true", help="more runs and finer steps; takes much longer")
    reproduction.add_argument("--seed", type=int, default=0, metavar="N", help="of all random numbers (default: 0)")
    return parser


def _command(commands, name: str, run, does: str, writes: str) -> argparse.ArgumentParser:
    """Register a command and its option --out."""
    parser = commands.add_parser(name, help=does, description=f"{does[0].upper()}{does[1:]}.  Writes {writes}.")
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR", help=f"folder for {writes} (default: here)")
    parser.set_defaults(run=run)
    return parser


def _add_robot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("robot", metavar="ROBOT", help="name of a robot that comes with the package, or a .urdf file")
    parser.add_argument("--locked", metavar="SET", help="set of joints to hold, from the robot's TOML file")
    parser.add_argument("--servos", choices=("mipsd", "rotor", "standard", "none"), help=SERVO_HELP)


def _output(args, kind: str) -> Path:
    """Path of the files of a command about a robot, without suffix."""
    return args.out / f"{Path(args.robot).stem}_{kind}"


def _ground(model):
    """Flat ground for a robot that can stand on it."""
    from .model import Ground

    return Ground() if model.base == "floating" and model.contacts else None


# ---------------------------------------------------------------------------------------------- info


def _info(args) -> int:
    from .build.scene import compile_scene
    from .robot_file import load_robot

    model = load_robot(args.robot, locked=args.locked)
    servos = args.servos or ("mipsd" if any(name in model.servos for name in model.joint_names) else None)
    scene = compile_scene(model, None if servos == "none" else servos, _ground(model))
    lines = [
        f"{model.name}  {model.source}",
        f"{model.mass:.4g} kg, {model.base} base, {len(model.joint_names)} moving joints, {len(model.locked)} locked",
        *_link_table(model),
        *_joint_table(model, scene.preflight),
        *_servo_table(model),
        *_contact_table(model),
        *(f"note: {note}" for note in model.notes),
        "",
        *_preflight_lines(scene),
    ]
    text = "\n".join(lines) + "\n"
    print(text, end="")
    _output(args, "info").with_suffix(".txt").write_text(text, encoding="utf-8")
    return 0


def _link_table(model) -> list[str]:
    head = ("link", "mass [kg]", "centre of mass [m]", "ixx, iyy, izz [kg m^2]")
    rows = [
        (link.name, f"{link.mass:.5g}", _numbers(link.center_of_mass), _numbers(link.inertia[k] for k in (0, 3, 5)))
        for link in model.links
    ]
    return _table(head, rows)


def _joint_table(model, check) -> list[str]:
    """The joints, with the largest step that an explicit integrator could take."""
    head = ("joint", "type", "parent", "child", "axis", "limits", "effort", "speed", "explicit step [ms]")
    steps = {limit.joint: _limit(limit) for limit in check.limits}
    steps |= {
        joint.name: f"locked at {_angle(joint, model.locked[joint.name])}"
        for joint in model.joints
        if joint.name in model.locked
    }
    rows = []
    for joint in model.joints:
        if joint.type == "fixed":
            rows.append((joint.name, joint.type, joint.parent, joint.child, *"-----"))
            continue
        limits = f"{_angle(joint, joint.lower)} to {_angle(joint, joint.upper)}"
        force, rate = ("N", "m/s") if joint.type == "prismatic" else ("N m", "rad/s")
        effort, speed = f"{joint.effort:.4g} {force}", f"{joint.velocity:.4g} {rate}"
        axis = _numbers(joint.axis)
        rows.append((joint.name, joint.type, joint.parent, joint.child, axis, limits, effort, speed, steps[joint.name]))
    return _table(head, rows)


def _limit(limit) -> str:
    return f"{1e3 * limit.step:.3g}, {limit.cause}" if limit.step < math.inf else f"any, {limit.cause}"


def _angle(joint, value: float) -> str:
    return f"{value:.4g} m" if joint.type == "prismatic" else f"{math.degrees(value):.4g} deg"


def _servo_table(model) -> list[str]:
    """Each kind of servo once, with the joints that have it."""
    kinds: dict = {}
    for joint, servo in model.servos.items():
        kinds.setdefault(servo, []).append(joint)
    lines = []
    for servo, joints in kinds.items():
        parts = {"motor": servo, "controller": servo.controller, "gearbox": servo.gearbox}
        rows = [(part, name, value, unit) for part, record in parts.items() for name, value, unit in _fields(record)]
        whose = ", ".join(joints) if len(kinds) > 1 else "all joints"
        lines += ["", f"servo of {whose}", *_table(("part", "parameter", "value", "unit"), rows)[1:]]
    return lines


def _fields(record):
    """Name, value and unit of the numbers of a servo, controller or gearbox."""
    from .model import SERVO_UNITS

    units = SERVO_UNITS | GAINS.get(getattr(record, "law", ""), {})
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if not dataclasses.is_dataclass(value):
            yield field.name, value if isinstance(value, str) else f"{value:.6g}", units.get(field.name, "")


def _contact_table(model) -> list[str]:
    rows = [(point.link, _numbers(point.position)) for point in model.contacts]
    return _table(("contact point on", "position [m]"), rows) if rows else []


def _preflight_lines(scene) -> list[str]:
    check, servos = scene.preflight, f"{scene.servos} servos" if scene.servos else "no servos"
    worst = min(check.limits, key=lambda limit: limit.step, default=None)
    limited = "nothing limits an explicit step"
    if worst is not None and worst.step < math.inf:
        alone = f"{worst.joint} alone {1e3 * worst.step:.3g} ms, by its {worst.cause}"
        limited = f"explicit steps up to {1e3 * check.largest_explicit_step:.3g} ms, all joints together ({alone})"
    where = "on the ground" if scene.ground else "without ground"
    return [f"with {servos}, {where}: {limited}", f"chosen: {_choice(scene)}"]


def _choice(scene) -> str:
    steps = "steps by their error" if scene.adaptive else f"step {1e3 * scene.timestep:g} ms"
    return f"{scene.integrator}, {steps} ({scene.preflight.reason})"


def _refinement(scene) -> str:
    return "a tenth of the tolerance" if scene.adaptive else "half the step"


def _numbers(values) -> str:
    return ", ".join(f"{value + 0.0:.4g}" for value in values)


def _table(head, rows) -> list[str]:
    """An empty line, the headings and the rows, in aligned columns."""
    widths = [max(len(str(row[k])) for row in [head, *rows]) for k in range(len(head))]
    return ["", *("  ".join(f"{cell:{width}}" for cell, width in zip(row, widths)).rstrip() for row in [head, *rows])]


# ---------------------------------------------------------------------------------------------- simulate


def _simulate(args) -> int:
    start = time.perf_counter()
    from .build.scene import compile_scene
    from .robot_file import load_robot

    model = load_robot(args.robot, locked=args.locked)
    driven = model.base == "floating" and bool(model.servos)
    servos = None if args.servos == "none" else args.servos or ("mipsd" if driven else None)
    scene = compile_scene(model, servos, _ground(model), args.integrator, args.timestep)
    duration = args.duration if args.duration is not None else (1.0 if _is_free(scene) else 2.0)
    text, run = _experiment(scene)
    run(scene, scene.timestep)  # compiles, or loads what an earlier process compiled
    ready = time.perf_counter()
    run(scene, duration)
    done = time.perf_counter()
    trajectory = run(scene, duration, estimate_error=True)
    measures = _measures(scene, trajectory) | {
        "seconds_until_ready": ready - start,
        "seconds_per_simulated_second": (done - ready) / trajectory.end_time,
    }
    trajectory.info.update(start=text, joints=model.joint_names, measures=measures)
    path = _output(args, "simulation")
    trajectory.save(path)
    plotting = time.perf_counter()
    _plot_simulation(scene, trajectory, text, path.with_suffix(".png"))
    measures["seconds_of_plotting"] = time.perf_counter() - plotting
    print("\n".join(_summary(scene, trajectory, duration)))
    print(f"files       {path}.npz, .json, .png")
    return 0 if trajectory.ok else 1


def _is_free(scene) -> bool:
    """Whether nothing but gravity, friction and stops acts: then energy tells how exact the run is."""
    return scene.servos is None and scene.ground is None


def _experiment(scene):
    """What happens, in words, and the function that simulates it: run(scene, duration)."""
    import numpy as np

    from .reference import Reference
    from .run.simulate import initial_state, simulate

    model, state, reference = scene.model, None, None
    home = np.array([min(max(0.0, joint.lower), joint.upper) for joint in model.moving_joints])
    doing = "servos hold all joints at zero" if scene.servos else "all joints limp"
    text = f"{model.name} stands on the ground, {doing}"
    if scene.ground is None:
        q, posture = _start(model, home, PULL if scene.servos else SWING)
        text = f"{model.name} swings freely from rest, {posture}"
        if scene.servos:
            reference, text = Reference([0.0], home[None]), f"{model.name}, {posture}, is pulled to zero by its servos"
        state = initial_state(scene, q)
    sample = max(1, round(SAMPLE / scene.timestep)) * scene.timestep
    record = ["q", "qd", "torque", "energy"]
    record += ["base_q", "base_qd"] if model.base == "floating" else []
    record += ["contact_force"] if scene.ground else []

    def run(scene, duration, **how):
        return simulate(scene, duration, state, reference, record=record, sample=sample, **how)

    return text, run


def _start(model, home, angle: float):
    """Positions at the start: the first joint, if it turns, at `angle` or as far as it goes, the others at home."""
    q, posture = home.copy(), "all joints at zero"
    if model.moving_joints and model.moving_joints[0].type != "prismatic":
        joint = model.moving_joints[0]
        q[0] = min(max(angle, joint.lower), joint.upper)
        posture = f"{joint.name} at {math.degrees(q[0]):.4g} deg, all others at zero"
    return ([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, *q] if model.base == "floating" else q), posture


def _measures(scene, trajectory) -> dict:
    """How exact the run is, and what it shows."""
    import numpy as np

    measures = {"error_estimate": float(trajectory.error["q"].max(initial=0.0))}
    if _is_free(scene):
        drift, kinetic = _drift(scene, trajectory)
        measures |= {"energy_error_J": float(np.abs(drift).max()), "kinetic_energy_J": float(kinetic.max())}
    if scene.servos:
        from .plotting import SUMMED

        spent = trajectory["energy"][-1].sum(axis=0)
        measures["energy_J"] = dict(zip(SUMMED["energy"], map(float, spent)))
    if scene.ground:
        shift = np.linalg.norm(trajectory["base_q"][:, :3] - trajectory["base_q"][0, :3], axis=1)
        weight = scene.model.mass * -scene.constants.gravity[2]
        measures["base_shift_m"] = float(shift.max())
        measures["ground_force_by_weight"] = float(trajectory["contact_force"][-1, :, 0].sum() / weight)
    return measures


def _drift(scene, trajectory):
    """Change of the energy [J] that friction and stops do not explain, and the kinetic energy [J], at each sample."""
    import numpy as np

    from .core.effects.energies import FRICTION, STOPS
    from .dynamics import energy
    from .plotting import positions

    base = [trajectory["base_qd"]] if scene.model.base == "floating" else []
    kinetic, potential = energy(scene.model, positions(trajectory), np.hstack([*base, trajectory["qd"]])).T
    spent = trajectory["energy"].sum(axis=1)
    total = kinetic + potential + spent[:, FRICTION] + spent[:, STOPS]
    return total - total[0], kinetic


def _summary(scene, trajectory, duration: float) -> list[str]:
    m = trajectory.info["measures"]
    lines = [
        f"simulated   {trajectory.info['start']}: {duration:g} s",
        f"status      {trajectory.status}{': ' if trajectory.message else ''}{trajectory.message}",
        f"integrator  {_choice(scene)}",
    ]
    if "energy_error_J" in m:
        share = f", {m['energy_error_J'] / m['kinetic_energy_J']:.1e} of" if m["kinetic_energy_J"] > 0 else ";"
        lines.append(
            f"energy      off by at most {m['energy_error_J']:.1e} J{share} the largest kinetic energy, "
            f"{m['kinetic_energy_J']:.3g} J"
        )
    if "energy_J" in m:
        lines.append("energy      " + ", ".join(f"{k} {v:.3g}" for k, v in m["energy_J"].items()) + " J")
    if "base_shift_m" in m:
        shift, force = 1e3 * m["base_shift_m"], m["ground_force_by_weight"]
        lines.append(f"ground      base moves by at most {shift:.3g} mm; ground carries {force:.4f} of the weight")
    return [
        *lines,
        f"error       of the joints, estimated by {_refinement(scene)}: at most {m['error_estimate']:.1e} rad or m",
        f"time        {1e3 * m['seconds_per_simulated_second']:.2f} ms per simulated second; ready to run after "
        f"{m['seconds_until_ready']:.2f} s, plot {m['seconds_of_plotting']:.2f} s",
    ]


def _plot_simulation(scene, trajectory, text: str, path: Path) -> None:
    """The motion on the left; joints and what tells how good the run is on the right."""
    from matplotlib.figure import Figure

    from .plotting import plot_motion, plot_trajectory

    figure = Figure(figsize=(11.0, 5.5), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 1.2))
    motion = left.subplots()
    plot_motion(scene.model, trajectory, motion, view="xz")
    motion.set_title("dark: start, light: end", fontsize=9)
    if scene.ground:
        motion.axhline(scene.ground.height, color="0.2", linewidth=0.8)
    panels = right.subplots(2, sharex=True)
    if _is_free(scene):
        plot_trajectory(trajectory, ["q"], panels[0])
        drift, kinetic = _drift(scene, trajectory)
        panels[1].plot(trajectory["time"], drift / (kinetic.max() or 1.0), color="0.2", linewidth=1.2)
        panels[1].set(xlabel="time [s]", ylabel="energy error by\nlargest kinetic energy")
        panels[1].grid(alpha=0.3)
    else:
        plot_trajectory(trajectory, ["q", "contact_force" if scene.ground else "torque"], panels)
    panels[0].set(xlabel="", ylabel="joints [rad or m]")
    figure.suptitle(text, fontsize=11)
    figure.savefig(path, dpi=120)


# ---------------------------------------------------------------------------------------------- optimize


def _optimize(args) -> int:
    from .optimize import main_job

    main_job(
        args.robot, servos=args.servos, iterations=args.iterations, seed=args.seed, out=args.out, resume=args.resume
    )
    return 0


# ---------------------------------------------------------------------------------------------- study


def _study(args) -> int:
    from .study import read_study, run_study

    study = read_study(args.file)
    start = time.perf_counter()
    options = {"batch": args.batch, "progress": True, "parquet": args.parquet}
    if args.cluster is None:
        outcome = run_study(study, args.out, **options)
    else:
        with _cluster(args.cluster) as client:
            outcome = run_study(study, args.out, executor=client.get_executor(), **options)
    seconds = time.perf_counter() - start
    print(f"{study.name}: {len(study)} runs, {outcome.computed} of them now in {seconds:.3g} s")
    print("status: " + ", ".join(f"{status} {count}" for status, count in outcome.statuses.items()))
    print(f"files: {outcome.table}, {outcome.picture}")
    return 0


def _cluster(address: str):
    try:
        from distributed import Client
    except ImportError as error:
        raise ValueError('--cluster needs dask: pip install "featherstone-gait[cluster]"') from error
    return Client(address)


# ---------------------------------------------------------------------------------------------- benchmark


def _benchmark(args) -> int:
    import_module(f".benchmark.{args.name}", __package__).run(args.out, full=args.full)
    return 0


# ---------------------------------------------------------------------------------------------- reproduce


def _reproduce(args) -> int:
    from .experiments.report import reproduce

    entries = reproduce(args.names, args.out, full=args.full, seed=args.seed, progress=True)
    for entry in entries:
        print(entry.name + (f": failed: {entry.failure}" if entry.failure else ""))
        for claim in entry.claims:
            print(f"  {claim.verdict:23} {claim.claim}")
    print(f"files: {args.out / 'reproduction.html'}, {args.out / 'reproduction.md'}")
    return 1 if any(entry.failure for entry in entries) else 0
