"""Faults in what the module says, and when."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.serial import device as serial
from axistwin.devices.mac.serial.device import MacSerial
from axistwin.devices.mac.serial.framing import HEX, number
from axistwin.kernel.effects import Transmit
from zoo.mutant import Any_, MonkeyPatch, frames, mutant, on, replies, wrap

LATEST_NS = 1_000_000_000
ACCEPTED, REFUSED = b"\x06\x13\x1a", b"\x06\x13\x17"
QUERIES = range(0x20, 0x2A)


def _answer(data: bytes, digit: bytes, change: Any_) -> bytes:
    """`change(data)` if this is the answer with that digit."""
    return bytes(change(data)) if len(data) == 21 and data[8:9] == digit else data


def _summed(data: bytes) -> bytes:
    """The answer with its checksum made right."""
    return data[:17] + HEX[sum(data[6:17]) & 0xFF] + data[19:]


@mutant("MACS-LINE-02", "MACS-REPLY-03")
def xoff_is_swallowed_in_refusals(patch: MonkeyPatch) -> None:
    """A driver with software flow control eats the 13h of refusals."""
    replies(patch, lambda data, _: b"\x06\x17" if data == REFUSED else data)


@mutant("MACS-REPLY-01")
def acceptance_is_acknowledged_twice(patch: MonkeyPatch) -> None:
    """06 06 13 1A: one Ack for the frame, one for its execution."""
    replies(patch, lambda data, _: b"\x06" + data if data == ACCEPTED else data)


@mutant("MACS-REPLY-02", traps=(3,))
def the_nack_is_wrapped(patch: MonkeyPatch) -> None:
    """A wrong sum gets Nack, Xoff, Xon."""
    patch.setattr(serial, "NACK", b"\x15\x13\x1a")


@mutant("MACS-REPLY-02", traps=(4,))
def a_wrong_sum_is_refused(patch: MonkeyPatch) -> None:
    """A wrong sum gets 06 13 17, as if the command were forbidden."""
    patch.setattr(serial, "NACK", REFUSED)


@mutant("MACS-REPLY-03", traps=(4,))
def a_refusal_is_a_nack(patch: MonkeyPatch) -> None:
    """A forbidden command gets 15, as if its sum were wrong."""
    replies(patch, lambda data, _: b"\x15" if data == REFUSED else data)


@mutant("MACS-REPLY-04")
def a_nacked_command_is_executed(patch: MonkeyPatch) -> None:
    """The sum decides about the reply only; the parameter is stored all the same."""

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        stores = request.command in (0x09, 0x0A, 0x0C, 0x0D, 0x0F)
        if stores and request.address == module.address and not request.is_sum_right:
            value = number(frame[10:18], any_case=False) or 0
            module._command(request.command, value, general=False)
        judge()

    frames(patch, act)


@mutant("MACS-REPLY-04")
def a_nacked_stop_stops(patch: MonkeyPatch) -> None:
    """18h stops the axis before its sum is looked at."""

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        if request.command == 0x18 and not request.is_sum_right:
            module.axis.drive.hard_stop(module._etx_ns)
        judge()

    frames(patch, act)


@mutant("MACS-REPLY-04")
def a_nack_disarms(patch: MonkeyPatch) -> None:
    """A wrong sum drops what 10h has armed."""

    def act(judge: Any_, module: MacSerial, _: bytes, request: Any) -> None:
        if request.is_framed and not request.is_sum_right:
            module.axis._armed = False
        judge()

    frames(patch, act)


@mutant("MACS-REPLY-05")
def a_refusal_disarms(patch: MonkeyPatch) -> None:
    """What is refused drops what 10h has armed."""

    def make(obey: Any_) -> Any_:
        def obeying(module: MacSerial, *frame: Any, **how: Any) -> Any:
            reply = obey(module, *frame, **how)
            module.axis._armed = module.axis._armed and reply != REFUSED
            return reply

        return obeying

    wrap(patch, MacSerial, "_obey", make)


@mutant("MACS-REPLY-06")
def an_unassigned_index_needs_no_sum(patch: MonkeyPatch) -> None:
    """An index without a meaning is refused before the sum is looked at."""

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        index = request.command
        is_none = index is not None and not module.axis.is_assigned(index) and index not in QUERIES
        judge(frame, request._replace(is_sum_right=True) if is_none else request)

    frames(patch, act)


@mutant("MACS-REPLY-01")
def acceptance_of_a_motion_has_no_xon(patch: MonkeyPatch) -> None:
    """13h, 14h and 15h are acknowledged with 06 13."""

    def make(command: Any_) -> Any_:
        def commanding(module: MacSerial, index: int, n: int, *, general: bool) -> Any:
            reply = command(module, index, n, general=general)
            return reply[:2] if 0x13 <= index <= 0x15 and reply == ACCEPTED else reply

        return commanding

    wrap(patch, MacSerial, "_command", make)


@mutant("MACS-REPLY-09")
def eeprom_answers_as_ram(patch: MonkeyPatch) -> None:
    """29h answers with digit 8."""
    replies(
        patch,
        lambda data, _: _answer(data, b"9", lambda data: _summed(data[:8] + b"8" + data[9:])),
    )


@mutant("MACS-REPLY-10")
def the_length_of_an_answer_counts_the_index(patch: MonkeyPatch) -> None:
    """22h answers with 012, as if it repeated both digits of the index."""
    replies(patch, lambda data, _: _answer(data, b"2", lambda data: data[:3] + b"012" + data[6:]))


@mutant("MACS-REPLY-06", traps=(4,))
def the_lock_is_tested_before_the_sum(patch: MonkeyPatch) -> None:
    """A command that would be refused is refused, right sum or not."""

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        index = request.command
        is_known = index is not None and index < 0x20 and not request.is_sum_right
        if is_known and request.is_framed and module.axis.cell(index) == "R":
            request = request._replace(is_sum_right=True)
        judge(frame, request)

    frames(patch, act)


@mutant("MACS-REPLY-05", "MACS-CMD-13-02", traps=(18,))
def a_refused_move_ends_the_running_one(patch: MonkeyPatch) -> None:
    """13h in motion is refused and stops the axis."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        accepted = bool(go())
        if not accepted and axis.drive.kind is not None:
            axis.drive.hard_stop(now)
        return accepted

    on(patch, 0x13, act)


