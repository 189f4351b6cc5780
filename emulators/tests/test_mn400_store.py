"""The store of an MN400: two programs that share 8 KiB."""

from axistwin.devices.mn400.quirks import parse_quirks
from axistwin.devices.mn400.store import Part, ProgramStore
from axistwin.devices.switches import Value


def store(**settings: Value) -> ProgramStore:
    """An empty one."""
    return ProgramStore(parse_quirks(settings))


def enter(kept: ProgramStore, part: Part, *lines: bytes) -> int:
    """Enter a program; returns how many lines found room."""
    kept.begin(part)
    stored = sum(kept.add(part, line) is not None for line in lines)
    kept.end(part)
    return stored


def test_a_program_replaces_its_predecessor_when_its_entry_ends() -> None:
    """Until then the predecessor is there."""
    kept = store()
    enter(kept, "program", b"M1000", b"m-1000")
    kept.begin("program")
    kept.add("program", b"V5")
    assert kept.lines("program") == (b"M1000", b"m-1000")
    assert kept.end("program")
    assert kept.lines("program") == (b"V5",)


def test_the_programs_share_the_room() -> None:
    """A configuration of k bytes leaves k bytes less."""
    kept = store()
    assert enter(kept, "program", *[b"M1"] * 3000) == 8192 // 3
    enter(kept, "program")
    enter(kept, "config", b"=5", b"~4")
    assert enter(kept, "program", *[b"M1"] * 3000) == (8192 - 6) // 3
    assert kept.used == 6 + 3 * 2728


def test_a_line_that_does_not_fit_leaves_the_earlier_ones() -> None:
    """A shorter one may still fit."""
    kept = store(nvm_size=16)
    assert enter(kept, "program", b"M1,2,3,4", b"M1,2,3,4", b"V5") == 2
    assert kept.lines("program") == (b"M1,2,3,4", b"V5")


def test_a_line_may_take_more_room() -> None:
    """The overhead is a quirk."""
    kept = store(nvm_size=16, nvm_line_overhead=4)
    assert enter(kept, "program", *[b"M123"] * 3) == 2


def test_what_was_stored_is_there_in_the_next_life() -> None:
    """Both programs, and nothing of longer ones before."""
    kept = store()
    enter(kept, "program", b"V1", b"V2", b"V3")
    enter(kept, "program", b"M,,5")
    enter(kept, "config", b"=5")
    cells = kept.cells()
    again = store()
    again.restore(cells)
    assert again.lines("program") == (b"M,,5",)
    assert again.lines("config") == (b"=5",)
    assert again.cells() == cells


def test_only_cells_that_differ_are_stored() -> None:
    """At the end of the entry, or line by line."""
    kept = store()
    enter(kept, "program", b"V1", b"V2")
    kept.begin("program")
    assert kept.add("program", b"V1") == ()
    assert [name for name, _ in kept.end("program")] == ["program_00001"]
    each = store(nvm_commit="per_line")
    assert each.begin("config") == ()
    assert each.add("config", b"=5")
    assert each.lines("config") == (b"=5",)


def test_cells_that_are_no_program_are_left_out() -> None:
    """A hole, or a number that is no line."""
    for cells in ({"program_00000": 0, "program_00001": 0x14D}, {"program_00000": 0x24D}):
        kept = store()
        kept.restore(cells)
        assert kept.lines("program") == ()
