"""What a receiver makes of a line, looking at one instant after the other: slow, and plain."""

from collections.abc import Sequence

from axistwin.wire.framing import LineFormat
from axistwin.wire.uart import ROUNDING, sample_offsets
from axistwin.wire.waveform import FINE_BITS, FINE_PER_S, Transmission, parity_bit


def _drives(each: Transmission, fine: int) -> bool:
    return each.start_ns << FINE_BITS <= fine < each.fine_end


def _pulls(each: Transmission, fine: int) -> bool:
    """Whether this driver alone makes it space."""
    if not _drives(each, fine):
        return False
    elapsed = fine - (each.start_ns << FINE_BITS)
    form = each.format
    index, half_bit = divmod(elapsed * 2 * form.baud // FINE_PER_S, form.half_bits_per_byte)
    if index >= each.count:
        return each.is_broken and not each.count
    (value,) = each.data(index, index + 1)
    place = half_bit // 2 - 1
    if place < form.data_bits:
        return place < 0 or not value >> place & 1
    return form.parity != "N" and place == form.data_bits and not parity_bit(form.parity, value)


def is_space(line: Sequence[Transmission], station: int, fine: int) -> bool:
    """The level at ``station``'s receiver, which is off (mark) while the station itself drives."""
    if any(each.station == station and _drives(each, fine) for each in line):
        return False
    return any(each.station != station and _pulls(each, fine) for each in line)


def falls(line: Sequence[Transmission], station: int, begin: int) -> list[int]:
    """All instants from ``begin`` on at which mark becomes space."""
    instants = {each.fine_end for each in line}
    for each in line:
        half_bits = each.format.half_bits_per_byte
        instants |= {each.edge(0, at) for at in range(max(1, each.count) * half_bits)}
    return [
        at
        for at in sorted(instants)
        if at >= begin and is_space(line, station, at) and not is_space(line, station, at - 1)
    ]


def hear(
    line: Sequence[Transmission], station: int, form: LineFormat, begin: int
) -> list[tuple[int, int, bool]]:
    """Time, value and badness of each character from ``begin`` on; no glitches."""
    offsets = sample_offsets(form)
    span = -(-form.half_bits_per_byte * FINE_PER_S // (2 * form.baud))
    heard = []
    for edge in falls(line, station, begin):
        if edge < begin:
            continue
        start, *bits = (not is_space(line, station, edge + each) for each in offsets)
        begin = edge + offsets[0] - ROUNDING
        if start:
            continue
        begin = edge + offsets[-1] - ROUNDING
        value = sum(bit << place for place, bit in enumerate(bits[: form.data_bits]))
        parity = form.parity == "N" or bits[-2] == bool(parity_bit(form.parity, value))
        heard.append((edge + span >> FINE_BITS, value, not (bits[-1] and parity)))
    return heard
