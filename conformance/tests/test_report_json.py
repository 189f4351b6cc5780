"""The stream of events as the one truth, and the report folded from it."""

from __future__ import annotations

import io
import json
import re
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import pytest
from click.testing import CliRunner

from axistwin_conformance.base import events
from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.base.events import FailureStored
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.cli import conform
from axistwin_conformance.report import json as report_json
from axistwin_conformance.report.json import FORMAT, JsonStream, fold, load
from axistwin_conformance.report.plot import is_inside
from axistwin_conformance.transport.kinds import BUS

DOCS = Path(__file__).parents[2] / "docs"
Told = list[dict[str, Any]]


def test_a_report_holds_what_the_events_told(wrong_run: Told) -> None:
    """Run, device, checks with their motions, readings, requirements, end; nothing is lost."""
    report = fold(wrong_run)
    assert report["format"] == FORMAT
    assert report["run"]["seed"] == 5
    assert report["run"]["command"] == "axistwin conform toy --seed 5"
    assert report["device"]["summary"] == "a toy"
    assert [one["name"] for one in report["checks"]][-1] == "_drifting"
    assert report["checks"][-1]["behaviour"] == "It would have to be at 20 after 2 ms."
    assert report["checks"][-1]["motions"] == [
        {
            "name": "move 1",
            "measured": [[1_000_000, 10], [2_000_000, 27]],
            "predicted": [[0, -1, 1], [1_000_000, 9, 11], [2_000_000, 19, 21]],
        }
    ]
    assert report["checks"][0]["motions"] == []
    assert [(one["switch"], one["reading"]) for one in report["readings"]] == [("xon_byte", "11h")]
    assert len(report["requirements"]) == 136
    assert report["finished"]["exit_status"] == 1


def test_requirements_tell_on_what_ground_they_stand(wrong_run: Told) -> None:
    """Kind, safety class, source, and why the wire cannot show the ones that it cannot."""
    told = {one["id"]: one for one in fold(wrong_run)["requirements"]}
    assert told["MACS-FRAME-01"]["kind"] == "must"
    assert told["MACS-FRAME-01"]["safety"] == ["passive"]
    assert told["MACS-FRAME-01"]["source"] == "S II, III"
    assert told["MACS-FRAME-01"]["verdict"] == "fail"


def test_bytes_are_told_in_hex_and_decoded(wrong_run: Told) -> None:
    """Time, direction, hex and words; notes and silences have words only."""
    [wrong] = [one for one in fold(wrong_run)["checks"] if one["name"] == "_wrong"]
    records = wrong["findings"][0]["transcript"]
    assert [(one["direction"], one["data"], one["decoded"]) for one in records[-2:]] == [
        ("host", "51", "the letter Q"),
        ("device", "71", "the letter q"),
    ]
    assert records[0]["decoded"] == ""
    assert records[1]["text"] == "the <question> & its answer"


@pytest.mark.parametrize("kind", get_args(events.Event))
def test_the_schema_is_documented_field_by_field(kind: type[Any]) -> None:
    """docs/reference/reports.md has a row for each event with all of its fields."""
    name = "_".join(re.findall("[A-Z][a-z]+", kind.__name__)).lower()
    lines = (DOCS / "reference" / "reports.md").read_text().splitlines()
    [row] = [line for line in lines if line.startswith(f"| `{name}` |")]
    assert [one.name for one in fields(kind) if f"`{one.name}`" not in row] == []


def test_every_event_is_a_line_at_once() -> None:
    """Who reads along need not wait for a buffer."""

    class Out(io.StringIO):
        flushed = 0

        def flush(self) -> None:
            self.flushed += 1

    out = Out()
    stream = JsonStream(out, lambda record: "said")
    stream(events.Note("µ"))
    stream(events.Note("b"))
    assert out.getvalue() == '{"event": "note", "text": "µ"}\n{"event": "note", "text": "b"}\n'
    assert out.flushed == 2


def test_a_record_is_explained_only_if_it_holds_bytes() -> None:
    """A silence is not put into other words."""
    explained = report_json.plain(Record(1, Direction.SILENCE, text="nothing"), lambda record: "x")
    assert explained == {
        "time_ns": 1, "direction": "silence", "data": "", "text": "nothing", "decoded": "",
    }  # fmt: skip


def test_a_report_and_its_events_load_the_same(wrong_run: Told, tmp_path: Path) -> None:
    """A run that was cut off leaves events only; they are as good."""
    lines = tmp_path / "events.jsonl"
    lines.write_text("\n".join(json.dumps(one) for one in wrong_run) + "\n")
    whole = tmp_path / "report.json"
    whole.write_text(report_json.to_text(fold(wrong_run)))
    assert load(lines) == load(whole) == fold(wrong_run)


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"{}", b"\xff\xfe", b'{"format": 2, "requirements": []}', b"{"]
)
def test_what_is_no_report_is_refused_in_a_line(tmp_path: Path, content: bytes) -> None:
    """With its name and what would be one."""
    (tmp_path / "other").write_bytes(content)
    with pytest.raises(UsageError, match="other is no report of a run"):
        load(tmp_path / "other")


def test_a_report_that_is_not_there_is_told_so(tmp_path: Path) -> None:
    """In the system's words."""
    with pytest.raises(UsageError, match="No such file"):
        load(tmp_path / "missing.json")


def test_the_readings_of_a_sound_twin_lie_in_the_bands_drawn_around_them() -> None:
    """What is drawn is what was judged: moves, endless motion, stops and segments."""
    checks = (
        "the_ramp_has_120_increments_per_unit", "moves_take_the_time_of_the_closed_form",
        "velocity_climbs_and_cruises_on_time", "a_ramped_stop_in_full_motion_takes_one_ramp",
        "a_hard_stop_stops_where_the_axis_is", "segments_run_at_their_own_constant_speed",
    )  # fmt: skip
    result = CliRunner().invoke(conform, ["mac23", "--json", *checks])
    assert result.exit_code == 0
    report = fold(json.loads(line) for line in result.stdout.splitlines())
    assert {one["name"] for one in report["checks"]} == set(checks)
    for check in report["checks"]:
        assert check["motions"], check["name"]
        for motion in check["motions"]:
            assert motion["measured"]
            assert is_inside(motion), f"{check['name']}, {motion['name']}"
            times = [point[0] for point in motion["predicted"]]
            assert times == sorted(times)


def test_recorded_operations_are_hex_whatever_carries_the_device() -> None:
    """Operations are no frames: on a bus, too, each of them is told byte by byte."""
    recording = Recording("mac23-can", (b"\x11\x0f\x46\x75",), found=b"\x11\x0f\x46\x75")
    told = report_json.event_object(FailureStored("draws", recording), spell=BUS.spell)
    assert told["recording"]["operations"] == ["11 0F 46 75"]
    assert told["recording"]["found"] == "11 0F 46 75"
