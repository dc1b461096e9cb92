"""The pages of `docs/`: programs run, links and paths lead somewhere, what is quoted, listed and shown is so."""

import ast
import importlib
import inspect
import os
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from featherstone_gait import cli
from featherstone_gait.core.step.state import CHANNELS
from featherstone_gait.model import ContactPoint, Supply
from featherstone_gait.robot_file.servos import SERVO_KEYS, ManualPoint
from featherstone_gait.robot_file.settings import OWN, SECTIONS

ROOT = Path(__file__).parents[2]
DOCS, PACKAGE = ROOT / "docs", ROOT / "featherstone_gait"
STORED = DOCS / "reproduction"
PAGES = [page for page in sorted(DOCS.rglob("*.md")) if DOCS / "notebooks" not in page.parents]  # copies for the site
TEXTS = {page: page.read_text("utf-8") for page in [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]}
ARCHITECTURE = TEXTS[DOCS / "architecture.md"]
CODE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
sys.path.append(str(DOCS))  # keys, tables, timings
tables = importlib.import_module("tables")


PROGRAMS = [  # those that define kernels are also run without compilation
    pytest.param(text, id=str(page.relative_to(ROOT)), marks=[pytest.mark.nojit] if "core.compile" in text else [])
    for page, text in TEXTS.items() if CODE.search(text) and page.name != "architecture.md"
]  # fmt: skip


ATTRIBUTE = re.compile(r"`([a-z_]\w*)((?:\.[a-z_]\w*)+)(?:\([^`]*\))?`")
FILES = r"\.(csv|html|json|jsonl|md|npz|png|py|toml|urdf|xml)$"


def attributes_in(prose, code):
    """The lines of prose as those attributes that it names of what the code before it defines."""
    nodes = [*ast.walk(ast.parse(code))]
    known = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    for line in prose.split("\n"):
        named = (name + path for name, path in ATTRIBUTE.findall(line) if name in known and not re.search(FILES, path))
        yield "; ".join(named)


@pytest.mark.long
@pytest.mark.parametrize("text", PROGRAMS)
def test_what_a_page_says_holds(text, tmp_path):
    """All blocks of a page are one program in a folder where it may write; lines are numbered as in the page.

    Attributes of what a block defines, which the text below it names, are read there.
    """
    texts = CODE.split(text)
    parts = (
        "\n" + part if k % 2 else "\n".join(attributes_in(part, "".join(texts[1:k:2]))) for k, part in enumerate(texts)
    )
    (tmp_path / "page.py").write_text("".join(parts), "utf-8")
    command, environment = [sys.executable, "-W", "error", "page.py"], os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_attributes_that_the_text_names_are_read():
    found = attributes_in("of `run.status` and\n`x.y`, `run.npz`, `run.of(name)`", "run = 1")
    assert [*found] == ["run.status", "run.of"]


def test_pages_name_every_timing_and_no_other():
    named = {name for page in PAGES for name in re.findall(r"timings\.py (\w+)", TEXTS[page])}
    assert named == importlib.import_module("timings").TIMINGS.keys()


def anchors(page):
    """The anchors that code hosts give the headings of a page."""
    titles = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_links_are_found():
    links = [(page, *link.partition("#")) for page, text in TEXTS.items()
             for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link]  # fmt: skip
    targets = [(page, (page.parent / path).resolve() if path else page, anchor) for page, path, _, anchor in links]
    assert [(page, path) for page, path, _ in targets if not path.exists()] == []
    assert [found for found in targets if found[2] and found[2] not in anchors(found[1])] == []


@pytest.mark.parametrize("part", ["", "walking", "search", "study", "run.sensors", "identification", "envs", "optimize",
                                  "crosscheck", "judge", "reproduction.maximal", "identification.bench"])  # fmt: skip
def test_the_reference_shows_and_uses_every_public_name(part):
    """Once, on the page whose program calls it if it is a function, and else names it."""
    module = importlib.import_module(f"featherstone_gait.{part}".rstrip("."))
    own = [name for name, thing in vars(module).items() if (inspect.isfunction(thing) or inspect.isclass(thing))
           and thing.__module__ == module.__name__ and name[0] != "_"]  # fmt: skip
    entry = re.compile(rf"^\.\. (?:auto\w+|py:data):: {re.escape(module.__name__)}\.(\w+)$", re.MULTILINE)
    shown = {text: entry.findall(text) for page, text in TEXTS.items() if page.parent.name == "api"}
    assert sorted(each for names in shown.values() for each in names) == sorted(getattr(module, "__all__", own))
    for text, names in shown.items():
        nodes = [*ast.walk(ast.parse("\n".join(CODE.findall(text))))]
        called = {getattr(node.func, "id", "") for node in nodes if isinstance(node, ast.Call)}
        used = {node.id for node in nodes if isinstance(node, ast.Name)} | {"RobotFileWarning"}  # robots.md shows it
        assert {name for name in names if inspect.isfunction(getattr(module, name))} <= called
        assert {*names} <= used


