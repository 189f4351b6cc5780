"""A failure in one sentence: what the device did, under which condition, and what is expected.

    After 0Bh (position counter reset), 20h (position) read 37 increments; expected 0 increments.

A check that knows best says so itself (`Observation`).  Otherwise what was sent last is named, and
of all before it what is likely to have led there: the last thing that changed something, and what
was done to the rig.  The rest stands in the transcript.  A family puts one exchange into words
(`Exchange`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from itertools import pairwise
from typing import Final, NamedTuple

from axistwin_conformance.base.errors import counted
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.base.verdicts import Finding, Verdict

LONGEST_REMARK: Final = 240  # characters: a remark that is a story of its own stands below
LONGEST_VALUE: Final = 160  # characters of one thing expected, or seen
AT_ONCE_NS: Final = 50_000_000  # what comes later than that after its cause, says so
NOTHING: Final[Mapping[str, str]] = {}
REQUEST: Final = "{request}"  # in an observation: the request that is judged, in words
WAITED: Final = "{waited}"  # and how long was waited for a reply in vain
WAITED_MS: Final = re.compile(r"[0-9.]+ ms")
BARE_NUMBER: Final = re.compile(r"-?[0-9]+( (to|or) -?[0-9]+)*")
LIST: Final = re.compile(r"\[([^\[\]]*,[^\[\]]*)\]")
BYTE: Final = re.compile(r"[0-9A-F]{2}")
POSITION_LIKE: Final = re.compile(
    rf"^({BARE_NUMBER.pattern})$|\bposition\b|\brest\b|\bstill -?[0-9]"
)
RANGE: Final = re.compile(r"(-?[0-9]+(?:\.[0-9]+)?)\.\.(-?[0-9]+(?:\.[0-9]+)?)")
SEQUENCE: Final = "operations begin here"
BEGINS: Final = ("check ", "detecting ", SEQUENCE)  # marks: nothing before matters
SHORT_SEQUENCE: Final = 5  # operations that are all told: they have been shrunk to those it takes
RIG: Final = "rig: "
ACTS: Final = (RIG, "our end of the line ")  # marks of what was done beside sending
POWER_OFF: Final = "the power was switched off"
POWER_ON: Final = "the power was switched on"
POWER_CYCLE: Final = "a power cycle"


STARTS_IN_NS: Final = 1_000_000_000  # until a move to where a check began is over, at least
SLOWEST_INCREMENT_NS: Final = 10_000_000
LONGEST_MOVE_NS: Final = 2_500_000_000  # until one that was made earlier is over
ONE_EXCHANGE: Final = 4  # records, at most: a note, a request, its reply and a receipt
MOST_BY_HAND: Final = 12  # requests; more, nobody pastes
ACKNOWLEDGED: Final = "not with 'axistwin send', which acknowledges every reply: use the line above"
WORKED: Final = "not with 'axistwin send' alone: the device has to be worked as well, in this order"


class Effect(Enum):
    """What a request does to a device."""

    NOTHING = auto()  # it asks
    VALUE = auto()  # it stores a value and starts nothing
    HOLD = auto()  # the motion that follows waits
    START = auto()  # what waits begins
    MOTION = auto()  # the axis moves from then on, so that it matters how long ago it was
    STOP = auto()
    OTHER = auto()


MOVING: Final = (Effect.MOTION, Effect.START, Effect.STOP)


# Parts of the state of a device that no check leaves to the next one.
RUNNING: Final = "motion"
PLACE: Final = "position"
POWERED: Final = "motor"
FLEETING: Final = frozenset({RUNNING, PLACE, POWERED})
AS_AT_START: Final = ""  # the value of what is as after switching on
UNTOUCHED: Final[Mapping[str, str | None]] = {}


class Exchange(NamedTuple):
    """One request, and the reply to it if it was answered.

    `request`: in a few words; empty: not worth any (a receipt).  `effect`: on the device.
    `quantity`: what a bare number in its answer is.  `answer`: what the answer says, by its fields
    if it has any.  `is_altered`: not as a host sends it that means well (a reply refused).
    `is_refused`: the device says that it has not done it.

    Of the state of the device, by name: `sets`, what it changes, and to which value (None: from
    what it was before); `needs`, what the reply depends on; both None: that is not known.  `shows`,
    which values the reply tells.
    """

    request: str
    effect: Effect = Effect.OTHER
    quantity: str = ""
    answer: str = ""
    is_altered: bool = False
    is_refused: bool = False
    sets: Mapping[str, str | None] | None = None
    needs: frozenset[str] | None = None
    shows: Mapping[str, str | None] = UNTOUCHED

    @property
    def is_query(self) -> bool:
        """True if it changes nothing."""
        return self.effect is Effect.NOTHING


@dataclass(frozen=True, slots=True)
class Observation:
    """What a device did, as a clause with its actor: ``{request} was accepted (06 13 1A)``.

    `clause`: may hold `REQUEST` and `WAITED`.  `value`: the same in the report, beside what is
    expected there; empty: the clause.  `wanted`: what is expected, in this sentence; empty: as the
    report has it.  `request`: the one that is judged; none: what was sent last.  `causes`: words of
    those requests before it that led there, to be shown beside it.  `is_whole`: the clause names
    the condition that matters; otherwise what led there is put before it, what `causes` names
    included.  `rule`: the one that is applied, where it is not what the requirement says.
    `earlier`: an exchange before this check that the device is held to, under a note that says what
    it showed.
    """

    clause: str
    value: str = ""
    wanted: str = ""
    request: bytes = b""
    causes: tuple[str, ...] = ()
    is_whole: bool = True
    rule: str = ""
    earlier: tuple[Record, ...] = ()
    by_hand: str = ""

    def __str__(self) -> str:
        return self.value or self.clause.replace(REQUEST, "the request").replace(WAITED, "")


class Telling(NamedTuple):
    """A failure in words: the sentence, and which of the records (by number) decided.

    `by_hand`: those that were sent, and have to be sent again to see it again, and what was done to
    the rig between them.  `no_hand`: why sending is not enough.  `before`: what brings a device to
    the state in which it was before the first of them.
    """

    sentence: str
    decisive: tuple[int, ...]
    by_hand: tuple[int, ...] = ()
    no_hand: str = ""
    before: tuple[Record, ...] = ()

    def finding(
        self,
        requirement: str,
        expected: Sequence[str],
        actual: object,
        text: str,
        records: Sequence[Record],
        most: int,
    ) -> Finding:
        """The failure with the end of the transcript, of what was before that the records that
        matter, and the exchange that the device is held to."""
        end = range(max(0, len(records) - most), len(records))
        kept = sorted({*end, *self.decisive, *self.by_hand})
        seen = actual if isinstance(actual, Observation) else Observation("")
        before = seen.earlier
        if before and kept:
            time_ns = records[kept[0]].time_ns
            before = (*before, Record(time_ns, Direction.NOTE, text="in this check:"))
        place = {number: at for at, number in enumerate(kept, len(before))}
        return Finding(
            requirement, Verdict.FAIL, text, tuple(expected), str(actual),
            (*before, *(records[number] for number in kept)), self.sentence,
            (*range(len(before)), *(place[number] for number in self.decisive)),
            (*self._first_by_hand(before), *(place[number] for number in self.by_hand)),
            self.no_hand, self.before, seen.rule,
        )  # fmt: skip

    def _first_by_hand(self, before: Sequence[Record]) -> Iterable[int]:
        """The requests of the exchange that the device is held to; a receipt is none."""
        requests = (n for n, one in enumerate(before) if one.direction is Direction.HOST)
        return (n for n in requests if len(before[n].data) > 1) if self.by_hand else ()


class _Act(NamedTuple):
    """What was sent, or done to the rig; `first` and `last`: its records, with what came of it."""

    time_ns: int
    words: str
    first: int
    last: int
    exchange: Exchange = Exchange("")
    data: bytes = b""

    @property
    def is_rig(self) -> bool:
        """True for what was done to inputs, supply or shaft."""
        return not self.data


Describe = Callable[[bytes, bytes], Exchange]


def telling(
    records: Sequence[Record],
    describe: Describe,
    expected: Sequence[str],
    actual: object,
    remark: str = "",
    glossary: Mapping[str, str] = NOTHING,
    history: Callable[[], Sequence[Record]] = tuple,
) -> Telling:
    """Say of a failure what the device did and what is expected; `glossary`: what the
    abbreviations of the manual stand for; `history`: all that was said in this run."""
    acts = _acts(records, describe)
    seen = actual if isinstance(actual, Observation) else None
    judged = acts[-1] if acts else None
    if seen is not None and seen.request:
        judged = next((act for act in reversed(acts) if act.data == seen.request), judged)
    wanted = _plain(seen.wanted) if seen and seen.wanted else ""
    wanted = wanted or _spelt(_plain(_either(expected)), glossary)
    begins = [one.text for one in records if one.text.startswith(BEGINS)]
    is_sequence = bool(begins) and begins[-1].startswith(SEQUENCE)
    before = acts[: acts.index(judged)] if judged else []
    causes = _causes(before, judged, is_sequence=is_sequence) if judged else []
    if seen is not None:
        clause = _clause(seen.clause, judged, records)
        named = [act for act in (_latest(acts, words) for words in seen.causes) if act is not None]
        if seen.is_whole:
            causes = [*(act for act in causes if act.is_rig), *named]
        else:
            chosen = {act.first: act for act in (*causes, *named)}
            causes = [act for _, act in sorted(chosen.items())]
    else:
        value = _as_expected(_plain(_short(str(actual).strip() or "nothing")), expected, glossary)
        value = _spelt(value, glossary)
        clause, wanted = _generic(judged, value, wanted, records)
    if causes and not (seen and seen.is_whole):
        assert judged is not None
        clause = f"{_condition(causes, judged)}, {clause}"
    rest = f" ({_plain(remark)})" if 0 < len(remark) <= LONGEST_REMARK else ""
    text = f"{clause}; expected {wanted}{rest}." if wanted else f"{clause}{rest}."
    decisive = _decisive(causes, judged, records)
    by_hand, no_hand, needs = _by_hand(acts, judged, causes)
    no_hand = no_hand or (seen.by_hand if seen else "")
    sent = [act for act in acts if act.first in by_hand]
    led = state_before(acts, sent, needs, describe, history) if by_hand else ()
    return Telling(text[0].upper() + text[1:], decisive, by_hand, no_hand, led)


def shown_exchange(
    records: Sequence[Record], describe: Describe, causes: Sequence[str] = ()
) -> tuple[Record, ...]:
    """The last question of these records with its answer, and what led there, which `causes` name:
    an observation without a judgement."""
    acts = _acts(records, describe)
    asked = [act for act in acts if act.exchange.is_query] or acts
    if not asked:
        return ()
    shown = asked[-1]
    for act in reversed(acts[: acts.index(shown)]):  # it stood there before it was told to stop
        is_same = (act.data, act.exchange) == (shown.data, shown.exchange)
        if not is_same and act.exchange.effect is not Effect.STOP:
            break
        shown = act if is_same else shown
    before = acts[: acts.index(shown)]
    named = [_latest(before, words) for words in causes]
    led = [*_causes(before, shown), *(act for act in named if act is not None)]
    return tuple(records[number] for number in _decisive(led, shown, records))


def asked_in(earlier: Sequence[Record], describe: Describe) -> str:
    """`` (at RFLAG 256)``: the request of an earlier exchange, if it is short; otherwise empty."""
    asked = (describe(record.data, b"").request for record in earlier if record.data)
    question = next(filter(None, asked), "") if len(earlier) <= ONE_EXCHANGE else ""
    return f" (at {question})" if question else ""


def _clause(clause: str, judged: _Act | None, records: Sequence[Record]) -> str:
    waited = ""
    if judged is not None:
        heard = records[judged.first : judged.last + 1]
        silences = [one.text for one in heard if one.direction is Direction.SILENCE]
        found = WAITED_MS.search(silences[-1]) if silences else None
        waited = f" within {found[0]}" if found else ""
    words = judged.words if judged else "the request"
    return _plain(clause.replace(REQUEST, words).replace(WAITED, waited))


def _generic(
    judged: _Act | None, value: str, wanted: str, records: Sequence[Record]
) -> tuple[str, str]:
    """What was asked last and what was seen; and what is expected, in the same unit."""
    if judged is None:
        return f"seen: {value}", wanted
    exchange = judged.exchange
    if "increments" in wanted and BARE_NUMBER.fullmatch(value):
        value = counted(value, "increment")
    elif exchange.quantity and POSITION_LIKE.search(wanted):
        value, wanted = (_in_increments(text) for text in (value, wanted))
    if exchange.answer and exchange.answer not in value and _is_answered_last(records):
        value += f" ({exchange.answer})"
    is_read = exchange.quantity and re.match(r"-?[0-9]", value)
    return f"{judged.words}{' read ' if is_read else ': '}{value}", wanted


def _in_increments(text: str) -> str:
    text = text.removeprefix("position ")
    return counted(text, "increment") if BARE_NUMBER.fullmatch(text) else text


def _condition(causes: Sequence[_Act], judged: _Act) -> str:
    """``after 10h (wait for synchro), 234 ms after 13h (go to position 76)``."""
    words: list[str] = []
    for number, act in enumerate(causes):
        is_cycle = _is_cycle(causes[number - 1 : number + 1]) if number else False
        words[-is_cycle or len(words) :] = [POWER_CYCLE if is_cycle else act.words]
    waited_ns = judged.time_ns - causes[-1].time_ns
    is_under_way = causes[-1].exchange.effect in MOVING
    is_worth = waited_ns > AT_ONCE_NS or is_under_way
    *others, last = words
    if not is_worth:
        return f"after {', '.join(others)}{' and ' if others else ''}{last}"
    *first, before = others or [""]
    led = f"after {', '.join(first)}{' and ' if first else ''}{before}, " if before else ""
    return f"{led}{waited_ns / 1e6:.0f} ms after {last}"


def _causes(before: Sequence[_Act], judged: _Act, *, is_sequence: bool = False) -> list[_Act]:
    """What is likely to have led to a reply: what was done to the rig, and the last command; what
    only stored a value matters to a query."""
    rigs = [act for act in before if act.is_rig]
    cycle = [n for n in range(2, len(rigs) + 1) if _is_cycle(rigs[n - 2 : n])][-1:]
    worked = [*(rigs[cycle[0] - 2 : cycle[0]] if cycle else []), *rigs[-1:]]
    changes = [
        act
        for act in before
        if not act.is_rig
        and not act.exchange.is_query
        and act.words != judged.words
        and (judged.exchange.is_query or act.exchange.effect is not Effect.VALUE)
    ]
    if judged.is_rig:
        return rigs[-1:]
    if is_sequence and len(changes) <= SHORT_SEQUENCE:
        return [act for act in before if act in worked or act in changes]
    moved = [act for act in changes if act.exchange.effect in (Effect.MOTION, Effect.START)]
    moved = moved[-1:] if judged.exchange.quantity else []
    chosen = {act.first: act for act in (*worked, *changes[-1:], *moved, *_waiting(changes))}
    return [act for _, act in sorted(chosen.items())]


def _waiting(changes: Sequence[_Act]) -> Sequence[_Act]:
    """The last command that makes a motion wait, and that motion, unless they are over."""
    held = [n for n, act in enumerate(changes) if act.exchange.effect is Effect.HOLD][-1:]
    since = changes[held[0] :] if held else ()
    if any(act.exchange.effect in (Effect.START, Effect.STOP) for act in since[:-1]):
        return ()
    return [act for act in since if act.exchange.effect is not Effect.VALUE][:2]


def _is_cycle(acts: Sequence[_Act]) -> bool:
    return [act.words for act in acts] == [POWER_OFF, POWER_ON]


def _decisive(
    causes: Iterable[_Act], judged: _Act | None, records: Sequence[Record]
) -> tuple[int, ...]:
    """The records of these acts, in the order of time."""
    numbers = {number for act in causes for number in range(act.first, act.last + 1)}
    if judged is not None:
        numbers.update(range(judged.first, judged.last + 1))
    return tuple(sorted(numbers, key=lambda number: (records[number].time_ns, number)))


def _by_hand(
    acts: Sequence[_Act], judged: _Act | None, causes: Collection[_Act]
) -> tuple[tuple[int, ...], str, frozenset[str]]:
    """What to send and to do again, all that has changed something since the state was known that
    matters; why sending does not do; and what matters of the state before."""
    if judged is None:
        return (), "", frozenset()
    before = acts[: acts.index(judged)]
    if any(act.exchange.is_altered for act in (*before, judged)):
        return (), ACKNOWLEDGED, frozenset()
    kept, needs = _changing(before, judged, causes)
    steps = {act.first for act in (*kept, *causes)} - {judged.first}
    if len(steps) >= MOST_BY_HAND:
        reason = f"too long to type ({len(steps)} steps before the last one): use the line above"
        return (), reason, frozenset()
    is_worked = any(act.is_rig for act in (*before, judged))
    return (*sorted(steps), judged.first), WORKED if is_worked else "", needs


def _changing(
    before: Sequence[_Act], judged: _Act, causes: Collection[_Act]
) -> tuple[list[_Act], frozenset[str]]:
    """What was done to the rig, and the requests that changed what the last one depends on, or what
    such a request depends on; and what they depend on of the state before.

    What was set anew depends on nothing before that.  What is as after switching on is not brought
    about: neither a stop where nothing moves nor a motor that is powered.
    """
    moved = [act for act in before if act.exchange.effect in (Effect.HOLD, *MOVING[:2])]
    is_all = judged.is_rig or judged.exchange.needs is None
    needs, settled, kept = set(judged.exchange.needs or ()), set[str](), list[_Act]()
    if not needs & FLEETING:  # of several settings that a reply tells, those it is about
        about = {name for act in causes for name in act.exchange.sets or ()}
        needs = needs & about or needs
    for act in reversed(before):
        exchange = act.exchange
        sets = exchange.sets
        is_idle = exchange.effect is Effect.STOP and not (moved and moved[0].first < act.first)
        is_cause = act in causes and not act.is_rig
        if not act.is_rig and not is_cause:
            if exchange.is_query or exchange.is_refused or is_idle:
                continue
            if sets is not None and not (set(sets) - settled if is_all else needs & set(sets)):
                continue
        fixed = {name for name, value in (sets or {}).items() if value is not None}
        if not exchange.is_refused:
            settled |= fixed
            needs -= fixed
        if sets and all(value == AS_AT_START for value in sets.values()) and not is_cause:
            continue
        kept.append(act)
        is_all |= not act.is_rig and exchange.needs is None
        needs |= exchange.needs or set()
    return kept, frozenset(needs)


def state_before(
    acts: Sequence[_Act],
    sent: Sequence[_Act],
    needs: frozenset[str],
    describe: Describe,
    history: Callable[[], Sequence[Record]],
) -> tuple[Record, ...]:
    """What to send first: of what was set earlier in the run all that matters and is not as the run
    has found it, and then, for an axis, the way to where it was when the check began: to
    0 only if what is then `sent` moves it."""
    began_ns = acts[0].time_ns
    shown: dict[str, str | None] = {}
    for act in acts:
        is_known = act.exchange.is_query or act.exchange.sets is not None
        if not is_known or PLACE in (act.exchange.sets or ()):
            break
        shown = {**act.exchange.shows, **shown}
    latest = _set_earlier(history(), describe, began_ns) if needs - FLEETING else {}
    chosen = {
        past.record.time_ns: past
        for name, past in latest.items()
        if name in needs and past.value != past.found and shown.get(name, past.value) == past.value
    }
    steps: list[Record] = []
    has_moved = False
    for _, past in sorted(chosen.items()):
        steps.append(past.record)
        if past.lasts_ns:
            has_moved = True
            steps.append(_typed(f"wait {past.lasts_ns / 1e6:.0f} ms"))
    place = shown.get(PLACE)
    # What is asked at 0 and moves nothing is no reason to move a device.
    has_moved |= any(act.exchange.effect in MOVING[:2] for act in sent)
    if PLACE in needs and place is not None and (has_moved or int(place)):
        lasts_ns = STARTS_IN_NS + abs(int(place)) * SLOWEST_INCREMENT_NS
        steps += [_typed(f"go to {place}"), _typed(f"wait {lasts_ns / 1e6:.0f} ms")]
    return tuple(steps)


class _Past(NamedTuple):
    """The last request that has set a part of the state; `found`: its value when the run began, if
    that was told; `lasts_ns`: how long to wait behind it."""

    record: Record
    value: str | None
    found: str | None
    lasts_ns: int


def _set_earlier(records: Sequence[Record], describe: Describe, until_ns: int) -> dict[str, _Past]:
    """By name, what was set before that time."""
    asked = [n for n, one in enumerate(records) if one.direction is Direction.HOST]
    known: dict[tuple[bytes, bytes], Exchange] = {}
    found: dict[str, str | None] = {}
    latest: dict[str, _Past] = {}
    for number, end in pairwise([*asked, len(records)]):
        record = records[number]
        if record.time_ns >= until_ns:
            break
        reply = b"".join(_replies(records[number:end]))
        exchange = known.get((record.data, reply)) or describe(record.data, reply)
        known[record.data, reply] = exchange
        if not reply or exchange.is_refused:
            continue
        for name, value in exchange.shows.items():
            if name not in latest:
                found.setdefault(name, value)
        lasts_ns = LONGEST_MOVE_NS if exchange.effect is Effect.MOTION else 0
        for name, value in (exchange.sets or {}).items():
            if value is not None:
                latest[name] = _Past(record, value, found.get(name), lasts_ns)
    return latest


def _typed(text: str) -> Record:
    """A step in the words of 'axistwin send'."""
    return Record(0, Direction.NOTE, text=text)


def _latest(acts: Sequence[_Act], words: str) -> _Act | None:
    return next((act for act in reversed(acts) if words in act.words), None)


def _is_answered_last(records: Sequence[Record]) -> bool:
    """True if nothing has come since the reply to what was sent last."""
    last = max(n for n, one in enumerate(records) if one.direction is Direction.HOST)
    return sum(one.direction is Direction.DEVICE for one in records[last:]) == 1


def _either(expected: Sequence[str]) -> str:
    """One of several."""
    return " or ".join(map(_short, expected))


def _short(text: str) -> str:
    """The beginning of what is longer than a sentence; the report has all of it."""
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE].rpartition(' ')[0]} …"


def _as_expected(value: str, expected: Sequence[str], glossary: Mapping[str, str]) -> str:
    """A bare byte with the name that it has where it is expected: ``dd 00``, as in ``dd 01``."""
    is_byte = BYTE.fullmatch(value)
    named = (name for name in glossary if is_byte and expected[0].startswith(f"{name} "))
    return f"{next(named, '')} {value}".strip()


def _spelt(text: str, glossary: Mapping[str, str]) -> str:
    for short, long in glossary.items():
        text = re.sub(rf"(?<![\w=]){short}\b(?! byte)", long, text, count=1)
    return text


def _plain(text: str) -> str:
    """Ranges in words, one value where a range has no more; lists without their brackets."""
    text = LIST.sub(lambda one: one[1].replace("'", ""), text)
    return RANGE.sub(lambda one: one[1] if one[1] == one[2] else f"{one[1]} to {one[2]}", text)


def _acts(records: Sequence[Record], describe: Describe) -> list[_Act]:
    """All that was sent and done since the check, or what is like one, began."""
    starts = [number for number, one in enumerate(records) if one.text.startswith(BEGINS)]
    first = starts[-1] + 1 if starts else 0
    opened = [n for n in range(first, len(records)) if _opens(records[n], describe)]
    acts: list[_Act] = []
    for number, end in pairwise([*opened, len(records)]):
        record = records[number]
        if record.direction is not Direction.HOST:
            text = record.text.removeprefix(RIG)
            acts.append(_Act(record.time_ns, text, number, end - 1))
            continue
        exchange = describe(record.data, b"".join(_replies(records[number:end])))
        receipts = (one for one in records[number + 1 : end] if one.direction is Direction.HOST)
        if any(describe(one.data, b"").is_altered for one in receipts):
            exchange = exchange._replace(is_altered=True)
        words = _short(exchange.request)
        acts.append(_Act(record.time_ns, words, number, end - 1, exchange, record.data))
    return acts


def _opens(record: Record, describe: Describe) -> bool:
    """True for the first record of an act; a receipt belongs to the exchange before it."""
    if record.direction is Direction.HOST:
        return bool(describe(record.data, b"").request)
    return record.text.startswith(ACTS)


def _replies(records: Iterable[Record]) -> Iterator[bytes]:
    return (one.data for one in records if one.direction is Direction.DEVICE)
