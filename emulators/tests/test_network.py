"""Devices on a line: everything happens in the order of time."""

from collections.abc import Mapping

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_device import ToyTrace

from axistwin.kernel.effects import Effect, Silence, Store, Trace, Transmit
from axistwin.runtime import network as network_module
from axistwin.runtime.network import HOST_BUFFER_BYTES, SerialNetwork
from axistwin.wire.framing import Chunk, LineFormat
from axistwin.wire.instant_line import InstantLine
from axistwin.wire.serial_line import SerialLine
from axistwin.wire.waveform import Transmission

F38400 = LineFormat(38400)
F9600 = LineFormat(9600)
BYTE_NS = F38400.span_ns(1)
LATENCY_NS = 1_000_000
END = 0x2E  # a full stop ends a request


class Echo:
    """A device that repeats each request that begins with its name; wakes up when it is told to.

    "a3." makes "a" want to be woken 3 ms later, when it says "!" and notes it.
    """

    is_full_duplex = False

    def __init__(self, name: str, line_format: LineFormat = F38400, skew_ns: int = 0) -> None:
        self.name = ord(name)
        self.line_format = line_format
        self.skew_ns = skew_ns
        self.log: list[tuple[int, str]] = []
        self.due: list[int] = []
        self._request = bytearray()

    def quiet_prefix(self, data: bytes) -> int:
        """A reaction takes a full stop."""
        end = data.find(END)
        return len(data) if end < 0 else end

    def receive(self, chunk: Chunk) -> list[Effect]:
        """Note the bytes; a full stop ends a request."""
        effects: list[Effect] = []
        for index, value in enumerate(chunk.data):
            assert not effects, "heard bytes beyond its own reaction"
            now = chunk.arrival_ns(index)
            self.log.append((now, chr(value)))
            self._request.append(value)
            if value == ord("="):
                self._request.clear()  # somebody's answer
            if value == END:
                effects += self._answer(now, bytes(self._request))
                self._request.clear()
        return effects

    def _answer(self, now: int, request: bytes) -> list[Effect]:
        if request[0] != self.name:
            return []
        if request[1:2].isdigit():
            self.due = sorted({*self.due, now + int(request[1:2]) * 1_000_000})
            return [Store((("due", self.due[0]),))]
        return [Transmit(now + LATENCY_NS + self.skew_ns, request[:-1] + b"=")]

    def next_event(self) -> int | None:
        """The earliest of the times asked for."""
        return self.due[0] if self.due else None

    def wake(self, now: int) -> list[Effect]:
        """Do what is due."""
        assert now == self.due.pop(0)
        self.log.append((now, "woken"))
        return [ToyTrace(now, "woken"), Transmit(now, b"!")]

    def power_off(self, now: int) -> list[Effect]:
        """Forget all that is under way."""
        self.due.clear()
        self._request.clear()
        return [ToyTrace(now, "off")]

    def power_on(self, now: int) -> list[Effect]:
        """Start up."""
        return [ToyTrace(now, "on")]

    def cells(self, now: int) -> Mapping[str, int]:
        """Nothing is kept."""
        return {}

    def is_moving(self, now: int) -> bool:
        """Nothing moves."""
        return False


def host_log(network: SerialNetwork, until_ns: int) -> list[tuple[int, bytes]]:
    """Run to ``until_ns``, taking each byte when it is announced."""
    log = []
    while (due := network.next_host_byte_ns() or network.next_event()) is not None:
        if due > until_ns:
            break
        network.run_until(due)
        if network.host_available:
            log.append((network.now_ns, network.host_take()))
    network.run_until(until_ns)
    return log


def test_an_exchange_takes_its_exact_time() -> None:
    """Request, latency, answer: each byte at its nanosecond."""
    network = SerialNetwork([Echo("a")], start_ns=5000)
    network.host_send(b"ab.")
    assert network.host_sent_ns == 5000 + F38400.span_ns(3)
    start = network.host_sent_ns + LATENCY_NS
    assert host_log(network, 10**9) == [
        (start + F38400.span_ns(1), b"a"),
        (start + F38400.span_ns(2), b"b"),
        (start + F38400.span_ns(3), b"="),
    ]
    assert network.next_event() is None


def test_nothing_is_announced_when_nothing_will_happen() -> None:
    """An idle line lets its shell sleep for ever."""
    network = SerialNetwork([Echo("a")])
    assert network.next_event() is None
    assert network.next_host_byte_ns() is None
    network.run_until(10**15)
    assert network.now_ns == 10**15