@mutant("MACS-REPLY-05")
def a_refused_period_is_stored(patch: MonkeyPatch) -> None:
    """0Dh in motion is refused, but 25h shows the new value."""

    def act(go: Any_, axis: Axis, _: int, parameters: int) -> bool:
        accepted = bool(go())
        if not accepted and parameters & 0xFFFF:
            axis.parameters.set_period(parameters)
        return accepted

    on(patch, 0x0D, act)


@mutant("MACS-REPLY-07")
def the_eeprom_answer_has_no_xon(patch: MonkeyPatch) -> None:
    """The answer to 29h ends with Etx."""
    replies(patch, lambda data, _: _answer(data, b"9", lambda d: d[:-1]))


@mutant("MACS-REPLY-07", traps=(6,))
def the_whole_index_is_echoed(patch: MonkeyPatch) -> None:
    """The answer to 22h says 22, two digits, and is one character longer."""
    replies(
        patch,
        lambda data, _: _answer(data, b"2", lambda d: _summed(d[:8] + b"2" + d[8:-1]) + d[-1:]),
    )


@mutant("MACS-REPLY-08", traps=(36,))
def the_address_of_an_answer_is_ff(patch: MonkeyPatch) -> None:
    """Answers are made for everybody."""
    replies(patch, lambda d, _: _summed(d[:6] + b"FF" + d[8:]) if len(d) == 21 else d)


@mutant("MACS-REPLY-08")
def eeprom_answers_as_module_01(patch: MonkeyPatch) -> None:
    """The address in the answer to 29h is 01."""
    replies(
        patch,
        lambda data, _: _answer(data, b"9", lambda data: _summed(data[:6] + b"01" + data[8:])),
    )


@mutant("MACS-MULTI-01")
def every_module_answers_as_00(patch: MonkeyPatch) -> None:
    """The address of an answer is the constant 00."""
    replies(patch, lambda d, _: _summed(d[:6] + b"00" + d[8:]) if len(d) == 21 else d)


@mutant("MACS-REPLY-09", traps=(7,))
def the_digit_of_25h_is_copied_from_another_page(patch: MonkeyPatch) -> None:
    """25h answers with digit 2, which the manual prints for 21h and 23h only."""
    replies(patch, lambda data, _: _answer(data, b"5", lambda d: _summed(d[:8] + b"2" + d[9:])))


