"""Faults in telling for whom a frame is, and who answers what is said to all (ID, GEN)."""

from __future__ import annotations

from typing import Any

from zoo.mutant import Any_, MonkeyPatch, State

from axistwin.devices.mac.can.device import MacCan
from axistwin.wire.can_frame import CanFrame
from zoo_can.planting import DOWNLOAD, around, can_mutant, general_replies, hears, sends

OWN_REPLY, REQUEST, GENERAL_REPLY = 0x580, 0x600, 0x581
LATCHED_NS = 2_000_000


def _is_request_to(module: MacCan, frame: CanFrame, address: int) -> bool:
    is_plain = not (frame.is_extended or frame.is_remote)
    return is_plain and frame.identifier == REQUEST + address


def _takes_for_its_own(module: MacCan, frame: CanFrame) -> None:
    module._own_request(frame.data)


# --- individual addresses ------------------------------------------------------------------------


@can_mutant("MACC-ID-01", traps=(7,))
def replies_come_under_the_requests_identifier(patch: MonkeyPatch) -> None:
    """A module answers on 600h + address, where it was asked."""

    def act(send: Any_, _: MacCan, identifier: int, data: bytes, start_ns: int) -> object:
        return send(identifier + 0x80 if 0x581 < identifier < 0x600 else identifier, data, start_ns)

    sends(patch, act)


@can_mutant("MACC-ID-01", traps=(7,))
def every_module_answers_as_module_1(patch: MonkeyPatch) -> None:
    """The identifier of a reply is the constant 581h."""

    def act(send: Any_, _: MacCan, identifier: int, data: bytes, start_ns: int) -> object:
        is_reply = OWN_REPLY < identifier < REQUEST
        return send(GENERAL_REPLY if is_reply else identifier, data, start_ns)

    sends(patch, act)


@can_mutant("MACC-ID-02", "MACC-SDO-06")
def addresses_have_six_bits(patch: MonkeyPatch) -> None:
    """The upper bit of the address is not compared: module 1 answers for 41h as well."""
    hears(
        patch,
        lambda module, frame: _is_request_to(module, frame, module.address ^ 0x40),
        _takes_for_its_own,
    )


@can_mutant("MACC-ID-02")
def downloads_for_others_are_executed_mutely(patch: MonkeyPatch) -> None:
    """A download for another address is executed, only the reply is kept back."""

    def takes(module: MacCan, frame: CanFrame) -> bool:
        own = frame.identifier in (REQUEST, REQUEST + module.address)
        return REQUEST < frame.identifier < 0x680 and not own and frame.data[:1] == b"\x23"

    hears(patch, takes, lambda module, frame: module._serve(frame.data))


@can_mutant("MACC-ID-01", "MACC-ID-02", traps=(8,))
def module_129_is_module_1(patch: MonkeyPatch) -> None:
    """The identifier 681h of the manual's example is taken as well."""
    hears(
        patch,
        lambda module, frame: _is_request_to(module, frame, module.address + 0x80),
        _takes_for_its_own,
    )


@can_mutant("MACC-ID-02", "MACC-SDO-06")
def what_comes_right_behind_its_own_is_its_own(patch: MonkeyPatch) -> None:
    """The identifier is not read again within 2 ms: a request behind an own one is an own one."""
    heard: dict[MacCan, int] = {}

    def hear(go: Any_, module: MacCan, _: bytes) -> None:
        heard[module] = module._now
        go()

    def act(module: MacCan, frame: CanFrame) -> None:
        if module._now - heard.get(module, 0) < LATCHED_NS:
            module._own_request(frame.data)

    around(patch, "_own_request", hear)
    hears(patch, lambda _, frame: REQUEST < frame.identifier < 0x680, act)


# --- forms of frames -----------------------------------------------------------------------------


@can_mutant("MACC-ID-03")
def extended_frames_count_as_well(patch: MonkeyPatch) -> None:
    """The bit that tells the two kinds of identifiers apart is not looked at."""
    hears(
        patch,
        lambda module, frame: frame.is_extended and frame.identifier == REQUEST + module.address,
        _takes_for_its_own,
    )


@can_mutant("MACC-ID-03")
def extended_frames_are_obeyed_mutely(patch: MonkeyPatch) -> None:
    """The upper 11 bits of an extended identifier are taken for the identifier; nobody replies."""

    def takes(module: MacCan, frame: CanFrame) -> bool:
        return frame.is_extended and frame.identifier >> 18 == REQUEST + module.address

    hears(patch, takes, lambda module, frame: module._serve(frame.data))


