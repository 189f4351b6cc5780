"""Types of click for options that take numbers: an address, a count, a span."""

from __future__ import annotations

from typing import Any

import click


class Address(click.ParamType[int]):
    """An address: decimal, 0x7F or 7Fh."""

    name = "address"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Read the number; the family checks the range."""
        text = str(value).strip().lower()
        try:
            return int(text[:-1], 16) if text.endswith("h") else int(text, 0)
        except ValueError:
            self.fail(f"{value!r} is no address: write 5, 0x05 or 05h", param, ctx)


class Count(click.ParamType[int]):
    """A whole number between two bounds, both meant."""

    name = "count"

    def __init__(self, lowest: int, highest: int) -> None:
        self.lowest, self.highest = lowest, highest

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Read it; whatever else was written is a mistake."""
        bounds = f"{self.lowest} to {self.highest}"
        try:
            number = int(value)
        except ValueError:
            self.fail(f"{value!r} is no whole number: choose one of {bounds}", param, ctx)
        if not self.lowest <= number <= self.highest:
            self.fail(f"{value} is out of range: choose {bounds}", param, ctx)
        return number


class Span(click.ParamType[range]):
    """FIRST-LAST, both meant; one number alone is a span of its own."""

    name = "span"

    def __init__(self, highest: int) -> None:
        self.highest = highest

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> range:
        """Read it; the highest number there can be is known here."""
        first, dash, last = str(value).partition("-")
        if not first or (dash and not last):
            self.fail(f"{value!r} is no span: write FIRST-LAST within 0-{self.highest}", param, ctx)
        low = Address().convert(first, param, ctx)
        high = Address().convert(last, param, ctx) if dash else low
        if low > high:
            self.fail(f"{value!r} runs backwards: write {last}-{first}", param, ctx)
        if not 0 <= low <= high <= self.highest:
            self.fail(f"{value!r} is no span: write FIRST-LAST within 0-{self.highest}", param, ctx)
        return range(low, high + 1)
