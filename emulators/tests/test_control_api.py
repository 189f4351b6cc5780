"""The control API over real sockets: devices, controls, supply, live state, metrics."""

import contextlib
import json
import time
from collections.abc import Iterator
from typing import Any

import pytest
from served_control import TIMEOUT_S, ServedControl
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from axistwin import discovery
from axistwin.control import watching
from axistwin.control.client import LET_GO
from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_MS, NS_PER_S
from axistwin.macroprogram import Macroprogram
from axistwin.motion.plant import Load

pytestmark = pytest.mark.system


class Idle(Macroprogram):
    """Does nothing."""

    def scan(self) -> None:
        """Nothing."""


@pytest.fixture(scope="module")
def api() -> Iterator[ServedControl]:
    """Two lines and a bus."""
    with ServedControl("mac23:0 mac34-1:5", "msc-250:1", "mac23-can:3") as served:
        yield served


def watch(served: ServedControl, query: str = "") -> ClientConnection:
    """A client of the WebSocket."""
    url = served.server.url.replace("http", "ws") + f"/api/v1/events{query}"
    return connect(url, open_timeout=TIMEOUT_S, proxy=None)


def next_event(client: ClientConnection, kind: str, *names: str) -> dict[str, Any]:
    """The next event of that kind that has these values."""
    end = time.monotonic() + TIMEOUT_S
    while time.monotonic() < end:
        event: dict[str, Any] = json.loads(client.recv(TIMEOUT_S))
        if event["event"] == kind and all(name in event.get("values", {}) for name in names):
            return event
    raise AssertionError(f"no event {kind} {names}")


# ---- what there is -------------------------------------------------------------------------------


def test_devices_and_lines_are_listed(api: ServedControl) -> None:
    """With where they are, and how."""
    devices = api.get("devices")["devices"]
    assert [each["name"] for each in devices] == [
        "mac23:0",
        "mac34-1:5",
        "msc-250:1",
        "mac23-can:3",
    ]
    assert devices[1] == {
        "name": "mac34-1:5",
        "model": "mac34-1",
        "address": 5,
        "line": "mac23:0",
        "power": True,
        "state": devices[1]["state"],
        "axes": {
            "names": ["axis"],
            "unit": "increments",
            "position": "position",
            "rate": "velocity",
        },
    }
    assert devices[2]["axes"] is None
    assert api.get("devices/mac34-1") == devices[1]
    lines = api.get("lines")["lines"]
    assert [(each["name"], each["devices"]) for each in lines] == [
        ("mac23:0", ["mac23:0", "mac34-1:5"]),
        ("msc-250:1", ["msc-250:1"]),
        ("mac23-can:3", ["mac23-can:3"]),
    ]
    assert all(each["failure"] is None for each in lines)


def test_a_state_is_all_values_at_one_instant(api: ServedControl) -> None:
    """By the names of controls, with the time of the line."""
    first, second = api.get("devices/mac23:0/state"), api.get("devices/mac23:0/state")
    assert first["values"]["supply_volts"] == 24.0
    assert first["values"]["cells"]["baud"] == 38400
    assert second["time_ns"] > first["time_ns"]


def test_a_control_tells_what_it_takes(api: ServedControl) -> None:
    """Kind, unit, limits and value; of numbers, the first and the last."""
    info = api.get("devices/mac23:0/controls/supply_volts")
    assert {name: info[name] for name in ("kind", "unit", "low", "high", "value", "writable")} == {
        "kind": "number",
        "unit": "V",
        "low": 0.0,
        "high": 1000.0,
        "value": 24.0,
        "writable": True,
    }
    controls = {each["name"]: each for each in api.get("devices/msc-250/controls")["controls"]}
    assert controls["variables"]["numbers"] == {"first": 0, "last": 65535}
    assert controls["battery"]["choices"] == ["good", "low", "flat"]
    assert "load_program" not in controls


# ---- working -------------------------------------------------------------------------------------


