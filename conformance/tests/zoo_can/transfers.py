"""Faults in requests and replies: what they hold, what is refused, what has a meaning (SDO)."""

from __future__ import annotations

from typing import Any

from zoo.mutant import Any_, MonkeyPatch, answers, mutant, on, setter, wrap

from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.can.device import MacCan
from axistwin.kernel.effects import SendFrame
from axistwin.wire.can_frame import CanFrame
from zoo_can.planting import (
    DOWNLOAD,
    LATENCY_NS,
    MODEL,
    REFUSED,
    UPLOAD,
    around,
    can_mutant,
    replies,
    requests,
)

ACCEPTED, READ = 0x60, 0x42
UPLOADS = range(8)
LATEST_NS = 1_000_000_000


def _changed(patch: MonkeyPatch, first: int, change: Any_) -> None:
    """Let each reply with that first byte be `change(reply, request)`."""
    replies(patch, lambda reply, request: change(reply, request) if reply[0] == first else reply)


# --- the form of replies -------------------------------------------------------------------------


@can_mutant("MACC-SDO-01")
def acceptance_repeats_the_parameters(patch: MonkeyPatch) -> None:
    """60h is followed by the four bytes that were taken."""
    _changed(patch, ACCEPTED, lambda reply, request: reply[:4] + request[4:])


@can_mutant("MACC-SDO-09", traps=(35,))
def acceptance_forgets_the_sub_index(patch: MonkeyPatch) -> None:
    """60h repeats the index, and 00 for the sub-index."""
    _changed(patch, ACCEPTED, lambda reply, request: reply[:3] + b"\0" + reply[4:])


@can_mutant("MACC-SDO-01")
def acceptance_of_a_motion_is_an_answer(patch: MonkeyPatch) -> None:
    """Motions are acknowledged by 42h, as if something had been asked."""
    _changed(
        patch,
        ACCEPTED,
        lambda reply, request: bytes((READ if reply[1] in (0x13, 0x19) else ACCEPTED,)) + reply[1:],
    )


@can_mutant("MACC-SDO-02", traps=(4,))
def only_some_refusals_have_a_reason(patch: MonkeyPatch) -> None:
    """A lock in motion gets an abort code of the standard, everything else zeros."""

    def change(reply: bytes, request: bytes) -> bytes:
        return reply[:4] + b"\x22\0\0\x08" if request[0] == DOWNLOAD and request[1] in (
            0x13, 0x14,
        ) else reply  # fmt: skip

    _changed(patch, REFUSED, change)


@can_mutant("MACC-SDO-02")
def a_lock_is_acknowledged(patch: MonkeyPatch) -> None:
    """13h and 14h in motion are refused, but acknowledged with 60h."""
    _changed(
        patch,
        REFUSED,
        lambda reply, request: (
            bytes((ACCEPTED if reply[1] in (0x13, 0x14) else REFUSED,)) + reply[1:]
        ),
    )


@can_mutant("MACC-SDO-02", traps=(35,))
def refusals_forget_what_they_refuse(patch: MonkeyPatch) -> None:
    """80h is followed by seven zeros."""
    _changed(patch, REFUSED, lambda reply, request: reply[:1] + bytes(7))


@can_mutant("MACC-SDO-03", traps=(3,))
def short_answers_tell_their_size(patch: MonkeyPatch) -> None:
    """The first byte of 2005h's and 2006h's answers counts their bytes, as the standard has it."""
    _changed(
        patch, READ, lambda reply, request: bytes((0x4B if reply[1] > 4 else READ,)) + reply[1:]
    )


@can_mutant("MACC-SDO-03")
def answers_end_with_their_last_byte_that_is_not_0(patch: MonkeyPatch) -> None:
    """Trailing zeros of an answer are not sent."""
    _changed(patch, READ, lambda reply, request: reply[:4] + reply[4:].rstrip(b"\0"))


@can_mutant("MACC-SDO-03", traps=(35,))
def answers_to_2003h_name_2002h(patch: MonkeyPatch) -> None:
    """The inferior stop is answered under the index of the superior one."""
    _changed(
        patch,
        READ,
        lambda reply, request: reply[:1] + (b"\x02" if reply[1] == 3 else reply[1:2]) + reply[2:],
    )


