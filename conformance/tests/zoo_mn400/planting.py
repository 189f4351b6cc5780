"""The few ways in which a fault is planted into the MN400 twins of this process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

from zoo.mutant import Any_, MonkeyPatch, mutant
from zoo_msc.planting import around

from axistwin.devices.mn400 import grammar, orders
from axistwin.devices.mn400.acceptance import TABLE, BoardState, Treatment
from axistwin.devices.mn400.commands import Interpreter
from axistwin.devices.mn400.link import packets
from axistwin.devices.mn400.link.ports import Answer
from axistwin.devices.mn400.link.sender import Reply
from axistwin.devices.mn400.mover import Mover
from axistwin.devices.mn400.orders import BoardSettings
from axistwin.devices.mn400.readout import ReadOut

__all__ = [
    "MS",
    "Any_",
    "BoardState",
    "MonkeyPatch",
    "S",
    "Treatment",
    "all_packets",
    "around",
    "begins_with",
    "board_mutant",
    "cells",
    "commands",
    "data_packets",
    "fits",
    "judges",
    "parameter",
    "plans",
    "repeats",
    "resummed",
    "settles",
    "status_packets",
    "values",
]

MS: Final = 1_000_000
S: Final = 1000 * MS

board_mutant: Final = partial(mutant, model="mn400")


# --- packets --------------------------------------------------------------------------------------


def resummed(head: bytes) -> bytes:
    """A packet whose sum is yet to come, with it."""
    return head + bytes([sum(head) & 0x7F])


def repeats(patch: MonkeyPatch, change: Callable[[ReadOut, Reply, int], Reply | None]) -> None:
    """Let & send `change(readout, message, now)` instead of a message it repeats."""

    def act(go: Any_, readout: ReadOut, line: Any) -> Answer:
        answer: Answer = go()
        again = answer.parts[0].message
        assert callable(again)

        def other(now: int) -> Reply | None:
            last = again(now)
            return last and change(readout, last, now)

        return answer._replace(parts=[answer.parts[0]._replace(message=other)])

    around(patch, ReadOut, "retransmit", act)


def status_packets(patch: MonkeyPatch, change: Callable[[bytes], bytes]) -> None:
    """Let `change(raw)` be sent instead of each packet with a return code."""
    make = packets.status
    patch.setattr(packets, "status", lambda *given: change(make(*given)))


def data_packets(patch: MonkeyPatch, change: Callable[[bytes], bytes]) -> None:
    """Let `change(raw)` be sent instead of each packet with a value."""
    make = packets.data_packet
    patch.setattr(packets, "data_packet", lambda *given: change(make(*given)))


def all_packets(patch: MonkeyPatch, change: Callable[[bytes], bytes]) -> None:
    """Both."""
    status_packets(patch, change)
    data_packets(patch, change)


def values(patch: MonkeyPatch, letter: str, change: Any_) -> None:
    """Let a command tell `change(text, readout, now)` instead of its value."""

    def act(go: Any_, readout: Any, *given: Any) -> None:
        go()
        tell = readout._values[letter]
        readout._values[letter] = lambda now: change(tell(now), readout, now)

    around(patch, ReadOut, "__init__", act)


# --- parameters -----------------------------------------------------------------------------------


def parameter(patch: MonkeyPatch, letter: str, index: int | None, **changes: Any) -> None:
    """Let a parameter of a command (None: each of them) be otherwise."""
    command = grammar.COMMANDS[letter]
    changed = tuple(
        replace(one, **changes) if index in (None, number) else one
        for number, one in enumerate(command.parameters)
    )
    patch.setitem(grammar.COMMANDS, letter, replace(command, parameters=changed))


def fits(patch: MonkeyPatch, act: Any_) -> None:
    """Let `act(go, parameter, value)` decide which value a number is."""
    check = grammar._checked

    def checking(one: Any, value: int, quirks: Any) -> Any:
        return act(lambda other=value: check(one, other, quirks), one, value)

    patch.setattr(grammar, "_checked", checking)


# --- commands -------------------------------------------------------------------------------------


def judges(patch: MonkeyPatch, act: Any_) -> None:
    """Let each line be judged by `act(go, interpreter, line, letter)`."""
    around(patch, Interpreter, "_answer", act)


def commands(patch: MonkeyPatch, letters: str, act: Any_) -> None:
    """Let commands do `act(go, interpreter, line, given)` instead; `go(line, known, given, how)` is
    the command as it should be."""

    def acting(go: Any_, one: Any, line: Any, known: Any, given: Any, how: Any) -> Any:
        if known.letter not in letters:
            return go()

        def carry_out(*other: Any) -> Any:
            return go(line, known, other[0] if other else given, how)

        return act(carry_out, one, line, given)

    around(patch, Interpreter, "_act", acting)


def cells(
    patch: MonkeyPatch, letters: str, states: Sequence[BoardState], treatment: Treatment
) -> None:
    """Write a treatment into cells of the table of acceptance."""
    for letter in letters:
        for state in states:
            patch.setitem(TABLE, (letter, state), treatment)


def begins_with(patch: MonkeyPatch, **settings: Any) -> None:
    """Let a board have other settings at power-up."""

    def act(go: Any_, mover: Mover) -> None:
        go()
        mover.settings = mover.accepted = replace(mover.settings, **settings)

    around(patch, Mover, "reset", act)


def settles(patch: MonkeyPatch, letter: str, change: Any_) -> None:
    """Let a setting become `change(after, before)` of the settings that it should lead to."""
    make = orders.change_of

    def making(given_letter: str, *given: Any) -> Any:
        changed = make(given_letter, *given)
        if given_letter != letter:
            return changed

        def otherwise(before: BoardSettings) -> BoardSettings:
            found = change(changed(before), before)
            assert isinstance(found, BoardSettings)
            return found

        return otherwise

    from axistwin.devices.mn400 import commands as module

    patch.setattr(module, "change_of", making)


def plans(patch: MonkeyPatch, name: str, act: Any_) -> None:
    """Let a motion (`straight`, `arc`, `helix`, `contour`, `thread`) be planned by
    `act(go, now, settings, *rest)`; `go(now, settings, *rest)` plans as it should be."""
    make = getattr(orders, name)
    patch.setattr(orders, name, lambda *given: act(make, *given))
