"""What a user's program sees and does; how it is run stands in test_msc_program.py."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from program_bench import BAD_OPCODE, RUNNING, STRAY_RETURN, ProgramBench

from axistwin.errors import UsageError
from axistwin.macroprogram import (
    Array,
    Input,
    Macroprogram,
    MotorStatus,
    Output,
    Steps,
    Timer,
    UserFlag,
    Variable,
    until,
    wrapped,
)

INT32 = st.integers(-(1 << 31), (1 << 31) - 1)


class Parts(Macroprogram):
    """One of each kind, for programs to derive from."""

    part = Input(3)
    lamp = Output(20)
    work = Timer(32)
    ready = MotorStatus(41)
    start = UserFlag(200)
    done = UserFlag(201)
    count = Variable(2008)
    other = Variable(2012)
    table = Array(2048, 8)


# -- a scan ------------------------------------------------------------------------------------


def test_a_scan_sees_what_was_there_when_it_began() -> None:
    """What it sets it reads in the next one: variables, elements and flags."""
    seen: list[tuple[int, int, bool]] = []

    class Program(Parts):
        def scan(self) -> None:
            self.count += 1
            self.count += 1  # of the same value as above
            self.table[2] = 7
            self.lamp = True
            seen.append((self.count, self.table[2], bool(self.lamp)))

    bench = ProgramBench(Program).at(10)
    assert seen == [(0, 0, False), (1, 7, True)]
    assert bench.value(2008) == 2


def test_two_variables_change_places() -> None:
    """All that a scan sets is set at once, at its end."""

    class Program(Parts):
        count = Variable(2008, initial=1)
        other = Variable(2012, initial=2)

        def scan(self) -> None:
            self.count = self.other
            self.other = self.count

    bench = ProgramBench(Program).at(0)
    assert (bench.value(2008), bench.value(2012)) == (2, 1)
    bench.at(10)
    assert (bench.value(2008), bench.value(2012)) == (1, 2)


def test_rise_and_fall_compare_with_the_previous_scan() -> None:
    """Each holds in one scan, whoever changed the flag."""
    seen: list[str] = []

    class Program(Parts):
        def scan(self) -> None:
            seen.append("/" if self.part.rise else "\\" if self.part.fall else "-")

    bench = ProgramBench(Program).at(5)
    bench.set(3)
    bench.at(25)
    bench.clear(3)
    bench.at(45)
    assert "".join(seen) == "-/-\\-"


def test_a_flag_that_is_on_at_the_start_does_not_rise() -> None:
    """The first scan has no previous one."""
    seen: list[bool] = []

    class Program(Parts):
        def scan(self) -> None:
            seen.append(bool(self.part.rise or self.part.fall))

    bench = ProgramBench(Program, started=False)
    bench.set(3)
    bench.runner.start(0)
    bench.at(20)
    assert seen == [False] * 3


def test_a_pulse_within_one_scan_is_not_seen() -> None:
    """Set and cleared between two scans."""

    class Program(Parts):
        def run(self) -> Steps:
            yield self.start.rise
            self.lamp = True
            yield until(lambda: False)

    bench = ProgramBench(Program).at(12)
    bench.set(200)
    bench.at(18)
    bench.clear(200)
    assert not bench.at(100).is_on(20)


@pytest.mark.parametrize("number", [3, 20, 41, 201])
def test_a_program_may_set_flags_of_any_kind(number: int) -> None:
    """Inputs and motor flags too: it may be the machine's model."""

    class Program(Parts):
        def scan(self) -> None:
            self.part = self.lamp = self.ready = self.done = not self.start

    bench = ProgramBench(Program).at(0)
    assert bench.is_on(number)
    bench.set(200)
    assert not bench.at(10).is_on(number)


def test_a_flag_takes_another_flag() -> None:
    """By assignment, or with set and clear."""

    class Program(Parts):
        def scan(self) -> None:
            self.lamp = self.part
            if self.part:
                self.done.set()
            else:
                self.done.clear()

    bench = ProgramBench(Program).at(0)
    bench.set(3)
    bench.at(10)
    assert (bench.is_on(20), bench.is_on(201)) == (True, True)
    bench.clear(3)
    bench.at(20)
    assert (bench.is_on(20), bench.is_on(201)) == (False, False)


def test_a_flag_in_use_shows_its_state() -> None:
    """For whoever looks at it in a debugger."""
    shown: list[str] = []

    class Program(Parts):
        def scan(self) -> None:
            self.lamp = True
            shown.append(repr(self.lamp))

    ProgramBench(Program).at(10)
    assert shown == ["<flag 20 off>", "<flag 20 on>"]


