"""Paragraphs and tables of generated pages."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from typing import Final

WIDTH: Final = 100


def prose(text: str) -> str:
    """A paragraph, in lines of the usual length."""
    return textwrap.fill(" ".join(text.split()), WIDTH, break_on_hyphens=False) + "\n\n"


def cell(text: object) -> str:
    """``text`` as it may stand in a table."""
    return str(text).replace("|", "\\|").replace("\n", " ")


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table."""
    head = list(head)
    lines = [head, ["---"] * len(head), *([cell(each) for each in row] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
