"""How a controller runs a macroprogram: scans made up for, rest, starts and ends, what fits."""

import time
from typing import Any, ClassVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from program_bench import BAD_OPCODE, RUNNING, ProgramBench

from axistwin.devices.program_traces import ProgramFailed, ProgramStarted, ProgramStopped
from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_MS, NS_PER_S
from axistwin.macroprogram import (
    Condition,
    Input,
    Macroprogram,
    Output,
    ScanCount,
    Steps,
    Timer,
    UserFlag,
    Variable,
    until,
)

HOUR_NS = 3600 * NS_PER_S


class Worker(Macroprogram):
    """Waits for this and that, and tells when it went on."""

    part = Input(3)
    lamp = Output(20)
    work = Timer(32)
    start = UserFlag(200)
    steps = Variable(2000)
    last_ms = Variable(2004)

    def run(self) -> Steps:
        """Each wait of another kind."""
        while True:
            for wanted in (
                self.start.rise,
                self.part & ~self.start,
                self.after_ms(35) | self.part.fall,
                ~self.part.rise & ~self.start.rise,
            ):
                yield wanted
                self.steps += 1
                self.last_ms = round(self.time_ms)
            self.lamp = ~self.lamp
            self.work.start(47)
            yield self.work.expired | self.start.fall
            self.start = False
            yield self.work.fall | self.after_ms(90)


class RestlessWorker(Worker):
    """The same, but the controller cannot know that its scans do nothing."""

    def scan(self) -> None:
        """Nothing."""


class Ticks(Macroprogram):
    """Counts its scans."""

    ticks = Variable(2000)

    def scan(self) -> None:
        """One more."""
        self.ticks += 1


# -- scans and rest ----------------------------------------------------------------------------


@pytest.mark.parametrize("scan_ms", [1, 10, 60])
def test_scans_come_from_the_start_on_one_scan_time_apart(scan_ms: int) -> None:
    """The first one at the start itself."""
    bench = ProgramBench(Ticks, started=False, scan_ms=scan_ms).at(7)
    bench.runner.start(bench.now)
    assert bench.at(7).value(2000) == 1
    assert bench.at(7 + 5 * scan_ms).value(2000) == 6
    assert bench.at(6.999999 + 6 * scan_ms).value(2000) == 6


def test_a_program_may_have_a_scan_time_of_its_own() -> None:
    """In place of the unit's."""

    class Program(Ticks):
        scan_ms = 2.5

    assert ProgramBench(Program).at(10).value(2000) == 5


def test_looks_do_not_change_what_scans_do() -> None:
    """One look after a second sees the same as a look every millisecond."""
    often = ProgramBench(Ticks)
    for milliseconds in range(1001):
        often.at(milliseconds)
    assert often.value(2000) == ProgramBench(Ticks).at(1000).value(2000) == 101


class Watcher(Macroprogram):
    """Acknowledges each value that the host writes, and has its scans counted."""

    wanted = Variable(2000)
    seen = Variable(2004)
    scans = ScanCount(2008)

    def __init__(self) -> None:
        self.asked = 0

    def is_new(self) -> bool:
        """Whether there is a value to acknowledge."""
        self.asked += 1
        return self.wanted != self.seen

    def run(self) -> Steps:
        """One value after the other."""
        while True:
            yield until(self.is_new, is_steady=True)
            self.seen = self.wanted


def test_a_program_that_waits_for_data_is_not_asked_in_each_scan_and_its_scans_are_counted() -> (
    None
):
    """An hour of scans costs a look; a value is seen in the scan behind it."""
    bench = ProgramBench(Watcher).at(3_600_000)
    assert bench.value(2008) == 360_001
    program = bench.runner.instance
    assert isinstance(program, Watcher)
    assert program.asked < 10
    bench.data.write(2000, 7)
    assert bench.at(3_600_009).value(2004) == 0
    assert (bench.at(3_600_010).value(2004), bench.value(2008)) == (7, 360_002)


def test_looks_do_not_change_how_many_scans_are_counted() -> None:
    """Looked at often, or once."""
    often = ProgramBench(Watcher)
    for milliseconds in range(1001):
        often.at(milliseconds)
    assert often.value(2008) == ProgramBench(Watcher).at(1000).value(2008) == 101


def test_a_program_cannot_set_the_count_of_its_scans() -> None:
    """It is a script error, and the scan is not done."""

    class Program(Watcher):
        def run(self) -> Steps:
            self.scans = 5
            yield

    bench = ProgramBench(Program).at(0)
    assert "the controller counts its scans there" in (bench.runner.error or "")
    assert bench.value(2008) == 0


