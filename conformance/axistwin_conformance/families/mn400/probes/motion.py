"""Which readings a board follows in its motions, told by where its axes are at what time, and by
what N and E say of them.

Most are told by one recorded motion: whichever readings lead the model through all that was read of
it, explain it.  All go no farther than `FAR` steps, as far as there is room.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import hypot, sqrt
from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mn400.checks.contours import EXAMPLE_LINES, EXAMPLE_STEPS
from axistwin_conformance.families.mn400.driver import AXES, DATA, DONE, BoardDriver
from axistwin_conformance.families.mn400.model.board import BoardModel
from axistwin_conformance.families.mn400.model.motions import Span
from axistwin_conformance.families.mn400.motion.board_motion import (
    LAG_S,
    MOTION,
    NS,
    RIG_MOTION,
    BoardMotion,
    inside,
)

ORDER = 30  # of this module in a run; see `Family.modules`

FAR: Final = 2000
LOOKS: Final = 16
ANY: Final = "*"
MOST_TOLERANCE: Final = 8  # steps by which the radii of no arc differ


class RecordedMotion:
    """What was said to a board that was made ready, and what it then said of its axes."""

    def __init__(
        self, driver: BoardDriver, *texts: str, speed: int = 2000,
        profile: Sequence[int] = (1000, 5000, 10_000),
    ) -> None:  # fmt: skip
        self.driver, self.motion = driver, BoardMotion(driver)
        self.motion.ready(speed=speed, profile=profile)
        self._before = [
            f"F{','.join(map(str, profile))}", f"V{speed}", self.motion.plane(1, 3, 2),
            self.motion.mode(is_absolute=False), "L0,0,0,0",
        ]  # fmt: skip
        self._said: list[tuple[str, Span]] = []
        self._read: list[tuple[tuple[int, ...], Span]] = []
        for text in texts:
            self.say(text)

    def say(self, text: str) -> None:
        """Send a command that must work here."""
        exchange = self.driver.command(text)
        self._said.append((text, self.motion.span(exchange)))

    def starts(self, text: str) -> bool:
        """Send a command that some boards refuse; True if this one does not."""
        exchange = self.driver.ask(text)
        self._said.append((text, self.motion.span(exchange)))
        return exchange.says(*DONE)

    def watch(self, seconds: float, looks: int = LOOKS) -> RecordedMotion:
        """Read the counters so often over the next seconds."""
        begun = Fraction(self.driver.target.now_ns, NS)
        for number in range(looks):
            self.motion.wait_until(begun + Fraction(seconds) * number / looks)
            self._read.append(self.motion.read())
        return self

    def tells(self, switch: str) -> Outcome:
        """The readings of a switch that explain all that was read."""
        ledger = self.driver.session.run.ledger
        readings = [one for one in ledger.ambiguity_of(switch).switches[switch] if one != ANY]
        fitting = tuple(
            number for number, one in enumerate(readings) if self._explains(switch, one)
        )
        if fitting:
            return fitting
        return f"the counters were {', '.join(str(counters) for counters, _ in self._read)}"

    def _explains(self, switch: str, reading: str) -> bool:
        def read_as(name: str) -> str:
            return reading if name == switch else self.driver.reading(name)

        model = BoardModel(read_as)
        begun = self._said[0][1] if self._said else (Fraction(0), Fraction(0))
        for text in self._before:
            model.accept(text, begun)
        for text, taken in self._said:
            model.accept(text, taken)
        return all(
            inside(counters, model.where(self.motion.widened(now, model)))
            for counters, now in self._read
        )


# --- speed ----------------------------------------------------------------------------------------


@probe(safety=MOTION)
def step_phase(driver: BoardDriver) -> Outcome:
    """The first of two steps at 2 steps/s: at once or after half a second."""
    motion = BoardMotion(driver)
    motion.ready("V2")
    driver.command("M2")
    place, now = motion.read()
    if now[1] - now[0] > Fraction(1, 4):
        driver.session.skip("its replies take too long to tell")
    driver.ask("Q")
    return {0: 0, 1: 1}.get(place[0], str(place))


@probe(safety=MOTION)
def accel_scale(driver: BoardDriver) -> Outcome:
    """How long 2000 steps take with F1000,4000,4000 and V3000."""
    recorded = RecordedMotion(driver, "M2000", speed=3000, profile=(1000, 4000, 4000))
    return recorded.watch(1.4).tells("accel_scale")


@probe(safety=MOTION)
def multiplex_cap(driver: BoardDriver) -> Outcome:
    """A diagonal at 50000 steps/s and multiplex 4."""
    motion = BoardMotion(driver)
    motion.needs_speed(50_000, "this move")
    motion.needs_room(16_000, "this move")
    recorded = RecordedMotion(driver, "X4", speed=50_000, profile=(50_000, 50_000, 10_000))
    if not recorded.starts("M16000,16000"):
        return 1
    found = recorded.watch(2.0).tells("multiplex_cap")
    # The model knows of no error: where it fits without the limit, that was none.
    return 2 if found == (1, 2) else found


@probe(safety=MOTION)
def dda_phase(driver: BoardDriver) -> Outcome:
    """The one step of axis 2 beside 40 of axis 1: halfway, at the end, or at once."""
    motion = BoardMotion(driver)
    motion.ready("V40")
    driver.command("M40,1")
    begun = Fraction(driver.target.now_ns, NS)
    seen = []
    for part in (Fraction(1, 4), Fraction(3, 4)):
        motion.wait_until(begun + part)
        seen.append(motion.read()[0][1])
    motion.rest()
    readings = {(0, 1): 0, (0, 0): 1, (1, 1): 2}
    return readings.get((seen[0], seen[1]), f"axis 2 at {seen}")


# --- circles --------------------------------------------------------------------------------------


@probe(safety=MOTION)
def arc_radius_tol(driver: BoardDriver) -> Outcome:
    """By how much the radii of an arc that is begun may differ, sought by halves."""
    motion = BoardMotion(driver)
    radius = motion.within(2000) // 2
    fits, too_far = 0, int(sqrt(2 * MOST_TOLERANCE * radius))
    while too_far - fits > 1:
        aside = (fits + too_far) // 2
        motion.ready()
        exchange = driver.ask(f"A{-radius},0,{-2 * radius},{aside},1")
        driver.ask("Q")
        if exchange.says(*DONE):
            fits = aside
        else:
            too_far = aside
    least, most = (Fraction(hypot(radius, one) - radius) for one in (fits, too_far))
    ambiguity = driver.session.run.ledger.ambiguity_of("arc_radius_tol")
    usual = ambiguity.default_of("arc_radius_tol")
    if least <= Fraction(usual) < most:
        return Measured(usual)
    return Measured(f"{float(least + most) / 2:.2f}")


@probe(safety=MOTION)
def arc_rate(driver: BoardDriver) -> Outcome:
    """A half circle of radius 500 at V800, below the start speed."""
    recorded = RecordedMotion(driver, "A-500,0,-1000,0,1", speed=800)
    return recorded.watch(2.2).tells("arc_rate")


@probe(safety=MOTION)
def arc_ramp(driver: BoardDriver) -> Outcome:
    """A half circle of radius 500 at V3000, with a slow ramp from 500."""
    recorded = RecordedMotion(driver, "A-500,0,-1000,0,1", speed=3000, profile=(500, 5000, 2000))
    return recorded.watch(2.0).tells("arc_ramp")


@probe(safety=MOTION)
def arc_zero_sweep(driver: BoardDriver) -> Outcome:
    """An arc of radius 100 to its start."""
    recorded = RecordedMotion(driver, "A-100,0,0,0,1", speed=500)
    return recorded.watch(1.4).tells("arc_zero_sweep")


@probe(safety=MOTION)
def helix_zero_final(driver: BoardDriver) -> Outcome:
    """A helix of one turn to its start."""
    recorded = RecordedMotion(driver, "+-50,0,0,0,1,20,1", speed=500)
    return recorded.watch(1.6).tells("helix_zero_final")


@probe(safety=MOTION)
def helix_abs_fields(driver: BoardDriver) -> Outcome:
    """A helix in absolute mode, behind counters that are not 0, whose fields make a circle in every
    reading, each with another end."""
    motion = BoardMotion(driver)
    motion.ready(motion.mode(is_absolute=True), "L100,50,100,0")
    driver.command("+0,100,-100,100,1,-70,0")
    place = motion.rest()
    ends = ((-100, -20, 100, 0), (0, -20, 200, 0), (-100, -70, 100, 0))
    return ends.index(place) if place in ends else str(place)


# --- contours -------------------------------------------------------------------------------------


@probe(safety=MOTION)
def cc_corner_speed(driver: BoardDriver) -> Outcome:
    """A right angle of 500 steps either way at V3000."""
    recorded = RecordedMotion(driver, "(", "M500", "M0,500", ")", speed=3000)
    return recorded.watch(1.2).tells("cc_corner_speed")


@probe(safety=MOTION)
def cc_margin_scope(driver: BoardDriver) -> Outcome:
    """The manual's example at a margin of 20."""
    BoardMotion(driver).needs_room(EXAMPLE_STEPS, "this contour")
    recorded = RecordedMotion(driver, "(20", *EXAMPLE_LINES, ")")
    return recorded.watch(1.3).tells("cc_margin_scope")


