"""The log of the wire."""

from __future__ import annotations

from axistwin_conformance.base.transcript import Direction, Record, Transcript


def filled(kept: int, count: int) -> Transcript:
    """A transcript of `count` numbered notes."""
    transcript = Transcript(kept)
    for number in range(count):
        transcript.add(Record(number, Direction.NOTE, text=str(number)))
    return transcript


def test_an_excerpt_begins_at_its_mark() -> None:
    """`since` gives what was recorded after a position."""
    transcript = filled(100, 5)
    mark = transcript.position
    transcript.add(Record(9, Direction.HOST, b"x"))
    assert [one.data for one in transcript.since(mark)] == [b"x"]
    assert transcript.since(transcript.position) == ()


def test_an_excerpt_keeps_the_last_records_when_it_is_limited() -> None:
    """The end of a sequence matters more than its beginning."""
    assert [one.time_ns for one in filled(100, 5).since(0, limit=2)] == [3, 4]


def test_old_records_fall_out_and_marks_stay_valid() -> None:
    """Memory is bounded; a mark older than the log gives all there is."""
    transcript = filled(3, 10)
    assert len(transcript) == 3
    assert [one.time_ns for one in transcript.since(0)] == [7, 8, 9]
    assert [one.time_ns for one in transcript.since(8)] == [8, 9]


def test_a_reply_read_in_pieces_is_shown_whole() -> None:
    """With the time of its last byte; what comes much later, or after a request, is another."""
    transcript = Transcript()
    for time_ns, direction, data in (
        (0, Direction.HOST, b"?"),
        (1, Direction.DEVICE, b"a"),
        (2, Direction.DEVICE, b"b"),
        (200_000_000, Direction.DEVICE, b"c"),
        (200_000_001, Direction.HOST, b"!"),
        (200_000_002, Direction.DEVICE, b"d"),
    ):
        transcript.add(Record(time_ns, direction, data))
    shown = transcript.since(0)
    assert [one.data for one in shown] == [b"?", b"ab", b"c", b"!", b"d"]
    assert shown[1].time_ns == 2
    assert [one.data for one in transcript.since(0, limit=2)] == [b"!", b"d"]


def test_the_last_request_comes_with_what_followed_it() -> None:
    """Nothing where there is none, or one only before the last records that are looked at."""
    transcript = filled(100, 3)
    assert transcript.since_request(64) == ()
    for time_ns, data in enumerate((b"?", b"!"), 10):
        transcript.note(time_ns, Direction.HOST, data)
    transcript.note(20, Direction.DEVICE, b"a")
    transcript.note(21, Direction.DEVICE, b"b")
    assert [one.data for one in transcript.since_request(64)] == [b"!", b"ab"]
    assert len(transcript.since_request(3)) == 2
    assert transcript.since_request(2) == ()


def test_a_long_piece_belongs_to_the_reply_it_was_read_with() -> None:
    """136 bytes take 142 ms at 9600 baud; what comes as late without being as long is another."""
    transcript = Transcript()
    transcript.note(0, Direction.DEVICE, b"head")
    transcript.note(142_000_000, Direction.DEVICE, b"x" * 136)
    transcript.note(284_000_000, Direction.DEVICE, b"y")
    assert [len(one.data) for one in transcript.since(0)] == [140, 1]
