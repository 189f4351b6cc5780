"""Checks of an MSC on a bench: other readings are named, what fits none fails."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from msc_controller import AREA, Controller, judge, twisted
from msc_judging import failed, troubles

from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import COMMA, Packet
from axistwin_conformance.families.msc.family import FAMILY
from axistwin_conformance.families.msc.safety import writings

pytestmark = pytest.mark.strength

UNKNOWN = "a_name_nobody_knows_is_refused"
NO_COMMA = "a_name_without_its_comma_is_unknown"
CASE = "names_are_upper_case"
NO_RFLAGS = "a_model_without_rflags_does_not_answer_it"
SIZE = "a_body_of_another_size_is_refused"
WRITE_SIZE = "a_write_of_another_size_stores_nothing"
WRITE_INSIDE = "a_write_inside_a_value_changes_what_a_read_there_shows"
INSIDE = "an_address_inside_a_value_reads_its_bytes"
OUTSIDE = "an_address_outside_the_data_area_is_refused"
READ_OVER = "a_block_read_over_the_end_is_refused_whole"
WRITE_OVER = "a_block_written_over_the_end_stores_nothing"
FAR_FLAG = "a_flag_number_above_255_is_refused"
ODD = b"\x12\x34\x56\x78"

Makes = Callable[[], Controller]


# --- other readings ------------------------------------------------------------------------------


def acked(self: Controller, one: Packet) -> bytes | None:
    """Whatever is not understood is ACKed and ignored."""
    return b""


def without_comma(self: Controller, one: Packet) -> bytes | None:
    """A name alone is taken for one with its comma."""
    if COMMA not in one.body:
        one = made(codec.body(one.body.decode("latin-1")))
        return Controller.serve(self, one) if one.is_request else None
    return None


def any_case(self: Controller, one: Packet) -> bytes | None:
    """A name in any case."""
    name, _, values = one.body.partition(COMMA)
    upper = made(name.upper() + COMMA + values)
    return Controller.serve(self, upper) if upper.is_request and COMMA in one.body else None


def made(body: bytes) -> Packet:
    """A sound packet with that body."""
    one = codec.parse(codec.packet(1, body))
    assert one is not None
    return one


def lenient(self: Controller, one: Packet) -> bytes | None:
    """What fits of a body is used."""
    size = codec.REQUEST_PAYLOADS.get(one.name) if COMMA in one.body else None
    if size is None or len(one.payload) < size or one.name in codec.WRITES:
        return None
    return Controller.serve(self, made(codec.body(one.name, one.payload[:size])))


def rounded(self: Controller, one: Packet) -> bytes | None:
    """An address inside a value means that value."""
    return self.get(one.numbers[0] & ~3, 4)


def refused_inside(self: Controller, one: Packet) -> bytes | None:
    """An address inside a value is refused."""
    return None if one.numbers[0] % 4 else self.get(one.numbers[0], 4)


def writes_rounded(self: Controller, one: Packet) -> bytes | None:
    """Writes inside a value mean that value."""
    if one.name in ("DWRITE", "BWRITE"):
        return self.put(one.numbers[0] & ~3, one.payload[2:])
    return Controller.serve(self, one)


def writes_refused(self: Controller, one: Packet) -> bytes | None:
    """Writes inside a value are refused."""
    if one.name in ("DWRITE", "BWRITE") and one.numbers[0] % 4:
        return None
    return Controller.serve(self, one)


def zero_outside(self: Controller, address: int, count: int) -> bytes | None:
    """Nothing but zeros behind the end."""
    return bytes(self.area[address : address + count]).ljust(count, b"\x00")


def round_again(self: Controller, address: int, count: int) -> bytes | None:
    """The area over and over."""
    return bytes(self.area[(address + one) % AREA] for one in range(count))


def ignored_outside(self: Controller, address: int, data: bytes) -> bytes | None:
    """What is written behind the end is lost."""
    inside = data[: max(0, AREA - address)]
    self.area[address : address + len(inside)] = inside
    return b""


def partly(self: Controller, one: Packet) -> bytes | None:
    """A block as far as there is one."""
    return zero_outside(self, one.numbers[0], 128) if one.numbers[0] < AREA else None


def round_block(self: Controller, one: Packet) -> bytes | None:
    """A block that goes on at the beginning."""
    return round_again(self, one.numbers[0], 128) if one.numbers[0] < AREA else None


def partly_written(self: Controller, one: Packet) -> bytes | None:
    """A block stored as far as there is room."""
    return ignored_outside(self, one.numbers[0], one.payload[2:])


def round_put(self: Controller, address: int, data: bytes) -> bytes | None:
    """The same of writes."""
    for number, byte in enumerate(data):
        self.area[(address + number) % AREA] = byte
    return b""


def round_written(self: Controller, one: Packet) -> bytes | None:
    """A block of which the rest is stored at the beginning."""
    return round_put(self, one.numbers[0], one.payload[2:])


def far_off(self: Controller, one: Packet) -> bytes | None:
    """A flag above 255 is off."""
    return codec.u16(one.numbers[0] < 256 and one.numbers[0] in self.states())


def far_ignored(self: Controller, number: int, *, on: bool) -> bytes | None:
    """A flag above 255 is not turned."""
    return b"" if number > 255 else Controller.turn(self, number, on=on)


def low_byte(self: Controller, one: Packet) -> bytes | None:
    """The low byte of a flag's number alone."""
    return codec.u16(one.numbers[0] % 256 in self.states())


