"""The CAN face of a MAC23: SDO requests in, replies and network messages out, over the axis core.

What belongs to this face and nothing else: the SDO frames, boot-up, emergency and lifebeat, SYNC,
the address procedure, the general message.  What a command means, and when it is taken, the axis
knows; power, restarts and surroundings are the module's.

    600h+adr  23 ii 20 ss dddddddd   download ii = command ii     60 ii 20 ss 0     580h+adr
                                                        refused:  80 ii 20 ss 0
              40 ii 20 ss xxxxxxxx   upload ii = query 20h+ii     42 ii 20 ss dddddddd
    600h      either, for everybody; module 1 alone replies
    080h      SYNC: command 11h for everybody, without a reply
    7E5h      04 01 / 11 adr / 04 00                              11 00 0           7E4h
                                               700h+adr  00       boot-up, when it is alive
                                               080h+adr  8 bytes  emergency, lifebeat

Rules
-----
1. Data frames with 11-bit identifiers of this list are heard, all others are not (MACC-ID-02, -03);
   in BT and RI, and from an accepted restart on, none is (MACC-BOOT-04, MACC-STATE-02).
2. The direction decides what an index means (MACC-SDO-05).  Parameters travel most significant byte
   first, the index low byte first (MACC-SDO-04).
3. Every request is answered once, a fixed latency after its end (MACC-SDO-06, -13); what it stores
   stands in front of its reply in the list of effects.  A motion starts at the end of the frame
   that asks for it (ledger §5 item 10).
4. A restart acts when its own reply has left (MACC-CMD-00-02); the boot-up message ends it.
5. The message on 080h+adr goes out when dd of the status changes, and 10 s after the last request
   to 600h+adr or message of its own (MACC-EMCY-01, -02, -05).  A lifebeat that still waits for
   somebody to acknowledge it is not joined by another one.
6. An address is taken over, and stored, by the 04 00 of a complete procedure (MACC-LMT-03).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from axistwin.devices.mac.axis.acceptance import SERIAL_ONLY, SIGNIFICANT
from axistwin.devices.mac.axis.models import MAC23_CAN
from axistwin.devices.mac.axis.module import MacModule, ModuleSnapshot
from axistwin.devices.mac.can.quirks import MacCanQuirks, read_error_codes
from axistwin.errors import UsageError
from axistwin.kernel.effects import Effect, SendFrame
from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import NS_PER_S, NS_PER_US, Nanos
from axistwin.wire.can_frame import CanFrame

GENERAL_REQUEST: Final = 0x600
REQUEST, REPLY, BOOT_UP, EMERGENCY = 0x600, 0x580, 0x700, 0x080  # + address
NMT, SYNC, LMT_REQUEST, LMT_REPLY = 0x000, 0x080, 0x7E5, 0x7E4

DOWNLOAD, ACCEPTED, UPLOAD, REFUSED = 0x23, 0x60, 0x40, 0x80
OTHER_DOWNLOADS: Final = (0x22, 0x27, 0x2B, 0x2F)  # the expedited ones of CiA 301
INDEX_HIGH: Final = 0x20
QUERIES: Final = 0x20  # serial index of upload 0
UPLOAD_COUNT: Final = 8
REQUEST_BYTES: Final = 8
NOTHING: Final = bytes(4)

LIFEBEAT_NS: Final = 10 * NS_PER_S

LMT_MODE, LMT_ADDRESS, LMT_STORE, LMT_NODE = 0x04, 0x11, 0x17, 0x5E
LMT_IDENTITY: Final = (0x5A, 0x5B, 0x5C, 0x5D)  # vendor, product, revision, serial number
NMT_STATES: Final = {0x01: "operational", 0x02: "stopped", 0x80: "pre-operational"}
NMT_RESETS: Final = (0x81, 0x82)  # node, communication

# Abort codes of CiA 301, told only by abort_code_form = code (MACC-AMB-17).
UNKNOWN_COMMAND, NO_OBJECT, NO_SUB_INDEX = 0x05040001, 0x06020000, 0x06090011
READ_ONLY, BAD_VALUE, BAD_STATE = 0x06010002, 0x06090030, 0x08000022

LONG, WORDS, BYTES = (4,), (2, 2), (1, 1, 1, 1)
DOWNLOAD_FIELDS: Final = {**dict.fromkeys((0x0D, 0x0E, 0x16, 0x1E), WORDS), 0x15: (1, 1, 2)}
"""Widths of the fields of a download that is no single number (ledger §2.2)."""

UPLOAD_FIELDS: Final = (LONG, BYTES, LONG, LONG, BYTES, (1, 1, 2), BYTES, BYTES)

TAKES_VALUES: Final = frozenset((0x02, 0x03, 0x07, 0x0C, 0x0D, 0x0E, 0x13))
"""Commands that refuse a value if not the state."""

SEGMENTS: Final = (0x16, 0x1E)


@dataclass(frozen=True, slots=True)
class CanModuleSnapshot(ModuleSnapshot):
    """A module on a bus; ``configuration_mode``: whether it takes a new address."""

    configuration_mode: bool


class MacCan(MacModule):
    """One MAC23 module on a CAN bus.

    address: 1..127; a stored one wins.  cells: what it stored in an earlier life.  skew_ns: added
    to its reply latency.  A ``powered`` module is switched on at time 0; a ``started`` one has its
    boot time and its boot-up message behind it then.
    Raises UsageError for an address out of range.
    """

    quirks: MacCanQuirks

    def __init__(
        self,
        address: int = 1,
        *,
        quirks: MacCanQuirks | None = None,
        cells: Mapping[str, int] | None = None,
        skew_ns: int = 0,
        powered: bool = True,
        started: bool = True,
    ) -> None:
        if address not in MAC23_CAN.addresses:
            raise UsageError(f"address {address} is not in 1..127, the addresses of a MAC on CAN")
        quirks = quirks or MacCanQuirks()
        super().__init__(MAC23_CAN, quirks, {"address": address, **(cells or {})})
        self.axis.arm_lasts = quirks.sync_arm_lifetime == "permanent"
        self._latency_ns = quirks.reply_latency_us * NS_PER_US + skew_ns
        codes = read_error_codes(quirks.emcy_code_map)
        assert codes is not None, "checked by the switch"
        self._codes = codes
        # What it hears, when, and the restart that waits for its reply to leave.
        self._services: dict[int, Callable[[MacCan, bytes], None]] = {}
        self._listens = False
        self._now: Nanos = 0
        self._wants_restart = False
        self._awaited: CanFrame | None = None
        # Network state.
        self._lifebeat_at: Nanos = NEVER
        self._waiting_lifebeat: CanFrame | None = None
        self._told_status = 0
        self._nmt_state = "pre-operational"
        self._configures = False
        self._given_address: int | None = None
        self._unstored_address: int | None = None
        self._take_over_stored()
        if powered:
            self._switch_on(started=started)
        self._effects.clear()  # it has been so for long

    # ---- what it hears ---------------------------------------------------------------------------

    def accepts(self, frame: CanFrame) -> bool:
        """Whether the identifier is one of this module's, in an 11-bit data frame (rule 1)."""
        return frame.identifier in self._services and not frame.is_extended and not frame.is_remote

    def receive(self, frame: CanFrame, end_ns: Nanos) -> list[Effect]:
        """Take a frame that was complete at ``end_ns``; what comes of it."""
        if not self.accepts(frame):
            return []
        if end_ns >= self._due:
            self._run_until(end_ns)
        if not self._listens:
            return self._taken_effects()
        self._now = end_ns
        self._services[frame.identifier](self, frame.data)
        return self._settle(end_ns)

    def sent(self, frame: CanFrame, end_ns: Nanos) -> list[Effect]:
        """A frame of this module has left: the reply to a restart lets it act (rule 4)."""
        self._run_until(end_ns)
        if frame == self._waiting_lifebeat:
            self._waiting_lifebeat = None
        if frame != self._awaited:
            return self._taken_effects()
        self._awaited = None
        self._take_over_at = end_ns
        return self._settle(end_ns)

    def _send(self, identifier: int, data: bytes, start_ns: Nanos) -> CanFrame:
        frame = CanFrame(identifier, data)
        self._effects.append(SendFrame(start_ns, frame))
        return frame

    # ---- requests --------------------------------------------------------------------------------

    def _own_request(self, data: bytes) -> None:
        """600h + address (MACC-SDO-06)."""
        request = self._whole(data)
        if request is None:
            return
        if self.quirks.lifebeat_restart != "free":
            self._restart_lifebeat(self._now)
        if not self._serves():
            return
        self._answer(REPLY + self.address, self._serve(request))

    def _general_request(self, data: bytes) -> None:
        """600h: all obey, module 1 alone replies (MACC-GEN-01..03)."""
        self._note_common_traffic()
        request = self._whole(data)
        if request is None or not self._serves():
            return
        if request[0] == UPLOAD and self.quirks.general_upload == "ignore":
            return
        replies = self.address == 1
        self._answer(self.quirks.general_reply_id if replies else None, self._serve(request))

    def _whole(self, data: bytes) -> bytes | None:
        """The 8 bytes of a request; None for one that is too short (MACC-SDO-11)."""
        if len(data) == REQUEST_BYTES:
            return data
        return data.ljust(REQUEST_BYTES, b"\0") if self.quirks.short_frame == "pad" else None

    def _serves(self) -> bool:
        """Whether SDO requests are served in the present mode (MACC-LMT-08, MACC-AMB-24)."""
        if self._configures and self.quirks.lmt_sdo == "ignored":
            return False
        return self._nmt_state != "stopped"

    def _answer(self, identifier: int | None, reply: bytes | None) -> None:
        """Send ``reply``, unless the module is mute; a restart waits until it has left."""
        if reply is None or identifier is None:
            if self._wants_restart:
                self._take_over_at = self._now
        else:
            frame = self._send(identifier, reply, self._now + self._latency_ns)
            if self._wants_restart:
                self._awaited = frame
        self._wants_restart = False

    def _serve(self, request: bytes) -> bytes | None:
        """Execute a request of 8 bytes; its reply, or None for silence."""
        command, quirks = request[0], self.quirks
        if command != DOWNLOAD and command != UPLOAD:
            if quirks.sdo_other_ccs == "silence":
                return None
            if quirks.sdo_other_ccs == "refuse" or command not in OTHER_DOWNLOADS:
                return self._refused(request, UNKNOWN_COMMAND)
        if request[2] != INDEX_HIGH:
            return self._outside(request)
        if request[3] and quirks.subindex_policy == "refuse":
            return self._refused(request, NO_SUB_INDEX)
        return self._upload(request) if command == UPLOAD else self._download(request)

    def _refused(self, request: bytes, abort_code: int) -> bytes:
        """80h with zeros (MACC-SDO-02)."""
        tells = self.quirks.abort_code_form == "code"
        tail = abort_code.to_bytes(4, "little") if tells else NOTHING
        return bytes((REFUSED,)) + request[1:4] + tail

    def _accepted(self, request: bytes) -> bytes:
        """60h with zeros (MACC-SDO-01)."""
        return bytes((ACCEPTED,)) + request[1:4] + NOTHING

    def _read(self, request: bytes, data: bytes) -> bytes:
        """42h with four bytes (MACC-SDO-03)."""
        return bytes((self.quirks.upload_scs,)) + request[1:4] + data

    def _outside(self, request: bytes) -> bytes | None:
        """Objects that are not 20xxh (MACC-SDO-10)."""
        policy = self.quirks.od_outside_20
        if policy == "silence":
            return None
        index, sub_index = request[2] << 8 | request[1], request[3]
        register = self._error()[1]
        objects = {(0x1000, 0): 0, (0x1001, 0): register, (0x1018, 0): 1, (0x1018, 1): 0}
        value = objects.get((index, sub_index))
        if policy == "refuse" or value is None:
            return self._refused(request, NO_OBJECT)
        if request[0] != UPLOAD:
            return self._refused(request, READ_ONLY)
        return self._read(request, value.to_bytes(4, "little"))

    def _unassigned(self, request: bytes) -> bytes | None:
        """An index of 20xxh that nobody assigned (MACC-CMD-XX-01, MACC-Q-XX-01)."""
        policy = self.quirks.unknown_index
        if policy == "silence":
            return None
        if policy == "refuse":
            return self._refused(request, NO_OBJECT)
        return self._read(request, NOTHING) if request[0] == UPLOAD else self._accepted(request)

    # ---- downloads and uploads -------------------------------------------------------------------

    def _upload(self, request: bytes) -> bytes | None:
        """Bytes 4..7 do not matter (MACC-SDO-07)."""
        index = request[1]
        if index >= UPLOAD_COUNT:
            return self._unassigned(request)
        data = self.axis.query(self._now, QUERIES + index).to_bytes(4, "big")
        return self._read(request, self._ordered(data, UPLOAD_FIELDS[index]))

    def _download(self, request: bytes) -> bytes | None:
        """Command ``request[1]``; what is refused changes nothing (MACC-SDO-12)."""
        index, axis = request[1], self.axis
        if index >= QUERIES or index in SERIAL_ONLY:
            return self._unassigned(request)
        cell = axis.cell(index)
        if cell == "u":
            return self._unassigned(request)
        fields = DOWNLOAD_FIELDS.get(index, LONG)
        parameters = int.from_bytes(self._ordered(request[4:], fields), "big")
        if parameters & ~SIGNIFICANT.get(index, 0) and self.quirks.dont_care_digits == "refuse":
            return self._refused(request, BAD_VALUE)
        if index in _FACE_COMMANDS:
            return _FACE_COMMANDS[index](self, request)
        is_locked = axis.is_locked(index, parameters)
        accepted = not is_locked and axis.execute(self._now, index, parameters, self._now)
        self._collect(self._now)
        if accepted:
            return self._accepted(request)
        self._tell_refusal(self._now, index, is_locked=is_locked)
        takes_value = index in TAKES_VALUES or (index in SEGMENTS and not parameters & 0xFFFF)
        return self._refused(request, BAD_VALUE if takes_value and cell == "A" else BAD_STATE)

    def _ordered(self, data: bytes, fields: tuple[int, ...]) -> bytes:
        """Four bytes as sent from four bytes as meant, or back (MACC-AMB-01)."""
        if self.quirks.can_byte_order == "big":
            return data
        swapped, at = b"", 0
        for width in fields:
            swapped += data[at : at + width][::-1]
            at += width
        return swapped

    def _initialise(self, request: bytes) -> bytes | None:
        """2000h: restart when the reply has left (MACC-CMD-00-01, -02)."""
        refuses = self.quirks.fault_ack_while_present == "refuse"
        if refuses and self.axis.faults.is_locking_cause_present:
            return self._refused(request, BAD_STATE)
        self._restart()
        return self._accepted(request) if self.quirks.reset_reply == "ack" else None

    def _restore_factory(self, request: bytes) -> bytes | None:
        """2001h: factory values and address 1, then like 2000h (MACC-CMD-01-01, -02)."""
        self.axis.restore_factory_values(self._now)
        self._collect(self._now)
        self._restart(restarts=self.quirks.factory_reset_scope == "restart")
        return self._accepted(request) if self.quirks.reset_reply == "ack" else None

    def _restart(self, *, restarts: bool = True) -> None:
        """Take over the stored address, and start anew if it ``restarts``, after the reply."""
        self._wants_restart, self._take_over_restarts = True, restarts
        if restarts:
            self._listens, self._lifebeat_at = False, NEVER

    # ---- what the module tells its face ----------------------------------------------------------

    def _take_over_stored(self) -> None:
        """Work with the stored address from now on, or with one that is not stored yet."""
        super()._take_over_stored()
        if self._unstored_address is not None:
            self.address, self._unstored_address = self._unstored_address, None
        self._services = {
            GENERAL_REQUEST: MacCan._general_request,
            REQUEST + self.address: MacCan._own_request,
            SYNC: MacCan._sync,
            LMT_REQUEST: MacCan._lmt,
        }
        if self.quirks.nmt_supported:
            self._services[NMT] = MacCan._nmt

    def _hear_nothing(self, until: Nanos) -> None:
        """Off, held or starting up: no dialogue, no message, no procedure (MACC-BOOT-04)."""
        self._listens = self._configures = self._wants_restart = False
        self._lifebeat_at = NEVER
        self._awaited = self._given_address = self._waiting_lifebeat = None

    def _booted(self, now: Nanos) -> None:
        """Alive: say so (MACC-BOOT-01, -02)."""
        forms = {
            "heartbeat": (BOOT_UP, b"\0"),
            "emergency_empty": (EMERGENCY, b""),
            "heartbeat_empty": (BOOT_UP, b""),
        }
        base, data = forms[self.quirks.bootup_form]
        self._send(base + self.address, data, now)
        self._listens = True
        self._nmt_state = "pre-operational"
        # No error has been told yet; one that is there already is told at once.
        self._told_status = self.axis.query(now, 0x21) & ~(self.axis.faults.word << 24)
        self._restart_lifebeat(now)

    # ---- emergency and lifebeat ------------------------------------------------------------------

    def _restart_lifebeat(self, now: Nanos) -> None:
        """10 s from now (MACC-EMCY-05)."""
        if self.quirks.emcy_payload != "none":
            self._lifebeat_at = now + LIFEBEAT_NS

    def _note_common_traffic(self) -> None:
        """600h and SYNC, which concern everybody (MACC-AMB-06)."""
        if self.quirks.lifebeat_restart == "any":
            self._restart_lifebeat(self._now)

    def _collect(self, now: Nanos) -> None:
        """What every module tells, and a change of the status (MACC-EMCY-02, MACC-AMB-29)."""
        super()._collect(now)
        if not self._listens:
            return
        status, told = self.axis.query(now, 0x21), self._told_status
        mask = self.quirks.emcy_trigger_mask
        if (status ^ told) & mask:
            self._told_status = status
            if self.quirks.emcy_on_clear or status & ~told & mask:
                self._send_emergency(now, status)
                if self.quirks.lifebeat_restart != "free":
                    self._restart_lifebeat(now)

    def _lifebeat(self, now: Nanos) -> None:
        """10 s of silence (MACC-EMCY-01); the content is the present one."""
        if self._waiting_lifebeat is None:
            self._waiting_lifebeat = self._send_emergency(now, self.axis.query(now, 0x21))
        self._restart_lifebeat(now)

    def _error(self) -> tuple[int, int]:
        """Error code and error register for the present faults (ledger §6.3)."""
        word = self.axis.faults.word
        for bits, code, register in self._codes:
            if word & bits:
                return code, register
        return 0, 0

    def _send_emergency(self, now: Nanos, status: int) -> CanFrame | None:
        """080h + address (MACC-EMCY-03, -04); None: not in this mode."""
        form = self.quirks.emcy_payload
        if form == "none" or self._nmt_state == "stopped":
            return None
        code, register = self._error()
        head, shown = code.to_bytes(2, "little") + bytes((register,)), status.to_bytes(4, "big")
        payloads = {
            "cia301_status": head + shown + b"\0",
            "status_first": shown + NOTHING,
            "code_only": head + bytes(5),
        }
        return self._send(EMERGENCY + self.address, payloads[form], now)

    # ---- SYNC, address procedure, NMT ------------------------------------------------------------

    def _sync(self, data: bytes) -> None:
        """080h: as download 2011h, without an answer (MACC-SYNC-01..05)."""
        self._note_common_traffic()
        if (data and self.quirks.sync_dlc == "empty") or self._nmt_state == "stopped":
            return
        if not self.axis.is_locked(0x11, 0):
            self.axis.execute(self._now, 0x11, 0, self._now)

    def _lmt(self, data: bytes) -> None:
        """7E5h: the address procedure (MACC-LMT-01..09), in frames of two bytes or more."""
        if len(data) < 2:
            return
        command, value = data[0], data[1]
        if command == LMT_MODE:
            if value == 1:
                self._configures, self._given_address = True, None
            elif value == 0:
                self._leave_configuration()
        elif command == LMT_ADDRESS:
            if self._configures:
                self._give_address(value)
        elif self.quirks.lmt_other == "cia305":
            self._other_lmt_service(command)

    def _give_address(self, address: int) -> None:
        """11 adr (MACC-LMT-02, -04, -05)."""
        if address in self.model.addresses:
            self._given_address = address
            self._lmt_reply(LMT_ADDRESS, 0)
        elif self.quirks.lmt_error_reply != "silence":
            self._lmt_reply(LMT_ADDRESS, int(self.quirks.lmt_error_reply, 16))

    def _leave_configuration(self) -> None:
        """04 00: take over the address that was given, and restart (MACC-LMT-03, -07)."""
        address, self._given_address = self._given_address, None
        self._configures = False
        if address is None:
            if self.quirks.lmt_incomplete == "ignore":
                return
        elif self.quirks.lmt_other == "cia305":
            self._unstored_address = address
        else:
            self.axis.parameters.store("address", address)
        self._restart()
        self._answer(None, None)

    def _other_lmt_service(self, command: int) -> None:
        """Identity and storing, if the module knows them (MACC-AMB-12)."""
        if command == LMT_NODE:
            self._lmt_reply(command, self.address)
        elif command in LMT_IDENTITY:
            self._lmt_reply(command, 0)
        elif command == LMT_STORE and self._configures:
            if self._given_address is not None:
                self.axis.parameters.store("address", self._given_address)
                self._collect(self._now)
            self._lmt_reply(command, 0)

    def _lmt_reply(self, *data: int) -> None:
        reply = bytes(data).ljust(self.quirks.lmt_dlc, b"\0")
        self._send(LMT_REPLY, reply, self._now + self._latency_ns)

    def _nmt(self, data: bytes) -> None:
        """000h, where it is obeyed (MACC-AMB-24)."""
        if len(data) < 2 or data[1] not in (0, self.address):
            return
        if data[0] in NMT_STATES:
            self._nmt_state = NMT_STATES[data[0]]
        elif data[0] in NMT_RESETS:
            self._restart()
            self._answer(None, None)

    # ---- time ------------------------------------------------------------------------------------

    def _reschedule(self) -> None:
        super()._reschedule()
        if self._lifebeat_at < self._due:
            self._due = self._lifebeat_at

    def _do(self, due: Nanos) -> None:
        """Of what is due together the lifebeat comes last: it tells the state after all of it."""
        others = self._take_over_at, self._boot_end, self.axis.next_event()
        if due == self._lifebeat_at and due not in others:
            self._lifebeat(due)
        else:
            super()._do(due)

    # ---- for whoever looks on --------------------------------------------------------------------

    def cells(self, now: Nanos) -> Mapping[str, int]:
        """All nonvolatile cells; there is no rate to remember on a bus."""
        cells = dict(super().cells(now))
        del cells["baud"]
        return cells

    def describe(self, now: Nanos) -> CanModuleSnapshot:
        """Everything worth showing."""
        return CanModuleSnapshot(**self.facts(now), configuration_mode=self._configures)


_FACE_COMMANDS: Final[dict[int, Callable[[MacCan, bytes], bytes | None]]] = {
    0x00: MacCan._initialise,
    0x01: MacCan._restore_factory,
}
"""Commands that this face executes itself; the axis accepts them in every state."""
