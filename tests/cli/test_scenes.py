"""Commands on files of scenes: what is in them, what touches what, runs and pages."""

import pytest

from featherstone_gait import Trajectory, cli

FILE = """
pairs = {pairs}
[ground]
friction = 0.8
[[objects]]
name = "crate"
shape = "box"
size = [0.2, 0.2, 0.2]
mass = 2.0
position = [0.0, 0.0, 0.4995]
[[objects]]
name = "ball"
shape = "sphere"
radius = 0.1
mass = 1.0
position = [1.0, 0.0]
[[obstacles]]
name = "table"
shape = "box"
size = [0.5, 0.5, 0.4]
position = [0.0, 0.0, 0.2]
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text(FILE.format(pairs='"none"'), encoding="utf-8")
    return path


def test_info_says_what_touches_what(file, capsys):
    for arguments, says in (((), "pairs: none"), (("--pairs", "all"), "3 can touch"), (("--pairs", "none"), "none")):
        assert cli.main(["info", str(file), *arguments]) == 0
        told = capsys.readouterr().out
        for each in ("crate: 2 kg, object", "obstacles: table", "friction 0.8", says):
            assert each in told
    file.write_text(FILE.format(pairs='[["crate", "table"]]'), encoding="utf-8")
    assert cli.main(["info", str(file)]) == 0
    assert "1 can touch each other: crate/body - table/body" in capsys.readouterr().out
    assert cli.main(["info", "humanoid", "--pairs", "all", "--all"]) == 0  # of a robot its own links
    assert "humanoid/right_foot - humanoid/left_foot" in " ".join(capsys.readouterr().out.split())


@pytest.mark.long
def test_a_scene_is_simulated_saved_and_shown(file, tmp_path, capsys):
    out = ["--out", str(tmp_path)]
    assert cli.main(["simulate", str(file), "--pairs", "all", "--duration", "0.2", *out]) == 0
    assert "crate/body - table/body" in capsys.readouterr().out
    run = Trajectory.load(tmp_path / "bench_simulation.npz")
    assert run.contact("crate", "table").force[-1, 2] == pytest.approx(2.0 * 9.81, rel=1e-4)
    assert '"together":true' in (tmp_path / "bench_simulation.html").read_text("utf-8")
    assert cli.main(["view", str(tmp_path / "bench_simulation.npz"), *out]) == 0
    assert "pair_normal_force" in (tmp_path / "bench_simulation_view.html").read_text("utf-8")
    assert cli.main(["view", str(file), *out]) == 0
    assert (tmp_path / "bench_view.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("simulate", "--base", "fixed"), "leave --base out"),
        (("info", "--servo", "generic"), "leave --servo out"),
        (("view", "--live"), "leave --live out"),
        (("view", "--keyframe", "home"), "leave --keyframe out"),
    ],
)
def test_what_a_scene_does_not_take_is_said_in_one_line(file, arguments, says, capsys):
    command, *options = arguments
    assert cli.main([command, str(file), *options, "--out", str(file.parent)]) == 2
    told = capsys.readouterr().err
    assert says in told
    assert told.count("\n") == 1