def low_turned(self: Controller, number: int, *, on: bool) -> bytes | None:
    """The same of SFLAG and CFLAG."""
    return Controller.turn(self, number % 256, on=on)


READINGS: list[tuple[str, Makes, str]] = [
    (UNKNOWN, twisted(unknown=acked), "unknown_command=ack_ignore"),
    (NO_COMMA, twisted(unknown=without_comma), "comma=optional"),
    (CASE, twisted(unknown=any_case), "case_sensitive=false"),
    (NO_RFLAGS, twisted(unknown=acked), "rflags_unsupported=ack_no_reply"),
    (SIZE, twisted(unknown=acked), "malformed_body=ack_ignore"),
    (SIZE, twisted(unknown=lenient), "malformed_body=lenient"),
    (WRITE_SIZE, twisted(unknown=acked), "malformed_body=ack_ignore"),
    (INSIDE, twisted(dread=rounded), "data_misaligned=round_down"),
    (INSIDE, twisted(dread=refused_inside), "data_misaligned=nak"),
    (WRITE_INSIDE, twisted(serve=writes_rounded), "data_misaligned=round_down"),
    (WRITE_INSIDE, twisted(serve=writes_refused), "data_misaligned=nak"),
    (OUTSIDE, twisted(get=zero_outside, put=ignored_outside), "data_out_of_range=zero"),
    (OUTSIDE, twisted(get=round_again, put=round_put), "data_out_of_range=wrap"),
    (READ_OVER, twisted(bread=partly), "block_overrun=partial"),
    (READ_OVER, twisted(bread=round_block), "block_overrun=wrap"),
    (WRITE_OVER, twisted(bwrite=partly_written), "block_overrun=partial"),
    (WRITE_OVER, twisted(bwrite=round_written), "block_overrun=wrap"),
    (FAR_FLAG, twisted(rflag=far_off, turn=far_ignored), "flag_out_of_range=off"),
    (FAR_FLAG, twisted(rflag=low_byte, turn=low_turned), "flag_out_of_range=mod256"),
]


@pytest.mark.parametrize(("name", "make", "reading"), READINGS, ids=[one[2] for one in READINGS])
def test_another_reading_is_named_and_not_failed(name: str, make: Makes, reading: str) -> None:
    """Held from then on: told as a quirk, or held against the device that has shown another."""
    switch, value = reading.split("=")
    port = make()
    port.has_rflags = name != NO_RFLAGS
    for number in range(AREA):
        port.area[number] = number % 251 + 1
    found = judge(name, port, readings={switch: value})
    assert not failed(found), troubles(found)
    told = [one.text for one in found if one.verdict is Verdict.QUIRK]
    assert any(reading in text for text in told), found


