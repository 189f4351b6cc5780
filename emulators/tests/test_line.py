import threading
import time
from collections.abc import Callable

import pytest
from spy_storage import SpySlot, SpyStorage
from toy_device import LATENCY_NS, ToyDevice, ToyTrace

from axistwin.errors import StateError
from axistwin.kernel.effects import Trace
from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.runtime.clock import PacedClock, VirtualClock
from axistwin.runtime.line import Line
from axistwin.runtime.network import SerialNetwork
from axistwin.runtime.simulation import Station
from axistwin.runtime.storage import MemorySlot, MemoryStorage
from axistwin.runtime.twin import Twin
from axistwin.wire.framing import LineFormat

BYTE_NS = LineFormat(38400).span_ns(1)


class Rig:
    """A line in virtual time with toy devices."""

    def __init__(self, count: int = 1, *, paced: bool = True) -> None:
        self.toys = [ToyDevice() for _ in range(count)]
        self.slots = [SpySlot() for _ in self.toys]
        self.storage = SpyStorage()
        self.clock = VirtualClock()
        self.network = SerialNetwork(self.toys, paced=paced)
        stations = [
            Station(f"toy:{index}", "toy", toy, slot)
            for index, (toy, slot) in enumerate(zip(self.toys, self.slots, strict=True))
        ]
        for toy, slot in zip(self.toys, self.slots, strict=True):
            slot.cells.update(toy.cells(0))
        self.line = Line(
            self.network, self.clock, self.storage, stations, explain=lambda data: f"{len(data)} B"
        )

    def ask(self, data: bytes, count: int, timeout_ns: Nanos = NS_PER_S) -> bytes:
        """Send, and wait for ``count`` bytes."""
        self.line.send(data)
        self.line.wait(self.clock.now_ns() + timeout_ns, count)
        return self.line.receive(count)


@pytest.fixture
def rig() -> Rig:
    """With the defaults."""
    return Rig()


def test_time_stands_still_while_nobody_waits(rig: Rig) -> None:
    """Sending and receiving move no virtual time; without time nothing is answered."""
    rig.line.send(b"W")
    assert rig.line.receive() == b""
    assert rig.line.available == 0
    assert rig.clock.now_ns() == 0
    assert rig.line.host_backlog <= 1


def test_waiting_for_bytes_ends_when_they_are_complete(rig: Rig) -> None:
    """The answer is there after byte, latency, byte; not a nanosecond later."""
    rig.line.send(b"W")
    now = rig.line.wait(NS_PER_S)
    assert now == rig.clock.now_ns() == 2 * BYTE_NS + LATENCY_NS
    assert rig.line.available == 1
    assert rig.line.receive() == b"K"


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_waiting_for_several_bytes_ends_with_the_last_of_them(rig: Rig, count: int) -> None:
    """Of an answer of four bytes exactly the wanted ones have arrived."""
    rig.line.send(b"P")
    now = rig.line.wait(NS_PER_S, count)
    answer_ns = BYTE_NS + LATENCY_NS
    assert now == answer_ns + LineFormat(38400).span_ns(count)
    assert rig.line.available == count


def test_waiting_in_vain_ends_at_its_time(rig: Rig) -> None:
    """A short answer does not end the wait for more; the limit does."""
    rig.line.send(b"W")
    assert rig.line.wait(NS_PER_S, 2) == NS_PER_S
    assert rig.line.receive() == b"K"


def test_waiting_for_ever_in_virtual_time_ends_when_nothing_will_happen(rig: Rig) -> None:
    """A blocking read of a silent line returns instead of hanging the test."""
    assert rig.line.wait(None) == 0
    rig.line.send(b"W")
    assert rig.line.wait(None, 5) == 2 * BYTE_NS + LATENCY_NS


