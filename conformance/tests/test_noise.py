"""Noise: lost, late and corrupted bytes never make a wrong verdict."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable
from typing import Any

import pytest
import serial
from port_in_front import PortInFront

from axistwin_conformance import noise
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine import Engine, Result
from axistwin_conformance.events import Outcome
from axistwin_conformance.judgement import CheckResult
from axistwin_conformance.noise import Attempt, LineQuality, Replays
from axistwin_conformance.targets import TWIN_HANDLER, Target
from axistwin_conformance.verdicts import Finding, Verdict

LATEST_NS = 60_000_000  # a byte may come that late: more than the pause after a forbidden frame


class NoisyPort(PortInFront):
    """The built-in twin's port with one byte in `every` lost, corrupted or late, both ways."""

    def __init__(self, port: Any, every: int, seed: int) -> None:
        super().__init__(port)
        self.every = every
        self.random = random.Random(seed)
        self.hits = 0
        self._arrived: deque[tuple[int, int]] = deque()  # from when on, byte

    def _spoil(self, byte: int) -> tuple[bytes, int]:
        """What becomes of a byte, and how late (ns)."""
        if self.random.randrange(self.every):
            return bytes([byte]), 0
        self.hits += 1
        fate = self.random.randrange(3)
        if fate == 0:
            return b"", 0
        if fate == 1:
            return bytes([byte ^ self.random.randrange(1, 256)]), 0
        return bytes([byte]), self.random.randrange(LATEST_NS)

    def write(self, data: bytes) -> int:
        """Send what noise leaves of the bytes; a late one holds up those behind it."""
        whole = b""
        for byte in data:
            kept, late_ns = self._spoil(byte)
            if late_ns:
                self.port.write(whole)
                whole = b""
                self._let_pass(late_ns)
            whole += kept
        self.port.write(whole)
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """Read what noise leaves, as pyserial does."""
        deadline_ns = self.virtual_time_ns + round((self.timeout or 0) * 1e9)
        taken = b""
        while True:
            self._collect(0)
            while (
                self._arrived and self._arrived[0][0] <= self.virtual_time_ns and len(taken) < size
            ):
                taken += bytes([self._arrived.popleft()[1]])
            left_ns = deadline_ns - self.virtual_time_ns
            if len(taken) == size or left_ns <= 0:
                return taken
            if self._arrived:
                left_ns = max(1, min(left_ns, self._arrived[0][0] - self.virtual_time_ns))
            self._collect(left_ns)

    def _is_ready(self) -> bool:
        return bool(self._arrived) and self._arrived[0][0] <= self.virtual_time_ns

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        self._collect(0)
        return sum(ready_ns <= self.virtual_time_ns for ready_ns, _ in self._arrived)

    def close(self) -> None:
        """Close."""
        self.port.close()

    def _let_pass(self, duration_ns: int) -> None:
        until_ns = self.virtual_time_ns + duration_ns
        while (left_ns := until_ns - self.virtual_time_ns) > 0:
            self._collect(left_ns)

    def _collect(self, timeout_ns: int) -> None:
        """Take what comes within the time, a first byte at most, into the queue."""
        self.port.timeout = timeout_ns / 1e9
        for byte in self.port.read(1) + self.port.read(self.port.in_waiting):
            kept, late_ns = self._spoil(byte)
            before_ns = self._arrived[-1][0] if self._arrived else 0
            ready_ns = max(before_ns, self.virtual_time_ns + late_ns)
            self._arrived.extend((ready_ns, one) for one in kept)


def noisy_run(every: int, seed: int, *words: str, level: str = "quick", **quirks: str) -> Result:
    """Judge the built-in twin behind a noisy line."""
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    options = make_options(model="mac23", ids=words, level=level, seed=seed)
    ports: list[NoisyPort] = []

    def open_noisy(neighbours: tuple[int, ...]) -> Target:
        url = options.family.twin_url(options.model, options.address, neighbours)
        url += "".join(f"&quirk.{name}={value}" for name, value in quirks.items())
        inner = serial.serial_for_url(url, baudrate=options.baud)
        ports.append(NoisyPort(inner, every, seed + len(ports)))
        return Target(ports[-1], url, is_builtin=True, is_lossless=False)

    result = Engine(options, open_noisy).run(lambda event: None)
    assert sum(port.hits for port in ports) > 0, "there was noise"
    return result


