"""Damaged files are read or refused by name; FEATHERSTONE_GAIT_FUZZ sets how many of each kind."""

import os

import pytest

from featherstone_gait.benchmark import attack_files
from featherstone_gait.benchmark.attack_files import Row, Target, TooLong

COUNT = int(os.environ.get("FEATHERSTONE_GAIT_FUZZ", "25"))
SEED = int(os.environ.get("FEATHERSTONE_GAIT_FUZZ_SEED", "2"))


def test_damaged_files_are_read_or_refused_by_name():
    assert attack_files.attack_files(COUNT, SEED) == []


def test_every_kind_of_file_is_refused_at_times_and_is_sound_before(tmp_path):
    for target in attack_files.targets(tmp_path):
        target.read(target.path)
        sound = target.path.read_bytes()
        target.path.write_bytes(b"\xff\0[<")
        if not target.kind.startswith("cache"):
            with pytest.raises((ValueError, OSError), match=target.path.name):
                target.read(target.path)
        target.path.write_bytes(sound)


@pytest.mark.parametrize(
    ("raised", "fault"),
    [
        (KeyError("attacked"), "KeyError"),
        (TooLong(), "too long"),
        (ValueError("wrong"), "not named"),
        (ValueError("attacked.csv: wrong"), "from inside"),
        (FileNotFoundError(2, "no such file", "attacked.csv"), None),
    ],
)
def test_a_fault_is_found(tmp_path, raised, fault):
    def read(_):
        raise raised

    path = tmp_path / "attacked.csv"
    path.write_text("a,b\n1,2\n")
    rows = list(attack_files._attacked(Target("csv", path, read), 2, SEED))
    assert [(row.kind, row.attack, row.fault) for row in rows] == [("csv", k, fault) for k in range(2) if fault]
    assert path.read_text() == "a,b\n1,2\n"
    assert all(isinstance(row, Row) for row in rows)


def test_the_same_seed_gives_the_same_attacks(tmp_path):
    def attacks(seed):
        seen = []
        path = tmp_path / "attacked.csv"
        path.write_text("a,b\n1,2\n" * 10)
        list(attack_files._attacked(Target("csv", path, lambda path: seen.append(path.read_bytes())), 20, seed))
        return seen

    assert attacks(1) == attacks(1) != attacks(2)
    assert len(set(attacks(1))) > 10