@probe(safety=MOTION)
def cc_axis4(driver: BoardDriver) -> Outcome:
    """A segment of the fourth axis alone."""
    motion = BoardMotion(driver)
    motion.ready()
    driver.command("(")
    exchange, closing = driver.ask("M,,,20"), driver.ask(")")
    driver.ask("Q") if not closing.says(*DONE) else motion.rest()
    is_served = exchange.says(*DONE) and closing.says(*DONE)
    return (
        0 if is_served else 1 if "PARA_ERROR" in (*exchange.codes, *closing.codes) else str(closing)
    )


@probe(safety=MOTION)
def contour_pulses(driver: BoardDriver) -> Outcome:
    """A contour of two steps behind V-1, without pulses."""
    motion = BoardMotion(driver)
    motion.ready("V-1")
    driver.command("(")
    driver.ask("M2")
    closing = driver.ask(")")
    if not closing.says(*DONE):
        driver.ask("Q")
        return 2
    driver.target.wait(3.0)  # more than two steps take at the least speed
    place, _ = motion.read()
    driver.ask("Q")
    return {0: 0, 2: 1}.get(place[0], str(place))


# --- what reads tell ------------------------------------------------------------------------------


def _paused(driver: BoardDriver, text: str) -> tuple[BoardMotion, tuple[int, ...], tuple[int, ...]]:
    """A motion that is paused: its counters, and what N says."""
    motion = BoardMotion(driver)
    motion.ready(speed=500)
    driver.command(text)
    driver.target.wait(0.3)
    driver.command("{")
    place = motion.rest_paused()
    return motion, place, driver.steps_left()


