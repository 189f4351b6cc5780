"""Sessions with a board, written down step by step, and what is seen at each.

::

    LINE                    a command, answered S D        LINE -> S 1,2,3,4    its reply in short
    #5 LINE                 to board 5 (0: all)            LINE takes 0.600 s   its motion, rounded
    ^D                      04h                            hex 81 2A -> 81 2A   bytes, within 300 ms
    wait 500 -> hex bytes   ms pass                        at -> 1,2,3,4        the counters
    on, off, tap NAME       an input                       pulses -> 1,2,3,4    at the step outputs
    feed 5 -> 1,2,3,4       pulses, and the counters       feed pot 500         per mille
    index                   the index pulse                output 1 -> on       an output
    state -> RDY            as in the table of states      usb E -> 45 30       reports
    rate 19200              of the host                    power [up -> bytes]  off and on again
    delay -> 14             whole ms before the reply      anew 1 2 name=value  other boards

``nothing``: no byte; ``some bytes``; ``ends TEXT``: the value does; ``a or b``; ``1,2 ± 3``: each
number as near as that.
"""

import re
from collections.abc import Callable
from typing import Any

from mn400_bench import Mn400Bench, in_short, packets_in

from axistwin.devices.mn400.link.packets import packet
from axistwin.kernel.time import NS_PER_MS

WIDE_MS = 300
"""Within this the longest of the replies has come that a table expects."""

LATE_MS = 2500
TAP_MS = 50


class Session:
    """One or more boards on a line, and what was asked of them last."""

    def __init__(self) -> None:
        self.bench = Mn400Bench()
        self._heard_ns = 0

    def play(self, script: str) -> list[str]:
        """All steps; those that were not as written, each with what was seen."""
        steps = [line for line in script.splitlines() if line]
        wrong = []
        for number, step in enumerate(steps, 1):
            asked, _, expected = step.partition(" -> ")
            seen = self._do(asked, bool(expected))
            if expected and not agrees(seen, expected):
                wrong.append(f"{number}. {step}: {seen}")
        return wrong

    def _do(self, asked: str, has_result: bool) -> str:
        """Do one step; what is seen of it."""
        if " takes " in asked:
            return self._timed(*asked.split(" takes "))
        verb, _, rest = asked.partition(" ")
        act = self._verbs().get(verb)
        if act is not None:
            return act(rest)
        told = self._say(asked)
        is_plain = has_result or asked.endswith("*")
        assert is_plain or set(told.split()) == {"S", "D"}, (asked, told)
        return told

    def _verbs(self) -> dict[str, Callable[[str], str]]:
        bench = self.bench
        device, switch = bench.device, bench.switch

        def done(act: Callable[[str], object]) -> Callable[[str], str]:
            return lambda rest: str(act(rest) or "")

        return {
            "anew": self._anew,
            "hex": lambda rest: self._ask(bytes.fromhex(rest)).hex(" "),
            "wait": lambda rest: self.bench.wait(float(rest)).hex(" "),
            "at": lambda rest: joined(bench.peek()),
            "pulses": lambda rest: joined(device.steps_at(bench.now)),
            "state": lambda rest: device.describe(bench.now).state,
            "output": lambda rest: "on" if device.output_at(bench.now, int(rest)) else "off",
            "delay": lambda rest: str((device.sent[0][0] - self._heard_ns) // NS_PER_MS - 1),
            "on": done(switch),
            "off": done(lambda name: switch(name, on=False)),
            "tap": self._tap,
            "feed": self._feed,
            "index": done(lambda rest: bench.perform(device.index_pulse(bench.now))),
            "rate": done(lambda rest: bench.host_rate(int(rest))),
            "usb": self._usb,
            "power": self._power,
        }

    def _ask(self, data: bytes, milliseconds: float = WIDE_MS) -> bytes:
        self._heard_ns = self.bench.send(data)
        return self.bench.wait(milliseconds)

    def _say(self, line: str) -> str:
        number, sep, text = 1, "", line
        if re.match(r"#\d+ ", line):
            head, sep, text = line.partition(" ")
            number = int(head[1:])
        text = "\x04" if text == "^D" else text
        wide = LATE_MS if sep else 100
        heard = self._ask(packet(number, text.encode("latin-1")), wide)
        return " ".join(in_short(raw) for raw in packets_in(heard))

    def _timed(self, line: str, written: str) -> str:
        """Compare a duration with a figure that was rounded."""
        figure = written.removesuffix(" s")
        digits = len(figure.partition(".")[2])
        taken = self.bench.moving_ms(line) / 1000
        assert abs(taken - float(figure)) <= 0.51 / 10**digits, (line, written, taken)
        return ""

    def _anew(self, rest: str) -> str:
        words = rest.split()
        numbers = [int(word) for word in words if word.isdigit()]
        quirks: dict[str, Any] = dict(word.split("=") for word in words if "=" in word)
        rate = quirks.pop("baud", None)
        cells = {"baud": int(rate)} if rate else None
        self.bench = Mn400Bench(*numbers, cells=cells, **quirks)
        return ""

    def _tap(self, name: str) -> str:
        self.bench.switch(name)
        self.bench.wait(TAP_MS)
        self.bench.switch(name, on=False)
        self.bench.wait(LATE_MS)
        return ""

    def _feed(self, rest: str) -> str:
        bench = self.bench
        if rest.startswith("pot "):
            bench.perform(bench.device.set_feed_pot(bench.now, int(rest[4:])))
        else:
            bench.perform(bench.device.feed_pulses(bench.now, int(rest)))
        return joined(bench.peek())

    def _usb(self, text: str) -> str:
        bench = self.bench
        bench.perform(bench.device.send_usb(bench.now, text))
        bench.wait(200)
        told = ", ".join(bench.device.take_report(bench.now))
        bench.perform(bench.device.drop_reports(bench.now))
        return told.lower()

    def _power(self, rest: str) -> str:
        self.bench.power_cycle()
        return self.bench.wait(200).hex(" ")


def joined(numbers: list[int]) -> str:
    """As a value on the wire."""
    return ",".join(map(str, numbers))


def agrees(seen: str, expected: str) -> bool:
    """What is seen against what is written (see the top)."""
    if expected == "some bytes":
        return bool(seen)
    if expected.startswith("ends "):
        value = in_short(packets_in(bytes.fromhex(seen))[-1])
        return value.endswith(expected[5:])
    if " ± " in expected:
        text, _, room = expected.partition(" ± ")
        pairs = zip(re.findall(r"-?\d+", seen), re.findall(r"-?\d+", text), strict=True)
        return all(abs(int(a) - int(b)) <= int(room) for a, b in pairs)
    wanted = ["" if each == "nothing" else each for each in expected.split(" or ")]
    return any(seen == each or seen == each.lower() for each in wanted)
