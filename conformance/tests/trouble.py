"""Trouble at chosen moments of a run in virtual time.

At each of the moments the process forks, and the child meets it there: so hundreds of interrupts
all over a run cost little more than that run.
"""

from __future__ import annotations

import os
import random
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NoReturn, Protocol

from shaft_watch import ACTING, Order, Shaft

from axistwin_conformance.base import interrupts
from axistwin_conformance.base.events import Outcome
from axistwin_conformance.engine.result import Result

STOP = 0x18


class Witness(Protocol):
    """What stands between suite and twins and looks at the shafts: on a line, or on a bus."""

    sent: list[Any]
    shafts: list[Shaft]
    cells: list[dict[str, Any]]

    def stored(self) -> list[dict[str, Any]]:
        """What each twin's EEPROM holds."""

    def rest(self, seconds: float = 1.0) -> None:
        """Let time pass in which nobody sends."""

    def has_acted(self, before: int) -> bool:
        """True if anything was sent by then that leaves something to put back."""

    def orders_after(self, sent: int) -> list[Order]:
        """What was asked for later than that."""


Judge = Callable[[Result, list[Any], Any, int], None]
Run = Callable[[Callable[[Any], None]], tuple[Result, list[Any]]]  # a run, who is told of each call


@dataclass
class Trouble:
    """Counts what is done with a line or bus, and at chosen moments lets a child of this process
    meet trouble there; `judge` looks at how that child's run ends."""

    moments: frozenset[int]
    befall: Callable[[], None]
    judge: Judge
    calls: int = 0
    failures: list[str] = field(default_factory=list)
    met: tuple[Any, int] | None = None  # in the child: where, and after how many requests
    _pipe: int = -1

    def __call__(self, watch: Any) -> None:
        """A moment of the run."""
        if interrupts.is_held_back():
            return  # on the way out no other trouble is made
        self.calls += 1
        if self.met is not None or self.calls not in self.moments:
            return
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reading)
            self.met, self._pipe = (watch, len(watch.sent)), writing
            self.befall()
            return
        os.close(writing)
        with os.fdopen(reading, "rb") as pipe:
            told = pipe.read().decode()
        _, status = os.waitpid(child, 0)
        if told or status:
            self.failures.append(f"at call {self.calls}: {told or status}")

    def finish(self, result: Result, watches: list[Any]) -> None:
        """In the child: judge, tell, and be gone."""
        if self.met is None:
            return
        try:
            self.judge(result, watches, *self.met)
            self.leave("")
        except BaseException:
            self.leave(f"{result.sentence} {result.problems}\n{traceback.format_exc()}")

    def leave(self, text: str) -> NoReturn:
        """In the child: tell what went wrong, and end."""
        os.write(self._pipe, text[-60_000:].encode())
        os._exit(0)


def meet(trouble: Trouble, run: Run) -> None:
    """Run with trouble; every child must have ended well."""
    parent = os.getpid()
    try:
        result, watches = run(trouble)
        trouble.finish(result, watches)
        assert result.exit_status == 0, result.sentence
    except BaseException:
        if os.getpid() != parent:
            trouble.leave(traceback.format_exc())
        raise
    assert "\n".join(trouble.failures) == ""


def moments_of(number: int, run: Run, *, seed: int) -> frozenset[int]:
    """That many moments, all over the true length of the run."""
    measured = Trouble(frozenset(), lambda: None, lambda *given: None)
    run(measured)
    return frozenset(random.Random(seed).sample(range(1, measured.calls + 1), number))


def judge_way_out(
    watches: list[Any], met: Witness, sent: int, *, most: int, is_ended: bool = True
) -> None:
    """The stop went out first, every shaft rests inside `most` increments, and every EEPROM is as
    it was.

    `is_ended`: what was being done ended there; otherwise it may have been the putting back.
    """
    if met.has_acted(sent):
        # A module that has another address or rate just now could not hear the stop.
        after = [order.index for order in met.orders_after(sent)]
        acts = [index for index in after if index in ACTING - {0x00, 0x08, 0x1B}]
        assert acts[0] == STOP or (not is_ended and STOP in acts), [
            f"{index:02X}h" for index in after[:9]
        ]
    for watch in watches:
        before = [shaft.place for shaft in watch.shafts]
        watch.rest()
        assert [shaft.place for shaft in watch.shafts] == before, "at rest"
        assert not any(shaft.twin.is_moving for shaft in watch.shafts)
        assert watch.stored() == watch.cells
        for shaft in watch.shafts:
            assert max(shaft.asked, shaft.furthest) <= most + shaft.blur


def judge_interrupted(
    result: Result, watches: list[Any], met: Witness, sent: int, *, most: int
) -> None:
    """Stopped, put back, 130."""
    assert result.is_interrupted
    assert result.exit_status == 130
    assert result.problems == []
    judge_way_out(watches, met, sent, most=most)


def judge_lost(result: Result, met: Witness, sent: int, *, transport: str) -> None:
    """The port or bus was lost: nothing can be stopped then; that is said, and it is no crash."""
    assert result.exit_status in (3, 4)
    told = " ".join([*result.problems, result.refusal])
    assert "error in the suite" not in told
    assert f"the {transport} failed" in told or "cannot open" in told
    if met.has_acted(sent):
        assert "could not stop the axis or put its parameters back" in told


# They are about places far away, or long ways, and say what travel they need.
FAR_AWAY = (
    "positions_are_signed_and_big_endian",
    "long_ways_are_counted_in_full",
    "neither_motion_nor_arm_ends_while_nobody_speaks",
)


def judge_envelope(result: Result, watches: list[Any], *, travel: int, speed: int) -> None:
    """No position further away was asked for, or reached, and every EEPROM is as it was.

    The twin's plant is ideal: it brakes within the increment.  Each 0Bh in motion leaves the
    witness itself in doubt about one (`blur`).
    """
    assert result.problems == []
    held_back = {
        one.check.name: one.trouble for one in result.checks if one.outcome is not Outcome.DONE
    }
    for name in FAR_AWAY:
        assert held_back.pop(name, "needs --max-travel").startswith("needs --max-travel")
    assert held_back == {}, "the checks know the envelope; the fence had nothing to do"
    shafts = [shaft for watch in watches for shaft in watch.shafts]
    for shaft in shafts:
        assert shaft.asked <= travel + shaft.blur
        assert shaft.furthest <= travel + shaft.blur
        assert shaft.fastest <= speed
    assert max(shaft.furthest for shaft in shafts) > travel // 2, "there was motion"
    assert max(shaft.asked for shaft in shafts) > travel // 2
    for watch in watches:
        assert watch.stored() == watch.cells, "what the EEPROMs held is back"


def interrupt() -> None:
    """Ctrl-C."""
    raise KeyboardInterrupt
