"""A soak: fresh seeds until the time is over, each of which can be run again alone."""

from __future__ import annotations

import itertools
import random
import shlex
import zlib
from collections.abc import Iterator
from typing import Any

import pytest

from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.base.events import CheckFinished, Note, SoakProgress, StatesCovered
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.session import Session
from axistwin_conformance.engine.plan import duration_word, make_plan
from axistwin_conformance.engine.soak import Soak, round_seed

LINE, FRAME = "MACS-LINE-01", "MACS-FRAME-01"
SHORT = {"level": "soak", "duration_s": 0.15}


def ask(session: Session) -> None:
    """It answers."""
    session.target.send(b"Q")
    session.expect(session.target.receive(1, 0.01) == b"q", LINE, "q", "")


def draws(session: Session) -> None:
    """It answers, whatever is drawn."""
    ask(session)
    counts = {"HD": {"ask": 1}}
    session.run.emit(StatesCovered("draws", 1, 1, counts))
    session.expect(session.random.randrange(8) != 0, FRAME, "1 to 7", 0)


def once(session: Session) -> None:
    """It answers once."""
    ask(session)


@pytest.fixture
def bench(toy: Any) -> Any:
    """A toy with a check that fails for one seed in eight, and one that draws nothing; each look at
    the clock of a soak takes a millisecond."""
    looks = itertools.count()
    toy.soak_clock = lambda: next(looks) / 1000
    toy.add(once, LINE)
    toy.add(draws, LINE, FRAME, soaks=True)
    return toy


def seeds_of(toy: Any) -> list[int]:
    """The seeds of the rounds."""
    return [one.seed for one in toy.seen(SoakProgress)]


def test_rounds_go_on_with_fresh_seeds_until_the_time_is_over(bench: Any) -> None:
    """Only what draws is repeated; the seeds follow from the run's."""
    bench.run(**SHORT)
    seeds = seeds_of(bench)
    assert len(seeds) > 3
    assert seeds == [round_seed(5, number) for number in range(1, len(seeds) + 1)]
    assert len(set(seeds)) == len(seeds)
    assert [one.name for one in bench.seen(CheckFinished)].count("once") == 1
    last = bench.seen(SoakProgress)[-1]
    assert 0 < last.elapsed_s < last.duration_s == 0.15


def test_a_round_that_fails_is_found_again_by_its_seed_alone(bench: Any) -> None:
    """Its replay command runs it without the rounds before."""
    failing = 0
    while round_seed(failing, 1) and not is_bad(round_seed(failing, 1)):
        failing += 1
    bench.run(**SHORT, seed=failing)
    found = next(
        one for one in bench.seen(CheckFinished) if one.verdict is Verdict.FAIL and "-" in one.name
    )
    assert found.name == f"draws-seed-{round_seed(failing, 1)}"
    words = shlex.split(found.replay)
    assert words == ["axistwin", "conform", "toy", "--seed", str(round_seed(failing, 1)), "draws"]
    bench.events.clear()
    result = bench.run(words=("draws",), seed=int(words[4]))
    assert result.exit_status == 1


def is_bad(seed: int) -> bool:
    """Whether the check fails with this seed."""
    return random.Random(seed << 32 | zlib.crc32(b"draws")).randrange(8) == 0


def test_what_was_found_before_is_only_counted(bench: Any) -> None:
    """One result for the first round that fails so; one that tells how often all held."""
    result = bench.run(**SHORT)
    names = [one.check.name for one in result.checks]
    assert sum(name.startswith("draws-seed-") for name in names) == 1
    assert names[-1] == "draws-soak"
    held = {one.requirement: one.text for one in result.checks[-1].findings}
    assert held[LINE].startswith("held in ")
    (note,) = [one.text for one in bench.seen(Note) if one.text.startswith("soak: ")]
    rounds = len(seeds_of(bench))
    bad = [seed for seed in seeds_of(bench) if is_bad(seed)]
    assert note.startswith(f"soak: {rounds} rounds in 0 s, seeds from 5; {len(bad)} went wrong")
    assert str(bad[0]) in note


