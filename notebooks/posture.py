"""Hold the complete humanoid in the posture of Table 3, in this package and in the paper's kind of program."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from setups import scale_masses

from featherstone_gait import (
    Ground,
    Reference,
    compile_scene,
    initial_state,
    load_robot,
    simulate_batch,
    standing_state,
)
from featherstone_gait.identification import changed
from featherstone_gait.model import Base
from featherstone_gait.reproduction.maximal import Engine, simulate_seeds
from featherstone_gait.run.trajectory import Trajectory

# Joint -> reference, and the paper's largest angle, smallest angle and standard deviation with each model [deg].  The
# joints of robots/humanoid have the names and signs of the paper's table.
TABLE_3 = {
    "left_lateral_shoulder": (-45.0, {"standard": (-45.06, -47.21, 0.39), "mipsd": (-44.96, -45.04, 0.01)}),
    "right_front_shoulder": (25.0, {"standard": (25.00, 24.13, 0.16), "mipsd": (25.04, 24.97, 0.01)}),
    "right_lateral_shoulder": (25.0, {"standard": (26.60, 24.15, 0.50), "mipsd": (25.03, 24.96, 0.01)}),
    "left_elbow": (45.0, {"standard": (48.40, 44.19, 0.84), "mipsd": (45.05, 44.95, 0.01)}),
}
# The paper gives no masses.  Its authors' scenes (P33a/SimTwo) have two humanoids: bioloid2.xml, which robots/humanoid
# is, of 2.423 kg, and Bioloid.xml of 1.957 kg.  All links are scaled to the second's mass, or the arms get its masses.
MASSES: dict[str, dict[str, float]] = {
    "bioloid2.xml": {},
    "mass of Bioloid.xml": {"": 1.957 / 2.423},
    "arms of Bioloid.xml": {"forearm": 0.082 / 0.102, "shoulder_block": 0.012 / 0.082},
}
LAWS = {"P": math.inf, "PI": 1.0}  # integral time Kp / Ki [s]; a standing robot with a third of it sways until it falls
STORED = Path(__file__).parents[1] / "docs" / "reproduction" / "measured_posture.csv"
NUMBERS = ("left_lateral_deg", "right_front_deg", "right_lateral_deg", "elbow_deg", "off_deg")  # columns of this file


def hold(
    gearbox: str,
    program: str = "simtwo",
    *,
    step: float = 1e-3,
    base: Base = "floating",
    law: str = "PI",
    mass: str = "bioloid2.xml",
    sweeps: int = 10,
    runs: int = 8,
    duration: float = 20.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Hold the humanoid.

    Parameters
    ----------
    gearbox : str
        "standard" or "mipsd".
    program : str
        An integrator of this package, in which the starts of the runs differ by 0.1 deg in each joint; or "bodies", the
        paper's kind of program, in which their seeds do.
    step : float
        [s]
    base : str
        "floating": the robot stands; "fixed": its trunk is held.
    law, mass : str
        Keys of `LAWS` and `MASSES`.
    sweeps : int
        Of the program of bodies; 0: each step is solved.
    runs : int
        Number of starts or of seeds.
    duration : float
        [s]

    Returns
    -------
    time : ndarray, shape (samples,)
        Of the second half [s].
    angles : ndarray, shape (runs, samples, 4)
        Of the joints of `TABLE_3` [deg]; NaN in runs that fell.
    """
    model = load_robot("humanoid", base)
    times = [[factor for end, factor in MASSES[mass].items() if link.name.endswith(end)] for link in model.links]
    model = scale_masses(model, [math.prod(factors) for factors in times])
    model = changed(model, Ki=next(iter(model.servos.values())).controller.Kp / LAWS[law])
    stands, bodies = base == "floating", program == "bodies"
    scene = compile_scene(model, gearbox, Ground() if stands else None, "simtwo" if bodies else program, step)
    places, pose = [model.joint_names.index(name) for name in TABLE_3], np.zeros(len(model.joint_names))
    pose[places] = np.radians([angle for angle, _ in TABLE_3.values()])
    start, reference = standing_state if stands else initial_state, Reference([0.0], [pose])
    how = {"record": ("q",), "record_interval": max(step, 1e-3)}
    done: Sequence[Trajectory]
    if bodies:
        engine = Engine(iterations=sweeps)
        done = simulate_seeds(scene, duration, start(scene, pose), reference, seeds=range(runs), engine=engine, **how)
    else:
        off = np.radians(0.1) * np.random.default_rng(0).standard_normal((runs, len(pose)))
        states = [start(scene, pose + one) for one in off]
        done = simulate_batch(scene, duration, states, [reference] * runs, estimate_error=False, **how)
    late = done[0]["time"] >= 0.5 * duration
    angles = np.degrees([run["q"][late][:, places] for run in done])
    angles[[run.end_time < duration - 1e-6 for run in done]] = np.nan
    return done[0]["time"][late], angles


def measured(angles: np.ndarray) -> np.ndarray:
    """Return the joints' deviations, median over the runs, and last how far one is off (5,) [deg].

    angles: as `hold` returns them.  All are NaN if the robot falls in every run.
    """
    stands = angles[np.isfinite(angles).all(axis=(1, 2))]
    if not len(stands):
        return np.full(len(NUMBERS), np.nan)
    off = stands - [angle for angle, _ in TABLE_3.values()]
    return np.append(np.median(stands.std(axis=1), axis=0), abs(off).max())


def stored(gearbox: str) -> dict[str, np.ndarray]:
    """Return what was `measured` in the program of bodies, by case; `python docs/measure.py posture` makes the file."""
    with STORED.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(line for line in file if line[0] != "#") if row["gearbox"] == gearbox]
    return {
        f"bodies, {row['sweeps']} sweeps, {case(float(row['step_s']), row['base'], row['law'], row['mass'])}": np.array(
            [float(row[name] or "nan") for name in NUMBERS]
        )
        for row in rows
    }


def case(step: float, base: str, law: str, mass: str) -> str:
    """Name what the paper leaves out."""
    stands = "standing" if base == "floating" else "trunk fixed"
    return f"{1e3 * step:g} ms, {stands}, {law}, {mass}"
