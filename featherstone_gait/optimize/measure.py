"""Measurement of the first and the optimized gait: quality, test worlds, MuJoCo, baselines, standby power."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import OptimizeResult

from ..base.files import FilePath, parse_json
from ..crosscheck import crosscheck, motion_of, verdict
from ..crosscheck.run import files as crosscheck_files
from ..model import Model
from ..robot_file import load_servo
from ..robot_file.servos import servo_names
from ..scene.actuator import usual_gearbox
from ..walking.cost import WalkingCost
from ..walking.feedback import BalancedWalk
from ..walking.walker import GENERIC
from .baselines import Stored, measure_baselines, stored_baselines
from .feedback import report_feedback
from .gait_page import least_so_far, parts_of
from .planning import Start
from .preparation import Job
from .quality import Quality, measure_in_test_worlds, measure_limits, measure_quality, with_standby
from .selection import Selected

SPEED_TOLERANCE = 0.05  # by how much speeds may differ that are called equal [-]
STANDBY = 0.05  # current of a servo's electronics, of an AX-12 [A]


def measure(job: Job, start: Start, result: OptimizeResult, found: Selected) -> dict[str, Any]:
    """Measure both gaits for the report; after an interrupted search on the robot's own ground alone."""
    options, cost = job.options, start.cost
    if result.status == 2:
        options = replace(options, test_worlds=0, crosscheck=0, baselines=False)
    gaits = {"before": cost.gait.to_vector(), "after": found.x}
    quality = {side: measure_quality(cost, x) for side, x in gaits.items()}
    limits = {side: measure_limits(cost, x, start.watch) for side, x in gaits.items()}
    stored = stored_baselines(quality["before"].measures) if job.robot == "humanoid" else {}
    worlds = _in_test_worlds(cost, stored, found.walk or found.x, options.test_worlds, options.progress)
    checked, path = (
        _walk_in_mujoco(job, cost, found) if options.crosscheck else None,
        crosscheck_files(job.crosscheck)[0],
    )
    floors = parse_json(path.read_bytes(), str(path), "delete it")["floors"] if checked and path.exists() else []
    cheapest = start.plan != "cheapest" and options.baselines and options.worlds > 0
    baselines = measure_baselines(cost, start.plan, options.test_worlds, options.progress, cheapest, stored)
    if worlds:
        baselines[0]["elsewhere"] = worlds[0]
    return {
        **{side: one.as_dict() for side, one in quality.items()},
        "elsewhere": worlds and dict(zip(gaits, worlds)),
        **({} if options.servo is None else {"with_own_servos": measure_with_own_servos(job.own, cost)}),
        "feedback": found.walk and report_feedback(cost, found.walk, options.worlds),
        "crosscheck": checked,
        "crosscheck_floors": [  # [J/m]; None where the gait falls
            {"floor": row["floor"], "soles": row["soles"], "mujoco": row["mujoco"]["cost"], "own": row["own"]["cost"]}
            for row in floors
        ],
        "plausible": limits | {"servo": _servo_limits(job.model), "not_watched": start.watch.close()},
        "standby": standby_costs(job, quality),
        "baselines": baselines,
        "at_equal_speed": _at_equal_speed(cost, result, baselines),
    }


def _in_test_worlds(
    cost: WalkingCost, stored: Stored, gait: np.ndarray | BalancedWalk, count: int, progress: bool
) -> list[dict[str, Any]] | None:
    """Walk the first gait, unless that is stored, and the optimized one in test worlds; return None for none."""
    if not count:
        return None
    known = next(iter(stored.values()), None)
    before = [] if known is None or known["elsewhere"]["worlds"] != count else [known["elsewhere"]]
    gaits = [gait] if before else [cost.gait.to_vector(), gait]
    return before + measure_in_test_worlds(cost, gaits, count, progress)


def measure_with_own_servos(own: Model, cost: WalkingCost) -> dict:
    """Measure the first gait of `cost` with the robot's own servos."""
    if not own.servos:
        return {"servo": "none", "status": "it has none"}
    gearbox = usual_gearbox(own) if cost.scene.gearbox == "mipsd" else cost.scene.gearbox  # its gears may be rigid
    with_own = replace(cost, scene=cost.scene.recompiled(own, gearbox=gearbox))
    return {"servo": servo_name(own)} | with_own.measure([cost.gait.to_vector()])[0].as_dict()