def test_what_is_set_is_set_at_a_definite_time_of_the_line(api: ServedControl) -> None:
    """The answer tells it, and it is between what was read before and afterwards."""
    before = api.get("devices/mac23:0/state")["time_ns"]
    status, done = api.ask("PUT", "devices/mac23:0/controls/inputs.positive_stop", {"value": True})
    assert (status, done["value"]) == (200, True)
    after = api.get("devices/mac23:0/state")
    assert before < done["time_ns"] < after["time_ns"]
    assert after["values"]["inputs.positive_stop"] is True
    journal = [(time_ns, text) for time_ns, _, text in api.lines[0].journal]
    (noted,) = [time_ns for time_ns, text in journal if "positive_stop = True" in str(text)]
    assert abs(noted - done["time_ns"]) < 100 * NS_PER_MS
    api.ask("PUT", "devices/mac23:0/controls/inputs.positive_stop", {"value": False})


def test_numbers_actions_and_choices_are_worked(api: ServedControl) -> None:
    """Of an MSC: a flag, a variable, the battery, and a program that is there."""
    base = "devices/msc-250:1/controls"
    assert api.ask("PUT", f"{base}/flags.200", {"value": True})[0] == 200
    assert api.get(f"{base}/flags.200")["value"] is True
    assert api.ask("PUT", f"{base}/variables.2008", {"value": -7})[0] == 200
    assert api.get(f"{base}/variables.2008")["value"] == -7
    assert api.ask("PUT", f"{base}/battery", {"value": "low"})[1]["value"] == "low"
    api.lines[1].twins[0].load_program(Idle)
    assert api.ask("PUT", f"{base}/start_program", {"value": None})[0] == 200
    assert api.get("devices/msc-250:1")["state"] == "program running"
    assert api.ask("PUT", f"{base}/stop_program", {})[0] == 200


def test_the_supply_is_cut_for_as_long_as_asked(api: ServedControl) -> None:
    """Off, on, and a cycle, with the times of the line."""
    path = "devices/mac34-1:5/power"
    _, off = api.ask("POST", path, {"action": "off"})
    assert (off["power"], off["on_time_ns"]) == (False, None)
    assert api.get("devices/mac34-1:5")["power"] is False
    _, on = api.ask("POST", path, {"action": "on"})
    assert on["on_time_ns"] > off["off_time_ns"]
    _, cycle = api.ask("POST", path, {"action": "cycle", "off_s": 0.2})
    assert cycle["power"] is True
    assert cycle["on_time_ns"] - cycle["off_time_ns"] >= NS_PER_S // 5
    assert api.get("devices/mac34-1:5")["power"] is True


def test_a_cycle_is_as_long_as_asked_in_the_time_of_the_line() -> None:
    """A thousand times as fast: twenty seconds are twenty milliseconds."""
    with ServedControl("mac23:0", speed=1000) as served:
        begin = time.monotonic()
        _, done = served.ask("POST", "devices/mac23/power", {"action": "cycle", "off_s": 20})
        assert done["on_time_ns"] - done["off_time_ns"] >= 20 * NS_PER_S
        assert time.monotonic() - begin < 20


# ---- mistakes ------------------------------------------------------------------------------------

MISTAKES = [
    ("GET", "devices/mac32:0", None, 404, "did you mean mac23:0"),
    ("GET", "devices/mac23:0/controls/inputs.refrence", None, 404, "did you mean inputs.reference"),
    ("GET", "devices/msc-250:1/controls/load_program", None, 404, "none is taken from the network"),
    ("PUT", "devices/msc-250:1/controls/load_program", {"value": "bench"}, 404, "none is taken"),
    ("GET", "devices/msc-250:1/controls/flags.start", None, 404, "no program with names"),
    ("GET", "nothing", None, 404, "openapi.json"),
    ("DELETE", "devices", None, 405, "Not Allowed"),
    ("PUT", "devices/mac23:0/controls/supply_volts", {"value": 2000}, 422, "0..1000 V"),
    ("PUT", "devices/mac23:0/controls/supply_volts", {"value": "x"}, 422, "0..1000 V"),
    ("PUT", "devices/mac23:0/controls/load.torque_nm", {"value": 10**400}, 422, "at least 0 Nm"),
    ("PUT", "devices/mac23:0/controls/push", {"value": 1 << 70}, 422, "out of range"),
    ("PUT", "devices/mac23:0/controls/position", {"value": 1}, 422, "only read"),
    ("PUT", "devices/mac23:0/controls/inputs.reset", {"value": 7}, 422, "True or False"),
    ("PUT", "devices/mac23:0/controls/inputs.reset", {"value": [1]}, 422, "value"),
    ("PUT", "devices/mac23:0/controls/inputs.reset", {"valeu": True}, 422, "valeu"),
    ("PUT", "devices/mac23:0/controls/supply_volts", b'{"value": NaN}', 422, "finite"),
    ("PUT", "devices/mac23:0/controls/supply_volts", b'{"value": 1e999}', 422, "finite"),
    ("PUT", "devices/mac23:0/controls/supply_volts", b"{", 422, "JSON"),
    ("PUT", "devices/mac23:0/controls/supply_volts", b"[" * 60000, 400, "parsing"),
    ("PUT", "devices/mac23:0/controls/push", b'{"value": ' + b"9" * 9000 + b"}", 400, "parsing"),
    ("POST", "devices/mac23:0/power", {"action": "of"}, 422, "cycle"),
    ("POST", "devices/mac23:0/power", {"action": "cycle", "off_s": 21}, 422, "20"),
    ("POST", "devices/mac23:0/power", {"action": "on", "off_s": False}, 422, "number"),
    ("POST", "devices/mac23:0/power", {"action": "on", "off_s": "1"}, 422, "number"),
]