ACTIONS = st.lists(
    st.tuples(
        st.integers(0, 40_000),  # microseconds until then
        st.sampled_from([(200, True), (200, False), (3, True), (3, False), (32, False), None]),
    ),
    max_size=60,
)


@pytest.mark.strength
@given(ACTIONS, st.sampled_from(["running", "expired"]))
@settings(max_examples=200)
def test_a_program_that_rests_does_what_it_would_do_awake(
    actions: list[tuple[int, tuple[int, bool] | None]], reading: str
) -> None:
    """Whatever is done to it, and whenever somebody looks: the scans left out did nothing."""
    resting = ProgramBench(Worker, timer_flag=reading)
    awake = ProgramBench(RestlessWorker, timer_flag=reading)
    now = 0.0
    for pause_us, action in actions:
        now += pause_us / 1000
        if action is not None:
            number, on = action
            for bench in (resting, awake):
                bench.at(now).flags.set(number, on)
        awake.at(now)
        if action is None:  # a look
            resting.at(now)
            assert resting.flags.states(resting.now) == awake.flags.states(awake.now)
            assert resting.data.cells() == awake.data.cells()
    for bench in (resting, awake):
        bench.at(now + 500)
    assert resting.flags.states(resting.now) == awake.flags.states(awake.now)
    assert resting.data.cells() == awake.data.cells()


@given(ACTIONS)
def test_a_driver_that_wakes_when_asked_sees_the_same(
    actions: list[tuple[int, tuple[int, bool] | None]],
) -> None:
    """``next_event`` lies ahead and never asks for a wake-up in vain or too late."""
    driven, looked = ProgramBench(Worker), ProgramBench(RestlessWorker)
    now = 0
    driven.at(0)
    for pause_us, action in actions:
        until = now + pause_us * 1000
        while (due := driven.runner.next_event()) is not None and due <= until:
            assert due > now, "time goes on"
            now = due
            driven.runner.wake(now)
        now = until
        for bench in (driven, looked):
            bench.at(now / NS_PER_MS)
            if action is not None:
                bench.flags.set(*action)
    assert driven.data.cells() == looked.data.cells()


def test_what_has_just_happened_is_over_in_the_next_scan() -> None:
    """A program that waits for the end of an event does not rest on it."""
    ends: list[float] = []

    class Program(Macroprogram):
        part = Input(3)
        work = Timer(32)

        def run(self) -> Steps:
            self.work.start(5)  # it starts and ends between two scans: its flag is never seen
            yield self.work.expired
            yield ~self.work.expired
            ends.append(self.time_ms)
            yield self.part.rise
            yield ~self.part.rise
            ends.append(self.time_ms)
            yield self.work

    bench = ProgramBench(Program).at(100)
    bench.set(3)
    bench.at(200)
    assert ends == [20, 120]


def test_a_function_is_asked_once_in_each_scan() -> None:
    """Whoever looks how often, alone and joined with other conditions."""
    asked: list[float] = []

    class Program(Macroprogram):
        part = Input(3)

        def ask(self) -> bool:
            asked.append(self.time_ms)
            return len(asked) in (4, 9)

        def run(self) -> Steps:
            yield self.ask
            yield self.part | until(self.ask)
            self.stop()

    bench = ProgramBench(Program)
    for milliseconds in range(0, 200, 3):
        bench.at(milliseconds).runner.next_event()
    assert asked == [10 * scan for scan in range(1, 10)]


class Never(Condition):
    """A user's own condition, with a mistake."""

    def holds(self) -> bool:
        """Not even that."""
        raise ZeroDivisionError