@mutant("MACS-REPLY-10", traps=(2, 7))
def the_length_of_an_answer_is_copied_from_the_request(patch: MonkeyPatch) -> None:
    """26h answers with 014, which the manual prints for 28h only."""
    replies(patch, lambda data, _: _answer(data, b"6", lambda d: d[:3] + b"014" + d[6:]))


@mutant("MACS-REPLY-11")
def a_query_with_a_wrong_sum_is_dropped(patch: MonkeyPatch) -> None:
    """Only commands are Nacked; a query with a wrong sum is silence."""

    def act(judge: Any_, _: MacSerial, __: bytes, request: Any) -> None:
        if request.is_sum_right or request.command not in QUERIES:
            judge()

    frames(patch, act)


@mutant("MACS-REPLY-12")
def the_end_of_a_motion_is_announced(patch: MonkeyPatch) -> None:
    """When a motion ends, the module sends Xon once more."""

    def make(wake: Any_) -> Any_:
        def waking(module: MacSerial, now: int) -> Any:
            was = module.axis.drive.kind
            effects = wake(module, now)
            ended = was is not None and module.axis.drive.kind is None
            return [*effects, Transmit(now, b"\x1a")] if ended else effects

        return waking

    wrap(patch, MacSerial, "wake", make)


@mutant("MACS-REPLY-12")
def a_nack_is_repeated(patch: MonkeyPatch) -> None:
    """A wrong sum gets 15 15."""
    patch.setattr(serial, "NACK", b"\x15\x15")


@mutant("MACS-REPLY-12")
def a_zero_follows_what_is_said_to_segments(patch: MonkeyPatch) -> None:
    """16h and 1Eh are answered with 06 13 1A 00: the length counts the end of the string."""
    asked = [0]

    def act(judge: Any_, _: MacSerial, __: bytes, request: Any) -> None:
        asked[0] = request.command
        judge()

    frames(patch, act)
    replies(patch, lambda data, _: data + b"\0" * (data == ACCEPTED and asked[0] in (0x16, 0x1E)))


@mutant("MACS-REPLY-14")
def a_move_is_acknowledged_when_it_is_over(patch: MonkeyPatch) -> None:
    """The reply to 13h waits for the end of the motion, though not longer than a second."""

    def make(span: Any_) -> Any_:
        def spanning(module: MacSerial, size: int) -> tuple[int, int]:
            start_ns, end_ns = span(module, size)
            due_ns = module.axis.next_event() if size == 3 else None
            delay_ns = min(max(0, (due_ns or 0) - start_ns), LATEST_NS)
            return start_ns + delay_ns, end_ns + delay_ns

        return spanning

    wrap(patch, MacSerial, "_reply_span", make)


@mutant("MACS-REPLY-08")
def the_address_of_an_answer_is_decimal(patch: MonkeyPatch) -> None:
    """The module tells its address as a decimal number."""
    replies(
        patch,
        lambda data, module: (
            _summed(data[:6] + b"%02d" % (module.address % 100) + data[8:])
            if len(data) == 21
            else data
        ),
    )


@mutant("MACS-REPLY-08")
def the_first_answer_behind_a_command_to_all_is_of_ff(patch: MonkeyPatch) -> None:
    """The address to answer with is set by each frame but a query to the module itself, which takes
    it over once."""
    is_next = [False]

    def act(judge: Any_, _: MacSerial, __: bytes, request: Any) -> None:
        if request.address == 0xFF and (request.command or 0x20) < 0x20:
            is_next[0] = True
        judge()

    def change(data: bytes, _: MacSerial) -> bytes:
        if len(data) != 21 or data[6:8] == b"FF" or not is_next[0]:
            return data
        is_next[0] = False
        return _summed(data[:6] + b"FF" + data[8:])

    frames(patch, act)
    replies(patch, change)


@mutant("MACS-REPLY-12")
def a_minute_of_silence_sends_it_to_sleep(patch: MonkeyPatch) -> None:
    """The first frame after a minute without any wakes the module up, and is lost."""
    heard_ns = [0]

    def act(judge: Any_, module: MacSerial, _: bytes, __: Any) -> None:
        is_asleep = module._etx_ns - heard_ns[0] > 60_000_000_000
        heard_ns[0] = module._etx_ns
        if not is_asleep:
            judge()

    frames(patch, act)