# --- numbers -------------------------------------------------------------------------------------


def _swapped(number: int, size: int = 4) -> int:
    return int.from_bytes((number & (1 << 8 * size) - 1).to_bytes(size, "big"), "little")


@mutant("MACC-SDO-04", "MACC-CMD-0D-01", model=MODEL, traps=(1,))
def the_period_is_little_endian(patch: MonkeyPatch) -> None:
    """200Dh takes its word with the least significant byte first, as it is CANopen."""
    setter(patch, 0x0D, lambda n: _swapped(n, 2) or 1)


@mutant("MACC-SDO-04", "MACC-CMD-16-01", model=MODEL, traps=(1,))
def segments_are_little_endian(patch: MonkeyPatch) -> None:
    """The manual's example 03 E8 10 00 is -6141 steps of 16 ticks."""
    on(patch, 0x16, lambda go, axis, now, n: go(_swapped(n >> 16, 2) << 16 | _swapped(n, 2)))


@mutant("MACC-SDO-04", "MACC-Q-00-01", model=MODEL, traps=(1,))
def positions_are_told_little_endian(patch: MonkeyPatch) -> None:
    """2000h tells the last two bytes the other way round."""
    answers(patch, 0x20, lambda value, axis, now: value & 0xFFFF0000 | _swapped(value, 2))


@can_mutant("MACC-SDO-10", traps=(2,))
def the_index_may_be_turned_round(patch: MonkeyPatch) -> None:
    """An index with its high byte first is taken as well."""

    def act(serve: Any_, _: MacCan, request: bytes) -> object:
        is_turned = request[1] == 0x20 and request[2] < 0x20
        return serve(request[:1] + request[2:0:-1] + request[3:] if is_turned else request)

    requests(patch, act)


@mutant("MACC-CMD-15-01", model=MODEL, traps=(22,))
def the_direction_is_the_first_byte(patch: MonkeyPatch) -> None:
    """SS of 2015h is byte 4, not byte 5."""
    on(patch, 0x15, lambda go, axis, now, n: go((n >> 8 & 0xFF0000) | n & 0xFFFF))


@mutant("MACC-CMD-02-01", "MACC-SDO-12", model=MODEL, traps=(21,))
def half_torque_is_0dh(patch: MonkeyPatch) -> None:
    """The page's 0dh is read as a number: 2002h takes 0Dh for half torque."""
    setter(patch, 0x02, lambda n: {0x0D: 1, 1: 0}.get(n & 0xFF, n))


# --- an index is two things ----------------------------------------------------------------------


@can_mutant("MACC-SDO-05", traps=(5,))
def reading_2001h_restores_the_factory_values(patch: MonkeyPatch) -> None:
    """The object 2001h is what its index says, however it is reached."""

    def act(serve: Any_, module: MacCan, request: bytes) -> object:
        if request[:3] == b"\x40\x01\x20":
            address = module.axis.stored["address"]
            module.axis.restore_factory_values(module._now)
            module.axis.parameters.store("address", address)
        return serve()

    requests(patch, act)


@can_mutant("MACC-SDO-05", traps=(5,))
def reading_2000h_restarts(patch: MonkeyPatch) -> None:
    """An upload of 2000h answers, and then the module starts anew."""

    def act(serve: Any_, module: MacCan, request: bytes) -> object:
        reply = serve()
        if request[:3] == b"\x40\x00\x20" and request[4:] == b"\xff\xff\xff\xff":
            module._restart()
        return reply

    requests(patch, act)


