"""A MAC23 on CAN on the bench of a unit test: virtual time, direct calls, a bus that is never busy.

``CanBench`` is a ``MacBench`` whose ``ask`` goes over SDO frames, so that what was written for the
serial face can be asked of this one: an accepted download reads ``ACCEPTED``, an upload as the 21
characters of an answer.
"""

from typing import Any

from mac_bench import ACCEPTED, MS, REFUSED, SILENCE, MacBench

from axistwin.devices.mac.can.device import MacCan
from axistwin.devices.mac.can.quirks import parse_can_quirks
from axistwin.devices.switches import Value
from axistwin.kernel.effects import Effect, SendFrame, Silence
from axistwin.wire.can_frame import CanFrame, wire_bits

BIT_NS = 2000  # 500 kbit/s


class CanBench(MacBench):
    """One module and a host; quirks are keyword arguments.

    ``frames``: all that the module sent, with the time at which each was offered to the bus.
    """

    device: Any

    def __init__(
        self,
        address: int = 1,
        *,
        cells: dict[str, int] | None = None,
        started: bool = True,
        **quirks: Value,
    ) -> None:
        settings = parse_can_quirks(quirks)
        self.device = MacCan(address, quirks=settings, cells=cells, started=started)
        self.address = address
        self.now = 1000 * MS if started else 0
        self.etx_ns = 0
        self.effects: list[Effect] = []
        self.late: list[Any] = []
        self.frames: list[tuple[int, CanFrame]] = []
        self._leaving: list[tuple[int, int, CanFrame]] = []  # start, end, frame

    # ---- time ----

    def run_until(self, time_ns: int) -> None:
        """Let time pass: frames leave, and the module is woken whenever it wants."""
        while True:
            due = self.device.next_event()
            left = self._leaving[0][1] if self._leaving else None
            first = min((at for at in (due, left) if at is not None), default=None)
            if first is None or first > time_ns:
                break
            if due == first:
                self.take(self.device.wake(due))
                after = self.device.next_event()
                assert after is None or after > due, "a wake-up that does not end"
            else:
                _, end_ns, frame = self._leaving.pop(0)
                self.take(self.device.sent(frame, end_ns))
        self.now = max(self.now, time_ns)

    def take(self, effects: list[Effect]) -> bytes:
        """Note effects; frames leave one after the other."""
        self.effects += effects
        for effect in effects:
            if isinstance(effect, SendFrame):
                self.late.append(effect)
                self.frames.append((effect.start_ns, effect.frame))
                start = max(effect.start_ns, self._leaving[-1][1] if self._leaving else 0)
                end = start + wire_bits(effect.frame) * BIT_NS
                self._leaving.append((start, end, effect.frame))
            elif isinstance(effect, Silence):
                self._leaving = [each for each in self._leaving if each[0] <= self.now]
        return b""

    # ---- frames ----

    def put(self, frame: CanFrame) -> None:
        """Let a frame of another station be complete after the time that it takes."""
        self.run_until(self.now + wire_bits(frame) * BIT_NS)
        self.etx_ns = self.now
        accepts = self.device.accepts(frame)
        effects = self.device.receive(frame, self.now)
        assert accepts or not effects, "a frame that does not concern it had effects"
        self.take(effects)

    def say(self, identifier: int, data: str | bytes = b"") -> list[str]:
        """Send a frame, data in hex digits; all that the module sends until that has left."""
        if isinstance(data, str):
            data = bytes.fromhex(data)
        count = len(self.frames)
        self.put(CanFrame(identifier, data))
        while self._leaving:
            self.run_until(self._leaving[0][1])
        return [str(frame) for _, frame in self.frames[count:]]

    def told(self, since: int = 0) -> list[str]:
        """All frames sent from number ``since`` on, as candump shows them."""
        return [str(frame) for _, frame in self.frames[since:]]

    def ask_raw(self, data: str | bytes, general: bool = False) -> bytes:
        """An SDO request to the module (or to all); the bytes of its one reply, or nothing."""
        if isinstance(data, str):
            data = bytes.fromhex(data)
        count = len(self.frames)
        self.say(0x600 if general else 0x600 + self.address, data)
        replies = [
            frame
            for _, frame in self.frames[count:]
            if frame.identifier in (0x580 + self.address, 0x601)
        ]
        assert len(replies) <= 1
        return replies[0].data if replies else b""

    def ask(
        self, index: int, parameters: int = 0, *, address: int | None = None, sub_index: int = 0
    ) -> bytes:
        """Command or query by its serial index; the reply as the serial face would give it."""
        upload = index >= 0x20
        head = bytes((0x40, index - 0x20, 0x20) if upload else (0x23, index, 0x20))
        reply = self.ask_raw(
            head + bytes((sub_index,)) + parameters.to_bytes(4, "big"), address == 0xFF
        )
        if not reply:
            return SILENCE
        assert reply[1:4] == head[1:3] + bytes((sub_index,))
        if reply[0] in (0x42, 0x43):
            return b"000000000" + reply[4:].hex().upper().encode() + b"0000"
        return {0x60: ACCEPTED, 0x80: REFUSED}[reply[0]]


def emergencies(bench: CanBench) -> list[tuple[int, str]]:
    """Times and payloads of all emergency and lifebeat messages so far."""
    identifier = 0x080 + bench.device.address
    return [
        (start, frame.data.hex(" "))
        for start, frame in bench.frames
        if frame.identifier == identifier
    ]
