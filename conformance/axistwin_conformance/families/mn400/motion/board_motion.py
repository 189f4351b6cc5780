"""Motion of one board: settings that are known, commands that the model follows, and readings of E
judged by it.

    ready()    at rest, home, all settings said anew; the counters are loaded with 0
    do(text)   send it, judge START and DONE, let the model take it over
    follow()   read E until all motion must be over, and judge each reading and the end

Times.  A command is taken over between the end of its request and the end of its reply; a counter
is read between the end of its request and the begin of its data packet.  In virtual time the board
may take no longer; of a real one motion may begin `LAG_S` later, and its clock may differ from ours
by `CLOCK_ERROR` (ledger 9.3).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import partial
from itertools import pairwise
from typing import Final

from axistwin_conformance.base.errors import OutsideEnvelope
from axistwin_conformance.core.session import Requirements
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mn400 import codec, words
from axistwin_conformance.families.mn400.client import BoardExchange
from axistwin_conformance.families.mn400.driver import AXES, DATA, DONE, BoardDriver
from axistwin_conformance.families.mn400.model.board import BoardModel
from axistwin_conformance.families.mn400.model.motions import (
    ENDLESS,
    CircleMotion,
    CompensatedMotion,
    Place,
    PlannedMotion,
    RestOfMotion,
    Span,
)
from axistwin_conformance.families.mn400.model.settings import BoardSettings
from axistwin_conformance.families.mn400.motion.return_to_start import (
    return_to_start,
    turn_hold_off,
    wait_for_rest,
)
from axistwin_conformance.families.mn400.planner.vector import Window

MOTION: Final = ("motion",)
RIG_MOTION: Final = ("motion", "rig")
LAG_S: Final = Fraction(25, 1000)  # from an answer to the first step of what it was about
CLOCK_ERROR: Final = Fraction(1, 100)
NS: Final = 10**9
LATE_SHARE: Final = Fraction(1, 4)  # of a motion's time, for which one that is not over is waited
LATE_S: Final = Fraction(1, 5)
PROFILE: Final = (1000, 5000, 10_000)  # start, end, acceleration: those of power-on
SPEED: Final = 2000


class BoardMotion:
    """The motions of one board; `model`: what must come of it, since `ready`."""

    def __init__(self, driver: BoardDriver) -> None:
        self.driver, self.session = driver, driver.session
        self.target = driver.target
        self.model = BoardModel(driver.reading)
        self._mode = ""  # the I that was judged since `ready`
        self._asked: list[tuple[PlannedMotion, BoardSettings]] = []  # since then, and by what

    # --- settings ---------------------------------------------------------------------------------

    @property
    def room(self) -> int:
        """How many steps an axis may go either way from its start."""
        return self.session.envelope.max_travel

    def within(self, steps: int) -> int:
        """So many steps, or as many as there is room for."""
        return min(steps, self.room)

    def needs_room(self, steps: int, what: str) -> None:
        """Leave the check out where an axis may not go so far."""
        if steps > self.room:
            raise OutsideEnvelope(f"{what} take {steps} steps", "--max-travel", steps)

    def fast(self, speed: int) -> int:
        """That speed, or the greatest allowed."""
        return min(speed, self.session.envelope.max_speed)

    def needs_speed(self, speed: int, what: str) -> None:
        """Leave the check out where an axis may not go so fast."""
        if speed > self.session.envelope.max_speed:
            raise OutsideEnvelope(f"{what} run at {speed} steps/s", "--max-speed", speed)

    def mode(self, *, is_absolute: bool) -> str:
        """The I that selects a coordinate mode on this board (MN4-AMB-09)."""
        absolute = int(self.driver.reading("abs_mode_value"))
        return f"I{absolute if is_absolute else 1 - absolute}"

    def plane(self, *motors: int) -> str:
        """The P of these motors, which are numbered from 1 here (MN4-AMB-11)."""
        shift = 1 - int(self.driver.reading("plane_base"))
        return "P" + ",".join(str(motor - shift) for motor in motors)

    def ready(self, *texts: str, speed: int = SPEED, profile: Sequence[int] = PROFILE) -> None:
        """Bring the board to rest at home, with relative coordinates, counters of 0 and settings as
        at power-on, but for what is given; `texts` are sent behind that.

        Nothing rests on what a board does without being told: every setting is said.
        """
        return_to_start(self.session, self.driver)
        self.model, self._mode = BoardModel(self.driver.reading), ""
        self._asked.clear()
        start, end, acceleration = profile
        speed, start, end = (self.fast(one) for one in (speed, start, end))
        hold = ["H0"] if self.driver.reading("hold_takes_arg") == "true" else []
        for text in (
            *hold, f"F{start},{end},{acceleration}", f"V{speed}", "X1", "B0,0,0,0", "D1,1,1,1",
            "Y1000", self.plane(1, 3, 2), self.mode(is_absolute=False), "L0,0,0,0",
        ):  # fmt: skip
            self.set(text)
        if not hold:
            turn_hold_off(self.driver)
        for text in texts:
            self.set(text)

    def set(self, text: str) -> BoardExchange:
        """Send a command that must work here, and go on."""
        exchange = self.driver.command(text)
        self.model.accept(text, self.span(exchange))
        return exchange

    # --- times ------------------------------------------------------------------------------------

    def span(self, exchange: BoardExchange) -> Span:
        """Between which times (s) a board has done what it was asked."""
        first, last, byte_ns = exchange.asked_ns, exchange.done_ns, self.target.byte_ns
        sizes = [len(exchange.request), *(len(packet.raw) for packet in exchange.found)]
        if last - first >= sum(sizes) * byte_ns:  # the bytes take their time here
            first += sizes[0] * byte_ns
            last -= sizes[-1] * byte_ns if exchange.value is not None else 0
        return Fraction(first, NS), Fraction(last, NS)

    @property
    def now(self) -> Span:
        """The present, as a time in which something was done."""
        return (Fraction(self.target.now_ns, NS),) * 2

    def widened(self, now: Span, model: BoardModel | None = None) -> Span:
        """The same, wider by what a real board's clock may be off since motion began; `model`: of
        what was told to the board elsewhere."""
        if self.target.is_virtual:
            return now
        began = (model or self.model).timeline.began
        off = max(Fraction(0), now[1] - began) * CLOCK_ERROR
        return now[0] - LAG_S - off, now[1] + off

    def wait_until(self, seconds: Fraction) -> None:
        """Let time pass until then, on the target's clock."""
        left = float(seconds - Fraction(self.target.now_ns, NS))
        if left > 0:
            self.target.wait(left)

    # --- motion -----------------------------------------------------------------------------------

    def do(self, text: str, requirement: Requirements) -> BoardExchange:
        """Judge that a command is accepted, and take its effect over."""
        exchange = self.driver.draws(text, DONE, requirement)
        self.model.accept(text, self.span(exchange))
        self._mode = text if text.startswith("I") else self._mode
        rows = self.model.timeline.motions or self.model.timeline.held
        if rows and not any(rows[-1].motion is motion for motion, _ in self._asked):
            self._asked.append((rows[-1].motion, self.model.settings))
        return exchange

    @property
    def ends(self) -> Span:
        """The earliest and the latest time at which all motion is over."""
        ends = self.model.timeline.ends
        now = Fraction(self.target.now_ns, NS)
        return (now, now) if ends is None or ends[1] >= ENDLESS else ends

    @property
    def end(self) -> Place:
        """Where the axes are when all is over."""
        return self.model.timeline.end

    def read(self, text: str = "E") -> tuple[tuple[int, ...], Span]:
        """The counters, and between which times they were read."""
        exchange = self.driver.ask(text)
        self.session.step(exchange.says(*DATA), "START and a value to E", exchange.observed)
        fields = exchange.value.fields if exchange.value else None
        self.session.step(len(fields or ()) >= AXES, f"{AXES} counters", exchange.observed)
        return (fields or ()), self.span(exchange)

    def look(self, requirement: Requirements) -> tuple[int, ...]:
        """Judge that the axes are where they may be now; give the counters."""
        counters, now = self.read()
        place = self.model.where(self.widened(now))
        self._plot(counters, now, place)
        is_right = all(low <= one <= high for one, (low, high) in zip(counters, place, strict=True))
        self.session.expect(
            is_right, requirement, told(place), partial(self._seen, counters, place)
        )
        return counters

    def _seen(self, counters: Sequence[int], place: Place, when: str = "on") -> Observation:
        """Where the axes were, and on which motion, in words."""
        motions = self.model.timeline.motions
        settings = self._settings_of(motions[0].motion) if motions else self.model.settings
        start, end, acceleration = settings.profile
        coordinates = "absolute" if settings.is_absolute else "relative"
        multiplex = f" and X{settings.multiplex}" if settings.multiplex > 1 else ""
        mode = self.mode(is_absolute=settings.is_absolute)
        way = f", {when} the motion from {told(motions[0].base)} to" if motions else ", at rest at"
        return Observation(
            f"{REQUEST} read {', '.join(map(str, counters))}",
            value=str(counters),
            wanted=f"{told(place)}{way} {told(self.end)} in {coordinates} coordinates ({mode}"
            f" on this board), at {settings.speed} steps/s (V) and with"
            f" F{start},{end},{acceleration}{multiplex}; DONE says that it was taken, not that it"
            " is over",
            causes=(f"{self._mode} (",) if self._mode else (),
            is_whole=False,
        )

    def _settings_of(self, motion: PlannedMotion) -> BoardSettings:
        """Those with which a motion was asked for; what came later is for others."""
        while isinstance(motion, RestOfMotion):
            motion = motion.whole
        found = (settings for asked, settings in self._asked if asked is motion)
        return next(found, self.model.settings)

    def follow(
        self,
        path: Requirements,
        end: Requirements = None,
        time: Requirements = None,
        samples: int = 5,
    ) -> tuple[tuple[int, ...], ...]:
        """Read E until all motion must be over; give all counters read.

        `path`: judged by each reading under way.  `end`: by where the axes stop.  `time`: by when
        they do: not before they may, and not after they must.  What is not named is `path`'s.
        """
        first, last = self.ends
        now = Fraction(self.target.now_ns, NS)
        seen = []
        for number in range(samples):
            self.wait_until(now + (first - now) * number / samples)
            seen.append(self.look(path))
        self.wait_until(first - self._exchange_s)
        self._judge_early(time or path)
        self.wait_until(
            last + (0 if self.target.is_virtual else LAG_S + (last - now) * CLOCK_ERROR)
        )
        self._judge_quiet()
        seen.append(self._stopped(last - now, time or path, end or path))
        return tuple(seen)

    def _judge_quiet(self) -> None:
        """Judge that nothing has come since the last reply, where a check names that."""
        check = self.session.check
        if check is None or "MN4-RSP-14" not in check.declared:
            return
        raw = self.driver.client.listen(0)
        found, _ = codec.packets(raw)
        is_quiet = not any(one.is_sound and one.command != "E" for one in found)  # E may come late
        came = words.explain_reply(raw) or "nothing"
        told, when = "nothing behind the reply to E", "while the motion came to its end"
        self.session.expect(is_quiet, "MN4-RSP-14", told, came, when)

    @property
    def _exchange_s(self) -> Fraction:
        """What it takes to read the counters, at least."""
        return Fraction(40 * self.target.byte_ns, NS)

    def _judge_early(self, time: Requirements) -> None:
        """Judge that a motion that cannot be over is not."""
        counters, now = self.read()
        place = self.model.where(self.widened(now))
        is_over = inside(counters, self.end) and not inside(counters, place)
        told_end = f"not yet at {told(self.end)}"
        self.session.expect(not is_over, time, told_end, counters, "read just before it may end")

    def _stopped(self, lasted: Fraction, time: Requirements, end: Requirements) -> tuple[int, ...]:
        """Judge that the axes are at the end, where a motion that is late is told from one that
        ends elsewhere."""
        counters, _ = self.read()
        if not inside(counters, self.end):
            before = counters
            self.target.wait(float(LATE_S + lasted * LATE_SHARE))
            counters, _ = self.read()
            is_late = inside(counters, self.end)
            self.session.expect(
                not is_late, time, f"{told(self.end)} by then", before, "it came there later"
            )
        is_right, shown = (
            inside(counters, self.end),
            partial(self._seen, counters, self.end, "after"),
        )
        self.session.expect(is_right, end, told(self.end), shown)
        self.model.observe(counters)
        return counters

    def run(
        self,
        text: str,
        reply: Requirements,
        path: Requirements = None,
        end: Requirements = None,
        time: Requirements = None,
        samples: int = 5,
    ) -> tuple[tuple[int, ...], ...]:
        """`do`, then `follow`; what is not named is the business of `reply`."""
        self.do(text, reply)
        return self.follow(path or reply, end or path or reply, time or path or reply, samples)

    def lasts(self) -> Span:
        """Look at the axes until they are at the end; the least and the most time (s) since the
        motion was asked for."""
        began = last = self.model.timeline.began
        until = self.ends[1] + LATE_S + (self.ends[1] - began)
        while True:
            counters, now = self.read()
            if inside(counters, self.end) or now[0] > until:
                return last - began, now[1] - began
            last = now[0]

    def stays(self, requirement: Requirements, seconds: float = 0.3) -> tuple[int, ...]:
        """Judge that no axis moves for so long; give the counters."""
        before, _ = self.read()
        self.target.wait(seconds)
        after, _ = self.read()
        self.session.expect(after == before, requirement, before, after, "read again")
        return after

    def rest(self) -> tuple[int, ...]:
        """Wait until the axes stand, however long they take; give the counters."""
        wait_for_rest(self.driver)
        self.driver.ask("N")  # by which the travel guard knows that a move is over
        counters = self.driver.position()
        self.model.observe(counters)
        return counters

    def rest_paused(self) -> tuple[int, ...]:
        """The same in a pause: the motion is not over."""
        return wait_for_rest(self.driver)

    def _plot(self, counters: Sequence[int], now: Span, place: Place) -> None:
        """Keep a reading of the axis that goes farthest, for the report."""
        motions = self.model.timeline.motions
        moves = [abs(one) for one in motions[0].motion.displacements] if motions else [0]
        axis = moves.index(max(moves))
        at_ns = round((now[0] + now[1]) / 2 * NS)
        low, high = place[axis]
        began_s = float(self.model.timeline.began)
        self.session.motions.sample(
            f"motion of axis {axis + 1} at {began_s:.3f} s",
            [(at_ns, counters[axis])],
            [(at_ns, low, high)],
        )
        for x, y in _planes([one.motion for one in motions[:1]]):
            self.session.motions.trace(
                f"path of axes {x + 1} and {y + 1} at {began_s:.3f} s",
                (f"axis {x + 1}", f"axis {y + 1}"),
                (at_ns, counters[x], counters[y], *place[x], *place[y]),
            )