@pytest.mark.parametrize(("name", "make", "reading"), READINGS, ids=[one[2] for one in READINGS])
def test_one_that_has_shown_the_default_must_keep_to_it(
    name: str, make: Makes, reading: str
) -> None:
    """A device that shows two readings follows none."""
    switch, _ = reading.split("=")
    port = make()
    port.has_rflags = name != NO_RFLAGS
    for number in range(AREA):
        port.area[number] = number % 251 + 1
    default = port_default(switch)
    assert failed(judge(name, port, readings={switch: default}))


def port_default(switch: str) -> str:
    """The default reading of a switch."""
    return load_ledger("msc").ambiguity_of(switch).default_of(switch)


# --- faults --------------------------------------------------------------------------------------


def nonsense(self: Controller, one: Packet) -> bytes | None:
    """Whatever is not understood is answered by something."""
    return ODD


def hangs(self: Controller, one: Packet) -> bytes | None:
    """What is not understood ends it."""
    self.is_powered = False
    return None


def begun(self: Controller, one: Packet) -> bytes | None:
    """A name that begins as another one is served as that."""
    known = [name for name in codec.READS if one.name.startswith(name)]
    return getattr(self, max(known, key=len).lower())(one) if known else None


def no_comma_ahead(self: Controller, one: Packet) -> bytes | None:
    """An address that begins with a comma is refused."""
    return None if one.payload[:1] == b"," else Controller.dread(self, one)


def stores_what_fits(self: Controller, one: Packet) -> bytes | None:
    """A write of the wrong size is refused, and carried out."""
    if one.name in ("BWRITE", "DWRITE") and len(one.payload) > 2:
        self.put(one.numbers[0], one.payload[2:])
    return None


def turns_what_fits(self: Controller, one: Packet) -> bytes | None:
    """SFLAG of the wrong size is refused, and carried out."""
    if one.name == "SFLAG" and one.numbers:
        Controller.turn(self, one.numbers[0], on=True)
    return None


def shifted(self: Controller, one: Packet) -> bytes | None:
    """Bytes from one further on than was asked for."""
    number = one.numbers[0]
    return self.get(number + 1 if number % 4 else number, 4)


def wide(self: Controller, address: int, data: bytes) -> bytes | None:
    """A write inside a value that clears the rest of the next one."""
    return Controller.put(self, address, data + bytes(-(address + len(data)) % 4))


def refused_yet_put(self: Controller, one: Packet) -> bytes | None:
    """A write inside a value that is refused, and carried out."""
    Controller.dwrite(self, one)
    return None if one.numbers[0] % 4 else b""


def refuses_the_last(self: Controller, one: Packet) -> bytes | None:
    """A block that just fits is refused as well."""
    return None if one.numbers[0] + 128 >= AREA else self.get(one.numbers[0], 128)


def garbled_over(self: Controller, one: Packet) -> bytes | None:
    """A block over the end that is something else altogether."""
    over = one.numbers[0] + 128 > AREA and one.numbers[0] < AREA
    return ODD * 32 if over else self.get(one.numbers[0], 128)


def refused_yet_stored(self: Controller, one: Packet) -> bytes | None:
    """A block over the end that is refused, and half of it stored."""
    if one.numbers[0] + 128 > AREA:
        ignored_outside(self, one.numbers[0], one.payload[2:])
        return None
    return Controller.bwrite(self, one)


def block_outside(self: Controller, one: Packet) -> bytes | None:
    """A block where there is no value at all."""
    return self.get(one.numbers[0], 128) if one.numbers[0] + 128 <= AREA else bytes(128)


def far_any(self: Controller, one: Packet) -> bytes | None:
    """A flag above 255 in a state of its own."""
    return codec.u16(one.numbers[0] >> 8 or one.numbers[0] in self.states())


def far_cleared(self: Controller, number: int, *, on: bool) -> bytes | None:
    """SFLAG of a flag above 255 is refused, and turns another."""
    if number > 255:
        Controller.turn(self, number % 256, on=on)
        return None
    return Controller.turn(self, number, on=on)


