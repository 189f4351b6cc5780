"""What goes over a line, for whoever looks on: history, stream, losses; and what is set."""

import json
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from served_control import TIMEOUT_S, ServedControl
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from axistwin.catalog import find_model
from axistwin.control import watching
from axistwin.runtime.bus import Bus
from axistwin.runtime.line import Line
from axistwin.runtime.serving import traffic
from axistwin.runtime.serving.traffic import LineTraffic, WatchedLine
from axistwin.wire.can_frame import CanFrame

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "work-a-daemon.md"
LEDGERS = ROOT / "conformance" / "axistwin_conformance" / "families"

QUESTIONS = {
    "mac23:0": ("20h", "position = 0", 0),
    "msc-250:1": ("RQSTAT", "RQSTAT = ", 1),
    "mn400:1": ("E", "ReadPosition = 0,0,0,0", 1),
    "mac23-can:3": ("20h", "position = 0", 3),
}
"""What is asked of the first device of a line, what its reply says, and its address."""


@pytest.fixture(scope="module")
def served() -> Iterator[ServedControl]:
    """A line of each family."""
    with ServedControl(*QUESTIONS) as served:
        yield served


def watch(served: ServedControl, query: str) -> ClientConnection:
    """A client of the WebSocket."""
    url = served.server.url.replace("http", "ws") + f"/api/v1/events?{query}"
    return connect(url, open_timeout=TIMEOUT_S, proxy=None)


def ask(served: ServedControl, name: str) -> str:
    """Ask the question of a line's device; what the transcript says of the exchange."""
    simulation: Any = served.rack.lines[name].simulation
    model = find_model(name.partition(":")[0])
    request = model.family.compose(QUESTIONS[name][0], QUESTIONS[name][2])
    before = len(simulation.messages)
    if isinstance(simulation, Bus):
        port = simulation.attach()
        simulation.send(port, request)
        simulation.wait(simulation.sync() + 10**9, port)
        simulation.detach(port)
    else:
        assert isinstance(simulation, Line)
        simulation.send(request)
        end = time.monotonic() + TIMEOUT_S
        while QUESTIONS[name][1] not in simulation.render_transcript().rpartition(" > ")[2]:
            simulation.receive()
            assert time.monotonic() < end
            time.sleep(0.002)
    assert len(simulation.messages) > before
    return str(simulation.render_transcript())


def messages(client: ClientConnection, *wanted: str) -> list[dict[str, Any]]:
    """All that is streamed until a message says what is ``wanted``."""
    found: list[dict[str, Any]] = []
    end = time.monotonic() + TIMEOUT_S
    while not all(any(text in each["text"] for each in found) for text in wanted):
        assert time.monotonic() < end
        event = json.loads(client.recv(TIMEOUT_S))
        found += event["messages"] if event["event"] == "traffic" else []
    return found


@pytest.mark.parametrize("name", QUESTIONS)
def test_an_exchange_is_streamed_and_kept(served: ServedControl, name: str) -> None:
    """With time, direction, bytes, words and unit; once, after what was before."""
    _, answer, unit = QUESTIONS[name]
    with watch(served, f"traffic={quote(name)}") as client:
        first = json.loads(client.recv(TIMEOUT_S))
        assert (first["event"], first["line"], first["dropped"]) == ("traffic", name, 0)
        ask(served, name)
        streamed = messages(client, answer)
    question = streamed[0]
    reply = next(each for each in streamed if answer in each["text"])
    assert (question["direction"], reply["direction"]) == ("host", "device")
    assert question["time_ns"] < reply["time_ns"]
    assert (question["unit"], reply["unit"]) == (unit, unit)
    kept = served.get(f"lines/{quote(name)}/traffic")["messages"]
    told = first["messages"] + streamed
    assert kept[: len(told)] == told  # a unit that is not acknowledged says it again


def test_history_is_filtered(served: ServedControl) -> None:
    """By words, by whole bytes, by direction; the last ones."""
    for name in ("mac23:0", "mac23-can:3"):
        ask(served, name)
    path = "lines/mac23:0/traffic"

    def found(query: str) -> list[dict[str, Any]]:
        answer: list[dict[str, Any]] = served.get(f"{path}?{query}")["messages"]
        return answer

    assert all(each["direction"] == "device" for each in found("direction=device"))
    assert found("direction=device&last=1") == found("")[-1:]
    assert found("text=POSITION?") == found("direction=host")
    assert found("hex=06%2013%2002") == found("direction=device")
    assert found("hex=30%203") == found("hex=303")
    assert found("hex=6130") == []
    frames = served.get("lines/mac23-can:3/traffic?hex=603%2340")["messages"]
    assert [each["hex"][:4] for each in frames] == ["603#"] * len(frames)
    assert frames


