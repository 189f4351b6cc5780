"""The requirement ledger as data."""

from __future__ import annotations

import re
from collections import Counter

import pytest

from axistwin_conformance.base import ledger as ledger_module
from axistwin_conformance.base.ledger import RequirementKind, load_ledger, parse_ledger
from axistwin_conformance.families.catalog import families

LEDGERS = sorted({family.name for family in families()} | {"mac_can", "mn400"})
# How many requirements each chapter of the CAN ledger has.
CAN_CHAPTERS = {
    "ID": 3, "SDO": 14, "BOOT": 4, "EMCY": 5, "SYNC": 5, "LMT": 9, "GEN": 3, "CMD": 32, "Q": 11,
    "STATE": 2, "STOP": 1, "REF": 1, "BUSY": 1, "PERS": 2,
}  # fmt: skip
# How many each chapter of the MSC ledger has, in its order.
MSC_CHAPTERS = {
    "PHY": 5, "PKT": 21, "LNK": 24, "CMD": 12, "BREAD": 5, "BWRITE": 7, "CFLAG": 3, "DREAD": 4,
    "DWRITE": 5, "RFLAG": 2, "RFLAGS": 3, "RQSTAT": 3, "SFLAG": 3, "STA": 4, "MOD": 2, "DAT": 3,
    "FLG": 3, "PROP": 16,
}  # fmt: skip
# How many each chapter of the MN400 ledger has, in its order.
MN4_CHAPTERS = {
    "PHY": 5, "PKT": 15, "RSP": 15, "ERR": 6, "PAR": 10, "USB": 8, "CMD-M": 4, "CMD-A": 5,
    "CMD-HEL": 4, "CMD-CC": 9, "CMD-T": 3, "CMD-Q": 5, "CMD-PAU": 4, "CMD-H": 3, "CMD-K": 3,
    "CMD-J": 1, "CMD-U": 2, "CMD-V": 5, "CMD-F": 3, "CMD-I": 4, "CMD-L": 3, "CMD-P": 3,
    "CMD-X": 1, "CMD-B": 2, "CMD-D": 2, "CMD-G": 2, "CMD-Y": 1, "CMD-FH": 2, "CMD-C": 3,
    "CMD-ADDR": 4, "CMD-BAUD": 4, "CMD-E": 4, "CMD-N": 3, "CMD-S": 2, "CMD-EXIT": 4, "CMD-SHD": 1,
    "CMD-SW": 2, "CMD-FW": 1, "CMD-POLL": 2, "CMD-RTX": 4, "NVM": 13, "PWR": 3, "STM": 8,
    "MOT": 12, "ARC": 9, "HEL": 5, "CC": 10, "BKL": 7, "MEA": 6, "PAU": 5, "QUIT": 2, "LIM": 8,
    "SHD": 4, "JOG": 8, "THR": 6, "SYN": 2, "IO": 3, "DROP": 12,
}  # fmt: skip
MN4_GAP = range(7, 10)  # the rules of ramps begin at MOT-10
ENTRY = """
[requirement.A-1]
kind = "must"
safety = "passive"
source = "S II"
text = "It answers."
quirks = ["AMB-1"]
[ambiguity.AMB-1]
question = "how"
detect = "look"
switches.manner = ["kindly", "rudely"]
"""


@pytest.mark.parametrize("name", LEDGERS)
def test_a_shipped_ledger_says_all_it_must_of_every_requirement(name: str) -> None:
    """Each requirement has text and source, and is either observable or says why not."""
    for one in load_ledger(name).requirements.values():
        assert one.text.endswith("."), one.id
        assert one.source, one.id
        assert one.safety, one.id
        assert one.observable or one.not_on_wire, one.id


@pytest.mark.parametrize("name", LEDGERS)
def test_an_ambiguity_named_in_a_reason_exists(name: str) -> None:
    """Prose that points at an ambiguity points at one the ledger has."""
    ledger = load_ledger(name)
    for one in ledger.requirements.values():
        assert set(re.findall(r"\w+-AMB-\d\d", one.not_on_wire)) <= set(ledger.ambiguities)


