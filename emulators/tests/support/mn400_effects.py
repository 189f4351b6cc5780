"""What each command of an MN400 changes, seen from outside, and how a board is brought to rest."""

from collections.abc import Callable, Mapping
from dataclasses import astuple

from mn400_bench import Mn400Bench

from axistwin.kernel.time import NS_PER_S

Watch = Callable[[Mn400Bench], object]


def told(bench: Mn400Bench, *lines: str) -> str:
    """Say lines to the first board, whatever its number and rate are by now."""
    described = bench.device.describe(bench.now)
    bench.host_rate(described.baud)
    return bench.say(*lines, number=described.address)


def moved(bench: Mn400Bench, *lines: str) -> list[int]:
    """How far the counters go with ``lines``."""
    before = bench.peek()
    told(bench, *lines)
    rest(bench)
    return [after - each for after, each in zip(bench.peek(), before, strict=True)]


def stepped(bench: Mn400Bench, *lines: str) -> list[int]:
    """How many pulses the step outputs make with ``lines``."""
    before = bench.device.steps_at(bench.now)
    told(bench, *lines)
    rest(bench)
    return [
        after - each for after, each in zip(bench.device.steps_at(bench.now), before, strict=True)
    ]


def lasting_ms(bench: Mn400Bench, line: str) -> float:
    """How long a motion lasts."""
    described = bench.device.describe(bench.now)
    bench.host_rate(described.baud)
    assert described.address == 1
    return bench.moving_ms(line)


def jogged(bench: Mn400Bench, milliseconds: float) -> int:
    """How far a jog input moves the first axis."""
    before = bench.peek()[0]
    told(bench, "J1")
    bench.switch("jog_m1_plus")
    bench.wait(milliseconds)
    bench.switch("jog_m1_plus", on=False)
    bench.wait(3000)
    told(bench, "J0")
    return bench.peek()[0] - before


def measured(bench: Mn400Bench) -> str:
    """What E1 counts during a motion of two axes."""
    told(bench, "M20000,10000")
    bench.wait(200)
    count = bench.value("E1", milliseconds=200).split(",")[4]
    told(bench, "Q", "|")
    return count


def mode(bench: Mn400Bench) -> list[int]:
    """Whether 5 is a place or a way."""
    told(bench, "L2,0,0,0", "M5")
    rest(bench)
    return bench.peek()


SETTINGS: Mapping[str, tuple[str, Watch]] = {
    "C": ("C1,0", lambda bench: bench.device.output_at(bench.now, 1)),
    "G": ("G1,1,1,1,8", lambda bench: jogged(bench, 50)),
    "Y": ("Y100", lambda bench: jogged(bench, 1500)),
    "L": ("L,,,77", lambda bench: bench.peek()[3]),
    "F": ("F500,600,10000", lambda bench: lasting_ms(bench, "M1000")),
    "I": ("I1", mode),
    "B": ("B50", lambda bench: stepped(bench, "M-1")),
    "D": ("D-1", lambda bench: stepped(bench, "B50", "M1")),
    "P": ("P3,4,1", lambda bench: moved(bench, "A-20,0,-40,0,1")),
    "X": ("X4", measured),
    "V": ("V300", lambda bench: lasting_ms(bench, "M1000")),
    "=": ("=9", lambda bench: bench.device.describe(bench.now).address),
    "~": ("~4", lambda bench: bench.device.describe(bench.now).baud),
    ";": (";1", lambda bench: told(bench, ":")[4]),
}
"""A line of each command that sets something, and what tells whether it has."""

MOTIONS: Mapping[str, tuple[str, tuple[int, int, int, int]]] = {
    "A": ("A300,0,600,0,1", (600, 0, 0, 0)),
    "+": ("+100,0,200,0,1,5,1", (200, 5, 0, 0)),
    "M": ("M700,,-3", (700, 0, -3, 0)),
    "T": ("T5,0,0,2,10", (5, 0, 0, 2)),
}
"""A line of each motion command, and how far it goes."""

OTHERS: Mapping[str, str] = {"H": "H1", "J": "J1"}


def line_of(letter: str, state: str) -> str:
    """A legal line of a command that changes something if it may."""
    if (letter, state) == ("J", "JOG"):
        return "J0"
    known = {**{key: line for key, (line, _) in (*SETTINGS.items(), *MOTIONS.items())}, **OTHERS}
    return known.get(letter, letter)


_WAYS_OUT = {
    "PAU": "}",
    "HLD": "H0",
    "HPD": "K",
    "CCB": ")",
    "PRG": "\x04",
    "CFG": "Q",
    "JOG": "J0",
    "ABT": "|",
}


def rest(bench: Mn400Bench) -> list[str]:
    """Bring a board to rest by what leads out of each state; the states it was in."""
    visited = []
    while (state := bench.device.describe(bench.now).state) != "RDY":
        visited.append(state)
        assert len(visited) < 12, visited
        if state == "THR":
            bench.perform(bench.device.index_pulse(bench.now))
            bench.perform(bench.device.feed_pulses(bench.now, 1000))
        elif state in _WAYS_OUT:
            told(bench, _WAYS_OUT[state])
        else:
            pass_by(bench, state)
    return visited


def pass_by(bench: Mn400Bench, state: str) -> None:
    """Let time pass until the state is another one."""
    until_ns = bench.now + 60 * NS_PER_S
    while bench.device.describe(bench.now).state == state and bench.now < until_ns:
        bench.wait(100)


def shown(bench: Mn400Bench) -> tuple[object, ...]:
    """All that can be seen of a board at an instant."""
    flags = [bench.device.flag_at(bench.now, name) for name in ("stop", "pause", "jog", "run")]
    return (*astuple(bench.device.describe(bench.now)), *flags)
