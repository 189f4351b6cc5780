"""What ``axistwin watch`` shows in a terminal of any size: all devices, or one with all it tells.

Everything comes from the control API: no family is named here.
"""

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Final, Protocol

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from axistwin.cli.event_lines import EventLines
from axistwin.errors import UsageError

REFRESH_HZ: Final = 8
EVENTS_KEPT: Final = 100
WIDE_COLUMNS: Final = 100
NARROW_COLUMNS: Final = 60
"""From how many columns on two stand beside each other; below how many some are left out."""

_ONE_LINE: Final[Any] = {"no_wrap": True, "overflow": "ellipsis"}


class Screen(Protocol):
    """What is shown of events."""

    def receive(self, event: dict[str, Any]) -> None:
        """Something has happened."""

    def render(self, width: int, height: int) -> RenderableType:
        """What a terminal of this size shows now."""


def follow(
    screen: Screen, events: Iterable[dict[str, Any]], console: Console | None = None
) -> None:
    """Show ``screen`` while ``events`` come; the terminal is as it was at the end."""
    lock, console = threading.Lock(), console or Console(highlight=False)

    def render() -> RenderableType:
        with lock:
            return screen.render(*console.size)

    with Live(get_renderable=render, console=console, screen=True, refresh_per_second=REFRESH_HZ):
        for event in events:
            with lock:
                screen.receive(event)


class _WatchedDevice:
    """A device, with the values that it has."""

    def __init__(self, device: dict[str, Any]) -> None:
        self.name: str = device["name"]
        self.axes: dict[str, Any] | None = device["axes"]
        self.time_ns = 0
        self.values: dict[str, Any] = {"power": device["power"], "state": device["state"]}

    def receive(self, event: dict[str, Any]) -> None:
        self.time_ns = event["time_ns"]
        if event["event"] == "set":
            if event["control"] in self.values:
                self.values[event["control"]] = event["value"]
        else:
            self.values.update(event.get("values", {}))

    @property
    def state(self) -> Text:
        if not self.values["power"]:
            return Text("power off", "red")
        return Text(str(self.values["state"]), "bold")

    def on_axes(self, key: str, unit: str) -> str:
        """Position or rate of its axes; empty if it has none, or has not told it yet."""
        if self.axes is None or self.axes[key] not in self.values:
            return ""
        return f"{_plain(self.values[self.axes[key]])} {self.axes['unit']}{unit}"


class _Events:
    """The last events, as lines."""

    def __init__(self) -> None:
        self._lines: deque[str] = deque(maxlen=EVENTS_KEPT)
        self._event_lines = EventLines()

    def receive(self, event: dict[str, Any]) -> None:
        lines = self._event_lines.lines(event)
        if event["event"] in ("told", "set", "line"):
            self._lines.extend(lines)

    def last(self, count: int) -> RenderableType:
        rows = list(self._lines)[-count:] if count > 0 else []
        return Text("\n".join(rows), "dim", **_ONE_LINE)


class OverviewScreen:
    """A row for each of ``devices``, and what they told last.

    find: what the daemon says of a device that came later.
    """

    def __init__(
        self, devices: list[dict[str, Any]], find: Callable[[str], dict[str, Any]]
    ) -> None:
        self._find = find
        self._devices = {each["name"]: _WatchedDevice(each) for each in devices}
        self._events = _Events()

    def receive(self, event: dict[str, Any]) -> None:
        """A device, or a line, has news."""
        self._events.receive(event)
        name = event.get("device")
        if event["event"] == "snapshot" and name not in self._devices:
            with contextlib.suppress(UsageError):  # it has just gone again
                self._devices[event["device"]] = _WatchedDevice(self._find(event["device"]))
        if event.get("kind") == "line_removed":
            for gone in event["details"]["devices"]:
                self._devices.pop(gone, None)
        if name in self._devices:
            self._devices[event["device"]].receive(event)

    def render(self, width: int, height: int) -> RenderableType:
        """As many devices as there are rows for, then events; a narrow terminal has no rates."""
        shown = list(self._devices.values())[: max(1, height - 2)]
        left = len(self._devices) - len(shown)
        table = Table(box=None, expand=True, pad_edge=False, padding=(0, 1, 0, 0))
        for title in (
            "device",
            "state",
            "position",
            *(("speed",) if width >= WIDE_COLUMNS else ()),
        ):
            table.add_column(title, header_style="dim", **_ONE_LINE)
        if width < NARROW_COLUMNS:
            table.columns.pop()
        for device in shown:
            cells: list[str | Text] = [
                device.name,
                device.state,
                device.on_axes("position", ""),
                device.on_axes("rate", "/s"),
            ]
            table.add_row(*cells[: len(table.columns)])
        if left:
            return Group(table, _more(f"{left} more"))
        room = height - len(shown) - 2
        return Group(table, Text(), self._events.last(room)) if room > 0 else table


