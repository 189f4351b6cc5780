"""The host's hands on one module: settings, motions and their forecasts, waiting for rest.

Built on `talk.py`, which tells for each exchange when the module can have taken it over.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from axistwin_conformance.base.errors import OutsideEnvelope, TargetError
from axistwin_conformance.core.probing import Probe
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S as QUIET_S
from axistwin_conformance.families.mac.axis.driver.client import Exchange as Exchange
from axistwin_conformance.families.mac.axis.driver.client import Part as Part
from axistwin_conformance.families.mac.axis.driver.client import Sample as Sample
from axistwin_conformance.families.mac.axis.driver.client import Talk
from axistwin_conformance.families.mac.axis.exchanges import Kind
from axistwin_conformance.families.mac.axis.model.forecast import (
    Forecast,
    Segment,
    Timeline,
    Window,
)
from axistwin_conformance.families.mac.axis.model.kinematics import (
    RAMP_LEVELS,
    TICK_NS,
    TICKS_PER_SECOND,
    Course,
    Law,
)
from axistwin_conformance.families.mac.axis.return_to_start import wait_for_it

DEAF_S: Final = 2.0  # MACS-CMD-00-02
FIFO_STAGES: Final = 3
PRELOAD_SHOWS_S: Final = 0.2
CLOCK_ERROR: Final = 0.002  # a real module's quartz against ours; none in virtual time

SLOWEST_LEVEL_TICKS: Final = RAMP_LEVELS * 0xFFFF  # an increment at the foot of the slowest ramp

GENTLE_BRAKING: Final = 1_000_000  # inc/s²: a tenth of what an unloaded MAC23 does (§5.4)

PLOT_POINTS: Final = 12  # of the predicted band, at most, from one reading to the next
PLOT_SPACING_NS: Final = 5_000_000
MOTION_NAMES: Final = {"PO": "move", "VE": "endless motion", "IN": "segments", "HD": "halt"}

SLOWEST: Final = 0xFFFF
PLAIN_EXCHANGE_NS: Final = 15_000_000  # at 38400 baud, with nothing in between
MOST_ROOM: Final = 500_000  # increments: 100 s at the speed of the checks
SAFE_PERIOD: Final = 0x0640  # 1600 ticks: 5000 inc/s, 150 rpm on a MAC23


class Bench(Talk):
    """One module on the line, as a check handles it."""

    def __init__(self, session: Session, address: int | None = None) -> None:
        super().__init__(session, address)
        self.period = SAFE_PERIOD
        self.coefficient = 0
        self.is_plotting = True  # False: what moves is not what is judged
        self._plotted: tuple[int, str, int] | None = None  # start of a motion, its plot, how far

    def reading(
        self, switch: str, outcome: int | tuple[int, ...] | str, requirement: Part = None
    ) -> None:
        """Judge an ambiguity: `outcome` is the number of the reading seen, 0 the default, or the
        numbers of those that explain what was seen, or a sentence about what came if none does."""
        readings = self.session.run.ledger.ambiguity_of(switch).switches[switch]
        if isinstance(outcome, str):
            self.session.fail(requirement, [f"{switch}={one}" for one in readings], outcome)
        numbers = (outcome,) if isinstance(outcome, int) else outcome
        self.session.quirk(requirement, switch, [readings[number] for number in numbers])
        self.session.expect(True, requirement, readings, "one of them")

    def again(self, probe: Probe, requirement: Part = None) -> None:
        """Ask a probe's question again and judge that the device reads it as it did."""
        seen = probe.look(self.session)
        if not seen.readings:
            readings = self.session.run.ledger.ambiguity_of(probe.switch).switches[probe.switch]
            self.session.fail(requirement, readings, seen.evidence)
        self.session.quirk(requirement, probe.switch, seen.readings)
        self.session.expect(True, requirement, seen.readings, "one of them")

    def known(self, switch: str, look: Callable[[Bench], int | str] | None = None) -> int:
        """The number of the reading this device follows, as far as known, asking by `look` if it
        has not shown itself yet; what fits no reading counts as the default here, and so does what
        this module's manual does not leave open."""
        ledger = self.session.run.ledger
        readings = ledger.ambiguity_of(switch).switches[switch]
        seen = self.session.readings.get(switch)
        if seen in readings:
            return readings.index(seen)
        if look is None or not ledger.asks(switch):
            return 0
        outcome = look(self)
        if isinstance(outcome, str):
            return 0
        self.session.run.readings.setdefault(switch, readings[outcome])
        return outcome

    # --- settings and motion ---------------------------------------------------------------------

    def fit(self, samples: Sequence[Sample], forecasts: Sequence[Forecast]) -> list[int]:
        """Which of several predictions, by number, all the samples agree with."""
        slack = self.allowance(self.period)
        fitting = []
        for number, forecast in enumerate(forecasts):
            bounds = [forecast.bounds(self._widened(one.taken, forecast)) for one in samples]
            if all(
                lowest - slack <= one.position <= highest + slack
                for one, (lowest, highest) in zip(samples, bounds, strict=True)
            ):
                fitting.append(number)
        for one in samples:
            self.plot(forecasts[fitting[0] if fitting else 0], one, slack)
        return fitting

    def beyond(self, samples: Sequence[Sample], behind: Forecast, ahead: Forecast) -> str:
        """Which sample is not between two predictions, in words; empty if all are."""
        slack = self.allowance(self.period)
        for one in samples:
            lowest = behind.bounds(self._widened(one.taken, behind))[0] - slack
            highest = ahead.bounds(self._widened(one.taken, ahead))[1] + slack
            if not lowest <= one.position <= highest:
                return f"position {one.position}, not within {lowest}..{highest}"
        return ""

    def sampled(self, seconds: float, count: int) -> list[Sample]:
        """Read the counter `count` times over the next `seconds`."""
        begin_ns = self.target.now_ns
        samples = []
        for number in range(count):
            self.wait_until(begin_ns + round(seconds * 1e9) * number // count)
            samples.append(self.sample())
        return samples

    @property
    def law(self) -> Law:
        """The readings that shape profiles, as this device has shown them."""
        seen = self.session.readings
        return Law(
            ramp=seen.get("ramp_law", "equal_time"),
            change=seen.get("vel_change_law", "ramp_length"),
            stop=seen.get("stop_ramp_law", "climbed"),
            triangle=seen.get("triangle_law", "mirror"),
            step=seen.get("step_phase", "end"),
        )

    def may(self, safety: str) -> bool:
        """True if the running check, or probe, has declared that it does such things."""
        check = self.session.check
        return check is not None and safety in check.safety

    @property
    def deaf_s(self) -> float:
        """How long this module is deaf after a restart (MACS-AMB-21)."""
        return int(self.session.reading("boot_time_ms")) / 1000

    @property
    def deaf_surely_s(self) -> float:
        """For how long after a restart it surely hears nothing."""
        return self.deaf_s - min(0.5, self.deaf_s / 2)

    @property
    def awake_surely_s(self) -> float:
        """How long after a restart it surely listens."""
        return self.deaf_s + 0.5

    def wait_awake(self) -> None:
        """Wait until the module surely listens after a restart, as long as this one is deaf."""
        self.wait(self.awake_surely_s)

    def reinitialise(self) -> Exchange:
        """Send 00h and wait until the module surely listens again."""
        exchange = self.within(QUIET_S, 0x00)
        self.wait_awake()
        return exchange

    def command(self, index: int, parameter: int = 0, sub_index: int = 0) -> Exchange:
        """Send a command; before the counter is cleared the place is read, where the envelope
        counts: how far the axis may have come since it was read last is lost to it for ever."""
        if index == 0x0B and self.session.envelope.is_guarded:
            self.ask(0x20)
        if index in (0x13, 0x14):
            self.needs_speed(SLOWEST)
        exchange = super().command(index, parameter, sub_index)
        if index == 0x18 and exchange.kind is Kind.ACCEPTED:
            self.run_out()
        return exchange

    def run_out(self, slowest_ticks: int = SLOWEST_LEVEL_TICKS) -> None:
        """Wait until an axis stands still that runs on after 18h and stops, locked as in motion;
        `slowest_ticks`: what an increment takes at most when it begins to.

        It runs on over the N increments it was seen to (MACS-INT-03), slowing down evenly, so that
        the last one takes 2√N times as long as one before, and all of them √N times that.
        """
        number = self.session.reading("brake_increments")
        if number.isdigit():
            increments = int(number)
        elif self.has_ideal_plant:
            increments = int(self._may_run_on)
        else:
            increments = self.braking(self.period)
        if not increments:
            return
        pause_s = (2 * math.sqrt(increments) + 1) * slowest_ticks / TICKS_PER_SECOND
        place = self.ask(0x20).reply.data
        for _ in range(math.isqrt(increments) + 2):
            if place is None:  # who is silent is not waited for
                return
            self.wait(pause_s)
            before, place = place, self.ask(0x20).reply.data
            if place == before:
                return

    @property
    def _may_run_on(self) -> bool:
        """True in a probe that comes before it is known how the plant brakes, where looking costs
        nothing: in virtual time, without noise."""
        check = self.session.check
        is_asked = check is not None and not check.requirements
        return is_asked and self.target.is_lossless and "plant" not in self.session.readings

    @property
    def fastest(self) -> int:
        """The shortest period the envelope allows; one beyond SLOWEST allows no motion at all."""
        return max(1, -(-TICKS_PER_SECOND // self.session.envelope.max_speed))

    @property
    def can_move(self) -> bool:
        """False if the slowest motion there is would be too fast for the envelope."""
        return self.fastest <= SLOWEST or not self.session.envelope.is_guarded

    def needs_speed(self, period: int) -> None:
        """Leave the check, or the probe, if that period is too fast for the envelope."""
        if self.session.envelope.is_guarded and period < self.fastest:
            speed = -(-TICKS_PER_SECOND // period)
            slow = "no motion is slow enough" if period == SLOWEST else "it is a matter of speed"
            raise OutsideEnvelope(slow, "--max-speed", speed)

    def slowed(self, period: int) -> int:
        """That period, or the shortest the envelope allows."""
        self.needs_speed(SLOWEST)
        return max(period, self.fastest)

    def slowed_alike(self, *periods: int) -> list[int]:
        """These periods, all made longer by as much as the shortest has to be; none beyond
        SLOWEST."""
        fastest = self.slowed(min(periods))
        return [min(SLOWEST, -(-period * fastest // min(periods))) for period in periods]

    def lasting_s(self, increments: int, period: int | None = None) -> float:
        """The time that so many increments take, at the speed of `ready` or another."""
        return increments * (self.period if period is None else period) / TICKS_PER_SECOND

    def needs_room(self, increments: int, reason: str) -> None:
        """Leave the check, or the probe, if nobody may go that far from where `ready` ends."""
        self.needs_travel(-(-increments * 8 // 7), reason)  # an eighth may be used up already

    def needs_travel(self, increments: int, reason: str) -> None:
        """Leave the check, or the probe, if so many increments are too many for the envelope."""
        envelope = self.session.envelope
        if envelope.is_guarded and increments > envelope.max_travel:
            raise OutsideEnvelope(reason, "--max-travel", increments)

    def ready(self, period: int = SAFE_PERIOD, coefficient: int = 0) -> int:
        """Bring the module to rest with plain settings; give its position.

        No sync, no stops, nominal torque (an axis in standby may swing by one increment, so exact
        places could not be judged), tolerance 0, the given period and ramp.
        """
        self.settle(period, coefficient)
        return self.come_home()

    def settle(self, period: int = SAFE_PERIOD, coefficient: int = 0) -> None:
        """The same, wherever the axis then stands."""
        self.at_rest()
        speeds, modes = self.value(0x25), self.value(0x26)
        self.period = max(period, self.fastest) if self.can_move else speeds & 0xFFFF
        self.coefficient = coefficient
        for index, present, wanted in (
            (0x02, modes >> 12 & 0xF, 0),
            (0x03, modes >> 8 & 0xF, 0),
            (0x0D, speeds & 0xFFFF, self.period),
            (0x0F, modes >> 24, coefficient),
            (0x1C, modes & 0xFF, 0),
        ):
            if present != wanted:  # an EEPROM bears only so many writes
                self.command(index, wanted)

    @contextmanager
    def torque_kept(self) -> Iterator[None]:
        """Put the torque limit back at the end: what is asked next may have to move the axis."""
        own = self.data_bytes(0x26)[1]
        yield
        self.command(0x0C, own)

    def come_home(self) -> int:
        """Go back to where the run found the axis if it has come far; give the position."""
        position, home = self.position(), self.home
        if home is None or abs(position - home) <= self.room() // 4 or not self.can_move:
            return position
        if self.session.run.runaway:
            raise TargetError(self.session.run.runaway)
        end = self.go(home).end
        assert end is not None
        return wait_for_it(self, position, home, end.latest_ns)

    @property
    def home(self) -> int | None:
        """Where the run found the axis; None while nobody has looked."""
        memory = self.session.run.memory
        if memory is not None and self.address in memory.neighbours:
            memory = memory.neighbours[self.address]
        return None if memory is None else memory.position

    def at_rest(self) -> None:
        """End motion and synchronous mode, whatever the device's reading of either."""
        reply = self.command(0x18)
        if self.known("abort_flush"):
            self.command(0x1A)  # what 18h leaves in the FIFO and preloaded, goes with the power
        if reply.kind is Kind.REFUSED or self.known("preload_policy"):
            # A preloaded motion survives 18h on this device: let it start, and stop it.
            self.command(0x11)
            self.command(0x18)

    def disarm(self) -> None:
        """Spend a 10h that no motion has followed: stops may leave it (MACS-AMB-36)."""
        self.at_rest()
        self.command(0x13, self.position())
        self.command(0x11)
        self.at_rest()

    def room(self) -> int:
        """Increments a check may use up in one direction: half of the envelope, and never so many
        that ways take hours and end where the counter does."""
        return min(self.session.envelope.max_travel // 2, MOST_ROOM)

    def fits(self, *targets: int) -> bool:
        """True if these counters lie in the envelope, or nobody enforces one."""
        home, envelope = self.home or 0, self.session.envelope
        inside = all(abs(target - home) <= envelope.max_travel for target in targets)
        return inside or not envelope.is_guarded

    def gentle(self, period: int, seconds: float) -> int:
        """The period, or a slower one with which the axis stays inside for so long."""
        if not self.session.envelope.is_guarded:
            return max(period, self.fastest)
        self.needs_speed(SLOWEST)
        gentle = round(seconds * TICKS_PER_SECOND / max(1, self.room())) + 1
        if gentle > SLOWEST:
            travel = 2 * (round(seconds * TICKS_PER_SECOND / (SLOWEST - 1)) + 1)
            self.needs_travel(travel, f"the slowest endless motion, for {seconds:.1f} s")
        return min(SLOWEST, max(period, self.fastest, gentle))

    def go(self, target: int) -> Forecast:
        """Send 13h to a target in the envelope; it must be accepted.  Give what to expect."""
        origin = self.position()
        home = origin if self.home is None else self.home
        limit = self.session.envelope.max_travel
        far = abs(target - home)
        if far > max(limit, abs(origin - home)):
            raise OutsideEnvelope(f"{target} is outside", "--max-travel", far)
        exchange = self.accepted(0x13, target)
        return self.to_position(exchange, origin, target)

    def go_plainly(self, target: int) -> Forecast:
        """Go back to a place with the settings of `ready`."""
        self.ready(self.period)
        return self.go(target)

    def to_position(
        self, exchange: Exchange, origin: int, target: int, law: Law | None = None
    ) -> Forecast:
        """What to expect of a 13h, 14h or 11h taken over in that exchange."""
        distance, direction = abs(target - origin), (target > origin) - (target < origin)
        return Forecast.started(
            exchange.taken,
            origin,
            direction,
            lambda law: Course.to_position(distance, self.period, self.coefficient, law),
            law or self.law,
        )

    def to_velocity(
        self,
        exchange: Exchange,
        origin: int,
        direction: int,
        period: int,
        law: Law | None = None,
    ) -> Forecast:
        """What to expect of a 15h from rest taken over in that exchange."""
        direction = self.heading(direction)
        return Forecast.started(
            exchange.taken,
            origin,
            direction,
            lambda law: Course.endless(period, self.coefficient, law),
            law or self.law,
            mode="VE",
        )

    def heading(self, direction: int) -> int:
        """The way this device turns when asked for a direction (MACS-AMB-07)."""
        return 1 if self.known("vel_f6_direction") == 1 else direction

    def turn(self, direction: int, period: int) -> Forecast:
        """Send 15h from rest; it must be accepted."""
        origin = self.position()
        exchange = self.accepted(0x15, velocity(direction, period))
        return self.to_velocity(exchange, origin, direction, period)

    def feed(self, origin: int, *row: Segment) -> Forecast:
        """Send a row of segments from rest, each of which must be accepted; what to expect."""
        first = self.put(row[0])
        for number, one in enumerate(row[1:], 1):
            self.unbroken(first, row[:number], self.put(one))
        return self.to_segments(first, origin, *row)

    def put(self, one: Segment) -> Exchange:
        """Send a segment, real or virtual, that must be accepted."""
        return self.accepted(0x16 if one.moves else 0x1E, segment(one.steps, one.period))

    def unbroken(self, first: Exchange, before: Sequence[Segment], exchange: Exchange) -> None:
        """Give the attempt up if the row begun in `first` may have run out before the module took
        over one more: then the axis has halted in between, rightly, nobody knows for how long."""
        runs_out_ns = first.taken.earliest_ns + sum(one.duration_ns for one in before)
        self.taken_in_time(exchange, runs_out_ns, "a segment came after the row before it")

    def taken_in_time(self, exchange: Exchange, limit_ns: int, what: str) -> None:
        """Give the attempt up if the module may not have taken that over before something ended:
        what it does then, it does rightly, and it tells nothing."""
        if exchange.taken.latest_ns > limit_ns:
            slowest = f"an exchange takes up to {self.target.uncertainty_ns / 1e6:.0f} ms here"
            self.session.void_attempt(f"{what} may have ended: {slowest}, or longer")

    def unhurried(self, period: int, slowest: int = SLOWEST) -> int:
        """The period, or one that is as much slower as exchanges take longer here than on a plain
        line: what is seen of a motion is then as sharp."""
        if self.target.is_virtual:
            return period
        return min(slowest, max(period, period * self.target.uncertainty_ns // PLAIN_EXCHANGE_NS))

    def outlasting(self, steps: int, period: int, exchanges: int = 3) -> int:
        """The period, or a slower one with which so many steps outlast so many exchanges here."""
        least_ns = exchanges * self.target.line_ns
        return min(SLOWEST, max(self.slowed(period), -(-least_ns // (steps * TICK_NS))))

    def to_segments(self, exchange: Exchange, origin: int, *segments: Segment) -> Forecast:
        """What to expect of segments of which the first was taken over at rest."""
        return Forecast.of(
            Timeline("IN", origin, edge, segments=segments, leads=self.law.step == "start")
            for edge in exchange.taken.edges
        )

    def allowance(self, period: int) -> int:
        """Increments a real axis may trail or lead its set-point by; none in virtual time, where
        the built-in twin's plant is ideal."""
        if self.target.is_virtual and self.has_ideal_plant:
            return 0
        return 2 + TICKS_PER_SECOND // max(1, period) // 200  # 5 ms of motion

    @property
    def has_ideal_plant(self) -> bool:
        """True if the axis is always where its set-point is, as far as is known."""
        return not self.known("plant")

    def braking(self, period: int) -> int:
        """Increments a real axis may need to stop without ramp; none in virtual time, where the
        built-in twin's plant is ideal (§5.7)."""
        number = self.session.reading("brake_increments")
        if number.isdigit():
            return int(number)
        if self.target.is_virtual and self.has_ideal_plant:
            return 0
        speed = TICKS_PER_SECOND // max(1, period)
        return 2 + speed * speed // (2 * GENTLE_BRAKING)

    def follow(self, forecast: Forecast, requirement: Part = None, allowance: int = 0) -> Sample:
        """Judge one counter reading against what is expected."""
        sample = self.sample()
        lowest, highest = forecast.bounds(self._widened(sample.taken, forecast))
        self.plot(forecast, sample, allowance)
        self._judge(
            lowest - allowance <= sample.position <= highest + allowance,
            requirement,
            f"position {lowest}..{highest}",
            f"position {sample.position}",
        )
        return sample

    def _widened(self, window: Window, forecast: Forecast) -> Window:
        """On a real module's own quartz, time runs a little differently than on ours."""
        if self.target.is_virtual:
            return window
        start_ns = min(timeline.start_ns for timeline in forecast.timelines)
        error_ns = round(max(0, window.latest_ns - start_ns) * CLOCK_ERROR)
        return Window(window.earliest_ns - error_ns, window.latest_ns + error_ns)

    def plot(self, forecast: Forecast, sample: Sample, allowance: int) -> None:
        """Keep a reading for the report, with the band it was judged by since the one before."""
        if not self.is_plotting:
            return
        first = min(forecast.timelines, key=lambda timeline: timeline.start_ns)
        start_ns, taken = first.start_ns, sample.taken
        middle_ns = (taken.earliest_ns + taken.latest_ns) // 2
        margin_ns = taken.latest_ns - middle_ns
        is_new = self._plotted is None or self._plotted[0] != start_ns
        if self._plotted is None or is_new:
            number = self.session.motions.count + 1
            self._plotted = start_ns, f"{MOTION_NAMES[first.mode]} {number}", start_ns
        _, name, since_ns = self._plotted
        self._plotted = start_ns, name, middle_ns
        count = min(PLOT_POINTS, 1 + max(0, middle_ns - since_ns) // PLOT_SPACING_NS)
        band = []
        for point in range(0 if is_new else 1, count + 1):
            now_ns = since_ns + (middle_ns - since_ns) * point // count
            window = Window(now_ns - margin_ns, now_ns + margin_ns)
            lowest, highest = forecast.bounds(self._widened(window, forecast))
            band.append((now_ns, lowest - allowance, highest + allowance))
        self.session.motions.sample(name, [(middle_ns, sample.position)], band)

    def watch(self, forecast: Forecast, requirement: Part = None, samples: int = 6) -> int:
        """Judge the whole motion: some places on its way, and its end.  Give the final place."""
        end = forecast.end
        assert end is not None, "an endless motion is not waited for"
        begin_ns = self.target.now_ns
        allowance = self.allowance(self.period)
        for number in range(1, samples + 1):
            self.wait_until(begin_ns + (end.earliest_ns - begin_ns) * number // (samples + 1))
            self.follow(forecast, requirement, allowance)
        # The last increments are the slowest: just before the end, one too many or too few shows.
        last_ns = end.earliest_ns - self.glance_ns
        if last_ns > self.target.now_ns:
            self.wait_until(last_ns)
            self.follow(forecast, requirement, allowance)
        return self.finish(forecast, requirement)

    def finish(self, forecast: Forecast, requirement: Part = None, braking: int = 0) -> int:
        """Wait for the end of a motion; judge where the axis then stands, at most so many
        increments above where it was stopped."""
        end = forecast.end
        assert end is not None, "an endless motion is not waited for"
        settle_ns = 0 if self.target.is_virtual else 100_000_000
        self.wait_until(end.latest_ns + settle_ns)
        lowest, highest = forecast.final
        highest += braking
        sample = self.sample()
        self.plot(forecast, sample, 0)
        self._judge(
            lowest <= sample.position <= highest,
            requirement,
            f"at rest at {lowest}" if lowest == highest else f"at rest in {lowest}..{highest}",
            f"position {sample.position}",
        )
        return sample.position


def velocity(direction: int, period: int) -> int:
    """The parameter of 15h: SS = F6h turns counter-clockwise, 00h clockwise (MACS-CMD-15-01)."""
    return (0xF60000 if direction < 0 else 0) | period


def segment(steps: int, period: int) -> int:
    """The parameter of 16h and 1Eh: DDDD and VVVV."""
    return (steps & 0xFFFF) << 16 | period


def bench_of(session: Session, address: int | None = None) -> Bench:
    """A module of the family under test, this one or that at an address, as its face handles it."""
    bench = session.run.family.driver(session, address)
    assert isinstance(bench, Bench)
    return bench