@can_mutant("MACC-ID-03")
def a_remote_frame_asks_for_the_position(patch: MonkeyPatch) -> None:
    """The controller answers a remote frame under its own reply's identifier."""

    def answer(module: MacCan, _: CanFrame) -> None:
        position = module.axis.query(module._now, 0x20).to_bytes(4, "big")
        module._send(OWN_REPLY + module.address, b"\x42\x00\x20\x00" + position, module._now)

    hears(
        patch,
        lambda module, frame: frame.is_remote and frame.identifier == OWN_REPLY + module.address,
        answer,
    )


# --- to all --------------------------------------------------------------------------------------


def _answers_all(patch: MonkeyPatch, who: Any_) -> None:
    """Let those answer a general request, each on its own identifier, of whom `who(module)`."""
    general_replies(
        patch,
        lambda module, _, identifier, reply: (
            identifier or (OWN_REPLY + module.address if who(module) else None),
            reply,
        ),
    )


@can_mutant("MACC-GEN-02", traps=(9,))
def all_modules_answer_all(patch: MonkeyPatch) -> None:
    """Every module answers a request on 600h, on its own identifier."""
    _answers_all(patch, lambda module: True)


@can_mutant("MACC-GEN-02", traps=(10,), address=2)
def without_module_1_another_one_answers(patch: MonkeyPatch) -> None:
    """Where there is no module 1, module 2 answers what is said to all."""
    _answers_all(patch, lambda module: module.address == 2)


@can_mutant("MACC-GEN-02", traps=(9,))
def module_1_keeps_silent_to_all(patch: MonkeyPatch) -> None:
    """Nobody answers a request on 600h."""
    general_replies(patch, lambda module, request, identifier, reply: (None, reply))


def _only_module_1(patch: MonkeyPatch, does_not_concern: Any_) -> None:
    def act(go: Any_, module: MacCan, data: bytes) -> object:
        return None if module.address != 1 and does_not_concern(data) else go()

    around(patch, "_general_request", act)


@can_mutant("MACC-GEN-01", traps=(9,))
def what_is_said_to_all_concerns_module_1_only(patch: MonkeyPatch) -> None:
    """The others do not execute what they may not answer."""
    _only_module_1(patch, lambda data: True)


@can_mutant("MACC-GEN-01")
def motions_for_all_concern_module_1_only(patch: MonkeyPatch) -> None:
    """The others take settings from 600h, and no motion."""
    _only_module_1(patch, lambda data: data[:1] == b"\x23" and data[1] in (0x13, 0x14, 0x15, 0x16))


@can_mutant("MACC-GEN-01")
def a_stop_for_all_concerns_module_1_only(patch: MonkeyPatch) -> None:
    """2017h, 2018h and 201Ah on 600h stop module 1; the others want to be asked themselves."""
    _only_module_1(patch, lambda data: data[:1] == b"\x23" and data[1] in (0x17, 0x18, 0x1A))


@can_mutant("MACC-GEN-02")
def module_1_accepts_for_all(patch: MonkeyPatch) -> None:
    """The reply to a download on 600h is 60h, whatever module 1 says to it."""
    general_replies(
        patch,
        lambda module, request, identifier, reply: (
            identifier,
            b"\x60" + reply[1:] if request[0] == DOWNLOAD else reply,
        ),
    )


@can_mutant("MACC-GEN-02")
def what_all_are_asked_is_answered_with_zeros(patch: MonkeyPatch) -> None:
    """An upload on 600h gets 42h and no data."""
    general_replies(
        patch,
        lambda module, request, identifier, reply: (identifier, reply[:4] + bytes(4)),
    )


@can_mutant("MACC-GEN-03")
def what_is_said_to_all_is_answered_under_580h(patch: MonkeyPatch) -> None:
    """The reply to 600h comes on 580h, the identifier of address 0."""
    general_replies(
        patch,
        lambda module, request, identifier, reply: (identifier and OWN_REPLY, reply),
    )


@can_mutant("MACC-GEN-01")
def a_reset_for_all_concerns_module_1_only(patch: MonkeyPatch) -> None:
    """2000h on 600h restarts module 1; the others go on."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        if module.address == 1 or data[:3] != b"\x23\x00\x20":
            go()

    around(patch, "_general_request", act)


@can_mutant("MACC-GEN-01", "MACC-BOOT-01")
def a_reset_for_all_is_acknowledged_and_not_obeyed(patch: MonkeyPatch) -> None:
    """2000h on 600h gets its reply, and restarts nobody."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        if data[:3] != b"\x23\x00\x20":
            go()
        else:
            module._answer(0x581 if module.address == 1 else None, b"\x60" + data[1:4] + bytes(4))

    around(patch, "_general_request", act)


