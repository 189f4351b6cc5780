"""The few ways in which a fault is planted into the MSC twins of this process."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final

from zoo.mutant import Any_, MonkeyPatch, mutant, wrap

from axistwin.devices.msc import receiver as receiver_module
from axistwin.devices.msc.commands import Commands
from axistwin.devices.msc.packets import ACK, NAK, STX, Whom, is_sum_right
from axistwin.devices.msc.receiver import LINE_FORMAT, Receiver, ReceiverState
from axistwin.kernel.schedule import NEVER

__all__ = [
    "ACK",
    "LINE_FORMAT",
    "MS",
    "NAK",
    "NEVER",
    "STX",
    "Any_",
    "Commands",
    "MonkeyPatch",
    "Receiver",
    "ReceiverState",
    "S",
    "Whom",
    "accepts",
    "alarms",
    "around",
    "at",
    "bodies",
    "carry_out",
    "hears",
    "listens_to_others",
    "msc_mutant",
    "name_of",
    "number_in",
    "on",
    "packets_sent",
    "payloads",
    "replies",
    "resummed",
    "total",
]  # fmt: skip

MODEL: Final = "msc-250"
MS: Final = 1_000_000
S: Final = 1000 * MS

msc_mutant: Final = partial(mutant, model=MODEL)


# --- packets -------------------------------------------------------------------------------------


def total(data: bytes) -> bytes:
    """The two bytes of a checksum over these bytes."""
    return (sum(data) & 0xFFFF).to_bytes(2, "big")


def resummed(raw: bytes) -> bytes:
    """The packet under the sum that fits it."""
    return raw[:-2] + total(raw[1:-2])


def name_of(raw: bytes) -> str:
    """The command's name in a packet."""
    return raw[6:-2].partition(b",")[0].decode("latin-1")


# --- methods -------------------------------------------------------------------------------------


def around(patch: MonkeyPatch, owner: Any, name: str, act: Any_) -> None:
    """Let a method be `act(go, self, *arguments)`; `go()` is the method as it should be,
    `go(*others)` with other arguments."""

    def make(method: Any_) -> Any_:
        def acting(one: Any, *arguments: Any, **named: Any) -> Any:
            def go(*others: Any) -> Any:
                return method(one, *(others or arguments), **named)

            return act(go, one, *arguments)

        return acting

    wrap(patch, owner, name, make)


def packets_sent(patch: MonkeyPatch, change: Any_) -> None:
    """Let the unit send `change(receiver, raw)` instead of each packet, repeats among them."""

    def act(go: Any_, receiver: Receiver, start_ns: int, data: bytes) -> Any:
        return go(start_ns, bytes(change(receiver, data)) if data[:1] == b"\x02" else data)

    around(patch, Receiver, "_send", act)


def replies(patch: MonkeyPatch, change: Any_, *names: str) -> None:
    """Let the unit send `change(raw)` instead of the replies to the commands named, or to all."""

    def changed(receiver: Receiver, raw: bytes) -> bytes:
        return bytes(change(raw)) if not names or name_of(raw) in names else raw

    packets_sent(patch, changed)


def payloads(patch: MonkeyPatch, change: Any_, *names: str) -> None:
    """Let the reply to the commands named, or to all, have `change(payload)` behind its comma; the
    rest of it is as it should be."""

    def act(go: Any_, unit: Commands, name: bytes, build: Callable[[int], bytes]) -> Any:
        if names and name[:-1].decode() not in names:
            return go()
        return go(name, lambda now: bytes(change(build(now))))

    around(patch, Commands, "_read", act)


# --- what is heard -------------------------------------------------------------------------------


def accepts(patch: MonkeyPatch, is_right: Callable[[bytes], bool]) -> None:
    """Let a checksum be right if it is, or if `is_right(raw)`."""
    patch.setattr(receiver_module, "is_sum_right", lambda raw: is_sum_right(raw) or is_right(raw))


def number_in(body: bytes) -> int:
    """The address, or the number of the flag, that a command names."""
    return int.from_bytes(body.partition(b",")[2][:2], "big")


def at(body: bytes, address: int) -> bytes:
    """The same command at another address."""
    name, comma, values = body.partition(b",")
    return name + comma + (address & 0xFFFF).to_bytes(2, "big") + values[2:]


