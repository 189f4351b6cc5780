"""What devices of each family store, as a client sees it: cells to write and read back."""

import time
from collections.abc import Collection
from typing import Final, Protocol

import can
import serial
from can_clients import message
from daemon_process import TIMEOUT_S
from mac_frames import ACCEPTED, ANSWER_LENGTH, answer_value, request
from mn400_bench import in_short, packets_in
from msc_bench import ACK, dread, dwrite

from axistwin.devices.mn400.link.packets import packet
from axistwin.wire.can_frame import CanFrame


class StoredValues(Protocol):
    """Cells behind one port or bus, by numbers of their own; a value has 31 bits.

    write: whether storing a value was acknowledged.  Both raise EOFError or OSError when the daemon
    is gone; pyserial's errors are OSErrors.
    """

    @property
    def cells(self) -> Collection[int]:
        """Those to be written."""

    def read(self, cell: int) -> int:
        """The value that is stored."""

    def write(self, cell: int, value: int) -> bool:
        """Store ``value``."""


class MacMemory:
    """What modules on a serial line store by some commands."""

    WRITTEN: Final = {0x09: 0x22, 0x0A: 0x23}
    """By the command that stores 32 bits: the query that reads them."""

    def __init__(self, port: serial.SerialBase, addresses: Collection[int] = (0,)) -> None:
        self._port = port
        self.cells = [address << 8 | command for address in addresses for command in self.WRITTEN]

    def exchange(self, frame: bytes, length: int) -> bytes:
        """Send ``frame`` and read ``length`` bytes, fewer when the twin is gone."""
        self._port.write(frame)
        return bytes(self._port.read(length))

    def ask(self, query: int, address: int = 0) -> int:
        """The 32-bit value that ``query`` answers with."""
        return answer_value(self.exchange(request(query, address=address), ANSWER_LENGTH))

    def read(self, cell: int) -> int:
        """By the query of its command."""
        return self.ask(self.WRITTEN[cell & 0xFF], cell >> 8)

    def write(self, cell: int, value: int) -> bool:
        """By its command."""
        return self.exchange(request(cell & 0xFF, value, cell >> 8), 3) == ACCEPTED


class CanMemory:
    """What modules on a bus store by some downloads."""

    WRITTEN: Final = {0x09: 0x02, 0x0A: 0x03}
    """By the download that stores 32 bits: the upload that reads them."""
    DOWNLOAD, ACCEPTED, UPLOAD, READ = 0x23, 0x60, 0x40, 0x42

    def __init__(self, bus: can.BusABC, addresses: Collection[int]) -> None:
        self._bus = bus
        self.cells = [address << 8 | index for address in addresses for index in self.WRITTEN]

    def exchange(self, address: int, command: int, index: int, value: int = 0) -> bytes:
        """The reply to an SDO request.  Raises EOFError or OSError when the daemon is gone."""
        data = bytes((command, index, 0x20, 0)) + value.to_bytes(4, "big")
        end_s = time.monotonic() + TIMEOUT_S
        try:
            self._bus.send(message(CanFrame(0x600 + address, data)))
            while (left_s := end_s - time.monotonic()) > 0:
                reply = self._bus.recv(left_s)
                if reply is not None and reply.arbitration_id == 0x580 + address:
                    return bytes(reply.data)
        except can.CanError as error:
            raise EOFError from error
        raise EOFError(f"no reply from module {address}")

    def ask(self, address: int, index: int) -> int:
        """What the upload of ``index`` gives."""
        reply = self.exchange(address, self.UPLOAD, index)
        assert reply[:4] == bytes((self.READ, index, 0x20, 0))
        return int.from_bytes(reply[4:], "big")

    def order(self, address: int, index: int, value: int) -> bool:
        """Whether the download of ``value`` was accepted."""
        return self.exchange(address, self.DOWNLOAD, index, value)[0] == self.ACCEPTED

    def read(self, cell: int) -> int:
        """By the upload that goes with its download."""
        return self.ask(cell >> 8, self.WRITTEN[cell & 0xFF])

    def write(self, cell: int, value: int) -> bool:
        """By its download."""
        return self.order(cell >> 8, cell & 0xFF, value)


class MscMemory:
    """Variables of a controller, stored by DWRITE."""

    cells = (0, 2008, 0x7FFC)

    def __init__(self, port: serial.SerialBase) -> None:
        self._port = port

    def read(self, cell: int) -> int:
        """By DREAD."""
        self._port.write(dread(cell))
        answer = bytes(self._port.read(19))
        self._port.write(ACK)
        return int.from_bytes(answer[-6:-2], "big", signed=True)

    def write(self, cell: int, value: int) -> bool:
        """By DWRITE."""
        self._port.write(dwrite(cell, value))
        return bytes(self._port.read(1)) == ACK


class Mn400Memory:
    """Both stored programs of a board, of some lines that each tell the value.

    Anything between two values is torn: that fails at once.
    """

    PROGRAM, CONFIGURATION = range(2)
    OPENING, END = ("Z", "."), ("\x04", "Q")
    DONE_BYTES = 12
    PRESENT = bytes.fromhex("81 2A 16 00 81 42")
    MASKS = (0, 0x2AAAAAAA, 0x55555555, 0x33333333)
    """What the four counters of one configuration differ by: they tell whether it is whole."""
    cells = (PROGRAM, CONFIGURATION)

    def __init__(self, port: serial.SerialBase) -> None:
        self._port = port

    def lines_of(self, cell: int, value: int) -> list[str]:
        """A program or a configuration of some lines."""
        count = 1 + value % 9
        if cell == self.PROGRAM:
            return [f"M{value},{number},{count}" for number in range(count)]
        loads = ["L" + "," * axis + str(value ^ mask) for axis, mask in enumerate(self.MASKS)]
        return [*loads, *(f"B{number}" for number in range(count))]

    def order(self, *lines: str) -> list[str]:
        """What commands are answered with, in short; fewer when the board is gone."""
        self._port.write(b"".join(packet(1, line.encode()) for line in lines))
        heard = bytes(self._port.read(self.DONE_BYTES * len(lines)))
        if len(heard) < self.DONE_BYTES * len(lines):
            return []
        return [in_short(raw) for raw in packets_in(heard)]

    def ask(self, line: str) -> list[str]:
        """What a command and a poll behind it are answered with, in short, without START."""
        self._port.write(packet(1, line.encode()) + packet(1, b"*"))
        heard = bytes(self._port.read_until(self.PRESENT))
        if not heard.endswith(self.PRESENT):
            raise EOFError
        return [in_short(raw) for raw in packets_in(heard)][1:-2]

    def read(self, cell: int) -> int:
        """The value whose lines are stored; 0: none are."""
        if cell == self.PROGRAM:
            lines = self.ask("R")
            value = int(lines[0][1:].split(",")[0]) if lines else 0
            assert lines == (self.lines_of(cell, value) if lines else []), "a torn program"
            return value
        counters = [int(text) for text in self.ask("E")[0].split(",")]
        value = counters[0]
        whole = [value ^ mask for mask in self.MASKS] if any(counters) else counters
        assert counters == whole, "a torn configuration"
        return value

    def write(self, cell: int, value: int) -> bool:
        """Store its lines; whether the end of the entry was acknowledged."""
        told = self.order(self.OPENING[cell], *self.lines_of(cell, value), self.END[cell])
        assert set(told) <= {"S", "D"}
        return bool(told)
