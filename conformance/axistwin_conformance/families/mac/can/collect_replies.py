"""What comes of a frame, all of it: a check that counts replies must not stop at the first one.

`CanClient.send` waits for the reply and no longer.  Here every reply on the bus is collected,
whoever it is from, until it has been quiet for a while.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import Part, quiet_s
from axistwin_conformance.families.mac.axis.driver.motion import CLOCK_ERROR
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import CanReply, CanRequest
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.transport.can import Arrival
from axistwin_conformance.transport.can_frame import Frame

FRAMES_ON_THE_WAY: Final = 4  # what else may be on the bus, or wait for it, beside what is timed
LONGEST_FRAME: Final = 1.3  # of eight bytes with all stuff bits there can be, over the shortest
SLOW_FRAME_NS: Final = 1_100_000  # at 125 kbit/s, where nobody has told the bit rate
MOST_BESIDE: Final = 256  # replies, beside one to each request: two from every address there is
REAL_JITTER_NS: Final = 20_000_000


def everybody(session: Session) -> list[CanDriver]:
    """The module under test and its neighbours."""
    return [CanDriver(session, address) for address in (session.address, *session.neighbours)]


def unknown_addresses(session: Session) -> list[int]:
    """Addresses nobody has been said to have: all of them in virtual time, else those that a
    decoder with a bit too few would take for this module's."""
    taken = {session.address, *session.neighbours}
    others = [address for address in codec.ADDRESSES if address not in taken]
    if session.transport.is_virtual:
        return others
    own = session.address
    near = [own ^ 1, own + 1, own - 1, own ^ 0x40, own ^ 0x20, 0x7F]
    return [candidate for candidate in dict.fromkeys(near) if candidate in others]


def replies(driver: CanDriver, *frames: Frame, is_awaited: bool = True) -> tuple[Frame, ...]:
    """Send frames in a row; every reply that comes of them, whoever sends it.

    `is_awaited`: the first one may take as long as a reply may take.
    """
    driver.client.target.drain()
    for frame in frames:
        driver.client.target.send(frame)
    pause_s = quiet_s(driver.client.target)
    received: list[Frame] = []
    silence_limit_s = driver.session.reply_timeout_s if is_awaited else pause_s
    for _ in range(len(frames) + MOST_BESIDE):  # who never falls silent is not waited for
        if (arrival := driver.client.target.receive(codec.is_reply, silence_limit_s)) is None:
            break
        received.append(arrival.frame)
        silence_limit_s = pause_s
    return tuple(received)


def described(frames: tuple[Frame, ...]) -> str:
    """What was heard, in words."""
    return "; ".join(str(frame) for frame in frames) or "silence"


def exactly(driver: CanDriver, frame: Frame, wanted: Frame, requirement: Part) -> None:
    """Judge that a frame gets that one reply, byte for byte, and no other."""
    received = replies(driver, frame)
    driver.session.expect(
        received == (wanted,), requirement, f"{wanted} alone", described(received)
    )


def the_reply(driver: CanDriver, request: CanRequest, requirement: Part) -> CanReply:
    """Judge that a request to this module gets one reply, from it, to what was asked; give it."""
    received = replies(driver, request.frame())
    flaw = "" if len(received) == 1 else "more than one"
    if len(received) == 1:
        whence = received[0].identifier - codec.REPLY
        flaw = (
            codec.mismatch(request, received[0])
            if whence == driver.client.address
            else "from somebody else"
        )
    own = codec.REPLY + driver.client.address
    driver.session.expect(
        len(received) == 1 and not flaw,
        requirement,
        f"one reply, on {own:03X}h",
        described(received),
        flaw,
    )
    return codec.parse(received[0], driver.client.byte_order)


def reply_frame(request: CanRequest, command: int, data: bytes = codec.ZEROS) -> Frame:
    """The reply to a request that has this first byte: what was named repeated, then the data."""
    head = bytes([command, request.index_low, request.index_high, request.sub_index])
    return Frame(codec.REPLY + request.address, head + data)


def with_a_reason(driver: CanDriver, reply: CanReply) -> str:
    """What is wrong with a refusal beside the reading of MACC-AMB-17 it shows."""
    is_bare = driver.session.reading("abort_code_form") == "zeros" and reply.abort_code
    return f"{reply}, on a module whose refusals carry zeros" if is_bare else ""


def outcome_of(
    driver: CanDriver, request: CanRequest, readings: Mapping[ReplyKind, int]
) -> int | str:
    """Which reading one reply, or none, to a request stands for; else what came."""
    received = replies(driver, request.frame())
    if len(received) > 1:
        return described(received)
    reply = codec.parse(received[0] if received else None, driver.client.byte_order)
    if received:
        own = codec.REPLY + driver.client.address
        flaw = codec.mismatch(request, received[0]) or (
            "" if received[0].identifier == own else "not its own"
        )
        flaw = flaw or (with_a_reason(driver, reply) if reply.kind is ReplyKind.REFUSED else "")
        if flaw:
            return f"{received[0]}: {flaw}"
    return readings.get(reply.kind, str(reply))


# --- what is said unasked, and when --------------------------------------------------------------


def slack_ns(driver: CanDriver, after_ns: int) -> int:
    """How far from its time a message may come that is due so long after something we have seen:
    frames on the way; on a real bus the module's quartz and our own ears as well."""
    frame_ns = round(driver.client.frame_ns * LONGEST_FRAME) or SLOW_FRAME_NS
    on_the_way_ns = FRAMES_ON_THE_WAY * frame_ns
    if driver.client.target.is_virtual:
        return on_the_way_ns
    ears_ns = REAL_JITTER_NS + driver.client.target.uncertainty_ns
    return on_the_way_ns + ears_ns + round(after_ns * CLOCK_ERROR)


def unasked(
    driver: CanDriver, seconds: float, is_wanted: Callable[[Frame], bool] | None = None
) -> tuple[Arrival, ...]:
    """Everything this module says unasked within that time, what was said before set aside."""
    received: list[Arrival] = []
    deadline_ns = driver.client.target.now_ns + round(seconds * 1e9)

    def is_ours(frame: Frame) -> bool:
        is_ours = codec.spontaneous_from(frame) == driver.client.address
        return is_ours and (is_wanted is None or is_wanted(frame))

    while (left_ns := deadline_ns - driver.client.target.now_ns) >= 0:
        arrival = driver.client.target.receive_spontaneous(is_ours, left_ns / 1e9)
        if arrival is None:
            break
        received.append(arrival)
    return tuple(received)
