"""A MAC module on the bench of a unit test: virtual time, direct calls, a host that behaves."""

from axistwin.devices.mac.axis.quirks import parse_quirks
from axistwin.devices.mac.serial.device import MacSerial
from axistwin.devices.mac.serial.framing import request
from axistwin.devices.switches import Value
from axistwin.kernel.effects import Effect, Store, Transmit
from axistwin.motion.plant import Load
from axistwin.wire.framing import Chunk, LineFormat

ACCEPTED = b"\x06\x13\x1a"
REFUSED = b"\x06\x13\x17"
NACK = b"\x15"
SILENCE = b""
TICK_NS = 125
MS = 1_000_000
S = 1_000_000_000
PERIOD = 0x320  # 800 ticks, the ledger's examples
HELD, FREE = Load(held=True), Load()


class MacBench:
    """One module and a host that waits for each reply; quirks are keyword arguments.

    ``now`` is the time in ns; ``etx_ns`` when the module heard the last Etx; ``effects`` all that
    the module asked for so far; ``stores`` the same as a dict of cells.
    """

    def __init__(
        self,
        model: str = "mac23",
        address: int = 0,
        *,
        cells: dict[str, int] | None = None,
        started: bool = True,
        **quirks: Value,
    ) -> None:
        self.device = MacSerial(
            model, address, quirks=parse_quirks(quirks), cells=cells, started=started
        )
        self.address = address
        self.now = 1000 * MS if started else 0
        self.etx_ns = 0
        self.effects: list[Effect] = []
        self.late: list[Transmit] = []

    # ---- time ----

    def run_until(self, time_ns: int) -> None:
        """Let time pass and the module be woken whenever it wants."""
        while (due := self.device.next_event()) is not None and due <= time_ns:
            self.take(self.device.wake(due))
            after = self.device.next_event()
            assert after is None or after > due, "a wake-up that does not end"
        self.now = max(self.now, time_ns)

    def advance(self, nanoseconds: int) -> None:
        """Let that much time pass."""
        self.run_until(self.now + nanoseconds)

    def take(self, effects: list[Effect]) -> bytes:
        """Note effects; the bytes transmitted among them."""
        self.effects += effects
        sent = [effect for effect in effects if isinstance(effect, Transmit)]
        self.late += sent
        return b"".join(effect.data for effect in sent)

    # ---- exchanges ----

    def send(self, data: bytes, line_format: LineFormat | None = None) -> bytes:
        """Send raw bytes from now on; what the module replies; time goes on to the reply's end."""
        line_format = line_format or self.device.line_format
        reply, at, end = b"", 0, self.now
        while at < len(data):
            quiet = self.device.quiet_prefix(data[at:])
            assert 0 <= quiet <= len(data) - at
            size = min(len(data) - at, quiet + 1) if quiet < len(data) - at else quiet
            chunk = Chunk(self.now + line_format.span_ns(at), data[at : at + size], line_format)
            self.run_until(chunk.arrival_ns(0))
            due = self.device.next_event()
            if due is not None and due < chunk.arrival_ns(size - 1):
                self.run_until(due)
            effects = self.device.receive(chunk)
            if quiet == size:
                assert not effects, "a quiet prefix had effects"
            reply += self.take(effects)
            self.etx_ns = chunk.arrival_ns(size - 1)
            self.now = self.etx_ns
            for effect in effects:
                if isinstance(effect, Transmit):
                    assert effect.start_ns >= self.etx_ns
                    end = effect.start_ns + line_format.span_ns(len(effect.data))
            at += size
            if at < len(data):
                self.now = chunk.start_ns - line_format.span_ns(at - size)
        self.run_until(max(end, self.etx_ns))
        return reply

    def ask(
        self, index: int, parameters: int = 0, *, address: int | None = None, sub_index: int = 0
    ) -> bytes:
        """Send one well-formed frame; the raw reply."""
        whom = self.address if address is None else address
        return self.send(request(whom, index, parameters, sub_index))

    def do(self, index: int, parameters: int = 0, *, address: int | None = None) -> None:
        """A command that has to be accepted."""
        reply = self.ask(index, parameters, address=address)
        xon = self.device.quirks.xon_byte
        assert reply == bytes((0x06, 0x13, xon)), f"{index:02X}h answered {reply.hex(' ')}"

    def refuse(self, index: int, parameters: int = 0) -> None:
        """A command that has to be refused."""
        reply = self.ask(index, parameters)
        assert reply == REFUSED, f"{index:02X}h answered {reply.hex(' ')}"

    def read(self, index: int, sub_index: int = 0) -> int:
        """The unsigned data of a query."""
        reply = self.ask(index, sub_index=sub_index)
        assert len(reply) == 21, f"{index:02X}h answered {reply.hex(' ')}"
        return int(reply[9:17], 16)

    def position(self) -> int:
        """What 20h reads, signed."""
        number = self.read(0x20)
        return number - (1 << 32) if number >> 31 else number

    # ---- shortcuts ----

    def state(self) -> str:
        """The state code now."""
        return self.device.state_code(self.now)

    def position_at(self, time_ns: int) -> int:
        """The counter at a time from now on, without a frame."""
        self.run_until(time_ns)
        return self.device.position_at(time_ns)

    def input(self, name: str, active: bool) -> None:
        """Ground or open an input now."""
        self.take(self.device.set_input(self.now, name, active))
        self.run_until(self.now)

    def settle(self, limit_ns: int = 3600 * S) -> int:
        """Let the motion end; the time when it did."""
        deadline = self.now + limit_ns
        while self.device.is_moving(self.now):
            due = self.device.next_event()
            assert due is not None, "the motion has no end"
            assert due <= deadline, "the motion does not end"
            self.run_until(due)
        return self.now

    def settled_position(self) -> int:
        """Let the motion end; what 20h reads then, signed."""
        self.settle()
        return self.position()

    @property
    def stores(self) -> dict[str, int]:
        """Every cell stored so far, with its last value."""
        cells: dict[str, int] = {}
        for effect in self.effects:
            if isinstance(effect, Store):
                cells.update(effect.cells)
        return cells

    def power_cycle(self, off_ns: int = 100 * MS) -> None:
        """Off, a pause, on, and the boot time."""
        self.take(self.device.power_off(self.now))
        self.advance(off_ns)
        self.take(self.device.power_on(self.now))
        self.advance(self.device.quirks.boot_time_ms * MS)

    def reset(self) -> None:
        """00h and its two seconds."""
        self.do(0x00)
        self.advance(self.device.quirks.boot_time_ms * MS)


def moving(distance: int, aa: int = 1, **quirks: str | int) -> MacBench:
    """A module that has just accepted 13h, period 800."""
    bench = MacBench(factory_ramp=aa, factory_period=PERIOD, **quirks)  # type: ignore[arg-type]
    bench.do(0x13, distance & 0xFFFFFFFF)
    return bench
