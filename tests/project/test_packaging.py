"""What is built, installed and written in the README is complete and true."""

import ast
import email
import importlib.util
import os
import re
import shlex
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import matplotlib
import pytest
from matplotlib import pyplot

import featherstone_gait
from featherstone_gait import cli, robot_names

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text("utf-8")
START = (ROOT / "docs" / "start.md").read_text("utf-8")
OF_ROBOTS = [p for p in (ROOT / "robots").rglob("*") if p.is_file() and "__pycache__" not in p.parts]
ROBOT_FILES = {str(p.relative_to(ROOT).as_posix()) for p in OF_ROBOTS}

PROGRAM = """
import featherstone_gait
from featherstone_gait import load_robot, load_servo, robot_names
assert all(load_robot(name).servos for name in robot_names())
assert load_servo("ax12").gearbox.ratio == 254
print(featherstone_gait.__file__, len(load_robot("humanoid").joint_names), *robot_names())
"""


def blocks(language, text=README):
    """A page's code blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def distributions(tmp_path_factory):
    """The folder that holds a wheel and a source distribution, freshly built."""
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-d", folder], cwd=ROOT, check=True, capture_output=True
    )
    return folder


def test_the_wheel_holds_package_robots_and_license(distributions):
    (path,) = distributions.glob("*.whl")
    with zipfile.ZipFile(path) as wheel:
        names = set(wheel.namelist())
        (metadata,) = (wheel.read(name).decode() for name in names if name.endswith(".dist-info/METADATA"))
    kinds = (".py", ".pyi", ".html", ".css", ".js", ".toml", ".onnx", ".typed")
    sources = [p for p in (ROOT / "featherstone_gait").rglob("*") if p.suffix in kinds]
    assert "py.typed" in [p.name for p in sources]
    modules = {str(p.relative_to(ROOT).as_posix()) for p in sources}
    rest = names - modules - {f"featherstone_gait/{name}" for name in ROBOT_FILES}
    assert len(names - rest) == len(modules) + len(ROBOT_FILES)
    assert {name.partition("/")[0] for name in rest} == {f"featherstone_gait-{featherstone_gait.__version__}.dist-info"}
    assert any(name.endswith("licenses/LICENSE") for name in rest)
    message = email.message_from_string(metadata)
    assert message["License-Expression"] == "MIT"
    assert message["Version"] == featherstone_gait.__version__
    assert {f"Programming Language :: Python :: 3.{k}" for k in (11, 12, 13)} <= {*message.get_all("Classifier")}
    assert len(message.get_payload()) > 5000
    assert re.findall(r"\]\((?!https:)|<!--", message.get_payload()) == []  # an index has no files beside its README


def test_an_index_gets_links_into_the_repository_if_one_is_stated():
    spec = importlib.util.spec_from_file_location("metadata", ROOT / "docs" / "metadata.py")
    metadata = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(metadata)
    address = metadata.repository("license: MIT\nrepository-code: 'https://host/us/it/'\n")
    assert (address, metadata.repository("title: x\n")) == ("https://host/us/it", "")
    assert [*metadata.addresses("")] == ["Paper"]
    assert all(url.startswith(address) for name, url in metadata.addresses(address).items() if name != "Paper")
    text = "![A walk](docs/walk.gif) [a](docs/a.md#b), [c](https://c.org/d) and [e](LICENSE)\n<!-- f -->\n<!-- g -->2"
    assert metadata.for_index(text, address, "v1") == (
        "![A walk](https://host/us/it/raw/v1/docs/walk.gif) [a](https://host/us/it/blob/v1/docs/a.md#b), "
        "[c](https://c.org/d) and [e](https://host/us/it/blob/v1/LICENSE)\n2"
    )
    text = "![A](a.gif)\n\n[a](docs/a.md#b) ([how](h.md)), [c](https://c.org).\n\n## Where to go\n\n[e](f)\n\n## End\n"
    assert metadata.for_index(text, "", "v1") == "a, [c](https://c.org).\n\n## End\n"


def test_the_source_distribution_holds_all_that_the_tests_need(distributions):
    (path,) = distributions.glob("*.tar.gz")
    with tarfile.open(path) as source:
        names = {name.partition("/")[2] for name in source.getnames()}
    tests = {p.relative_to(ROOT).as_posix() for p in (ROOT / "tests").rglob("*.py")}
    copied = ROOT / "docs" / "notebooks"  # while the site is built
    files = [p for p in (ROOT / "docs").rglob("*") if p.is_file() and copied not in p.parents]
    pages = {str(p.relative_to(ROOT).as_posix()) for p in files if "__pycache__" not in p.parts}
    notebooks = {str(p.relative_to(ROOT).as_posix()) for p in (ROOT / "notebooks").glob("*.ipynb")}
    top = {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff"}
    assert top | ROBOT_FILES | pages | notebooks | tests <= names
    assert {name.partition("/")[0] for name in names} - {"PKG-INFO", ".gitignore"} <= {p.name for p in ROOT.iterdir()}


@pytest.mark.long
def test_an_installed_wheel_finds_its_robots_anywhere(distributions, tmp_path):
    (wheel,) = distributions.glob("*.whl")
    site = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", site, wheel]
    subprocess.run(pip, cwd=tmp_path, check=True)
    command, environment = [sys.executable, "-c", PROGRAM], os.environ | {"PYTHONPATH": str(site)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True)
    file, joints, *names = done.stdout.split()
    assert Path(file).is_relative_to(site)
    assert (int(joints), tuple(names)) == (19, robot_names())
    assert (site / "bin" / "featherstone-gait").exists() or (site / "Scripts" / "featherstone-gait.exe").exists()


def test_every_public_name_is_there_once():
    names = featherstone_gait.__all__
    assert len(names) == len(set(names))
    assert all(getattr(featherstone_gait, name).__name__ == name for name in names)
    assert {*names, "base"} <= {*dir(featherstone_gait)}
    assert not {"re", "import_module"} & {*dir(featherstone_gait)}
    with pytest.raises(AttributeError, match="no attribute 'simulator'"):
        featherstone_gait.simulator  # noqa: B018


def test_type_checkers_know_every_public_name():
    tree = ast.parse(Path(featherstone_gait.__file__).with_suffix(".pyi").read_text("utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    found = {alias.name for node in imports for alias in node.names if alias.asname == alias.name}
    assert found == set(featherstone_gait.__all__)


def test_readme_has_commands_that_exist():
    install, *commands = [line for block in blocks("sh") for line in block.splitlines()]
    assert install == "pip install ."
    test = commands.pop(1)
    for command in commands:
        program, *arguments = shlex.split(command)
        assert program == "featherstone-gait"
        assert callable(cli._parser().parse_args(arguments).run)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert f"`pip install --find-links FOLDER {project['name']}`" in README
    assert project["scripts"] == {"featherstone-gait": "featherstone_gait.cli:main"}
    assert test == 'pip install -e ".[test]" && python -m pytest'
    assert "test" in project["optional-dependencies"]


def test_the_readme_has_a_picture_that_moves_and_is_small():
    (picture,) = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", README)
    data = (ROOT / picture).read_bytes()
    assert data[:6] == b"GIF89a"
    assert data.count(b"\x21\xf9\x04") > 30  # control blocks: one a frame
    assert len(data) < 1_500_000


def test_the_citation_has_version_license_and_paper():
    text = (ROOT / "CITATION.cff").read_text("utf-8")
    assert f"\nversion: {featherstone_gait.__version__}\n" in text
    assert "\nlicense: MIT\n" in text
    assert "doi: 10.5772/54766" in text
    (authors,) = re.findall(r"^Copyright \(c\) \d+ (.*)$", (ROOT / "LICENSE").read_text("utf-8"), re.MULTILINE)
    assert authors in text


def test_readme_links_lead_somewhere():
    links = [link for link in re.findall(r"\]\(([^)]+)\)", README) if not link.startswith("http")]
    assert links
    assert [link for link in links if not (ROOT / link.partition("#")[0]).is_file()] == []  # anchors: test_docs.py
    assert [name for name in robot_names() if f"`{name}`" not in README] == []


def test_the_first_example_prints_what_its_page_says(tmp_path, monkeypatch, capsys):
    (example,), (output,) = blocks("python", START), blocks("text", START)
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    exec(compile(example, "start.md", "exec"), {})
    pyplot.close("all")
    # An estimate of 4e-5 is made of round-off in part, and so of the processor: its factor of 2 is held, not its digit.
    estimate = re.compile(r"\d+e-\d+")
    printed = capsys.readouterr().out
    assert estimate.sub("", printed) == estimate.sub("", output)
    (ours,), (told,) = estimate.findall(printed), estimate.findall(output)
    assert 0.5 < float(ours) / float(told) < 2.0
    assert (tmp_path / "standing.png").stat().st_size > 10_000