@probe(safety=MOTION)
def readcount_sign(driver: BoardDriver) -> Outcome:
    """N in the pause of M-400."""
    _, place, left = _paused(driver, "M-400")
    driver.command("Q")
    rest = -400 - place[0]
    return {rest: 0, -rest: 1}.get(left[0], f"{left} at {place}")


@probe(safety=MOTION)
def readcount_after_abort(driver: BoardDriver) -> Outcome:
    """N after Q in the pause of M400."""
    _, place, left = _paused(driver, "M400")
    driver.command("Q")
    after = driver.steps_left()
    return 0 if after == left else 1 if not any(after) else f"{after} at {place}"


@probe(safety=MOTION)
def readcount_arc(driver: BoardDriver) -> Outcome:
    """N in the pause of three quarters of a circle of radius 200."""
    _, place, left = _paused(driver, "A-200,0,-200,200,1")
    driver.command("Q")
    net = tuple(abs(end - here) for end, here in zip((-200, 0, 200, 0), place, strict=True))
    return 0 if tuple(map(abs, left)) == net else 1


@probe(safety=MOTION)
def measure_single_axis(driver: BoardDriver) -> Outcome:
    """E1 in a move of one axis at 500 steps/s."""
    _, count = _measured(driver)
    return 0 if count == 0 else 1 if abs(count - 50) <= 2 else f"a count of {count}"