def test_the_requests_of_the_page_are_answered(served: ServedControl) -> None:
    """Those of the traffic, as they stand there; the message has what the page shows of one."""
    text = PAGE.read_text(encoding="utf-8")
    ask(served, "mac23:0")
    (path,) = re.findall(r"`/api/v1/(lines/mac23:0/traffic\?[^`]*)`", text)
    (shown,) = re.findall(r"^{\"time_ns.*}$", text, re.MULTILINE)
    told = served.get(path)["messages"][0]
    for query in re.findall(r"`\?((?:direction|text|hex)=[^`]*)`", text):
        assert served.get(f"lines/mac23:0/traffic?{query}")["messages"]
    example = json.loads(shown)
    assert told.keys() == example.keys()
    assert (told["direction"], told["text"]) == (example["direction"], example["text"])
    assert told["hex"].startswith(example["hex"].removesuffix("..."))


@pytest.mark.parametrize(
    ("path", "status", "text"),
    [
        ("lines/mac32:0/traffic", 404, "did you mean mac23:0"),
        ("lines/mac23:0/traffic?hex=xy", 422, "601#4000"),
        ("lines/mac23:0/traffic?last=0", 422, "last"),
        ("lines/mac23:0/traffic?direction=up", 422, "direction"),
    ],
)
def test_a_mistake_is_explained(served: ServedControl, path: str, status: int, text: str) -> None:
    """With the nearest name, or what is allowed."""
    answered, answer = served.ask("GET", path)
    assert answered == status
    assert text in answer["message"]


def test_watching_an_unknown_line_is_refused_with_the_nearest_name(served: ServedControl) -> None:
    """Before the WebSocket begins."""
    with pytest.raises(InvalidStatus) as caught:
        watch(served, "traffic=mac32:0")
    assert caught.value.response.status_code == 404
    assert b"did you mean mac23:0" in (caught.value.response.body or b"")


def test_a_line_that_fails_while_it_is_watched_ends_alone() -> None:
    """Its watchers are told; the other line goes on, and is told of."""
    with (
        ServedControl("mac23:0", "mac23-can:3") as served,
        watch(served, "traffic=mac23:0&traffic=mac23-can:3") as client,
    ):
        line: Any = served.lines[0]

        def fail(**_: Any) -> None:
            raise AssertionError("our bug")

        line.flush_messages = fail
        event = json.loads(client.recv(TIMEOUT_S))
        while event["event"] != "line":
            event = json.loads(client.recv(TIMEOUT_S))
        assert (event["line"], event["kind"]) == ("mac23:0", "line_failed")
        ask(served, "mac23-can:3")
        assert messages(client, "position = 0")
        assert served.get("lines/mac23:0/traffic")["messages"] == []


def test_nobody_looks_and_nobody_listens(served: ServedControl) -> None:
    """A line has subscribers while it is watched, and none before and after."""
    line: Any = served.rack.lines["mac23:0"].simulation
    bus: Any = served.rack.lines["mac23-can:3"].simulation

    def listeners() -> int:
        return len(line.transcript._subscribers) + len(bus._frame_subscribers)

    def wait_for(count: int) -> None:
        end = time.monotonic() + TIMEOUT_S
        while listeners() != count:
            assert time.monotonic() < end
            time.sleep(0.005)

    wait_for(0)
    with watch(served, "traffic=mac23:0&traffic=mac23-can:3"), watch(served, "traffic=mac23:0"):
        wait_for(2)
    wait_for(0)


def test_what_does_not_fit_is_dropped_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The newest are kept; the count comes with the next ones."""
    monkeypatch.setattr(traffic, "PENDING_MAX", 3)
    served = ServedControl("mac23-can:3")
    simulation: Any = served.lines[0]
    told: list[LineTraffic] = []
    watched = WatchedLine("bus", served.rack.lines["mac23-can:3"])
    watched.join(told.append)
    port = simulation.attach()
    for number in range(8):
        simulation.send(port, CanFrame(0x700 + number))
    simulation.wait(simulation.sync() + 10**8)
    watched.report()
    sent = [each for each in told[-1].messages if each.direction == "host"]
    assert [str(each.content) for each in sent] == ["705#", "706#", "707#"]
    assert told[-1].dropped == 5
    watched.report()
    assert told[-1].dropped == 5, "nothing was said since"
    simulation.close()
    served.rack.close()


def test_who_reads_too_slowly_misses_messages_and_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is not dropped for that."""
    query = "traffic=mac23:0&device=mac23:0"
    with ServedControl("mac23:0") as served, watch(served, query) as client:
        for _ in range(2):
            json.loads(client.recv(TIMEOUT_S))
        line: Any = served.lines[0]
        watched = served.server.live._lines["mac23:0"]
        with monkeypatch.context() as patch:
            patch.setattr(watching, "TRAFFIC_MAX", 0)
            ask(served, "mac23:0")
            while line.transcript._is_open or watched._pending:
                time.sleep(0.005)
            served.ask("PUT", "devices/mac23:0/controls/push", {"value": 0})
            next_set(client)  # what was told before has been put, or left out
        ask(served, "mac23:0")
        event = json.loads(client.recv(TIMEOUT_S))
        while event["event"] != "traffic":
            event = json.loads(client.recv(TIMEOUT_S))
        assert event["dropped"] >= 2
        assert event["messages"][0]["direction"] == "host"


