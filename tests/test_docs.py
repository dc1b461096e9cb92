"""The pages of `docs/`: their programs run, their links and paths lead somewhere, what they quote and list is so."""

import ast
import importlib
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import featherstone_gait
from featherstone_gait import cli
from featherstone_gait.core.step.state import CHANNELS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PACKAGE = ROOT / "featherstone_gait"
PAGES = sorted({*DOCS.rglob("*.md")} - {DOCS / "architecture.md"} - {*(DOCS / "notebooks").rglob("*")})
ARCHITECTURE = (DOCS / "architecture.md").read_text("utf-8")
LINKED = [DOCS / "architecture.md", *PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
REFERENCE = sorted((DOCS / "api").glob("*.md"))


def blocks(text):
    """The Python blocks of a page, each with the number of lines before it."""
    found = re.finditer(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [(text[: match.start(1)].count("\n"), match[1]) for match in found]


def program(text):
    """All blocks of a page as one program, each line where it is in the page."""
    lines = [""] * text.count("\n")
    for first, block in blocks(text):
        code = block.splitlines()
        lines[first : first + len(code)] = code
    return "\n".join(lines)


def run(text, folder):
    """Run a page's program in a folder, where it may write."""
    script = folder / "page.py"
    script.write_text(program(text), "utf-8")
    command = [sys.executable, "-W", "error", script]
    paths = {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=folder, env=os.environ | paths, capture_output=True, text=True)


def defines_kernels(text):
    return "core.compile" in text


def marked(page):
    return [pytest.mark.nojit] if defines_kernels(page.read_text("utf-8")) else []


@pytest.mark.long
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=marked(page), id=page.relative_to(DOCS).as_posix().removesuffix(".md"))
        for page in PAGES
        if blocks(page.read_text("utf-8"))
    ],
)
def test_what_a_page_says_holds(page, tmp_path):
    done = run(page.read_text("utf-8"), tmp_path)
    assert done.returncode == 0, done.stderr


def test_a_page_that_is_wrong_fails_where_it_is_wrong(tmp_path):
    done = run("A page.\n\n```python\nx = 1\n```\n\n```python\nassert x == 2\n```\n", tmp_path)
    assert done.returncode == 1
    assert "line 8" in done.stderr


def heading_anchors(text):
    """The anchors that GitHub gives the headings of a page."""
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_pages_have_links_to_follow():
    assert sum(len(local_links(page.read_text("utf-8"))) for page in LINKED) > 50


def local_links(text):
    return [link.partition("#") for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link]


@pytest.mark.parametrize("page", LINKED, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    links = local_links(page.read_text("utf-8"))
    targets = [((page.parent / path).resolve() if path else page, anchor) for path, _, anchor in links]
    assert [path for path, _ in targets if not path.exists()] == []
    pages = [(path, anchor) for path, anchor in targets if anchor]
    assert [(path.name, a) for path, a in pages if a not in heading_anchors(path.read_text("utf-8"))] == []


def test_the_reference_has_every_public_name_once():
    text = "\n".join(page.read_text("utf-8") for page in REFERENCE)
    shown = re.findall(r"^\.\. auto\w+:: featherstone_gait\.(\w+)$", text, re.MULTILINE)
    assert sorted(shown) == featherstone_gait.__all__


def test_the_reference_has_an_example_of_every_public_name():
    """On the page of the name, where the tests run it: functions are called, and classes made or met."""
    for page in REFERENCE:
        text = page.read_text("utf-8")
        code = "\n".join(block for _, block in blocks(text))
        used = {node.id for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name)}
        called = {call.func.id for call in calls(code)}
        shown = set(re.findall(r"^\.\. auto\w+:: featherstone_gait\.(\w+)$", text, re.MULTILINE))
        functions = {name for name in shown if inspect.isfunction(getattr(featherstone_gait, name))}
        assert functions - called == set()
        assert shown - used - {"RobotFileWarning"} == set()  # that one is shown where warnings are, in robots.md


@pytest.mark.parametrize(
    "part",
    [
        "walking", "search", "study", "run.sensors", "identification",
        "envs", "reproduction.maximal", "optimize", "crosscheck", "identification.bench",
    ],
)  # fmt: skip
def test_the_reference_shows_all_of_a_part_and_calls_its_functions(part):
    module = importlib.import_module(f"featherstone_gait.{part}")
    kinds = (inspect.isfunction, inspect.isclass)
    own = [name for name, thing in vars(module).items() if any(is_(thing) for is_ in kinds)
           and thing.__module__ == module.__name__ and name[0] != "_"]  # fmt: skip
    public = sorted(getattr(module, "__all__", own))
    pages = [page.read_text("utf-8") for page in REFERENCE]
    entry = re.compile(rf"^\.\. (?:auto\w+|py:data):: featherstone_gait\.{part}\.(\w+)$", re.MULTILINE)
    shown = [entry.findall(page) for page in pages]
    assert sorted(name for names in shown for name in names) == public
    (text,) = (page for page, names in zip(pages, shown) if names)
    code = "\n".join(block for _, block in blocks(text))
    called = {call.func.id for call in calls(code)}
    used = {node.id for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name)}
    assert {name for name in public if inspect.isfunction(getattr(module, name))} - called == set()
    assert {*public} - used == set()


def calls(code):
    return [n for n in ast.walk(ast.parse(code)) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)]


def test_the_page_on_commands_lists_every_command():
    names = [each.__name__.rpartition(".")[2].replace("_", "-") for each in cli.COMMANDS]
    listed = re.findall(r"^\| `([a-z-]+)[` ]", (DOCS / "commands.md").read_text("utf-8"), re.MULTILINE)
    assert listed == names


def test_the_architecture_names_paths_that_exist():
    named = re.findall(r"`([\w./]+(?:\.py|/))`", ARCHITECTURE)
    assert len(named) > 40
    assert [path for path in named if not (PACKAGE / path).exists() and not (ROOT / path).exists()] == []


def test_the_architecture_quotes_the_sources():
    sources = "\n".join(path.read_text("utf-8") for path in PACKAGE.rglob("*.py"))
    quoted = [block for _, block in blocks(ARCHITECTURE)]
    assert quoted
    assert [block for block in quoted if block not in sources] == []


def test_the_architecture_names_functions_that_exist():
    """In its table of effects: each function in a file of its row, or in `core/effects/` or `core/step/`."""
    rows = re.findall(r"^\| .*`core/effects/.*\|$", ARCHITECTURE.partition("## Effects")[2], re.MULTILINE)
    rows = [row for row in rows if row.count("|") == 5]
    assert len(rows) > 5
    for row in rows:
        names = re.findall(r"`([\w./]+)`", row)
        folders = [PACKAGE / "core" / "effects", *(PACKAGE / name for name in names if name.endswith(".py"))]
        files = [file for place in folders for file in (place.glob("*.py") if place.is_dir() else [place])]
        text = "\n".join(file.read_text("utf-8") for file in files)
        functions = [name for name in names if not name.endswith((".py", "/"))]
        assert [name for name in functions if f"def {name}(" not in text] == []


def test_the_architecture_lists_every_channel():
    rows = [f"| `{c.name}` | {c.kind} | {c.of} | {c.width} | {c.unit} | {c.what} |" for c in CHANNELS]
    table = ARCHITECTURE.partition("## Channels")[2].partition("##")[0]
    assert [line for line in table.splitlines() if line.startswith("| `")] == rows
