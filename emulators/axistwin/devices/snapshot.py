"""Everything worth showing of a device at one instant: a frozen dataclass per family."""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any


class Snapshot(Mapping[str, Any]):
    """Base of all snapshots; each field can also be had by its name: ``snapshot["address"]``."""

    __slots__ = ()

    def __getitem__(self, name: str) -> Any:
        if name in self.__dataclass_fields__:  # type: ignore[attr-defined]  # of every heir
            return getattr(self, name)
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.__dataclass_fields__)  # type: ignore[attr-defined]

    def __len__(self) -> int:
        return len(fields(self))  # type: ignore[arg-type]