@pytest.mark.parametrize(
    ("method", "path", "body", "status", "part"),
    MISTAKES,
    ids=[f"{number}-{path}" for number, (_, path, *_) in enumerate(MISTAKES)],
)
def test_a_mistake_has_one_shape(
    api: ServedControl, method: str, path: str, body: Any, status: int, part: str
) -> None:
    """Status, kind, and one line with the nearest name or what is allowed; nothing has failed."""
    answer = api.ask(method, path, body)
    assert answer[0] == status, answer
    assert set(answer[1]) == {"error", "message", "allowed"}
    assert part in answer[1]["message"]
    assert "\n" not in answer[1]["message"]
    assert all(line["failure"] is None for line in api.get("lines")["lines"])


@pytest.mark.parametrize(
    ("path", "allowed"),
    [
        ("devices/mac23:0/controls/push", "GET, PUT"),
        ("devices/mac23:0/power", "POST"),
        ("/metrics", "GET"),
        ("/panel/panel.js", "GET"),
    ],
)
def test_a_method_that_a_path_does_not_take_is_told_with_those_it_takes(
    api: ServedControl, path: str, allowed: str
) -> None:
    """All of them, whichever route is the first."""
    url = path if path.startswith("/") else f"/api/v1/{path}"
    answered = api.raw(
        f"PATCH {url} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode()
    )
    head, _, body = answered.decode().partition("\r\n\r\n")
    assert head.startswith("HTTP/1.1 405")
    assert f"allow: {allowed}\r\n" in f"{head}\r\n".lower().replace(allowed.lower(), allowed)
    assert json.loads(body)["error"] == "method_not_allowed"


def test_a_value_out_of_range_is_told_with_the_range(api: ServedControl) -> None:
    """For programs, too."""
    path = "devices/mac23:0/controls/temperature_celsius"
    _, answer = api.ask("PUT", path, {"value": 5000})
    assert answer["allowed"] == {
        "kind": "number",
        "unit": "°C",
        "low": -273.0,
        "high": 1000.0,
        "choices": [],
    }


WILD: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2**62, -(2**62), 0.5, -1e18, 1e18, 1e300),
    *("", "on", "\0", "é" * 1000, "9" * 100),
)


@pytest.mark.parametrize("model", sorted(discovery.models()))
def test_no_value_of_any_control_of_any_model_is_a_bug(model: str) -> None:
    """Taken or refused: the line goes on, and can be shown."""
    with ServedControl(model) as served:
        (device,) = served.rack.devices
        controls = served.get(f"devices/{device}/controls")["controls"]
        assert len(controls) > 8
        for info in controls:
            name = info["name"]
            if info["numbers"] is not None:
                name = f"{name}.{info['numbers']['first']}"
            for value in WILD if info["writable"] else ():
                path = f"devices/{device}/controls/{name}"
                status, answer = served.ask("PUT", path, {"value": value})
                assert status in (200, 422), (name, value, answer)
            status, answer = served.ask("GET", f"devices/{device}/controls/{name}")
            assert status == 200, (name, answer)
        assert served.get(f"devices/{device}/state")["values"]