# -- data --------------------------------------------------------------------------------------


@given(INT32, st.integers())
def test_variables_wrap_around(first: int, second: int) -> None:
    """Arithmetic is that of 32 bits in two's complement."""

    class Program(Parts):
        count = Variable(2008, initial=first)

        def scan(self) -> None:
            self.other = self.count + second
            self.table[0] = self.count * second

    bench = ProgramBench(Program).at(0)
    assert (bench.value(2012) - first - second) % (1 << 32) == 0
    assert (bench.value(2048) - first * second) % (1 << 32) == 0
    assert all(-(1 << 31) <= bench.value(address) < 1 << 31 for address in (2012, 2048))


@pytest.mark.parametrize(
    ("value", "left"),
    [
        (2**31 - 1, 2**31 - 1),
        (2**31, -(2**31)),
        (-(2**31) - 1, 2**31 - 1),
        (2**32, 0),
        (-1, -1),
        (0xFFFFFFFF, -1),
    ],
)
def test_what_does_not_fit_is_cut_off(value: int, left: int) -> None:
    """At the ends of the range."""
    assert wrapped(value) == left


@pytest.mark.parametrize("stride", [4, 2, 1])
def test_elements_are_one_stride_apart(stride: int) -> None:
    """Whatever the unit has; from the front, from the back, in slices."""
    seen: list[Any] = []

    class Program(Parts):
        table = Array(2048, 4, initial=[1, 2, 3, 4])

        def scan(self) -> None:
            seen[:] = [self.table[0], self.table[-1], self.table[1:3], len(self.table)]
            seen.append(list(self.table))
            self.table[-1] = 40

    bench = ProgramBench(Program, data_address_stride=stride).at(0)
    assert seen == [1, 4, [2, 3], 4, [1, 2, 3, 4]]
    assert bench.value(2048 + 3 * stride) == 40


def test_an_array_is_set_as_a_whole() -> None:
    """By a sequence of its size."""

    class Program(Parts):
        def scan(self) -> None:
            self.table = [*range(8)]

    bench = ProgramBench(Program).at(0)
    assert [bench.value(2048 + 4 * place) for place in range(8)] == [*range(8)]


# -- waiting -----------------------------------------------------------------------------------


def test_a_sequence_goes_from_step_to_step() -> None:
    """A flag, its opposite, an edge, a time, a function, nothing: each ends in its scan."""
    steps: list[float] = []

    class Program(Parts):
        def run(self) -> Steps:
            for wanted in (
                self.start,
                ~self.start,
                self.part.rise,
                self.part.fall,
                self.after_ms(15),
                lambda: self.count == 5,
                None,
            ):
                yield wanted
                steps.append(self.time_ms)
            self.stop()

    bench = ProgramBench(Program).at(12)  # waits for start
    bench.set(200)
    bench.at(22)
    bench.clear(200)
    bench.at(32)
    bench.set(3)
    bench.at(42)
    bench.clear(3)
    bench.at(72)
    bench.data.write(2008, 5)
    bench.at(200)
    # ``after_ms`` was made with the tuple, in the first scan: it was over long ago.
    assert steps == [20, 30, 40, 50, 60, 80, 90]
    assert bench.word & RUNNING == 0


def test_a_time_runs_from_the_scan_in_which_it_is_asked_for() -> None:
    """And ends in the first scan that is not before it."""
    steps: list[float] = []

    class Program(Parts):
        def run(self) -> Steps:
            for duration_ms in (250, 0, 0.001, 10, 10.5):
                yield self.after_ms(duration_ms)
                steps.append(self.time_ms)
            self.stop()

    ProgramBench(Program).at(1000)
    assert steps == [250, 260, 270, 280, 300]


def test_conditions_are_joined() -> None:
    """Both, one of them, not; a function among them."""
    seen: list[tuple[bool, ...]] = []

    class Program(Parts):
        def scan(self) -> None:
            part, start = self.part, self.start
            is_five = until(lambda: self.count == 5)
            joined = (part & start, part | start, ~part & start, is_five | part)
            seen.append(tuple(bool(each) for each in joined))

    bench = ProgramBench(Program).at(0)
    bench.set(200)
    bench.at(10)
    bench.set(3)
    bench.at(20)
    bench.clear(200, 3)
    bench.data.write(2008, 5)
    bench.at(30)
    assert seen == [
        (False, False, False, False),
        (False, True, True, False),
        (True, True, False, True),
        (False, False, False, True),
    ]


