"""Every example of every `--help` runs, with sizes that end in seconds; all but a few are long.

Files that the examples name are put beside them.  The numbers that make an example smaller are added at its end.
"""

import re
import shutil
from contextlib import ExitStack
from pathlib import Path

import pytest
from test_cli import quadruped
from test_scenes import FILE

from featherstone_gait import cli
from featherstone_gait.benchmark import precision, scoreboard, speed
from featherstone_gait.crosscheck import FLOORS
from featherstone_gait.reproduction import report
from featherstone_gait.robot_file.source import robots_folder
from featherstone_gait.view import live

SMALLER = {
    "optimize": "--iterations 8 --worlds 2 --test-worlds 2 --no-baselines",
    "crosscheck": "--strides 1 --floors 2ms_0.9",
    "judge": "--worlds 8 --seconds 0.5",
    "simulate": "--duration 0.2",
    "drive": "--duration 0.2 --port 8391",
    "warm-up": "my_program.py --only",
}
SERVED = "tcp://"  # a scheduler of dask
STUDY = 'robot = "arm7"\nexperiment = "hold"\nduration = 0.1\n[vary]\nscene.gearbox = ["rotor"]\n'


def examples():
    """The examples of the command alone and of each command, without what is said beside them."""
    parser = cli._parser()
    commands = next(action for action in parser._actions if action.dest not in ("help", "version")).choices
    epilogs = [parser.epilog, *(each.epilog for each in commands.values())]
    found = [line for text in epilogs for line in re.findall(r"^  featherstone-gait (.*)$", text, re.MULTILINE)]
    return [line for line in dict.fromkeys(re.split("  +", each)[0] for each in found) if line != "COMMAND --help"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with all files that the examples name."""
    folder, robots = tmp_path_factory.mktemp("examples"), robots_folder()
    shutil.copy(robots / "arm7" / "arm7.urdf", folder / "my_robot.urdf")
    shutil.copy(robots / "humanoid" / "humanoid.urdf", folder / "my_biped.urdf")
    (folder / "dog.urdf").write_text(quadruped(), "utf-8")
    shutil.copytree(robots / "ax12_arm", folder / "my_robots")
    shutil.copy(robots / "servos" / "mx64.toml", folder / "my_servo.toml")
    shutil.copy(robots / "humanoid" / "optimized_gait.npz", folder / "humanoid_gait.npz")
    for name in ("sin_sin", "lift_and_drop"):
        for gain in (100, 200):
            shutil.copy(robots / "servos" / "recordings" / f"xl330_kp{gain}_{name}.csv", folder)
    (folder / "my_program.py").write_text("print('compiles nothing')")
    (folder / "notebooks").mkdir()
    for name in ("FILE.toml", "notebooks/stability_study.toml", "notebooks/unit_study.toml"):
        (folder / name).write_text(STUDY)
    (folder / "bench.toml").write_text(FILE.format(pairs='"none"'), "utf-8")
    return folder


def files_of(line, folder):
    """Make the files of a line that take a simulation or a command to make."""
    if "humanoid_simulation" in line or re.search(r"\b(run|before|after)\.npz", line):
        if not (folder / "humanoid_simulation.npz").exists():
            assert cli.main(["simulate", "humanoid", "--duration", "0.2"]) == 0
        for name in ("run", "before", "after"):
            for ending in (".npz", ".json"):
                shutil.copy(folder / f"humanoid_simulation{ending}", folder / f"{name}{ending}")
    if "my_gait.csv" in line and not (folder / "my_gait.csv").exists():
        assert cli.main(["export", "humanoid_gait.npz", "--csv"]) == 0
        (folder / "humanoid_gait_angles.csv").rename(folder / "my_gait.csv")


@pytest.mark.quick("info_humanoid", "servos", "servos_ax12*", "export_*", "view_humanoid", "view_dog*", "info_my_*")
@pytest.mark.parametrize("line", [pytest.param(each, id=each.replace(" ", "_")) for each in examples()])
def test_an_example_runs(line, folder, monkeypatch, tmp_path):
    """Benchmarks and notebooks are called alone; a page is served and left; two floors stand for all."""
    monkeypatch.chdir(folder)
    files_of(line, folder)
    monkeypatch.setattr(live.Live, "wait", lambda self: self.stop())
    monkeypatch.setattr("webbrowser.open", lambda url: True)
    for name in [*FLOORS] if "optimize" in line else ():
        if name not in ("10ms_0.9", "20ms_0.9"):
            monkeypatch.delitem(FLOORS, name)
    for module in (speed, precision, scoreboard):
        monkeypatch.setattr(module, "run", lambda out, full, **how: None)
    monkeypatch.setattr(report, "reproduce", lambda names, source, progress: [])
    monkeypatch.setattr(report, "check", lambda names, source: source)
    with ExitStack() as stack:
        if SERVED in line:
            cluster = stack.enter_context(
                pytest.importorskip("distributed").LocalCluster(1, threads_per_worker=1, dashboard_address=None)
            )
            line = re.sub(rf"{SERVED}\S+", cluster.scheduler_address, line)
        elif "--live" in line:
            pytest.importorskip("viser")
        found = (sorted(map(str, Path().glob(word))) if "*" in word else [word] for word in line.split())
        words = [name for names in found for name in names]
        smaller = SMALLER.get(words[0], "").split()
        if (words[0] == "crosscheck" and "--floors" in words) or words[-1] == "--only":
            smaller = []
        out = [] if "--out" in words else ["--out", str(tmp_path)]
        assert cli.main([*words, *smaller, *out]) == 0


def test_examples_are_found():
    """Each command has at least one example, and every example is about its own command."""
    names = {each.__name__.rpartition(".")[2].replace("_", "-") for each in cli.COMMANDS}
    assert {line.split()[0] for line in examples()} == names


def test_commands_on_the_pages_are_understood():
    root = Path(__file__).parents[2]
    pages = [root / "README.md", *(root / "docs").glob("*.md"), *(root / "docs" / "tutorials").glob("*.md")]
    shell = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
    blocks = [block for page in pages for block in shell.findall(page.read_text("utf-8"))]
    lines = [line for block in blocks for line in re.findall(r"featherstone-gait (\w.*)", block)]
    assert len(lines) > 20
    for line in lines:
        assert callable(cli._parser().parse_args(re.split(r"\s+#", line)[0].split()).run)