def test_advance_moves_time_by_the_given_span(rig: Rig) -> None:
    """Whatever happens in between, advance ends where it was told to."""
    rig.line.send(b"GP")
    assert rig.line.advance(3600 * NS_PER_S) == 3600 * NS_PER_S
    assert rig.line.twins[0].position == (3600 * NS_PER_S - BYTE_NS) // NS_PER_MS
    assert rig.line.advance_to(5) == 3600 * NS_PER_S


def test_what_a_device_stores_is_written_before_its_acknowledgement_can_be_read(rig: Rig) -> None:
    """The write happens at or before the sync that shows the first byte."""
    rig.line.send(b"W")
    rig.line.advance(BYTE_NS)
    assert rig.slots[0].writes == [({"writes": 1}, True)]
    assert rig.line.available == 0
    rig.line.advance(LATENCY_NS + BYTE_NS)
    assert rig.line.receive() == b"K"


def test_a_failed_write_is_raised_and_nothing_can_be_read_any_more(rig: Rig) -> None:
    """The acknowledgement of what was not stored never reaches the host."""
    rig.slots[0].fail = True
    rig.line.send(b"W")
    with pytest.raises(StateError, match="disk full"):
        rig.line.wait(NS_PER_S)
    rig.slots[0].fail = False
    rig.clock.advance_to(NS_PER_S)
    for call in (rig.line.receive, rig.line.sync, lambda: rig.line.available):
        with pytest.raises(StateError, match="disk full"):
            call()
    with pytest.raises(StateError, match="disk full"):
        rig.line.send(b"P")
    rig.line.close()
    assert rig.storage.closed == 1


def test_a_moving_position_that_cannot_be_saved_is_not_told_either(rig: Rig) -> None:
    """Any failed write ends the line, not only that of a parameter."""
    rig.line.send(b"G")
    rig.line.advance(NS_PER_S)
    rig.slots[0].fail = True
    with pytest.raises(StateError, match="disk full"):
        rig.ask(b"P", 4)
    rig.slots[0].fail = False
    with pytest.raises(StateError, match="disk full"):
        rig.line.receive()


def test_the_host_is_never_told_a_position_that_a_kill_would_take_back(rig: Rig) -> None:
    """When bytes become readable while an axis moves, its position is saved first."""
    rig.line.send(b"G")
    rig.line.advance(100 * NS_PER_MS)
    rig.slots[0].writes.clear()
    told = int.from_bytes(rig.ask(b"P", 4), "big")
    assert told >= 99
    assert rig.slots[0].writes
    assert all(not durable for _, durable in rig.slots[0].writes)
    assert rig.slots[0].cells["position"] >= told


def test_an_axis_at_rest_is_not_saved_again_and_again(rig: Rig) -> None:
    """Queries alone write nothing."""
    rig.ask(b"P", 4)
    rig.line.save_moving()
    assert rig.slots[0].writes == []
    assert not rig.line.is_moving


def test_save_moving_writes_what_has_changed_by_itself() -> None:
    """A server calls it from time to time; it is not durable."""
    rig = Rig(2)
    rig.line.send(b"G")
    rig.line.advance(BYTE_NS + 50 * NS_PER_MS)
    assert rig.line.is_moving
    rig.line.save_moving()
    assert rig.slots[0].writes == [({"position": 50}, False)]


def test_the_servers_alarm_is_set_for_the_end_of_an_answer(rig: Rig) -> None:
    """Not for every byte of it, and not for nothing."""
    assert rig.line.next_event_ns() is None
    rig.line.send(b"P")
    assert rig.line.next_event_ns() == BYTE_NS
    rig.line.advance_to(BYTE_NS)
    assert rig.line.next_event_ns() == BYTE_NS + LATENCY_NS + LineFormat(38400).span_ns(4)