@pytest.mark.parametrize(
    ("every", "least_judged"), [(5000, 100), pytest.param(500, 60, marks=pytest.mark.soak)]
)
def test_a_healthy_twin_never_fails_behind_a_noisy_line(every: int, least_judged: int) -> None:
    """Lost, late and corrupted bytes cost time and certainty, never a verdict."""
    for seed in (1, 2):
        result = noisy_run(every, seed)
        verdicts = [one.verdict for one in result.requirements]
        assert Verdict.FAIL not in verdicts
        quirks = [one.reason for one in result.requirements if one.verdict is Verdict.QUIRK]
        # The time to start is measured by polling, and told as measured.
        assert all(reason.startswith("boot_time_ms=") for reason in quirks)
        assert verdicts.count(Verdict.PASS) >= least_judged
        assert result.exit_status in (0, 4)


@pytest.mark.soak
def test_a_line_that_spoils_every_other_exchange_still_gets_an_honest_end() -> None:
    """One byte in 50: the run ends, what could not be settled is inconclusive, k of n is told."""
    for seed in (1, 2):
        result = noisy_run(50, seed)
        verdicts = [one.verdict for one in result.requirements]
        assert Verdict.FAIL not in verdicts
        assert Verdict.INCONCLUSIVE in verdicts
        assert result.exit_status == 4
        texts = [one.reason for one in result.requirements if one.verdict is Verdict.INCONCLUSIVE]
        assert any("not settled in" in text for text in texts)


@pytest.mark.parametrize("every", [500, 5000])
def test_noise_does_not_hide_another_reading(every: int) -> None:
    """A device that does not follow the default never passes for one that does."""
    for seed in range(3):
        result = noisy_run(every, seed, "MACS-REPLY-01", xon_byte="11h")
        assert result.readings["xon_byte"] == "11h"
        assert all(one.verdict is not Verdict.FAIL for one in result.requirements)


# --- when a result is believed -------------------------------------------------------------------


def attempt(
    verdict: Verdict = Verdict.PASS,
    *,
    retries: tuple[str, ...] = (),
    disturbance: str = "",
    place: bytes = b"here",
    spoilt: tuple[str, ...] = (),
    outcome: Outcome = Outcome.DONE,
) -> Callable[[bool], Attempt]:
    """One attempt of a check that ends like this."""

    def made(is_strict: bool) -> Attempt:
        said = Verdict.INCONCLUSIVE if disturbance else verdict
        finding = Finding("MACS-LINE-01", said, "text", ("7",), "8")
        trouble = disturbance or ("crash" if outcome is Outcome.ERROR else "")
        end = Outcome.TROUBLE if disturbance else outcome
        result = CheckResult(CHECK, end, (finding,), retries, 0.0, trouble)
        return Attempt(
            result, disturbance, {}, is_strict, spoilt, place if said is Verdict.FAIL else b""
        )

    return made


class FakeCheck:
    """As much of a check as judging its attempts needs."""

    requirements = ("MACS-LINE-01",)


CHECK: Any = FakeCheck()
PASSES, FAILS = attempt(), attempt(Verdict.FAIL)
RETRIED = attempt(retries=("20h: silence",))
VOID = attempt(disturbance="13h: silence")


def settled(
    *attempts: Callable[[bool], Attempt], quality: LineQuality | None = None
) -> tuple[Verdict, int, list[bool]]:
    """Play these attempts (the last one again and again); the verdict, how many were needed, and
    which of them were strict."""
    asked: list[bool] = []

    def one(is_strict: bool) -> Attempt:
        asked.append(is_strict)
        return attempts[min(len(asked), len(attempts)) - 1](is_strict)

    result = Replays(one, lambda: True, quality or LineQuality(10_000, 0)).settle()
    return result.verdict, len(asked), asked


