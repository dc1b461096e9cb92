"""Read XML safely, with the line of every element and numbers as XML Schema and C write them; write XML.

An element that is read keeps what of it a reader has asked for; `unread` yields the rest, which is left out.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, ParseError, TreeBuilder
from xml.parsers.expat import errors

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser

from .source import read_bytes

Vector = tuple[float, float, float]

SIMILAR = 0.8  # from here on a name is taken for a misspelled one (difflib's ratio)
MAX_DEPTH = 256  # of nested elements; one a link of a chain in MJCF
MAX_NUMBER = 1e30  # in a robot file, so that no product of masses and lengths overflows
DECLARATION = re.compile(rb"<\?xml\s[^<>]*\?>")
PREFIX = re.compile(rb"[</\s]([A-Za-z_][\w.-]*):[A-Za-z_][\w.-]*[\s=/>]")
COMMENT = re.compile(rb"<!--(.*?)-->", re.DOTALL)
ROOT = re.compile(rb"<[A-Za-z_][\w.-]*")
NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")  # what strtod reads in the C locale


class Read(Element):
    """An element that keeps which attributes and children a reader has asked it for.

    under: an element whose attributes count where this one has none of their names; whole: whether a reader has said
    what becomes of all of it.
    """

    under: Element | None = None
    whole = False

    def __init__(self, tag: str, attributes: dict[str, str] | None = None) -> None:
        super().__init__(tag, attributes or {})
        self.names: dict[str, None] = {}  # of attributes
        self.tags: dict[str, bool] = {}  # of children, and whether all of them count or the first alone

    def get(self, name: str, default: Any = None) -> Any:
        """Return an attribute."""
        self.names[name] = None
        below = default if self.under is None else self.under.get(name, default)
        return super().get(name, below)

    def find(self, tag: str, namespaces: Any = None) -> Any:
        """Return the first child of a tag."""
        self.tags.setdefault(tag, False)
        return super().find(tag)

    def iterfind(self, tag: str, namespaces: Any = None) -> Any:
        """Return the children of a tag."""
        self.tags[tag] = True
        return super().iterfind(tag)

    def findall(self, tag: str, namespaces: Any = None) -> Any:
        """Return the children of a tag as a list."""
        return [*self.iterfind(tag)]


def children(element: Element, tags: Iterable[str]) -> list[Element]:
    """Return the children of some tags."""
    tags = {*tags}
    if isinstance(element, Read):
        element.tags |= dict.fromkeys(tags, True)
    return [child for child in element if child.tag in tags]


def unread(element: Element) -> Iterator[tuple[Read, str, Element | None]]:
    """Yield what no reader has asked for: an element and its attribute, or an element and its child."""
    if not isinstance(element, Read) or element.whole:
        return
    yield from ((element, name, None) for name in element.attrib if name not in element.names)
    for child in element:
        if child.tag in element.tags:
            yield from unread(child)
        else:
            yield element, str(child.tag), child


def meant(name: str, asked: Iterable[str]) -> str:
    """Return which of the names that a reader has asked for a misspelled one is like; empty for none."""
    return next(iter(difflib.get_close_matches(name[:40], [*asked], 1, SIMILAR)), "")


class Markup(NamedTuple):
    """An XML file."""

    root: Element
    lines: dict[Element, int]  # where each element begins
    doubts: tuple[str, ...] = ()  # what is no well-formed XML, and has one meaning


class _Parser(DefusedXMLParser):
    """A parser that keeps the lines, and refuses entities and document types."""

    def __init__(self) -> None:
        super().__init__(target=TreeBuilder(element_factory=Read), forbid_dtd=True)
        self.lines: dict[Element, int] = {}

    def _start(self, tag: str, attributes: list[str]) -> Element:
        element = super()._start(tag, attributes)
        self.lines[element] = self.parser.CurrentLineNumber
        return element


def read_markup(path: Path) -> Markup:
    """Read an XML file; raise ValueError if it is none, declares entities or nests more than MAX_DEPTH elements.

    An XML declaration below the first line, prefixes that no xmlns declares, and hyphens in a row within comments are
    accepted and reported.
    """
    data, doubts = read_bytes(path), dict[str, None]()
    while True:
        parser = _Parser()
        try:
            parser.feed(data)
            root = parser.close()
            break
        except DefusedXmlException as error:
            raise ValueError(f"declares a document type or entities ({error}); remove the <!DOCTYPE ...>") from error
        except ParseError as error:
            data, doubt = _mended(data, error.code)
            if not doubt or doubt in doubts:
                text = f"is not well-formed XML: {error}; correct the syntax there"
                raise ValueError(text) from error
            doubts[doubt] = None
        except (ValueError, LookupError) as error:
            raise ValueError(f"has an encoding that cannot be read: {error}; save it as UTF-8") from error
    _check_depth(root)
    namespace = root.tag[: root.tag.find("}") + 1]  # of <robot xmlns="...">
    for child in root.iter() if namespace else ():
        child.tag = child.tag.removeprefix(namespace)
    return Markup(root, parser.lines, tuple(doubts))


def _mended(data: bytes, code: int) -> tuple[bytes, str]:
    """Remove what the parser stumbled over, keeping the lines, and say what it was; "" if that is not known."""
    if code == errors.codes[errors.XML_ERROR_MISPLACED_XML_PI]:
        return DECLARATION.sub(lambda found: b"\n" * found[0].count(b"\n"), data), "skipped <?xml ...?> below line 1"
    if code == errors.codes[errors.XML_ERROR_UNBOUND_PREFIX]:
        names = sorted(set(PREFIX.findall(data)) - {b"xmlns", b"xml"})
        declared = b"".join(b" xmlns:%b='%b'" % (name, name) for name in names if b"xmlns:" + name not in data)
        mended = ROOT.sub(lambda found: found[0] + declared, data, count=1)
        return mended, "took prefixes as declared that no xmlns declares"
    end = data.rfind(b"-->") + 3  # beyond it each "<!--" would be searched to the end of the file
    hyphens = any(b"--" in found[1] for found in COMMENT.finditer(data, 0, end))
    if code == errors.codes[errors.XML_ERROR_INVALID_TOKEN] and hyphens:
        kept = COMMENT.sub(lambda found: b"\n" * found[0].count(b"\n"), data[:end])
        return kept + data[end:], "skipped comments with -- in them"
    return data, ""


def _check_depth(root: Element) -> None:
    """Refuse deep nesting, level by level, so that no recursion is needed."""
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
        if not level:
            return
    raise ValueError(f"nests <{level[0].tag}> more than {MAX_DEPTH} elements deep; a robot needs far less: flatten it")


def vector(element: Element, attribute: str, what: str, default: str = "0 0 0") -> Vector:
    """Return three numbers, or the default if the attribute is missing; raise ValueError for anything else."""
    text = element.get(attribute, default)
    if "$(" in text or "${" in text:
        raise ValueError(f"{what}: <{element.tag}> {attribute}={text!r} is a macro: expand the file with xacro first")
    words = text.split()
    if len(words) != 3:
        raise ValueError(
            f"{what}: <{element.tag}> {attribute}={element.get(attribute)!r} has {len(words)} numbers; "
            "expected 3, separated by spaces: correct it"
        )
    x, y, z = (_parsed(word, f"{what}: <{element.tag}> {attribute}") for word in words)
    return x, y, z


def number(element: Element, attribute: str, what: str, default: float | None = None) -> float:
    """Return a finite number; raise ValueError for anything else, and if the attribute is missing without a default."""
    text = element.get(attribute)
    if text is None:
        if default is None:
            raise ValueError(f"{what}: attribute {attribute!r} of <{element.tag}> is missing; it is required: add it")
        return default
    return _parsed(text.strip(), f"{what}: <{element.tag}> {attribute}")


def number_or_inf(element: Element, attribute: str, what: str) -> float:
    """Return a number that may be infinite; raise ValueError for anything else."""
    word = element.get(attribute, "").strip().lower()
    if word.lstrip("+-") in ("inf", "infinity"):
        return -math.inf if word.startswith("-") else math.inf
    return number(element, attribute, what)


def _parsed(word: str, what: str) -> float:
    """Return a finite number; float() alone would accept 1_0, nan and Arabic digits too."""
    value = float(word) if NUMBER.fullmatch(word) else math.nan
    if not abs(value) <= MAX_NUMBER:
        raise ValueError(
            f"{what} is {word[:40]!r}; expected a number up to {MAX_NUMBER:g}: write it like -0.15 or 2e-3"
        )
    return value


def element(tag: str, attributes: Mapping[str, Any], inside: Iterable[str] = ()) -> list[str]:
    """Write the lines of an element, without attributes that are None; numbers read back the same."""
    from xml.sax.saxutils import quoteattr  # imports what opens web pages, which reading needs not

    stated = [f" {name}={quoteattr(_text(value))}" for name, value in attributes.items() if value is not None]
    start, lines = f"<{tag}{''.join(stated)}", [f"  {line}" for line in inside]
    return [f"{start}>", *lines, f"</{tag}>"] if lines else [f"{start}/>"]


def _text(value: Any) -> str:
    """Write text, a number, or an array of numbers separated by spaces."""
    return value if isinstance(value, str) else " ".join(repr(float(x)) for x in np.ravel(value))


def comment(text: str) -> str:
    """Write <!-- text -->, without the two hyphens in a row that XML forbids in it."""
    return f"<!-- {re.sub('-(?=-)', '- ', text)} -->"
