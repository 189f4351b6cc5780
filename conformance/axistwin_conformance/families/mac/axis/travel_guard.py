"""The travel guard: no frame leaves the suite that asks an axis to leave the envelope.

It reads every byte either way, below checks, hooks and shrinking alike, and keeps for each axis on
the line an interval of where the shaft may be or may still go (`Axis.reach`), in increments from
where the run found it.  The counter may be cleared under it (0Bh, the reference input): `offset`
is what has to be added to the counter to get the shaft, an interval as well.

    frame sent ──▶ what would follow, all readings of a doubt joined ──▶ outside? not sent
    reply heard ─▶ refused or Nack: nothing followed; none: both remain possible

Endless motion has no asked-for position.  It is bounded by time: `deadline_ns` is when the stop
must be on its way, and who lets time pass (`Transport`) sends it then, whatever the check is about.

The counter is an encoder's and tells of a shaft that was turned by hand, too.  It does not tell
where the shaft is once it has been cleared: by 0Bh, by the reference input in motion (07h), or by a
supply that was cut on a device that forgets.  The rig says when it does such things (`worked`), and
all places that then are possible are kept (`_origin_seen`): nothing the run does gives back travel
that is used up.  A reference contact may open again and again: a move it can prolong is treated
like endless motion until its target is seen.

What is sent rests on what the device is believed to do.  A counter reading of a place where the
axis cannot be (`_is_runaway`) shows that it does something else; a second one in a row is no noise,
and from then on nothing that moves is sent any more (`runaway`), so that it strays by one motion
and not by their sum; nor is any of what was sent since it was last seen where it should be, since
that moved it (`_suspects`), whatever it is by its name.  A shaft that the rig may have turned is
taken to be where it is seen next.

18h is never held back.  Any other request may be (`OutsideEnvelope`, which names what it would
take): `foresee` asks beforehand, so that a check can be left out instead.  Judged is what a device
does that follows the manual in the readings known of it; nothing can be said of one that obeys
frames with wrong checksums.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Any, Final, NoReturn, Protocol

from axistwin_conformance.base.errors import OutsideEnvelope
from axistwin_conformance.core.readings import Readings
from axistwin_conformance.families.mac.axis.exchanges import QUERIES, ReplyKind, signed
from axistwin_conformance.families.mac.axis.model.kinematics import (
    TICKS_PER_SECOND,
    ramp_increments,
)
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS
from axistwin_conformance.families.mac.axis.shaft import (
    FACTORY_PERIOD,
    SLOWEST_LEVEL_TICKS,
    SLOWEST_TICKS,
    ZERO_SLACK,
    Axis,
    Interval,
    Shown,
    join,
    shift,
)
from axistwin_conformance.families.mac.axis.suspects import Suspects

MARGIN_NS: Final = 30_000_000  # a frame at 9600 baud takes 22 ms; the rest is our own reaction
# The readings that matter here, as the ledger names them (MACS-AMB-07, -36, -38, -40, -51).
F6_TURNS: Final = "negative"
REPLACES: Final = "replace"
SEGMENTS_SIGNED: Final = "true"
FLUSHES: Final = "true"
COASTS: Final = "decelerate"
PERMANENT: Final = "permanent"
GENTLE_BRAKING: Final = 1_000_000  # inc/s²: a tenth of what an unloaded MAC23 does (§5.4)
HALTING: Final = frozenset({0x00, 0x01, 0x18, 0x1A})
STOP: Final = 0x18
CUTTING: Final = frozenset({"power", "micro_cut", "supply"})  # a device may forget its place then
SWING: Final = 100  # increments: a shaft may swing, or be pushed, by fewer
MOTIONS: Final = frozenset({0x13, 0x14, 0x15, 0x16})
MOVING: Final = MOTIONS | {0x11}
NEVER_HELD_BACK: Final = {STOP, *QUERIES}


@dataclass(frozen=True, slots=True)
class SentRequest:
    """A request that would be obeyed: by the module at that address, or by all (None); `raw` as it
    was sent."""

    address: int | None
    index: int
    parameter: int
    raw: bytes


@dataclass(frozen=True, slots=True)
class ReceivedReply:
    """A whole reply: its kind, and the number in it if it is an answer.

    `whom`: where many were asked and one speaks for itself alone, its address.
    """

    kind: ReplyKind
    data: int | None = None
    whom: int | None = None


class Reader(Protocol):
    """How the travel guard understands what passes, on one face of the module."""

    def foreseen(self, data: bytes, /) -> list[SentRequest]:
        """What these bytes would ask for if they followed what was sent so far."""

    def sent(self, data: bytes, /) -> None:
        """From now on these bytes have been sent."""

    def received(self, data: bytes, /) -> ReceivedReply | None:
        """Take in what was received; the reply it completes, or None."""

    def stop(self, address: int, /) -> bytes:
        """The frame that ends any motion of that module."""

    def explained(self, raw: bytes, /) -> str:
        """A request in words."""


class AxisTravelGuard:
    """The envelope of one line.

    `own`: the address under test.  `readings`: what is known of the device, as the run learns it.
    """

    def __init__(
        self, reader: Reader, max_travel: int, max_speed: int, own: int, readings: Readings
    ) -> None:
        self.reader = reader
        self.max_travel, self.max_speed, self.own = max_travel, max_speed, own
        self.readings = readings
        self.axes: dict[int, Axis] = {}
        self.runaway = ""  # why nothing that moves is sent any more
        self.broken = ""  # the requirement it fails by that
        self.written: dict[int, dict[int, int]] = {}  # parameters, last value of each, by address
        self.run_on = 0  # how many increments more 18h and stops may take, while that is asked
        self._doubtful: set[int] = set()  # axes last seen where they cannot be
        self._suspects = Suspects()
        self._shown: defaultdict[int, Shown] = defaultdict(Shown)  # by address
        self._found_periods: dict[int, int] = {}
        self._before: dict[int, Axis] = {}
        self._after: dict[int, Axis] = {}
        self._last: SentRequest | None = None  # the last request sent
        self._last_ns = 0

    @property
    def is_in_doubt(self) -> bool:
        """True if an axis was last seen where it cannot be: the next reading tells whether that was
        noise."""
        return bool(self._doubtful) and not self.runaway

    @property
    def _run_on(self) -> int:
        """Increments that 18h and stops still take, where that is a number (MACS-AMB-76)."""
        number = self.readings.guess("brake_increments", "")
        return int(number) if number.isdigit() else self.run_on

    @property
    def _keeps_preload(self) -> bool:
        """Whether what 10h has begun may outlast a stop (MACS-AMB-36)."""
        return bool(self.readings.get("preload_policy", REPLACES) != REPLACES)

    def _braking(self, speed: int) -> int:
        """Increments a real axis may need to stop without ramp."""
        return max(self._run_on, 2 + speed * speed // (2 * GENTLE_BRAKING))

    # --- what is sent -----------------------------------------------------------------------------

    def foresee(self, data: bytes, now_ns: int) -> OutsideEnvelope | None:
        """Why these bytes would be held back now; None if they would not be."""
        after = {address: axis.grown(now_ns) for address, axis in self.axes.items()}
        try:
            for asked in self.reader.foreseen(data):
                self._account(after, asked, now_ns)
        except OutsideEnvelope as error:
            return error
        return None

    def sending(self, data: bytes, now_ns: int) -> None:
        """Account for bytes about to be sent; raises OutsideEnvelope if they must not be."""
        before = {address: axis.grown(now_ns) for address, axis in self.axes.items()}
        after = dict(before)
        requests = self.reader.foreseen(data)
        for asked in requests:
            self._account(after, asked, now_ns)
            addresses = tuple(self.axes) if asked.address is None else (asked.address,)
            if asked.index in PARAMETERS:
                for address in addresses:
                    self.written.setdefault(address, {})[asked.index] = asked.parameter
            if asked.index not in NEVER_HELD_BACK:
                self._suspects.sent(addresses, asked.index)
        self.reader.sent(data)
        self._before, self._after = before, after
        # Until the reply comes, the frame may have been obeyed or not.
        self.axes = {
            address: before[address].joined(axis) if address in before else axis
            for address, axis in after.items()
        }
        self._last = requests[-1] if requests else None
        self._last_ns = now_ns

    def _account(self, axes: dict[int, Axis], asked: SentRequest, now_ns: int) -> None:
        address, index, parameter, frame = asked.address, asked.index, asked.parameter, asked.raw
        if index in MOVING and (self.runaway or self._doubtful):
            raise OutsideEnvelope(self.runaway or "an axis was last seen where it cannot be")
        if index in self._suspects.indices:
            raise OutsideEnvelope(f"{self.runaway}, nor sent {index:02X}h, which may have moved it")
        if index in MOTIONS and address is not None and address not in axes:
            self._refuse(
                frame, f"nobody knows where the axis at {address:02X}h is", "--neighbour", address
            )
        for candidate in tuple(axes) if address is None else (address,):
            if candidate not in axes:
                continue
            after = self._obeyed(axes[candidate], index, parameter, now_ns, frame)
            if index in MOVING:
                after = replace(
                    after,
                    begun_ns=now_ns,
                    begun_by=index,
                    is_still=False,
                    slowest_ticks=max(after.slowest_ticks, after.level_ticks(index, parameter)),
                )
            if index != STOP:
                self._judge_reach(axes[candidate], after, now_ns, frame)
            axes[candidate] = after
            if index == 0x08:  # the same axis may answer there from now on
                new = parameter & 0x7F
                axes[new] = axes[new].joined(after) if new in axes else after

    def _judge_reach(self, before: Axis, after: Axis, now_ns: int, frame: bytes) -> None:
        """Hold back what leads out, or further out for an axis that was turned out by hand."""
        (low, high), (lowest, highest) = after.reach, before.reach
        if low < min(-self.max_travel, lowest) or high > max(self.max_travel, highest):
            self._refuse(
                frame,
                f"it could bring the axis to {low:+}..{high:+} from where it was found",
                "--max-travel",
                max(-low, high),
            )
        is_begun = after.speed > before.speed or after.directions != before.directions
        if after.speed and is_begun and self._deadline_of(after) <= now_ns:
            room = self._braking(after.speed) + after.speed * 2 * MARGIN_NS // 1_000_000_000 + 2
            self._refuse(
                frame,
                "there is no room for motion without an end at that speed",
                "--max-travel",
                room + max(abs(low), abs(high)),
            )

    def _refuse(self, frame: bytes, reason: str, option: str, needed: int) -> NoReturn:
        raise OutsideEnvelope(
            f"held back {self.reader.explained(frame)}: {reason}; the envelope is"
            f" {self.max_travel} increments either way, {self.max_speed} per second",
            option,
            needed,
        )

    def _obeyed(self, axis: Axis, index: int, parameter: int, now_ns: int, frame: bytes) -> Axis:
        """What may be true once the axis has obeyed."""
        low_byte, half = parameter & 0xFF, parameter & 0xFFFF
        if index in (0x13, 0x14):
            counter = signed(parameter) if index == 0x13 else 0
            return self._sent_to(axis, counter, now_ns, frame)
        if index == 0x15:
            return self._endless(axis, parameter >> 16 & 0xFF, half, now_ns, frame)
        if index == 0x16 and half:
            return self._stepped(axis, parameter >> 16, half, now_ns, frame)
        if index == 0x11:
            lifetime = self.readings.guess("sync_arm_lifetime", "")
            return axis.released(now_ns, is_permanent=lifetime == PERMANENT)
        if index == 0x17:
            return self._run_out(axis) if self._keeps_preload else self._run_out(axis).disarmed()
        if index in HALTING:
            return self._halted(axis, index, now_ns)
        if index == 0x0D and half:
            if half != self._found_periods.get(self.own):  # what was found may be put back
                self._judge_period(half, frame)
            return replace(axis, period=half)
        if index == 0x0B:
            return self._cleared(axis, now_ns, now_ns + 2 * MARGIN_NS)
        changes: dict[int, dict[str, Any]] = {
            0x10: {"is_armed": True},
            0x07: {"has_reference": bool(low_byte)},
            0x0F: {"coefficient": low_byte},
        }
        return replace(axis, **changes.get(index, {}))

    def _cleared(self, axis: Axis, since_ns: int, now_ns: int) -> Axis:
        """0Bh, between two instants: the counter is 0, where the shaft is known no better, and a
        move under way ends at its old number of the new count."""
        cleared = axis.counter_at(now_ns)
        offset, reach = shift(axis.offset, cleared), axis.reach
        if axis.may_move and not axis.speed and not axis.segment_speed:
            reach = join(reach, shift(axis.tip, cleared))
        return replace(
            axis, offset=offset, counter=(0, 0), seen_ns=since_ns, target=None, reach=reach
        )

    def _steadily_at(self, axis: Axis, now_ns: int) -> Interval:
        """The same for an axis that keeps its speed without a ramp, and nothing is in its way."""
        low, high = axis.counter_at(now_ns)
        here = axis.counter[0]
        if axis.coefficient or not axis.may_move or axis.counter[1] > here:
            return low, high
        speed, left = TICKS_PER_SECOND // axis.period, (axis.target or here) - here
        if axis.segment_speed:
            speed, left = axis.segment_speed - 1, axis.tip[0] - axis.offset[0] - here
        elif axis.target is None and axis.directions != (-1, 1):
            speed, left = (
                axis.speed - 1,
                (axis.directions[0] + axis.directions[1]) * self.max_travel,
            )
        moving_ns = now_ns - max(axis.seen_ns, axis.begun_ns) - 2 * MARGIN_NS
        least = min(abs(left), max(0, speed * moving_ns // 1_000_000_000 - ZERO_SLACK))
        return (here + least, high) if left > 0 else (low, here - least)

    def _judge_period(self, period: int, frame: bytes) -> None:
        if self.max_speed * period < TICKS_PER_SECOND:
            speed = -(-TICKS_PER_SECOND // period)
            self._refuse(frame, f"period {period:04X}h is too fast", "--max-speed", speed)

    def _sent_to(self, axis: Axis, counter: int, now_ns: int, frame: bytes) -> Axis:
        if not axis.was_seen_at(counter):  # a move of no way has no speed
            self._judge_period(axis.period, frame)
        goal = shift(axis.offset, (counter, counter))
        moved = replace(
            axis,
            reach=join(axis.reach, goal),
            tip=join(axis.tip, goal),
            may_move=True,
            target=None if axis.may_move else counter,
            is_filled=axis.is_armed is not False,
        )
        if not axis.has_reference or goal[1] <= axis.reach[0]:
            return moved
        if axis.is_armed is not False:  # 11h starts it; the deadline is checked then
            moved = replace(moved, held=(TICKS_PER_SECOND // axis.period + 1, (0, 1)))
        if axis.is_armed:
            return moved
        # Cleared on the way, the counter has as far to go again from there.
        speed = max(axis.speed, TICKS_PER_SECOND // axis.period + 1)
        return replace(
            moved, speed=speed, directions=join(axis.directions, (0, 1)), since_ns=now_ns
        )

    def _stepped(self, axis: Axis, digits: int, period: int, now_ns: int, frame: bytes) -> Axis:
        self._judge_period(period, frame)
        steps = signed(digits, 16)
        seen = self.readings.get("segment_signed") if steps != digits else SEGMENTS_SIGNED
        if seen is None:  # it may go on forward until it is stopped
            axis = self._endless(axis, 0, period, now_ns, frame)
        elif seen != SEGMENTS_SIGNED:
            steps = digits
        coasts = self.readings.guess("fifo_underrun", COASTS) == COASTS
        return axis.stepped(steps, ramp_increments(axis.coefficient) if coasts else 0, period)

    def _endless(self, axis: Axis, selector: int, period: int, now_ns: int, frame: bytes) -> Axis:
        if not period:
            return self._run_out(axis)
        self._judge_period(period, frame)
        speed = max(TICKS_PER_SECOND // period + 1, axis.speed)
        if axis.may_move:  # a move may be taken over at its own speed, in its own direction
            speed = max(speed, TICKS_PER_SECOND // axis.period + 1)
        f6_direction = self.readings.guess("vel_f6_direction", "")
        is_known = f6_direction and not axis.may_move
        direction = -1 if selector == 0xF6 and f6_direction == F6_TURNS else 1
        directions = (min(direction, 0), max(direction, 0)) if is_known else (-1, 1)
        if axis.is_armed is not False:
            axis = replace(axis, held=(speed, directions), is_filled=True)
        if axis.is_armed:
            return axis
        return replace(
            axis, speed=speed, directions=directions, since_ns=now_ns, may_move=True, target=None
        )

    def _run_out(self, axis: Axis) -> Axis:
        """17h, or 15h with period 0: what is left is the ramp."""
        if not axis.speed:
            return axis
        far = ramp_increments(axis.coefficient) + self._braking(axis.speed)
        reach = (axis.reach[0] + axis.directions[0] * far, axis.reach[1] + axis.directions[1] * far)
        return replace(axis, reach=reach, speed=0, directions=(0, 0), target=None)

    def _halted(self, axis: Axis, index: int, now_ns: int) -> Axis:
        """18h, 1Ah, 00h, 01h: at rest at once, nothing stored; unless the device reads it else."""
        counter = axis.counter_at(now_ns + 2 * MARGIN_NS)  # at rest, until it is read
        far = self._braking(axis.speed) if axis.speed else 0
        reach = (axis.reach[0] + axis.directions[0] * far, axis.reach[1] + axis.directions[1] * far)
        is_stop, is_factory = index in (0x18, 0x1A), index == 0x01
        keeps_segments = is_stop and self.readings.get("abort_flush", FLUSHES) != FLUSHES
        keeps_preload = keeps_segments or (is_stop and self._keeps_preload)
        keeps = keeps_segments or (keeps_preload and axis.is_armed is not False)
        return replace(
            axis if keeps_preload else axis.disarmed(),
            reach=reach,
            tip=axis.tip if keeps else reach,
            counter=counter,
            speed=0,
            directions=(0, 0),
            target=None,
            may_move=axis.may_move and keeps,
            segment_speed=axis.segment_speed if keeps_segments else 0,
            period=FACTORY_PERIOD if is_factory else axis.period,
        )

    def worked(self, name: str, window: tuple[int, int], *_: object) -> None:
        """The rig has worked `name` (of `AXIS_CONTROLS`) in this window of the clock, ns."""
        self._shown.clear()
        for address, found in self.axes.items():
            axis = replace(found, is_worked=True, is_still=False)
            self.axes[address] = axis
            if name == "reference":
                edge = axis.counter_at(window[1])
                self.axes[address] = replace(axis, edge=join(edge, axis.edge or edge))
            elif name in CUTTING:
                self.axes[address] = replace(axis, is_cut=True)

    # --- what is heard ----------------------------------------------------------------------------

    def received(self, data: bytes, now_ns: int) -> None:
        """Learn from the reply what became of the frame."""
        reply, asked = self.reader.received(data), self._last
        if reply is None or asked is None:
            return
        axes = self.axes
        was = {address: self._before.get(address, axis) for address, axis in self._after.items()}
        if reply.kind is ReplyKind.REFUSED and asked.index == STOP:
            axes = {
                address: self._unpowered(was[address], axis, now_ns)
                for address, axis in self._after.items()
            }
        elif reply.kind in (ReplyKind.REFUSED, ReplyKind.NACK):
            axes = was
            if asked.index == 0x11:
                axes = {address: axis.not_released() for address, axis in was.items()}
        elif reply.kind is ReplyKind.ACCEPTED:
            axes = {
                address: self._heeded(was[address], axis, now_ns)
                for address, axis in self._after.items()
            }
            for address in self._before if asked.address is None else (asked.address,):
                if (before := self._before.get(address)) is not None:
                    self._shown[address].heeded(
                        before, asked.index, asked.parameter, self._last_ns, now_ns
                    )
        elif reply.data is not None and asked.address is not None:
            self._learn(asked.address, asked.index, reply.data, now_ns)
        if asked.address is None and reply.whom is not None:  # what became of the others is open
            axes = {
                **self.axes,
                **{address: axes[address] for address in axes if address == reply.whom},
            }
        self.axes = axes
        self._last = None

    def _unpowered(self, before: Axis, after: Axis, now_ns: int) -> Axis:
        """An axis that refuses to stop: after a fault nothing drives it (MACS-STATE-02).  What is
        preloaded stays where that is the reason (MACS-AMB-36)."""
        ended = self._heeded(before, after, now_ns)
        return replace(
            ended, held=before.held, is_armed=before.is_armed, is_filled=before.is_filled
        )

    def _heeded(self, before: Axis, after: Axis, now_ns: int) -> Axis:
        """An axis that has obeyed somewhere between request and reply."""
        if after is not before and self._last is not None and self._last.index == 0x0B:
            return self._cleared(before, self._last_ns, now_ns)
        if not before.speed or after.speed:
            return after
        grown = before.grown(now_ns).reach
        far = shift(grown, (after.reach[0] - before.reach[0], after.reach[1] - before.reach[1]))
        return replace(after, reach=far, tip=join(after.tip, far))

    def _learn(self, address: int, index: int, data: int, now_ns: int) -> None:
        axis = self.axes.get(address)
        if index == 0x20:
            counter = signed(data)
            if axis is None:
                self.axes[address] = Axis(offset=(-counter, -counter), seen_ns=self._last_ns)
            elif not self._is_runaway(address, axis, counter, now_ns):
                self.axes[address] = self._located(axis, counter, now_ns)
            is_doubtful, is_runaway = address in self._doubtful, bool(self.runaway)
            self._suspects.seen(address, counter, is_doubtful=is_doubtful, is_runaway=is_runaway)
            if (unshown := self._shown[address].seen(counter, self._last_ns)) and not is_runaway:
                self.broken = f"MACS-CMD-{self.axes[address].begun_by:02X}-01"
                self.runaway = unshown
        elif axis is not None and index == PARAMETERS[0x0D].query:
            period = PARAMETERS[0x0D].read(data)
            self._found_periods.setdefault(address, period)
            self.axes[address] = replace(axis, period=period or 1)
        elif axis is not None and index == PARAMETERS[0x0F].query:
            self.axes[address] = replace(axis, coefficient=PARAMETERS[0x0F].read(data))

    def seen_still(self, address: int) -> None:
        """The axis no longer runs on after what has ended its motion."""
        if address in self.axes:
            self.axes[address] = replace(
                self.axes[address], is_still=True, slowest_ticks=SLOWEST_TICKS
            )

    def slowest_ticks(self, address: int) -> int:
        """What an increment takes at most of anything that may have moved the axis since."""
        return self.axes[address].slowest_ticks if address in self.axes else SLOWEST_LEVEL_TICKS

    def is_still(self, address: int) -> bool:
        """True if it was seen so, and nothing that could move it has happened since."""
        return address in self.axes and self.axes[address].is_still

    def _is_runaway(self, address: int, axis: Axis, counter: int, now_ns: int) -> bool:
        """True if the axis is seen where nothing it was asked for leads, by more than it may run on
        or swing; told for good when the next reading says the same."""
        axis = self._origin_seen(axis, counter, now_ns).grown(now_ns)
        slack = SWING + (self._braking(axis.speed) if axis.speed else self._run_on)
        (low, high), (lowest, highest) = shift(axis.offset, (counter, counter)), axis.reach
        if axis.is_worked or (lowest - slack <= high and low <= highest + slack):
            self._doubtful.discard(address)
            return False
        if address in self._doubtful and not self.runaway:
            after = self._suspects.foremost(address, axis.begun_by)
            leads = "which leads" if after in MOVING else "where other commands lead"
            self.broken = f"MACS-CMD-{after:02X}-01"
            self.runaway = (
                f"after {after:02X}h, {leads} to {lowest:+}..{highest:+} from where the axis was"
                f" found, it was seen at {low:+}: it is moved no more"
            )
        self._doubtful.add(address)
        return True

    def _located(self, axis: Axis, counter: int, now_ns: int) -> Axis:
        """Narrow down by a counter reading."""
        axis, is_turned = self._origin_seen(axis, counter, now_ns), axis.is_worked
        here = shift(axis.offset, (counter, counter))
        axis = replace(axis, counter=(counter, counter), seen_ns=self._last_ns, is_worked=False)
        if axis.speed and counter == axis.target:  # a move that the reference could have prolonged
            axis = replace(axis, speed=0, directions=(0, 0), may_move=False, target=None)
        if axis.speed:
            return replace(axis, reach=here, since_ns=self._last_ns)
        if not axis.may_move:
            return replace(axis, reach=here, tip=here)
        # Where it runs on, or swings, adds nothing: reading by reading it could go anywhere.
        known = join(axis.reach, here) if is_turned else axis.reach
        if axis.target is None:
            return replace(axis, reach=known)
        goal = shift(axis.offset, (axis.target, axis.target))
        low, high = join(here, goal)
        left = (max(low, known[0]), min(high, known[1]))
        return replace(axis, reach=left, tip=goal, may_move=counter != axis.target)

    def _origin_seen(self, axis: Axis, counter: int, now_ns: int) -> Axis:
        """Account for a counter that may have been cleared since it was read last: it then counts
        from a place `zero` of the old count."""
        low, high = axis.counter_at(now_ns)
        if axis.edge is not None:  # a slow rig leaves much open that the motion itself settles
            low, high = self._steadily_at(axis, now_ns)
        is_plain = low <= counter <= high
        zeros = [(0, 0)] if is_plain else []
        if axis.is_cut and not is_plain and abs(counter) <= ZERO_SLACK:
            zeros = [(0, 0), (low, high)]
        if axis.edge is not None:
            zeros.append((max(axis.edge[0], low - counter), min(axis.edge[1], high - counter)))
        if axis.has_reference and not is_plain and axis.edge is None:  # a contact of the machine's
            zeros.append((max(low, low - counter), min(high, high - counter)))
        zeros = [zero for zero in zeros if zero[0] <= zero[1]] or [(0, 0)]  # turned by hand
        return replace(axis, offset=shift(axis.offset, join(*zeros)), edge=None, is_cut=False)

    # --- endless motion ---------------------------------------------------------------------------

    @property
    def deadline_ns(self) -> int | None:
        """When the stop has to be on its way; None while nothing moves without an end."""
        moving = [self._deadline_of(axis) for axis in self.axes.values() if axis.speed]
        if not moving:
            return None
        is_stopping = self._last is not None and self._last.index in HALTING
        return max(min(moving), self._last_ns + 2 * MARGIN_NS) if is_stopping else min(moving)

    def _deadline_of(self, axis: Axis) -> int:
        rooms = []
        if axis.directions[0] < 0:
            rooms.append(self.max_travel + axis.reach[0])
        if axis.directions[1] > 0:
            rooms.append(self.max_travel - axis.reach[1])
        room = min(rooms) - self._braking(axis.speed) - 1
        return axis.since_ns + room * 1_000_000_000 // axis.speed - MARGIN_NS

    def needed(self, wait_ns: int) -> int:
        """How far from where they were found endless motions lead if they go on for so long."""
        far = [0]
        for axis in self.axes.values():
            if axis.speed:
                low, high = axis.grown(self._deadline_of(axis) + wait_ns).reach
                margin = self._braking(axis.speed) + axis.speed * 2 * MARGIN_NS // 1_000_000_000
                far.append(max(-low, high) + margin)
        return max(far)

    def stop(self) -> tuple[bytes, ...]:
        """The frames that end what may be running, to each axis."""
        return tuple(self.reader.stop(address) for address, axis in self.axes.items() if axis.speed)
