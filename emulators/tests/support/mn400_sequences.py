"""Sequences of motions on one MN400: drawn commands one after the other, and what came of each.

Moves, arcs, helices and contours are sent while others run, between changes of every setting, with
pauses, holds, turns of the pot and Q.  What each is to be is reckoned here, from the commands alone
and by the ledger; the rules of single motions then judge every one that the board makes.

A sequence is drawn from a seed and a number, and with both it is the same again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from random import Random
from typing import Any, Literal, NamedTuple, TypeAlias

from mn400_bench import Mn400Bench, in_short, packets_in
from mn400_journeys import Four, Journey, Kind, Travel, Turn, drawn_segments, drawn_turn, travelled
from mn400_motions import Recorder, negated
from mn400_travel_rules import judge_arc, judge_duration, judge_end, judge_speeds

from axistwin.devices.mn400.link.packets import packet
from axistwin.devices.mn400.motion import (
    ContourSegment,
    MotionRules,
    MoveSettings,
    Plane,
    SpeedProfile,
    VectorMotion,
)
from axistwin.kernel.time import NS_PER_MS

Numbers: TypeAlias = tuple[int | None, ...]
MIRRORED = {"M": 4, "L": 4, "D": 4, "A": 4, "+": 4}
"""How many of the first parameters change their sign in a mirror; of + the traverse, too."""

COMMANDS_MAX = 20
"""Between two rests: less than a queue holds."""


class Act(NamedTuple):
    """What is done: a command, or ``wait`` (ms), ``feed`` (per mille), ``rest``."""

    what: str
    numbers: Numbers = ()

    def mirrored(self) -> "Act":
        """With all axes the other way."""
        count = MIRRORED.get(self.what, 0)
        turned = [
            -value if value and (place < count or (self.what == "+" and place == 5)) else value
            for place, value in enumerate(self.numbers)
        ]
        return Act(self.what, tuple(turned))

    @property
    def line(self) -> str:
        """As it is sent."""
        return self.what + ",".join("" if each is None else str(each) for each in self.numbers)


@dataclass(frozen=True)
class Expected:
    """A motion that is to come: of which act, and all of it but what the motions before leave."""

    act: int
    journey: Journey
    end: Four
    """The counters then."""


@dataclass
class Made:
    """A motion that the board has made."""

    recorder: Recorder
    start_ns: int
    plans: list[VectorMotion]
    feeds: list[tuple[int, int]]
    pauses: list[tuple[int, int]] = field(default_factory=list)
    paused_ns: int | None = None


class Cut(NamedTuple):
    """After Q: motions begun by then, whether the last was cut short, the counters, and N."""

    begun: int
    is_cut: bool
    counters: Four
    left: Four


# ---- drawing ----


class Drawing:
    """Draws commands, and reckons what they are to do."""

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self.acts: list[Act] = []
        self.expected: list[Expected] = []
        self._position: Four = (0, 0, 0, 0)
        self._settings = MoveSettings(MotionRules())
        self._plane = Plane()
        self._is_absolute = False
        self._waiting = 0

    def draw(self) -> None:
        """Some motions and what is between them."""
        self._do("D", 1, 1, 1, 1)
        for _ in range(self._rng.randint(6, 24)):
            kind = self._rng.choices(
                ("motion", "setting", "wait", "pause", "hold", "feed", "rest", "quit"),
                (40, 25, 12, 10, 5, 5, 5, 3),
            )[0]
            getattr(self, f"_{kind}")()
            if self._waiting > COMMANDS_MAX:
                self._rest()
        self._rest()

    def _do(self, what: str, *numbers: int | None) -> None:
        self.acts.append(Act(what, numbers))
        self._waiting += 1

    # settings

    def _setting(self, letter: str = "") -> None:
        rng = self._rng
        letter = letter or rng.choice("VFXBDILP")
        numbers: Numbers
        if letter == "V":
            numbers = (rng.randrange(30, rng.choice((1000, 6000, 100_001))),)
            self._settings = replace(self._settings, speed=numbers[0])
        elif letter == "F":
            start = rng.randrange(2, rng.choice((50, 1000, 3000)))
            profile = SpeedProfile(
                start, start + rng.randrange(20_000), rng.randrange(1, rng.choice((300, 30_000)))
            )
            numbers = (profile.start, profile.end, profile.acceleration)
            self._settings = replace(self._settings, profile=profile)
        elif letter == "X":
            numbers = (rng.choice((1, 2, 4)),)
            self._settings = replace(self._settings, multiplex=numbers[0])
        elif letter == "B":
            lash = self._four(0, 15)
            numbers = lash
            self._settings = replace(self._settings, lash=lash)
        elif letter == "D":
            numbers = tuple(rng.choice((1, -1, None)) for _ in range(4))
        elif letter == "I":
            self._is_absolute = rng.random() < 0.5
            numbers = (int(self._is_absolute),)
        elif letter == "L":
            self._position = numbers = self._four(-500, 500)
        else:
            x, y, z = rng.sample(range(4), 3)
            self._plane = Plane(x, y, z)
            numbers = (x + 1, y + 1, z + 1)
        self._do(letter, *numbers)

    def _four(self, low: int, high: int) -> Four:
        first, second, third, fourth = (self._rng.randint(low, high) for _ in range(4))
        return first, second, third, fourth

    # motions

    def _motion(self) -> None:
        draw = self._rng.choice((self._move, self._move, self._contour, self._turn))
        draw()

    def _expect(self, kind: Kind, way: Sequence[ContourSegment], margin: int = 0) -> None:
        journey = Journey(kind, 0, self._settings, tuple(way), margin, None, ())
        self._go(journey)

    def _go(self, journey: Journey) -> None:
        first, second, third, fourth = (
            here + there for here, there in zip(self._position, journey.total, strict=True)
        )
        self._position = first, second, third, fourth
        self.expected.append(Expected(len(self.acts) - 1, journey, self._position))

    def _move(self) -> None:
        reach = self._rng.choice((5, 60, 400))
        way = self._sent(self._four(-reach, reach), self._position)
        self._expect("move", [ContourSegment(way, self._settings.speed)])

    def _sent(self, way: Four, position: Four) -> Four:
        """Send a move, some axes omitted; how far it goes."""
        omitted = [self._rng.random() < 0.3 for _ in range(4)]
        goes = [0 if out else value for value, out in zip(way, omitted, strict=True)]
        base = position if self._is_absolute else (0, 0, 0, 0)
        self._do(
            "M",
            *(None if out else a + b for a, b, out in zip(goes, base, omitted, strict=True)),
        )
        first, second, third, fourth = goes
        return first, second, third, fourth

    def _contour(self) -> None:
        rng = self._rng
        margin = rng.choice((0, 1, 20, 50, 200, 1000))
        self._do("(", *(() if margin == 20 else (margin,)))
        position, segments = self._position, []
        for segment in drawn_segments(rng):
            if rng.random() < 0.4:
                self._settings = replace(self._settings, speed=max(30, segment.speed))
                self._do("V", self._settings.speed)
            way = self._sent(segment.displacement, position)
            first, second, third, fourth = (a + b for a, b in zip(position, way, strict=True))
            position = first, second, third, fourth
            segments.append(ContourSegment(way, self._settings.speed))
        self._do(")")
        self._expect("contour", segments, margin)

    def _turn(self) -> None:
        kind: Literal["arc", "helix"] = self._rng.choice(("arc", "helix"))
        turn: Turn = drawn_turn(self._rng, kind)._replace(plane=self._plane)
        x, y, _ = self._plane
        base = (self._position[x], self._position[y]) if self._is_absolute else (0, 0)
        numbers = [
            turn.center[0] + base[0],
            turn.center[1] + base[1],
            turn.destination[0] + base[0],
            turn.destination[1] + base[1],
            1 if turn.is_clockwise else -1,
        ]
        if kind == "arc":
            self._do("A", *numbers)
        else:
            self._do("+", *numbers, turn.traverse, turn.turns)
        self._go(Journey(kind, 0, self._settings, (), 0, turn, ()))

    # the rest

    def _wait(self) -> None:
        self.acts.append(Act("wait", (self._rng.choice((1, 40, 300, 2000)),)))

    def _pause(self) -> None:
        """Also where nothing moves, and with more motions meanwhile."""
        self._do("{")
        self._wait()
        if self._rng.random() < 0.3:
            self._motion()
        self._do("}")

    def _hold(self) -> None:
        self._do("H")
        self._motion()
        self._wait()
        self._do("K")
        self.expected[-1] = replace(self.expected[-1], act=len(self.acts) - 1)
        self._do("H", 0)

    def _feed(self) -> None:
        permille = self._rng.choice((0, 1, 300, 750, 999, 1000, 1000))
        self.acts.append(Act("feed", (permille,)))

    def _rest(self) -> None:
        self.acts.append(Act("rest"))
        self._waiting = 0

    def _quit(self) -> None:
        """Wherever it is; which settings had their turn nobody knows, so all come anew."""
        self._do("Q")
        for letter in "VFXBILP":
            self._setting(letter)
        self._do("D", 1, 1, 1, 1)


class MotionSequence(NamedTuple):
    """What is sent, and the motions that are to come of it."""

    acts: tuple[Act, ...]
    expected: tuple[Expected, ...]

    def mirrored(self) -> "MotionSequence":
        """All axes the other way."""
        acts = tuple(act.mirrored() for act in self.acts)
        expected = tuple(
            Expected(each.act, each.journey.mirrored(), negated(each.end)) for each in self.expected
        )
        return MotionSequence(acts, expected)


def drawn_sequence(seed: int, number: int) -> MotionSequence:
    """The sequence with that number."""
    drawing = Drawing(Random(f"sequence {seed}/{number}"))
    drawing.draw()
    return MotionSequence(tuple(drawing.acts), tuple(drawing.expected))


# ---- playing ----


class Player:
    """Plays a sequence on a board and keeps every motion that it makes."""

    def __init__(self, sequence: MotionSequence, **quirks: Any) -> None:
        self.sequence = sequence
        self.bench = Mn400Bench(paced=False, **quirks)
        self.made: list[Made] = []
        self.sent_ns: list[int] = []
        self.cuts: dict[int, Cut] = {}
        """What was to be seen after each Q, by its act."""
        self.rests: dict[int, Four] = {}
        """The counters at each rest."""
        self._order: object = None
        self._open: Made | None = None
        self._feed = 1000
        self.bench.switch("feedrate_enable")

    def play(self) -> "Player":
        """All of it."""
        for act in self.sequence.acts:
            self.sent_ns.append(self.bench.now)
            self._do(act)
        return self

    def _do(self, act: Act) -> None:
        bench, mover = self.bench, self.bench.device.mover
        if act.what == "wait":
            (milliseconds,) = act.numbers
            assert milliseconds is not None
            self._run_until(bench.now + milliseconds * NS_PER_MS)
        elif act.what == "feed":
            (permille,) = act.numbers
            assert permille is not None
            self._feed = permille
            bench.perform(bench.device.set_feed_pot(bench.now, permille))
            self._sample()
        elif act.what == "rest":
            while mover.is_busy:
                self._step(None)
            self.rests[len(self.sent_ns) - 1] = mover.position_at(bench.now)
            assert mover.exit_code == 0, "a sequence ends with an exit code"
        else:
            is_open = self._open is not None
            bench.send(packet(1, act.line.encode()))
            self._run_until(bench.now + 10 * NS_PER_MS)
            heard = " ".join(in_short(raw) for raw in packets_in(bench.network.host_take()))
            assert heard == "S D", (act.line, heard)
            if act.what == "Q":
                left, at = mover.left_at(bench.now), mover.position_at(bench.now)
                is_cut = is_open and mover.is_aborted
                self.cuts[len(self.sent_ns) - 1] = Cut(len(self.made), is_cut, at, left)

    def _run_until(self, until_ns: int) -> None:
        while self.bench.now < until_ns:
            self._step(until_ns)

    def _step(self, until_ns: int | None) -> None:
        """To the next event, and look what has become of the motion."""
        due = self.bench.network.next_event()
        if until_ns is None:
            assert due is not None, "a motion never ends"
            until_ns = due
        self.bench.network.run_until(until_ns if due is None else min(due, until_ns))
        self._sample()

    def _sample(self) -> None:
        now, mover = self.bench.now, self.bench.device.mover
        motion, order, made = mover.motion_at(now), mover.order, self._open
        if made is not None and motion is not made.recorder.motion:
            before = made.recorder.until(now)
            if motion is None or order is not self._order:
                self._open = None
            else:
                self._changed(made, before, motion)
        if motion is not None and self._open is None:
            since_ns = motion.since_ns
            self._open = Made(Recorder(motion), since_ns, [motion], [(since_ns, self._feed)])
            self.made.append(self._open)
            self._order = order

    def _changed(self, made: Made, before: VectorMotion, motion: VectorMotion) -> None:
        now = self.bench.now
        assert before.position_at(now) == motion.position_at(now), "a change moves the axes"
        made.recorder.motion = motion
        made.plans.append(motion)
        if made.feeds[-1][1] != self._feed:
            made.feeds.append((now, self._feed))
        if motion.is_paused and made.paused_ns is None:
            made.paused_ns = now
        elif made.paused_ns is not None and not motion.is_paused:
            made.pauses.append((made.paused_ns, now))
            made.paused_ns = None


# ---- judging ----


def judge_sequence(sequence: MotionSequence, **quirks: Any) -> int:
    """All properties of a sequence; how many motions it had.  Raises AssertionError."""
    player = Player(sequence, **quirks).play()
    SequenceJudge(player).judge()
    other = Player(sequence.mirrored(), **quirks).play()
    assert len(other.made) == len(player.made), "mirrored, there are other motions"
    for here, there in zip(player.made, other.made, strict=True):
        for axis in range(4):
            turned = [
                step._replace(direction=-step.direction) for step in there.recorder.steps[axis]
            ]
            assert here.recorder.steps[axis] == turned, "the mirrored sequence goes another way"
    return len(player.made)


class SequenceJudge:
    """Goes through the acts once more and holds each motion to what it is to be."""

    def __init__(self, player: Player) -> None:
        self._player = player
        self._begun = 0
        self._memory: Four = (1, 1, 1, 1)
        self._counters: Four = (0, 0, 0, 0)
        self._ended_ns = 0
        self._cut: Expected | None = None
        """The last motion before Q, if that has cut it short."""

    def judge(self) -> None:
        """Motion by motion, rest by rest."""
        player = self._player
        expected = list(player.sequence.expected)
        for place, act in enumerate(player.sequence.acts):
            while expected and expected[0].act == place:
                self._take(expected.pop(0))
            self._follow(place, act)
        counted = [sum(len(made.recorder.steps[axis]) for made in player.made) for axis in range(4)]
        bench = player.bench
        assert counted == bench.device.steps_at(bench.now), "steps beside the motions"
        assert self._begun == len(player.made), "motions that nobody has sent"

    def _follow(self, place: int, act: Act) -> None:
        """What an act does to what is known."""
        if act.what == "D":
            self._memory = _with(self._memory, act.numbers)
        elif act.what == "L":
            self._counters = _with(self._counters, act.numbers)
        elif act.what == "Q":
            self._quit(self._player.cuts[place])
        elif act.what == "rest":
            assert self._player.rests[place] == self._counters, "it rests elsewhere"

    def _quit(self, cut: Cut) -> None:
        assert self._begun == cut.begun, "not all that began was sent"
        if self._cut is not None:
            ends = tuple(a + b for a, b in zip(cut.counters, cut.left, strict=True))
            assert ends == self._cut.end, "what is left does not lead to the end"
            self._ended_ns = self._player.made[cut.begun - 1].recorder.since_ns
            self._cut = None

    def _take(self, expected: Expected) -> None:
        """A motion that was sent: made, cut short, dropped, or none at all."""
        journey = expected.journey
        cut = next((each for act, each in self._player.cuts.items() if act > expected.act), None)
        if cut is not None and self._begun == cut.begun:
            return
        self._counters = expected.end
        if journey.turn is None and not any(any(way) for way, _ in journey.segments):
            return
        made = self._player.made[self._begun]
        self._begun += 1
        if cut is not None and cut.is_cut and self._begun == cut.begun:
            self._cut = expected
            return
        self._judge(expected, made)

    def _judge(self, expected: Expected, made: Made) -> None:
        journey = expected.journey
        settings = replace(
            journey.settings, lash_memory=self._memory, feed_permille=made.feeds[0][1]
        )
        journey = replace(journey, start_ns=made.start_ns, settings=settings)
        travel = Travel(journey, made.recorder, made.plans, made.pauses, made.feeds)
        judge_end(travel)
        if journey.turn is None:
            judge_speeds(travel)
        else:
            judge_arc(travel, journey.turn)
        judge_duration(travel)
        if not made.pauses and len(made.feeds) == 1:
            alone = travelled(journey).recorder.steps
            assert alone == made.recorder.steps, "alone it goes another way"
        self._judge_start(expected, made)
        self._ended_ns = travel.end_ns
        self._memory = _with(
            self._memory,
            tuple(steps[-1].direction if steps else None for steps in made.recorder.steps),
        )

    def _judge_start(self, expected: Expected, made: Made) -> None:
        """At once, or when the one before is over; a pause ends with its motion."""
        earliest_ns = max(self._player.sent_ns[expected.act], self._ended_ns)
        late_ns = made.start_ns - earliest_ns
        assert late_ns == 0, ("it does not start when it is its turn", late_ns)


def _with(values: Four, given: Numbers) -> Four:
    """The values with those that are given."""
    first, second, third, fourth = (
        old if new is None else new for old, new in zip(values, given, strict=True)
    )
    return first, second, third, fourth