def test_the_next_event_is_the_first_possible_reaction() -> None:
    """A shell need not wake up for bytes to which nobody reacts."""
    network = SerialNetwork([Echo("a"), Echo("b")])
    network.host_send(b"xxxxx.xx")
    assert network.next_event() == F38400.span_ns(6)
    network.run_until(F38400.span_ns(6))
    assert network.next_event() == F38400.span_ns(8)


def test_a_wake_up_lies_between_the_bytes_where_its_time_lies() -> None:
    """No device hears a byte that arrives later than an event that has not been run."""
    first, second = Echo("a"), Echo("b")
    network = SerialNetwork([first, second])
    first.due = [3 * BYTE_NS + 5]
    network.perform(0, ())
    network.host_send(b"........")
    network.run_until(10**9)
    times = [time for time, _ in first.log]
    assert times == sorted(times)
    assert (3 * BYTE_NS + 5, "woken") in first.log


def test_a_byte_is_heard_before_a_wake_up_at_the_same_nanosecond() -> None:
    """Ties: the line first, then the devices by index."""
    devices = [Echo("a"), Echo("b")]
    network = SerialNetwork(devices)
    for index, device in enumerate(devices):
        device.due = [BYTE_NS]
        network.perform(index, ())
    network.host_send(b"x")
    network.run_until(BYTE_NS)
    assert devices[0].log == devices[1].log == [(BYTE_NS, "x"), (BYTE_NS, "woken")]
    order = [str(index) for index, effect in network.take_effects() if isinstance(effect, Trace)]
    assert order == ["0", "1"]


def test_effects_come_in_the_order_of_time() -> None:
    """Stores and traces carry their device's index; taking them empties the queue."""
    devices = [Echo("a"), Echo("b")]
    network = SerialNetwork(devices)
    network.host_send(b"b9.a3.")
    network.run_until(10**9)
    kinds = [(index, type(effect)) for index, effect in network.take_effects()]
    assert kinds == [(1, Store), (0, Store), (0, ToyTrace), (1, ToyTrace)]
    assert network.take_effects() == []


def test_devices_with_one_name_answer_on_top_of_one_another() -> None:
    """The host gets garbage, with and without pacing; told apart they are alone."""
    for paced in (True, False):
        same = SerialNetwork([Echo("a"), Echo("a", skew_ns=37_000)], paced=paced)
        same.host_send(b"a7U.")
        same.host_send(b"aUUU.")
        same.run_until(10**9)
        assert b"aUUU=" not in same.host_take()
        apart = SerialNetwork([Echo("a"), Echo("b", skew_ns=37_000)], paced=paced)
        apart.host_send(b"aUUU.")
        apart.run_until(10**9)
        assert apart.host_take() == b"aUUU="


def test_a_client_at_the_wrong_rate_gets_no_valid_answer_until_it_is_right() -> None:
    """9600 on a 38400 line, with and without pacing."""
    for paced in (True, False):
        network = SerialNetwork([Echo("a")], paced=paced, host_format=F9600)
        network.host_send(b"ab." * 5)
        network.run_until(10**9)
        assert b"ab=" not in network.host_take()
        network.host_format = F38400
        network.host_send(b".ab.")
        network.run_until(2 * 10**9)
        assert network.host_take() == b"ab="


def test_a_device_that_changes_its_rate_is_followed() -> None:
    """The network looks at a device's format after each call and each touch."""
    device = Echo("a")
    network = SerialNetwork([device])
    device.line_format = F9600
    network.perform(0, ())
    network.host_format = F9600
    network.host_send(b"ab.")
    network.run_until(10**9)
    assert network.host_take() == b"ab="


def test_effects_of_a_call_from_outside_are_performed_now() -> None:
    """A transmission in the past begins now."""
    network = SerialNetwork([Echo("a")])
    network.run_until(1000)
    network.perform(0, [Transmit(0, b"hi"), ToyTrace(1000, "poke")])
    assert network.next_host_byte_ns() == 1000 + BYTE_NS
    assert network.take_effects() == [(0, ToyTrace(1000, "poke"))]