def servo_name(model: Model) -> str:
    """Name a robot's servos, as far as they come with the package."""
    known = {load_servo(name): name for name in servo_names()}
    return ", ".join(dict.fromkeys(known.get(servo, "as in its file") for servo in model.servos.values()))


def servo_in_file(servo: FilePath | None) -> str:
    """Return the servo as a gait's file names it: a name, the absolute path of a file, "" for the robot's own."""
    if servo is None or str(servo).startswith(GENERIC) or str(servo) in servo_names():
        return str(servo or "")
    return str(Path(servo).resolve())


def standby_costs(job: Job, quality: Mapping[str, Quality]) -> dict[str, Any]:
    """Compute the power drawn all the time [W] and the energy per distance with it [J/m].

    By default the electronics of each servo take `STANDBY` amperes, and locked servos no more than that.
    """
    own, electronics = job.own, job.options.electronics_power
    moving = {joint.name for joint in own.moving_joints}
    watts = {"walking": 0.0, "locked": 0.0}
    for name, servo in own.servos.items():
        if servo.voltage_limit < math.inf:
            watts["walking" if name in moving else "locked"] += STANDBY * servo.voltage_limit
    if electronics is not None:
        share = sum(name in moving for name in own.servos) / max(len(own.servos), 1)
        watts = {"walking": share * electronics, "locked": (1.0 - share) * electronics}
    watts = {
        "electronics of the servos that walk": watts["walking"],
        "electronics of the locked servos": watts["locked"],
        "locked servos that hold": job.options.holding_power or 0.0,
    }
    sides = {side: with_standby(one.measures.as_dict(), watts) for side, one in quality.items()}
    return {"watts": watts, "assumed": electronics is None} | sides


def _walk_in_mujoco(job: Job, cost: WalkingCost, found: Selected) -> str:
    """Crosscheck a gait in MuJoCo; return the verdict, or why there is none: a failure must not lose the search."""
    options, gearbox = job.options, cost.scene.gearbox
    assert gearbox is not None
    motion = found.walk or motion_of(cost.gait.from_vector(found.x), cost.start, cost.blend_strides)
    try:
        return verdict(
            crosscheck(
                motion, job.own, gearbox=gearbox, servo=options.servo, out=job.crosscheck,
                processes=options.crosscheck, progress=options.progress,
            )
        )  # fmt: skip
    except (ValueError, OSError) as error:
        return f"not run: {error}"
    except KeyboardInterrupt:
        return "interrupted; featherstone-gait crosscheck continues it"


def _at_equal_speed(cost: WalkingCost, result: OptimizeResult, baselines: Sequence[dict]) -> list[dict[str, Any]]:
    """Find the cheapest gait on the search's path that is as fast as each baseline that walks.

    Where a plan has the period of the gait, equal speeds are equal steps.  The search did not aim at that speed: the
    gain there is at least the one reported.
    """
    best = np.concatenate([least_so_far(part) for part in parts_of(result.history["f"], result.get("since"))])
    improving = np.flatnonzero((best < np.concatenate([[np.inf], best[:-1]])) & np.isfinite(best))
    path = cost.measure(result.history["x"][improving]) if len(improving) else []
    found = []
    for row in baselines:
        if row["status"] == "ok":
            equal = [x for x in path if x.status == "ok" and abs(x.speed / row["speed"] - 1.0) <= SPEED_TOLERANCE]
            cheapest = min(equal, key=lambda one: one.cost, default=None)
            found.append({
                "baseline": row["name"], "cost": row["cost"], "speed": row["speed"],
                "found": cheapest and cheapest.as_dict(),
                "gain": cheapest and 1.0 - cheapest.cost / row["cost"],
            })  # fmt: skip
    return found


def _servo_limits(model: Model) -> str:
    """Describe in words what the servo can take."""
    moving = (model.servos[name] for name in model.joint_names if name in model.servos)
    servo = next((servo for servo in moving if servo.resistance > 0.0 and servo.voltage_limit < math.inf), None)
    if servo is None:
        return ""
    limit = f", and lets no more than {servo.current_limit:g} A pass" if servo.current_limit < math.inf else ""
    return (
        f"This servo stalls at {servo.voltage_limit / servo.resistance:.2f} A from {servo.voltage_limit:g} V{limit}; "
        "a real AX-12 at 1.5 A from 12 V (its manual), which is for moments: the manual calls motions stable up to a "
        "fifth of the stall torque."
    )
