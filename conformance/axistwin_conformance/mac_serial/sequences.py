"""One-draw sequences: a string of bytes is a list of operations, and every reply is judged.

Four bytes make an operation: what, two arguments, and a pause.  Any string is a sequence, so a
failing one shrinks by leaving bytes out.  The generator cannot leave the envelope: targets are
scaled into it, and before each operation an axis on its way out is stopped instead.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

from axistwin_conformance.mac_serial import codec
from axistwin_conformance.mac_serial.bench import (
    QUIET_S,
    Bench,
    Exchange,
    Sample,
    segment,
    velocity,
)
from axistwin_conformance.mac_serial.codec import Kind
from axistwin_conformance.mac_serial.forecast import Forecast, Timeline, Window
from axistwin_conformance.mac_serial.model import (
    DROPPING,
    MOTIONS,
    SEGMENTS,
    AxisModel,
    Parameters,
)
from axistwin_conformance.mac_serial.motion import TICKS_PER_SECOND

Choices = tuple[int, ...]

BYTES_PER_OPERATION: Final = 4
PERIODS: Final = (0x0640, 0x0800, 0x1000, 0x1800, 0x2000, 0x4000, 0xFFFF)
COEFFICIENTS: Final = (0, 0, 1, 1, 2, 3, 5)
SPAN: Final = 3000  # increments about the start in which targets lie
AHEAD_NS: Final = 600_000_000  # how far an axis is looked after
CHANGES: Final = 2  # speed changes and stops within one motion: each doubles the histories kept

# Which requirement a surprise under an index speaks about; the rest is about replies in general.
BLAME: Final = {
    0x0D: "MACS-STATE-01", 0x0F: "MACS-STATE-01", 0x02: "MACS-STATE-01", 0x03: "MACS-STATE-01",
    0x09: "MACS-STATE-01", 0x0A: "MACS-STATE-01",
    0x13: "MACS-CMD-13-02", 0x14: "MACS-CMD-14-02", 0x15: "MACS-CMD-15-02",
    0x16: "MACS-CMD-16-02", 0x1E: "MACS-CMD-1E-01", 0x17: "MACS-CMD-17-01",
    0x18: "MACS-CMD-18-01", 0x10: "MACS-CMD-10-01", 0x11: "MACS-CMD-11-01",
    0x20: "MACS-Q-20-01", 0x21: "MACS-Q-21-01", 0x25: "MACS-REPLY-05", 0x26: "MACS-REPLY-05",
    0x22: "MACS-REPLY-05", 0x23: "MACS-REPLY-05", 0x27: "MACS-BUSY-01",
}  # fmt: skip
BLAME_MODE: Final = {"PO": "MACS-CMD-13-01", "VE": "MACS-CMD-15-01", "IN": "MACS-CMD-16-01"}
BLAME_OTHERWISE: Final = "MACS-REPLY-01"


# Where a device follows another reading than the default and the ledger gives no exact rule for
# it, the operations that would need one are left out.
UNRULED_SEGMENTS: Final = ("fifo_underrun", "abort_flush", "segment_zero_steps")
UNRULED_SYNC: Final = ("preload_policy", "abort_flush", "sync_arm_lifetime")
UNRULED_STOPS: Final = ("soft_stop_compare", "soft_stop_blocks")
UNRULED_STATUS: Final = ("ff_lifetime", "status_ff_layout")
UNRULED_CHANGES: Final = ("vel_change_law", "ramp_law", "vel_reverse_cmd")
UNRULED_RAMPED_STOPS: Final = ("stop_ramp_law", "ramp_law")
UNRULED_RESTARTS: Final = ("persist_modes",)


class Mismatch(Exception):  # noqa: N818 - a finding, not an error
    """A reply outside the admissible set."""

    def __init__(self, requirement: str, expected: str, actual: str) -> None:
        super().__init__(f"{requirement}: admissible {expected}, came {actual}")
        self.requirement, self.expected, self.actual = requirement, expected, actual
        self.story: tuple[str, ...] = ()


@dataclass
class Sequence:
    """One run of one byte string against one module.

    `judged`: requirement → how many replies were held against it.  `covered`: state of the model
    and index → how many frames were answered there.  `marks`: where in the story each operation
    begins.  `watch`: told of each position judged: what was expected, what came, the slack.
    """

    bench: Bench
    model: AxisModel
    home: int
    release: int
    story: list[str] = field(default_factory=list)
    judged: Counter[str] = field(default_factory=Counter)
    covered: Counter[tuple[str, int]] = field(default_factory=Counter)
    marks: list[int] = field(default_factory=list)
    watch: Callable[[Forecast, Sample, int], None] | None = None
    offset: int = 0  # of the shaft: what 0Bh has taken off the counter
    changes: int = 0

    def follows(self, *switches: str) -> bool:
        """True if the device follows the default readings of these switches, as far as known."""
        return not any(self.bench.known(switch) for switch in switches)

    # --- doing ------------------------------------------------------------------------------------

    def play(self, data: bytes) -> None:
        """Run all operations, then stop and compare everything readable."""
        try:
            for at in range(0, len(data) - BYTES_PER_OPERATION + 1, BYTES_PER_OPERATION):
                what, first, second, pause = data[at : at + BYTES_PER_OPERATION]
                self.marks.append(len(self.story))
                self._settle_doubt()
                self._keep_inside()
                OPERATIONS[what % len(OPERATIONS)](self, first, second)
                if pause > 0x80:
                    self._pause((pause - 0x80) / 1000)
            self.command(0x18)
            for index in (0x20, 0x21, 0x22, 0x23, 0x25, 0x26, 0x27):
                self.query(index)
        except Mismatch as mismatch:
            mismatch.story = tuple(self.story)
            raise
        finally:
            self._put_origin_back()

    def _put_origin_back(self) -> None:
        """Clear the counter where it was 0 before the sequence."""
        if self.offset:
            self.bench.at_rest()
            self.bench.command(0x03, 0)
            self.bench.ready()
            self.bench.finish(self.bench.go(-self.offset))
            self.bench.command(0x0B)
            self.offset = 0

    def command(self, index: int, parameter: int = 0) -> None:
        """Send a command and hold its reply against the admissible set."""
        exchange = self._tell(index, parameter)
        if index == 0x00 and exchange.kind is Kind.SILENCE:  # MACS-AMB-20
            exchange = replace(exchange, reply=codec.Reply(Kind.ACCEPTED))
        admissible = self.model.outcomes(index, parameter & 0xFFFFFFFF, exchange.taken)
        if exchange.kind not in admissible:
            states = "/".join(sorted(self.model.states(exchange.taken)))
            raise Mismatch(
                BLAME.get(index, BLAME_OTHERWISE),
                " or ".join(kind.value for kind in admissible) + f" to {index:02X}h in {states}",
                str(exchange.reply),
            )
        self.judged[BLAME.get(index, BLAME_OTHERWISE)] += 1
        self.model.learn(index, parameter & 0xFFFFFFFF, exchange.kind, admissible[exchange.kind])

    def query(self, index: int) -> None:
        """Send a query and hold its data against the admissible ones."""
        exchange = self._tell(index)
        reply, taken = exchange.reply, exchange.taken
        if reply.data is None or reply.digit is None:
            raise Mismatch("MACS-Q-XX-01", f"an answer to {index:02X}h", str(reply))
        self.judged["MACS-Q-XX-01"] += 1
        if index == 0x20:
            self._judge_position(codec.signed(reply.data), taken)
        elif index == 0x21:
            ff, allowed = reply.data >> 16 & 0xFF, self.model.stopped_on(taken)
            holds = ff & 0x0F in allowed or not self.follows(*UNRULED_STATUS)
            self._judge(index, holds, f"ff in {sorted(allowed)}", f"ff {ff:02X}")
        elif index == 0x27:
            is_busy, busy = not reply.data & 0x0800, self.model.busy(taken)
            holds = is_busy in busy or not self.follows("busy_after_abort")
            self._judge(index, holds, f"busy in {sorted(busy)}", f"busy {is_busy}")
        elif index in (0x22, 0x23, 0x25, 0x26):
            wanted = self.model.parameters.answer(index)
            self._judge(
                index, reply.data == wanted, f"{index:02X}h {wanted:08X}", f"{reply.data:08X}"
            )
        elif index == 0x24:
            self._judge(
                index, reply.data == self.release, f"{self.release:08X}", f"{reply.data:08X}"
            )

    def _judge(self, index: int, holds: bool, expected: str, actual: str) -> None:
        if not holds:
            raise Mismatch(BLAME.get(index, BLAME_OTHERWISE), expected, actual)
        self.judged[BLAME.get(index, BLAME_OTHERWISE)] += 1

    def _judge_position(self, position: int, taken: Window) -> None:
        lowest, highest = self.model.bounds(taken)
        slack = self.bench.allowance(PERIODS[0])
        if self.watch is not None:
            self.watch(self.model.forecast, Sample(position, taken), slack)
        modes = self.model.forecast.modes(taken)
        names = [BLAME_MODE[mode] for mode in sorted(modes) if mode in BLAME_MODE]
        name = names[0] if names else "MACS-Q-20-01"
        if not lowest - slack <= position <= highest + slack:
            raise Mismatch(name, f"position {lowest}..{highest}", f"position {position}")
        self.judged[name] += 1
        self.model.learn_position(position, taken)

    def _tell(self, index: int, parameter: int = 0) -> Exchange:
        frame = self.bench.frame(index, parameter)
        exchange = self.bench.send(frame)
        self.story.append(f"{codec.explain(frame.encode())} → {exchange.reply}")
        self.covered["/".join(sorted(self.model.states(exchange.taken))), index] += 1
        return exchange

    def lost(self, frame: codec.Request, wanted: Kind) -> None:
        """Send a frame that must not be executed and gets just that reply."""
        exchange = self.bench.send(frame, QUIET_S)
        self.story.append(f"{codec.explain(frame.encode())} → {exchange.reply}")
        name = "MACS-REPLY-02" if wanted is Kind.NACK else "MACS-FRAME-07"
        if exchange.kind is not wanted:
            raise Mismatch(name, wanted.value, str(exchange.reply))
        self.judged[name] += 1

    def restart(self) -> None:
        """00h, and the deaf time after it."""
        self.command(0x00)
        self._pause(self.bench.awake_surely_s)

    def _pause(self, seconds: float) -> None:
        self.story.append(f"wait {seconds * 1000:.0f} ms")
        self.bench.wait(seconds)

    # --- staying inside ---------------------------------------------------------------------------

    def _now(self) -> Window:
        now_ns = self.bench.target.now_ns
        return Window(now_ns, now_ns)

    @property
    def is_resting(self) -> bool:
        """True if the axis is at rest for certain."""
        return self.model.forecast.modes(self._now()) == {"HD"}

    def _settle_doubt(self) -> None:
        """Ask for the position when the axis rests, so that the next motion starts from one."""
        if self.is_resting:
            self.changes = 0
            places = {timeline.final for timeline in self.model.forecast.timelines}
            if len(places) > 1:
                self.query(0x20)

    def _keep_inside(self) -> None:
        """Stop an axis that would leave the envelope before the next operation is over."""
        later_ns = self.bench.target.now_ns + AHEAD_NS
        lowest, highest = self.model.forecast.bounds(Window(later_ns, later_ns))
        margin = 120 * max(COEFFICIENTS)
        room = self.bench.session.envelope.max_travel - margin
        is_outside = max(self.home - self.shaft(lowest), self.shaft(highest) - self.home) > room
        fence = self.bench.target.fence
        deadline_ns = None if fence is None else fence.deadline_ns
        if is_outside or (deadline_ns is not None and deadline_ns < later_ns):
            self.command(0x18)

    def has_room(self, period: int) -> bool:
        """True if endless motion can go on until after the next operation."""
        envelope = self.bench.session.envelope
        if not envelope.is_fenced:
            return True
        lowest, highest = self.model.forecast.bounds(self._now())
        gone = max(abs(self.shaft(lowest) - self.home), abs(self.shaft(highest) - self.home))
        fastest = min(period, self.model.parameters.period or period, PERIODS[0])
        room = envelope.max_travel - gone - 120 * max(COEFFICIENTS)
        return room * fastest > TICKS_PER_SECOND * AHEAD_NS // 1_000_000_000

    def shaft(self, counter: int) -> int:
        """Where the shaft is, in increments of the counter as it was at the start."""
        return counter + self.offset

    def place(self, fraction: int) -> int:
        """A target for a byte: spread over the span about the start."""
        span = min(SPAN, self.bench.room())
        return self.home - self.offset + (fraction - 0x80) * span // 0x80

    def way(self, byte: int) -> int:
        """A direction, among those the device has."""
        return 1 if self.bench.known("vel_f6_direction") else -1 if byte & 1 else 1

    def value(self, values: Choices, legal: Choices, byte: int) -> int:
        """One of the values; only a legal one if the device takes others somehow (AMB-60)."""
        chosen = values if self.follows("param_range_policy") else legal
        return chosen[byte % len(chosen)]

    def period(self, byte: int) -> int:
        """A period for 0Dh, now and then 0."""
        if not byte and self.follows("zero_period_0d"):
            return 0
        return max(PERIODS[byte % len(PERIODS)], self.bench.fastest)

    def torque(self, byte: int) -> int:
        """A torque limit, legal or not."""
        imax = self.model.parameters.imax
        values = (1, 0x40, imax - 1, 0, imax, imax + 1, 0xFF)
        plain = self.follows("torque_range", "torque_over")
        return min(0xFF, values[byte % (len(values) if plain else 3)])

    def stops(self, byte: int) -> int:
        """A mode for 03h."""
        if not self.follows(*UNRULED_STOPS):
            return byte & 1
        return self.value((0, 8, 9, 1, 2, 8), (0, 8, 9, 1, 0, 8), byte)

    def here(self) -> int:
        """Some admissible present position."""
        now = self._now()
        return self.model.forecast.bounds(now)[0]

    @property
    def is_held(self) -> bool:
        """True in synchronous mode."""
        return self.model.is_armed

    @property
    def has_segments(self) -> bool:
        """True if segments run, or will before the next command is taken over."""
        return not self.is_resting and any(
            timeline.segments for timeline in self.model.forecast.timelines
        )

    def may_change(self) -> bool:
        """Count a change of a running motion; False when there were enough."""
        self.changes += 1
        return self.is_resting or self.changes <= CHANGES


# --- the operations ------------------------------------------------------------------------------
#
# Left out because the ledger does not say what happens: 15h while segments run and 10h while
# anything runs (each has a check of its own); segments while armed; 0Bh in a move (AMB-53).


def _move(run: Sequence, first: int, second: int) -> None:
    run.command(0x13, run.place(first))


def _nudge(run: Sequence, first: int, second: int) -> None:
    run.command(0x13, run.here() + first % 21 - 10)


def _home(run: Sequence, first: int, second: int) -> None:
    is_near = abs(run.home - run.offset) <= run.bench.room()
    is_ruled = run.is_resting or run.follows("motion_lock_set")
    run.command(0x14) if is_near and is_ruled else run.query(0x20)


def _turn(run: Sequence, first: int, second: int) -> None:
    if run.has_segments or not (run.is_resting or run.follows(*UNRULED_CHANGES)):
        run.command(0x18)
        return
    period = max(PERIODS[second % len(PERIODS)], run.bench.fastest)
    if not run.may_change() or not run.has_room(period):
        run.command(0x18)
        return
    run.command(0x15, velocity(run.way(first), period))


def _turn_off(run: Sequence, first: int, second: int) -> None:
    is_ruled = run.is_resting or run.follows(*UNRULED_RAMPED_STOPS, "vel_reverse_cmd")
    if run.has_segments or run.is_held or not is_ruled or not run.may_change():
        run.command(0x18)
        return
    run.command(0x15, velocity(run.way(first), 0))


def _ramped_stop(run: Sequence, first: int, second: int) -> None:
    is_ruled = run.follows(*UNRULED_RAMPED_STOPS)
    is_ruled &= not run.has_segments or run.bench.known("stop17_in_interp") < 2
    run.command(0x17 if run.is_resting or (is_ruled and run.may_change()) else 0x18)


def _segment(index: int) -> Callable[[Sequence, int, int], None]:
    def send(run: Sequence, first: int, second: int) -> None:
        is_ruled = run.follows(*UNRULED_SEGMENTS)
        is_ruled &= run.is_resting or run.bench.known("interp_during_profile") < 2
        if run.is_held or not is_ruled:
            run.query(0x20)
            return
        period = max(PERIODS[second % len(PERIODS)], run.bench.fastest)
        is_zero = second == 0xFF and run.follows("segment_zero_period")
        steps = first % 65 - 32
        steps = abs(steps) if run.bench.known("segment_signed") else steps
        run.command(index, segment(steps, 0 if is_zero else period))

    return send


def _sync(index: int) -> Callable[[Sequence, int, int], None]:
    def send(run: Sequence, first: int, second: int) -> None:
        is_ruled = run.is_resting and run.follows(*UNRULED_SYNC)
        run.command(index if is_ruled else 0x18)

    return send


def _set(index: int, value: Callable[[Sequence, int], int]) -> Callable[[Sequence, int, int], None]:
    def send(run: Sequence, first: int, second: int) -> None:
        if not run.is_resting and not run.follows("motion_lock_set"):
            run.query(0x20)  # what a new speed or ramp does to a running motion is not said
            return
        run.command(index, value(run, first))

    return send


def _clear(run: Sequence, first: int, second: int) -> None:
    if run.bench.session.envelope.is_fenced:
        run.command(0x18)  # so that the place is known exactly, and the envelope stays where it is
    run.query(0x20)
    if not run.is_resting or abs(run.home) > run.bench.room():
        return
    before = run.here()
    run.command(0x0B)
    run.offset += before


def _at_rest(index: int) -> Callable[[Sequence, int, int], None]:
    def send(run: Sequence, first: int, second: int) -> None:
        run.command(index if run.is_resting else 0x18)

    return send


def _query(run: Sequence, first: int, second: int) -> None:
    run.query(0x20 + first % 10)


def _unassigned(run: Sequence, first: int, second: int) -> None:
    if run.bench.known("unknown_index") > 1:
        return
    run.command((0x04, 0x05, 0x06, 0x12, 0x1D, 0x1F, 0x2A, 0x2F)[first % 8], second)


def _spoilt(run: Sequence, first: int, second: int) -> None:
    index = (*MOTIONS, *SEGMENTS, *DROPPING, 0x0B, 0x0D, 0x20)[first % 11]
    frame = run.bench.frame(index, 0x00101000)
    run.lost(frame.with_wrong_checksum(second % 0xFF + 1), Kind.NACK)


def _astray(run: Sequence, first: int, second: int) -> None:
    session = run.bench.session
    taken = {session.address, *session.neighbours}
    other = next(one for one in range(first % 0x70, 0x80) if one not in taken)
    index = (*DROPPING, 0x13, 0x20)[second % 5]
    if session.envelope.is_fenced and index == 0x13:
        index = 0x20  # a module that nobody has named might be there and move
    run.lost(run.bench.frame(index, 0, address=other), Kind.SILENCE)


def _restart(run: Sequence, first: int, second: int) -> None:
    is_cheap = run.bench.target.is_virtual and first < 0x40
    run.restart() if is_cheap and run.follows(*UNRULED_RESTARTS) else run.query(0x26)


OPERATIONS: Final[tuple[Callable[[Sequence, int, int], None], ...]] = (
    lambda run, first, second: run.query(0x20),
    _move,
    lambda run, first, second: run._pause(first / 1000),
    _turn,
    _segment(0x16),
    _ramped_stop,
    lambda run, first, second: run.command(0x18),
    _segment(0x1E),
    _nudge,
    _sync(0x10),
    _sync(0x11),
    _turn_off,
    _query,
    _move,
    _segment(0x16),
    lambda run, first, second: run.query(0x20),
    _set(0x0D, lambda run, first: run.period(first)),
    _set(0x0F, lambda run, first: COEFFICIENTS[first % 7]),
    _set(0x1C, lambda run, first: (0, 0, 1, 10, 100)[first % 5]),
    _set(0x0E, lambda run, first: first << 8),
    _set(0x0C, lambda run, first: run.torque(first)),
    _set(0x02, lambda run, first: run.value((0, 0, 2, 0x10), (0, 0, 0, 0), first)),
    _set(0x03, lambda run, first: run.stops(first)),
    _set(0x09, lambda run, first: run.place(first)),
    _set(0x0A, lambda run, first: run.place(first)),
    _clear,
    _at_rest(0x1A),
    lambda run, first, second: run.command(0x19),
    _home,
    _unassigned,
    _spoilt,
    _astray,
    _restart,
)


def begin(bench: Bench, home: int | None, law_known: Callable[[Bench], AxisModel]) -> Sequence:
    """Bring the module to a known state and give a sequence to play."""
    position = bench.ready(0x1000, 1)
    if home is not None and abs(position - home) > bench.room():
        bench.finish(bench.go(home))
        position = bench.position()
    model = law_known(bench)
    ff = bench.stopped_on()  # of the sequence before: the next motion clears it
    model.forecast = Forecast.of([Timeline("HD", position, ff=ff)])
    return Sequence(bench, model, position if home is None else home, bench.value(0x24))


def read_parameters(bench: Bench) -> Parameters:
    """Everything the model must know of a module at rest."""
    speeds, modes = bench.value(0x25), bench.value(0x26)
    return Parameters(
        superior=codec.signed(bench.value(0x22)),
        inferior=codec.signed(bench.value(0x23)),
        catch_up=speeds >> 24,
        period=speeds & 0xFFFF,
        coefficient=modes >> 24,
        torque=modes >> 16 & 0xFF,
        standby=modes >> 12 & 0xF,
        stops=modes >> 8 & 0xF,
        tolerance=modes & 0xFF,
        imax=bench.data_bytes(0x28, 0xAF)[0],
    )