@probe(safety=MOTION)
def measure_position_sample(driver: BoardDriver) -> Outcome:
    """Whether E1 in such a move tells where it was when the measurement began."""
    gone, _ = _measured(driver)
    return 0 if gone > 40 else 1


def _measured(driver: BoardDriver) -> tuple[int, int]:
    """How far a move of 500 steps/s was beyond a reading in a measurement right behind it, and the
    count of that."""
    motion = BoardMotion(driver)
    motion.ready(speed=500)
    driver.command("M500")
    before, _ = motion.read()
    exchange = driver.ask("E1")
    driver.session.step(exchange.says(*DATA), "START and a value to E1", exchange.observed)
    fields = (exchange.value.fields if exchange.value else None) or ()
    driver.session.step(len(fields) == AXES + 1, "five numbers", fields)
    driver.command("Q")
    return fields[0] - before[0], fields[-1]


# --- backlash -------------------------------------------------------------------------------------


@probe(safety=MOTION)
def backlash_counts(driver: BoardDriver) -> Outcome:
    """Where B50 and M-50 lead the counter."""
    motion = BoardMotion(driver)
    motion.ready("B50,0,0,0", speed=500)
    driver.command("M-50")
    place = motion.rest()
    return {-50: 0, -100: 1}.get(place[0], str(place))


@probe(safety=MOTION)
def backlash_speed(driver: BoardDriver) -> Outcome:
    """How long B100 takes at V2000, where the start speed is 200."""
    profile = (200, 5000, 10_000)
    recorded = RecordedMotion(driver, "B100,0,0,0", "M-100", profile=profile)
    return recorded.watch(0.8).tells("backlash_speed")


@probe(safety=MOTION)
def backlash_arc(driver: BoardDriver) -> Outcome:
    """Whether an arc on which two axes turn is over when it is without compensation on the way."""
    motion = BoardMotion(driver)
    motion.ready("B20,20,20,20", speed=100)
    motion.set("A-30,-30,-60,-60,1")
    motion.wait_until(motion.ends[1] + LAG_S + Fraction(1, 20))
    place, _ = motion.read()
    last = motion.rest()
    is_there = tuple((one, one) for one in last) == motion.end
    return int(place != last) if is_there else str(last)


# --- pause and quit -------------------------------------------------------------------------------


@probe(safety=MOTION)
def pause_idle(driver: BoardDriver) -> Outcome:
    """{ at rest, then M10."""
    motion = BoardMotion(driver)
    motion.ready()
    for text in ("{", "M10"):
        driver.command(text)
    place = motion.rest()
    driver.command("}")
    motion.rest()
    return {10: 0, 0: 1}.get(place[0], str(place))


def _ended_by(driver: BoardDriver, text: str) -> Outcome:
    """Whether what ends a move at 3000 steps/s has a ramp down to 500, which takes 875 steps."""
    motion = BoardMotion(driver)
    motion.needs_room(FAR, "this move")
    motion.ready(speed=3000, profile=(500, 5000, 5000))
    driver.command("M2000")
    driver.target.wait(0.5)
    before, _ = motion.read()
    exchange = driver.command(text)
    place = motion.rest_paused()
    driver.ask("Q")
    taken = motion.span(exchange)
    at_once = 3000 * (taken[1] - taken[0] + Fraction(1, 10)) + 50
    return int(place[0] - before[0] > at_once)


