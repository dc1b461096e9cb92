"""Wrong arguments and damaged files, drawn at random: faults are what is not refused with a message that names it."""

from __future__ import annotations

from pathlib import Path

from . import attack_api, attack_files
from .machine import machine
from .table import write_table

SEED = 1
FEW, MANY = 300, 20_000  # damaged files of each kind, and wrong arguments


def run(out_dir: Path, full: bool = False) -> list[tuple]:
    """Print the faults of both halves; write attack_files.csv and attack_api.csv; `full`: 20 000 of each kind."""
    count, host = MANY if full else FEW, machine()
    faults: list[tuple] = []
    print(f"{host}\nseed {SEED}, {count} damaged files of each kind, {count} calls with wrong arguments")
    for name, module in (("attack_files", attack_files), ("attack_api", attack_api)):
        rows = getattr(module, name)(count, SEED)
        faults += rows
        print(f"\n{name}: {len(rows)} faults")
        for cells in rows:
            print(": ".join(map(str, cells)))
        write_table(Path(out_dir) / f"{name}.csv", module.Row._fields, rows, f"{host}\nseed {SEED}, {count} attacks")
    return faults
