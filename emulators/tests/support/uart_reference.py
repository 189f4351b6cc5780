"""What a UART hears, from intervals of exact fractions: slow, and obviously the rules."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

from axistwin.wire.framing import LineFormat
from axistwin.wire.serial_line import HOST

Heard = list[tuple[int, int, int]]  # (arrival_ns, station, value)


@dataclass(frozen=True)
class Sent:
    """A transmission of the reference."""

    station: int
    start_ns: int
    data: bytes


def reference(formats: Sequence[LineFormat], sent: Sequence[Sent]) -> Heard:
    """What everybody hears, from intervals of exact fractions: slow, and obviously the rules."""
    spaces: list[tuple[int, Fraction, Fraction]] = []
    drives: list[tuple[int, Fraction, Fraction]] = []
    for each in sent:
        line_format = formats[each.station]
        bit = Fraction(10**9, line_format.baud)
        character = bit * line_format.half_bits_per_byte / 2
        end = each.start_ns + len(each.data) * character
        drives.append((each.station, Fraction(each.start_ns), end))
        for index, value in enumerate(each.data):
            for place, level in enumerate(_levels(line_format, value)):
                begin = each.start_ns + index * character + place * bit
                if not level:
                    spaces.append((each.station, begin, begin + bit))
    heard: Heard = []
    for station, line_format in enumerate(formats):
        heard += _reference_uart(station, line_format, spaces, drives)
    return sorted(heard)


def _levels(line_format: LineFormat, value: int) -> list[int]:
    data = [value >> place & 1 for place in range(line_format.data_bits)]
    parity = {
        "N": [],
        "E": [sum(data) % 2],
        "O": [1 - sum(data) % 2],
        "M": [1],
        "S": [0],
    }[line_format.parity]
    return [0, *data, *parity]


def _reference_uart(
    station: int,
    line_format: LineFormat,
    spaces: list[tuple[int, Fraction, Fraction]],
    drives: list[tuple[int, Fraction, Fraction]],
) -> Heard:
    own = [(start, end) for each, start, end in drives if each == station]
    low = [(start, end) for each, start, end in spaces if each != station]

    def level(time: Fraction) -> int:
        if any(start <= time < end for start, end in own):
            return 1
        return 0 if any(start <= time < end for start, end in low) else 1

    times = sorted({time for pair in low + own for time in pair})
    edges = []
    before = 1
    for time in times:
        if before and not level(time):
            edges.append(time)
        before = level(time)
    return _reference_characters(station, line_format, edges, level)


def _reference_characters(
    station: int,
    line_format: LineFormat,
    edges: list[Fraction],
    level: Callable[[Fraction], int],
) -> Heard:
    bit = Fraction(10**9, line_format.baud)
    heard: Heard = []
    free = Fraction(0)
    for edge in edges:
        if edge < free:
            continue
        free = edge + bit / 2
        if level(free):
            continue
        bits = []
        for _ in range(line_format.data_bits + (line_format.parity != "N") + 1):
            free += bit
            bits.append(level(free))
        value = sum(each << place for place, each in enumerate(bits[: line_format.data_bits]))
        good = bits == [*_levels(line_format, value)[1:], 1]
        if good or station == HOST:
            done = edge + bit * line_format.half_bits_per_byte / 2
            heard.append((done // 1, station, value if good else 0))
    return heard