@probe(safety=MOTION)
def pause_decel(driver: BoardDriver) -> Outcome:
    """How far { at 3000 steps/s lets a move go on."""
    outcome = _ended_by(driver, "{")
    return 1 - outcome if isinstance(outcome, int) else outcome


@probe(safety=MOTION)
def quit_decel(driver: BoardDriver) -> Outcome:
    """How far Q at 3000 steps/s lets a move go on."""
    return _ended_by(driver, "Q")


@probe(safety=MOTION)
def quit_flushes_queue(driver: BoardDriver) -> Outcome:
    """M300, M0,30 and Q in the first."""
    motion = BoardMotion(driver)
    motion.ready(speed=500)
    for text in ("M300", "M0,30"):
        driver.command(text)
    driver.command("Q")
    place = motion.rest()
    driver.ask("Q")
    return {0: 0, 30: 1}.get(place[1], str(place))


# --- pulses ---------------------------------------------------------------------------------------


@probe(safety=MOTION)
def threader_overrate(driver: BoardDriver) -> Outcome:
    """T with 30 steps in 20 pulses."""
    BoardMotion(driver).ready()
    exchange = driver.ask("T30,0,0,0,20")
    driver.ask("Q")
    if exchange.codes[-1:] == ("PARA_ERROR",):
        return 0
    return 1 if exchange.says(*DONE) else str(exchange)


@probe(safety=RIG_MOTION, needs=("rig:pulses", "rig:index"))
def threader_start(driver: BoardDriver) -> Outcome:
    """Ten pulses of twenty before any index."""
    motion = BoardMotion(driver)
    motion.ready()
    driver.command("T20,0,0,0,20")
    driver.session.rig.work("pulses", 10)
    driver.target.wait(0.1)
    place, _ = motion.read()
    driver.ask("Q")
    return {0: 0, 10: 1}.get(place[0], str(place))


@probe(safety=RIG_MOTION, needs=("rig:pulses",))
def sync_ratio(driver: BoardDriver) -> Outcome:
    """Ten pulses for a diagonal at multiplex 2."""
    motion = BoardMotion(driver)
    motion.ready("X2", "V-1")
    driver.command("M40,40")
    driver.session.rig.work("pulses", 10)
    driver.target.wait(0.1)
    place, _ = motion.read()
    driver.ask("Q")
    return {10: 0, 5: 1}.get(place[0], str(place))


# --- limits ---------------------------------------------------------------------------------------

LIMITS: Final = ("rig:limit_plus",)


def _at_limit(driver: BoardDriver, text: str, speed: int, profile: Sequence[int]) -> BoardMotion:
    """A move during which the + limit of axis 1 is turned on."""
    motion = BoardMotion(driver)
    motion.needs_room(FAR, "this move")
    motion.ready(speed=speed, profile=profile)
    driver.command(text)
    driver.target.wait(0.5)
    driver.session.rig.work("limit_plus", True, number=1)
    return motion


@probe(safety=RIG_MOTION, needs=LIMITS)
def limit_direction(driver: BoardDriver) -> Outcome:
    """A move away from a limit that is on."""
    motion = BoardMotion(driver)
    motion.ready()
    driver.session.rig.work("limit_plus", True, number=1)
    driver.command("M-20")
    place = motion.rest()
    driver.session.rig.work("limit_plus", False, number=1)
    return {-20: 0, 0: 1}.get(place[0], str(place))


@probe(safety=RIG_MOTION, needs=LIMITS)
def limit_halts(driver: BoardDriver) -> Outcome:
    """Which axes a limit of one halts in a diagonal."""
    motion = _at_limit(driver, "M1000,1000", 500, (1000, 5000, 10_000))
    place = motion.rest()
    driver.session.rig.work("limit_plus", False, number=1)
    if place[0] >= 1000:
        return str(place)
    return int(place[1] == 1000)