def test_a_wait_with_a_limit_ends_at_the_limit() -> None:
    """Nothing happens meanwhile."""
    ends: list[float] = []

    class Program(Parts):
        def run(self) -> Steps:
            yield self.part | self.after_ms(500)
            ends.append(self.time_ms)
            yield until(lambda: False)

    ProgramBench(Program).at(10_000)
    assert ends == [500]


def test_a_part_of_a_sequence_is_a_method_of_its_own() -> None:
    """It waits where it is called."""

    class Program(Parts):
        def run(self) -> Steps:
            for _ in range(3):
                yield from self._flash()
            self.done = True
            yield until(lambda: False)

        def _flash(self) -> Steps:
            self.lamp = True
            yield self.after_ms(10)
            self.lamp = False
            yield self.after_ms(10)
            self.count += 1

    bench = ProgramBench(Program).at(59)
    assert (bench.is_on(201), bench.value(2008)) == (False, 2)
    bench.at(60)
    assert (bench.is_on(201), bench.value(2008)) == (True, 3)


# -- timers ------------------------------------------------------------------------------------


class Pulse(Parts):
    """A timer from the first scan on, and when the program saw its end."""

    def __init__(self) -> None:
        self.ends: list[float] = []

    def run(self) -> Steps:
        """Start it; note its end; for ever."""
        self.work.start(25)
        while True:
            yield self.work.expired
            self.ends.append(self.time_ms)


@pytest.mark.parametrize(("reading", "running"), [("running", True), ("expired", False)])
def test_a_timer_runs_to_the_nanosecond(reading: str, running: bool) -> None:
    """Its flag changes between scans; the program sees it in the next, whatever the flag means."""
    bench = ProgramBench(Pulse, timer_flag=reading).at(0)
    assert bench.is_on(32) is running
    assert bench.at(24.999999).is_on(32) is running
    assert bench.at(25).is_on(32) is not running
    bench.at(1000)
    assert isinstance(bench.runner.instance, Pulse)
    assert bench.runner.instance.ends == [30]


def test_a_timer_is_started_anew_and_stopped() -> None:
    """Neither lets it expire."""

    class Program(Pulse):
        def scan(self) -> None:
            if self.part.rise:
                self.work.start(50)
            if self.done.rise:
                self.work.stop()

    bench = ProgramBench(Program).at(5)
    bench.set(3)  # at 10: until 60
    assert bench.at(59).is_on(32)
    assert not bench.at(60).is_on(32)
    bench.clear(3)
    bench.at(75)
    bench.set(3)
    assert bench.at(85).is_on(32)
    bench.set(201)
    assert not bench.at(95).is_on(32)
    bench.at(1000)
    assert isinstance(bench.runner.instance, Pulse)
    assert bench.runner.instance.ends == [60]


def test_a_timer_that_a_hand_stops_does_not_expire() -> None:
    """Its flag falls all the same."""
    falls: list[float] = []

    class Program(Pulse):
        def scan(self) -> None:
            if self.work.fall:
                falls.append(self.time_ms)

    bench = ProgramBench(Program).at(12)
    bench.clear(32)
    bench.at(100)
    assert isinstance(bench.runner.instance, Pulse)
    assert (falls, bench.runner.instance.ends) == ([20], [])


# -- ends --------------------------------------------------------------------------------------


def test_stop_ends_the_program_at_the_end_of_its_scan() -> None:
    """What the scan sets is done; nothing runs any more."""

    class Program(Parts):
        def scan(self) -> None:
            self.count += 1
            if self.count == 2:
                self.stop()
                self.lamp = True

    bench = ProgramBench(Program).at(1000)
    assert (bench.value(2008), bench.is_on(20)) == (3, True)
    assert bench.word == 0
    assert bench.runner.error is None


def test_the_end_of_run_is_a_stray_return() -> None:
    """Status bit 4; what the last step set is done."""

    class Program(Parts):
        def run(self) -> Steps:
            yield
            self.lamp = True

    bench = ProgramBench(Program).at(5)
    assert bench.word == RUNNING
    bench.at(10)
    assert (bench.word, bench.is_on(20)) == (STRAY_RETURN, True)


