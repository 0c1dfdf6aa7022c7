"""Where a key stands in a TOML file: ``tomllib`` forgets the lines, a person needs them.

The text has been parsed by ``tomllib`` before, so this reader trusts it to be valid TOML and only keeps count.
"""

from __future__ import annotations

from collections.abc import Mapping

KeyPath = tuple[str | int, ...]


def key_lines(text: str) -> dict[KeyPath, int]:
    r"""First line (from 1) of every table, key and array element of a valid TOML text.

    >>> key_lines("a = 1\n[[b]]\nc = [1,\n2]\n")[("b", 0, "c", 1)]
    4
    """
    return _Reader(text).read()


def nearest_line(lines: Mapping[KeyPath, int], path: KeyPath) -> int | None:
    """Line of the deepest part of ``path`` that stands in the file, None for a path of which nothing does."""
    for depth in range(len(path), 0, -1):
        if path[:depth] in lines:
            return lines[path[:depth]]
    return None


class _Reader:
    """One pass over the text; ``_lines`` fills as keys and elements are met."""

    def __init__(self, text: str) -> None:
        self._text = text.replace("\r\n", "\n") + "\n"
        self._at = 0
        self._line = 1
        self._lines: dict[KeyPath, int] = {}
        self._table_counts: dict[KeyPath, int] = {}

    def read(self) -> dict[KeyPath, int]:
        table: KeyPath = ()
        while self._blank():
            if self._text.startswith("[", self._at):
                table = self._header()
            else:
                self._pair(table)
        return self._lines

    def _move(self, count: int) -> None:
        self._line += self._text.count("\n", self._at, self._at + count)
        self._at += count

    def _blank(self) -> bool:
        """Step over white space and comments; False at the end of the text."""
        while self._at < len(self._text):
            here = self._text[self._at]
            if here == "#":
                self._move(self._text.index("\n", self._at) - self._at)
            elif here.isspace():
                self._move(1)
            else:
                return True
        return False

    def _note(self, path: KeyPath) -> None:
        for depth in range(1, len(path) + 1):
            self._lines.setdefault(path[:depth], self._line)

    def _header(self) -> KeyPath:
        array = self._text.startswith("[[", self._at)
        self._move(2 if array else 1)
        path: KeyPath = ()
        names = self._dotted_key()
        for depth, name in enumerate(names, start=1):
            path = (*path, name)
            if array and depth == len(names):
                count = self._table_counts.get(path, 0)
                self._table_counts[path] = count + 1
                self._note(path)
                path = (*path, count)
            elif path in self._table_counts:  # a table below the latest element of an array of tables
                path = (*path, self._table_counts[path] - 1)
        self._note(path)
        self._blank()
        self._move(2 if array else 1)
        return path

    def _pair(self, table: KeyPath) -> None:
        line = self._line
        path = (*table, *self._dotted_key())
        self._note(path)
        self._lines[path] = line
        self._blank()
        self._move(1)  # =
        self._blank()
        self._value(path)

    def _dotted_key(self) -> list[str]:
        names = [self._simple_key()]
        self._blank()
        while self._text.startswith(".", self._at):
            self._move(1)
            self._blank()
            names.append(self._simple_key())
            self._blank()
        return names

    def _simple_key(self) -> str:
        self._blank()
        start = self._at
        if self._text[start] in "\"'":
            self._string()
            # Escapes in quoted keys are left as written; such a key is unknown to every table anyway.
            return self._text[start + 1 : self._at - 1]
        while self._text[self._at].isalnum() or self._text[self._at] in "-_":
            self._at += 1
        return self._text[start : self._at]

    def _string(self) -> None:
        quote = self._text[self._at]
        marks = quote * 3 if self._text.startswith(quote * 3, self._at) else quote
        self._move(len(marks))
        while not self._text.startswith(marks, self._at):
            self._move(2 if self._text[self._at] == "\\" and quote == '"' else 1)
        self._move(len(marks))
        # up to two quotes may stand right before the closing three
        while len(marks) == 3 and self._text.startswith(quote, self._at):
            self._move(1)

    def _value(self, path: KeyPath) -> None:
        here = self._text[self._at]
        if here in "\"'":
            self._string()
        elif here == "[":
            self._array(path)
        elif here == "{":
            self._inline_table(path)
        else:
            while self._text[self._at] not in ",]}#\n":
                self._move(1)

    def _array(self, path: KeyPath) -> None:
        self._move(1)
        index = 0
        while self._blank() and self._text[self._at] != "]":
            self._note((*path, index))
            self._value((*path, index))
            index += 1
            self._blank()
            if self._text[self._at] == ",":
                self._move(1)
        self._move(1)

    def _inline_table(self, path: KeyPath) -> None:
        self._move(1)
        while self._blank() and self._text[self._at] != "}":
            self._pair(path)
            self._blank()
            if self._text[self._at] == ",":
                self._move(1)
        self._move(1)