@can_mutant("MACC-SDO-05", traps=(5, 6))
def writing_2002h_writes_what_reading_2002h_tells(patch: MonkeyPatch) -> None:
    """2002h sets the torque at rest and the superior stop at once."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        reply = serve()
        if request[:3] == b"\x23\x02\x20" and reply and reply[0] == ACCEPTED:
            module.axis.parameters.set_superior_stop(request[7])
        return reply

    requests(patch, act)


@can_mutant("MACC-Q-XX-01", "MACC-SDO-10", traps=(6,))
def what_is_written_can_be_read_there(patch: MonkeyPatch) -> None:
    """Uploads of 2009h and 200Ah tell the stops that downloads of them set."""

    def act(serve: Any_, _: MacCan, request: bytes) -> Any:
        if request[0] != UPLOAD or request[1:3] not in (b"\x09\x20", b"\x0a\x20"):
            return serve()
        reply = serve(b"\x40" + bytes((request[1] - 7,)) + request[2:])
        return reply[:1] + request[1:4] + reply[4:]

    requests(patch, act)


@can_mutant("MACC-Q-02-01", "MACC-Q-03-01", traps=(6,))
def uploads_of_the_stops_are_exchanged(patch: MonkeyPatch) -> None:
    """2002h tells the inferior stop, 2003h the superior one."""
    other = {2: 3, 3: 2}

    def act(serve: Any_, _: MacCan, request: bytes) -> Any:
        if request[0] != UPLOAD or request[2] != 0x20 or request[1] not in other:
            return serve()
        reply = serve(b"\x40" + bytes((other[request[1]],)) + request[2:])
        return reply[:1] + request[1:4] + reply[4:]

    requests(patch, act)


# --- once, and when ------------------------------------------------------------------------------


@can_mutant("MACC-SDO-06")
def the_end_of_a_motion_is_announced(patch: MonkeyPatch) -> None:
    """When a motion ends, its 60h is sent once more."""

    def make(wake: Any_) -> Any_:
        def waking(module: MacCan, now: int) -> Any:
            was = module.axis.drive.kind
            effects = wake(module, now)
            if was is not None and module.axis.drive.kind is None and module._listens:
                again = CanFrame(0x580 + module.address, b"\x60\x13\x20\0\0\0\0\0")
                return [*effects, SendFrame(now, again)]
            return effects

        return waking

    wrap(patch, MacCan, "wake", make)


@can_mutant("MACC-SDO-06")
def answers_come_twice(patch: MonkeyPatch) -> None:
    """An answer whose acknowledgement was not seen at once is repeated: 2004h always."""

    def act(go: Any_, module: MacCan, identifier: int | None, reply: bytes | None) -> None:
        go()
        if identifier is not None and reply is not None and reply[:2] == b"\x42\x04":
            module._send(identifier, reply, module._now + 2 * LATENCY_NS)

    around(patch, "_answer", act)


@can_mutant("MACC-SDO-06")
def a_velocity_is_acknowledged_again_on_its_way(patch: MonkeyPatch) -> None:
    """The 60h to 2015h comes a second time, 300 ms after the first."""

    def act(go: Any_, module: MacCan, identifier: int | None, reply: bytes | None) -> None:
        go()
        if identifier is not None and reply is not None and reply[:2] == b"\x60\x15":
            module._send(identifier, reply, module._now + 300_000_000)

    around(patch, "_answer", act)


@can_mutant("MACC-SDO-13")
def a_move_is_acknowledged_when_it_is_over(patch: MonkeyPatch) -> None:
    """The reply to 2013h waits for the end of the motion, though not longer than a second."""

    def act(go: Any_, module: MacCan, identifier: int, data: bytes, start_ns: int) -> Any:
        due_ns = module.axis.next_event() if data[:2] == b"\x60\x13" else None
        delay_ns = min(max(0, (due_ns or 0) - start_ns), LATEST_NS)
        return go(identifier, data, start_ns + delay_ns)

    around(patch, "_send", act)


@can_mutant("MACC-SDO-13")
def an_endless_motion_is_acknowledged_late(patch: MonkeyPatch) -> None:
    """The reply to 2015h comes a second after it has begun."""

    def act(go: Any_, module: MacCan, identifier: int, data: bytes, start_ns: int) -> Any:
        is_late = data[:2] == b"\x60\x15"
        return go(identifier, data, start_ns + (LATEST_NS if is_late else 0))

    around(patch, "_send", act)


@can_mutant("MACC-SDO-14")
def uploads_are_refused_in_motion(patch: MonkeyPatch) -> None:
    """2005h and 2006h are answered at rest only."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        is_late = request[0] == UPLOAD and request[1] in (5, 6) and request[2] == 0x20
        if is_late and module.axis.drive.kind is not None:
            return module._refused(request, 0)
        return serve()

    requests(patch, act)


