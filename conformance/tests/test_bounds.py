"""A run ends, whatever the device does: in a few times what a sound one would take."""

from __future__ import annotations

from typing import Any

import pytest
from interfaces import PLAIN, judge_behind, judge_plainly
from port_in_front import PortInFront

from axistwin_conformance.base.errors import TargetError
from axistwin_conformance.base.line_quality import LineQuality, SilenceLimit
from axistwin_conformance.cli import make_options
from axistwin_conformance.core.settings import Envelope
from axistwin_conformance.engine.eta import HELD_UP, HELD_UP_BY_NOISE, most_s
from axistwin_conformance.engine.plan import Options
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.transport.serial import SerialTransport, open_target

SECOND = 1_000_000_000
WEIGHT_S = 0.8
TIDYING_S = 600  # putting back, with a unit that answers every other question wrongly


class Talking(PortInFront):
    """A byte that nobody asked for comes every so often (ns)."""

    def __init__(self, port: Any, every_ns: int) -> None:
        super().__init__(port)
        self._every_ns, self._due_ns, self._said = every_ns, every_ns, b""

    def write(self, data: bytes) -> int:
        """What is asked reaches the device."""
        return int(self.port.write(data))

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        self._talk()
        return int(self.port.in_waiting) + len(self._said)

    def _talk(self) -> None:
        while self.virtual_time_ns >= self._due_ns:
            self._said += b"U"
            self._due_ns += self._every_ns

    def read(self, size: int = 1) -> bytes:
        """What comes first."""
        self._talk()
        if not self._said:
            now_ns = self.virtual_time_ns
            end_ns = now_ns + round((self.timeout or 0) * SECOND)
            self.port.timeout = max(0, min(end_ns, self._due_ns) - now_ns) / SECOND
            if heard := bytes(self.port.read(size)):
                return heard
            self._talk()
        heard, self._said = self._said[:size], self._said[size:]
        return heard

    def close(self) -> None:
        """The clock is still asked for."""


def msc_options() -> Options:
    """What is asked of a controller that may be written to."""
    return make_options(
        model="msc-250", port=PLAIN.url, ids=("MSC-DREAD", "MSC-BREAD", "MSC-DWRITE"),
        level="quick", allow="stored", variables=range(1000, 2000), flags=range(200, 210),
    )  # fmt: skip


class CutShort(PortInFront):
    """Ctrl-C at the read of that number; from then on the first byte of each reply is missing."""

    def __init__(self, port: Any, read: int) -> None:
        super().__init__(port)
        self._left, self._is_begun = read, False

    def write(self, data: bytes) -> int:
        """What is asked reaches the device."""
        self._is_begun = False
        return int(self.port.write(data))

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return int(self.port.in_waiting)

    def read(self, size: int = 1) -> bytes:
        """What comes first."""
        self._left -= 1
        if not self._left:
            raise KeyboardInterrupt
        self.port.timeout = self.timeout
        if self._left < 0 and not self._is_begun:
            self._is_begun = bool(self.port.read(1))
        return bytes(self.port.read(size))

    def close(self) -> None:
        """Give it back."""
        self.port.close()


@pytest.mark.parametrize("read", range(30, 33))
def test_a_twin_that_was_interrupted_amid_a_reply_has_not_failed(read: int) -> None:
    """Whatever it says from then on."""
    options = make_options(model="mac23", level="quick")
    url = options.family.twin_url(options.model, options.address, options.neighbours)

    def opener(neighbours: tuple[int, ...]) -> SerialTransport:
        return SerialTransport(CutShort(open_target(url, 38400)._port, read), url)

    result = Engine(options, opener).run(lambda event: None)
    assert result.exit_status == 130, result.sentence


@pytest.mark.strength(seconds=40)
@pytest.mark.parametrize("every_ms", [1000, 100])
def test_a_unit_that_talks_unasked_makes_no_run_of_hours(every_ms: int) -> None:
    """It ends within what is foreseen for a line as bad as that, and says why."""
    ports: list[Talking] = []

    def talking(port: Any) -> Talking:
        ports.append(Talking(port, every_ms * 1_000_000))
        return ports[-1]

    options = msc_options()
    plan = Engine(options).plan()
    most = (
        most_s(plan, options.settings.envelope, SECOND // 5, WEIGHT_S) * HELD_UP * HELD_UP_BY_NOISE
    )
    result = judge_plainly(options, before=talking)
    assert ports[0].virtual_time_ns / SECOND < most + TIDYING_S
    assert result.exit_status in (1, 4)
    assert "error in the suite" not in " ".join(result.problems)


def test_what_a_run_may_take_follows_its_line_and_its_speed() -> None:
    """Twice as slow, twice as long; none is without end."""
    options = msc_options()
    plan = Engine(options).plan()
    bench, crawl = Envelope(2000, 10_000), Envelope(2000, 500)
    plain = most_s(plan, bench, 0, WEIGHT_S)
    assert plain > 60
    assert most_s(plan, bench, 60_000_000, WEIGHT_S) - 60 == pytest.approx(2 * (plain - 60))
    assert most_s(plan, crawl, 0, WEIGHT_S) - 60 == pytest.approx(10 * (plain - 60))


@pytest.mark.strength(seconds=40)
def test_a_board_that_may_go_far_is_done_within_what_is_foreseen() -> None:
    """It has slow motions to show; how far they go changes little."""
    options = make_options(
        model="mn400", port=PLAIN.url, level="full", allow="motion", max_travel=200_000,
        max_speed=100_000,
    )  # fmt: skip
    url = options.family.twin_url(options.model, options.address, options.neighbours)
    run = judge_behind(PLAIN, options, url)
    assert run.result.exit_status == 0, run.result.sentence
    plan, bounds = Engine(options).plan(), options.settings.envelope
    weight_s = options.family.models[options.model].weight_s
    assert run.seconds < most_s(plan, bounds, 0, weight_s)


def test_a_device_is_given_up_after_a_minute_of_nonsense_on_the_noisiest_line() -> None:
    """However many bad replies in a row such a line may make."""
    quality = LineQuality(exchanges=1000, corrupted=900)
    limit = SilenceLimit()
    for second in range(60):
        limit.tried(second * SECOND, quality.bad_when_lost, is_silence=False)
    with pytest.raises(TargetError, match="nothing sensible has come for 60 s, in 61 attempts"):
        limit.tried(60 * SECOND, quality.bad_when_lost, is_silence=False)


@pytest.mark.parametrize(("corrupted", "needed"), [(3, 3), (50, 6), (2000, 31)])
def test_a_right_sum_is_chance_the_more_often_the_more_is_corrupted(
    corrupted: int, needed: int
) -> None:
    """One in 256 of what noise makes may have it; three of three do not."""
    quality = LineQuality(exchanges=10_000, corrupted=corrupted)
    assert [quality.is_meant(256) for _ in range(needed)] == [False] * (needed - 1) + [True]


def test_a_line_that_corrupts_every_fourth_exchange_is_given_no_patience() -> None:
    """Nothing settles on it in ten attempts; a worse one than that is noise of no line."""
    assert not LineQuality(exchanges=1000, corrupted=0).is_hopeless
    assert not LineQuality(exchanges=1000, corrupted=250).is_hopeless
    assert LineQuality(exchanges=1000, corrupted=251).is_hopeless
