"""Fit the parameters of a servo to recordings of it swinging a weight, or continue a fit that was interrupted.

A recording is a CSV file with the columns time [s], reference [rad] and angle [rad], or in ms and deg.  Those of an
xl330 or sts3250 on a bench like Rhoban's, with the columns time_s, angle_rad, goal_rad, supply_v and torque_on, are
fitted with friction that grows with the load.

Writes identify.csv (parameters), identify_errors.csv (error of each recording), identify.png (angles and errors), and
of a bench identify.jsonl (finished rounds, to continue from); with --effects only identify_effects.csv.

Takes half a minute for twelve recordings of 6 s; with --leave-out that again for each group, with --effects for each of
13 models; Ctrl-C keeps finished rounds of a bench.

  cd robots/servos/recordings
  featherstone-gait identify xl330_*.csv --servo xl330 --out results
  featherstone-gait identify xl330_*.csv --servo xl330 --leave-out gain
  featherstone-gait identify xl330_kp200_sin_sin.csv --servo xl330 --fit Kp
"""

from __future__ import annotations

from argparse import ArgumentTypeError, Namespace
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

from ..scene.gearbox_kinds import GEARBOX_KINDS
from .arguments import OWN_GEARBOX, Commands, add_command, add_quiet, announce, gearbox_line

if TYPE_CHECKING:
    from ..identification.bench import Bench, BenchRecording
    from ..identification.estimate import Fit
    from ..identification.log import FitLog
    from ..model import Model

FRICTIONS = ("m1", "m2", "m3", "m4", "m4p", "m5", "m6")
FITTED = ("motor_constant", "viscous_friction", "coulomb_friction", "rotor_inertia")  # by default, where they are not 0
FITTED_LAW = ("Kp", "Kd", "viscous_friction", "coulomb_friction")  # the same of a servo without a motor
TAKES = "half a minute for twelve recordings of 6 s, and as long for each further fit"


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    files = "recording; FILE.csv:Kp=61 states parameters of the servo in this recording alone, separated by commas"
    parser.add_argument("files", type=_recording, nargs="+", metavar="FILE.csv", help=files)
    servo = "servo from whose parameters the fit starts: a name that `featherstone-gait servos` lists, or a .toml file"
    parser.option("--servo", servo, metavar="NAME")
    load = "robot with one joint that carries the load, in place of --mass and --length; its servo is the default"
    parser.option("--robot", load, metavar="ROBOT")
    parser.option(
        "--mass", "mass of the weight; it hangs down at zero (default: the bench's)", type=float, metavar="KG"
    )
    parser.option("--length", "length of the rod to its center (default: the bench's)", type=float, metavar="M")
    names = f"parameters to fit (default: {', '.join(FITTED)}, where they are not 0; without a motor "
    names += f"{', '.join(FITTED_LAW)})"
    parser.option("--fit", names, nargs="+", metavar="NAME")
    parser.option("--gearbox", f"gearbox model (default: {OWN_GEARBOX})", choices=GEARBOX_KINDS)
    friction = "friction model of a bench (default: m4p, which is M4 with the product of the loads)"
    parser.option("--model", friction, choices=FRICTIONS)
    gain = "gain of the firmware on a bench (default: from file names with _kpNNN_)"
    parser.option("--gain", gain, type=float, metavar="KP")
    left_out = "cross-validate a bench: fit without each gain or motion in turn, and predict it"
    parser.option("--leave-out", left_out, choices=("gain", "motion"))
    effects = "of a bench, measure what each effect of the model contributes, by the error on each gain (or motion, "
    effects += "see --leave-out) that is left out of the fit"
    parser.option("--effects", effects, False)
    others = "recordings to predict, not to fit"
    parser.option("--predict", others, [], type=_recording, nargs="+", metavar="FILE.csv")
    parser.option("--plot", "name of the picture (default: identify.png)", type=Path, metavar="FILE.png")
    add_quiet(parser)


