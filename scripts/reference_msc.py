"""The protocol page of the MSC: tables and transcripts of the twin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from scripts.reference_tables import prose, table

from axistwin import catalog
from axistwin.devices.msc.commands import COMMANDS
from axistwin.devices.msc.controller import MscController
from axistwin.devices.msc.data_area import BLOCK_VALUES
from axistwin.devices.msc.flags import FLAGS, FlagKind
from axistwin.devices.msc.models import MODELS
from axistwin.devices.msc.packets import (
    ACK,
    BODY_MAX,
    CHECKSUM_BYTES,
    FRAME_BYTES,
    HEADER_BYTES,
    NAK,
    STX,
    packet,
)
from axistwin.devices.msc.quirks import QUIRKS
from axistwin.devices.msc.receiver import LINE_FORMAT
from axistwin.devices.msc.status import ERRORS, StatusBit
from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.runtime.clock import VirtualClock

MODEL: Final = "msc-250"
BYTE_NS: Final[Nanos] = LINE_FORMAT.span_ns(1)
QUIET_NS: Final[Nanos] = 20 * NS_PER_MS  # longer than from the ACK to the reply
BYTES_A_LINE: Final = 24
MARGIN: Final = " " * 14
ACKNOWLEDGED: Final = bytes((ACK,))
REFUSED: Final = bytes((NAK,))

ADDRESS, VALUE, BLOCK, FLAG = 2008, 1234, 2048, 200
VALUES: Final = range(1, BLOCK_VALUES + 1)

HEAD: Final = """\
# The MSC executive port

This page describes the executive port of an MSC controller for those who write a host. The tables
are those of the twin. The transcripts show what the twin sends in virtual time, byte for byte, with
the default of every quirk. The [requirements](msc-requirements.md) and the [quirks](msc-quirks.md)
have pages of their own.

The controller is passive. The host sends one packet as a request; the controller answers it with a
bare character, ACK or NAK. A command that writes gets nothing else. A command that reads gets a
packet of the same form after the ACK, and the host answers that packet with ACK or NAK.