@probe(safety=RIG_MOTION, needs=LIMITS)
def limit_ramp(driver: BoardDriver) -> Outcome:
    """How far a limit at 3000 steps/s lets a move go on; a ramp takes 875 steps."""
    motion = _at_limit(driver, "M2000", 3000, (500, 5000, 5000))
    before, _ = motion.read()
    place = motion.rest()
    driver.session.rig.work("limit_plus", False, number=1)
    return int(place[0] - before[0] > 300)


@probe(safety=RIG_MOTION, needs=(*LIMITS,))
def multi_limit_exit(driver: BoardDriver) -> Outcome:
    """/ after a move towards two limits that are on."""
    motion = BoardMotion(driver)
    motion.ready("|")
    for number in (1, 2):
        driver.session.rig.work("limit_plus", True, number=number)
    driver.command("M5,5")
    motion.rest()
    code = driver.exit_code()
    for number in (1, 2):
        driver.session.rig.work("limit_plus", False, number=number)
    return {10: 0, 2: 1, 8: 1}.get(code, f"exit code {code}")


# --- jogging --------------------------------------------------------------------------------------

JOG: Final = ("rig:jog_plus",)
JOG_SPEED, HELD_S = 400, 2.5
JOG_ROOM, JOG_OFF_MS = 1200, 3


def _taps(driver: BoardDriver, settings: str, times: int) -> tuple[int, ...]:
    """Where so many taps of axis 1 lead, one after the other."""
    motion = BoardMotion(driver)
    if not driver.session.rig.is_exact:
        driver.session.skip("taps of 50 ms need a rig that keeps time")
    motion.ready("Y100", settings)
    driver.command("J1")
    places = []
    for _ in range(times):
        for is_on in (True, False):
            driver.session.rig.work("jog_plus", is_on, number=1)
            driver.target.wait(0.05)
        places.append(motion.rest()[0])
    driver.command("J0")
    return tuple(places)


@probe(safety=RIG_MOTION, needs=JOG)
def tap_rounding(driver: BoardDriver) -> Outcome:
    """Five taps of 8/10 step."""
    places = _taps(driver, "G10,10,10,10,8", 5)
    rhythms = ((0, 1, 2, 3, 4), (1, 2, 2, 3, 4))
    return rhythms.index(places) if places in rhythms else str(places)


@probe(safety=RIG_MOTION, needs=JOG)
def jog_hold_ms(driver: BoardDriver) -> Outcome:
    """How many steps less than its time allows an input makes that is held."""
    motion, rig = BoardMotion(driver), driver.session.rig
    if not rig.is_exact:
        driver.session.skip("an input that is held needs a rig that keeps time")
    motion.needs_room(JOG_ROOM, "this jogging")
    motion.ready(f"Y{JOG_SPEED}", "G1,1,1,1,1")
    driver.command("J1")
    begun = rig.work("jog_plus", True, number=1)
    driver.target.wait(HELD_S)
    ended = rig.work("jog_plus", False, number=1)
    jogged = motion.rest()[0] - 1  # the press was a tap as well
    driver.command("J0")
    held_s = (sum(ended) - sum(begun)) / 2e9
    is_early = driver.reading("step_phase") == "start"  # then the last step is begun, not over
    ms = round((held_s - (jogged + (-0.5 if is_early else 0.5)) / JOG_SPEED) * 1000)
    usual = driver.session.run.ledger.ambiguity_of("jog_hold_ms").default_of("jog_hold_ms")
    return Measured(usual if abs(ms - int(usual)) <= JOG_OFF_MS else str(ms))


@probe(safety=RIG_MOTION, needs=JOG)
def jog_res_code(driver: BoardDriver) -> Outcome:
    """A tap with both Jog Res inputs off, of 1 step by r1 and 8 by r4."""
    (place,) = _taps(driver, "G8,4,2,1,8", 1)
    return {1: 0, 8: 1}.get(place, str(place))
