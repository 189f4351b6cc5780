"""The line of a failure that sends its last requests again."""

import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from axistwin.cli.program import main
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.report.by_hand import last_requests
from axistwin_conformance.report.json import plain

RECORDED = sorted((Path(__file__).parent / "contracts" / "golden").glob("*-faulty*/told.txt"))


@pytest.mark.parametrize("path", RECORDED, ids=lambda path: path.parent.name)
def test_a_line_that_is_pasted_reproduces_the_exchange(path: Path) -> None:
    """Each failure of each record has one, and the requests that stand in its transcript."""
    text = path.read_text(encoding="utf-8")
    failures = re.split(r"^FAIL  ", text.replace(" \\\n", ""), flags=re.MULTILINE)[1:]
    assert failures
    for failure in failures:
        line = re.search(r"^   by hand     (.*)$", failure, re.MULTILINE)
        assert line is not None, failure
        program, *words = shlex.split(line[1])
        assert program == "axistwin"
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 0, result.output
        sent = re.findall(r"^> (\S+(?: \S+)*)", result.output, re.MULTILINE)
        said = re.findall(r"^ +[\d.]+  host     (.{3,}?)  ", failure, re.MULTILINE)
        shown = min(len(sent), len(said))  # of a transcript the decisive lines
        assert shown
        assert sent[-shown:] == said[-shown:]
        assert result.output.count("\n< ") == len(sent)


def test_an_acknowledgement_is_no_request() -> None:
    """Whoever sends by hand acknowledges anyway."""
    records = [
        Record(0, Direction.HOST, b"\x02\x01"),
        Record(1, Direction.DEVICE, b"\x06\x02"),
        Record(2, Direction.HOST, b"\x06"),
        Record(3, Direction.SILENCE, text="nothing within 1 s"),
    ]
    assert last_requests(plain(records)) == ["02 01"]
