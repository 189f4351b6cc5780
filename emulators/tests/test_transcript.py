"""What was said lately: put together late, and yet the same as if at once."""

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin.kernel.time import NS_PER_MS
from axistwin.runtime import transcript as transcript_module
from axistwin.runtime.transcript import Burst, Direction, Transcript

directions: st.SearchStrategy[Direction] = st.sampled_from(["host", "device"])

pieces = st.lists(
    st.tuples(
        st.sampled_from([0, NS_PER_MS, 6 * NS_PER_MS]),
        directions,
        st.sampled_from([b"", b"a", b"bc", b"x" * 200, b"y" * 600]),
        st.sampled_from(["", "", "", "look", "flush"]),
    ),
    max_size=60,
)

Pieces = list[tuple[int, Direction, bytes, str]]


@pytest.fixture(autouse=True, scope="module")
def few_pieces() -> Iterator[None]:
    """Pieces are put together after 8 of them, so that short scripts come to that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(transcript_module, "_PIECES_MAX", 8)
        yield


@given(pieces, st.integers(1, 5))
def test_late_bursts_are_those_of_a_transcript_that_reports_each_at_once(
    script: Pieces, limit: int
) -> None:
    """When pieces are joined makes no difference, nor does what is forgotten before that."""
    late, prompt = Transcript(limit), Transcript(limit)
    reported: list[Burst] = []
    prompt.subscribe(reported.append)
    now = 0
    for gap_ns, direction, data, action in script:
        now += gap_ns
        for transcript in (late, prompt):
            transcript.add(now, direction, data)
            if action == "flush":
                transcript.flush()
        if action == "look":
            assert list(late) == list(prompt)
    assert list(late) == list(prompt)
    prompt.flush()
    assert list(late) == reported[len(reported) - len(late) :]
    assert len(late) == min(limit, len(reported))


def test_what_is_not_looked_at_stays_bounded() -> None:
    """Pieces do not pile up."""
    transcript = Transcript(3)
    for number in range(1000):
        transcript.add(number, "host", b"x")
        assert len(transcript._pieces) <= 8


def test_clearing_forgets_pieces_too() -> None:
    """Nothing is left, and the next burst is a new one."""
    transcript = Transcript()
    transcript.add(0, "host", b"a")
    transcript.clear()
    assert len(transcript) == 0
    transcript.add(1, "host", b"b")
    assert [burst.data for burst in transcript] == [b"b"]


def test_who_records_may_be_more_patient() -> None:
    """A reply in late pieces stays one burst; it is reported once, when it is over."""
    for pause_ns, expected in ((5 * NS_PER_MS, [b"a", b"b"]), (50 * NS_PER_MS, [b"ab"])):
        transcript = Transcript(pause_ns=pause_ns)
        reported: list[Burst] = []
        transcript.subscribe(reported.append)
        transcript.add(0, "device", b"a")
        transcript.add(20 * NS_PER_MS, "device", b"b")
        assert [burst.data for burst in reported] == expected[:-1]
        transcript.flush()
        transcript.flush()
        assert [burst.data for burst in reported] == expected
