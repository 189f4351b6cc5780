"""A failure in one sentence: what was done, what is admissible, what came.

    After 13h go to position 80, then, 352 ms later, 27h temperature, supply, inputs: expected busy,
    with 70 to 79 increments to go and tolerance 0; came not busy.

What was done is taken from the transcript: what was sent last, the commands before it that are
likely to matter, and what was done to the rig.  A family puts one exchange into words (`Exchange`).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

from axistwin_conformance.base.transcript import Direction, Record

MOST_BEFORE: Final = 3  # commands and acts told before what was sent last
LONGEST_REMARK: Final = 240  # characters: a remark that is a story of its own stands below
LONGEST_VALUE: Final = 160  # characters of one thing expected, or come
AT_ONCE_NS: Final = 50_000_000  # what comes later than that after what was done before, says so
NOTHING: Final[Mapping[str, str]] = {}
BARE_NUMBER: Final = re.compile(r"-?[0-9]+( (to|or) -?[0-9]+)*")
LIST: Final = re.compile(r"\[([^\[\]]*,[^\[\]]*)\]")
PLACE: Final = re.compile(rf"^({BARE_NUMBER.pattern})$|\bposition\b|\brest\b|\bstill -?[0-9]")
RANGE: Final = re.compile(r"(-?[0-9]+(?:\.[0-9]+)?)\.\.(-?[0-9]+(?:\.[0-9]+)?)")
BEGINS: Final = ("check ", "detecting ", "operations begin here")  # marks: nothing before matters
RIG: Final = "rig: "
ACTS: Final = (RIG, "our end of the line ")  # marks of what was done beside sending


class Exchange(NamedTuple):
    """One request, and the reply to it if it was answered.

    `request`: in a few words; empty: not worth any (a receipt).  `is_query`: it changes nothing.
    `quantity`: what a bare number in its answer is.  `answer`: what the fields of the answer say,
    empty where that is a number alone.
    """

    request: str
    is_query: bool = False
    quantity: str = ""
    answer: str = ""


class _Act(NamedTuple):
    time_ns: int
    words: str
    exchange: Exchange = Exchange("")

    @property
    def is_rig(self) -> bool:
        """True for what was done to inputs, supply or shaft."""
        return self.words.startswith(RIG)


Describe = Callable[[bytes, bytes], Exchange]


def sentence(
    records: Sequence[Record],
    describe: Describe,
    expected: Sequence[str],
    actual: str,
    remark: str = "",
    glossary: Mapping[str, str] = NOTHING,
) -> str:
    """Say of a failure what was done, what is admissible and what came; `glossary`: what the
    abbreviations of the manual stand for."""
    acts = _acts(records, describe)
    wanted, came = (
        _spelt(_plain(text), glossary)
        for text in (_either(expected), _short(actual.strip() or "nothing"))
    )
    last = acts[-1].exchange if acts else Exchange("")
    if "increments" in wanted and BARE_NUMBER.fullmatch(came):
        came += " increments"
    elif last.quantity and PLACE.search(wanted):
        wanted, came = (_named(text, last.quantity) for text in (wanted, came))
    if last.answer and last.answer not in came and _is_answered_last(records):
        came += f" ({last.answer})"
    text = f"expected {wanted}; came {came}."
    text = f"After {_done(acts)}: {text}" if acts else text[0].upper() + text[1:]
    return f"{text} {_plain(remark)}." if 0 < len(remark) <= LONGEST_REMARK else text


def _is_answered_last(records: Sequence[Record]) -> bool:
    """True if nothing has come since the reply to what was sent last."""
    last = max(n for n, one in enumerate(records) if one.direction is Direction.HOST)
    return sum(one.direction is Direction.DEVICE for one in records[last:]) == 1


def _either(expected: Sequence[str]) -> str:
    """One of several; readings of one switch are told after its name."""
    names = {one.partition("=")[0] for one in expected}
    if len(expected) > 1 and len(names) == 1 and all("=" in one for one in expected):
        *others, last = (one.partition("=")[2] for one in expected)
        return f"{names.pop()}={', '.join(others)} or {last}"
    return " or ".join(map(_short, expected))


def _short(text: str) -> str:
    """The beginning of what is longer than a sentence; the report has all of it."""
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE].rpartition(' ')[0]} …"


def _spelt(text: str, glossary: Mapping[str, str]) -> str:
    for short, long in glossary.items():
        text = re.sub(rf"(?<![\w=]){short}\b", long, text, count=1)
    return text


def _plain(text: str) -> str:
    """Ranges in words, one value where a range has no more; lists without their brackets."""
    text = LIST.sub(lambda one: one[1].replace("'", ""), text)
    return RANGE.sub(lambda one: one[1] if one[1] == one[2] else f"{one[1]} to {one[2]}", text)


def _named(text: str, quantity: str) -> str:
    return f"{quantity} {text}" if BARE_NUMBER.fullmatch(text) else text


def _done(acts: Sequence[_Act]) -> str:
    """The last act, and those before it that may matter, in their order."""
    *earlier, last = acts
    changes = [act for act in earlier if not act.exchange.is_query and act.words != last.words]
    rows = [list(row) for _, row in itertools.groupby(changes, lambda act: act.words)]
    latest = list({row[0].words: row for row in rows[::-1]}.values())  # the last one first
    before, older = latest[:MOST_BEFORE], latest[MOST_BEFORE:]
    # What was done to the rig matters longer than what was sent.
    if not any(row[0].is_rig for row in before):
        before += [row for row in older if row[0].is_rig][:1]
    before.reverse()
    words = last.words
    if before and (waited_ns := last.time_ns - before[-1][-1].time_ns) > AT_ONCE_NS:
        words = f"{waited_ns / 1e6:.0f} ms later, {words}"
    told = [f"{len(row)} times {row[0].words}" if row[1:] else row[0].words for row in before]
    return ", then ".join([*told, words])


def _acts(records: Sequence[Record], describe: Describe) -> list[_Act]:
    """All that was sent and done since the check, or what is like one, began."""
    acts: list[_Act] = []
    sent, reply = Record(0, Direction.HOST), b""

    def close() -> None:
        exchange = describe(sent.data, reply) if sent.data else Exchange("")
        if exchange.request:
            acts.append(_Act(sent.time_ns, _short(exchange.request), exchange))

    for record in records:
        if record.direction is Direction.DEVICE:
            reply += record.data
        elif record.direction is Direction.HOST:
            close()
            sent, reply = record, b""
        elif record.text.startswith(BEGINS):
            acts.clear()
            sent = Record(0, Direction.HOST)
        elif record.text.startswith(ACTS):
            close()
            sent = Record(0, Direction.HOST)
            acts.append(_Act(record.time_ns, record.text))
    close()
    return acts