"""

# Each command: its effect, the values of the request and of the reply.
MEANINGS: Final = {
    "BREAD": ("read 32 values", "address", "32 values"),
    "BWRITE": ("write 32 values; shorter arrays are padded", "address, 32 values", ""),
    "CFLAG": ("turn an output or a user flag off", "flag", ""),
    "DREAD": ("read a value", "address", "value"),
    "DWRITE": ("write a value", "address, value", ""),
    "RFLAG": ("read a flag", "flag", "0 or 1, in 2 bytes"),
    "RFLAGS": ("read all flags", "none", "32 bytes: flag f is bit f mod 8 of byte f / 8"),
    "RQSTAT": ("read the status word", "none", "status word, 6 bytes that mean nothing"),
    "SFLAG": ("turn an output or a user flag on", "flag", ""),
}
KINDS: Final = {
    FlagKind.INPUT: "the machine",
    FlagKind.OUTPUT: "the program, the host",
    FlagKind.TIMER: "the clock: on while the timer runs",
    FlagKind.MOTOR: "the motion",
    FlagKind.USER: "the program, the host",
    FlagKind.UNASSIGNED: "nobody: off",
}
CONDITIONS: Final = {
    StatusBit.RUNNING: "the program is running",
    StatusBit.BATTERY_LOW: "the battery of the memory is low",
    StatusBit.RAM_UNRELIABLE: "the memory may have lost its content",
    StatusBit.PROGRAM_CLEARED: "the system was reset, and the program cleared",
    StatusBit.SYSTEM_RETURN: "the program has met a system return",
    StatusBit.SYSTEM_FAULT: "the program has met a system fault",
    StatusBit.AUTO_START: "the program starts at power-up",
    StatusBit.SELF_TEST: "the self-test is in progress",
    StatusBit.LOAD_OVER_RUNNING: "a load was attempted over a running program",
    StatusBit.LOAD_CHECKSUM: "a checksum was wrong",
    StatusBit.LOADING: "a program is being loaded",
    StatusBit.LOAD_SEQUENCE: "a load was out of sequence",
    StatusBit.BAD_OPCODE: "the program has met a bad opcode",
    StatusBit.STACK_OVERFLOW: "a stack has run over",
    StatusBit.STACK_UNDERFLOW: "a stack has run empty",
    StatusBit.INTERRUPT_TABLE_FULL: "the table of software interrupts was full",
}
TIMES: Final = ("response_delay_ms", "reply_delay_ms", "packet_timeout_ms", "ack_timeout_ms")


def word(number: int) -> bytes:
    """An address or a flag number."""
    return number.to_bytes(2, "big")


def value(number: int) -> bytes:
    """A value."""
    return number.to_bytes(4, "big", signed=True)


def request(name: str, *values: bytes, unit: int = 1) -> bytes:
    """A packet for a unit."""
    return packet(unit, name.encode() + b"," + b"".join(values))


BLOCK_OF_VALUES: Final = b"".join(value(each) for each in VALUES)
EXCHANGES: Final = {
    "BWRITE": request("BWRITE", word(BLOCK), BLOCK_OF_VALUES),
    "BREAD": request("BREAD", word(BLOCK)),
    "DWRITE": request("DWRITE", word(ADDRESS), value(VALUE)),
    "DREAD": request("DREAD", word(ADDRESS)),
    "SFLAG": request("SFLAG", word(FLAG)),
    "RFLAG": request("RFLAG", word(FLAG)),
    "RFLAGS": request("RFLAGS"),
    "CFLAG": request("CFLAG", word(FLAG)),
    "RQSTAT": request("RQSTAT"),
}


@dataclass(slots=True)
class Burst:
    """Bytes in one direction without a pause: from their first start bit to their last stop bit."""

    begin_ns: Nanos
    arrow: str
    data: bytes
    end_ns: Nanos


class Host:
    """A host on a line of twins, in virtual time, with its transcript."""

    def __init__(self, *devices: str, program: str | None = None) -> None:
        specs = [catalog.parse_device(device) for device in devices or (MODEL,)]
        self.line = catalog.build_line(
            specs,
            clock=VirtualClock(),
            quirks={} if program is None else {"auto_start": True},
            programs={} if program is None else {None: program},
        )
        self._bursts: list[Burst] = []

    def send(self, data: bytes) -> None:
        """Send, and wait until it is on the line."""
        now = self.line.sync()
        span_ns = len(data) * BYTE_NS
        self._bursts.append(Burst(now, ">", data, now + span_ns))
        self.line.send(data)
        self.receive(span_ns)

    def receive(self, silence_ns: Nanos = QUIET_NS) -> bytes:
        """Receive until the line has been silent for so long; return the bytes."""
        received = b""
        until_ns = self.line.sync() + silence_ns
        while (now := self.line.wait(until_ns, count=1)) < until_ns or self.line.available:
            data = self.line.receive(1)
            if data:
                received += data
                self._note(now, data)
                until_ns = now + silence_ns
        return received

    def _note(self, now: Nanos, data: bytes) -> None:
        last = self._bursts[-1]
        if last.arrow == "<" and now - last.end_ns < 2 * BYTE_NS:
            last.data += data
            last.end_ns = now
        else:
            self._bursts.append(Burst(now - BYTE_NS, "<", data, now))

    def exchange(self, data: bytes) -> bytes:
        """The request, the reply, and the ACK of the host if the reply was a packet."""
        self.send(data)
        received = self.receive()
        if len(received) > len(ACKNOWLEDGED):
            self.send(ACKNOWLEDGED)
        return received

    def transcript(self) -> str:
        """The bursts since the last call, in hex and in words; times count from the first byte."""
        began_ns = self._bursts[0].begin_ns
        lines = [line for burst in self._bursts for line in shown(burst, began_ns)]
        self._bursts.clear()
        return "```text\n" + "".join(f"{line}\n" for line in lines) + "```\n"


def shown(burst: Burst, began_ns: Nanos) -> Iterator[str]:
    """A burst as lines: when it began, all its bytes, and below them what they mean."""
    data = burst.data
    time_ms = (burst.begin_ns - began_ns) / NS_PER_MS
    for start in range(0, len(data), BYTES_A_LINE):
        head = MARGIN if start else f"{time_ms:8.1f} ms {burst.arrow} "
        yield f"{head}{data[start : start + BYTES_A_LINE].hex(' ').upper()}"
    meaning = catalog.find_model(MODEL).explain(data)
    if meaning != data.hex(" ").upper():  # what is no packet is explained by its bytes
        yield f"{MARGIN}{meaning}"


# --- tables ---------------------------------------------------------------------------------------


def line_and_packet() -> str:
    """The character, the packet, the two answers."""
    rows = (
        (0, 1, "start of packet", f"{STX:02X}h"),
        (1, 1, "unit number", "1 to 15; 1 on RS-232"),
        (2, 2, "length N", f"bytes of the body, 1 to {BODY_MAX}"),
        (4, 2, "block number", "anything; 0 in replies"),
        (HEADER_BYTES, "N", "body", "name of the command, comma, values"),
        (
            f"{HEADER_BYTES} + N",
            CHECKSUM_BYTES,
            "checksum",
            "sum of all bytes from the unit number to the end of the body",
        ),
    )
    example = EXCHANGES["DWRITE"]
    total = sum(example[1:-CHECKSUM_BYTES])
    return (
        "## Line and packet\n\n"
        + prose(
            f"""{LINE_FORMAT.baud} baud, 8 data bits, no parity, 1 stop bit:
            {BYTE_NS / NS_PER_MS:.3f} ms a byte. No byte value is reserved: turn XON/XOFF off.
            Numbers go high byte first; values are signed, of 32 bits."""
        )
        + table(["offset", "bytes", "field", "value"], rows)
        + "\n"
        + prose(
            f"""ACK is {ACK:02X}h, NAK {NAK:02X}h, alone, in no packet. Nothing is escaped: inside
            a packet the length alone tells where it ends, and 02h, 06h and 15h are data."""
        )
        + f"`DWRITE` of {VALUE} to address {ADDRESS}, with the checksum {total} = {total:04X}h:\n\n"
        f"```text\n{example.hex(' ').upper()}\n```\n\n"
    )


def commands() -> str:
    """The commands, with the sizes of their packets and the time of a reply."""
    rows = []
    host = Host()
    for command in COMMANDS:
        name = command.name.decode()
        does, asked, answered = MEANINGS[name]
        request_bytes = FRAME_BYTES + len(name) + 1 + command.value_bytes
        assert request_bytes == len(EXCHANGES[name])
        reply_bytes = len(host.exchange(EXCHANGES[name])) - len(ACKNOWLEDGED)
        sizes = f"{request_bytes} / {reply_bytes or '-'}"
        time = f"{reply_bytes * BYTE_NS / NS_PER_MS:.1f} ms" if reply_bytes else "-"
        rows.append((f"`{name}`", does, asked, answered or "ACK only", sizes, time))
    head = ["command", "what it does", "request", "reply", "bytes of the packets", "reply time"]
    having, lacking = (
        " and ".join(f"`{each.name}`" for each in MODELS.values() if each.has_rflags is has)
        for has in (True, False)
    )
    return (
        "## Commands\n\n"
        + prose(
            """The name stands before the first comma, in upper case. The comma is there also if no
            value follows."""
        )
        + table(head, rows)
        + f"\n`RFLAGS` is known to {having}; to {lacking} it is an unknown command.\n\n"
        + prose(
            f"""The controller answers with NAK, and does nothing, to a wrong checksum, an unknown
            name, a body of the wrong size, a flag above {FLAGS - 1}, an address outside the data
            area, and a block that runs over its end."""
        )
    )


def behind_the_packets() -> str:
    """Data area, flags, status word."""
    unit = MscController(MODEL)
    data = unit.data
    flags = ((kind.value, unit.flags.spans(kind), KINDS[kind]) for kind in FlagKind)
    bits = (
        (bit.bit_length() - 1, int(bit), CONDITIONS[bit], "error" if bit & ERRORS else "")
        for bit in StatusBit
    )
    return (
        "## Data area, flags and status\n\n"
        + prose(
            f"""*Data area.* Addresses 0 to {data.size - 1}, a value every {data.stride}. The
            listing of the program gives the addresses of its values. `BWRITE` always stores
            {BLOCK_VALUES} values: nothing protects the values behind a shorter array. The battery
            keeps the whole area."""
        )
        + prose(
            """*Flags.* The manual does not say what each number stands for. This map is the twin's
            own; the quirk `flag_map` replaces it. `SFLAG` and `CFLAG` change only outputs and user
            flags; for flags of another kind they get an ACK and have no effect."""
        )
        + table(["flags", "numbers", "turned on and off by"], flags)
        + "\n*Status word.* 65 is 64 + 1: a program is running, and starts at power-up.\n\n"
        + table(["bit", "value", "set when", ""], bits)
        + "\n"
    )


def times() -> str:
    """Delays and time limits."""
    rows = ((f"`{name}`", f"{QUIRKS[name].default} ms", QUIRKS[name].doc) for name in TIMES)
    return (
        "## Times\n\n"
        + prose(
            """The manual gives none of these times; each is a quirk. A host waits longer than the
            packet time limit for an answer before it sends again."""
        )
        + table(["switch", "default", "what it is"], rows)
    )


# --- transcripts ----------------------------------------------------------------------------------


def each_command() -> str:
    """One exchange of each command."""
    host = Host(program="bench")
    page = "\n## Each command once\n\n" + prose(
        f"""`>` is the host, `<` the controller, unit 1. The time is that of the first byte of a
        burst, from the beginning of the exchange, at {LINE_FORMAT.baud} baud. A program is running.
        The bytes do not show their direction: a request for flag 1 looks like the answer "on"."""
    ).rstrip("\n")
    for name, data in EXCHANGES.items():
        host.exchange(data)
        page += f"\n\n### {name}\n\n{host.transcript()}".rstrip("\n")
    return page + "\n"


def what_goes_wrong() -> str:
    """Refused packets and replies, silence, several units."""
    host = Host()
    host.exchange(EXCHANGES["DWRITE"])
    host.transcript()
    page = "\n## When something goes wrong\n"
    for title, words, happens in MISHAPS:
        happens(host)
        page += f"\n### {title}\n\n{prose(words)}{host.transcript()}"
    return page + shared_line()


def damaged_request(host: Host) -> None:
    """Refused, and sent again."""
    host.exchange(corrupted(EXCHANGES["DREAD"]))
    host.exchange(EXCHANGES["DREAD"])


def refused_reply(host: Host) -> None:
    """Refused once, then acknowledged."""
    host.send(EXCHANGES["DREAD"])
    host.receive()
    host.send(REFUSED)
    host.receive()
    host.send(ACKNOWLEDGED)


def no_acknowledgement(host: Host) -> None:
    """The host says nothing."""
    host.send(EXCHANGES["DREAD"])
    host.receive(8 * NS_PER_S)


def broken_off(host: Host) -> None:
    """Half a request."""
    host.send(EXCHANGES["DREAD"][: HEADER_BYTES + 4])
    host.receive(2 * NS_PER_S)


MISHAPS: Final = (
    (
        "A damaged request",
        "The controller sends NAK; the host sends the request again. The checksum is one too high.",
        damaged_request,
    ),
    (
        "A reply that the host refuses",
        "The controller sends the same packet again, without another ACK; five times at most.",
        refused_reply,
    ),
    (
        "A host that does not acknowledge",
        """The controller sends the reply again when the time limit for the host's answer is over.
        After five repeats it gives up and is ready for the next packet.""",
        no_acknowledgement,
    ),
    (
        "A request that breaks off",
        """The packet time limit runs from the first byte. When it is over, the controller sends
        NAK. If a host sends again before that, the controller takes the new packet for the rest
        of the first one.""",
        broken_off,
    ),
)


def shared_line() -> str:
    """Units on RS-485."""
    host = Host(f"{MODEL}:1", f"{MODEL}:6")
    host.exchange(request("DREAD", word(ADDRESS), unit=6))
    host.exchange(corrupted(request("DREAD", word(ADDRESS), unit=3)))
    words = prose(
        """On RS-485 each unit follows every packet and answers its own. Packets to an absent unit
        get no answer, damaged or not. Here units 1 and 6 are on the line, and the second packet is
        for unit 3."""
    )
    return f"\n### Several units on one line\n\n{words}{host.transcript()}"


def corrupted(data: bytes) -> bytes:
    """The packet with a checksum one too high."""
    return data[:-1] + bytes((data[-1] + 1 & 0xFF,))


def page() -> str:
    """The whole page."""
    return (
        HEAD
        + line_and_packet()
        + commands()
        + behind_the_packets()
        + times()
        + each_command()
        + what_goes_wrong()
    )