def test_the_architecture_names_paths_and_functions_that_exist_and_quotes_the_sources():
    """In its table of effects each function is in a file of its row, or in `core/effects/`."""
    sources = {path.relative_to(PACKAGE).as_posix(): path.read_text("utf-8") for path in PACKAGE.rglob("*.py")}
    named, quoted = re.findall(r"`([\w./]+(?:\.py|/))`", ARCHITECTURE), CODE.findall(ARCHITECTURE)
    rows = re.findall(r"^\| [^|]*\|[^|]*`core/(?:effects|step)/[^|]*\|[^|]*\|[^|]*\|$", ARCHITECTURE, re.MULTILINE)
    assert (len(named) > 40, len(rows) > 5, len(quoted) > 0) == (True, True, True)
    assert [path for path in named if not (PACKAGE / path).exists() and not (ROOT / path).exists()] == []
    assert [block for block in quoted if block not in "\n".join(sources.values())] == []
    for names in (re.findall(r"`([\w./]+)`", row) for row in rows):
        text = "\n".join(text for path, text in sources.items() if path in names or path.startswith("core/effects/"))
        assert [each for each in names if "/" not in each and f"def {each}(" not in text] == []


def test_every_key_of_toml_is_listed_with_what_it_is():
    page = TEXTS[DOCS / "toml_keys.md"]
    named = {name.partition(".NAME")[0] for name in re.findall(r"`\[?([\w.]+)", page)}
    stated = (f.name for f in (*fields(ContactPoint), *fields(Supply)))
    assert named >= {*SECTIONS, *sum(OWN.values(), ()), *SERVO_KEYS, *stated}
    assert named >= {"default", "type", "gearbox", *(f"manual.{f.name}" for f in fields(ManualPoint)), "about.product"}
    rows = [row.split(" | ") for row in page.splitlines() if row.count(" | ") == 4]
    assert all(len(row[-1]) > 4 for row in rows[1:] if not row[0].startswith("| ---") and row[0] != "| key")


def test_every_command_and_channel_is_listed():
    names = [each.__name__.rpartition(".")[2].replace("_", "-") for each in cli.COMMANDS]
    assert re.findall(r"^\| `([a-z-]+)[` ]", TEXTS[DOCS / "commands.md"], re.MULTILINE) == names
    rows = [f"| `{c.name}` | {c.kind} | {c.of} | {c.width} | {c.unit} | {c.what} |" for c in CHANNELS]
    assert re.findall(r"^\| `.*", ARCHITECTURE.partition("## Channels")[2].partition("##")[0], re.MULTILINE) == rows


def test_pages_show_the_stored_results(capsys):
    """Each table and number that is described is on one page; one that differs is found and written anew."""
    assert tables.main(check=True) == 0, capsys.readouterr().out
    texts, described = "\n".join(TEXTS.values()), tables.DESCRIBED | {"keys": tables.keys.TABLES}
    found = sorted((page, name) for _, page, name in tables.TABLE.findall(texts) + tables.NUMBER.findall(texts))
    assert found == sorted((page, name) for page, names in described.items() for name in names)
    for page, old, new in ("README.md", "87.8 J/m", "78.8 J/m"), ("docs/coordinates.md", "-->-0.1", "-->12.3e-4"):
        text = TEXTS[ROOT / page]
        assert text != text.replace(old, new)
        assert tables.written(text.replace(old, new)) == text


def test_the_gallery_shows_ten_moving_pictures_of_its_programs():
    text = TEXTS[DOCS / "gallery.md"]
    programs, pictures = re.findall(r'path="(\w+)\.html"', text), re.findall(r"\((images/\S+)\)", text)
    assert pictures == [f"images/gallery/{name}.webp" for name in programs]
    data = [path.read_bytes() for path in (DOCS / "images" / "gallery").iterdir()]
    assert (len(programs), len(data)) == (10, 11)  # and that of the first page
    assert sum(map(len, data)) < 3_000_000
    assert min(each.count(b"ANMF") for each in data) > 20  # frames


def test_every_stored_file_has_its_command():
    rows = re.findall(r"^\| (`[^|]*) \| (`[^|]*) \| [\d.]+ \|$", TEXTS[STORED / "README.md"], re.MULTILINE)
    files = {name for names, _ in rows for name in re.findall(r"`(.*?)`", names)}
    kept = {path.relative_to(STORED).as_posix() for path in STORED.rglob("*") if path.is_file()} - {"README.md"}
    commands = " ".join(command for _, command in rows)
    scripts = {ROOT / word for word in re.findall(r"(?:docs|robots|notebooks)/[\w./]+\.\w+", commands)}
    assert kept - files == set()
    assert [path for path in {*scripts, *(STORED / name for name in files)} if not path.resolve().exists()] == []
    assert all(map(importlib.util.find_spec, re.findall(r"-m (featherstone_gait[\w.]*)", commands)))
