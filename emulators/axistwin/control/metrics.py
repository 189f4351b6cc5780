"""What a rack shows to Prometheus: its lines, its devices, and every control that has a number."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from axistwin.wire.wire_fault import FaultKind

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"

_LINE_UP: Final = "axistwin_line_up"
_METHODS: Final = ("GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH")

Values = dict[str, tuple[int, dict[str, Any]]]
"""Of each device its line's time, and its values by name."""

Acted = Mapping[str, Mapping[FaultKind, int]]
"""Of each line how many times faults of its wire have acted, by their kinds."""


class Counts:
    """How the API is used."""

    def __init__(self) -> None:
        self.requests: dict[tuple[str, str], int] = {}
        self.watchers = 0
        self.dropped = 0

    def count(self, method: str, status: int) -> None:
        """One more request."""
        key = method if method in _METHODS else "other", str(status)
        self.requests[key] = self.requests.get(key, 0) + 1


class _RackCollector(Collector):
    def __init__(
        self, values: Values, failures: dict[str, bool], acted: Acted, counts: Counts
    ) -> None:
        self._values, self._failures, self._counts = values, failures, counts
        self._acted = acted

    def collect(self) -> Iterator[Metric]:
        """Everything as it is now."""
        served = GaugeMetricFamily(_LINE_UP, "1 while a line is served", labels=["line"])
        for line, is_failed in self._failures.items():
            served.add_metric([line], 0.0 if is_failed else 1.0)
        yield served
        faults = CounterMetricFamily(
            "axistwin_wire_faults", "times that faults of the wire acted", labels=["line", "kind"]
        )
        for line, kinds in self._acted.items():
            for kind, number in kinds.items():
                faults.add_metric([line, kind], number)
        yield faults
        times = GaugeMetricFamily(
            "axistwin_device_time_seconds", "time of a device's line", labels=["device"]
        )
        shown = GaugeMetricFamily(
            "axistwin_control_value", "value of a control", labels=["device", "control"]
        )
        for device, (time_ns, values) in self._values.items():
            times.add_metric([device], time_ns / 1e9)
            for name, value in values.items():
                if isinstance(value, bool | int | float):
                    shown.add_metric([device, name], float(value))
        yield times
        yield shown
        yield from _collect_use(self._counts)


class _FrontCollector(Collector):
    """Of ``pages`` of workers, by their numbers, all but how their API is used.

    What is told of a process has the number of the worker for a label.
    """

    def __init__(self, pages: Mapping[int, str], ended: Sequence[str], counts: Counts) -> None:
        self._pages, self._ended, self._counts = pages, ended, counts

    def collect(self) -> Iterator[Metric]:
        """All, with this process, and 0 for the lines of workers that have ended."""
        own = ProcessCollector(registry=None).collect()
        families = {each.name: each for each in own}
        for number, page in self._pages.items():
            for told in text_string_to_metric_families(page):
                if told.name.startswith("axistwin_api_"):
                    continue
                family = families.setdefault(
                    told.name, Metric(told.name, told.documentation, told.type)
                )
                is_of_process = told.name.startswith("process_")
                more = {"worker": str(number)} if is_of_process else {}
                for sample in told.samples:
                    family.add_sample(sample.name, {**sample.labels, **more}, sample.value)
        for line in self._ended:
            families[_LINE_UP].add_sample(_LINE_UP, {"line": line}, 0.0)
        yield from families.values()
        yield from _collect_use(self._counts)


def _collect_use(counts: Counts) -> Iterator[Metric]:
    requests = CounterMetricFamily(
        "axistwin_api_requests", "requests answered", labels=["method", "status"]
    )
    for (method, status), number in counts.requests.items():
        requests.add_metric([method, status], number)
    yield requests
    yield GaugeMetricFamily("axistwin_api_watchers", "clients that watch", value=counts.watchers)
    yield CounterMetricFamily(
        "axistwin_api_watchers_dropped",
        "clients that watched and read too slowly",
        value=counts.dropped,
    )


def render(values: Values, failures: dict[str, bool], acted: Acted, counts: Counts) -> bytes:
    """The page that Prometheus reads."""
    registry = CollectorRegistry()
    ProcessCollector(registry=registry)
    registry.register(_RackCollector(values, failures, acted, counts))
    return bytes(generate_latest(registry))


def render_all(pages: Mapping[int, str], ended: Sequence[str], counts: Counts) -> bytes:
    """The page of a front: those of its workers in one; ``ended``: lines that none serves."""
    registry = CollectorRegistry()
    registry.register(_FrontCollector(pages, ended, counts))
    return bytes(generate_latest(registry))
