"""Faults drawn by a machine: which part of a device is wrong, in which way, and when."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from sweeping.formats import Format

MS = 1_000_000
Change = Callable[[int, int], int]  # number, its bits → another, which is then cut to the bits


def signed(number: int, bits: int) -> int:
    """As two's complement."""
    return number - (1 << bits) if number >> (bits - 1) else number


def _clamped(number: int, bits: int, kept: int) -> int:
    most = (1 << (kept - 1)) - 1
    return max(-most - 1, min(most, signed(number, bits)))


def _sign_and_magnitude(number: int, bits: int) -> int:
    value = signed(number, bits)
    return abs(value) | (1 << (bits - 1) if value < 0 else 0)


CHANGES: Final[Mapping[str, Change]] = {
    "one more": lambda number, bits: number + 1,
    "one less": lambda number, bits: number - 1,
    "16 more": lambda number, bits: number + 16,
    "its negative": lambda number, bits: -number,
    "its complement": lambda number, bits: ~number,
    "sign and magnitude": _sign_and_magnitude,
    "without sign": lambda number, bits: abs(signed(number, bits)),
    "half of it": lambda number, bits: signed(number, bits) // 2,
    "twice": lambda number, bits: number * 2,
    "a tenth more": lambda number, bits: signed(number, bits) * 11 // 10,
    "bytes reversed": lambda number, bits: int.from_bytes(number.to_bytes(bits // 8), "little"),
    "8 bits of it": lambda number, bits: number & 0xFF,
    "15 bits of it": lambda number, bits: number & 0x7FFF,
    "16 bits of it": lambda number, bits: number & 0xFFFF,
    "16 bits and their sign": lambda number, bits: signed(number & 0xFFFF, 16),
    "24 bits and their sign": lambda number, bits: signed(number & 0xFFFFFF, 24),
    "at most 16 bits": lambda number, bits: _clamped(number, bits, 16),
    "at most 8 bits": lambda number, bits: _clamped(number, bits, 8),
    "0": lambda number, bits: 0,
    "all ones": lambda number, bits: -1,
}


@dataclass(frozen=True, slots=True)
class When:
    """Of the messages that a fault is about: each `every`th, from number `first` on."""

    every: int = 1
    first: int = 0

    def __str__(self) -> str:
        told = "" if self.every == 1 else f", one in {self.every}"
        return told + (f", from number {self.first} on" if self.first else "")

    def is_due(self, number: int) -> bool:
        """Whether that message, from 0, is hit."""
        return number >= self.first and (number - self.first) % self.every == self.every - 1


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing wrong.

    `part`: of the device, a key of `PARTS`.  `kinds`: of requests; empty: all.  `how`: in which
    way.  `at`, `size`: the place in what is said, in bytes; `amount`: bits, ns, or bytes.
    `above`: only numbers of at least that.
    """

    part: str
    how: str
    kinds: tuple[str, ...] = ()
    when: When = When()
    at: int = 0
    size: int = 0
    amount: int = 0
    above: int = 0

    def __str__(self) -> str:
        whose = f" of {self.kinds[0]}" if self.kinds else ""
        whose = " of all commands" if len(self.kinds) > 1 else whose
        size = f"+{self.size}" if self.size else ""
        place = f" at {self.at}{size}" if self.at or self.size else ""
        amount = f" ({self.amount})" if self.amount else ""
        above = f", from {self.above} on" if self.above else ""
        return f"{self.part}{whose}{place}: {self.how}{amount}{above}{self.when}"

    def concerns(self, kind: str) -> bool:
        """Whether it is about requests of that kind."""
        return kind in self.kinds if self.kinds else bool(kind)

    def changed(self, values: bytes) -> bytes:
        """The values with the wrong one; the same if it is not there, or not hit."""
        size = min(self.size or len(values), len(values))
        if not size:
            return values
        at = self.at % (len(values) - size + 1)
        number = int.from_bytes(values[at : at + size])
        bits = 8 * size
        if abs(signed(number, bits)) < self.above:
            return values
        wrong = CHANGES[self.how](number, bits) % (1 << bits)
        return values[:at] + wrong.to_bytes(size) + values[at + size :]


Draw = Callable[[random.Random, Format], Fault]


def _when(draw: random.Random) -> When:
    if draw.random() < 0.8:
        return When()
    if draw.random() < 0.5:
        return When(every=draw.choice((2, 3, 7, 20)))
    return When(first=draw.choice((5, 20, 60, 200)))


def _kinds(
    draw: random.Random, known: tuple[str, ...], every: tuple[str, ...] = ()
) -> tuple[str, ...]:
    """One of those known, or `every` one."""
    return every if draw.random() < 0.25 else (draw.choice(known),)


def _field(draw: random.Random, part: str, known: tuple[str, ...]) -> Fault:
    at, size = draw.choice(((0, 4), (0, 4), (0, 2), (2, 2), (0, 1), (1, 1), (2, 1), (3, 1), (9, 4)))
    above = draw.choice((0, 0, 0, 0x80, 0x100, 0x8000, 0x10000))
    if above >> (8 * size - 1):  # never so large
        above = 0
    how = draw.choice(tuple(CHANGES))
    return Fault(part, how, _kinds(draw, known), _when(draw), at, size, above=above)


def _answer_field(draw: random.Random, form: Format) -> Fault:
    return _field(draw, "value of an answer", form.queries)


def _request_field(draw: random.Random, form: Format) -> Fault:
    return _field(draw, "value that is understood", form.commands)


def _reply_byte(draw: random.Random, form: Format) -> Fault:
    how = draw.choice(("bits flipped", "bits flipped, sum right", "dropped", "doubled", "zero"))
    kinds = _kinds(draw, form.commands + form.queries)
    amount = draw.choice((*(1 << bit for bit in range(8)), 0xFF, draw.randrange(1, 256)))
    return Fault("byte of a reply", how, kinds, _when(draw), draw.randrange(-4, 20), amount=amount)


def _reply_flow(draw: random.Random, form: Format) -> Fault:
    how = draw.choice(
        ("late", "lost", "twice", "that of the one before", "always the first", "cut short",
         "longer", "broken by a pause", "before the one that is due", "unasked too")
    )  # fmt: skip
    amount = 0
    if how in ("late", "broken by a pause", "unasked too"):
        # A reply has half a second: what is late by less breaks nothing.
        amount = draw.choice((3, 20, 300, 1200) if how == "unasked too" else (600, 1200)) * MS
    elif how in ("cut short", "longer"):
        amount = draw.choice((1, 2, 3, 8))
    kinds = _kinds(draw, form.commands + form.queries)
    return Fault("reply", how, kinds, _when(draw), amount=amount)


def _effect(draw: random.Random, form: Format) -> Fault:
    how = draw.choice(
        ("none", "twice", "late", "that of the one before", "none, no reply", "refused")
    )
    amount = draw.choice((30, 100, 400)) * MS if how in ("twice", "late") else 0
    kinds = _kinds(draw, form.commands, form.commands)
    return Fault("effect", how, kinds, _when(draw), amount=amount)


def _other_effect(draw: random.Random, form: Format) -> Fault:
    mine, other = draw.sample(form.commands, 2)
    return Fault("effect", f"that of {other}", (mine,), _when(draw))


def _state(draw: random.Random, form: Format) -> Fault:
    when = When(first=draw.choice((10, 50, 150)), every=draw.choice((1_000_000, 40, 7)))
    return Fault("state", "lost", _kinds(draw, form.commands + form.queries), when)


def _clock(draw: random.Random, form: Format) -> Fault:
    rate = draw.choice((500, 900, 960, 990, 1010, 1040, 1100, 2000))
    return Fault("clock", "thousandths of its rate", amount=rate)


def _inner(draw: random.Random, form: Format) -> Fault:
    how = draw.choice(
        ("one more", "one less", "its negative", "16 bits of it", "twice", "not done")
    )
    return Fault("inside", how, (), _when(draw), at=draw.randrange(1 << 20))


PARTS: Final[Mapping[str, Draw]] = {
    "byte of a reply": _reply_byte,
    "value of an answer": _answer_field,
    "value that is understood": _request_field,
    "reply": _reply_flow,
    "effect": _effect,
    "other effect": _other_effect,
    "state": _state,
    "clock": _clock,
    "inside": _inner,
}
WEIGHTS: Final = (3, 3, 3, 3, 2, 1, 1, 1, 4)


def draw_fault(form: Format, seed: str) -> Fault:
    """The fault of that seed."""
    draw = random.Random(seed)
    (part,) = draw.choices(tuple(PARTS), WEIGHTS)
    return PARTS[part](draw, form)