class DetailScreen:
    """All that ``device`` shows, by its ``controls``: groups, bits by name, and what it tells."""

    def __init__(self, device: dict[str, Any], controls: list[dict[str, Any]]) -> None:
        self._device = _WatchedDevice(device)
        self._controls = {each["name"]: each for each in controls}
        self._events = _Events()

    def receive(self, event: dict[str, Any]) -> None:
        """The device, or its line, has news."""
        self._events.receive(event)
        if event.get("device") == self._device.name:
            self._device.receive(event)

    def render(self, width: int, height: int) -> RenderableType:
        """A head, the values in one column or two, and events where there is room."""
        device = self._device
        head = Text.assemble((device.name, "bold"), "  ", device.state, **_ONE_LINE)
        head.append(f"  {device.time_ns / 1e9:.1f} s", "dim")
        rows = self._rows()
        columns = 2 if width >= WIDE_COLUMNS else 1
        length = -(-len(rows) // columns)
        room = height - 2
        parts: list[RenderableType] = [head]
        table = Table.grid(expand=True, padding=(0, 2, 0, 0))
        for _ in range(columns):
            table.add_column(style="dim", no_wrap=True)
            table.add_column(ratio=1, **_ONE_LINE)
        for at in range(min(length, room)):
            pairs = [
                rows[n] if n < len(rows) else ("", "") for n in range(at, len(rows) + 1, length)
            ]
            table.add_row(*(cell for pair in pairs[:columns] for cell in pair))
        parts.append(table)
        if length > room:
            parts.append(_more(f"{length - room} rows more"))
        elif room - length > 1:
            parts += [Text(), self._events.last(room - length - 1)]
        return Group(*parts)

    def _rows(self) -> list[tuple[str, str]]:
        """Name and value; switches of a group are one row with those that are on."""
        values = self._device.values
        switches = [name for name, value in values.items() if isinstance(value, bool)]
        members: dict[str, list[str]] = {}
        for name in switches:
            members.setdefault(name.partition(".")[0], []).append(name)
        rows: dict[str, str] = {}
        for name, value in values.items():
            group = name.partition(".")[0]
            control = self._controls.get(name) or self._controls.get(group, {})
            if len(members.get(group, ())) > 1:
                on = [each.partition(".")[2] for each in members[group] if values[each]]
                rows[group] = ", ".join(on) or "none on"
            elif control.get("bits"):
                on = [bit["name"] for bit in control["bits"] if value >> bit["bit"] & 1]
                rows[name] = ", ".join(on) or "none"
            elif name not in ("state", "power"):
                rows[name] = f"{_plain(value)} {control.get('unit', '')}".strip()
        return [(name.replace("_", " ").replace(".", " "), value) for name, value in rows.items()]


def _more(count: str) -> Text:
    return Text(f"{count}; make the terminal higher", "yellow", **_ONE_LINE)


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, list):
        return ", ".join(map(_plain, value)) or "–"
    if isinstance(value, float):
        return f"{value:.3f}".rstrip("0").rstrip(".")
    return "–" if value in (None, "") else str(value)
