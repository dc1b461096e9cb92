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

from featherstone_gait import cli
from featherstone_gait.core.step.state import CHANNELS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PACKAGE = ROOT / "featherstone_gait"
NOTEBOOKS = DOCS / "notebooks"  # copies, while the site is built
PAGES = sorted(page for page in DOCS.rglob("*.md") if NOTEBOOKS not in page.parents)
LINKED = [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
TEXTS = {page: page.read_text("utf-8") for page in LINKED}
ARCHITECTURE = TEXTS[DOCS / "architecture.md"]
REFERENCE = {page: text for page, text in TEXTS.items() if page.parent.name == "api"}


def name(page):
    return page.relative_to(ROOT).as_posix().removesuffix(".md")


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
    command, environment = [sys.executable, "-W", "error", script], os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def marks(text):
    """Pages that define kernels are also run without compilation."""
    return [pytest.mark.nojit] if "core.compile" in text else []


@pytest.mark.long
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=marks(text), id=name(page))
        for page, text in TEXTS.items()
        if blocks(text) and page.name != "architecture.md"
    ],
)
def test_what_a_page_says_holds(page, tmp_path):
    done = run(TEXTS[page], tmp_path)
    assert done.returncode == 0, done.stderr


def test_a_page_that_is_wrong_fails_where_it_is_wrong(tmp_path):
    done = run("A page.\n\n```python\nx = 1\n```\n\n```python\nassert x == 2\n```\n", tmp_path)
    assert done.returncode == 1
    assert "line 8" in done.stderr


def anchors(page):
    """The anchors that code hosts give the headings of a page."""
    titles = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", LINKED, ids=name)
def test_links_lead_somewhere(page):
    links = [link.partition("#") for link in re.findall(r"\]\(([^)\s]+)\)", TEXTS[page]) if "://" not in link]
    targets = [((page.parent / path).resolve() if path else page, anchor) for path, _, anchor in links]
    assert [path for path, _ in targets if not path.exists()] == []
    assert [(path.name, anchor) for path, anchor in targets if anchor and anchor not in anchors(path)] == []


@pytest.mark.parametrize(
    "part",
    [
        "", "walking", "search", "study", "run.sensors", "identification",
        "envs", "reproduction.maximal", "optimize", "crosscheck", "identification.bench",
    ],
)  # fmt: skip
def test_the_reference_shows_and_uses_every_public_name(part):
    """Once, on the page whose program calls it if it is a function, and else names it."""
    module = importlib.import_module(f"featherstone_gait.{part}".rstrip("."))
    kinds = (inspect.isfunction, inspect.isclass)
    own = [name for name, thing in vars(module).items() if any(is_(thing) for is_ in kinds)
           and thing.__module__ == module.__name__ and name[0] != "_"]  # fmt: skip
    public = sorted(getattr(module, "__all__", own))
    entry = re.compile(rf"^\.\. (?:auto\w+|py:data):: {re.escape(module.__name__)}\.(\w+)$", re.MULTILINE)
    shown = {page: entry.findall(text) for page, text in REFERENCE.items()}
    assert sorted(name for names in shown.values() for name in names) == public
    for page, names in shown.items():
        nodes = [*ast.walk(ast.parse("\n".join(block for _, block in blocks(TEXTS[page]))))]
        called = {node.func.id for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
        used = {node.id for node in nodes if isinstance(node, ast.Name)}
        assert {name for name in names if inspect.isfunction(getattr(module, name))} - called == set()
        assert {*names} - used - {"RobotFileWarning"} == set()  # which robots.md shows


def test_the_page_on_commands_lists_every_command():
    names = [each.__name__.rpartition(".")[2].replace("_", "-") for each in cli.COMMANDS]
    assert re.findall(r"^\| `([a-z-]+)[` ]", TEXTS[DOCS / "commands.md"], re.MULTILINE) == names


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
    """In its table of effects: each function in a file of its row, or in `core/effects/`."""
    rows = re.findall(r"^\| [^|]*\|[^|]*`core/(?:effects|step)/[^|]*\|[^|]*\|[^|]*\|$", ARCHITECTURE, re.MULTILINE)
    assert len(rows) > 5
    for row in rows:
        names = re.findall(r"`([\w./]+)`", row)
        files = [*(PACKAGE / "core" / "effects").glob("*.py"), *(PACKAGE / each for each in names if "/" in each)]
        text = "\n".join(file.read_text("utf-8") for file in files)
        assert [each for each in names if "/" not in each and f"def {each}(" not in text] == []


def test_the_architecture_lists_every_channel():
    rows = [f"| `{c.name}` | {c.kind} | {c.of} | {c.width} | {c.unit} | {c.what} |" for c in CHANNELS]
    table = ARCHITECTURE.partition("## Channels")[2].partition("##")[0]
    assert [line for line in table.splitlines() if line.startswith("| `")] == rows
