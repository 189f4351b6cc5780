"""A unit as the checks of its commands, data, flags and program take it into their hands.

What may be written is what the operator has named.  Addresses are four apart and blocks 128, so
that they are different variables in every reading (§5.2).
What is written is put back by the family after each check.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.client import Exchange
from axistwin_conformance.families.msc.codec import BLOCK_VALUES, Packet
from axistwin_conformance.families.msc.driver import SAFE_BLOCK, SAFE_STRIDE
from axistwin_conformance.families.msc.link import Link

Names = str | tuple[str, ...]
Readings = Mapping[str, str | tuple[str, ...]]

# What a packet may draw, in words.
ACKED: Final = "ACK and nothing more"
SERVED: Final = "ACK and a reply"
NAKED: Final = "NAK"
SILENCE: Final = "silence"

# What an unknown command draws, and what that says of MSC-AMB-04.
AS_UNKNOWN: Final[Readings] = {NAKED: "nak", ACKED: "ack_ignore", SILENCE: "silent"}

POLL_S: Final = 0.02
REACTION_S: Final = 1.0  # within which the bench program does what its flags ask for


class Controller(Link):
    """A unit whose commands, data, flags and status are judged."""

    # --- places -----------------------------------------------------------------------------------

    def slots(self, count: int) -> list[int]:
        """So many addresses of named variables, in order: the first, the last, others drawn from
        between; skips if fewer are named."""
        every = range(_up(self.variables.start, SAFE_STRIDE), self.variables.stop - 3, SAFE_STRIDE)
        return self._drawn(every, count, f"{count} variables {SAFE_STRIDE} addresses apart")

    def blocks(self, count: int) -> list[int]:
        """Where so many whole blocks of named variables begin, drawn likewise."""
        return self._drawn(self._rooms, count, f"{count * SAFE_BLOCK} addresses in a row")

    def some_blocks(self, most: int) -> list[int]:
        """The same of as many as there is room for, so many at most; skips if there is none."""
        return self.blocks(max(1, min(most, len(self._rooms))))

    @property
    def _rooms(self) -> range:
        first = _up(self.variables.start, SAFE_STRIDE)
        return range(first, self.variables.stop - SAFE_BLOCK + 1, SAFE_BLOCK)

    def may_be_moved(self, address: int) -> None:
        """Give up where a program may have written between two reads: only of the built-in twin it
        is known that none uses what is named."""
        if not self.session.target.is_builtin:
            self.session.inconclusive(
                None,
                f"what is read at {address} changes: a program uses it, or reading changes it; name"
                " addresses that no program uses (--variables), or have them written too"
                " (--allow stored)",
            )

    def some_flags(self, count: int) -> list[int]:
        """So many of the named flags, drawn likewise."""
        flags = self.flags_free
        return self._drawn(flags, min(count, len(flags)), "a flag")

    def _drawn(self, every: Sequence[int], count: int, what: str) -> list[int]:
        if len(every) < count:
            self.session.skip(f"needs {what} (--variables FIRST-LAST)")
        ends = [every[0], every[-1]][:count]
        rest = [one for one in every if one not in ends]
        return sorted([*ends, *self.session.random.sample(rest, count - len(ends))])

    def values(self, count: int) -> list[int]:
        """So many different values, none of them 0, in all four bytes of each something else."""
        drawn: set[int] = set()
        while len(drawn) < count:
            one = bytes(self.session.random.sample(range(1, 256), 4))
            drawn.add(int.from_bytes(one, "big", signed=True))
        return self.session.random.sample(sorted(drawn), count)

    def within_block(self, address: int) -> Iterator[tuple[int, int]]:
        """Each value of a block by its number and its address, in this device's reading of
        MSC-AMB-18; odd addresses, which may be no place to read from, are left out."""
        for number in range(BLOCK_VALUES):
            place = address + number * self.stride
            if place % 2 == 0:
                yield number, place

    # --- judging what a packet draws --------------------------------------------------------------

    def served(self, body: bytes, names: Names | None, what: str) -> Packet:
        """Judge that a reading command draws ACK and a reply, in words `what`; the reply."""
        exchange = self.ask(body)
        is_served = exchange.is_acked and exchange.reply is not None
        self.session.expect(is_served, names, f"ACK, and {what}", exchange)
        assert exchange.reply is not None
        return exchange.reply

    def draws(self, raw: bytes) -> tuple[str, Exchange]:
        """Send bytes; what they draw, in the words above, or as heard if it is none of those."""
        exchange = self.talk.ask(raw, is_read=True)
        kind = str(exchange)
        if exchange.is_naked:
            kind = NAKED
        elif exchange.is_silence:
            kind = SILENCE
        elif exchange.is_acked:
            is_bare = exchange.reply is None or self._is_empty(exchange.reply)
            kind = ACKED if is_bare else SERVED
        return kind, exchange

    def _is_empty(self, reply: Packet) -> bool:
        """True for what a device says behind the ACK to a write that packs that up as well."""
        is_packed = self.session.reading("write_reply") == "empty_packet"
        return is_packed and reply.is_sound and reply.name in codec.WRITES and not reply.payload

    def follows(self, raw: bytes, switch: str, readings: Readings, names: Names) -> Exchange:
        """Judge that a packet draws what some reading of a switch admits, then nothing more, and
        which one that is."""
        kind, exchange = self.draws(raw)
        told = codec.explain_request(raw)
        if kind not in readings:
            self.session.fail(names, tuple(readings), exchange, f"to {told}")
        if exchange.reply is not None:
            self.session.expect(exchange.reply.is_sound, names, "a sound reply", exchange)
        self.reading(switch, readings[kind], names)
        self.nothing_more(names, told)
        return exchange

    @property
    def as_unknown(self) -> str:
        """What an unknown command draws from this device (MSC-AMB-04)."""
        held = self.session.reading("unknown_command")
        return next(kind for kind, reading in AS_UNKNOWN.items() if reading == held)

    # --- flags ------------------------------------------------------------------------------------

    def turn(self, number: int, *, on: bool) -> None:
        """Turn a user flag on or off."""
        if on:
            self.set_flag(number)
        else:
            self.clear_flag(number)

    def flags_at_once(self) -> frozenset[int]:
        """All flags that are on, by RFLAGS."""
        states = self.flags()
        assert states is not None, "only where the model has RFLAGS"
        return codec.flags_on(states)


def _up(number: int, step: int) -> int:
    return -(-number // step) * step


class BenchProgram:
    """The bench program in a unit: its flags, its counters, its block; skips if it does not run."""

    def __init__(self, session: Session) -> None:
        place = session.run.settings.program
        assert place is not None, "a check that uses the bench program names it as a need"
        self.unit = Controller(session)
        self.session = session
        self.flag, self.address = place
        self.count, self.pulse, self.halt, self.timed = range(self.flag, self.flag + 4)
        self.block = self.address + 128

    def counter(self) -> int:
        """How often `count` was found on."""
        return self.unit.read(self.address)

    def ticks(self) -> int:
        """One more in every scan."""
        return self.unit.read(self.address + 4)

    def pulses(self) -> int:
        """How often `pulse` was seen to go on."""
        return self.unit.read(self.address + 8)

    def torn(self) -> int:
        """In how many scans the ends of the block differed."""
        return self.unit.read(self.address + 12)

    def is_running(self) -> bool:
        """True if it counts its scans."""
        first = self.ticks()
        return self.until(lambda: self.ticks() != first)

    def must_run(self) -> None:
        """Go on only with the program running."""
        if not self.is_running():
            self.session.skip(f"the bench program does not run: nothing counts at {self.address}+4")

    def until(self, is_so: Callable[[], bool], within_s: float = REACTION_S) -> bool:
        """Ask until it is so; False if it is not within so long."""
        deadline_ns = self.unit.target.now_ns + round(within_s * 1e9)
        while not is_so():
            if self.unit.target.now_ns >= deadline_ns:
                return False
            self.unit.target.wait(POLL_S)
        return True

    def taken(self, flag: int, names: Names) -> None:
        """Judge that the program finds a flag on, which it then clears."""
        is_cleared = self.until(lambda: not self.unit.flag(flag))
        self.session.expect(
            is_cleared, names, f"flag {flag} cleared by the program within {REACTION_S:g} s", "on"
        )