def _planes(motions: Sequence[PlannedMotion]) -> Iterator[tuple[int, int]]:
    """The two axes, from 0, of which a path is kept: those of a circle, or those that go farthest;
    none where one axis moves alone."""
    for motion in motions:
        bare = motion.motion if isinstance(motion, CompensatedMotion) else motion
        if isinstance(bare, CircleMotion):
            x, y, _ = bare.plane
            yield min(x, y), max(x, y)
            return
        moves = [abs(one) for one in bare.displacements]
        second, first = sorted(range(len(moves)), key=lambda axis: moves[axis])[-2:]
        if moves[second]:
            yield min(first, second), max(first, second)


def inside(counters: Sequence[int], place: Place) -> bool:
    """True if all axes are within a place."""
    return all(low <= one <= high for one, (low, high) in zip(counters, place, strict=True))


def told(place: Sequence[Window]) -> str:
    """A place in words."""
    return ", ".join(str(low) if low == high else f"{low} to {high}" for low, high in place)


def is_monotone(rows: Sequence[Sequence[int]], displacements: Sequence[int]) -> bool:
    """True if no axis ever turned back on a move of that direction."""
    return all(
        (after - before) * (1 if by > 0 else -1) >= 0 if by else after == before
        for one, other in pairwise(rows)
        for before, after, by in zip(one, other, displacements, strict=False)
    )