def test_the_mac_serial_ledger_is_complete_in_number() -> None:
    """136 requirements, 77 ambiguities and 1 more: a lost entry is noticed."""
    ledger = load_ledger("mac_serial")
    assert len(ledger.requirements) == 136
    assert len(ledger.ambiguities) == 78


def test_the_mac_can_ledger_is_complete_in_number() -> None:
    """Every chapter has its requirements; 32 ambiguities are CAN's own."""
    ledger = load_ledger("mac_can")
    assert Counter(key.split("-")[1] for key in ledger.requirements) == CAN_CHAPTERS
    numbers = [f"MACC-AMB-{number:02d}" for number in range(1, 33)]
    assert [key for key in ledger.ambiguities if key.startswith("MACC-")] == numbers


def test_the_mac_can_ledger_numbers_without_a_gap() -> None:
    """MACC-SDO-01 to -14 and so on: a lost entry is named."""
    ledger = load_ledger("mac_can")
    for chapter in ("ID", "SDO", "BOOT", "EMCY", "SYNC", "LMT", "GEN"):
        numbers = [f"MACC-{chapter}-{n:02d}" for n in range(1, CAN_CHAPTERS[chapter] + 1)]
        assert [key for key in ledger.requirements if key.split("-")[1] == chapter] == numbers


def test_the_msc_ledger_is_complete_and_numbers_without_a_gap() -> None:
    """Every chapter has its requirements, and there are 45 ambiguities."""
    ledger = load_ledger("msc")
    named = [f"MSC-{chapter}-{n:02d}" for chapter, n in MSC_CHAPTERS.items()
             for n in range(1, n + 1)]  # fmt: skip
    assert list(ledger.requirements) == named
    assert list(ledger.ambiguities) == [f"MSC-AMB-{number:02d}" for number in range(1, 46)]


def test_the_mn400_ledger_is_complete_and_numbers_without_a_gap() -> None:
    """287 requirements in 58 chapters, and 75 ambiguities, of which only slips have no switch."""
    ledger = load_ledger("mn400")
    named = [f"MN4-{chapter}-{n:02d}" for chapter, count in MN4_CHAPTERS.items()
             for n in _mn4_numbers(chapter, count)]  # fmt: skip
    assert list(ledger.requirements) == named
    assert len(named) == 287
    assert list(ledger.ambiguities) == [f"MN4-AMB-{number:02d}" for number in range(1, 76)]
    bare = [key for key, one in ledger.ambiguities.items() if not one.switches]
    assert bare == ["MN4-AMB-21", "MN4-AMB-64"]


def _mn4_numbers(chapter: str, count: int) -> list[int]:
    gap = MN4_GAP if chapter == "MOT" else range(0)
    return [n for n in range(1, count + len(gap) + 1) if n not in gap]


def test_what_the_axis_leaves_open_is_left_open_on_both_wires() -> None:
    """The CAN ledger takes the axis's ambiguities over from the serial one, readings and all."""
    serial, can = load_ledger("mac_serial").ambiguities, load_ledger("mac_can").ambiguities
    shared = [key for key in can if key in serial]
    assert len(shared) == 46
    for key in shared:
        assert set(can[key].switches) <= set(serial[key].switches), key
        assert all(can[key].switches[one] == serial[key].switches[one] for one in can[key].switches)
    assert can["MACS-AMB-28"] == serial["MACS-AMB-28"]
    assert set(can["MACS-AMB-08"].switches) == {"motion_lock_set"}


def test_a_question_that_can_does_not_ask_is_known_and_has_its_default() -> None:
    """Not so a switch that neither ledger has."""
    can, serial = load_ledger("mac_can"), load_ledger("mac_serial")
    assert not can.asks("cmd_1c_supported")
    assert can.asks("motion_lock_set")
    assert serial.asks("cmd_1c_supported")
    assert can.asks("boot_time_ms")  # under an ambiguity of its own
    assert can.ambiguity_of("boot_time_ms").id == "MACC-AMB-25"
    assert can.ambiguity_of("cmd_1c_supported").default_of("cmd_1c_supported") == "true"
    for ledger in (can, serial):
        with pytest.raises(ValueError, match="has a switch 'cmd_1c_suported'"):
            ledger.asks("cmd_1c_suported")


