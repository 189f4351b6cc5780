"""Which readings a board follows, as far as it shows them without a step and without a store.

They run in the order of their text: first what is in every reply, then what errors look like, by
which the bounds of parameters are told.  What is set is put back after each question.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mn400 import codec, words
from axistwin_conformance.families.mn400.client import BoardExchange
from axistwin_conformance.families.mn400.driver import LONGEST_VALUE, BoardDriver
from axistwin_conformance.families.mn400.snapshot import put_back

ORDER = 10  # of this module in a run; see `Family.modules`

TRAILERS: Final = (b"\x06", b"", b"\x06\x00", b"\x05", b"\x05\x00", b"\x00")
MS: Final = 1_000_000
LEAST_BOUND: Final = 2_147_000_000  # of long numbers: what the manual says
LONGEST_S: Final = 10.0  # a time-out that has not run out by then counts as none
COARSE_MS: Final = 50  # a time measured on a real line is told in steps of so many
SHORT_PAYLOAD, LONG_PAYLOAD = 69, 400  # characters: the longest legal one; more than most take
MOST_PAYLOAD: Final = 10_000  # characters; a buffer that takes more is not measured


def is_served(exchange: BoardExchange) -> bool:
    """True if a board has carried out what sets a value."""
    return exchange.codes[-1:] == ("DONE",)


def is_refused(exchange: BoardExchange) -> bool:
    """True if it has refused the parameters."""
    return exchange.codes[-1:] == ("PARA_ERROR",)


def serves(driver: BoardDriver, *texts: str) -> tuple[bool | None, ...]:
    """Which texts a board carries out, and which it refuses; None: neither."""
    with put_back(driver.session, "".join({text[:1] for text in texts})):
        came = [driver.ask(text) for text in texts]
    return tuple(True if is_served(one) else False if is_refused(one) else None for one in came)


def which(readings: dict[tuple[bool | None, ...], int], seen: tuple[bool | None, ...]) -> Outcome:
    """The reading that these answers are of, or what came."""
    told = {True: "DONE", False: "PARA_ERROR", None: "something else"}
    return readings.get(seen, ", ".join(told[one] for one in seen))


# --- what is in every reply -----------------------------------------------------------------------


@probe()
def data_packet_trailer(driver: BoardDriver) -> Outcome:
    """The bytes behind the last digit of the reply to E."""
    exchange = driver.ask("E")
    if exchange.value is None:
        return str(exchange)
    trailer = exchange.value.trailer
    return TRAILERS.index(trailer) if trailer in TRAILERS else trailer.hex(" ")


@probe()
def data_value_encoding(driver: BoardDriver) -> Outcome:
    """The separators in the reply to E."""
    exchange = driver.ask("E")
    if exchange.value is None:
        return str(exchange)
    if exchange.value.fields is None:
        return repr(exchange.value.text)
    return int(exchange.value.is_dotted)


@probe()
def outcome_null(driver: BoardDriver) -> Outcome:
    """The length of the packet that refuses X3."""
    exchange = driver.ask("X3")
    last = exchange.found[-1] if exchange.found else None
    if last is None or last.code is None:
        return str(exchange)
    return 0 if last.has_null else 1


@probe()
def error_start_policy(driver: BoardDriver) -> Outcome:
    """Which of X3, W and a poll with a wrong checksum draw START first."""
    wrong = codec.with_wrong_checksum(driver.client.request("*"))
    came = (driver.ask("X3"), driver.ask("W"), driver.client.ask_raw(wrong))
    has_start = tuple("START" in one.codes for one in came)
    readings: Mapping[tuple[bool, ...], int] = {
        (True, False, False): 0,
        (True, True, True): 1,
        (False, False, False): 2,
    }
    return readings.get(has_start, " / ".join(map(str, came)))


@probe()
def echo_case(driver: BoardDriver) -> Outcome:
    """The command byte of the replies to e."""
    seen = {packet.command for packet in driver.ask("e").found}
    return {"E": 0, "e": 1}.get("".join(seen), f"{sorted(seen)}")


@probe()
def retransmit_cmd(driver: BoardDriver) -> Outcome:
    """The command byte of & after ?."""
    driver.ask("?")
    exchange = driver.ask("&")
    seen = exchange.found[0].command if exchange.found else ""
    return {"&": 0, "?": 1}.get(seen, str(exchange))


@probe()
def baud_reply(driver: BoardDriver) -> Outcome:
    """What follows BAUDCHANGEOK when the rate stays as it is."""
    exchange = driver.ask(f"~{codec.RATES.index(driver.target.baud)}")
    more = driver.client.strays_now()
    found = (*exchange.found, *codec.packets(more)[0])
    readings: Mapping[tuple[str, ...], int] = {
        ("START", "BAUDCHANGEOK"): 0,
        ("START", "BAUDCHANGEOK", "DONE"): 1,
    }
    return readings.get(codec.codes_of(found), f"{exchange}, {words.explain_reply(more)}")


# --- parameters -----------------------------------------------------------------------------------


@probe()
def omitted_param(driver: BoardDriver) -> Outcome:
    """L1,2,3,4, then L,9: E."""
    with put_back(driver.session, "L"):
        driver.command("L1,2,3,4")
        exchange = driver.ask("L,9")
        position = driver.position()
    if is_refused(exchange):
        return 2
    readings: Mapping[tuple[int, ...], int] = {(1, 9, 3, 4): 0, (0, 9, 0, 0): 1}
    return readings.get(position, str(position))


@probe()
def extra_params(driver: BoardDriver) -> Outcome:
    """V with two parameters."""
    return which({(False,): 0, (True,): 1}, serves(driver, "V2000,5"))


@probe()
def space_policy(driver: BoardDriver) -> Outcome:
    """A space within L."""
    return which({(False,): 0, (True,): 1}, serves(driver, "L 5,0,0,0"))


@probe()
def long_max(driver: BoardDriver) -> Outcome:
    """The greatest counter that is loaded, sought by halves."""
    return _bound(driver, "")


@probe()
def long_min(driver: BoardDriver) -> Outcome:
    """The least counter that is loaded, sought by halves."""
    return _bound(driver, "-")


def _bound(driver: BoardDriver, sign: str) -> Outcome:
    """The bound of long numbers of that sign (MN4-AMB-48)."""
    fits, too_far = LEAST_BOUND, (1 << 31) + 1
    with put_back(driver.session, "L"):
        if not is_served(driver.ask(f"L{sign}{fits},0,0,0")):
            return f"{sign}{fits} is refused"
        while too_far - fits > 1:
            middle = (fits + too_far) // 2
            if is_served(driver.ask(f"L{sign}{middle},0,0,0")):
                fits = middle
            else:
                too_far = middle
    return Measured(f"{sign}{fits}")


@probe()
def g_widths(driver: BoardDriver) -> Outcome:
    """40000 as the first and as the last parameter of G."""
    seen = serves(driver, "G40000,1,1,1,1", "G1,1,1,1,40000")
    return which({(False, False): 0, (True, True): 1, (False, True): 2}, seen)


@probe()
def speed_range_policy(driver: BoardDriver) -> Outcome:
    """V0, V1, V100001 and a profile that ends below its start."""
    seen = serves(driver, "V0", "V1", "V100001", "F5000,1000,1")
    return which({(False,) * 4: 0, (True,) * 4: 1}, seen)


@probe()
def negative_v(driver: BoardDriver) -> Outcome:
    """V-5 beside V-1."""
    return which({(True, True): 0, (True, False): 1}, serves(driver, "V-1", "V-5"))


@probe()
def plane_base(driver: BoardDriver) -> Outcome:
    """Which of P4,1,2 and P0,1,2 is refused."""
    return which({(True, False): 0, (False, True): 1}, serves(driver, "P4,1,2", "P0,1,2"))


@probe()
def plane_z_check(driver: BoardDriver) -> Outcome:
    """A plane whose traverse motor is Y: refused at once, or else it is left for +."""
    base = int(driver.reading("plane_base"))
    seen = serves(driver, f"P{base},{base + 2},{base + 2}")
    if seen == (True,):
        return 0, 2  # only a helix tells these apart
    return which({(False,): 1}, seen)


@probe()
def hold_takes_arg(driver: BoardDriver) -> Outcome:
    """H0."""
    return which({(True,): 0, (False,): 1}, serves(driver, "H0"))


@probe()
def measure_other(driver: BoardDriver) -> Outcome:
    """E3."""
    exchange = driver.ask("E3")
    if is_refused(exchange):
        return 0
    return 1 if exchange.value is not None else str(exchange)


# --- states and flags -----------------------------------------------------------------------------


@probe()
def has_feedhold_cmds(driver: BoardDriver) -> Outcome:
    """The reply to :."""
    exchange = driver.ask(":")
    if exchange.value is not None:
        return 0
    return 1 if exchange.codes[-1:] == ("INVALIDCOMMAND",) else str(exchange)


@probe()
def shield_status_sense(driver: BoardDriver) -> Outcome:
    """Whether [ and the first field of : are equal."""
    if driver.reading("has_feedhold_cmds") == "false":
        driver.session.skip("this board has no : to compare [ with")
    return 0 if driver.shield() == driver.flags()["ShieldFlag"] else 1


@probe()
def cc_unsupported(driver: BoardDriver) -> Outcome:
    """? while a contour is entered."""
    with driver.entered("("):
        exchange = driver.ask("?")
    last = exchange.codes[-1:]
    readings: Mapping[tuple[str, ...], int] = {
        ("INVALIDCOMMAND",): 0,
        ("BUSY",): 1,
        ("DONE",): 2,
        ("data",): 3,
    }
    return readings.get(last, str(exchange))


# --- frames ---------------------------------------------------------------------------------------


@probe()
def timeout_reply(driver: BoardDriver) -> Outcome:
    """What an address and a command without an end draw in time."""
    received, _ = _cut_off(driver)
    said = codec.codes_of(codec.packets(received)[0])
    readings: Mapping[tuple[str, ...], int] = {("TIMEOUT",): 0, (): 1}
    return readings.get(said, words.explain_reply(received))


@probe()
def rx_timeout_ms(driver: BoardDriver) -> Outcome:
    """From the last byte of a cut frame to its TIMEOUT."""
    received, took_ns = _cut_off(driver)
    if not received:
        driver.session.skip("this board says nothing when a frame is cut off")
    ms = round((took_ns - _first_byte(driver, driver.client.request("E"))[1]) / MS)
    if driver.target.is_virtual and driver.target.is_lossless:
        return Measured(str(ms))
    usual = int(driver.session.run.ledger.ambiguity_of("rx_timeout_ms").default_of("rx_timeout_ms"))
    if abs(ms - usual) <= COARSE_MS:
        return Measured(str(usual))
    return Measured(str(max(1, round(ms / COARSE_MS)) * COARSE_MS))


def _cut_off(driver: BoardDriver) -> tuple[bytes, int]:
    """What an address and a * draw by themselves, and how long after them it began (ns)."""
    return _first_byte(driver, driver.client.request("*")[:2])


def _first_byte(driver: BoardDriver, raw: bytes) -> tuple[bytes, int]:
    """What these bytes draw, and how long after the last of them that began (ns)."""
    driver.target.drain()
    begun_ns = driver.client.send(raw)
    first = driver.target.receive(1, LONGEST_S)
    came_ns = driver.target.now_ns
    rest = driver.client.listen(driver.session.reply_timeout_s) if first else b""
    own_ns = (len(raw) + 1) * driver.target.byte_ns
    return first + rest, came_ns - begun_ns - own_ns


@probe()
def timeout_without_command(driver: BoardDriver) -> Outcome:
    """What an address alone draws in time."""
    driver.target.drain()
    driver.client.send(driver.client.request("*")[:1])
    received = driver.client.forget_frame()
    if not received:
        return 0
    found, _ = codec.packets(received)
    is_zero = len(found) == 1 and found[0].payload[:1] == b"\0"
    return 1 if is_zero else words.explain_reply(received)


def _is_too_long(driver: BoardDriver, size: int) -> bool:
    """Whether a payload of so many characters draws SLAVEBUFFOV."""
    return "SLAVEBUFFOV" in driver.ask("L" + "1" * (size - 1)).codes


@probe()
def rx_payload_max(driver: BoardDriver) -> Outcome:
    """The longest payload that does not draw SLAVEBUFFOV, sought by halves."""
    fits, too_long = SHORT_PAYLOAD, LONG_PAYLOAD
    while not _is_too_long(driver, too_long):
        if too_long == MOST_PAYLOAD:
            driver.session.skip(f"{too_long} characters are received, and no end of it")
        fits, too_long = too_long, min(2 * too_long, MOST_PAYLOAD)
    while too_long - fits > 1:
        middle = (fits + too_long) // 2
        if _is_too_long(driver, middle):
            too_long = middle
        else:
            fits = middle
    return Measured(str(fits))


# --- all boards -----------------------------------------------------------------------------------


@probe(needs=("alone",))
def broadcast_reply(driver: BoardDriver) -> Outcome:
    """S to id 0."""
    limit_s = driver.slots_s(LONGEST_VALUE)
    exchange = driver.client.ask_raw(codec.request(codec.ALL_BOARDS, "S"), limit_s)
    if exchange.is_silence:
        return 2
    if exchange.codes != ("START", "data"):
        return str(exchange)
    return (0, 1) if driver.board == 1 else _is_at_once(driver, exchange)


def _is_at_once(driver: BoardDriver, exchange: BoardExchange) -> Outcome:
    """Whether a board whose turn is late has waited for it."""
    waited_s = (exchange.came_ns[0] - exchange.asked_ns) / 1e9
    return int(waited_s < driver.poll_slot_s() * (driver.board - 1) / 2)
