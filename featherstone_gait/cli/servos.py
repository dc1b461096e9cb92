"""List servos, or compare some with their manuals: stall, no-load speed and efficiency.

Writes nothing but the picture of --plot.

  featherstone-gait servos
  featherstone-gait servos ax12 ax12a --plot curves.png
  featherstone-gait servos my_servo.toml --voltage 11.1
"""

from __future__ import annotations

import math
from argparse import Namespace
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from ..base.files import complete
from .arguments import LINE, Commands, add_command
from .info import table

if TYPE_CHECKING:
    from ..identification.curve import TorqueSpeed
    from ..model import Servo
    from ..robot_file.servos import ManualPoint, ServoSheet

FIGURES = {  # of a curve and of a manual: digits, and the unit
    "stall_torque": ("stall torque [N m]", 4),
    "stall_current": ("stall current [A]", 4),
    "no_load_speed": ("no-load speed [rad/s]", 4),
    "no_load_current": ("no-load current [A]", 3),
}


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    names = "name of a servo of the package, or a .toml file (default: list all of the package)"
    parser.add_argument("names", nargs="*", metavar="NAME", help=names)
    voltage = "supply voltage [V] (default: each servo's own, and those of its manual)"
    parser.option("--voltage", voltage, type=float, metavar="V")
    parser.option("--plot", "draw torque, current and efficiency against speed", type=Path, metavar="FILE.png")


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..robot_file.servos import servo_names, servo_sheet

    names, known = args.names or servo_names(), servo_names()
    for name in names:
        if name not in known and not name.endswith(".toml"):
            raise ValueError(f"there is no servo {name!r}; the package has {', '.join(known)}; or give a .toml file")
    sheets = {name: servo_sheet(name) for name in names}
    lines = [line for name in names for line in _shown(name, sheets[name], args.voltage)] if args.names else None
    print("\n".join(lines or _listed(sheets, args.voltage)).strip())
    if args.plot:
        path = args.out / args.plot
        _plot(sheets, args.voltage, path)
        print(f"files: {path}")
    return 0


def _servo(name: str) -> Servo:
    from ..robot_file import gearbox_presets, load_servo

    presets = gearbox_presets(name)  # any will do, the curve does not depend on it
    chosen = {"gearbox": next(iter(presets))} if presets and "physical" not in presets else {}
    return load_servo(name, **chosen)


def _curve(name: str, voltage: float | None) -> TorqueSpeed:
    from ..identification.curve import torque_speed

    return torque_speed(_servo(name), voltage)


def _gear(name: str) -> str:
    from ..scene.actuator import is_elastic

    return "elastic" if is_elastic(_servo(name)) else "rigid"


def _listed(sheets: dict[str, ServoSheet], voltage: float | None) -> list[str]:
    """Format one line for each servo."""
    figures = "at [V]", "stall [N m]", "no load [rad/s]", "best [%]"
    head = ("servo", "product", *figures, "gear", "numbers from", "quality")
    rows = []
    for name, sheet in sheets.items():
        c = _curve(name, voltage)
        cells = [f"{x:.3g}" for x in (c.voltage, c.stall_torque, c.no_load_speed, 100.0 * c.peak_efficiency)]
        product, source, quality = (text or "see its file" for text in (sheet.product, sheet.source, sheet.quality))
        rows.append((name, product, *cells, _gear(name), source, quality))
    return table(head, rows)


def _shown(name: str, sheet: ServoSheet, voltage: float | None) -> list[str]:
    """Format a servo's figures at its voltage and at those of its manual, or at the voltage given."""
    texts = {"product": sheet.product, "gear": _gear(name), "numbers": sheet.source, "quality": sheet.quality}
    texts["manual"] = sheet.manual_source
    lines = ["", name]
    for what, text in texts.items():
        lines += [fill(f"  {what:8} {text}", LINE, subsequent_indent=" " * 11, break_long_words=False)] if text else []
    points = {point.voltage: point for point in sheet.manual}
    voltages = [_curve(name, voltage).voltage, *(() if voltage is not None else points)]
    rows = []
    for V in dict.fromkeys(voltages):
        curve = _curve(name, V)
        best = f"{1e2 * curve.peak_efficiency:.1f}"
        rows.append((f"{V:.4g} V simulated", *_cells(curve), best))
        if V in points:
            rows.append((f"{V:.4g} V manual", *_cells(points[V]), "-"))
            rows.append((f"{V:.4g} V ratio", *_ratios(curve, points[V]), "-"))
    head = ("", *(label for label, _ in FIGURES.values()), "peak efficiency [%]")
    return [*lines, *table(head, rows)]


def _cells(figures: TorqueSpeed | ManualPoint) -> list[str]:
    values = [(getattr(figures, name), digits) for name, (_, digits) in FIGURES.items()]
    return [f"{value:.{digits}g}" if math.isfinite(value) else "-" for value, digits in values]


def _ratios(curve: TorqueSpeed, point: ManualPoint) -> list[str]:
    """Divide simulated figures by those of the manual."""
    ratios = [getattr(curve, name) / getattr(point, name) for name in FIGURES]
    return [f"{ratio:.3f}" if math.isfinite(ratio) else "-" for ratio in ratios]


def _plot(sheets: dict[str, ServoSheet], voltage: float | None, path: Path) -> None:
    """Plot each servo at the voltage given, or at that of its manual nearest to its own."""
    from ..identification.curve import plot_curves

    curves, points = {}, {}
    for name, sheet in sheets.items():
        own = _curve(name, voltage).voltage
        near = [own] if voltage is not None or not sheet.manual else [point.voltage for point in sheet.manual]
        V = min(near, key=lambda v: abs(v - own))
        label = f"{Path(name).stem}, {V:.4g} V"
        curves[label], points[label] = _curve(name, V), sheet.manual
    with complete(path) as file:
        plot_curves(curves, points).savefig(file, format="png", dpi=110)
