"""Settings, motions and their forecasts, waiting for rest.

Built on `client.py`, which says for each exchange when the module can have taken it over.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Final

from axistwin_conformance.base.errors import OutsideEnvelope, counted
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mac.axis.driver.client import (
    QUIET_S,
    AxisClient,
    AxisExchange,
    Part,
    Sample,
    hold,
    judge_deaf,
)
from axistwin_conformance.families.mac.axis.driver.judge import AxisJudge
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST, AxisLimits
from axistwin_conformance.families.mac.axis.driver.readings import AxisReadings
from axistwin_conformance.families.mac.axis.driver.undone import Begun, undone
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind, signed
from axistwin_conformance.families.mac.axis.model.forecast import (
    Forecast,
    Segment,
    Timeline,
    TimeWindow,
)
from axistwin_conformance.families.mac.axis.model.kinematics import (
    TICKS_PER_SECOND,
    Course,
    EvenRun,
    Law,
    Profile,
    ramp_increments,
)
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS, values_of
from axistwin_conformance.families.mac.axis.return_to_start import STILL_S, comes_back
from axistwin_conformance.families.mac.axis.shaft import SLOWEST_LEVEL_TICKS
from axistwin_conformance.families.mac.axis.travel_guard import AxisTravelGuard
from axistwin_conformance.families.mac.axis.words import pace_words

DEAF_S: Final = 2.0  # MACS-CMD-00-02
FIFO_STAGES: Final = 3
PRELOAD_SHOWS_S: Final = 0.2
LITTLE_LONGER_S: Final = 0.4
STANDS_S: Final = 0.1  # between two readings of a position that tell that an axis stands
RAMP_TAKES: Final = 1  # times as long as its increments at full speed, beside these
CLOCK_ERROR: Final = 0.002  # a real module's quartz against ours; none in virtual time

PLOT_POINTS: Final = 12  # of the predicted band, at most, from one reading to the next
PLOT_SPACING_NS: Final = 5_000_000
COURSES: Final = {
    "PO": "move",
    "VE": "endless motion",
    "IN": "interpolated motion (a step is an increment)",
}
FARTHEST_RUN_ON: Final = 0xFFFF  # increments: the largest number there is (MACS-AMB-76)
MOTION_NAMES: Final = {"PO": "move", "VE": "endless motion", "IN": "segments", "HD": "halt"}

PLAIN: Final = (0x02, 0x03, 0x0D, 0x0F, 0x1C)  # the parameters that `AxisMotion.set_plain` sets
SAFE_PERIOD: Final = 0x0640  # 1600 ticks: 5000 inc/s, 150 rpm on a MAC23


class AxisMotion:
    """The settings and motions of one axis, and what to expect of them."""

    def __init__(
        self, client: AxisClient, judge: AxisJudge, readings: AxisReadings, limits: AxisLimits
    ) -> None:
        self._client, self._judge = client, judge
        self._readings, self._limits = readings, limits
        self._session = client.session
        client.precautions = self
        self.period = SAFE_PERIOD
        self.coefficient = 0
        self._begun: Begun | None = None
        self.is_plotting = True  # False: what moves is not what is judged
        self._plotted: tuple[int, str, int] | None = None  # start of a motion, its plot, how far

    # --- settings and motion ---------------------------------------------------------------------

    def fit(self, samples: Sequence[Sample], forecasts: Sequence[Forecast]) -> list[int]:
        """Which of several predictions, by number, all the samples agree with."""
        slack = self._limits.allowance(self.period)
        fitting = []
        for number, forecast in enumerate(forecasts):
            bounds = [forecast.bounds(self._widened(sample.taken, forecast)) for sample in samples]
            if all(
                lowest - slack <= sample.position <= highest + slack
                for sample, (lowest, highest) in zip(samples, bounds, strict=True)
            ):
                fitting.append(number)
        for sample in samples:
            self.plot(forecasts[fitting[0] if fitting else 0], sample, slack)
        return fitting

    def beyond(
        self, samples: Sequence[Sample], behind: Forecast, ahead: Forecast, allowance: int = 0
    ) -> str:
        """Which sample is not between two predictions, in words; empty if all are."""
        slack = self._limits.allowance(self.period) + allowance
        for sample in samples:
            lowest = behind.bounds(self._widened(sample.taken, behind))[0] - slack
            highest = ahead.bounds(self._widened(sample.taken, ahead))[1] + slack
            if not lowest <= sample.position <= highest:
                return f"position {sample.position}, not within {lowest}..{highest}"
        return ""

    def sampled(self, seconds: float, count: int) -> list[Sample]:
        """Read the counter `count` times over the next `seconds`."""
        begin_ns = self._client.target.now_ns
        samples = []
        for number in range(count):
            self._client.wait_until(begin_ns + round(seconds * 1e9) * number // count)
            samples.append(self._client.sample())
        return samples

    @property
    def deaf_s(self) -> float:
        """How long this module is deaf after a restart (MACS-AMB-21)."""
        return int(self._session.reading("boot_time_ms")) / 1000

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
        self._client.wait(self.awake_surely_s)

    def reinitialise(self) -> AxisExchange:
        """Send 00h and wait until the module surely listens again; where the line may have lost it,
        from a module that acknowledges it, the attempt is void."""
        exchange, session = self._client.within(QUIET_S, 0x00), self._session
        is_heard = exchange.kind is not ReplyKind.SILENCE or session.transport.is_lossless
        if not is_heard and session.readings.get("reset_reply") == "ack" and session.check:
            session.void_attempt("00h may have been lost: there was no reply")
        if exchange.kind is ReplyKind.ACCEPTED:
            judge_deaf(self._client, exchange.taken.earliest_ns, self.deaf_surely_s)
        self._client.wait_until(exchange.taken.latest_ns + round(self.awake_surely_s * 1e9))
        return exchange

    def before(self, index: int) -> None:
        """Before the counter is cleared the place is read, where the envelope counts: how far the
        axis may have come since it was read last is lost to it for ever."""
        if index == 0x0B and self._session.envelope.is_guarded:
            self._client.ask(0x20)
        if index in (0x13, 0x14):
            self._limits.needs_speed(SLOWEST)

    def after(self, index: int, kind: ReplyKind) -> None:
        """See `run_out`."""
        if index == 0x18 and kind is ReplyKind.ACCEPTED:
            guard = self.travel_guard
            if guard is None or not guard.is_still(self._client.address):
                self.run_out()

    @property
    def travel_guard(self) -> AxisTravelGuard | None:
        """Who watches how far the axis goes, if anybody does."""
        guard = self._client.target.travel_guard
        return guard if isinstance(guard, AxisTravelGuard) else None

    def run_out(self, slowest_ticks: int | None = None) -> None:
        """Wait until an axis stands still that runs on after 18h and stops, locked as in motion;
        `slowest_ticks`: what an increment takes at most when it begins to, if that is known better
        than by what was sent.

        It runs on over the N increments it was seen to (MACS-INT-03), slowing down evenly, so that
        the last one takes 2√N times as long as one before, and all of them √N times that.  While N
        is not known it is followed as far as any runs on, by how far it has come so far.
        """
        number = self._limits.brake_increments
        farthest = 0
        if number.isdigit():
            increments = int(number)
        elif self._limits.has_ideal_plant:
            increments = int(self._limits.may_run_on)
            farthest = increments * FARTHEST_RUN_ON
        else:
            increments = self._limits.braking(self.period)
        if not increments:
            return
        guard = self.travel_guard
        if slowest_ticks is None:
            slowest_ticks = (
                SLOWEST_LEVEL_TICKS if guard is None else guard.slowest_ticks(self._client.address)
            )
        place = begin = self._client.ask(0x20).reply.data
        # Waits that grow with √ of the way made so far are π/2·√N in all.
        for _ in range(2 * math.isqrt(max(increments, farthest)) + 2):
            if place is None or begin is None:  # who is silent is not waited for
                return
            made = min(abs(signed(place - begin & 0xFFFF_FFFF)), farthest)
            last = 2 * math.sqrt(max(increments, made)) + 1
            self._client.wait(last * slowest_ticks / TICKS_PER_SECOND)
            before, place = place, self._client.ask(0x20).reply.data
            if place == before:
                if guard is not None:
                    guard.seen_still(self._client.address)
                return

    def lasting_s(self, increments: int, period: int | None = None) -> float:
        """The time that so many increments take, at the speed of `ready` or another."""
        return increments * (self.period if period is None else period) / TICKS_PER_SECOND

    def ready(self, period: int = SAFE_PERIOD, coefficient: int = 0) -> int:
        """Bring the module to rest with plain settings; give its position.

        No sync, no stops, nominal torque (an axis in standby may swing by one increment, so exact
        places could not be judged), tolerance 0, the given period and ramp.
        """
        self.set_plain(period, coefficient)
        return self.come_home()

    def ready_for_segments(self, coefficient: int = 0) -> int:
        """The same where nothing moves at the period that is set: a slower one stays, unless it is
        a long way home."""
        self.set_plain(coefficient=coefficient, keeps_period=True)
        position = self._client.position()
        return self.ready(coefficient=coefficient) if self._is_far(position) else position

    def set_plain(
        self,
        period: int = SAFE_PERIOD,
        coefficient: int = 0,
        *,
        distance: int | None = None,
        keeps_period: bool = False,
    ) -> None:
        """The same, wherever the axis then stands.  `distance`: the way it then goes; a period and
        a ramp stay with which that takes little longer.  `keeps_period`: one that is slower stays.
        """
        self.at_rest()
        present = values_of({query: self._client.value(query) for query in (0x25, 0x26)})
        if distance is not None and self._is_fit(present, distance, period):
            period, coefficient = present[0x0D], present[0x0F]
        if keeps_period:
            period = max(period, present[0x0D])
        can_move = self._limits.can_move
        self.period = max(period, self._limits.fastest) if can_move else present[0x0D]
        self.coefficient = coefficient
        plain = {0x0D: self.period, 0x0F: coefficient}
        for index in PLAIN:
            wanted = plain.get(index, 0)
            if present[index] != wanted:  # an EEPROM bears only so many writes
                self._client.command(index, wanted)

    def _is_fit(self, present: Mapping[int, int], distance: int, period: int) -> bool:
        """Whether the settings present are no faster than that period, and slower by little."""
        ramps = min(distance, 2 * ramp_increments(present[0x0F]))
        lasting_s = self.lasting_s(distance + RAMP_TAKES * ramps, present[0x0D])
        is_slower = present[0x0D] >= max(period, self._limits.fastest)
        return is_slower and lasting_s <= self.lasting_s(distance, period) + LITTLE_LONGER_S

    def keep_off(self, index: int, place: int) -> None:
        """Have the software stop of 09h or 0Ah no nearer than that place; one that is further out
        stays."""
        stop, outward = PARAMETERS[index], 1 if index == 0x09 else -1
        if (stop.taken(self._client.parameter(index)) - place) * outward < 0:
            self._judge.accepted(index, place)

    @contextmanager
    def torque_kept(self) -> Iterator[None]:
        """Put the torque limit back at the end: what is asked next may have to move the axis."""
        own = self._client.parameter(0x0C)
        yield
        self._client.command(0x0C, own)

    def come_home(self) -> int:
        """Go back to where the run found the axis if it has come far; give the position."""
        position, home = self._client.position(), self._limits.home
        if home is None or not self._is_far(position):
            return position
        end = self.go(home).end
        assert end is not None
        if self._session.envelope.is_guarded:
            late_ns = round(STILL_S * 1e9)
            comes_back(self._client, home, self.lasting_s, end.latest_ns + late_ns)
        else:
            self._client.wait_until(end.latest_ns)
        self._client.command(0x18)
        return self._client.position()

    def _is_far(self, position: int) -> bool:
        home = self._limits.home
        is_near = home is None or abs(position - home) <= self._limits.room() // 4
        return self._limits.can_move and not is_near

    def at_rest(self) -> None:
        """End motion and synchronous mode, whatever the device's reading of either."""
        self._rest(is_armed=False)

    def disarm(self) -> None:
        """The same where nobody knows whether stops leave what 10h has begun (MACS-AMB-36)."""
        self._rest(is_armed=True)

    def _rest(self, *, is_armed: bool) -> None:
        """`is_armed`: what 10h has begun, with a motion or without, is ended for certain."""
        if self._session.run.runaway:
            hold(self._client)
            return
        reply = self._client.command(0x18)
        if self._readings.known("abort_flush"):
            self._client.command(
                0x1A
            )  # what 18h leaves in the FIFO and preloaded, goes with the power
        if self._readings.known("preload_policy") and not self.is_disarmed:  # stops may leave it
            if self._readings.may_be("sync_arm_lifetime", "permanent"):
                self.reinitialise()  # nothing else disarms it
                return
            is_armed = True
        if is_armed:  # what holds no motion yet is spent on one of no way
            self._client.command(0x13, self._client.position())
        if is_armed or reply.kind is ReplyKind.REFUSED:
            self._client.command(0x11)
            self._client.command(0x18)

    @property
    def is_disarmed(self) -> bool:
        """True if the travel guard has followed the axis, and nothing 10h has begun is left."""
        guard = self.travel_guard
        axis = None if guard is None else guard.axes.get(self._client.address)
        return axis is not None and axis.is_armed is False

    def go(self, target: int) -> Forecast:
        """Send 13h to a target in the envelope; it must be accepted.  Give what to expect."""
        origin = self._client.position()
        home = origin if self._limits.home is None else self._limits.home
        limit = self._session.envelope.max_travel
        far = abs(target - home)
        if far > max(limit, abs(origin - home)):
            raise OutsideEnvelope(f"{target} is outside", "--max-travel", far)
        exchange = self._judge.accepted(0x13, target)
        forecast = self.to_position(exchange, origin, target)
        self._begun = Begun(forecast, 0x13, target)
        return forecast

    def go_plainly(self, target: int) -> Forecast:
        """Go back to a place with the settings of `ready`."""
        self.ready(self.period)
        return self.go(target)

    def to_position(
        self, exchange: AxisExchange, origin: int, target: int, law: Law | None = None
    ) -> Forecast:
        """What to expect of a 13h, 14h or 11h taken over in that exchange."""
        distance, direction = abs(target - origin), (target > origin) - (target < origin)
        return Forecast.started(
            exchange.taken,
            origin,
            direction,
            lambda law: Course.to_position(distance, self.period, self.coefficient, law),
            law or self._readings.law_of(self.coefficient),
        )

    def to_velocity(
        self,
        exchange: AxisExchange,
        origin: int,
        direction: int,
        period: int,
        law: Law | None = None,
    ) -> Forecast:
        """What to expect of a 15h from rest taken over in that exchange."""
        direction = self._heading(direction)
        return Forecast.started(
            exchange.taken,
            origin,
            direction,
            lambda law: Course.endless(period, self.coefficient, law),
            law or self._readings.law_of(self.coefficient, is_changed=True),
            mode="VE",
        )

    def _heading(self, direction: int) -> int:
        """The way this device turns when asked for a direction (MACS-AMB-07)."""
        return 1 if self._readings.known("vel_f6_direction") == 1 else direction

    def turn(self, direction: int, period: int) -> Forecast:
        """Send 15h from rest; it must be accepted."""
        origin = self._client.position()
        parameter = velocity(direction, period)
        exchange = self._judge.accepted(0x15, parameter)
        forecast = self.to_velocity(exchange, origin, direction, period)
        self._begun = Begun(forecast, 0x15, parameter)
        return forecast

    def feed(self, origin: int, *row: Segment) -> Forecast:
        """Send a row of segments from rest, each of which must be accepted; what to expect."""
        first = self.put(row[0])
        for number, segment in enumerate(row[1:], 1):
            self.unbroken(first, row[:number], self.put(segment))
        return self.to_segments(first, origin, *row)

    def put(self, segment: Segment) -> AxisExchange:
        """Send a segment, real or virtual, that must be accepted."""
        return self._judge.accepted(
            0x16 if segment.moves else 0x1E, segment_parameter(segment.steps, segment.period)
        )

    def unbroken(
        self, first: AxisExchange, before: Sequence[Segment], exchange: AxisExchange
    ) -> None:
        """Give the attempt up if the row begun in `first` may have run out before the module took
        over one more: then the axis has halted in between, rightly, nobody knows for how long."""
        runs_out_ns = first.taken.earliest_ns + sum(segment.duration_ns for segment in before)
        self.taken_in_time(exchange, runs_out_ns, "a segment came after the row before it")

    def taken_in_time(self, exchange: AxisExchange, limit_ns: int, what: str) -> None:
        """Give the attempt up if the module may not have taken that over before something ended:
        what it does then, it does rightly, and it tells nothing."""
        if exchange.taken.latest_ns > limit_ns:
            slowest = (
                f"an exchange takes up to {self._client.target.uncertainty_ns / 1e6:.0f} ms here"
            )
            self._session.void_attempt(f"{what} may have ended: {slowest}, or longer")

    def to_segments(self, exchange: AxisExchange, origin: int, *segments: Segment) -> Forecast:
        """What to expect of segments of which the first was taken over at rest."""
        return Forecast.of(
            Timeline(
                "IN",
                origin,
                edge,
                segments=segments,
                leads=leads,
            )
            for edge in exchange.taken.edges
            for leads in self._readings.law_of(0).leads
        )

    def follow(self, forecast: Forecast, requirement: Part = None, allowance: int = 0) -> Sample:
        """Judge one counter reading against what is expected."""
        sample = self._client.sample()
        lowest, highest = forecast.bounds(self._widened(sample.taken, forecast))
        self.plot(forecast, sample, allowance)
        self._judge.holds(
            lowest - allowance <= sample.position <= highest + allowance,
            requirement,
            f"position {lowest}..{highest}",
            lambda: self._seen(sample, forecast, self._wanted(forecast, lowest, highest)),
        )
        return sample

    def _wanted(self, forecast: Forecast, lowest: int, highest: int) -> str:
        """A band of places, and from what it was predicted."""
        place = f"{lowest} to {highest} increments" if lowest < highest else f"{lowest} increments"
        return f"{place} by then, {self._course(forecast, 'on')}"

    def _course(self, forecast: Forecast, when: str) -> str:
        """Which motion it is, where it began, and the settings that it runs by."""
        first = min(forecast.timelines, key=lambda timeline: timeline.start_ns)
        way = f"{when} the {COURSES.get(first.mode, 'motion')} from position {first.origin}"
        if forecast.timelines[0].mode not in ("PO", "VE"):
            return way
        return f"{way} {self.settings_words()}"

    def settings_words(self) -> str:
        """The speed and the ramp of a move, in words."""
        unit = counted(ramp_increments(1), "increment")
        ramp = f"{unit} of ramp for each unit" if self.coefficient else "no ramp"
        return (
            f"at {pace_words(self._client.named(0x0D), self.period)}"
            f" and {self._client.named(0x0F)} = {self.coefficient} ({ramp})"
        )

    def _widened(self, window: TimeWindow, forecast: Forecast) -> TimeWindow:
        """On a real module's own quartz, time runs a little differently than on ours."""
        if self._client.target.is_virtual:
            return window
        start_ns = min(timeline.start_ns for timeline in forecast.timelines)
        error_ns = round(max(0, window.latest_ns - start_ns) * CLOCK_ERROR)
        return TimeWindow(window.earliest_ns - error_ns, window.latest_ns + error_ns)

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
            number = self._session.motions.count + 1
            self._plotted = start_ns, f"{MOTION_NAMES[first.mode]} {number}", start_ns
        _, name, since_ns = self._plotted
        self._plotted = start_ns, name, middle_ns
        count = min(PLOT_POINTS, 1 + max(0, middle_ns - since_ns) // PLOT_SPACING_NS)
        band = []
        for point in range(0 if is_new else 1, count + 1):
            now_ns = since_ns + (middle_ns - since_ns) * point // count
            window = TimeWindow(now_ns - margin_ns, now_ns + margin_ns)
            lowest, highest = forecast.bounds(self._widened(window, forecast))
            band.append((now_ns, lowest - allowance, highest + allowance))
        self._session.motions.sample(name, [(middle_ns, sample.position)], band)

    def watch(self, forecast: Forecast, requirement: Part = None, samples: int = 6) -> int:
        """Judge the whole motion: some places on its way, and its end.  Give the final place."""
        end = forecast.end
        assert end is not None, "an endless motion is not waited for"
        begin_ns = self._client.target.now_ns
        allowance = self._limits.allowance(self.period)
        for number in range(1, samples + 1):
            self._client.wait_until(
                begin_ns + (end.earliest_ns - begin_ns) * number // (samples + 1)
            )
            self.follow(forecast, requirement, allowance)
        # The last increments are the slowest: just before the end, one too many or too few shows.
        last_ns = end.earliest_ns - self._client.glance_ns
        if last_ns > self._client.target.now_ns:
            self._client.wait_until(last_ns)
            self.follow(forecast, requirement, allowance)
        return self.finish(forecast, requirement)

    def finish(self, forecast: Forecast, requirement: Part = None, braking: int = 0) -> int:
        """Wait for the end of a motion; judge where the axis then stands, at most so many
        increments above where it was stopped."""
        end = forecast.end
        assert end is not None, "an endless motion is not waited for"
        swinging_ns = 0 if self._client.target.is_virtual else 100_000_000
        self._client.wait_until(end.latest_ns + swinging_ns)
        lowest, highest = forecast.final
        highest += braking
        sample = self._client.sample()
        self.plot(forecast, sample, 0)
        self._judge.holds(
            lowest <= sample.position <= highest,
            requirement,
            f"at rest at {lowest}" if lowest == highest else f"at rest in {lowest}..{highest}",
            lambda: self._ended(
                sample,
                forecast,
                f"{lowest}..{highest} increments {self._course(forecast, 'at the end of')}",
            ),
        )
        return sample.position

    def _seen(self, sample: Sample, forecast: Forecast, wanted: str) -> Observation:
        """Where the axis was, in words."""
        text = f"{REQUEST} read {counted(sample.position, 'increment')}"
        if sample.position == forecast.timelines[0].origin:
            text += undone(self._client, self._begun, forecast)
        return Observation(text, f"position {sample.position}", wanted, is_whole=False)

    def _ended(self, sample: Sample, forecast: Forecast, wanted: str) -> Observation:
        """Where the axis was when its motion was to be over, and whether it stood there, in words:
        a motion that is late is told from one that ends elsewhere."""
        self._client.wait(STANDS_S)
        stood = self._client.position()
        before = f"as {STANDS_S * 1000:.0f} ms before"
        if stood != sample.position:
            before = f"{STANDS_S * 1000:.0f} ms before that {sample.position}, still moving"
        text = f"{REQUEST} read {counted(stood, 'increment')} ({before})"
        text += undone(self._client, self._begun, forecast)
        return Observation(text, f"position {sample.position}", wanted, is_whole=False)


def as_velocity(motion: AxisMotion, exchange: AxisExchange, origin: int, period: int) -> Forecast:
    """What to expect of an upward segment taken over at rest, where a 15h will take its speed over
    before it ends."""
    return Forecast.started(
        exchange.taken,
        origin,
        1,
        lambda law: Course(Profile((EvenRun(None, period),)), period, motion.coefficient, law),
        motion._readings.law_of(motion.coefficient, is_changed=True),
        mode="VE",
    )


def velocity(direction: int, period: int) -> int:
    """The parameter of 15h: SS = F6h turns counter-clockwise, 00h clockwise (MACS-CMD-15-01)."""
    return (0xF60000 if direction < 0 else 0) | period


def segment_parameter(steps: int, period: int) -> int:
    """The parameter of 16h and 1Eh: DDDD and VVVV."""
    return (steps & 0xFFFF) << 16 | period