def _recording(text: str) -> tuple[Path, dict[str, float]]:
    """Split FILE.csv:NAME=VALUE,... into a path and the parameters of the servo in this recording."""
    path, _, given = text.rpartition(":")
    if "=" not in given:
        return Path(text), {}
    settings = {}
    for part in given.split(","):
        name, _, value = part.partition("=")
        try:
            settings[name.strip()] = float(value)
        except ValueError:
            raise ArgumentTypeError(f"{part!r} of {text!r} is no NAME=NUMBER, as in {path}:Kp=61") from None
    return Path(path), settings


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..identification.bench import BENCHES, is_bench_recording, read_bench
    from ..identification.log import FitLog

    bench = BENCHES.get(args.servo)
    files = [*args.files, *args.predict]
    on_bench = all([is_bench_recording(path) and not settings for path, settings in files])
    if bench is None or not on_bench or any((args.robot, args.fit, args.gearbox)):
        return _fit_any(args)
    own = {"gain": args.gain, "mass": args.mass, "length": args.length}
    recordings, others = ([read_bench(path, bench, **own) for path, _ in of] for of in (args.files, args.predict))
    announce(args, TAKES)
    with FitLog(args.out / "identify.jsonl") as log:
        return (_effects if args.effects else _fit)(args, bench, recordings, others, log)


def _fit_any(args: Namespace) -> int:
    """Fit any servo to recordings of any source."""
    from ..identification import identify, predict, read_recording
    from ..scene.actuator import servo_gearbox

    flags = ("--model", "--gain", "--leave-out", "--effects")
    given = [flag for flag in flags if getattr(args, flag[2:].replace("-", "_"))]
    if given:
        raise ValueError(
            f"{', '.join(given)}: only recordings of an xl330 or sts3250 on a bench, with the columns time_s, "
            "angle_rad, goal_rad, supply_v and torque_on, have these; omit them"
        )
    model = _swinging(args)
    servo = model.servos[model.joint_names[0]] if len(model.joint_names) == 1 and model.servos else None
    usual = FITTED_LAW if servo is not None and not servo.motor_constant else FITTED
    parts = () if servo is None else (servo, servo.controller, servo.gearbox)
    fitted = args.fit or [name for name in usual if any(getattr(part, name, 0.0) for part in parts)]
    recordings, others = ([read_recording(path, **own) for path, own in of] for of in (args.files, args.predict))
    kind = servo_gearbox(model, args.gearbox)
    announce(args, TAKES)
    fit = identify(model, recordings, fitted, kind, progress=True)
    if args.gearbox is None:
        print(gearbox_line(kind))
    print(fit.summary())
    rows = [(r.name, "fitted", 1e3 * e) for r, e in zip(fit.recordings, fit.errors)]
    shown = list(zip(fit.recordings, fit.angles))
    for r, (angle, _) in zip(others, predict(fit.model, others, gearbox=kind) if others else ()):
        shown.append((r, angle))
        rows.append((r.name, "predicted", 1e3 * abs(angle - r.angle).mean()))
        print(f"predicted, {r.name}: {rows[-1][2]:.1f} mrad")
    print("in TOML     " + ", ".join(f"{name} = {value:.6g}" for name, value in fit.values.items()))
    return _write(args, fit, rows, shown, f"{args.servo or args.robot}, gearbox {kind}")


def _swinging(args: Namespace) -> Model:
    """Return the robot whose servo is recorded."""
    from ..base.arguments import real
    from ..identification.bench import BENCHES
    from ..identification.bench_rollouts import pendulum
    from ..robot_file import load_robot, load_servo
    from ..robot_file.servos import without_actuators

    if args.robot is not None:
        if args.mass is not None or args.length is not None:
            raise ValueError(f"{args.robot} has its own load; omit --mass and --length, or --robot")
        model = load_robot(args.robot)
        if args.servo is None:
            return model
        servos = dict.fromkeys(model.joint_names, load_servo(args.servo))
        return replace(without_actuators(model, servos), servos=servos)
    if args.servo is None:
        raise ValueError("the servo is missing; name it (--servo), or a robot that has it (--robot)")
    servo, bench = load_servo(args.servo), BENCHES.get(args.servo)
    mass = args.mass if bench is None or args.mass is not None else bench.mass
    length = args.length if bench is None or args.length is not None else bench.length
    if mass is None or length is None:
        raise ValueError(f"{args.servo}: the load is missing; give --mass [kg] and --length [m], or --robot")
    mass, length = real("--mass", mass, 1e-6, 1e3, "give kg"), real("--length", length, 1e-4, 10.0, "give meters")
    return pendulum(f"{Path(args.servo).stem}_pendulum", servo, mass, length)


