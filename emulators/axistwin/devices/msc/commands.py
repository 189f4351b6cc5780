"""The nine commands (ledger §2.4): what a body asks for, and what comes of it.

Rules
-----
1. A body is a name, a comma, and values of a fixed size (MSC-CMD-01).  The name is everything
   before the first comma and is compared whole (MSC-CMD-07); later commas are data (MSC-CMD-08).
2. A command is refused before anything is done, or done whole (MSC-LNK-06).
3. A write carries out when the link says so, a read looks at the data when its reply is built: both
   are handed to the link as functions of the time (``receiver.Verdict``).
4. A reply begins with the command's name and comma (MSC-CMD-04) and repeats neither address nor
   flag number (MSC-CMD-12).
"""

from collections.abc import Callable
from dataclasses import dataclass
from struct import Struct
from typing import Final, TypeAlias

from axistwin.devices.msc.data_area import BLOCK_VALUES, VALUE_BYTES, DataArea
from axistwin.devices.msc.flags import FLAGS, Flags
from axistwin.devices.msc.models import MscModel
from axistwin.devices.msc.quirks import MscQuirks
from axistwin.devices.msc.receiver import ACCEPTED, IGNORED, REFUSED, Verdict
from axistwin.devices.msc.status import Status, StatusBit
from axistwin.kernel.time import NS_PER_MS, Nanos

_ADDRESS = Struct(">H")
_VALUE = Struct(">i")
_BLOCK = Struct(f">{BLOCK_VALUES}i")

_COMMA: Final = b","

Handler: TypeAlias = "Callable[[Commands, bytes], Verdict]"


@dataclass(frozen=True, slots=True)
class Command:
    """One command: its name, the bytes of its values, who carries it out."""

    name: bytes
    value_bytes: int
    handler: Handler


_POLICIES: Final = {"nak": REFUSED, "ack_ignore": ACCEPTED, "silent": IGNORED}