# ---- looking on ----------------------------------------------------------------------------------


def test_a_watcher_gets_a_snapshot_and_then_changes_only(api: ServedControl) -> None:
    """Of the device that it names; typed, and with the time of the line."""
    with watch(api, "?device=mac23:0") as client:
        shown = json.loads(client.recv(TIMEOUT_S))
        assert (shown["event"], shown["device"]) == ("snapshot", "mac23:0")
        assert shown["values"]["temperature_celsius"] == 25.0
        path = "devices/mac23:0/controls/temperature_celsius"
        api.ask("PUT", path, {"value": 60})
        changed = next_event(client, "changed", "temperature_celsius")
        assert changed["values"] == {"temperature_celsius": 60.0}
        assert changed["time_ns"] > shown["time_ns"]
        api.ask("PUT", path, {"value": 25})


def test_a_watcher_is_told_what_a_device_tells(api: ServedControl) -> None:
    """A state that it goes through, with its words."""
    with watch(api, "?device=mac23") as client:
        json.loads(client.recv(TIMEOUT_S))
        api.ask("POST", "devices/mac23/power", {"action": "cycle"})
        told = next_event(client, "told")
        assert told["device"] == "mac23:0"
        assert told["kind"] == "StateChanged"
        assert told["text"]


def test_all_devices_are_watched_without_a_name(api: ServedControl) -> None:
    """A snapshot of each first."""
    with watch(api) as client:
        shown = [json.loads(client.recv(TIMEOUT_S)) for _ in api.rack.devices]
    assert [each["device"] for each in shown] == list(api.rack.devices)


def test_nobody_watches_and_nobody_looks(api: ServedControl) -> None:
    """When the last watcher has gone, devices are left alone."""
    live = api.server.live
    with watch(api):
        pass
    end = time.monotonic() + TIMEOUT_S
    while (live._watched or live._is_looking) and time.monotonic() < end:
        time.sleep(0.01)
    assert not live._watched
    assert not live._is_looking


def test_watching_an_unknown_device_is_refused_with_the_nearest_name(api: ServedControl) -> None:
    """Before the WebSocket begins."""
    with pytest.raises(InvalidStatus) as caught:
        watch(api, "?device=mac32:0")
    assert caught.value.response.status_code == 404
    assert b"did you mean mac23:0" in (caught.value.response.body or b"")


def test_who_says_something_to_the_websocket_is_dropped(api: ServedControl) -> None:
    """With a code that says so."""
    with watch(api, "?device=mac23:0") as client:
        client.send("hello")
        with pytest.raises(ConnectionClosed) as caught:
            next_event(client, "never")
        assert caught.value.rcvd is not None
        assert caught.value.rcvd.code == watching.NOT_EXPECTED


def test_what_is_set_from_python_is_an_event_as_through_the_api(api: ServedControl) -> None:
    """By attributes, methods, keys and records, from any thread; a refused value is none."""
    mac, msc = api.lines[0].twins[0], api.lines[1].twins[0]
    with watch(api, "?device=mac23:0&device=msc-250:1") as client:
        for _ in range(2):
            json.loads(client.recv(TIMEOUT_S))
        mac.supply_volts = 23.5
        mac.inputs.reference = True
        mac.controls["inputs.reference"].set(False)
        mac.push(7)
        with pytest.raises(UsageError):
            mac.supply_volts = -1
        mac.load.held = True
        mac.load = Load()
        mac.power_cycle()
        mac.power_on()
        msc.flags[200] = True
        msc.load_program(Idle)
        mac.supply_volts = 24
        heard = [next_event(client, "set") for _ in range(14)]
    assert [(each["device"], each["control"], each["value"]) for each in heard] == [
        ("mac23:0", "supply_volts", 23.5),
        ("mac23:0", "inputs.reference", True),
        ("mac23:0", "inputs.reference", False),
        ("mac23:0", "push", None),
        ("mac23:0", "load.held", True),
        ("mac23:0", "load.torque_nm", 0.0),
        ("mac23:0", "load.inertia_kgcm2", 0.0),
        ("mac23:0", "load.held", False),
        ("mac23:0", "power", False),
        ("mac23:0", "power", True),
        ("mac23:0", "power", True),
        ("msc-250:1", "flags.200", True),
        ("msc-250:1", "load_program", None),
        ("mac23:0", "supply_volts", 24.0),
    ]


