"""Faults in telling for whom a frame is, and who answers what is said to all (ID, GEN)."""

from __future__ import annotations

from zoo.mutant import Any_, MonkeyPatch

from axistwin.devices.mac.can.device import MacCan
from axistwin.wire.can_frame import CanFrame
from zoo_can.planting import DOWNLOAD, around, can_mutant, general_replies, hears, sends

OWN_REPLY, REQUEST, GENERAL_REPLY = 0x580, 0x600, 0x581


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