# --- for others and for all, in states of their own ----------------------------------------------


def _is_for_another(module: MacCan, frame: CanFrame) -> bool:
    is_plain = not (frame.is_extended or frame.is_remote)
    address = frame.identifier - REQUEST
    return is_plain and 0 < address < 0x80 and address != module.address and len(frame.data) == 8


def _hears_of_others(patch: MonkeyPatch, index: int, act: Any_) -> None:
    """Let `act(module, data)` be done at a download of that index to another address."""
    head = bytes((DOWNLOAD, index, 0x20))
    hears(
        patch,
        lambda module, frame: _is_for_another(module, frame) and frame.data[:3] == head,
        lambda module, frame: act(module, frame.data),
    )


@can_mutant("MACC-ID-02")
def a_start_for_another_module_starts_it(patch: MonkeyPatch) -> None:
    """2011h starts the motion held here whatever address it is for."""
    _hears_of_others(patch, 0x11, lambda module, data: module._serve(data))


@can_mutant("MACC-ID-02", "MACC-CMD-10-01")
def a_motion_for_another_module_spends_its_arm(patch: MonkeyPatch) -> None:
    """A 2013h for another address ends what 2010h has begun here."""

    def disarm(module: MacCan, _: bytes) -> None:
        module.axis._armed = False

    _hears_of_others(patch, 0x13, disarm)


@can_mutant("MACC-ID-02")
def an_arm_for_another_module_arms_it(patch: MonkeyPatch) -> None:
    """2010h holds the next motion back whatever address it is for."""
    _hears_of_others(patch, 0x10, lambda module, data: module._serve(data))


@can_mutant("MACC-ID-02")
def a_zero_for_another_module_counts_in_motion(patch: MonkeyPatch) -> None:
    """200Bh clears the counter of a module in motion whatever address it is for."""

    def clear(module: MacCan, data: bytes) -> None:
        if module.axis.is_locked(0x13, 0):
            module._serve(data)

    _hears_of_others(patch, 0x0B, clear)


@can_mutant("MACC-ID-02")
def the_torque_of_the_next_address_is_its_own(patch: MonkeyPatch) -> None:
    """200Ch for the address above is stored here as well."""

    def takes(module: MacCan, frame: CanFrame) -> bool:
        is_next = _is_request_to(module, frame, module.address + 1)
        return is_next and frame.data[:3] == b"\x23\x0c\x20"

    hears(patch, takes, lambda module, frame: module._serve(frame.data))


@can_mutant("MACC-ID-02")
def unknown_commands_for_others_are_refused(patch: MonkeyPatch) -> None:
    """A command byte that is unknown is refused before the address is looked at."""

    def takes(module: MacCan, frame: CanFrame) -> bool:
        return _is_for_another(module, frame) and frame.data[0] not in (DOWNLOAD, 0x40)

    def refuse(module: MacCan, frame: CanFrame) -> None:
        module._answer(OWN_REPLY + module.address, b"\x80" + frame.data[1:4] + bytes(4))

    hears(patch, takes, refuse)


@can_mutant("MACC-ID-02")
def identifier_680h_is_said_to_all(patch: MonkeyPatch) -> None:
    """Bit 7 of the identifier is not compared: 680h is 600h."""
    hears(
        patch,
        lambda module, frame: _is_request_to(module, frame, 0x80),
        lambda module, frame: module._general_request(frame.data),
    )


def _for_all(patch: MonkeyPatch, is_meant: Any_, act: Any_) -> None:
    """Let a download on 600h of which `is_meant(index)` be `act(go, module, data)`."""

    def general(go: Any_, module: MacCan, data: bytes) -> None:
        if data[:1] == b"\x23" and len(data) == 8 and is_meant(data[1]):
            act(go, module, data)
        else:
            go()

    around(patch, "_general_request", general)


@can_mutant("MACC-GEN-01")
def an_arm_for_all_is_only_acknowledged(patch: MonkeyPatch) -> None:
    """2010h on 600h gets its reply and holds nothing back."""

    def act(_: Any_, module: MacCan, data: bytes) -> None:
        reply = b"\x60" + data[1:4] + bytes(4)
        module._answer(GENERAL_REPLY if module.address == 1 else None, reply)

    _for_all(patch, lambda index: index == 0x10, act)


@can_mutant("MACC-GEN-01", "MACC-CMD-16-01")
def segments_for_all_are_never_refused(patch: MonkeyPatch) -> None:
    """A segment on 600h is acknowledged though the FIFO is full."""
    general_replies(
        patch,
        lambda module, request, identifier, reply: (
            identifier,
            b"\x60" + reply[1:] if request[1] in (0x16, 0x1E) else reply,
        ),
    )