@can_mutant("MACC-SDO-14")
def a_question_ends_the_motion(patch: MonkeyPatch) -> None:
    """Each reading of 2001h in a move ends it a little early."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        if request[:3] == b"\x40\x01\x20" and module.axis.drive.kind is not None:
            module.axis.drive.ramped_stop(module._now)
        return serve()

    requests(patch, act)


# --- what does not matter ------------------------------------------------------------------------


@can_mutant("MACC-SDO-07", traps=(36,))
def an_upload_wants_zeros_behind_it(patch: MonkeyPatch) -> None:
    """An upload request with a last byte that is not 0 is refused."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        is_filled = request[0] == UPLOAD and request[2] == 0x20 and request[7]
        return module._refused(request, 0) if is_filled else serve()

    requests(patch, act)


@can_mutant("MACC-SDO-07")
def the_filler_of_an_upload_comes_back(patch: MonkeyPatch) -> None:
    """The last byte behind an upload request is ORed into the answer."""
    _changed(patch, READ, lambda reply, request: reply[:7] + bytes([reply[7] | request[7]]))


@can_mutant("MACC-SDO-09", traps=(35,))
def answers_forget_the_sub_index(patch: MonkeyPatch) -> None:
    """An answer has 00 where the sub-index was."""
    _changed(patch, READ, lambda reply, request: reply[:3] + b"\0" + reply[4:])


@can_mutant("MACC-SDO-09")
def the_sub_index_counts_objects(patch: MonkeyPatch) -> None:
    """An upload with sub-index n tells what the n-th object behind tells."""

    def act(serve: Any_, _: MacCan, request: bytes) -> Any:
        index = request[1] + request[3]
        if request[0] != UPLOAD or request[2] != 0x20 or not request[3] or index not in UPLOADS:
            return serve()
        reply = serve(b"\x40" + bytes((index,)) + request[2:])
        return reply[:1] + request[1:4] + reply[4:]

    requests(patch, act)


@can_mutant("MACC-SDO-09")
def the_sub_index_is_the_top_of_a_number(patch: MonkeyPatch) -> None:
    """The sub-index of a download comes into the first byte of its number."""

    def act(serve: Any_, _: MacCan, request: bytes) -> Any:
        if request[0] != DOWNLOAD or request[2] != 0x20:
            return serve()
        return serve(request[:4] + bytes((request[3] ^ request[4],)) + request[5:])

    requests(patch, act)


@can_mutant("MACC-SDO-09")
def the_sub_index_is_the_top_of_a_target(patch: MonkeyPatch) -> None:
    """The sub-index of a download of a target comes into the second byte of its number."""

    def act(serve: Any_, _: MacCan, request: bytes) -> Any:
        if request[:3] != bytes((DOWNLOAD, 0x13, 0x20)):
            return serve()
        return serve(request[:5] + bytes((request[3] ^ request[5],)) + request[6:])

    requests(patch, act)


@can_mutant("MACC-SDO-09")
def a_download_to_a_sub_index_is_lost(patch: MonkeyPatch) -> None:
    """A download with a sub-index other than 00 is acknowledged and sets nothing."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        is_lost = request[0] == DOWNLOAD and request[2] == 0x20 and request[3]
        return module._accepted(request) if is_lost and request[1] < 0x10 else serve()

    requests(patch, act)


# --- what is no request --------------------------------------------------------------------------


@can_mutant("MACC-SDO-10")
def the_high_byte_of_the_index_is_not_looked_at(patch: MonkeyPatch) -> None:
    """21xxh to FFxxh are 20xxh."""

    def act(serve: Any_, _: MacCan, request: bytes) -> Any:
        if request[2] <= 0x20:
            return serve()
        reply = serve(request[:2] + b"\x20" + request[3:])
        return reply and reply[:2] + request[2:3] + reply[3:]

    requests(patch, act)


@can_mutant("MACC-SDO-10", traps=(35,))
def refusals_name_20h_whatever_was_asked(patch: MonkeyPatch) -> None:
    """The high byte of the index in a refusal is a constant."""
    _changed(patch, REFUSED, lambda reply, request: reply[:2] + b"\x20" + reply[3:])


@can_mutant("MACC-SDO-10")
def the_first_bits_of_a_command_byte_are_not_looked_at(patch: MonkeyPatch) -> None:
    """03h, 43h, 63h and so on up to E3h are all 23h."""

    def act(serve: Any_, _: MacCan, request: bytes) -> Any:
        is_download = request[0] & 0x1F == 0x03
        return serve(b"\x23" + request[1:] if is_download else request)

    requests(patch, act)


@can_mutant("MACC-SDO-12")
def what_is_no_request_is_refused_and_executed(patch: MonkeyPatch) -> None:
    """A segment of the standard (00h) is refused, but its last byte is stored as torque limit."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        if request[0] < 0x20 and request[1:3] == b"\x0c\x20":
            module.axis.parameters.set_torque(request[7])
        return serve()

    requests(patch, act)


