"""Where each key of a TOML text stands, which ``tomllib`` does not tell."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from typing import TypeAlias

KeyPath: TypeAlias = tuple[str | int, ...]
"""Keys from the outside in, and indices into arrays: ``("line", 0, "devices", 1)``."""

_TOKEN = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}'
    r"|'''.*?'{3,5}"
    r'|"(?:\\.|[^"\\\n])*"'
    r"|'[^'\n]*'"
    r"|\#[^\n]*|\n|[\[\]{},=]|[ \t\r]+|[^\s\[\]{},=\#\"']+",
    re.DOTALL,
)
_OPENING, _CLOSING = ("[", "{"), ("]", "}")


class Positions:
    """The lines, counted from 1, of keys, tables and elements of arrays in ``text``.

    ``text`` is one that tomllib has read.
    """

    def __init__(self, text: str) -> None:
        self._lines: dict[KeyPath, int] = {}
        self._counts: dict[KeyPath, int] = {}  # of arrays of tables: how many there are
        self._table: KeyPath = ()
        for number, tokens in _statements(text):
            words = [token for _, token in tokens]
            if words[0] == "[":
                self._enter_table(number, words)
            else:
                self._add_key(number, tokens)

    def line_of(self, path: KeyPath) -> int:
        """The line of ``path``, or of the innermost thing around it that stands somewhere."""
        while path and path not in self._lines:
            path = path[:-1]
        return self._lines.get(path, 1)

    def _enter_table(self, number: int, words: list[str]) -> None:
        is_array = words[1] == "["
        depth = 2 if is_array else 1
        keys = _keys("".join(words[depth : words.index("]")]))
        path: KeyPath = ()
        for key in keys[:-1]:
            path = self._inner(path, key)
        path = (*path, keys[-1])
        self._lines.setdefault(path, number)
        if is_array:
            self._counts[path] = self._counts.get(path, 0) + 1
        self._table = self._inner(path[:-1], keys[-1])
        self._lines.setdefault(self._table, number)

    def _inner(self, path: KeyPath, key: str) -> KeyPath:
        """What ``key`` in ``path`` is; of an array of tables the last one."""
        path = (*path, key)
        return (*path, self._counts[path] - 1) if path in self._counts else path

    def _add_key(self, number: int, tokens: list[tuple[int, str]]) -> None:
        words = [token for _, token in tokens]
        equals = words.index("=")
        path = (*self._table, *_keys("".join(words[:equals])))
        self._lines[path] = number
        depth = index = 0
        for line, token in tokens[equals + 1 :]:
            if token in _CLOSING:
                depth -= 1
            elif token == "," and depth == 1:
                index += 1
            elif depth == 1 and not token.isspace():
                self._lines.setdefault((*path, index), line)
            if token in _OPENING:
                depth += 1


def _statements(text: str) -> Iterator[tuple[int, list[tuple[int, str]]]]:
    """Each statement of ``text``: its line, and its tokens, comments left out, with theirs."""
    number, depth = 1, 0
    tokens: list[tuple[int, str]] = []
    for token in _TOKEN.findall(text):
        depth += (token in _OPENING) - (token in _CLOSING)
        if token == "\n" and depth == 0:
            if tokens:
                yield tokens[0][0], tokens
            tokens = []
        elif not token.startswith("#") and (tokens or not token.isspace()):
            tokens.append((number, token))
        number += token.count("\n")
    if tokens:
        yield tokens[0][0], tokens


def _keys(text: str) -> tuple[str, ...]:
    """The keys in a dotted one."""
    keys = []
    inner: object = tomllib.loads(f"{text} = 0")
    while isinstance(inner, Mapping):
        ((key, inner),) = inner.items()
        keys.append(key)
    return tuple(keys)
