"""Fit a servo with a friction model to recordings on a pendulum, or continue a fit that was interrupted.

Writes identify.csv (parameters), identify_errors.csv (error of each recording), identify.png (angles and errors),
identify.jsonl (finished rounds, to continue from); with --effects only identify_effects.csv.

Takes half a minute for twelve recordings of 6 s; with --leave-out that again for each group, with --effects for each of
13 models; Ctrl-C keeps finished rounds.

  cd robots/servos/recordings
  featherstone-gait identify xl330_*.csv --servo xl330 --out results
  featherstone-gait identify xl330_*.csv --servo xl330 --leave-out gain
"""

from __future__ import annotations

from argparse import Namespace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

from .arguments import Commands, add_command, add_quiet, announce

if TYPE_CHECKING:
    from ..identification.bench import Bench, BenchRecording
    from ..identification.log import FitLog

FRICTIONS = ("m1", "m2", "m3", "m4", "m4p", "m5", "m6")
SERVOS = ("xl330", "sts3250")
TAKES = "half a minute for twelve recordings of 6 s, and as long for each further fit"


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    columns = "recording with the columns time_s, angle_rad, goal_rad, supply_v and torque_on; see "
    columns += "help(featherstone_gait.identification.bench)"
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE.csv", help=columns)
    servo = "servo whose firmware and bench are simulated, and whose parameters the fit starts from"
    parser.option("--servo", servo, choices=SERVOS, required=True)
    friction = "friction model (default: m4p, which is M4 with the product of the loads)"
    parser.option("--model", friction, "m4p", choices=FRICTIONS)
    parser.option("--mass", "mass of the weight (default: the bench's)", type=float, metavar="KG")
    parser.option("--length", "length of the rod (default: the bench's)", type=float, metavar="M")
    gain = "gain of the firmware (default: from file names with _kpNNN_)"
    parser.option("--gain", gain, type=float, metavar="KP")
    left_out = "cross-validate: fit without each gain or motion in turn, and predict it"
    parser.option("--leave-out", left_out, choices=("gain", "motion"))
    effects = "measure what each effect of the model contributes, by the error on each gain (or motion, see "
    effects += "--leave-out) that is left out of the fit"
    parser.option("--effects", effects, False)
    others = "recordings to predict, not to fit"
    parser.option("--predict", others, [], type=Path, nargs="+", metavar="FILE.csv")
    parser.option("--plot", "name of the picture (default: identify.png)", type=Path, metavar="FILE.png")
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..identification.bench import BENCHES, read_bench
    from ..identification.log import FitLog

    bench = BENCHES[args.servo]
    own = {"gain": args.gain, "mass": args.mass, "length": args.length}
    recordings, others = ([read_bench(path, bench, **own) for path in paths] for paths in (args.files, args.predict))
    announce(args, TAKES)
    with FitLog(args.out / "identify.jsonl") as log:
        return (_effects if args.effects else _fit)(args, bench, recordings, others, log)


def _fit(
    args: Namespace, bench: Bench, recordings: list[BenchRecording], others: list[BenchRecording], log: FitLog
) -> int:
    import numpy as np

    from ..base.files import Format, complete, write_csv
    from ..identification.bench import fit_servo, leave_out, plot_rollouts

    fit = fit_servo(recordings, bench, args.model, log=log, progress=True)
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
        held = leave_out(recordings, bench, args.model, by, log=log, progress=True)
        for group, (_, _, errors) in held.items():
            print(f"left out, {args.leave_out} {group}: {1e3 * errors.mean():.1f} mrad")
            names = [r.name for r in recordings if by(r) == group]
            rows += [(name, "left out", 1e3 * e) for name, e in zip(names, errors)]
        print(f"left out, mean: {1e3 * np.mean([errors.mean() for _, _, errors in held.values()]):.1f} mrad")
    form, notes, units = Format("servo identification"), f"{bench.name}, friction {fit.friction}", fit.units
    found = [(name, value, *fit.intervals[name], units[name]) for name, value in fit.values.items()]
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