@pytest.mark.parametrize("kind", [ZeroDivisionError, KeyError, StopIteration, AssertionError])
def test_an_exception_is_a_script_error(kind: type[Exception]) -> None:
    """Status bit 12; nothing of that scan is done."""

    class Program(Parts):
        def scan(self) -> None:
            self.count += 1
            if self.count == 2:
                raise kind("why")

    bench = ProgramBench(Program).at(1000)
    assert (bench.value(2008), bench.word) == (2, BAD_OPCODE)
    assert bench.runner.error is not None
    assert "test_macroprogram.py:" in bench.runner.error
    assert kind.__name__ in bench.runner.error


def test_a_fault_is_told_with_its_reason() -> None:
    """And the line that told it."""

    class Program(Parts):
        def run(self) -> Steps:
            yield
            self.fault("the clamp is open")

    bench = ProgramBench(Program).at(10)
    assert bench.word == BAD_OPCODE
    assert bench.runner.error is not None
    place, _, reason = bench.runner.error.rpartition(": ")
    assert reason == "the clamp is open"
    assert place.rpartition(":")[2].isdigit()


def _mistake(statement: str) -> type[Macroprogram]:
    code = f"def scan(self):\n    {statement}\n"
    names: dict[str, Any] = {}
    exec(compile(code, "mistake.py", "exec"), names)
    return type("Mistake", (Parts,), {"scan": names["scan"]})


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("self.count = 1.5", "count = 1.5: a variable takes whole numbers; round it first"),
        ("self.table[8] = 1", "table[8]: its elements are 0..7 or, from the end, -1..-8"),
        ("self.table[-9]", "table[-9]: its elements are 0..7 or, from the end, -1..-8"),
        ("self.table[0] = None", "table[0] = None: a variable takes whole numbers; round it first"),
        ("self.table = [1]", "table has 8 elements, not 1"),
        ("self.work.start(0)", "a timer cannot run for 0 ms; give more than 0"),
        ("self.work = True", "timer 32 is started, not set: use start(duration_ms)"),
        ("self.work = False", "timer 32 is stopped, not cleared: use stop()"),
        ("self.after_ms(-1)", "-1 ms cannot be waited for; give 0 or more"),
        ("self.cuont", "AttributeError: Mistake has no cuont: did you mean count?"),
    ],
)
def test_mistakes_in_a_program_are_told_with_their_line(statement: str, message: str) -> None:
    """One line: file, line, what is wrong."""
    bench = ProgramBench(_mistake(statement)).at(0)
    assert bench.runner.error == f"mistake.py:2: {message}"
    assert bench.word == BAD_OPCODE


def test_run_is_told_when_it_waits_for_nonsense() -> None:
    """At the line with the yield."""

    class Program(Parts):
        def run(self) -> Steps:
            yield 250

    bench = ProgramBench(Program).at(0)
    assert bench.runner.error is not None
    assert bench.runner.error.endswith("run cannot wait for 250; yield a condition, or nothing")
    assert "test_macroprogram.py" in bench.runner.error


def test_what_is_cleaned_up_at_the_end_has_no_effect() -> None:
    """A program that is stopped sets nothing on its way out, and cannot stay."""

    class Program(Parts):
        def run(self) -> Steps:
            try:
                yield until(lambda: False)
            finally:
                self.lamp = True
                yield

    bench = ProgramBench(Program).at(10)
    bench.runner.stop(bench.now)
    assert not bench.at(50).is_on(20)
    assert bench.word == 0


# -- declarations ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Output(256), "Output(256) is not allowed; give a whole number, 0..255"),
        (lambda: UserFlag(-1), "UserFlag(-1) is not allowed"),
        (lambda: Input("3"), "Input('3') is not allowed"),  # type: ignore[arg-type]
        (lambda: Timer(True), "Timer(True) is not allowed"),
        (lambda: Variable(65536), "Variable(65536) is not allowed; give a whole number, 0..65535"),
        (lambda: Variable(0, initial=1 << 31), "initial value 2147483648 of address 0"),
        (lambda: Array(0, 0), "Array(0, 0): its size is a whole number, 1 or more"),
        (lambda: Array(0, 2, [1, 2, 3]), "Array(0, 2): 3 initial values are too many"),
        (lambda: Array(0, 2, [1.5]), "initial value 1.5"),  # type: ignore[list-item]
    ],
)
def test_a_bad_declaration_is_refused_in_one_line(make: Any, message: str) -> None:
    """When the class is made."""
    with pytest.raises(UsageError) as caught:
        make()
    assert str(caught.value).startswith(message)


def test_declarations_are_seen_on_the_class() -> None:
    """By whoever wants their numbers."""
    assert (Parts.start.number, Parts.count.address, Parts.table.size) == (200, 2008, 8)
