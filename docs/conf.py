"""Sphinx: `python -m sphinx -W -b html docs build`, with the packages of `pip install -e ".[docs]"`.

Notebooks are shown as they are stored: they are copied beside the pages while the site is built, and run by the tests.
Formulas become MathML here, so that a page needs no program of anybody else's.
"""

import inspect
import os
import re
import shutil
import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

HERE = Path(__file__).parent
ROOT, NOTEBOOKS = HERE.parent, HERE / "notebooks"
sys.path.insert(0, str(ROOT))

import featherstone_gait  # noqa: E402
import featherstone_gait.cli  # noqa: E402

project, author = "featherstone_gait", "the authors of featherstone_gait"
copyright = "2026, " + author
version = release = featherstone_gait.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
napoleon_google_docstring = False
napoleon_use_ivar = True
nb_execution_mode = "off"
suppress_warnings = ["mystnb.unknown_mime_type"]  # judged statements, which stand as HTML beside it
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
exclude_patterns = ["build", "**/.ipynb_checkpoints"]
html_theme = "furo"
html_title = f"featherstone_gait {version}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("ArrayLike", "Choice", "FilePath", "Wrench")}
python_maximum_signature_line_length = 88
templates_path: list[str] = []


def setup(app):
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
    app.connect("config-inited", _copy_notebooks, priority=1)
    app.connect("source-read", _resolve)
    app.connect("build-finished", _remove_notebooks)
    app.connect("doctree-read", _keep_units)
    app.connect("autodoc-process-docstring", _docstring, priority=400)  # before napoleon
    app.connect("autodoc-process-signature", _signature)
    return {"parallel_read_safe": True}


ACCENT = re.compile(
    r'<munderover>\s*(<mi>[^<]*</mi>)\s*(.*?)\s*(<mo stretchy="false">[˙¨ˆ¯]</mo>)\s*</munderover>',
    re.DOTALL,
)


def _mathml(text, **how):
    """An index stands beside the letter that has a dot or a hat, not below it."""
    return ACCENT.sub(r'<msub><mover accent="true">\1\3</mover>\2</msub>', tex2mathml(text, **how))


def _inline(writer, node):
    writer.body.append(_mathml(node.astext()))
    raise nodes.SkipNode


def _display(writer, node):
    text = re.sub(r"\\(begin|end)\{(equation|gather|align)\*?\}", "", node.astext())
    writer.body.append(f'<div class="math">{_mathml(text, as_block=True)}</div>')
    raise nodes.SkipNode


def _copy_notebooks(app, config):
    shutil.rmtree(NOTEBOOKS, ignore_errors=True)
    ignored = shutil.ignore_patterns(".*", "*_searches", "*.html")
    shutil.copytree(ROOT / "notebooks", NOTEBOOKS, ignore=ignored)


def _remove_notebooks(app, exception):
    shutil.rmtree(NOTEBOOKS, ignore_errors=True)


def _resolve(app, page, source):
    """Fill in lists and help texts; turn links out of this folder, as in the repository, into the site's."""
    up = "../" * page.count("/")
    text = re.sub(r"\]\((?:\.\./)+notebooks/", f"]({up}notebooks/", source[0])
    text = re.sub(r"\]\((?:\.\./)+docs/", f"]({up}", text)  # of a notebook
    text = re.sub(r"\]\((?:\.\./)+CONTRIBUTING\.md", f"]({up}contributing.md", text)
    if page == "index":
        listed = set(re.findall(r"^([\w/]+)$|<([\w/]+)>$", text, re.MULTILINE))
        named = {name for pair in listed for name in pair}
        others = sorted(path.stem for path in HERE.glob("*.md") if path.stem not in {*named, "index"})
        text = text.replace("@others", "\n".join(others))
    if page == "commands":
        text = text.replace("<!-- help -->", _helps())
    source[0] = text


NUMBER = re.compile(r"(?<=\d) (?=(?:[kmµn]?[gmsJNVAW]|rad|mm|ms|mrad|min|%|J/m|N m|mm/s|rad/s)(?![\w/]))")


SMALL = re.compile(r"(\d[\d.]*e-\d+)")


def _keep_units(app, doctree):
    """In tables no unit is alone in its line, and no number is broken after its minus sign."""
    for entry in doctree.findall(nodes.entry):
        for text in [*entry.findall(nodes.Text)]:
            parts = SMALL.split(NUMBER.sub("\N{NO-BREAK SPACE}", text))
            whole = [nodes.inline("", part, classes=["number"]) for part in parts]
            text.parent.replace(text, [whole[k] if k % 2 else nodes.Text(part) for k, part in enumerate(parts)])


def _helps():
    """What each command says of itself, in as many columns as a page has room for."""
    os.environ["COLUMNS"] = "88"
    parser = featherstone_gait.cli._parser()
    (commands,) = (each.choices for each in parser._actions if isinstance(each.choices, dict))
    return "\n".join(f"## {name}\n\n```text\n{each.format_help()}```\n" for name, each in commands.items())


FIELD = re.compile(r"^    (\w+): [^#\n]*?(?:#\s*(.*))?$", re.MULTILINE)


def _docstring(app, what, name, thing, options, lines):
    """Turn plain text into reStructuredText; a class that lists no attributes gets its fields with their comments."""
    base = None  # indentation of the line that introduces a literal block
    for k, line in enumerate(lines):
        if base is None or (line.strip() and _indent(line) <= base):
            after = lines[k + 1 :] or [""]
            block = next(filter(str.strip, after), "")
            literal = line.endswith(":") and not after[0].strip() and _indent(block) > _indent(line)
            lines[k], base = _plain(line) + ":" * literal, _indent(line) if literal else None
    if what == "class" and "Attributes" not in lines:
        lines += _fields(thing)


def _indent(line):
    return len(line) - len(line.lstrip())


def _plain(line):
    """What is no markup stays as it is; `names` are code."""
    parts = re.split(r"(``.*?``|`[^`]*`)", line)
    escaped = [p if p.startswith("`") else re.sub(r"([*|\\])|_(?=\W|$)", r"\\\g<0>", p) for p in parts]
    return "".join(escaped)


def _fields(thing):
    """The fields of a dataclass or a NamedTuple, in its order, with what is said beside them."""
    names = [*getattr(thing, "__dataclass_fields__", ()), *getattr(thing, "_fields", ())]
    said = dict(FIELD.findall(inspect.getsource(thing))) if names else {}
    shown = [name for name in names if said.get(name)]
    return ["", *(line for name in shown for line in (f"``{name}``", f"    {_plain(said[name])}"))]


def _signature(app, what, name, thing, options, signature, returned):
    """Names of types as they are written; a default that is a lambda as `...`."""
    signature = signature and signature.replace("<function <lambda>>", "...")
    return signature and (re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", signature), returned)