def _fit(
    args: Namespace, bench: Bench, recordings: list[BenchRecording], others: list[BenchRecording], log: FitLog
) -> int:
    import numpy as np

    from ..identification.bench import fit_servo, leave_out

    friction = args.model or "m4p"
    fit = fit_servo(recordings, bench, friction, log=log, progress=True)
    print(fit.summary())
    print(f"{fit.seconds:.0f} s; {fit.message}")
    rows = [(r.name, "fitted", 1e3 * e) for r, e in zip(fit.recordings, fit.errors)]
    shown = list(zip(fit.recordings, fit.angles))
    if others:
        angles = fit.predict(others)
        shown += zip(others, angles)
        rows += [(r.name, "predicted", 1e3 * np.abs(a - r.angle).mean()) for r, a in zip(others, angles)]
        print(f"predicted: {np.mean([error for _, how, error in rows if how == 'predicted']):.1f} mrad")
    if args.leave_out:
        by = attrgetter(args.leave_out)
        held = leave_out(recordings, bench, friction, by, log=log, progress=True)
        for group, (_, _, errors) in held.items():
            print(f"left out, {args.leave_out} {group}: {1e3 * errors.mean():.1f} mrad")
            names = [r.name for r in recordings if by(r) == group]
            rows += [(name, "left out", 1e3 * e) for name, e in zip(names, errors)]
        print(f"left out, mean: {1e3 * np.mean([errors.mean() for _, _, errors in held.values()]):.1f} mrad")
    return _write(args, fit, rows, shown, f"{bench.name}, friction {fit.friction}")


def _write(args: Namespace, fit: Fit, rows: list[tuple], shown: list[tuple], notes: str) -> int:
    """Write parameters, errors and a picture of recordings and angles; return the exit code."""
    from ..base.files import Format, complete, write_csv
    from ..identification.estimate import plot_rollouts

    form = Format("servo identification")
    found = [(name, value, *fit.intervals[name], fit.units[name]) for name, value in fit.values.items()]
    write_csv(args.out / "identify.csv", form, ("parameter", "value", "low", "high", "unit"), found, notes)
    columns = ("recording", "how", "mean absolute error [mrad]")
    write_csv(args.out / "identify_errors.csv", form, columns, rows, notes)
    picture = args.plot or args.out / "identify.png"
    with complete(picture) as path:
        plot_rollouts(*zip(*shown)).savefig(path, format="png", dpi=110)
    print(f"files: {args.out / 'identify.csv'}, {args.out / 'identify_errors.csv'}, {picture}")
    return 0


def _effects(
    args: Namespace, bench: Bench, recordings: list[BenchRecording], others: list[BenchRecording], log: FitLog
) -> int:
    from ..base.files import Format, write_csv
    from ..identification.effects import effects

    if others:
        raise ValueError("--effects predicts what it leaves out of the fit; omit --predict")
    gains = {r.gain for r in recordings}
    by = args.leave_out or ("gain" if len(gains) > 1 else "motion")
    rows = []
    for row in effects(recordings, bench, attrgetter(by), log=log, progress=True):
        print(row.line(), flush=True)
        errors = [1e3 * error for error in (row.fitted, row.mean, *row.left_out.values())]
        rows.append((row.effect.name, *errors, row.seconds))
        groups = [f"left out, {by} {group} [mrad]" for group in row.left_out]
    columns = ("model", "fitted [mrad]", "left out, mean [mrad]", *groups, "time of the fit [s]")
    path = args.out / "identify_effects.csv"
    write_csv(path, Format("effects of a servo"), columns, rows, f"{bench.name}, left out by {by}")
    print(f"files: {path}")
    return 0