def test_a_long_silent_line_tells_of_its_last_burst(served: ServedControl) -> None:
    """It is over after a pause, though nothing follows it."""
    with watch(served, "traffic=msc-250:1") as client:
        simulation: Any = served.rack.lines["msc-250:1"].simulation
        simulation.send(b"\x55")
        assert [each["hex"] for each in messages(client, "55")][-1] == "55"


def test_reports_of_usb_are_traffic_too(served: ServedControl) -> None:
    """Beside the bytes of the serial line, in the order of their times."""
    name = "mn400:1"
    with watch(served, f"traffic={name}") as client:
        line: Any = served.rack.lines[name].simulation
        cable = line.usb_cable(0)
        cable.send(b"E".ljust(64, b"\0"))
        end = time.monotonic() + TIMEOUT_S
        while cable.receive() is None:
            assert time.monotonic() < end
            time.sleep(0.002)
        found = messages(client, "USB: E0,0,0,0")
    asked = next(each for each in found if each["text"] == "USB: E")
    assert (asked["direction"], asked["hex"], asked["unit"]) == ("host", "45", None)
    ask(served, name)
    kept = served.get(f"lines/{name}/traffic")["messages"]
    times = [each["time_ns"] for each in kept]
    assert times == sorted(times)
    assert [each["direction"] for each in kept if each["text"].startswith("USB")] == [
        "host",
        "device",
    ]


def test_every_set_is_an_event_even_if_nothing_changes(served: ServedControl) -> None:
    """A switch that is set twice alike; the value, the name, the time that the answer has."""
    with watch(served, "device=mac23:0") as client:
        json.loads(client.recv(TIMEOUT_S))
        for value in (True, False, False):
            _, done = served.ask(
                "PUT", "devices/mac23:0/controls/inputs.reference", {"value": value}
            )
            event = next_set(client)
            assert event == {
                "event": "set",
                "device": "mac23:0",
                "time_ns": done["time_ns"],
                "control": "inputs.reference",
                "value": value,
            }
        served.ask("POST", "devices/mac23:0/power", {"action": "cycle"})
        assert [next_set(client)["value"] for _ in range(2)] == [False, True]
        served.ask("PUT", "devices/mac23:0/controls/push", {"value": 5})
        assert next_set(client)["control"] == "push"


def next_set(client: ClientConnection) -> dict[str, Any]:
    """The next event ``set``."""
    while True:
        event: dict[str, Any] = json.loads(client.recv(TIMEOUT_S))
        if event["event"] == "set":
            return event


def test_bits_of_a_number_are_told_with_their_requirement(served: ServedControl) -> None:
    """Of each family, by name."""
    for name, control in (
        ("mac23:0", "fault_bits"),
        ("mac23:0", "stop_bits"),
        ("msc-250:1", "status"),
        ("mn400:1", "inputs_status"),
    ):
        bits = served.get(f"devices/{name}/controls/{control}")["bits"]
        assert len({each["bit"] for each in bits}) == len(bits) > 0
        assert all(each["name"] and "-" in each["requirement"] for each in bits)
    served.ask("PUT", "devices/mn400:1/controls/inputs.m2_plus", {"value": True})
    info = served.get("devices/mn400:1/controls/inputs_status")
    on = [each["name"] for each in info["bits"] if info["value"] >> each["bit"] & 1]
    assert on == ["m2 plus"]


@pytest.mark.parametrize("name", QUESTIONS)
def test_every_requirement_behind_a_bit_is_in_a_ledger(name: str) -> None:
    """Whatever the family; it is a whole number that has bits."""
    ledgers = "".join(path.read_text(encoding="utf-8") for path in LEDGERS.rglob("ledger.toml"))
    model = find_model(name.partition(":")[0])
    with_bits = [control for control in model.family.controls() if control.bits]
    assert with_bits
    for control in with_bits:
        assert control.kind == "whole"
        for bit in control.bits:
            assert f"[requirement.{bit.requirement}]" in ledgers