def on(patch: MonkeyPatch, name: bytes, act: Any_) -> None:
    """Let one command be judged by `act(go, unit, now, body)`; `go(now, body)` judges it as it
    should be."""

    def judge(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        if body.startswith(name + b","):
            return act(lambda *others: go(*(others or (now, body))), unit, now, body)
        return go()

    bodies(patch, judge)


def bodies(patch: MonkeyPatch, act: Any_) -> None:
    """Let what comes of a sound packet be `act(go, commands, now, body)`; `go(now, body)` judges a
    body as it should be."""
    around(patch, Commands, "examine", act)


def carry_out(unit: Commands, now: int, body: bytes) -> None:
    """Carry a write out at once, whatever is said to it."""
    act = unit.examine(now, body).act
    while act is not None and (again := act(now)) is not None:
        now = again


def hears(patch: MonkeyPatch, takes: Any_) -> None:
    """Let the unit take bytes one by one; `takes(receiver, byte, now)` is true if it has done with
    the byte what it does."""
    patch.setattr(Receiver, "quiet_prefix", lambda receiver, data: 0)
    patch.setattr(Receiver, "_whole_packet_at", lambda receiver, data: -1)

    def act(go: Any_, receiver: Receiver, chunk: Any) -> None:
        now = chunk.arrival_ns(0)
        if chunk.errors or receiver.is_busy or not takes(receiver, chunk.data[0], now):
            go()

    def one_by_one(go: Any_, receiver: Receiver, chunk: Any) -> None:
        for at in range(len(chunk.data)):
            when = chunk.start_ns if chunk.format is None else chunk.arrival_ns(at)
            go(chunk._replace(start_ns=when, data=chunk.data[at : at + 1], format=None, skipped=0))

    around(patch, Receiver, "receive", act)
    around(patch, Receiver, "_take", one_by_one)


def listens_to_others(patch: MonkeyPatch, act: Any_) -> None:
    """Let the unit keep packets for others too and do `act(receiver, raw, now)` when one is
    complete; it is true if that is all that comes of it."""
    patch.setattr(Receiver, "quiet_prefix", lambda receiver, data: 0)
    patch.setattr(Receiver, "_whole_packet_at", lambda receiver, data: -1)

    def judge_header(go: Any_, receiver: Receiver, now: int) -> None:
        go()
        if receiver.state is ReceiverState.SKIP:
            receiver.state = ReceiverState.BODY

    def judge(go: Any_, receiver: Receiver, raw: bytes, now: int) -> None:
        if receiver._whom is not Whom.OTHER:
            go()
        elif not act(receiver, raw, now):
            receiver._rest(now)

    around(patch, Receiver, "_judge_header", judge_header)
    around(patch, Receiver, "_judge", judge)


# --- when nobody asks ----------------------------------------------------------------------------


def alarms(patch: MonkeyPatch, act: Any_) -> None:
    """Let the unit have a time limit of its own: `receiver.alarm_ns` may be set to an instant, at
    which `act(receiver, now)` is done if it is not busy."""

    def next_event(go: Any_, receiver: Any) -> Any:
        alarm_ns = NEVER if receiver.is_busy else getattr(receiver, "alarm_ns", NEVER)
        return min(go(), alarm_ns)

    def wake(go: Any_, receiver: Any, now: int) -> None:
        while (due := receiver.next_event()) <= now:
            if due == getattr(receiver, "alarm_ns", NEVER) and not receiver.is_busy:
                receiver.alarm_ns = NEVER
                act(receiver, due)
            else:
                _wake_once(receiver, due)

    around(patch, Receiver, "next_event", next_event)
    around(patch, Receiver, "wake", wake)
    patch.setattr(Receiver, "quiet_prefix", lambda receiver, data: 0)


def _wake_once(receiver: Any, due: int) -> None:
    """Do the one thing of the unit's own that is due."""
    if due == receiver._busy_until:
        receiver._busy_until = NEVER
        receiver._then(due)
    elif due == receiver._packet_due:
        receiver._give_up_packet(due)
    else:
        receiver._give_up_waiting(due)