def test_power_cut_in_an_answer_breaks_it_off() -> None:
    """The byte on the line ends in mark, nothing follows, and after power-on all is well."""
    network = SerialNetwork([Echo("a")])
    network.host_send(b"a\0\0\0.")
    answer_ns = network.host_sent_ns + LATENCY_NS
    network.run_until(answer_ns + BYTE_NS + BYTE_NS // 2)
    network.power_off(0)
    network.host_send(b"ab.")
    network.run_until(10**9)
    assert network.host_take() == b"a\xf0"
    network.power_on(0)
    network.host_send(b"ab.")
    network.run_until(2 * 10**9)
    assert network.host_take() == b"ab="
    assert [effect for _, effect in network.take_effects()] == [
        ToyTrace(answer_ns + BYTE_NS + BYTE_NS // 2, "off"),
        ToyTrace(10**9, "on"),
    ]


def test_the_supply_takes_a_queued_answer_with_it() -> None:
    """Without pacing too: an answer whose latency has not passed is never sent."""
    for paced in (True, False):
        network = SerialNetwork([Echo("a")], paced=paced)
        network.host_send(b"ab.")
        network.run_until(network.host_sent_ns + LATENCY_NS // 2)
        network.power_off(0)
        network.run_until(10**9)
        assert network.host_take() == b""
        assert network.next_event() is None


@pytest.mark.parametrize("paced", [True, False])
def test_a_device_that_falls_silent_takes_its_answers_back(paced: bool) -> None:
    """What waits is dropped, the byte on the line breaks off; the next answer is whole."""
    device = Echo("a")
    network = SerialNetwork([device], paced=paced)
    for waited_ns, heard in ((LATENCY_NS // 2, b""), (LATENCY_NS + BYTE_NS + BYTE_NS // 2, b"a")):
        network.host_send(b"ab.")
        network.run_until(network.host_sent_ns + waited_ns)
        network.perform(0, [Silence()])
        network.run_until(network.now_ns + 10**9)
        answer = network.host_take()
        assert answer[:1] == heard
        assert len(answer) <= (2 if paced else 3)
    network.host_send(b"ab.")
    network.run_until(network.now_ns + 10**9)
    assert network.host_take() == b"ab="
    assert network.take_effects() == []


# -- the host's end --


def test_the_host_takes_as_much_as_it_likes() -> None:
    """What is not taken stays; time-outs and limits are the shell's affair."""
    network = SerialNetwork([Echo("a")])
    network.host_send(b"abcdef.")
    network.run_until(10**9)
    assert network.host_available == 7
    assert network.host_take(0) == b""
    assert network.host_take(3) == b"abc"
    assert network.host_take() == b"def="
    assert network.host_take() == b""


def test_what_does_not_fit_the_hosts_buffer_is_lost_and_counted() -> None:
    """The newest bytes go, as in a UART that is not read."""
    network = SerialNetwork([Echo("a")])
    network.perform(0, [Transmit(0, bytes(range(250)) * 400)])
    network.run_until(10**12)
    assert network.host_overruns == 100_000 - HOST_BUFFER_BYTES
    assert network.host_take() == (bytes(range(250)) * 400)[:HOST_BUFFER_BYTES]


def test_backlog_counts_what_has_not_begun_and_purge_drops_it() -> None:
    """Shells hold back by the backlog; a purge leaves the byte on the line."""
    device = Echo("a")
    network = SerialNetwork([device])
    network.host_send(b"abcdef")
    assert network.host_backlog == 6
    network.run_until(BYTE_NS + 1)
    assert network.host_backlog == 4
    network.host_purge_output()
    assert network.host_backlog == 0
    network.run_until(10**9)
    assert [name for _, name in device.log] == ["a", "b"]


class DroppingEcho(Echo):
    """Its UART drops what has a bad stop bit."""

    drops_bad_characters = True


def test_a_break_ruins_no_later_request() -> None:
    """A device's UART drops it, with and without pacing."""
    for paced in (True, False):
        network = SerialNetwork([DroppingEcho("a")], paced=paced)
        network.send_break(5_000_000)
        network.host_send(b"ab.")
        network.run_until(10**9)
        assert network.host_take() == b"ab="


def test_a_device_that_says_nothing_of_bad_characters_is_handed_each_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """So a family that knows nothing of the short ways needs nothing for them."""
    device = Echo("a")
    chunks: list[Chunk] = []

    def note(chunk: Chunk) -> list[Effect]:
        chunks.append(chunk)
        return []

    monkeypatch.setattr(device, "receive", note)
    network = SerialNetwork([device])
    network.send_break(5_000_000)
    network.host_send(b"ab.")
    network.run_until(10**9)
    assert [(each.data, each.errors) for each in chunks] == [(b"\0", (0,)), (b"ab.", ())]


# -- without pacing --


def test_without_pacing_only_the_devices_take_time() -> None:
    """Bytes are there at once; the answer comes after the device's own latency, in one piece."""
    network = SerialNetwork([Echo("a")], paced=False)
    network.host_send(b"ab.")
    assert network.host_backlog == 3
    assert network.next_event() == 0
    network.run_until(0)
    assert network.host_backlog == 0
    assert network.host_sent_ns == 0
    assert network.next_host_byte_ns() == LATENCY_NS
    network.run_until(LATENCY_NS - 1)
    assert network.host_available == 0
    network.run_until(LATENCY_NS)
    assert network.host_take() == b"ab="


def test_without_pacing_the_rest_of_a_burst_is_heard_before_the_answer() -> None:
    """Cut at the possible reaction, but at one instant; even with a device that takes no time."""
    first, second = Echo("a", skew_ns=-LATENCY_NS), Echo("b")
    network = SerialNetwork([first, second], paced=False)
    network.host_send(b"ab.cd")
    network.run_until(0)
    assert "".join(name for _, name in second.log) == "ab.cdab="
    assert network.host_take() == b"ab="


def test_without_pacing_an_exchange_does_not_disturb_the_one_before() -> None:
    """An answer that is only asked for after another was heard is alone on the line."""
    network = SerialNetwork([Echo("a"), Echo("b")], paced=False)
    network.host_send(b"aaaaaaaaaaaaaaaaaaaa.")
    network.run_until(LATENCY_NS)
    assert network.host_take() == b"aaaaaaaaaaaaaaaaaaaa="
    network.host_send(b"bb.")
    network.run_until(2 * LATENCY_NS)
    assert network.host_take() == b"bb="


# -- every way of driving --

requests = st.lists(
    st.tuples(
        st.integers(0, 12 * BYTE_NS),
        st.sampled_from([b"ab.", b"bc.", b"cde.", b"a2.", b"b3.", b"xyz", b".", b"c0bcd.a5."]),
    ),
    max_size=8,
)

skews = st.integers(0, 3 * BYTE_NS)


def drive(
    script: list[tuple[int, bytes]], skew_ns: int, stops: list[int], *, paced: bool = True
) -> tuple[list[list[tuple[int, str]]], bytes, list[tuple[int, Store | Trace]]]:
    """Play a host's script, pausing at ``stops`` too; all that devices and host noticed."""
    devices = [Echo("a"), Echo("b"), Echo("b", skew_ns=skew_ns), Echo("c", F9600)]
    network = SerialNetwork(devices, paced=paced)
    at_ns = 0
    for wait_ns, request in script:
        for stop in sorted(stops):
            if network.now_ns < stop < at_ns + wait_ns:
                network.run_until(stop)
                network.next_event()
                network.next_host_byte_ns()
        at_ns += wait_ns
        network.run_until(at_ns)
        network.host_send(request)
    network.run_until(at_ns + 10**9)
    assert network.next_event() is None
    return [each.log for each in devices], network.host_take(), network.take_effects()


@pytest.mark.strength
@settings(max_examples=150)
@given(requests, skews, st.lists(st.integers(0, 60 * BYTE_NS), max_size=20), st.booleans())
def test_where_time_pauses_changes_nothing(
    script: list[tuple[int, bytes]], skew_ns: int, stops: list[int], paced: bool
) -> None:
    """The same script gives the same world, however run_until is called in between."""
    assert drive(script, skew_ns, stops, paced=paced) == drive(script, skew_ns, [], paced=paced)


class SampledLine(SerialLine):
    """A line that looks at every bit, always."""

    def _undisturbed_until(self, current: Transmission, limit_ns: int) -> int:
        return min(limit_ns, current.start_ns - 1)

    def _is_in_step(self, first: Transmission, clash_ns: int | None) -> bool:
        return False


@pytest.mark.strength
@settings(max_examples=100)
@given(requests, skews)
def test_stretches_change_nothing(script: list[tuple[int, bytes]], skew_ns: int) -> None:
    """A world of bits and a world of stretches cannot be told apart."""
    stretches = drive(script, skew_ns, [])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network_module, "SerialLine", SampledLine)
        bits = drive(script, skew_ns, [])
    assert bits == stretches


class Sink(Echo):
    """A device that counts, and answers one request in a thousand."""

    def __init__(self) -> None:
        super().__init__("s")
        self.count = 0

    def receive(self, chunk: Chunk) -> list[Effect]:
        """Note the bytes; a full stop ends a request."""
        self.count += len(chunk.data)
        if chunk.data[-1] != END:
            return []
        return [Transmit(chunk.arrival_ns(len(chunk.data) - 1) + LATENCY_NS, b"answer")]


def held(network: SerialNetwork) -> int:
    """What the network keeps in memory, in bytes and things."""
    line = network._line
    return line.bytes_held + line.transmissions_held + network.host_available


@pytest.mark.parametrize("paced", [True, False])
def test_ten_million_bytes_pass_in_stretches_and_leave_nothing_behind(paced: bool) -> None:
    """No work per byte, nothing kept."""
    device = Sink()
    network = SerialNetwork([device], paced=paced)
    block = bytes(value for value in range(256) if value != END) * 40
    for _ in range(1000):
        network.host_send(block)
        network.run_until(network.host_sent_ns)
        assert held(network) == 0
    assert device.count == len(block) * 1000 > 10**7


@pytest.mark.parametrize("paced", [True, False])
def test_answers_that_nobody_waits_for_leave_nothing_behind(paced: bool) -> None:
    """A host that talks over the answers for ever keeps nothing but what is on the line."""
    network = SerialNetwork([Sink(), Sink()], paced=paced)
    most = 0
    for _ in range(300):
        network.host_send(b"0123456789012345678.")
        network.run_until(network.host_sent_ns - BYTE_NS // 2 if paced else network.now_ns)
        network.host_take()
        most = max(most, held(network))
    assert most < 5000


class LongWay(SerialNetwork):
    """Puts everything on the line."""

    def _reacts_at_once(self, now: int, data: bytes) -> bool:
        return False


Step = tuple[str, bytes]

steps = st.lists(
    st.tuples(
        st.sampled_from(["send"] * 6 + ["rate", "power", "poke", "queue"]),
        st.sampled_from([b"ab.", b"a.", b"a", b".", b"b.", b"a3.", b"a.a1.a", b"", b"x" * 3000]),
    ),
    max_size=12,
)


def exchanges(network: SerialNetwork, script: list[Step], gap_ns: int) -> list[object]:
    """Everything that can be seen of ``network`` after each step of ``script``."""
    seen: list[object] = []
    now = 0
    for action, data in script:
        now += gap_ns
        if action == "send":
            network.host_exchange(now, data)
        else:
            network.run_until(now)
        if action == "rate":
            network.host_format = F9600 if network.host_format == F38400 else F38400
        elif action == "power":
            network.power_off(0)
            network.power_on(0)
        elif action == "poke":
            network.perform(0, [Transmit(now + gap_ns, b"!")])
        elif action == "queue":
            network.host_send(data)
        state = network.now_ns, network.next_event(), network.host_backlog, network.host_sent_ns
        seen += [network.host_take(), network.take_effects(), state]
    network.run_until(now + 10 * LATENCY_NS)
    devices = [device.log for device in network.devices if isinstance(device, Echo)]
    return [*seen, network.host_take(), network.take_effects(), devices]


@pytest.mark.strength
@settings(max_examples=200)
@given(
    steps, st.sampled_from([-LATENCY_NS, 0]), st.sampled_from([0, 1000, LATENCY_NS]), st.booleans()
)
def test_the_short_way_of_an_exchange_changes_nothing(
    script: list[Step], skew_ns: int, gap_ns: int, paced: bool
) -> None:
    """Sending and reacting in one call gives what the line gives, at the same times."""
    short, long = (
        exchanges(kind([Echo("a", skew_ns=skew_ns)], paced=paced), script, gap_ns)
        for kind in (SerialNetwork, LongWay)
    )
    assert short == long


def test_an_exchange_without_pacing_goes_the_short_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """One device, one format, nothing under way: nothing is put on the line."""
    monkeypatch.setattr(InstantLine, "transmit", lambda *_: pytest.fail("the long way"))
    network = SerialNetwork([Echo("a", skew_ns=-LATENCY_NS)], paced=False)
    network.host_exchange(5, b"ab.")
    assert network.host_take() == b"ab="
