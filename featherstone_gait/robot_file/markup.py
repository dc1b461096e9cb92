"""XML, read safely, with the line of every element."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, ParseError

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser

from .source import read_bytes

MAX_DEPTH = 64  # of nested elements


class Markup(NamedTuple):
    """An XML file."""

    root: Element
    lines: dict[Element, int]  # where each element begins


class _Parser(DefusedXMLParser):
    """A parser that keeps the lines, and knows neither entities nor document types."""

    def __init__(self) -> None:
        super().__init__(forbid_dtd=True)
        self.lines: dict[Element, int] = {}

    def _start(self, tag: str, attributes: list[str]) -> Element:
        element = super()._start(tag, attributes)
        self.lines[element] = self.parser.CurrentLineNumber
        return element


def read_markup(path: Path) -> Markup:
    """Read an XML file.  Raises ValueError if it is none, declares entities or nests more than MAX_DEPTH elements."""
    data, parser = read_bytes(path), _Parser()
    try:
        parser.feed(data)
        root = parser.close()
    except DefusedXmlException as error:
        raise ValueError(f"declares a document type or entities ({error}); remove the <!DOCTYPE ...>") from error
    except ParseError as error:
        raise ValueError(f"is not well-formed XML: {error}; correct the syntax there, and give a URDF file") from error
    except (ValueError, LookupError) as error:
        raise ValueError(f"has an encoding that cannot be read: {error}; save it as UTF-8") from error
    _check_depth(root)
    _drop_default_namespace(root)
    return Markup(root, parser.lines)


def _check_depth(root: Element) -> None:
    """Refuse deep nesting, level by level, so that no recursion ever meets it."""
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
        if not level:
            return
    raise ValueError(f"nests <{level[0].tag}> more than {MAX_DEPTH} elements deep; a robot needs far less: flatten it")


def _drop_default_namespace(root: Element) -> None:
    """`<robot xmlns="...">` puts every tag into a namespace; strip that one and no other."""
    namespace = root.tag[: root.tag.find("}") + 1]
    if namespace:
        for element in root.iter():
            element.tag = element.tag.removeprefix(namespace)