def test_what_was_covered_is_told_once_in_all(bench: Any) -> None:
    """Summed up over the rounds."""
    bench.run(**SHORT)
    before, total = bench.seen(StatesCovered)
    assert before.sequences == 1
    assert total.sequences == len(seeds_of(bench))
    assert total.counts == {"HD": {"ask": total.sequences}}


def test_an_interrupt_ends_it_with_what_was_found(bench: Any) -> None:
    """Exit 130 as for every interrupt, and the rounds until then count."""
    rounds = iter(range(100))

    def broken_off(session: Session) -> None:
        """It is interrupted in the fifth round."""
        ask(session)
        if next(rounds) == 5:  # once in the run before the soak
            raise KeyboardInterrupt

    bench.add(broken_off, LINE, soaks=True)
    del bench.module.draws
    result = bench.run(level="soak", duration_s=3600.0)
    assert (result.exit_status, result.is_interrupted) == (130, True)
    (held,) = result.checks[-1].findings
    assert held.text == "held in 4 rounds"
    assert not bench.port.is_open


def test_the_first_failure_ends_it_if_that_is_wanted(bench: Any) -> None:
    """--exitfirst, in a soak of an hour."""
    result = bench.run(level="soak", duration_s=3600.0, is_exitfirst=True)
    assert result.exit_status == 1
    failed = [one for one in result.checks if one.verdict is Verdict.FAIL]
    assert len(failed) == 1
    assert sum(is_bad(seed) for seed in seeds_of(bench)) == len(seeds_of(bench) and failed)


def test_a_device_that_is_lost_ends_it(bench: Any) -> None:
    """Nothing is repeated on a line where nobody answers."""

    def loses(session: Session) -> None:
        """It answers until it is gone."""
        ask(session)
        session.target._port.is_mute = True  # type: ignore[attr-defined]

    bench.add(loses, LINE, soaks=True)
    result = bench.run(level="soak", duration_s=3600.0)
    assert "no longer answers" in "; ".join(result.problems)
    assert seeds_of(bench) == []


def test_a_soak_of_nothing_is_a_mistake_told_before_it_begins(bench: Any) -> None:
    """With the reason and what to allow."""
    options = bench.options(level="soak", words=("once",))
    with pytest.raises(UsageError, match="the IDs select no random sequences"):
        make_plan(options, bench_ledger(), bench.family.checks())
    del bench.module.draws
    bench.add(draws, FRAME, safety="motion", soaks=True)
    options = bench.options(level="soak", allowed=frozenset({"passive"}))
    with pytest.raises(UsageError, match="--allow motion"):
        make_plan(options, bench_ledger(), bench.family.checks())


def bench_ledger() -> Any:
    """The ledger of the toy."""
    return load_ledger("mac_serial")


def test_no_round_begins_after_the_end() -> None:
    """The clock is asked before each; the one that has begun is finished."""
    clock: Iterator[float] = iter([0.0, 1.0, 20.0, 39.0, 41.0, 41.0])
    soak = Soak((), 1, 40.0, lambda event: None, clock=lambda: next(clock))
    assert list(soak.rounds()) == []
    assert soak.rounds_done == 3


@pytest.mark.parametrize(
    ("seconds", "word"),
    [(7200.0, "2h"), (1800.0, "30m"), (45.0, "45s"), (5400.0, "90m"), (0.5, "0.5s")],
)
def test_a_duration_is_told_as_it_is_typed(seconds: float, word: str) -> None:
    """In the largest unit that makes it whole."""
    assert duration_word(seconds) == word


def test_the_command_of_a_soak_repeats_it(bench: Any) -> None:
    """Level and duration; the replay of a check asks for neither."""
    options = bench.options(**SHORT | {"duration_s": 1800.0})
    assert options.command == "axistwin conform toy --level soak --duration 30m --seed 5"
    assert options.replay(bench.family.checks()[0]) == "axistwin conform toy --seed 5 once"
