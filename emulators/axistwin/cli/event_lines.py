"""Events of the control API as lines, for a shell: values as a script reads them."""

import json
from collections.abc import Sequence
from typing import Any

from axistwin.cli.extras import needed
from axistwin.errors import UsageError


def shown(value: Any) -> str:
    """A value as a script reads it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, float):
        return f"{value:g}"
    return value if isinstance(value, str) else json.dumps(value)


def missing_for_watching(error: ImportError) -> UsageError:
    """What to install for what could not be imported."""
    return UsageError(
        f"watch: {error.name} is missing; install what it needs: pip install {needed(error.name)}"
    )


class EventLines:
    """What people are told of events: only of the controls ``names``, unless there are none.

    What was set is told at once, and not again when somebody has looked.
    """

    def __init__(self, names: Sequence[str] = ()) -> None:
        self._names = names
        self._reported: dict[tuple[str, str], Any] = {}

    def lines(self, event: dict[str, Any]) -> list[str]:
        """A line for each thing that ``event`` has."""
        if event["event"] == "line":
            return [] if self._names else [f"{'':>12} {event['line']}: {event['kind']}"]
        device = event["device"]
        head = f"{event['time_ns'] / 1e9:12.3f} {device}"
        if event["event"] == "told":
            return [] if self._names else [f"{head} {event['text']}"]
        values: dict[str, Any] = event.get("values", {})
        if event["event"] == "set":
            name, value = event["control"], event["value"]
            if value is None:  # an action
                return [f"{head} {name}"] if self._is_wanted(name) else []
            values = {name: value}
        else:  # also a snapshot of one who comes again
            values = {
                name: value
                for name, value in values.items()
                if (device, name) not in self._reported or self._reported[device, name] != value
            }
        for name, value in values.items():
            self._reported[device, name] = value
        return [
            f"{head} {name} {shown(value)}"
            for name, value in values.items()
            if self._is_wanted(name)
        ]

    def _is_wanted(self, name: str) -> bool:
        return not self._names or name in self._names