FAULTS: list[tuple[str, Makes, str]] = [
    (UNKNOWN, twisted(unknown=nonsense), "MSC-CMD-10"),
    (UNKNOWN, twisted(unknown=hangs), "MSC-CMD-10"),
    (NO_COMMA, twisted(unknown=acked), "MSC-CMD-10"),
    (NO_COMMA, twisted(unknown=hangs), "MSC-CMD-02"),
    ("a_name_is_compared_from_end_to_end", twisted(unknown=begun), "MSC-CMD-07"),
    ("every_byte_may_stand_in_an_address", twisted(dread=no_comma_ahead), "MSC-CMD-08"),
    (CASE, twisted(unknown=acked), "MSC-CMD-09"),
    (NO_RFLAGS, twisted(unknown=nonsense), "MSC-MOD-02"),
    (SIZE, twisted(unknown=nonsense), "MSC-CMD-11"),
    (SIZE, twisted(unknown=hangs), "MSC-CMD-11"),
    (WRITE_SIZE, twisted(unknown=stores_what_fits), "MSC-BWRITE-01"),
    (WRITE_SIZE, twisted(unknown=turns_what_fits), "MSC-SFLAG-01"),
    (WRITE_SIZE, twisted(unknown=nonsense), "MSC-CMD-11"),
    (INSIDE, twisted(dread=shifted), "MSC-DREAD-01"),
    (OUTSIDE, twisted(bread=block_outside), "MSC-DAT-03"),
    (OUTSIDE, twisted(put=ignored_outside), "MSC-DAT-03"),
    (WRITE_INSIDE, twisted(put=wide), "MSC-DWRITE-05"),
    (WRITE_INSIDE, twisted(dwrite=refused_yet_put), "MSC-DWRITE-05"),
    (READ_OVER, twisted(bread=refuses_the_last), "MSC-BREAD-05"),
    (READ_OVER, twisted(bread=garbled_over), "MSC-BREAD-05"),
    (WRITE_OVER, twisted(bwrite=refused_yet_stored), "MSC-BWRITE-07"),
    (FAR_FLAG, twisted(rflag=far_any), "MSC-FLG-02"),
    (FAR_FLAG, twisted(turn=far_cleared), "MSC-FLG-02"),
]


@pytest.mark.parametrize(
    ("name", "make", "requirement"), FAULTS,
    ids=[f"{one}-{key}-{number}" for number, (one, _, key) in enumerate(FAULTS)],
)  # fmt: skip
def test_a_fault_fails_what_it_breaks(name: str, make: Makes, requirement: str) -> None:
    """What fits no reading of the manual."""
    port = make()
    port.has_rflags = name != NO_RFLAGS
    found = judge(name, port)
    assert requirement in failed(found), troubles(found)


def test_writes_that_are_wrong_on_purpose_reach_no_real_controller() -> None:
    """On a port that is no twin such a check says so, and sends none of them."""
    port = Controller()
    found = judge(WRITE_OVER, port, is_twin=False)
    assert {one.verdict for one in found} == {Verdict.NOT_RUN}
    assert b"WRITE" not in port.received


def test_writes_of_a_wrong_size_reach_named_places_of_a_real_controller() -> None:
    """None whose flag nobody knows is among them; the guard looks at their places."""
    port = Controller()
    assert not troubles(judge(WRITE_SIZE, port, is_twin=False))
    assert port.received.count(b"BWRITE,") > 3
    assert all(len(one.partition(b",")[2]) != 1 for one in _bodies(port.received, b"SFLAG,"))


def _bodies(received: bytes, name: bytes) -> list[bytes]:
    """What was received of a command, as long as its packets say."""
    found = []
    at = received.find(name)
    while at >= 6:
        size = int.from_bytes(received[at - 4 : at - 2], "big")
        found.append(received[at : at + size])
        at = received.find(name, at + 1)
    return found


def test_inside_a_value_a_real_controller_is_written_to_at_even_addresses_only() -> None:
    """An odd one may be no address at all."""
    port = Controller()
    found = judge(WRITE_INSIDE, port, is_twin=False)
    assert {one.verdict for one in found} == {Verdict.PASS}
    numbers = {one.number for one in writings(bytes(port.received))}
    assert any(number % 4 == 2 for number in numbers)
    assert not any(number % 2 for number in numbers)


def test_every_check_for_a_bench_has_a_fault_here() -> None:
    """No check of that module goes without one that it finds."""
    names = {one.name for one in FAMILY.checks() if one.module.endswith("checks.bench")}
    assert names == {name for name, _, _ in FAULTS}
