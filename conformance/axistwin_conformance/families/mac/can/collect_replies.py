"""What comes of a frame, all of it: a check that counts replies must not stop at the first one.

`CanClient.send` waits for the reply and no longer.  Here every reply on the bus is collected,
whoever it is from, until it has been quiet for a while.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S, Part
from axistwin_conformance.families.mac.axis.driver.motion import CLOCK_ERROR
from axistwin_conformance.families.mac.axis.exchanges import Kind
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import Reply, Request
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


def strangers(session: Session) -> list[int]:
    """Addresses nobody has been said to have: all of them in virtual time, else those that a
    decoder with a bit too few would take for this module's."""
    taken = {session.address, *session.neighbours}
    others = [one for one in codec.ADDRESSES if one not in taken]
    if session.transport.is_virtual:
        return others
    own = session.address
    near = [own ^ 1, own + 1, own - 1, own ^ 0x40, own ^ 0x20, 0x7F]
    return [one for one in dict.fromkeys(near) if one in others]


def replies(driver: CanDriver, *frames: Frame, is_awaited: bool = True) -> tuple[Frame, ...]:
    """Send frames in a row; every reply that comes of them, whoever sends it.

    `is_awaited`: the first one may take as long as a reply may take.
    """
    driver.client.target.drain()
    for frame in frames:
        driver.client.target.send(frame)
    quiet_s = QUIET_S + driver.client.target.uncertainty_ns / 1e9
    heard: list[Frame] = []
    patience_s = driver.session.reply_timeout_s if is_awaited else quiet_s
    for _ in range(len(frames) + MOST_BESIDE):  # who never falls silent is not waited for
        if (arrival := driver.client.target.receive(codec.is_reply, patience_s)) is None:
            break
        heard.append(arrival.frame)
        patience_s = quiet_s
    return tuple(heard)


def told(frames: tuple[Frame, ...]) -> str:
    """What was heard, in words."""
    return "; ".join(str(one) for one in frames) or "silence"


def exactly(driver: CanDriver, frame: Frame, wanted: Frame, requirement: Part) -> None:
    """Judge that a frame gets that one reply, byte for byte, and no other."""
    heard = replies(driver, frame)
    driver.session.expect(heard == (wanted,), requirement, f"{wanted} alone", told(heard))


def the_reply(driver: CanDriver, one: Request, requirement: Part) -> Reply:
    """Judge that a request to this module gets one reply, from it, to what was asked; give it."""
    heard = replies(driver, one.frame())
    flaw = "" if len(heard) == 1 else "more than one"
    if len(heard) == 1:
        whence = heard[0].identifier - codec.REPLY
        flaw = (
            codec.mismatch(one, heard[0])
            if whence == driver.client.address
            else "from somebody else"
        )
    own = codec.REPLY + driver.client.address
    driver.session.expect(
        len(heard) == 1 and not flaw,
        requirement,
        f"one reply, on {own:03X}h, to {codec.explain(one.frame())}",
        told(heard),
        flaw,
    )
    return codec.parse(heard[0], driver.client.byte_order)


def reply_frame(one: Request, command: int, data: bytes = codec.ZEROS) -> Frame:
    """The reply to a request that has this first byte: what was named repeated, then the data."""
    head = bytes([command, one.index_low, one.index_high, one.sub_index])
    return Frame(codec.REPLY + one.address, head + data)


def with_a_reason(driver: CanDriver, reply: Reply) -> str:
    """What is wrong with a refusal beside the reading of MACC-AMB-17 it shows."""
    is_bare = driver.session.reading("abort_code_form") == "zeros" and reply.abort_code
    return f"{reply}, on a module whose refusals carry zeros" if is_bare else ""


def outcome_of(driver: CanDriver, one: Request, readings: Mapping[Kind, int]) -> int | str:
    """Which reading one reply, or none, to a request stands for; else what came."""
    heard = replies(driver, one.frame())
    if len(heard) > 1:
        return told(heard)
    reply = codec.parse(heard[0] if heard else None, driver.client.byte_order)
    if heard:
        own = codec.REPLY + driver.client.address
        flaw = codec.mismatch(one, heard[0]) or (
            "" if heard[0].identifier == own else "not its own"
        )
        flaw = flaw or (with_a_reason(driver, reply) if reply.kind is Kind.REFUSED else "")
        if flaw:
            return f"{heard[0]}: {flaw}"
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
    heard: list[Arrival] = []
    deadline_ns = driver.client.target.now_ns + round(seconds * 1e9)

    def is_ours(frame: Frame) -> bool:
        is_ours = codec.spontaneous_from(frame) == driver.client.address
        return is_ours and (is_wanted is None or is_wanted(frame))

    while (left_ns := deadline_ns - driver.client.target.now_ns) >= 0:
        arrival = driver.client.target.receive_spontaneous(is_ours, left_ns / 1e9)
        if arrival is None:
            break
        heard.append(arrival)
    return tuple(heard)