def test_everybody_is_told_of_changes_from_outside(rig: Rig) -> None:
    """Sending, inputs and rates may bring the next event nearer; looking does not."""
    calls: list[int] = []
    rig.line.on_change(lambda: calls.append(1))
    rig.line.sync()
    rig.line.receive()
    assert rig.line.twins[0].position == 0
    assert calls == []
    rig.line.send(b"P")
    rig.line.host_format = LineFormat(9600)
    rig.line.twins[0].inputs.reference = True
    assert len(calls) == 3
    rig.line.host_format = LineFormat(9600)
    assert len(calls) == 3
    rig.line.on_change(None)
    rig.line.send(b"P")
    assert len(calls) == 3


def test_traces_reach_their_subscribers_with_the_twin_they_are_of(rig: Rig) -> None:
    """Until they unsubscribe."""
    seen: list[tuple[Twin, Trace]] = []
    unsubscribe = rig.line.subscribe(lambda twin, trace: seen.append((twin, trace)))
    rig.ask(b"T", 1)
    assert seen == [(rig.line.twins[0], ToyTrace(BYTE_NS, "told"))]
    unsubscribe()
    rig.ask(b"T", 1)
    assert len(seen) == 1


def test_the_transcript_shows_both_directions_with_times_and_words(rig: Rig) -> None:
    """One line per burst."""
    rig.ask(b"W", 1)
    rig.ask(b"P", 4)
    assert rig.line.render_transcript().splitlines() == [
        "       0.000 ms > 57  1 B",
        "       1.521 ms < 4B  1 B",
        "       1.521 ms > 50  1 B",
        "       3.823 ms < 00 00 00 00  4 B",
    ]


@pytest.mark.strength
def test_a_transcript_is_bounded(rig: Rig) -> None:
    """A flood of bytes is shown cut, and only its end is kept."""
    for _ in range(220):
        rig.line.send(b"." * 300)
        rig.line.advance(NS_PER_S)
    assert len(rig.line.transcript) == 200
    assert all(len(burst.data) <= 256 for burst in rig.line.transcript)
    longer, rest = rig.line.render_transcript().splitlines()[-2:]
    assert longer.endswith("… 256 bytes  256 B")
    assert rest.endswith("… 44 bytes  44 B")


