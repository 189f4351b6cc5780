"""Faults in telling what is a frame, for whom it is, and what its characters mean."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mac.axis.acceptance import SIGNIFICANT
from axistwin.devices.mac.serial import framing
from axistwin.devices.mac.serial.device import MacSerial
from axistwin.devices.mac.serial.framing import ETX, HEX, STX
from axistwin.runtime.network import SerialNetwork
from axistwin.wire.framing import LineFormat
from zoo.mutant import Any_, MonkeyPatch, everywhere, frames, mutant, on, setter, wrap


@mutant("MACS-LINE-01")
def autobaud(patch: MonkeyPatch) -> None:
    """The module follows whatever rate the host talks."""

    def follow(network: SerialNetwork, line_format: LineFormat) -> None:
        for device in network.devices:
            device._line_format = line_format  # type: ignore[attr-defined]
        for index, device in enumerate(network.devices):
            network._formats[index] = device.line_format
            network._line.set_format(index + 1, device.line_format)
        network._line.set_format(0, line_format)

    host_format = vars(SerialNetwork)["host_format"]
    patch.setattr(SerialNetwork, "host_format", host_format.setter(follow))


def _frames_end_with_etx(patch: MonkeyPatch) -> None:
    def next_frame(buffer: bytes, after: int) -> tuple[int, int]:
        start = buffer.find(STX, after)
        end = buffer.find(bytes([ETX]), start) + 1 if start >= 0 else 0
        return (start, end) if end else (-1, max(start, 0) if start >= 0 else len(buffer))

    everywhere(patch, framing.is_one_frame, lambda data: False)
    everywhere(patch, framing.next_frame, next_frame)


@mutant("MACS-FRAME-01")
def any_length_will_do(patch: MonkeyPatch) -> None:
    """A frame is what stands between Stx and Etx; the last 17 characters of it count."""
    _frames_end_with_etx(patch)
    take_apart = framing.take_apart

    def cut(frame: bytes) -> bytes:
        return frame[:4].ljust(4, b"0") + frame[-17:].rjust(17, b"0")

    everywhere(patch, take_apart, lambda frame, any_case: take_apart(cut(frame), any_case))
    frames(patch, lambda judge, module, frame, request: judge(cut(frame), request))


@mutant("MACS-FRAME-04", traps=(10,))
def an_index_may_be_spelt_in_lower_case(patch: MonkeyPatch) -> None:
    """The index is read in either case, all other digits in upper case only."""
    take_apart = framing.take_apart

    def taking(frame: bytes, any_case: bool) -> framing.MacRequest:
        index = framing.ANY_CASE.get(frame[6:8])
        return take_apart(frame, any_case)._replace(command=index)

    everywhere(patch, take_apart, taking)


@mutant("MACS-FRAME-02", "MACS-FRAME-12")
def the_length_field_is_skipped(patch: MonkeyPatch) -> None:
    """Three bytes after Stx are skipped, whatever they are."""
    everywhere(patch, framing.is_framed, lambda frame: frame[20] == ETX)


@mutant("MACS-FRAME-02", traps=(2,))
def the_length_field_is_hexadecimal(patch: MonkeyPatch) -> None:
    """The length field is read as a number in hex too, so 00E counts 14 characters as well."""
    is_framed = framing.is_framed
    everywhere(
        patch,
        is_framed,
        lambda frame: is_framed(frame) or (frame[1:4] == b"00E" and frame[20] == ETX),
    )


@mutant("MACS-FRAME-12")
def etx_is_not_looked_at(patch: MonkeyPatch) -> None:
    """The frame is over after 21 bytes, whatever the last one is."""
    everywhere(patch, framing.is_framed, lambda frame: frame[1:4] == b"014")


def _also_takes(patch: MonkeyPatch, extra: int) -> None:
    """Accept sums that are wrong by `extra` beside the right ones."""
    take_apart = framing.take_apart

    def lenient(frame: bytes, any_case: bool) -> framing.MacRequest:
        request = take_apart(frame, any_case)
        other = HEX[(sum(frame[4:18]) + extra) & 0xFF]
        return request._replace(is_sum_right=request.is_sum_right or frame[18:20] == other)

    everywhere(patch, take_apart, lenient)


@mutant("MACS-FRAME-03", traps=(1,))
def the_sum_over_the_length_field_passes(patch: MonkeyPatch) -> None:
    """A checksum that includes 014 is taken for right as well."""
    _also_takes(patch, 0x95)


@mutant("MACS-FRAME-03", "MACS-REPLY-02", traps=(1,))
def the_sum_from_stx_on_passes(patch: MonkeyPatch) -> None:
    """A checksum that includes Stx and 014 is taken for right as well."""
    _also_takes(patch, 0x97)


@mutant("MACS-FRAME-03", "MACS-REPLY-11")
def the_last_digit_of_the_sum_is_not_compared(patch: MonkeyPatch) -> None:
    """Only the first digit of the checksum is compared."""
    take_apart = framing.take_apart

    def lenient(frame: bytes, any_case: bool) -> framing.MacRequest:
        right = framing.checksum(frame[4:18])[:1] == frame[18:19]
        return take_apart(frame, any_case)._replace(is_sum_right=right)

    everywhere(patch, take_apart, lenient)


@mutant("MACS-FRAME-13", traps=(10,))
def numbers_are_parsed_by_a_library(patch: MonkeyPatch) -> None:
    """Blanks, signs and underscores inside a number pass, as in int(text, 16)."""

    def lenient(digits: bytes, *, any_case: bool) -> int | None:
        try:
            return int(digits.decode("latin-1").replace("_", ""), 16) & 0xFFFFFFFF
        except ValueError:
            return None

    everywhere(patch, framing.number, lenient)


@mutant("MACS-FRAME-05", "MACS-CMD-09-01", traps=(8,))
def the_superior_stop_is_little_endian(patch: MonkeyPatch) -> None:
    """09h takes its number with the least significant byte first."""
    setter(patch, 0x09, lambda n: int.from_bytes(n.to_bytes(4, "big"), "little"))


@mutant("MACS-FRAME-05", traps=(39,))
def negative_targets_lose_their_sign(patch: MonkeyPatch) -> None:
    """13h takes its number without a sign, down to 0."""
    on(patch, 0x13, lambda go, axis, now, n: go(n & 0x7FFFFFFF if n >> 31 else n))


@mutant("MACS-FRAME-06", traps=(9,))
def the_whole_parameter_counts(patch: MonkeyPatch) -> None:
    """0Ch ORs the bytes printed x into its value."""
    setter(patch, 0x0C, lambda n: (n | n >> 8 | n >> 16 | n >> 24) & 0x7F if n >> 8 else n)


@mutant("MACS-FRAME-07")
def the_top_bit_of_the_address_is_ignored(patch: MonkeyPatch) -> None:
    """Addresses are compared in seven bits, so that 80h is 00h."""

    def make(concerns: Any_) -> Any_:
        def concerned(module: MacSerial, request: Any) -> bool:
            return bool(concerns(module, request)) or request.address == module.address | 0x80

        return concerned

    wrap(patch, MacSerial, "_concerns", make)
    frames(
        patch,
        lambda judge, module, frame, request: (
            judge(frame, request._replace(address=module.address))
            if request.address == module.address | 0x80
            else judge()
        ),
    )


@mutant("MACS-REPLY-13")
def frames_for_others_are_executed_mutely(patch: MonkeyPatch) -> None:
    """A command for another address is executed, only the reply is kept back."""
    wrap(patch, MacSerial, "_concerns", lambda concerns: lambda module, request: True)

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        foreign = request.address not in (module.address, 0xFF, None)
        if foreign and request.is_sum_right and request.command is not None:
            number = framing.number(frame[10:18], any_case=False) or 0
            if request.command < 0x20:
                module._command(request.command, number, general=False)
            return
        judge()

    frames(patch, act)


@mutant("MACS-FRAME-08", "MACS-Q-XX-02")
def the_second_digit_of_a_query_is_enough(patch: MonkeyPatch) -> None:
    """Every index from 30h up is answered like the query with the same second digit."""

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        index = request.command
        if index is not None and index >= 0x30 and index & 0xF < 0xA:
            index = 0x20 | index & 0xF
        judge(frame, request._replace(command=index))

    frames(patch, act)


@mutant("MACS-FRAME-09")
def the_sub_index_selects_a_query(patch: MonkeyPatch) -> None:
    """The sub-index is added to the index of a query that is no memory query."""

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        index, sub_index = request.command, frame[8:10]
        if index is not None and 0x20 <= index < 0x27 and sub_index == b"01":
            request = request._replace(command=index + 1)
        judge(frame, request)

    frames(patch, act)


@mutant("MACS-FRAME-09")
def the_sub_index_is_the_top_of_a_number(patch: MonkeyPatch) -> None:
    """The last digit of a sub-index other than 00 takes the place of the first of the number."""

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        if request.command is not None and request.command < 0x20 and frame[8:10] != b"00":
            frame = frame[:10] + frame[9:10] + frame[11:]
        judge(frame, request)

    frames(patch, act)


@mutant("MACS-FRAME-09")
def the_sub_index_is_the_top_of_a_target(patch: MonkeyPatch) -> None:
    """The last digit of a sub-index other than 00 takes the place of the third of a target."""

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        if request.command == 0x13 and frame[8:10] != b"00":
            frame = frame[:12] + frame[9:10] + frame[13:]
        judge(frame, request)

    frames(patch, act)


@mutant("MACS-FRAME-10")
def noise_spoils_the_next_frame(patch: MonkeyPatch) -> None:
    """Reception counts 21 bytes from the first byte heard, be it Stx or not."""
    next_frame = framing.next_frame

    def counting(buffer: bytes, after: int) -> tuple[int, int]:
        start, end = next_frame(buffer, after)
        if start > after:
            return -1, len(buffer)
        return start, end

    everywhere(patch, next_frame, counting)


@mutant("MACS-FRAME-11")
def stx_does_not_restart_reception(patch: MonkeyPatch) -> None:
    """An Stx inside a frame is a byte like any other."""

    def next_frame(buffer: bytes, after: int) -> tuple[int, int]:
        start = buffer.find(STX, after)
        if start < 0:
            return -1, len(buffer)
        end = start + framing.REQUEST_BYTES
        return (start, end) if end <= len(buffer) else (-1, start)

    everywhere(patch, framing.is_one_frame, lambda data: False)
    everywhere(patch, framing.next_frame, next_frame)


@mutant("MACS-FRAME-14")
def a_pause_drops_the_frame(patch: MonkeyPatch) -> None:
    """A second without a byte empties the receiver."""

    def make(receive: Any_) -> Any_:
        def receiving(module: Any, chunk: Any) -> Any:
            if chunk.start_ns - getattr(module, "heard_ns", chunk.start_ns) > 1_000_000_000:
                module.reception.partial = b""
            module.heard_ns = chunk.start_ns
            return receive(module, chunk)

        return receiving

    wrap(patch, MacSerial, "receive", make)


@mutant("MACS-FRAME-07")
def addresses_from_80_up_are_general(patch: MonkeyPatch) -> None:
    """Every address from 80h up is that of all modules."""
    wrap(
        patch,
        MacSerial,
        "_concerns",
        lambda concerns: (
            lambda module, request: concerns(module, request) or (request.address or 0) >= 0x80
        ),
    )
    frames(
        patch,
        lambda judge, module, frame, request: judge(
            frame,
            request._replace(address=framing.GENERAL_ADDRESS)
            if (request.address or 0) >= 0x80
            else request,
        ),
    )


@mutant("MACS-FRAME-08")
def indices_from_40_up_are_commands(patch: MonkeyPatch) -> None:
    """The upper three bits of an index from 40h up are not looked at."""
    frames(
        patch,
        lambda judge, module, frame, request: judge(
            frame,
            request._replace(command=request.command & 0x1F)
            if (request.command or 0) >= 0x40
            else request,
        ),
    )


@mutant("MACS-FRAME-01")
def a_frame_without_a_sum_passes(patch: MonkeyPatch) -> None:
    """A frame whose Etx stands where the sum should be is taken for right."""
    _frames_end_with_etx(patch)
    take_apart = framing.take_apart

    def whole(frame: bytes) -> bytes:
        summed = frame[:18] + HEX[sum(frame[4:18]) & 0xFF] + frame[18:]
        return (summed if len(frame) == 19 else frame)[:21].ljust(21, b"\0")

    everywhere(patch, take_apart, lambda frame, any_case: take_apart(whole(frame), any_case))
    frames(patch, lambda judge, module, frame, request: judge(whole(frame), request))


@mutant("MACS-REPLY-13")
def a_stop_for_another_stops(patch: MonkeyPatch) -> None:
    """18h stops the axis, whoever it is for."""
    wrap(patch, MacSerial, "_concerns", lambda concerns: lambda module, request: True)

    def act(judge: Any_, module: MacSerial, _: bytes, request: Any) -> None:
        if request.address in (module.address, framing.GENERAL_ADDRESS):
            judge()
        elif request.is_framed and request.is_sum_right and request.command == 0x18:
            module._command(0x18, 0, general=False)

    frames(patch, act)


@mutant("MACS-MULTI-02")
def motions_for_all_concern_module_00_only(patch: MonkeyPatch) -> None:
    """The others take settings from FF, and no motion."""

    def make(command: Any_) -> Any_:
        def commanding(module: MacSerial, index: int, n: int, *, general: bool) -> Any:
            if 0x13 <= index <= 0x16 and general and module.address:
                return module._accepted
            return command(module, index, n, general=general)

        return commanding

    wrap(patch, MacSerial, "_command", make)


@mutant("MACS-MULTI-01")
def it_answers_for_its_neighbour_too(patch: MonkeyPatch) -> None:
    """The lowest bit of the address is not compared: 00 and 01 both answer for 01."""

    def make(concerns: Any_) -> Any_:
        def concerned(module: MacSerial, request: Any) -> bool:
            return bool(concerns(module, request)) or request.address == module.address | 1

        return concerned

    wrap(patch, MacSerial, "_concerns", make)
    frames(
        patch,
        lambda judge, module, frame, request: judge(
            frame,
            request._replace(
                address=module.address if request.address == module.address | 1 else request.address
            ),
        ),
    )


@mutant("MACS-MULTI-03")
def another_than_module_00_answers_for_all(patch: MonkeyPatch) -> None:
    """On a shared line the module that is not 00 answers frames to FF, and 00 does not."""
    wrap(
        patch, MacSerial, "_answers_general",
        lambda answers: lambda module: answers(module) is module.alone,
    )  # fmt: skip


@mutant("MACS-MULTI-02", traps=(35,))
def general_frames_reach_module_00_only(patch: MonkeyPatch) -> None:
    """A module other than 00 takes FF for the address of somebody else."""

    def make(concerns: Any_) -> Any_:
        def concerned(module: MacSerial, request: Any) -> bool:
            if request.address == framing.GENERAL_ADDRESS and module.address:
                return False
            return bool(concerns(module, request))

        return concerned

    wrap(patch, MacSerial, "_concerns", make)


@mutant("MACS-MULTI-02")
def sync_is_not_heard_in_general_frames(patch: MonkeyPatch) -> None:
    """11h to FF starts module 00 only; the others wait for one of their own."""

    def make(command: Any_) -> Any_:
        def commanding(module: MacSerial, index: int, n: int, *, general: bool) -> Any:
            if index == 0x11 and general and module.address:
                return module._accepted
            return command(module, index, n, general=general)

        return commanding

    wrap(patch, MacSerial, "_command", make)


@mutant("MACS-FRAME-13")
def a_character_counts_as_0_in_the_new_address(patch: MonkeyPatch) -> None:
    """08h takes what is no digit for 0."""
    patch.setitem(SIGNIFICANT, 0x08, 0)


@mutant("MACS-FRAME-13")
def a_character_counts_as_0_in_15h(patch: MonkeyPatch) -> None:
    """15h takes what is no digit for 0."""
    patch.setitem(SIGNIFICANT, 0x15, 0)


@mutant("MACS-FRAME-01")
def a_frame_of_13_characters_passes_under_their_sum(patch: MonkeyPatch) -> None:
    """Etx ends a frame; one character short, and its sum right, it counts as with a 0 in front."""
    _frames_end_with_etx(patch)
    take_apart = framing.take_apart

    def whole(frame: bytes) -> bytes:
        summed = frame[4:-3]
        if len(frame) != 20 or HEX[sum(summed) & 0xFF] != frame[-3:-1]:
            return frame if len(frame) == 21 else frame[:4].ljust(21, b"0")
        padded = summed[:6] + b"0" + summed[6:]
        return frame[:4] + padded + HEX[sum(padded) & 0xFF] + frame[-1:]

    everywhere(patch, take_apart, lambda frame, any_case: take_apart(whole(frame), any_case))
    frames(patch, lambda judge, module, frame, request: judge(whole(frame), request))
