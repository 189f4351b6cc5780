"""Which readings a module follows, asked on the line alone: replies, frames, addresses, memory.

Each function asks the device one question of chapter 7 of the ledger (`probing`).

The probes run in the order of `Family.probe_modules` and of their text: spelling of replies first,
since everything is heard through it; then what commands of any kind do; then what ends motions;
then how they are shaped; last what re-addresses or re-initialises a module.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S, quiet_s
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED, reply_of
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.codec import GENERAL_ADDRESS, IMAX_ADDRESS
from axistwin_conformance.families.mac.serial.driver import SerialDriver

ORDER = 10  # of this module in a run; see `Family.modules`

EARLY_BYTES: Final = 3  # 0.8 ms at 38400 baud: a reply does not come sooner


# --- spelling ------------------------------------------------------------------------------------


@probe()
def xon_byte(driver: SerialDriver) -> Outcome:
    """The last byte of an answer to 20h."""
    spelling = driver.client.ask(0x20).reply.xon_spelling
    return "no answer" if spelling is None else Measured(spelling)


def refusals(driver: SerialDriver) -> list[codec.SerialRequest]:
    """Frames that a module refuses at rest, by one requirement or another, and that do nothing."""
    no_digit = replace(driver.client.request(0x20), index=b"2G")
    return [driver.client.request(0x12), driver.client.request(0x2A), no_digit]


@probe()
def xonerror_byte(driver: SerialDriver) -> Outcome:
    """The last byte of the reply to a frame that is refused at rest."""
    for frame in refusals(driver):
        spelling = driver.client.send(frame, QUIET_S).reply.xonerror_spelling
        if spelling is not None:
            return Measured(spelling)
    if driver.limits.may("motion"):  # or, as the ledger puts it, a move during a move
        start = driver.motion.ready()
        driver.client.command(0x13, start + 100)
        spelling = driver.client.command(0x13, start).reply.xonerror_spelling
        driver.client.command(0x18)
    return "nothing was refused" if spelling is None else Measured(spelling)


@probe()
def status_reply_digit(driver: SerialDriver) -> Outcome:
    """Byte 8 of the answer to 21h."""
    return _digit(driver, 0x21, {1: 0, 2: 1})


@probe()
def reply23_digit(driver: SerialDriver) -> Outcome:
    """Byte 8 of the answer to 23h."""
    return _digit(driver, 0x23, {3: 0, 2: 1})


def _digit(driver: SerialDriver, index: int, readings: Mapping[int, int]) -> Outcome:
    reply = driver.client.ask(index).reply
    return readings.get(-1 if reply.digit is None else reply.digit, str(reply))


@probe()
def reply28_length(driver: SerialDriver) -> Outcome:
    """Bytes 3 to 5 of the answer to 28h."""
    reply = driver.client.ask(0x28).reply
    return {b"011": 0, b"014": 1}.get(reply.length, str(reply))


# --- frames --------------------------------------------------------------------------------------


@probe()
def lowercase_hex(driver: SerialDriver) -> Outcome:
    """28h at AFh spelled af, under the checksum of that."""
    reply = driver.client.send(
        driver.client.request(0x28, 0, IMAX_ADDRESS).in_lower_case(), QUIET_S
    ).reply
    if reply.kind is ReplyKind.ANSWER:
        return 1 if reply.data == driver.client.value(0x28, IMAX_ADDRESS) else str(reply)
    return 0 if reply.kind in (ReplyKind.REFUSED, ReplyKind.SILENCE, ReplyKind.NACK) else str(reply)


@probe()
def bad_frame_reply(driver: SerialDriver) -> Outcome:
    """A query with length field 015, and one with another byte for Etx."""
    whole = driver.client.request(0x20)
    kinds = {
        driver.client.send(frame, quiet_s(driver.client.target)).kind
        for frame in (replace(whole, length=b"015"), replace(whole, end=b"\r"))
    }
    if len(kinds) > 1:
        return "now silence, now a reply"
    return reply_of(kinds.pop(), {ReplyKind.SILENCE: 0, ReplyKind.NACK: 1})


@probe(needs=("virtual",))
def rx_during_xoff(driver: SerialDriver) -> Outcome:
    """A second query whose first bytes come before the first one's answer, the rest behind it."""
    target, frame, early = driver.client.target, driver.client.request(0x20).encode(), EARLY_BYTES
    first = _followed(driver, frame, early)
    if first.kind is not ReplyKind.ANSWER:  # it may have begun before the last of these bytes
        taken = driver.client.send(frame).taken
        early = min(EARLY_BYTES, (taken.latest_ns - taken.earliest_ns) // target.byte_ns)
        if early < 1:
            driver.session.skip("the reply comes before a byte would have ended")
        first = _followed(driver, frame, early)
    if first.kind is not ReplyKind.ANSWER:
        return f"{first} to the first query"
    second = driver.client.send(frame[early:], QUIET_S).kind
    return reply_of(second, {ReplyKind.SILENCE: 0, ReplyKind.ANSWER: 1})


def _followed(driver: SerialDriver, frame: bytes, early: int) -> codec.SerialReply:
    """The reply to a query with so many bytes of a second one at its heels."""
    driver.client.target.drain()
    driver.client.target.send(frame + frame[:early])
    return codec.parse(
        driver.client.target.receive(codec.ANSWER_BYTES, QUIET_S + driver.client.target.line_s)
    )


@probe()
def subindex_policy(driver: SerialDriver) -> Outcome:
    """22h with sub-index 01."""
    reply = driver.client.ask(0x22, 0x01).reply
    if reply.kind is ReplyKind.ANSWER:
        return 0 if reply.data == driver.client.value(0x22) else str(reply)
    return reply_of(reply.kind, {ReplyKind.REFUSED: 1})


@probe(switch="dont_care_digits")
def dont_care_digits_of_a_query(driver: SerialDriver) -> Outcome:
    """24h with FFFFFFFF for the parameter digits that do not matter."""
    reply = driver.client.send(driver.client.request(0x24, 0xFFFFFFFF)).reply
    if reply.kind is ReplyKind.ANSWER:  # a command may be read more strictly
        return (0, 1) if reply.data == driver.client.value(0x24) else str(reply)
    return reply_of(reply.kind, {ReplyKind.REFUSED: 1})


@probe(safety="stored")
def dont_care_digits(driver: SerialDriver) -> Outcome:
    """0Ch with FFFFFF before the torque that is set."""
    torque = driver.client.parameter(0x0C)
    kind = driver.client.command(0x0C, 0xFFFFFF00 | torque).kind
    after = driver.client.parameter(0x0C)
    if after != torque:
        driver.client.command(0x0C, torque)
        return f"a torque of {after:02X}h where {torque:02X}h was sent"
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe()
def unknown_index(driver: SerialDriver) -> Outcome:
    """12h and 2Ah at rest."""
    command, query = (
        driver.client.send(driver.client.request(index), QUIET_S).reply for index in (0x12, 0x2A)
    )
    if query.kind is ReplyKind.ANSWER and query.data == 0 and command.kind is ReplyKind.ACCEPTED:
        return 2
    both = {ReplyKind.REFUSED: 0, ReplyKind.ACCEPTED: 1, ReplyKind.SILENCE: 3}
    described = f"{command} to 12h, {query} to 2Ah"
    return both.get(command.kind, described) if command.kind is query.kind else described


# --- what queries show ---------------------------------------------------------------------------


@probe()
def mem_wrap(driver: SerialDriver) -> Outcome:
    """28h and 29h at FEh beside those at 00h."""
    kinds = {_beyond_the_end(driver, index) for index in (0x28, 0x29)} - {None}
    if not kinds:
        driver.session.skip("only zeros on both sides of the end")
    return Measured(kinds.pop() or "") if len(kinds) == 1 else "28h and 29h differ"


def _beyond_the_end(driver: SerialDriver, index: int) -> str | None:
    top, bottom = driver.client.data_bytes(index, 0xFE), driver.client.data_bytes(index, 0x00)
    if not any(top[2:]) and not any(bottom[:2]):
        return None
    if top[2:] == bottom[:2]:
        return "wrap"
    return "other" if any(top[2:]) else "zero"


@probe()
def imax_value(driver: SerialDriver) -> Outcome:
    """28h at AFh."""
    return Measured(f"{driver.client.data_bytes(0x28, IMAX_ADDRESS)[0]:02X}h")


@probe()
def version_word(driver: SerialDriver) -> Outcome:
    """24h."""
    return Measured(f"{driver.client.value(0x24):08X}h")


# --- who answers ---------------------------------------------------------------------------------


def answers_to_all(driver: SerialDriver) -> tuple[ReplyKind, int | None]:
    """What a query to the general address gets: the kind, GARBAGE if several speak, and whose
    address an answer carries."""
    reply = driver.client.send(
        driver.client.request(0x20, address=GENERAL_ADDRESS), QUIET_S * 2
    ).reply
    extra = driver.client.target.receive(1, QUIET_S)
    driver.client.target.drain()
    return (ReplyKind.GARBAGE if extra else reply.kind), reply.address


def general_replies(driver: SerialDriver, kind: ReplyKind) -> int | tuple[int, ...] | str:
    """The readings of MACS-AMB-16 (00 only, all, none, or a lone one too) that explain a reply to
    a frame to FF on this line."""
    others = driver.session.neighbours
    is_lone, has_00 = not others, 0 in (driver.session.address, *others)
    if kind is ReplyKind.SILENCE:
        return 2 if has_00 else (0, 2) if is_lone else (0, 2, 3)
    if kind is ReplyKind.GARBAGE:
        return 1 if others else "garbage"
    if has_00:
        return (0, 3) if others else (0, 1, 3)
    return (1, 3) if is_lone else 1


@probe()
def general_reply_policy(driver: SerialDriver) -> Outcome:
    """20h to FF, and who is heard."""
    kind, _ = answers_to_all(driver)
    return general_replies(driver, kind)


@probe()
def general_echo(driver: SerialDriver) -> Outcome:
    """The address in the answer to 20h sent to FF."""
    kind, address = answers_to_all(driver)
    if kind is not ReplyKind.ANSWER:
        driver.session.skip("nobody is heard alone, so the address cannot be read")
    own = (driver.session.address, *driver.session.neighbours)
    return 0 if address == GENERAL_ADDRESS else 1 if address in own else f"address {address:02X}"


@probe()
def nack_scope(driver: SerialDriver) -> Outcome:
    """A wrong checksum to an address nobody has, and to a neighbour."""
    taken = (driver.session.address, *driver.session.neighbours)
    nobody = next(address for address in (0x55, 0x2A, 0x15, 0x66) if address not in taken)
    return nack_readings(driver, nobody)


def nack_readings(driver: SerialDriver, address: int) -> int | tuple[int, ...] | str:
    """The readings of MACS-AMB-19 that explain the reply to a wrong checksum for nobody."""
    received = _corrupted(driver, address)
    taken = (driver.session.address, *driver.session.neighbours)
    if not received:
        return 0 if 0 in taken else (0, 1)
    if set(received) != {codec.NACK} and len(taken) == 1:
        return f"{received.hex(' ')} to a wrong checksum for address {address:02X}"
    if 0 not in taken or len(received) > 1 or received[0] != codec.NACK:
        return 2  # several spoke, or one that is not 00
    if len(taken) == 1:
        return 1, 2
    return 1


def _corrupted(driver: SerialDriver, address: int) -> bytes:
    driver.client.target.drain()
    driver.client.target.send(
        driver.client.request(0x20, address=address).with_wrong_checksum().encode()
    )
    driver.client.wait(0)
    return driver.client.target.receive(codec.ANSWER_BYTES, QUIET_S * 2)
