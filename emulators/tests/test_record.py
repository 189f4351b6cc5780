import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin.memory.record import (
    ENTRY_SIZE,
    Record,
    RecordError,
    decode,
    decode_entry,
    encode,
    encode_entry,
)

CELLS = {"position": -12_345, "address": 5, "superior_stop": 0x3FFF_FFFF}
RECORD = Record("mac23", 41, CELLS)

cells = st.dictionaries(st.text(max_size=12), st.integers(-(2**40), 2**40), max_size=12)
sequences = st.integers(1, 2**62)


@pytest.mark.strength
@given(cells, sequences)
def test_a_record_reads_back_as_it_was_written(values: dict[str, int], sequence: int) -> None:
    """Any cells and any sequence number survive the way through text."""
    record = Record("mac34-1", sequence, values)
    assert decode(encode(record), "mac34-1") == record


@given(st.dictionaries(st.sampled_from("abc"), st.integers(-(2**40), 2**40)), sequences)
def test_an_entry_reads_back_and_has_its_fixed_size(values: dict[str, int], sequence: int) -> None:
    """Entries can be overwritten in place: all have one size."""
    record = Record("mac34-1", sequence, values)
    data = encode_entry(record)
    assert data is not None
    assert len(data) == ENTRY_SIZE
    assert decode_entry(data, "mac34-1") == record


def test_cells_that_do_not_fit_an_entry_are_told_apart() -> None:
    """Too many cells for the fixed size give None, never a cut text."""
    assert encode_entry(Record("mac23", 1, {f"cell_{i}": i for i in range(40)})) is None


def test_a_record_is_text_for_people_and_independent_of_the_order_of_cells() -> None:
    """One cell a line, sorted, so that two records can be compared with diff."""
    data = encode(RECORD)
    assert b'\n    "position": -12345,\n' in data
    assert data == encode(Record("mac23", 41, dict(sorted(CELLS.items(), reverse=True))))
    assert json.loads(data)["cells"] == CELLS


@pytest.mark.parametrize("form", ["record", "entry"])
def test_every_torn_record_is_refused(form: str) -> None:
    """Cut anywhere, the text is no record."""
    data, read = _written(form)
    for length in range(len(data)):
        with pytest.raises(RecordError):
            read(data[:length])


@pytest.mark.parametrize("form", ["record", "entry"])
def test_every_flipped_bit_and_every_changed_byte_is_noticed(form: str) -> None:
    """No single byte can change without the record being refused."""
    data, read = _written(form)
    for place in range(len(data)):
        for change in (1, 2, 4, 8, 16, 32, 64, 128, 0xFF):
            damaged = bytearray(data)
            damaged[place] ^= change
            with pytest.raises(RecordError):
                read(bytes(damaged))


def test_appended_bytes_are_noticed() -> None:
    """Even a blank at the end is not what was written."""
    for tail in (b" ", b"\n", b"{}", b"\0"):
        with pytest.raises(RecordError):
            decode(encode(RECORD) + tail, "mac23")


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "it is empty"),
        (b"\0" * 300, "no axistwin state"),
        (b"[1, 2]\n", "no axistwin state"),
        (b"[" * 100_000, "no axistwin state"),
        (b"hello\n", "no axistwin state"),
        (b'{"format": "something else"}\n', "no axistwin state"),
        (encode(RECORD)[:-20], "torn or damaged"),
        (encode(RECORD).replace(b"-12345", b"-12346"), "checksum does not fit"),
        (encode(RECORD).replace(b"-12345", b"true"), "impossible value"),
        (encode(RECORD).replace(b"-12345", b"1e3"), "impossible value"),
    ],
)
def test_the_reason_is_told(data: bytes, reason: str) -> None:
    """Foreign, torn and damaged texts are told apart in plain words."""
    with pytest.raises(RecordError, match=reason):
        decode(data, "mac23")


def test_a_record_of_another_model_is_refused_by_name() -> None:
    """Both models are named."""
    with pytest.raises(RecordError, match="belongs to a mac23, not to a mac34-1"):
        decode(encode(RECORD), "mac34-1")
    with pytest.raises(RecordError, match="belongs to a mac23, not to a mac34-1"):
        decode_entry(encode_entry(RECORD) or b"", "mac34-1")
    with pytest.raises(RecordError, match="belongs to a mac23, not to an msc-250"):
        decode(encode(RECORD), "msc-250")


def test_a_record_of_a_newer_program_is_refused_by_version(monkeypatch: pytest.MonkeyPatch) -> None:
    """A whole record of a later version is no damage."""
    monkeypatch.setattr("axistwin.memory.record.VERSION", 2)
    newer = encode(RECORD)
    monkeypatch.undo()
    with pytest.raises(RecordError, match="version 2, this program knows version 1"):
        decode(newer, "mac23")


def _written(form: str):  # type: ignore[no-untyped-def]
    """The bytes of RECORD in one of the two forms, and a reader for them."""
    if form == "record":
        return encode(RECORD), lambda data: decode(data, "mac23")
    data = encode_entry(RECORD)
    assert data is not None
    return data, lambda data: decode_entry(data, "mac23")


def test_a_version_changed_by_hand_is_named() -> None:
    """The checksum may be made in another way by then: it may be newer, or damaged."""
    data = encode(Record("mac23", 1, {"a": 1})).replace(b'"version": 1', b'"version": 2')
    with pytest.raises(RecordError, match=r"says version 2.* knows version 1: a newer axistwin"):
        decode(data, "mac23")