def test_entries_are_read() -> None:
    """Kind, safety and switches arrive as values."""
    ledger = parse_ledger("toy", ENTRY)
    assert ledger.requirements["A-1"].kind is RequirementKind.MUST
    assert ledger.requirements["A-1"].safety == {"passive"}
    assert ledger.ambiguity_of("manner").default_of("manner") == "kindly"


@pytest.mark.parametrize(
    ("good", "bad", "complaint"),
    [
        ('kind = "must"', 'kind = "maybe"', "A-1"),
        ('safety = "passive"', 'safety = "daring"', "daring"),
        ('source = "S II"', "", "source"),
        ('quirks = ["AMB-1"]', 'quirks = ["AMB-2"]', "AMB-2"),
        ('["kindly", "rudely"]', "[]", "AMB-1"),
        ('detect = "look"', 'detect = "look"\ndeparts = ["A-9"]', "A-9"),
        ('detect = "look"', "", "detect"),
    ],
)
def test_an_entry_that_contradicts_itself_is_refused(good: str, bad: str, complaint: str) -> None:
    """The message names the entry or the word that is wrong."""
    with pytest.raises(ValueError, match=complaint):
        parse_ledger("toy", ENTRY.replace(good, bad))


def test_an_ambiguity_of_another_ledger_is_taken_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """Question, switches and detect; what is said here takes the place of what is said there."""
    monkeypatch.setattr(ledger_module, "load_ledger", lambda name: parse_ledger(name, ENTRY))
    same = '[ambiguity.AMB-1]\nsame_as = "toy"\n'
    plain = parse_ledger("other", f"[requirement]\n{same}").ambiguities["AMB-1"]
    assert plain == parse_ledger("toy", ENTRY).ambiguities["AMB-1"]
    own = f'[requirement]\n{same}question = "why"\nwithout = ["manner"]\n'
    changed = parse_ledger("other", own).ambiguities["AMB-1"]
    assert (changed.question, changed.detect, changed.switches) == ("why", "look", {})


@pytest.mark.parametrize(
    ("key", "words", "complaint"),
    [
        ("AMB-2", "", "toy has none of that id"),
        ("AMB-1", 'switches.manner = ["kindly"]', "use without"),
        ("AMB-1", 'without = ["mood"]', "without mood"),
        ("AMB-1", 'departs = ["A-1"]', "A-1"),
    ],
)
def test_what_cannot_be_taken_over_is_refused(
    key: str, words: str, complaint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An id, a switch or a requirement that is not there."""
    monkeypatch.setattr(ledger_module, "load_ledger", lambda name: parse_ledger(name, ENTRY))
    text = f'[requirement]\n[ambiguity.{key}]\nsame_as = "toy"\n{words}\n'
    with pytest.raises(ValueError, match=complaint):
        parse_ledger("other", text)


def test_a_switch_belongs_to_one_ambiguity() -> None:
    """Two lists of readings for one switch would contradict one another."""
    again = '[ambiguity.AMB-2]\nquestion = "q"\ndetect = "d"\nswitches.manner = ["x"]\n'
    with pytest.raises(ValueError, match=r"AMB-2: the switch manner belongs to AMB-1"):
        parse_ledger("toy", ENTRY + again)


def test_an_unknown_switch_or_reading_is_our_mistake() -> None:
    """Checks cannot invent readings."""
    ledger = parse_ledger("toy", ENTRY)
    with pytest.raises(ValueError, match="mood"):
        ledger.ambiguity_of("mood")
    with pytest.raises(ValueError, match="loudly"):
        ledger.ambiguity_of("manner").check_reading("manner", "loudly")


def test_a_star_admits_any_reading() -> None:
    """A measured value need not be listed."""
    ledger = parse_ledger("toy", ENTRY.replace('"rudely"', '"*"'))
    ledger.ambiguity_of("manner").check_reading("manner", "1.5 s")