@pytest.mark.parametrize("wanted", [lambda: 1 // 0, until(lambda: 1 // 0), Never()])
def test_a_mistake_in_what_is_waited_for_is_a_script_error(wanted: object) -> None:
    """In the scan that asks."""

    class Program(Macroprogram):
        def run(self) -> Steps:
            yield wanted

    bench = ProgramBench(Program).at(9)
    assert bench.runner.next_event() is not None
    assert bench.word == RUNNING
    assert bench.at(10).word == BAD_OPCODE
    assert bench.runner.error is not None
    assert "ZeroDivisionError" in bench.runner.error


@pytest.mark.parametrize(("timer_ms", "limit_ms", "end_ms"), [(45, 90, 50), (90, 45, 50)])
def test_a_rest_ends_with_what_comes_first(timer_ms: float, limit_ms: float, end_ms: float) -> None:
    """A timer's flag, or the limit of the wait."""
    ends: list[float] = []

    class Program(Macroprogram):
        work = Timer(32)

        def run(self) -> Steps:
            self.work.start(timer_ms)
            yield
            yield ~self.work | self.after_ms(limit_ms - 10)
            ends.append(self.time_ms)
            yield ~self.work.rise & self.work.rise

    ProgramBench(Program).at(1000)
    assert ends == [end_ms]


@pytest.mark.parametrize("program", [Worker, Ticks])
def test_a_flag_that_the_host_has_forced_is_free_at_the_next_scan(
    program: type[Macroprogram],
) -> None:
    """MSC-AMB-23, also for a program that rests."""
    bench = ProgramBench(program).at(5)
    bench.flags.force(bench.now, 3, on=True)
    assert bench.at(9).is_on(3)
    assert not bench.at(10).is_on(3)


def test_a_timer_of_an_earlier_start_ends_a_rest() -> None:
    """It held with the program, and went on with it."""

    class Program(Macroprogram):
        work = Timer(32)
        lamp = Output(20)

        def run(self) -> Steps:
            if not self.work:
                self.work.start(1000)
                yield
            yield ~self.work
            self.lamp = True
            yield self.work

    bench = ProgramBench(Program).at(500)
    bench.runner.stop(bench.now)
    bench.at(10_000)
    bench.runner.start(bench.now)
    assert bench.at(10_499).runner.next_event() == 10_500 * NS_PER_MS
    assert not bench.is_on(20)
    assert bench.at(10_500).is_on(20)


def test_a_program_that_waits_for_a_flag_asks_for_nothing() -> None:
    """Until the flag changes; then the next scans are due soon."""
    bench = ProgramBench(Worker).at(0)
    assert bench.runner.next_event() is None
    bench.at(1000)
    bench.set(200)
    due = bench.runner.next_event()
    assert due is not None
    assert 1010 <= due / NS_PER_MS <= 1100


def test_a_program_that_waits_for_a_time_asks_for_its_scan() -> None:
    """The first one that is not before that time."""

    class Program(Macroprogram):
        lamp = Output(20)

        def run(self) -> Steps:
            yield self.after_ms(60_005)
            self.lamp = True
            yield ~self.lamp

    bench = ProgramBench(Program).at(0)
    assert bench.runner.next_event() == 60_010 * NS_PER_MS
    assert not bench.at(60_009).is_on(20)
    assert bench.at(60_010).is_on(20)


def test_an_hour_of_waiting_is_not_run() -> None:
    """Less than a thousandth of a second of the computer's, where an hour has 360000 scans."""
    bench = ProgramBench(Worker).at(0)
    began = time.process_time()
    bench.runner.wake(HOUR_NS)
    assert time.process_time() - began < 0.05
    bench.flags.set(200, on=True)
    bench.runner.wake(HOUR_NS + 10 * NS_PER_MS)
    assert bench.value(2000) == 1


@pytest.mark.strength
def test_an_hour_of_scans_takes_seconds() -> None:
    """Each is done; that is measured generously here, and stands in the page on macroprograms."""
    bench = ProgramBench(Ticks)
    began = time.process_time()
    bench.runner.wake(HOUR_NS)
    assert bench.value(2000) == 360_001
    assert time.process_time() - began < 20


def test_the_same_is_done_each_time() -> None:
    """Traces, flags and data of two runs are equal."""

    def life() -> tuple[Any, ...]:
        bench = ProgramBench(Worker)
        for step in range(200):
            bench.at(17.3 * step)
            bench.flags.set((200, 3)[step % 2], on=step % 3 == 0)
        bench.runner.stop(bench.now)
        return bench.runner.take_traces(), bench.flags.states(bench.now), bench.data.cells()

    assert life() == life()


# -- the host's writes -------------------------------------------------------------------------


class Rises(Macroprogram):
    """Counts rises."""

    start = UserFlag(200)
    rises = Variable(2000)

    def run(self) -> Steps:
        """For ever."""
        while True:
            yield self.start.rise
            self.rises += 1


@pytest.mark.parametrize(("visibility", "rises"), [("next_scan", 0), ("immediate", 1)])
def test_a_short_pulse_of_the_host_is_seen_by_a_program_that_looks_at_once(
    visibility: str, rises: int
) -> None:
    """MSC-AMB-33."""
    bench = ProgramBench(Rises, write_visibility=visibility)
    for milliseconds, on in ((12, True), (15, False)):
        bench.at(milliseconds).flags.set(200, on)
        bench.runner.host_wrote(bench.now)
    assert bench.at(40).value(2000) == rises


def test_a_write_without_a_program_wakes_nothing() -> None:
    """Before a start and after a stop."""
    bench = ProgramBench(Ticks, started=False, write_visibility="immediate")
    bench.runner.host_wrote(0)
    bench.runner.start(0)
    bench.at(10)
    bench.runner.stop(bench.now)
    bench.runner.host_wrote(bench.now)
    assert bench.value(2000) == 2


# -- starts and ends ---------------------------------------------------------------------------


def test_each_start_makes_a_new_object() -> None:
    """Flags and data stay; what the program remembered is gone."""

    class Program(Ticks):
        lamp = Output(20)

        def __init__(self) -> None:
            self.own = 0

        def scan(self) -> None:
            super().scan()
            self.own += 1
            self.lamp = True

    bench = ProgramBench(Program).at(20)
    first: Any = bench.runner.instance
    bench.runner.stop(bench.now)
    bench.at(1000)
    assert (bench.value(2000), bench.is_on(20), bench.word & RUNNING) == (3, True, 0)
    bench.runner.start(bench.now)
    bench.at(1010)
    second: Any = bench.runner.instance
    assert (first.own, second.own, bench.value(2000)) == (3, 2, 5)


def test_a_start_while_it_runs_begins_anew() -> None:
    """From the beginning, in step with the new start."""
    bench = ProgramBench(Ticks).at(15)
    bench.runner.start(bench.now)
    assert bench.at(24).value(2000) == 3
    assert bench.at(25).value(2000) == 4
    kinds = [type(trace) for trace in bench.runner.take_traces()]
    assert kinds == [ProgramStarted, ProgramStopped, ProgramStarted]


def test_timers_hold_while_the_program_is_stopped() -> None:
    """They go on with it (MSC-AMB-32)."""

    class Program(Macroprogram):
        work = Timer(32)
        again = Variable(2000)

        def run(self) -> Steps:
            if not self.again:
                self.again = 1
                self.work.start(100)
            yield ~self.work & self.work

    bench = ProgramBench(Program).at(30)
    bench.runner.stop(bench.now)
    assert bench.at(5000).is_on(32)
    bench.runner.start(bench.now)
    assert bench.at(5069).is_on(32)
    assert not bench.at(5070).is_on(32)


def test_a_start_clears_what_ended_the_program_before() -> None:
    """Error text and bits 4 and 12."""

    class Program(Macroprogram):
        part = Input(3)

        def run(self) -> Steps:
            yield ~self.part
            self.fault("no part")

    bench = ProgramBench(Program).at(0)
    bench.at(10)
    assert (bench.word, bench.runner.error is None) == (BAD_OPCODE, False)
    bench.set(3)
    bench.runner.start(bench.now)
    bench.at(20)
    assert (bench.word, bench.runner.error) == (RUNNING, None)


def test_a_program_that_cannot_be_made_is_a_script_error() -> None:
    """At a start; at its loading it is refused."""
    makes = iter([Ticks, Ticks])

    def program() -> Macroprogram:
        return next(makes)()

    bench = ProgramBench(program, started=False)
    bench.runner.start(0)
    bench.runner.start(0)
    assert bench.word == BAD_OPCODE
    assert bench.runner.error is not None
    assert bench.runner.error.endswith("StopIteration: ")


def test_flags_and_data_are_not_there_before_the_first_scan() -> None:
    """The message says where to use them."""

    class Program(Ticks):
        def __init__(self) -> None:
            self.ticks = 5

    with pytest.raises(UsageError, match=r"Program.__init__ cannot use flags and data: .* initial"):
        ProgramBench(Program)


def test_nothing_is_started_without_a_program() -> None:
    """The remedy is named."""
    bench = ProgramBench(Ticks, started=False)
    empty = type(bench.runner)(
        None, bench.data, bench.flags, bench.status, scan_ns=1, quirks=bench.runner._quirks
    )
    with pytest.raises(UsageError, match="there is no program to start; load one first"):
        empty.start(0)
    assert (empty.has_program, empty.is_running, empty.next_event()) == (False, False, None)


def test_the_traces_tell_starts_and_ends() -> None:
    """With their times and the error."""

    class Program(Macroprogram):
        def run(self) -> Steps:
            yield self.after_ms(20)
            self.fault("why")

    bench = ProgramBench(Program).at(1000)
    started, ended = bench.runner.take_traces()
    assert started == ProgramStarted(0)
    assert bench.runner.error is not None
    assert ended == ProgramFailed(20 * NS_PER_MS, bench.runner.error)
    assert bench.runner.take_traces() == []


@pytest.mark.parametrize(
    ("own", "unit", "starts"),
    [(None, False, False), (None, True, True), (True, False, True), (False, True, False)],
)
def test_the_program_says_whether_it_starts_by_itself(
    own: bool | None, unit: bool, starts: bool
) -> None:
    """Else the unit does."""

    class Program(Ticks):
        auto_start: ClassVar[bool | None] = own

    assert ProgramBench(Program, auto_start=unit).runner.is_auto_started is starts