@can_mutant("MACC-GEN-01", "MACC-STATE-01")
def what_is_said_to_all_is_not_locked(patch: MonkeyPatch) -> None:
    """The locks of a motion are looked at in the server of the own identifier only."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        locks = module.axis.is_locked
        module.axis.is_locked = lambda index, parameters: False  # type: ignore[method-assign]
        go()
        module.axis.is_locked = locks  # type: ignore[method-assign]

    _for_all(patch, lambda index: index in (0x02, 0x03, 0x0D, 0x0F), act)


@can_mutant("MACC-BOOT-01", "MACC-GEN-01")
def a_reset_for_all_ends_silently(patch: MonkeyPatch) -> None:
    """After a 2000h on 600h no boot-up message is sent."""
    told: set[MacCan] = set()

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        told.add(module)
        go()

    def send(go: Any_, module: MacCan, identifier: int, data: bytes, start_ns: int) -> object:
        if identifier == 0x700 + module.address and module in told:
            told.discard(module)
            return None
        return go(identifier, data, start_ns)

    _for_all(patch, lambda index: index == 0, act)
    sends(patch, send)


@can_mutant("MACC-PERS-01", "MACC-GEN-01")
def settings_for_all_are_not_stored(patch: MonkeyPatch) -> None:
    """A parameter on 600h holds up to the next start only."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        stored = dict(module.axis.parameters.stored)
        go()
        module.axis.parameters.stored.update(stored)

    _for_all(patch, lambda index: index in (0x09, 0x0A, 0x0C, 0x0D, 0x0E, 0x0F), act)


@can_mutant("MACC-GEN-01")
def nothing_for_all_is_heard_before_a_request(patch: MonkeyPatch) -> None:
    """After a start 600h is ignored up to the first request to the own identifier."""
    deaf: set[MacCan] = set()

    def start(go: Any_, module: MacCan, now: int) -> None:
        deaf.add(module)
        go()

    def own(go: Any_, module: MacCan, data: bytes) -> None:
        deaf.discard(module)
        go()

    def general(go: Any_, module: MacCan, data: bytes) -> None:
        if module not in deaf:
            go()

    around(patch, "_booted", start)
    around(patch, "_own_request", own)
    around(patch, "_general_request", general)


@can_mutant("MACC-Q-06-01", "MACC-GEN-02")
def the_mode_digits_for_all_are_exchanged(patch: MonkeyPatch) -> None:
    """In the answer to 2006h on 600h the two digits of the modes have changed places."""

    def change(_: MacCan, request: bytes, identifier: int | None, reply: bytes) -> object:
        if request[:3] == b"\x40\x06\x20":
            reply = reply[:6] + bytes((reply[6] << 4 & 0xF0 | reply[6] >> 4,)) + reply[7:]
        return identifier, reply

    general_replies(patch, change)


@can_mutant("MACC-GEN-01")
def endless_motion_is_deaf_to_what_all_are_told(patch: MonkeyPatch) -> None:
    """In velocity mode 600h is not looked at: it has no effect and no reply."""

    def act(go: Any_, module: MacCan, _: bytes) -> None:
        if module.axis.state is not State.VE:
            go()

    around(patch, "_general_request", act)


@can_mutant("MACC-GEN-01")
def the_mask_of_600h_takes_bit_6_of_the_address(patch: MonkeyPatch) -> None:
    """Modules from 40h on do not hear what is said to all."""

    def act(go: Any_, module: MacCan, _: bytes) -> None:
        if module.address < 0x40:
            go()

    around(patch, "_general_request", act)


@can_mutant("MACC-GEN-02")
def who_was_module_1_goes_on_answering(patch: MonkeyPatch) -> None:
    """Who answers what all are told is decided at power-up and 2000h, not by the procedure."""
    is_one: dict[MacCan, bool] = {}

    def leave(go: Any_, module: MacCan) -> None:
        is_one.setdefault(module, module.address == 1)
        go()

    def hear(go: Any_, module: MacCan, data: bytes) -> None:
        is_one.setdefault(module, module.address == 1)
        own, module.address = module.address, 1 if is_one[module] else module.address
        go()
        module.address = own

    def renew(go: Any_, module: MacCan, request: bytes) -> Any:
        is_one.pop(module, None)
        return go()

    around(patch, "_leave_configuration", leave)
    around(patch, "_general_request", hear)
    around(patch, "_initialise", renew)
