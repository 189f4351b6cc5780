"""Golden exchanges: what a manual, or the ledger, writes out byte for byte."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Generic, TypeVar

from axistwin_conformance.base.ledger import family_folder

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class GoldenExchange(Generic[T]):
    """A worked example of a manual, corrected: what is sent, and the reply."""

    name: str
    request: T
    reply: T
    requirements: tuple[str, ...]


@cache
def golden_rows(family: str) -> tuple[Mapping[str, Any], ...]:
    """The exchanges in a family's `golden/exchanges.toml`, as they are written there."""
    path = family_folder(family) / "golden" / "exchanges.toml"
    return tuple(tomllib.loads(path.read_text(encoding="utf-8"))["exchange"])


def golden_exchanges(family: str, read: Callable[[str], T]) -> tuple[GoldenExchange[T], ...]:
    """The examples of a family; `read` makes of their text what the family sends and receives."""
    return tuple(
        GoldenExchange(
            row["name"], read(row["request"]), read(row["reply"]), tuple(row["requirements"])
        )
        for row in golden_rows(family)
    )
