"""The control API against what its own schema allows and forbids, within this process."""

import zlib
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest
import schemathesis
from schemathesis import BaseSchema, HookContext
from schemathesis.config import SchemathesisConfig
from schemathesis.core.result import Ok
from schemathesis.engine import events, from_schema
from served_control import add_line

from axistwin.control.application import make_application
from axistwin.control.metrics import Counts
from axistwin.runtime.clock import VirtualClock
from axistwin.runtime.serving.live import Live
from axistwin.runtime.serving.rack import Rack

pytestmark = pytest.mark.strength(seconds=20)

DEVICES = ("mac23:0 mac34-1:5", "msc-250:1", "mn400:1", "mac23-can:3")
HOST = "localhost"
CONFIG: dict[str, Any] = {
    "base-url": f"http://{HOST}",
    "seed": 17,
    "workers": 1,
    "continue-on-failure": True,
    "request-timeout": 600,  # a busy machine is no finding
    "generation": {
        "max-examples": 20,
        "deterministic": True,
        "no-shrink": True,
        "database": "none",
    },
    # What a control takes depends on the control: the schema cannot tell.
    "checks": {
        "positive_data_acceptance": {"expected-statuses": ["2xx", "404", "422"]},
        "use_after_free": {"enabled": False},  # to delete all faults leaves a line with none
    },
}

# What the schema alone seldom hits: a value that this control takes, the number of a fault that is
# there.  The tests of the API ask for them.
SELDOM = {
    "PUT /api/v1/devices/{device}/controls/{control}",
    "DELETE /api/v1/lines/{line}/faults/{number}",
}


@pytest.fixture
def rack(monkeypatch: pytest.MonkeyPatch) -> Iterator[Rack]:
    """Devices of all families in virtual time; what its loop should do soon is done at once."""
    rack = Rack()
    lines = [add_line(rack, texts, VirtualClock(), lambda _: None) for texts in DEVICES]
    monkeypatch.setattr(rack.loop, "call_soon", lambda call, *given: call(*given))
    yield rack
    rack.close()
    for line in lines:
        line.close()


def schema_of(rack: Rack) -> BaseSchema:
    """The schema, with names of this rack in two of three requests."""
    application = make_application(rack, Live(rack), Counts(), HOST, None)
    config = SchemathesisConfig.from_dict(CONFIG)
    schema = schemathesis.openapi.from_asgi(
        "/openapi.json", application, config=config, headers={"Host": HOST}
    )
    known = [
        {"line": device.line, "device": device.name, "control": control}
        for device in rack.devices.values()
        for control in device.twin.controls
    ]

    @schema.hook
    def map_path_parameters(context: HookContext, path_parameters: Any) -> Any:
        drawn = zlib.crc32(repr(path_parameters).encode())
        if not path_parameters or drawn % 3 == 0:
            return path_parameters
        names = known[drawn % len(known)]
        return {key: names.get(key, value) for key, value in path_parameters.items()}

    return schema


def test_nothing_that_is_asked_breaks_the_schema_or_the_server(rack: Rack) -> None:
    """No answer is a 5xx or undocumented, and what the schema forbids is refused."""
    schema = schema_of(rack)
    broken: list[str] = []
    answered: Counter[tuple[str, int]] = Counter()
    for event in from_schema(schema).execute():
        if isinstance(event, events.NonFatalError | events.FatalError):
            broken.append(repr(event))
        if isinstance(event, events.ScenarioFinished):
            for case_id, checks in event.recorder.checks.items():
                label = event.recorder.cases[case_id].value.operation.label
                response = event.recorder.interactions[case_id].response
                answered[label, response.status_code if response is not None else 0] += 1
                failures = [each.failure_info for each in checks if each.failure_info is not None]
                broken += [f"{label}: {each.failure} {each.code_sample}" for each in failures]
    assert not broken, "\n\n".join(dict.fromkeys(broken))
    labels = {each.ok().label for each in schema.get_all_operations() if isinstance(each, Ok)}
    assert {label for label, status in answered if 200 <= status < 300} >= labels - SELDOM
    assert all(server.failure is None for server in rack.lines.values())
