"""Noise and damaged packets do not disturb a board: each answer in its turn, and nothing grows."""

import gc
import itertools
import random
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator

import pytest
from mn400_bench import Mn400Bench
from mn400_lines import Heard, ReferenceReceiver, drawn_line
from mutated_bytes import mutated

from axistwin.devices.mn400.device import Mn400Board
from axistwin.devices.mn400.link.packets import packet
from axistwin.kernel.effects import Effect, Transmit

START = 0x03
ALONE = (0x07, 0x0C, 0x13, 0x15)
"""What may come without START."""
LISTING = ord("R")
VALUES = "/?SNE[:"


def noise(rng: random.Random, total: int) -> Iterator[bytes]:
    """Random stretches and packets, good and mutated, ``total`` bytes in all.

    Only good packets set number and rate, to what they are: else nobody would be there any more.
    """
    sent = 0
    while sent < total:
        kind = rng.random()
        if kind < 0.02:
            piece = packet(1, rng.choice((b"=1", b"~0", b"Q", b"J0", b"H0", b".")))
        else:
            piece = noisy_piece(rng, kind).replace(b"=", b"<").replace(b"~", b"^")
        sent += len(piece)
        yield piece


def noisy_piece(rng: random.Random, kind: float) -> bytes:
    """A random stretch, or a packet; ``kind`` [0..1) decides."""
    if kind < 0.023:
        return rng.randbytes(3000)
    if kind < 0.12:
        return rng.randbytes(3)
    good = packet(rng.choice((1, 1, 1, 1, 0, 2)), drawn_line(rng))
    return good if rng.random() < 0.3 else mutated(good, rng)


class TurnJudge:
    """Holds what a board sends to what it has heard: each answer whole, one by one, in order."""

    def __init__(self) -> None:
        self._rest = b""
        self._due: deque[Heard] = deque()
        self._has_started = False
        self.packets = 0

    @property
    def _is_listing(self) -> bool:
        return self._has_started and self._due[0].command == LISTING

    @property
    def is_even(self) -> bool:
        """Whether all is answered; of a listing nobody knows the end."""
        return not self._rest and len(self._due) == self._is_listing

    def expect(self, heard: Iterable[Heard]) -> None:
        """What it has to answer."""
        self._due.extend(heard)

    def take(self, data: bytes) -> None:
        """What it has sent."""
        data, at = self._rest + data, 0
        while at < len(data):
            assert data[at] == 0x81, data[at : at + 20]
            close = data.find(b"\x81", at + 1)
            if close < 0 or close + 1 >= len(data):
                break
            raw = data[at : close + 2]
            assert sum(raw[:-1]) & 0x7F == raw[-1], ("a wrong sum", raw)
            self._judge(raw)
            at = close + 2
        self._rest = data[at:]

    def _judge(self, raw: bytes) -> None:
        """One packet: an answer to what is next, or a part of it."""
        self.packets += 1
        is_status = len(raw) == 6 and raw[2] < 0x20
        code = raw[2] if is_status else 0
        if self._is_listing:
            if raw[1] == LISTING and not is_status:
                return
            if raw[1] != LISTING or code in (START, *ALONE):
                self._pass_on()
        assert self._due, ("out of turn", raw)
        heard = self._due[0]
        assert raw[1] == heard.command, ("out of turn", raw, heard)
        if heard.flaw:
            assert code == heard.flaw, ("another answer", raw, heard)
        elif self._has_started:
            assert code != START, ("START twice", raw, heard)
            assert is_status or chr(heard.command) in VALUES, ("no value", raw, heard)
        elif heard.payload != b"&" and code not in ALONE:
            assert code == START, ("without START", raw, heard)
            self._has_started = True
            return
        self._pass_on()

    def _pass_on(self) -> None:
        self._due.popleft()
        self._has_started = False


def assert_bounded(bench: Mn400Bench) -> None:
    """Queue, contour buffer and store hold no more than they can."""
    quirks, device = bench.quirks, bench.device
    assert len(device.mover.queue) <= quirks.queue_depth
    contour = device.interpreter.contour
    assert contour is None or len(contour.segments) <= quirks.cc_capacity
    assert device.store.used <= quirks.nvm_size


def flood(bench: Mn400Bench, seed: int, total: int) -> tuple[int, int]:
    """Send that noise; (packets that came back, blocks of memory more than after half of it)."""
    rng, judge, reference = random.Random(seed), TurnJudge(), ReferenceReceiver(1)
    bench.say("*")  # so that there is a last message
    sent = early_blocks = 0
    for number, piece in enumerate(noise(rng, total)):
        bench.network.run_until(bench.send(piece))
        judge.expect(reference.take(piece))
        is_pause = number % 16 == 0
        heard = bench.wait(600 if is_pause else rng.choice((0, 0, 5, 50)))
        judge.expect(reference.give_up() if is_pause else ())
        judge.take(heard)
        if is_pause:
            settle(bench, judge)
        sent += len(piece)
        if not early_blocks and sent > total // 2:
            gc.collect()
            early_blocks = sys.getallocatedblocks()
    heard = bench.wait(600)
    judge.expect(reference.give_up())
    judge.take(heard)
    settle(bench, judge)
    gc.collect()
    return judge.packets, sys.getallocatedblocks() - early_blocks


def settle(bench: Mn400Bench, judge: TurnJudge) -> None:
    """Let everything be answered; look at what is kept, and drop what the bench keeps."""
    while not judge.is_even:
        heard = bench.wait(3000)
        assert heard, "no answer to what is due"
        judge.take(heard)
    assert_bounded(bench)
    bench.network.take_effects()
    for device in bench.devices:
        device.sent.clear()
        device.stored.clear()


@pytest.mark.parametrize(
    "total",
    [
        pytest.param(200_000, marks=pytest.mark.strength),
        pytest.param(10_000_000, marks=pytest.mark.soak),
    ],
)
def test_noise_leaves_a_board_that_answers_in_its_turn(total: int) -> None:
    """No exception, no byte out of turn, flat memory, bounded buffers, a poll is answered then."""
    bench = Mn400Bench()
    packets, growth = flood(bench, 2018, total)
    assert packets > total // 40, "the noise hardly reached the board"
    assert growth < 20_000, f"{growth} more objects than after half of the noise"
    bench.power_cycle()
    bench.wait(600_000)  # its configuration answers, and may enter a contour or hold a motion
    bench.say("Q", "K", "Q", "H0", milliseconds=1000)
    assert bench.say("*", milliseconds=1000) == "S PR"


@pytest.mark.strength
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda effect: [], "no answer|out of turn|without START"),
        (lambda effect: [effect, effect], "out of turn|START twice|another answer"),
        (lambda effect: [effect._replace(data=effect.data[:-1] + b"\x7f")], "a wrong sum"),
    ],
    ids=["lost", "doubled", "corrupted"],
)
def test_a_board_that_answers_wrongly_is_noticed(
    spoil: Callable[[Transmit], list[Transmit]], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each hundredth packet is lost, comes twice, or has another sum."""
    real, count = Mn400Board._taken, itertools.count(1)

    def taken(board: Mn400Board) -> list[Effect]:
        effects = real(board)
        return [
            each
            for effect in effects
            for each in (
                spoil(effect)
                if isinstance(effect, Transmit) and next(count) % 100 == 0
                else [effect]
            )
        ]

    monkeypatch.setattr(Mn400Board, "_taken", taken)
    with pytest.raises(AssertionError, match=words):
        flood(Mn400Bench(), 1, 20_000)
