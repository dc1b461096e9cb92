"""Read XML safely, with the line of every element."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, ParseError
from xml.parsers.expat import errors

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser

from .source import read_bytes

MAX_DEPTH = 64  # of nested elements
DECLARATION = re.compile(rb"<\?xml\s[^>]*\?>")
PREFIX = re.compile(rb"[</\s]([A-Za-z_][\w.-]*):[A-Za-z_][\w.-]*[\s=/>]")
ROOT = re.compile(rb"<[A-Za-z_][\w.-]*")


class Markup(NamedTuple):
    """An XML file."""

    root: Element
    lines: dict[Element, int]  # where each element begins
    doubts: tuple[str, ...] = ()  # what is no well-formed XML, and has one meaning


class _Parser(DefusedXMLParser):
    """A parser that keeps the lines, and refuses entities and document types."""

    def __init__(self) -> None:
        super().__init__(forbid_dtd=True)
        self.lines: dict[Element, int] = {}

    def _start(self, tag: str, attributes: list[str]) -> Element:
        element = super()._start(tag, attributes)
        self.lines[element] = self.parser.CurrentLineNumber
        return element


def read_markup(path: Path) -> Markup:
    """Read an XML file; raise ValueError if it is none, declares entities or nests more than MAX_DEPTH elements.

    An XML declaration below the first line, and prefixes that no xmlns declares, are accepted and reported.
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
                text = f"is not well-formed XML: {error}; correct the syntax there, and give a URDF file"
                raise ValueError(text) from error
            doubts[doubt] = None
        except (ValueError, LookupError) as error:
            raise ValueError(f"has an encoding that cannot be read: {error}; save it as UTF-8") from error
    _check_depth(root)
    _drop_default_namespace(root)
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
    return data, ""


def _check_depth(root: Element) -> None:
    """Refuse deep nesting, level by level, so that no recursion is needed."""
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
        if not level:
            return
    raise ValueError(f"nests <{level[0].tag}> more than {MAX_DEPTH} elements deep; a robot needs far less: flatten it")


def _drop_default_namespace(root: Element) -> None:
    """Strip the default namespace of `<robot xmlns="...">` from every tag."""
    namespace = root.tag[: root.tag.find("}") + 1]
    if namespace:
        for element in root.iter():
            element.tag = element.tag.removeprefix(namespace)
