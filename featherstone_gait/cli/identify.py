"""`featherstone-gait identify`: a servo's parameters from recordings of a real one."""

from __future__ import annotations

from argparse import Namespace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

from .arguments import Commands, add_command, announce

if TYPE_CHECKING:
    from ..identification.bench import Bench, BenchRecording, ServoFit
    from ..identification.log import FitLog

FRICTIONS = ("m1", "m2", "m3", "m4", "m4p", "m5", "m6")
SERVOS = ("xl330", "sts3250")
GROUPS = ("gain", "motion")
TAKES = (
    "half a minute for twelve recordings of 6 s; with --leave-out that again for each group, with --effects for each "
    "of 13 models; Ctrl-C keeps finished rounds"
)


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(
        commands,
        "identify",
        run,
        "fit a servo with a friction model to recordings on a pendulum, or continue a fit that was interrupted",
        "identify.csv (parameters), identify_errors.csv (error of each recording), identify.png (angles and errors), "
        "identify.jsonl (finished rounds, to continue from); with --effects only identify_effects.csv",
        examples=(
            "cd robots/servos/recordings",
            "featherstone-gait identify xl330_*.csv --servo xl330 --out results",
            "featherstone-gait identify xl330_*.csv --servo xl330 --leave-out gain",
        ),
        takes=TAKES,
    )
    columns = "recording with the columns time_s, angle_rad, goal_rad, supply_v and torque_on; see "
    columns += "help(featherstone_gait.identification.bench)"
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE.csv", help=columns)
    parser.add_argument(
        "--servo",
        choices=SERVOS,
        required=True,
        help="servo whose firmware and bench are simulated, and whose parameters the fit starts from",
    )
    what = "friction model (default: m4p, which is M4 with the product of the loads)"
    parser.add_argument("--model", choices=FRICTIONS, default="m4p", help=what)
    parser.add_argument("--mass", type=float, metavar="KG", help="mass of the weight (default: the bench's)")
    parser.add_argument("--length", type=float, metavar="M", help="length of the rod (default: the bench's)")
    parser.add_argument(
        "--gain", type=float, metavar="KP", help="gain of the firmware (default: from file names with _kpNNN_)"
    )
    parser.add_argument(
        "--leave-out", choices=GROUPS, help="cross-validate: fit without each gain or motion in turn, and predict it"
    )
    what = "measure what each effect of the model contributes, by the error on each gain (or motion, see --leave-out) "
    what += "that is left out of the fit"
    parser.add_argument("--effects", action="store_true", help=what)
    parser.add_argument(
        "--predict", type=Path, nargs="+", default=[], metavar="FILE.csv", help="recordings to predict, not to fit"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="name of the picture (default: identify.png)")


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..identification.bench import BENCHES, read_bench
    from ..identification.log import FitLog

    bench = BENCHES[args.servo]
    own = {"gain": args.gain, "mass": args.mass, "length": args.length}
    recordings, others = ([read_bench(path, bench, **own) for path in paths] for paths in (args.files, args.predict))
    announce(TAKES)
    with FitLog(args.out / "identify.jsonl") as log:
        return (_effects if args.effects else _fit)(args, bench, recordings, others, log)


def _fit(
    args: Namespace, bench: Bench, recordings: list[BenchRecording], others: list[BenchRecording], log: FitLog
) -> int:
    import numpy as np

    from ..base.files import complete
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
    _write(args.out, fit, rows)
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


def _write(folder: Path, fit: ServoFit, rows: list[tuple[str, str, float]]) -> None:
    """Write the tables, whole or not at all."""
    from ..base.files import Format, write_csv

    form = Format("servo identification")
    units = fit.bench.parameters()
    found = [(name, value, *fit.intervals[name], units[name].unit) for name, value in fit.values.items()]
    notes = f"{fit.bench.name}, friction {fit.friction}"
    write_csv(folder / "identify.csv", form, ("parameter", "value", "low", "high", "unit"), found, notes)
    columns = ("recording", "how", "mean absolute error [mrad]")
    write_csv(folder / "identify_errors.csv", form, columns, rows, notes)