class Commands:
    """What one unit does when it is told.

    data, flags, status: what the commands are about.  catch_up: is called before they are looked at
    or written; host_wrote: after every write.
    """

    def __init__(
        self,
        model: MscModel,
        quirks: MscQuirks,
        data: DataArea,
        flags: Flags,
        status: Status,
        catch_up: Callable[[Nanos], None],
        host_wrote: Callable[[Nanos], None],
    ) -> None:
        self._quirks = quirks
        self._data = data
        self._flags = flags
        self._status = status
        self._scan_ns = quirks.scan_ms * NS_PER_MS
        self._catch_up = catch_up
        self._host_wrote = host_wrote
        self._by_name = {command.name: command for command in COMMANDS}
        self._has_rflags = model.has_rflags
        if not model.has_rflags:
            del self._by_name[b"RFLAGS"]
        self._is_guarded = "nak" in (quirks.stopped_access, quirks.loading_access)
        # What ``status_spare`` = internal tells.
        self._examined = 0
        self._last_address = 0

    # -- bodies ----------------------------------------------------------------------------------

    def examine(self, now: Nanos, body: bytes) -> Verdict:
        """Judge the body of a packet whose sum is right, complete at ``now``."""
        self._examined += 1
        name, comma, values = body.partition(_COMMA)
        if not self._quirks.case_sensitive:
            name = name.upper()
        command = self._by_name.get(name)
        if self._quirks.comma == "optional" and (command is None or not comma):
            command, values = self._find_without_comma(body)
        elif not comma:
            command = None
        if command is None:
            return self._unknown(body, name)
        if self._is_guarded and self._is_locked(now, command):
            return REFUSED
        if len(values) != command.value_bytes:
            if self._quirks.malformed_body != "lenient":
                return _POLICIES[self._quirks.malformed_body]
            values = _fitting(command, values)
        return command.handler(self, values)

    def _find_without_comma(self, body: bytes) -> tuple[Command | None, bytes]:
        """The command whose name ``body`` begins with, and the rest (MSC-AMB-07)."""
        start = body if self._quirks.case_sensitive else body.upper()
        known = [name for name in self._by_name if start.startswith(name)]
        if not known:
            return None, b""
        name = max(known, key=len)
        return self._by_name[name], body[len(name) :].removeprefix(_COMMA)

    def _unknown(self, body: bytes, name: bytes) -> Verdict:
        """A body without the name of a command (MSC-CMD-10)."""
        if not body and self._quirks.empty_body == "ack":
            return ACCEPTED
        is_unsupported = name == b"RFLAGS" and not self._has_rflags
        if is_unsupported and self._quirks.rflags_unsupported == "ack_no_reply":
            return ACCEPTED
        return _POLICIES[self._quirks.unknown_command]

    def _is_locked(self, now: Nanos, command: Command) -> bool:
        """Whether the state of the program forbids a command (MSC-AMB-32)."""
        if command.name == b"RQSTAT":
            return False
        self._catch_up(now)
        if self._quirks.stopped_access == "nak" and not self._status.has(StatusBit.RUNNING):
            return True
        return self._quirks.loading_access == "nak" and self._status.has(StatusBit.LOADING)

    # -- the data area ---------------------------------------------------------------------------

    def _dread(self, values: bytes) -> Verdict:
        (address,) = _ADDRESS.unpack(values)
        data = self._data
        if not data.has(address):
            return REFUSED
        self._last_address = address
        return self._read(b"DREAD,", lambda _: _VALUE.pack(data.read(address)))

    def _bread(self, values: bytes) -> Verdict:
        (address,) = _ADDRESS.unpack(values)
        data = self._data
        if not data.has_block(address):
            return REFUSED
        self._last_address = address
        return self._read(b"BREAD,", lambda _: _BLOCK.pack(*data.read_block(address)))

    def _dwrite(self, values: bytes) -> Verdict:
        (address,) = _ADDRESS.unpack_from(values)
        (value,) = _VALUE.unpack_from(values, _ADDRESS.size)
        if not self._data.has(address):
            return REFUSED
        self._last_address = address

        def act(now: Nanos) -> None:
            self._catch_up(now)
            self._data.write(address, value)
            self._host_wrote(now)

        return self._write(b"DWRITE,", act)

    def _bwrite(self, values: bytes) -> Verdict:
        (address,) = _ADDRESS.unpack_from(values)
        block = [value for (value,) in _VALUE.iter_unpack(values[_ADDRESS.size :])]
        if not self._data.has_block(address):
            return REFUSED
        self._last_address = address

        places = self._data.block_places(address, len(block))
        left = list(zip(places, block, strict=True))
        at_once = len(left) if self._quirks.bwrite_atomic else BLOCK_VALUES // 2

        def act(now: Nanos) -> Nanos | None:
            self._catch_up(now)
            for place, value in left[:at_once]:
                self._data.put(place, value)
            del left[:at_once]
            self._host_wrote(now)
            return now + self._scan_ns if left else None  # a scan falls in between (MSC-AMB-42)

        return self._write(b"BWRITE,", act)

    def _read(self, name: bytes, build: Callable[[Nanos], bytes]) -> Verdict:
        """The verdict on a good read command."""

        def reply(now: Nanos) -> bytes:
            self._catch_up(now)
            return name + build(now)

        return Verdict(ACCEPTED.sign, None, reply)

    def _write(self, name: bytes, act: Callable[[Nanos], Nanos | None]) -> Verdict:
        """The verdict on a good write command (MSC-LNK-14, MSC-AMB-36)."""
        if self._quirks.write_reply == "none":
            return Verdict(ACCEPTED.sign, act)
        return Verdict(ACCEPTED.sign, act, lambda _: name)

    # -- flags -----------------------------------------------------------------------------------

    def _flag(self, values: bytes) -> int | None:
        """The flag that ``values`` names: -1 for one that is always off, None to refuse it."""
        (number,) = _ADDRESS.unpack(values)
        if number < FLAGS:
            return int(number)
        policy = self._quirks.flag_out_of_range
        return number % FLAGS if policy == "mod256" else -1 if policy == "off" else None

    def _rflag(self, values: bytes) -> Verdict:
        number = self._flag(values)
        if number is None:
            return REFUSED
        flags = self._flags
        return self._read(
            b"RFLAG,", lambda now: _ADDRESS.pack(number >= 0 and flags.state(now, number))
        )

    def _rflags(self, _: bytes) -> Verdict:
        return self._read(b"RFLAGS,", self._flags.snapshot)

    def _sflag(self, values: bytes) -> Verdict:
        return self._write_flag(b"SFLAG,", values, on=True)

    def _cflag(self, values: bytes) -> Verdict:
        return self._write_flag(b"CFLAG,", values, on=False)

    def _write_flag(self, name: bytes, values: bytes, *, on: bool) -> Verdict:
        """SFLAG and CFLAG (MSC-SFLAG-02, -03)."""
        flags, number = self._flags, self._flag(values)
        if number is None:
            return REFUSED
        is_own = number >= 0 and flags.may_host_write(number)
        policy = self._quirks.flag_write_readonly
        if number >= 0 and not is_own and policy == "nak":
            return REFUSED

        def act(now: Nanos) -> None:
            self._catch_up(now)
            if is_own:
                flags.set(number, on)
            elif number >= 0 and policy == "force":
                flags.force(now, number, on)
            self._host_wrote(now)

        return self._write(name, act)

    # -- status ----------------------------------------------------------------------------------

    def _rqstat(self, _: bytes) -> Verdict:
        return self._read(b"RQSTAT,", self._status_reply)

    def _status_reply(self, _: Nanos) -> bytes:
        """The status word and what is behind it (MSC-RQSTAT-02, -03)."""
        tail = bytes(self._quirks.status_tail)
        if self._quirks.status_spare == "internal":
            spare = self._last_address.to_bytes(len(tail) - _ADDRESS.size, "big")
            tail = _ADDRESS.pack(self._examined & 0xFFFF) + spare
        return _ADDRESS.pack(self._status.read()) + tail


def _fitting(command: Command, values: bytes) -> bytes:
    """As much of ``values`` as fits the command; zeros for what is missing (MSC-AMB-05)."""
    if command.name == b"BWRITE" and len(values) < command.value_bytes:
        whole = max(0, len(values) - _ADDRESS.size) // VALUE_BYTES
        return values[: _ADDRESS.size + whole * VALUE_BYTES].ljust(_ADDRESS.size, b"\0")
    return values[: command.value_bytes].ljust(command.value_bytes, b"\0")


COMMANDS: Final = (
    Command(b"BREAD", 2, Commands._bread),
    Command(b"BWRITE", 2 + BLOCK_VALUES * VALUE_BYTES, Commands._bwrite),
    Command(b"CFLAG", 2, Commands._cflag),
    Command(b"DREAD", 2, Commands._dread),
    Command(b"DWRITE", 2 + VALUE_BYTES, Commands._dwrite),
    Command(b"RFLAG", 2, Commands._rflag),
    Command(b"RFLAGS", 0, Commands._rflags),
    Command(b"RQSTAT", 0, Commands._rqstat),
    Command(b"SFLAG", 2, Commands._sflag),
)
"""The documented ones (MSC-CMD-06)."""
