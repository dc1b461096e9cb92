"""Find the lines of keys in TOML text, which the reader of Python does not tell."""

from __future__ import annotations

import re
import tomllib
from typing import Any

_BLANK = re.compile(r"(?:[ \t\r]|#[^\n]*)*")
_SPACE = re.compile(r"(?:\s|#[^\n]*)*")
_PART = re.compile(r"""[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'""")
_VALUE = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}|'  # a text of several lines
    r"'''.*?'{3,5}|"
    r'"(?:[^"\\\n]|\\.)*"|'
    r"'[^'\n]*'|"
    r"[^\s,\]}#]+(?: [0-9:.]+)?",  # a number, a truth value, or a date, which may have a space before its time
    re.DOTALL,
)


class Table(dict[str, Any]):
    """A table of a file, with its line, and the lines of its keys."""

    def __init__(self, line: int = 0) -> None:
        super().__init__()
        self.line, self.lines = line, dict[str, int]()


def with_lines(content: dict[str, Any], text: str) -> Table:
    """Return the content of TOML text with the lines of all keys; its tables, also those in lists, are `Table`."""
    lines = _Scanner(text.replace("\r\n", "\n")).document()
    return _table(content, lines, ())


def _table(content: dict[str, Any], lines: dict[tuple, int], path: tuple) -> Table:
    table = Table(lines.get(path, 0))
    for key, value in content.items():
        table.lines[key] = lines.get((*path, key), table.line)
        table[key] = _valued(value, lines, (*path, key))
    return table


def _valued(value: Any, lines: dict[tuple, int], path: tuple) -> Any:
    if isinstance(value, dict):
        return _table(value, lines, path)
    if isinstance(value, list):
        return [_valued(item, lines, (*path, k)) for k, item in enumerate(value)]
    return value


class _Scanner:
    """Walk through text that is known to be TOML."""

    def __init__(self, text: str) -> None:
        self.text, self.at, self.line = text, 0, 1
        self.lines: dict[tuple, int] = {}
        self.counts: dict[tuple, int] = {}  # of tables in the arrays of [[...]]

    def document(self) -> dict[tuple, int]:
        """Return the line of each path of keys and places in lists."""
        prefix: tuple = ()
        self._skip(_SPACE)
        while self.at < len(self.text):
            if self.text.startswith("[", self.at):
                prefix = self._header()
            else:
                self._pair(prefix)
            self._skip(_SPACE)
        return self.lines

    def _skip(self, pattern: re.Pattern[str]) -> str:
        """Go past what a pattern matches; return it."""
        found = pattern.match(self.text, self.at)
        matched = found[0] if found else ""
        self._go(len(matched))
        return matched

    def _go(self, count: int) -> None:
        self.line += self.text.count("\n", self.at, self.at + count)
        self.at += count

    def _key(self) -> list[str]:
        parts = []
        while True:
            self._skip(_BLANK)
            part = self._skip(_PART)
            parts.append(next(iter(tomllib.loads(f"{part} = 0"))))
            self._skip(_BLANK)
            if not self.text.startswith(".", self.at):
                return parts
            self._go(1)

    def _set(self, prefix: tuple, parts: list[str], line: int) -> tuple:
        """Give lines to a path and, where they have none, to those above it; return it with places in arrays."""
        for k, part in enumerate(parts, start=1):
            prefix = (*prefix, part)
            if k < len(parts) and prefix in self.counts:
                prefix = (*prefix, self.counts[prefix] - 1)
            self.lines.setdefault(prefix, line)
        return prefix

    def _header(self) -> tuple:
        line, width = self.line, 2 if self.text.startswith("[[", self.at) else 1
        self._go(width)
        path = self._set((), self._key(), line)
        self._go(width)
        if width == 2:
            self.counts[path] = self.counts.get(path, 0) + 1
            path = (*path, self.counts[path] - 1)
        self.lines[path] = line
        return path

    def _pair(self, prefix: tuple) -> None:
        line = self.line
        path = self._set(prefix, self._key(), line)
        self.lines[path] = line
        self._go(1)  # the sign =
        self._value(path)

    def _value(self, path: tuple) -> None:
        self._skip(_SPACE)
        self.lines.setdefault(path, self.line)
        start = self.text[self.at : self.at + 1]
        if start not in ("[", "{"):
            if not self._skip(_VALUE):
                self._go(1)
            return
        self._go(1)
        self._skip(_SPACE)
        count = 0
        while self.text[self.at : self.at + 1] not in "]}":
            if start == "[":
                self._value((*path, count))
            else:
                self._pair(path)
            count += 1
            self._skip(_SPACE)
            if self.text.startswith(",", self.at):
                self._go(1)
                self._skip(_SPACE)
        self._go(1)
