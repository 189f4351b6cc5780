"""One-draw sequences: a string of bytes is a list of operations, and every reply is judged.

Four bytes make an operation: what, two arguments, and a pause.  Any string is a sequence, so a
failing one shrinks by leaving bytes out.  The generator cannot leave the envelope: targets are
scaled into it, and before each operation an axis on its way out is stopped instead.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Final

from axistwin_conformance.families.mac.axis.driver.client import Sample
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind, signed
from axistwin_conformance.families.mac.axis.model.axis_model import (
    MOTIONS,
    SEGMENTS,
    AxisModel,
    Parameters,
)
from axistwin_conformance.families.mac.axis.model.forecast import (
    RESTING,
    Forecast,
    Timeline,
    TimeWindow,
)
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS, TICKS_PER_SECOND
from axistwin_conformance.families.mac.axis.parameters import PARAMETER_QUERIES, PARAMETERS
from axistwin_conformance.sequences.runner import Mismatch, Steps

BYTES_PER_OPERATION: Final = 4
SPAN: Final = 3000  # increments about the start in which targets lie
AHEAD_NS: Final = 600_000_000  # how far an axis is looked after
CHANGES: Final = 2  # speed changes and stops within one motion: each doubles the histories kept
PAUSED: Final = 0x80  # a pause byte above it is a wait, ms beyond it
SWINGING_S: Final = 0.1  # of a real axis
BEGIN_PERIOD: Final = 0x1000
BEGIN_COEFFICIENT: Final = 1
OPEN_STOPS: Final = ((0x09, 0x3FFFFFFF), (0x0A, 0xC0000000), (0x0E, 0x0500), (0x0C, 0x40))
PLAIN_MODES: Final = ((0x02, 0), (0x03, 0), (0x0F, BEGIN_COEFFICIENT), (0x1C, 0))
PERIODS: Final = (0x0640, 0x0800, 0x1000, 0x1800, 0x2000, 0x4000, 0xFFFF)
COEFFICIENTS: Final = (0, 0, 1, 1, 2, 3, 5)
RAMP_MARGIN: Final = 120 * max(COEFFICIENTS)
BYSTANDING_NS: Final = 200_000_000  # the longest wait for something that ends too far away

# Which requirement a surprise under an index speaks about; the rest is about replies in general.
DIAGNOSIS: Final = {
    0x0D: "MACS-STATE-01", 0x0F: "MACS-STATE-01", 0x02: "MACS-STATE-01", 0x03: "MACS-STATE-01",
    0x09: "MACS-STATE-01", 0x0A: "MACS-STATE-01",
    0x13: "MACS-CMD-13-02", 0x14: "MACS-CMD-14-02", 0x15: "MACS-CMD-15-02",
    0x16: "MACS-CMD-16-02", 0x1E: "MACS-CMD-1E-01", 0x17: "MACS-CMD-17-01",
    0x18: "MACS-CMD-18-01", 0x10: "MACS-CMD-10-01", 0x11: "MACS-CMD-11-01",
    0x20: "MACS-Q-20-01", 0x21: "MACS-Q-21-01", 0x25: "MACS-REPLY-05", 0x26: "MACS-REPLY-05",
    0x22: "MACS-REPLY-05", 0x23: "MACS-REPLY-05", 0x27: "MACS-BUSY-01",
}  # fmt: skip
DIAGNOSIS_OF_MODE: Final = {"PO": "MACS-CMD-13-01", "VE": "MACS-CMD-15-01", "IN": "MACS-CMD-16-01"}
DIAGNOSIS_OTHERWISE: Final = "MACS-REPLY-01"

STARTING: Final = frozenset({*MOTIONS, *SEGMENTS, 0x0B, 0x10, 0x11})  # where from is of account

# Where a device follows another reading than the default and the ledger gives no exact rule for
# it, nothing is judged.
UNRULED_STATUS: Final = ("ff_lifetime", "status_ff_layout")


@dataclass(frozen=True, slots=True)
class AxisOperation:
    """One line of the table: what it is called in reports, and what it does."""

    name: str
    act: Callable[[AxisSequence, int, int], None]


@dataclass
class AxisSequence(Steps):
    """One run of one byte string against one module.

    `judged`: requirement → how many replies were held against it, counted only where some other
    reply would not have done.  `operated`: state of the model and name of the operation → how often
    it was done there.  `marks`: where in the story each operation begins.  `watch`: told of each
    position judged: what was expected, what came, the slack.
    """

    operation_bytes = BYTES_PER_OPERATION

    driver: AxisDriver
    model: AxisModel
    home: int
    release: int
    operations: tuple[AxisOperation, ...]
    judged: Counter[str] = field(default_factory=Counter)
    operated: Counter[tuple[str, str]] = field(default_factory=Counter)
    marks: list[int] = field(default_factory=list)
    watch: Callable[[Forecast, Sample, int], None] | None = None
    offset: int = 0  # of the shaft: what 0Bh has taken off the counter
    changes: int = 0
    is_known: bool = False  # at the end: everything the model says has been confirmed

    def __post_init__(self) -> None:
        driver, envelope = self.driver, self.driver.session.envelope
        self.client, self._target = driver.client, driver.client.target
        self._may_be_silent = driver.client.face.may_be_silent
        self.is_guarded, self._max_travel = envelope.is_guarded, envelope.max_travel
        self.room, self.fastest = driver.limits.room(), driver.limits.fastest
        self._slack = driver.limits.allowance(PERIODS[0])
        self._timeout_s = driver.session.reply_timeout_s
        self._is_direct = self._target.is_direct
        self._cleared: set[int] = set()  # indices that the gate has let pass and nothing stores
        self._inside_until_ns = 0  # when it has to be looked again whether the axis stays inside
        self._log: list[tuple[bytes, bytes] | int] = []  # exchanges, and pauses in ns
        self._kinds: dict[bytes, ReplyKind] = {}  # of short replies: there are few
        self._known: dict[str, int] = {}
        self._follows: dict[tuple[str, ...], bool] = {}

    @property
    def story(self) -> list[str]:
        """What was sent, said and waited, in words."""
        return [
            f"wait {entry / 1e6:.0f} ms"
            if isinstance(entry, int)
            else f"{self.client.explained(entry[0])} → {self.client.described(entry[1])}"
            for entry in self._log
        ]

    def known(self, switch: str) -> int:
        """The number of the reading this device follows, as far as known at the beginning."""
        number = self._known.get(switch)
        if number is None:
            number = self._known[switch] = self.driver.readings.known(switch)
        return number

    def follows(self, *switches: str) -> bool:
        """True if the device follows the default readings of these switches, as far as known, and
        was not asked in vain."""
        follows = self._follows.get(switches)
        if follows is None:
            is_open = self.driver.readings.is_open
            follows = not any(self.known(switch) or is_open(switch) for switch in switches)
            self._follows[switches] = follows
        return follows

    # --- doing ------------------------------------------------------------------------------------

    def operate(self, what: int, first: int, second: int, pause: int) -> None:
        """Run one operation.  Raises Mismatch for a reply that is not admissible."""
        self.marks.append(len(self._log))
        operation = self.operations[what % len(self.operations)]
        try:
            state = self._look_after()
            operation.act(self, first, second)
            if pause > PAUSED:
                self.pause((pause - PAUSED) / 1000)
        except Mismatch as mismatch:
            mismatch.story = tuple(self.story)
            raise
        self.operated[state, operation.name] += 1

    def conclude(self) -> None:
        """Stop, and compare everything readable."""
        try:
            self.command(0x18)
            for index in (0x20, 0x21, 0x22, 0x23, 0x25, 0x26, 0x27):
                self.query(index)
        except Mismatch as mismatch:
            mismatch.story = tuple(self.story)
            raise
        # Some readings leave things behind that no query shows.
        self.is_known = self._is_direct and self.follows("abort_flush", "preload_policy")

    def leave(self) -> None:
        """Clear the counter where it was 0 before the sequence."""
        if not self.offset:
            return
        driver = self.driver
        if self._is_plain_again():
            position = self.model.forecast.places[0]
        else:
            driver.motion.at_rest()
            driver.client.command(0x03, 0)
            position = driver.motion.ready()
        self.is_known &= drive(driver, position, -self.offset) == -self.offset
        self.is_known &= driver.client.command(0x0B).kind is ReplyKind.ACCEPTED
        self.model.forecast = Forecast.rest(0)
        self.offset = 0

    def again(self) -> AxisSequence | None:
        """The next sequence, begun with no question whose answer is known; None if this one has
        not ended as the model says, and the module has to be asked."""
        driver, home = self.driver, self.home
        if not self._is_plain_again():
            return None
        if self.model.forecast.places != (home, home):
            if drive(driver, self.model.forecast.places[0], home) != home:
                return None
            self.model.forecast = Forecast.rest(home)
        after = AxisSequence(driver, self.model, home, self.release, self.operations)
        after._known, after._follows = self._known, self._follows
        return after

    def _is_plain_again(self) -> bool:
        """Set what differs from the beginning; False where that is not known or not accepted."""
        if not self.is_known:
            return False
        driver, parameters = self.driver, self.model.parameters
        period = driver.limits.slowed(BEGIN_PERIOD)
        for index, parameter in (*OPEN_STOPS, *PLAIN_MODES, (0x0D, period)):
            setting = PARAMETERS[index]
            value = setting.taken(parameter)
            if getattr(parameters, setting.name) != value:
                self.is_known &= driver.client.command(index, parameter).kind is ReplyKind.ACCEPTED
                setattr(parameters, setting.name, value)
        driver.motion.period, driver.motion.coefficient = period, BEGIN_COEFFICIENT
        return self.is_known

    def command(self, index: int, parameter: int = 0) -> None:
        """Send a command and hold its reply against the admissible set."""
        parameter &= 0xFFFFFFFF
        if index in STARTING:
            self._resolve_doubt()
        received, taken = self._exchange(index, parameter)
        kind = self._kinds.get(received) or self._kind_of(received)
        if index == 0x00 and kind is ReplyKind.SILENCE:  # MACS-AMB-20
            kind = ReplyKind.ACCEPTED
        admissible = self.model.outcomes(index, parameter, taken)
        if kind not in admissible:
            states = "/".join(sorted(self.model.states(taken)))
            is_of_store = index in SEGMENTS and self.has_segments  # a full one refuses either kind
            raise Mismatch(
                "MACS-CMD-16-02" if is_of_store else DIAGNOSIS.get(index, DIAGNOSIS_OTHERWISE),
                " or ".join(kind.value for kind in admissible)
                + f" to {self.client.named(index)} in {states}",
                self.client.described(received),
            )
        if len(admissible) == 1:
            self.judged[DIAGNOSIS.get(index, DIAGNOSIS_OTHERWISE)] += 1
        self.model.learn(index, parameter, kind, admissible[kind])

    def query(self, index: int) -> None:
        """Send a query and hold its data against the admissible ones."""
        received, taken = self._exchange(index)
        data = self.client.data_of(received)
        if data is None:
            described = self.client.described(received)
            raise Mismatch("MACS-Q-XX-01", f"an answer to {self.client.named(index)}", described)
        self.judged["MACS-Q-XX-01"] += 1
        if index == 0x20:
            self._judge_position(signed(data), taken)
        elif index == 0x21:
            if self.follows(*UNRULED_STATUS):
                ff, allowed = data >> 16 & 0xFF, self.model.stopped_on(taken)
                self._judge(index, ff & 0x0F, allowed, "ff")
                self.model.learn_status(ff & 0x0F, taken)
        elif index == 0x27:
            if self.follows("busy_after_abort", "busy_after_17h"):
                is_busy, busy = not data & 0x0800, self.model.busy(taken)
                self._judge(index, is_busy, busy, "busy")
        elif index in PARAMETER_QUERIES:
            wanted = self.model.parameters.answer(index)
            if data != wanted:
                name = self.client.named(index)
                raise Mismatch(DIAGNOSIS[index], f"{name} {wanted:08X}", f"data {data:08X}")
            self.judged[DIAGNOSIS[index]] += 1
        elif index == 0x24 and data != self.release:
            raise Mismatch(DIAGNOSIS_OTHERWISE, f"release {self.release:08X}", f"{data:08X}")

    def _judge(self, index: int, seen: int, admissible: frozenset[int], what: str) -> None:
        name = DIAGNOSIS.get(index, DIAGNOSIS_OTHERWISE)
        if seen not in admissible:
            raise Mismatch(name, f"{what} in {sorted(admissible)}", f"{what} {seen}")
        if len(admissible) == 1:
            self.judged[name] += 1

    def _judge_position(self, position: int, taken: TimeWindow) -> None:
        model, slack = self.model, self._slack
        lowest, highest = model.bounds(taken)
        if self.watch is not None:
            self.watch(model.forecast, Sample(position, taken), slack)
        name = self._diagnosis_of_place(taken)
        if not lowest - slack <= position <= highest + slack:
            raise Mismatch(name, f"position {lowest}..{highest}", f"position {position}")
        self.judged[name] += 1
        model.learn_position(position, taken)

    def _diagnosis_of_place(self, taken: TimeWindow) -> str:
        """The requirement of a counter reading: of the motion under way, or of the one that ended
        where nobody has looked since."""
        forecast = self.model.forecast
        if taken.earliest_ns >= forecast.over_ns:
            modes: Iterable[str] = (forecast.rested.timelines[0].after,)
        else:
            modes = sorted(forecast.modes(taken))
        return next(
            (DIAGNOSIS_OF_MODE[mode] for mode in modes if mode in DIAGNOSIS_OF_MODE), "MACS-Q-20-01"
        )

    def _exchange(self, index: int, parameter: int = 0) -> tuple[bytes, TimeWindow]:
        """Send a request; where time is virtual and nothing disturbs, by the shortest way.  There
        gate and meter are asked once about an index that stores nothing."""
        if self._is_direct and index not in self._may_be_silent:
            is_cleared = index in self._cleared
            frame, received, taken = self.client.swift(
                index, parameter, self._timeout_s, is_cleared
            )
            if not is_cleared and index not in PARAMETERS:
                self._cleared.add(index)
        else:
            exchange = self.client.send(self.client.request(index, parameter))
            frame, received, taken = exchange.request, exchange.reply.raw, exchange.taken
        self._log.append((frame, received))
        return received, taken

    def lost(self, request: Any, wanted: ReplyKind, name: str) -> None:
        """Send a request that must not be executed and gets just that reply; `name`: the
        requirement that says so."""
        exchange = self.client.in_vain(request)
        self._log.append((exchange.request, exchange.reply.raw))
        if exchange.kind is not wanted:
            raise Mismatch(name, wanted.value, str(exchange.reply))
        self.judged[name] += 1

    def synchronise(self) -> None:
        """Do what 11h does by the frame that all modules obey and none answers; what comes of it
        must be beyond doubt."""
        self._resolve_doubt()
        exchange = self.client.synchronise()
        assert exchange is not None, "only a face that has such a frame has this operation"
        self._log.append((exchange.request, exchange.reply.raw))
        ((kind, after),) = self.model.outcomes(0x11, 0, exchange.taken).items()
        self.model.learn(0x11, 0, kind, after)

    def _kind_of(self, received: bytes) -> ReplyKind:
        kind = self._kinds[received] = self.client.kind_of(received)
        return kind

    def restart(self) -> None:
        """00h, and the deaf time after it."""
        self.command(0x00)
        self.pause(self.driver.motion.awake_surely_s)

    def pause(self, seconds: float) -> None:
        """Let time pass."""
        self._log.append(round(seconds * 1e9))
        self.client.wait(seconds)

    def pause_until_taken(self, number: int, offset_ns: int) -> None:
        """Wait so that the next request is taken over about when something ends: the motion, or a
        stage of it; `number` picks which of those that are still to come."""
        aimed_ns = self._target.now_ns + self.client.frame_ns
        ends = self.model.forecast.ends_after(aimed_ns)
        if not ends:
            return
        end_ns = ends[number % len(ends)] + offset_ns
        if not self._target.is_virtual or not self._is_kept_inside(end_ns + AHEAD_NS):
            end_ns = min(end_ns, aimed_ns + BYSTANDING_NS)
        self.pause(max(0, end_ns - aimed_ns) / 1e9)

    # --- staying inside ---------------------------------------------------------------------------

    def _now(self) -> TimeWindow:
        now_ns = self._target.now_ns
        return TimeWindow(now_ns, now_ns)

    @property
    def is_resting(self) -> bool:
        """True if the axis is at rest for certain."""
        return self._target.now_ns >= self.model.forecast.over_ns

    def _look_after(self) -> str:
        """Stop an axis that would leave the envelope before the next operation is over.  Give the
        states it may have been in."""
        now_ns, forecast = self._target.now_ns, self.model.forecast
        if now_ns >= forecast.over_ns:
            self.changes = 0
            if self._target.travel_guard is not None and not self._is_left_alone(now_ns + AHEAD_NS):
                self.command(0x18)
            return self.model.name_of(RESTING)
        modes = forecast.modes(TimeWindow(now_ns, now_ns))
        if now_ns >= self._inside_until_ns and not self._is_kept_inside(now_ns + AHEAD_NS):
            self.command(0x18)
        return self.model.name_of(modes)

    def _resolve_doubt(self) -> None:
        """Ask where an axis at rest is, if that is in doubt, so that the next motion starts from
        one place."""
        forecast = self.model.forecast
        if len(forecast.timelines) > 1 and self.is_resting and not forecast.is_in_one_place:
            self.query(0x20)

    def _is_left_alone(self, later_ns: int) -> bool:
        """True if the travel guard has no reason to end a motion until then."""
        travel_guard = self._target.travel_guard
        deadline_ns = None if travel_guard is None else travel_guard.deadline_ns
        return deadline_ns is None or deadline_ns >= later_ns

    def _is_kept_inside(self, later_ns: int) -> bool:
        if not self._is_left_alone(later_ns):
            return False
        lowest, highest = self.model.forecast.bounds(TimeWindow(later_ns, later_ns))
        gone = max(self.home - self.shaft(lowest), self.shaft(highest) - self.home)
        room = self._max_travel - RAMP_MARGIN
        if not self.is_guarded and 0 <= gone < room:
            # Whatever it is told: no motion here is faster than the shortest period.
            time_ns = (room - gone) * PERIODS[0] * TICK_NS
            self._inside_until_ns = self._target.now_ns + time_ns // 2 - AHEAD_NS
        return gone <= room

    def has_room(self, period: int) -> bool:
        """True if endless motion can go on until after the next operation."""
        if not self.is_guarded:
            return True
        lowest, highest = self.model.forecast.bounds(self._now())
        gone = max(abs(self.shaft(lowest) - self.home), abs(self.shaft(highest) - self.home))
        fastest = min(period, self.model.parameters.period or period, PERIODS[0])
        room = self._max_travel - gone - RAMP_MARGIN
        return room * fastest > TICKS_PER_SECOND * AHEAD_NS // 1_000_000_000

    def shaft(self, counter: int) -> int:
        """Where the shaft is, in increments of the counter as it was at the start."""
        return counter + self.offset

    def place(self, fraction: int) -> int:
        """A target for a byte: spread over the span about the start."""
        span = min(SPAN, self.room)
        return self.home - self.offset + (fraction - 0x80) * span // 0x80

    def here(self) -> int:
        """Some admissible present position."""
        self._resolve_doubt()
        return self.model.forecast.bounds(self._now())[0]

    @property
    def is_held(self) -> bool:
        """True in synchronous mode."""
        return self.model.is_armed

    @property
    def has_segments(self) -> bool:
        """True if segments run, or will before the next command is taken over."""
        timelines = self.model.forecast.timelines
        return not self.is_resting and any(timeline.segments for timeline in timelines)

    def may_change(self) -> bool:
        """Count a change of a running motion; False when there were enough."""
        self.changes += 1
        return self.is_resting or self.changes <= CHANGES


def drive(driver: AxisDriver, origin: int, target: int) -> int:
    """Move between two places inside the envelope, judging nothing; give where the axis then is."""
    exchange = driver.client.command(0x13, target)
    if exchange.kind is ReplyKind.ACCEPTED:
        end = driver.motion.to_position(exchange, origin, target).end
        assert end is not None, "a move has one"
        driver.client.wait_until(end.latest_ns)
        driver.client.wait(0 if driver.client.target.is_virtual else SWINGING_S)
    return driver.client.position()


def begin(
    driver: AxisDriver,
    home: int | None,
    law_known: Callable[[AxisDriver], AxisModel],
    operations: tuple[AxisOperation, ...],
) -> AxisSequence:
    """Bring the module to a known state, always the same, and give a sequence of these operations
    to play."""
    position = driver.motion.ready(BEGIN_PERIOD, BEGIN_COEFFICIENT)
    if home is not None and position != home:
        position = drive(driver, position, home)
    model = law_known(driver)
    ff = driver.status.stopped_on()  # of the sequence before: the next motion clears it
    model.forecast = Forecast.of([Timeline("HD", position, ff=ff)])
    start = position if home is None else home
    return AxisSequence(driver, model, start, driver.client.value(0x24), operations)


def read_parameters(driver: AxisDriver) -> Parameters:
    """Everything the model must know of a module at rest."""
    found = driver.client.parameters()
    values = {
        part.name: part.taken(part.parameter(found[index])) for index, part in PARAMETERS.items()
    }
    return Parameters(imax=driver.client.imax, **values)