def test_what_is_set_is_told_before_what_follows_from_it(api: ServedControl) -> None:
    """The cause, then the effect, of one instant."""
    with watch(api, "?device=mac23:0") as client:
        json.loads(client.recv(TIMEOUT_S))
        api.lines[0].twins[0].power_off()
        api.lines[0].twins[0].power_on()
        events = [json.loads(client.recv(TIMEOUT_S)) for _ in range(4)]
    events = [each for each in events if each["event"] != "changed"]
    assert [each["event"] for each in events[:3]] == ["set", "told", "set"]
    assert events[0]["time_ns"] == events[1]["time_ns"]


def test_who_watches_a_line_that_is_removed_is_told_and_let_go() -> None:
    """Behind all that was for him, with a code that says so; who watches others stays."""
    queries = ("?device=mac23:1", "?traffic=mac23:1", "?device=mac23:1&device=mac23:0", "")
    with ServedControl("mac23:0", "mac23:1") as served, contextlib.ExitStack() as stack:
        clients = [stack.enter_context(watch(served, query)) for query in queries]
        other = stack.enter_context(watch(served, "?device=mac23:0"))
        for client in (*clients, other):
            json.loads(client.recv(TIMEOUT_S))
        remove = served.rack.do("mac23:0", lambda device: served.rack.remove("mac23:1"))
        remove.result(TIMEOUT_S)
        for client in clients:
            told = next_event(client, "line")
            assert (told["kind"], told["details"]) == ("line_removed", {"devices": ["mac23:1"]})
            with pytest.raises(ConnectionClosed) as caught:
                next_event(client, "never")
            assert caught.value.rcvd is not None
            assert caught.value.rcvd.code == LET_GO
        assert next_event(other, "line")["kind"] == "line_removed"
        served.rack.devices["mac23:0"].twin.push(1)
        assert next_event(other, "set")["control"] == "push"
        with watch(served) as client:
            assert json.loads(client.recv(TIMEOUT_S))["device"] == "mac23:0"


# ---- the rest ------------------------------------------------------------------------------------


def test_metrics_are_what_prometheus_reads(api: ServedControl) -> None:
    """Lines, controls and the API's own use."""
    status, page = api.ask("GET", "/metrics")
    text = page.decode()
    assert status == 200
    assert 'axistwin_line_up{line="msc-250:1"} 1.0' in text
    assert 'axistwin_control_value{control="supply_volts",device="mac23:0"} 24.0' in text
    assert 'axistwin_api_requests_total{method="GET",status="200"}' in text


def test_the_schema_tells_everything(api: ServedControl) -> None:
    """Each path, and each model with a description of its fields."""
    schema = api.get("/openapi.json")
    paths = {path for path in schema["paths"] if path.startswith("/api/v1/")}
    assert "/api/v1/devices/{device}/controls/{control}" in paths
    assert len(paths) == 10
    problems = schema["components"]["schemas"]["Problem"]["properties"]
    assert all("description" in field for field in problems.values())
    for methods in schema["paths"].values():
        for operation in methods.values():
            assert operation["summary"]


def test_a_line_that_fails_is_told_and_the_others_answer() -> None:
    """503 for its devices; the list has the rest, and watchers are told."""
    with ServedControl("mac23:0", "mac23:1") as served, watch(served) as client:
        device: Any = served.lines[0]._stations[0].device

        def fail(*_: Any) -> None:
            raise AssertionError("our bug")

        device.describe = fail
        status, answer = served.ask("GET", "devices/mac23:0/state")
        assert (status, answer["error"]) == (503, "unavailable")
        assert "mac23:0 is not served any more: our bug" in answer["message"]
        assert [each["name"] for each in served.get("devices")["devices"]] == ["mac23:1"]
        assert served.get("lines")["lines"][0]["failure"] == "our bug"
        told = next_event(client, "line")
        assert (told["line"], told["kind"]) == ("mac23:0", "line_failed")
