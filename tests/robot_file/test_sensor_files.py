"""Sensors in the TOML file beside a robot: read, written and read back; what is wrong is named with its line."""

from dataclasses import fields, replace

import numpy as np
import pytest

from featherstone_gait import (
    ContactSensor,
    ForceTorqueSensor,
    LineSensor,
    RangeSensor,
    RobotFileError,
    RobotFileWarning,
    SampledSensor,
    load_robot,
    save_robot,
)

TABLES = """
[[sensors]]
kind = "fan"
link = "link7"
angle = 2.0
rays = 5
reach = 3.0
name = "scanner"
noise = 0.01
rate = 20
delay = 0.05

[[sensors]]
kind = "cone"
link = "world"
angle = 0.5
rays = 32
position = [0.1, 0.0, 0.5]
name = "sonar"

[[sensors]]
kind = "infrared"
link = "link7"
curve = [[0.06, 3.1], [0.8, 0.4]]

[[sensors]]
kind = "line"
link = "link7"
positions = [[0.0, 0.01, 0.0], [0.0, -0.01, 0.0]]
radius = 0.003

[[sensors]]
kind = "force_torque"
link = "link6"
position = [0.0, 0.0, 0.1]
noise = [0.1, 0.1, 0.1, 0.01, 0.01, 0.01]
seed = 3

[[sensors]]
kind = "contact"
link = "link7"
threshold = 0.5
"""


@pytest.fixture
def arm(tmp_path):
    save_robot(load_robot("arm7"), tmp_path / "arm.urdf")
    return tmp_path / "arm.urdf"


def with_tables(path, text):
    beside = path.with_suffix(".toml")
    beside.write_text(beside.read_text("utf-8") + text, "utf-8")
    return path


def same(one, other):
    """Return whether two sensors have the same fields; directions to a rounding, by which unit length is made."""
    if isinstance(one, SampledSensor):
        return same(one.sensor, other.sensor) and replace(one, sensor="q") == replace(other, sensor="q")
    pairs = [(getattr(one, f.name), getattr(other, f.name)) for f in fields(one)]
    return type(one) is type(other) and all(np.allclose(a, b, 1e-15) if f.name == "directions" else a == b
                                            for f, (a, b) in zip(fields(one), pairs))  # fmt: skip


def test_sensors_are_read_written_and_read_back(arm, tmp_path):
    scanner = RangeSensor.fan("link7", 2.0, 5, reach=3.0, name="scanner")
    force = ForceTorqueSensor("link6", (0.0, 0.0, 0.1))
    wanted = (
        SampledSensor(scanner, 0.01, 20.0, 0.05),
        RangeSensor.cone("world", 0.5, 32, position=(0.1, 0.0, 0.5), name="sonar"),
        RangeSensor.infrared("link7", ((0.06, 3.1), (0.8, 0.4))),
        LineSensor("link7", ((0.0, 0.01, 0.0), (0.0, -0.01, 0.0)), 0.003),
        SampledSensor(force, (0.1, 0.1, 0.1, 0.01, 0.01, 0.01), seed=3),
        ContactSensor("link7", 0.5),
    )
    found = load_robot(with_tables(arm, TABLES))
    assert len(found.sensors) == len(wanted)
    with pytest.warns(RobotFileWarning, match="left out sensors of a channel: 'sampled q'"):
        save_robot(replace(found, sensors=(*found.sensors, SampledSensor("q", 0.1))), tmp_path / "again.urdf")
    again = load_robot(tmp_path / "again.urdf")
    for sensors in (found.sensors, again.sensors):
        assert all(map(same, sensors, wanted))


@pytest.mark.parametrize("seed", [2**53 + 1, 2**63 - 1])
def test_seeds_keep_all_digits(arm, tmp_path, seed):
    sensor = SampledSensor(ContactSensor("link7"), 0.1, seed=seed)
    save_robot(replace(load_robot(arm), sensors=(sensor,)), tmp_path / "seeded.urdf")
    assert load_robot(tmp_path / "seeded.urdf").sensors[0].seed == seed


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('kind = "lidar"\nlink = "link7"', r"line \d+: sensors\[0\]: kind is 'lidar'; expected one of range, line"),
        ('kind = "fan"\nlink = "link7"', "angle is missing"),
        ('kind = "range"\nlink = "link7"', "directions is missing"),
        ('kind = "line"\nlink = "wheel"', "is on 'wheel'; links: "),
        ('kind = "fan"\nlink = "link7"\nangle = 1.0\nrays = 2.5', "rays is 2.5"),
        ('kind = "contact"\nlink = "link7"\nlimit = 2.0', r"line \d+: sensors\[0\]: unknown key 'limit'"),
        ('kind = "contact"\nlink = "link7"\nrate = -2.0', "rate is -2"),
        ('kind = "contact"\nlink = "link7"\nname = "a/b"', "without '/'"),
        ('kind = "contact"\nlink = "link7"\nname = "q"', "a sensor is called 'q'"),
        ('kind = "contact"\nlink = "world"', r"line \d+: .*is on 'world'; links: "),
        ('kind = "infrared"\nlink = "link7"', r"line \d+: sensors\[0\]: curve is missing"),
        ('kind = "infrared"\nlink = "link7"\ncurve = []', r"line \d+: .*curve"),
        ('kind = "contact"\nlink = "link7"\nseed = 1.5', "seed is 1.5"),
    ],
)
def test_wrong_tables_are_named(arm, table, message):
    with pytest.raises(RobotFileError, match=message):
        load_robot(with_tables(arm, f"\n[[sensors]]\n{table}\n"))