def test_a_clean_pass_is_believed_at_once() -> None:
    """No replay without a reason."""
    assert settled(PASSES) == (Verdict.PASS, 1, [False])


def test_a_failure_needs_three_of_three() -> None:
    """The same thing three times is the device's."""
    assert settled(FAILS)[:2] == (Verdict.FAIL, noise.LEAST_ALIKE)


def test_a_failure_that_comes_and_goes_on_a_quiet_line_is_inconclusive() -> None:
    """Neither a pass nor a fail: the device does not hold still."""
    verdict, count, _ = settled(FAILS, PASSES)
    assert verdict is Verdict.INCONCLUSIVE
    assert count == noise.MOST_ATTEMPTS


def test_on_a_noisy_line_a_failure_that_does_not_come_again_was_noise() -> None:
    """Enough quiet passes outvote it."""
    noisy = LineQuality(10_000, 100)
    assert settled(FAILS, PASSES, quality=noisy)[0] is Verdict.PASS


def test_failures_at_different_places_are_not_the_device() -> None:
    """Noise hits here and there."""
    wandering = [attempt(Verdict.FAIL, place=bytes([number])) for number in range(10)]
    assert settled(*wandering)[0] is Verdict.INCONCLUSIVE


def test_the_noisier_the_line_the_more_must_agree() -> None:
    """Three of three mean nothing where every other exchange is spoilt."""
    assert settled(FAILS, quality=LineQuality(1000, 50))[:2] == (Verdict.FAIL, 5)
    assert settled(FAILS, quality=LineQuality(1000, 400))[0] is Verdict.INCONCLUSIVE


def test_a_void_attempt_is_replayed() -> None:
    """It tells nothing either way."""
    assert settled(VOID, VOID, PASSES)[:2] == (Verdict.PASS, 3)


def test_what_is_polled_all_the_time_is_not_wrong_the_same_time_twice_by_noise() -> None:
    """The same frame spoilt in each strict attempt, but another time: the pass stands."""
    hits = [attempt(Verdict.FAIL, spoilt=(f"20h, time {number}: ",)) for number in (7, 90, 31)]
    assert settled(RETRIED, *hits)[0] is Verdict.PASS


def test_what_breaks_off_at_one_place_every_time_is_then_judged_as_it_comes() -> None:
    """A device that never answers 13h is no noisy line."""
    strictly_silent = attempt(Verdict.FAIL, spoilt=("13h: ",))
    verdict, count, strict = settled(VOID, VOID, VOID, strictly_silent)
    assert (verdict, count) == (Verdict.FAIL, 6)
    assert strict == [False] * 3 + [True] * 3


def test_a_pass_by_asking_again_is_checked_without_asking_again() -> None:
    """A device whose fault is cured by asking again must not pass for noise."""
    cured = attempt(Verdict.FAIL, spoilt=("20h: 15",))
    assert settled(RETRIED, cured)[:2] == (Verdict.FAIL, 4)
    assert settled(RETRIED, PASSES)[:2] == (Verdict.PASS, 2)


def test_strict_attempts_that_fail_each_in_its_own_way_leave_the_pass_standing() -> None:
    """That is what noise looks like."""
    wandering = [attempt(Verdict.FAIL, spoilt=(str(number),)) for number in range(3)]
    assert settled(RETRIED, *wandering)[:2] == (Verdict.PASS, 4)


def test_a_crash_over_spoilt_bytes_is_void_and_one_without_is_told() -> None:
    """A mistake of the suite is only believed when nothing else explains it."""
    assert settled(attempt(outcome=Outcome.ERROR, spoilt=("x",)), PASSES)[0] is Verdict.PASS
    assert settled(attempt(outcome=Outcome.ERROR))[1] == 1


def test_a_device_that_is_lost_between_attempts_is_not_replayed() -> None:
    """The engine finds out and says so."""
    asked = []

    def one(is_strict: bool) -> Attempt:
        asked.append(is_strict)
        return FAILS(is_strict)

    result = Replays(one, lambda: False, LineQuality()).settle()
    assert len(asked) == 1
    assert result.verdict is Verdict.FAIL, "for the engine to withdraw"