def test_purging_drops_what_has_not_left_the_host(rig: Rig) -> None:
    """The byte on the line is finished."""
    rig.line.send(b"W" * 10)
    rig.line.advance(BYTE_NS // 2)
    assert rig.line.host_backlog == 9
    rig.line.purge_output()
    assert rig.line.host_backlog == 0
    assert rig.line.host_sent_ns == BYTE_NS
    rig.line.advance(NS_PER_S)
    assert rig.line.receive() == b"K"


def test_closing_saves_everything_durably_and_lets_go_once(rig: Rig) -> None:
    """The position under way is in the record; the line cannot be used any more."""
    rig.line.send(b"G")
    rig.line.advance(BYTE_NS + 7 * NS_PER_MS)
    rig.line.close()
    rig.line.close()
    assert rig.slots[0].writes[-1] == ({"position": 7}, True)
    assert rig.storage.closed == 1
    with pytest.raises(StateError, match="the line is closed"):
        rig.line.send(b"P")


def test_a_line_is_closed_at_the_end_of_its_with_block(rig: Rig) -> None:
    """As files are."""
    with rig.line as line:
        assert line.is_virtual
        assert line.is_volatile == SpyStorage.is_volatile
    assert rig.storage.closed == 1


def test_without_pacing_bytes_take_no_time_but_the_device_does() -> None:
    """The answer comes after the latency alone."""
    rig = Rig(paced=False)
    rig.line.send(b"P")
    assert rig.line.wait(NS_PER_S, 4) == LATENCY_NS
    assert rig.line.receive() == bytes(4)


def paced_line(speed: float = 1.0) -> tuple[Line, ToyDevice]:
    """A line of one toy in the time of this machine."""
    toy = ToyDevice()
    slot = MemorySlot()
    slot.cells.update(toy.cells(0))
    network = SerialNetwork([toy])
    station = Station("toy:0", "toy", toy, slot)
    return Line(network, PacedClock(speed), MemoryStorage(), [station]), toy


def test_in_real_time_waiting_ends_when_bytes_arrive() -> None:
    """Neither before the answer is complete nor at the limit."""
    line, _ = paced_line()
    begin = time.monotonic()
    line.send(b"P")
    line.wait(line.sync() + 60 * NS_PER_S, 4)
    took = time.monotonic() - begin
    assert line.receive() == bytes(4)
    assert 0.0023 <= took < 30


def test_in_scaled_time_an_hour_takes_milliseconds() -> None:
    """Advance waits in the twin's time."""
    line, _ = paced_line(speed=100_000.0)
    begin = time.monotonic()
    line.advance(3600 * NS_PER_S)
    assert 0.036 <= time.monotonic() - begin < 30


def test_another_thread_can_wake_a_waiting_one_and_feed_it() -> None:
    """A wait without limit ends by ``wake``; one for bytes ends when another thread sends."""
    line, _ = paced_line()
    results: list[Nanos] = []
    for action in (line.wake, lambda: line.send(b"W")):
        waiter = threading.Thread(target=lambda: results.append(line.wait(None)))
        waiter.start()
        while not line._changed._waiters:  # type: ignore[attr-defined]
            time.sleep(0.001)
        with line._lock:
            action()
        waiter.join(5)
        assert not waiter.is_alive()
    assert len(results) == 2
    assert line.receive() == b"K"


def test_an_exchange_is_a_send_and_a_receive_that_tells_no_alarm() -> None:
    """What has arrived comes back, stores come first, and the transcript has both directions."""
    rig = Rig(paced=False)
    told: list[str] = []
    rig.line.on_change(lambda: told.append("changed"))
    assert rig.line.exchange(b"W") == b""
    assert rig.slots[0].writes == [({"writes": 1}, True)]
    rig.clock.advance_to(LATENCY_NS)
    assert rig.line.exchange(b"T") == b"K"
    assert [burst.data for burst in rig.line.transcript] == [b"WT", b"K"]
    assert told == []
    rig.slots[0].fail = True
    with pytest.raises(StateError, match="disk full"):
        rig.line.exchange(b"W")
    with pytest.raises(StateError, match="disk full"):
        rig.line.exchange(b"")


def test_an_exchange_wakes_who_waits_for_time() -> None:
    """Another thread that sleeps until the next event is told that there is a new one."""
    rig = Rig(paced=False)
    line = Line(
        rig.network,
        PacedClock(),
        rig.storage,
        [Station("toy:0", "toy", rig.toys[0], rig.slots[0])],
    )
    woken: list[int] = []
    thread = threading.Thread(target=lambda: woken.append(line.wait(60 * NS_PER_S, 1)))
    thread.start()
    while not line._sleepers:
        time.sleep(0.001)
    line.exchange(b"P")
    thread.join(10)
    assert not thread.is_alive()
    assert line.receive() == bytes(4)


def test_many_threads_may_use_one_line_at_once() -> None:
    """Looking, setting inputs and supply, and exchanging do not disturb one another."""
    line, toy = paced_line(speed=100.0)
    twin = line.twins[0]
    failures: list[BaseException] = []
    stop = threading.Event()

    def repeat(action: Callable[[], object]) -> None:
        try:
            while not stop.is_set():
                action()
        except BaseException as error:
            failures.append(error)

    def set_input() -> None:
        twin.inputs.reference = not twin.inputs.reference

    actions = [set_input, lambda: twin.position, lambda: twin.push(1), line.save_moving]
    threads = [threading.Thread(target=repeat, args=(action,)) for action in actions]
    for thread in threads:
        thread.start()
    for number in range(1, 101):
        line.send(b"W")
        line.wait(line.sync() + 100 * NS_PER_S)
        assert line.receive() == b"K"
        assert twin.cells["writes"] == number
    stop.set()
    for thread in threads:
        thread.join(5)
    assert not failures
    assert toy.stored["position"] > 0