@can_mutant("MACC-SDO-11")
def seven_bytes_are_enough(patch: MonkeyPatch) -> None:
    """A request of seven bytes is served as if its last one were 0, a shorter one is not."""
    _whole(patch, lambda data: data.ljust(8, b"\0") if len(data) == 7 else None)


@can_mutant("MACC-SDO-11")
def four_bytes_of_an_upload_are_enough(patch: MonkeyPatch) -> None:
    """Of an upload request the filler may be missing, but not only a part of it."""
    _whole(
        patch, lambda data: data.ljust(8, b"\0") if data[:1] == b"@" and len(data) == 4 else None
    )


def _whole(patch: MonkeyPatch, complete: Any_) -> None:
    around(
        patch,
        "_whole",
        lambda go, module, data: go() if len(data) == 8 else complete(data),
    )


@can_mutant("MACC-SDO-12")
def a_short_download_is_executed_mutely(patch: MonkeyPatch) -> None:
    """A download of five to seven bytes gets no reply, but what is there of it is stored."""

    def act(go: Any_, module: MacCan, data: bytes) -> object:
        if 5 <= len(data) < 8 and data[0] == DOWNLOAD:
            module._serve(data.ljust(8, b"\0"))
        return go()

    around(patch, "_whole", act)


@can_mutant("MACC-CMD-XX-01")
def one_unassigned_download_is_accepted(patch: MonkeyPatch) -> None:
    """2012h is accepted without effect, its neighbours are refused."""
    replies(
        patch,
        lambda reply, request: b"\x60" + reply[1:] if request[:3] == b"\x23\x12\x20" else reply,
    )


@can_mutant("MACC-CMD-XX-01")
def the_address_can_be_downloaded(patch: MonkeyPatch) -> None:
    """2008h is accepted, as 08h is on the serial line, and changes no address."""
    replies(
        patch,
        lambda reply, request: b"\x60" + reply[1:] if request[:3] == b"\x23\x08\x20" else reply,
    )


@can_mutant("MACC-Q-XX-01")
def the_memory_can_be_uploaded(patch: MonkeyPatch) -> None:
    """2008h answers with bytes of the memory, as 28h does on the serial line."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        if request[:3] != b"\x40\x08\x20":
            return serve()
        image = module.axis.memory(module._now, ram=True)
        return module._read(request, image[0xAF:0xB3])

    requests(patch, act)


@mutant("MACC-SDO-08", model=MODEL)
def every_bit_of_200fh_counts(patch: MonkeyPatch) -> None:
    """200Fh ORs the bytes printed x into its value."""
    setter(patch, 0x0F, lambda n: (n | n >> 8 | n >> 16 | n >> 24) & 0xFF)


@mutant("MACC-Q-07-01", model=MODEL, traps=(29,))
def under_voltage_shows_as_the_reference_input(patch: MonkeyPatch) -> None:
    """Bit dd.5 of 2007h is the one of 2001h."""

    def change(value: int, axis: Axis, _: int) -> int:
        return value & ~0x20 | (0x20 if axis.faults.word & 0x20 else 0)

    answers(patch, 0x27, change)
