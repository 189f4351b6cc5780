"""``axistwin ctl line``: the faults of the wires of a running daemon, from a shell."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import click

from axistwin.control.client import ControlClient
from axistwin.errors import UsageError, nearest
from axistwin.wire.wire_fault import FAULT_FIELDS, FAULT_TYPES

LINE: Final = "line"
FAULTS: Final = "faults"
FAULT_ACTIONS: Final = ("add", "remove")
ALL: Final = "all"

_PARSED: Final[Mapping[str, Callable[[str], object]]] = {
    "count": int,
    "chance": float,
    "per_s": float,
    "duration_ms": float,
}


def work_line(client: ControlClient, words: tuple[str, ...], as_json: bool) -> None:
    """Do what ``words`` behind ``line`` say: ``[NAME] faults``, and what is to be done to them.

    Raises UsageError and PortError.
    """
    lines = [each["name"] for each in client.get("lines")["lines"]]
    if words and words[0] != FAULTS:
        if words[0] not in lines:
            raise UsageError(f"no line {words[0]!r}: {nearest(words[0], [*lines, FAULTS])}")
        lines, words = [words[0]], words[1:]
    if not words or words[0] != FAULTS:
        raise UsageError(f"line {' '.join(words)}: write 'axistwin ctl line faults'".strip())
    _, *rest = words
    if not rest:
        for line in lines:
            _tell(client.get("lines", line, FAULTS)["faults"], as_json)
        return
    action, *arguments = rest
    if action not in FAULT_ACTIONS:
        raise UsageError(f"line faults {action}: {nearest(action, FAULT_ACTIONS)}")
    if len(lines) > 1:
        raise UsageError(f"there are several lines; name one: line NAME faults {action} ...")
    if action == "add":
        _tell([client.post("lines", lines[0], FAULTS, **_order(arguments))], as_json)
    else:
        _remove(client, lines[0], arguments, as_json)


def _order(words: list[str]) -> dict[str, object]:
    """The fault that ``KIND [KEY=VALUE]...`` asks for."""
    if not words or "=" in words[0]:
        raise UsageError(f"line faults add: a kind is missing: {nearest('', FAULT_TYPES)}")
    order: dict[str, object] = {"kind": words[0]}
    if words[0] not in FAULT_TYPES:
        raise UsageError(f"kind {words[0]!r}: {nearest(words[0], FAULT_TYPES)}")
    for word in words[1:]:
        key, equals, text = word.partition("=")
        key = key.replace("-", "_")
        if not equals or key not in FAULT_FIELDS[1:]:
            raise UsageError(f"{word!r}: write KEY=VALUE: {nearest(key, FAULT_FIELDS[1:])}")
        try:
            order[key] = _PARSED.get(key, str)(text)
        except ValueError:
            raise UsageError(f"{key} {text!r}: that is no number; give one, such as 2") from None
    return order


def _remove(client: ControlClient, line: str, words: list[str], as_json: bool) -> None:
    if words == [ALL]:
        _tell(client.delete("lines", line, FAULTS)["faults"], as_json)
        return
    if len(words) != 1 or not words[0].isdecimal():
        raise UsageError(f"line faults remove {' '.join(words)}: give its number, or '{ALL}'")
    _tell([client.delete("lines", line, FAULTS, words[0])], as_json)


def _tell(faults: Iterable[Mapping[str, Any]], as_json: bool) -> None:
    for each in faults:
        if as_json:
            click.echo(json.dumps(each))
            continue
        chosen = [
            f"{name}={each[name]:g}" if isinstance(each[name], float) else f"{name}={each[name]}"
            for name in FAULT_FIELDS[1:]
            if each[name] not in (None, "")
        ]
        shown = " ".join([each["kind"], *chosen])
        done = f"seen {each['seen']}, acted {each['acted']}{', over' if each['over'] else ''}"
        last = f"; last {each['last_ns'] / 1e9:.3f} s: {each['last']}" if each["last"] else ""
        click.echo(f"{each['number']:>3} {each['line']}  {shown}  {done}{last}")
