"""``axistwin ctl``: the controls of a running daemon's devices, from a shell."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from typing import Any, Final, TypeVar

import click

from axistwin.cli.event_lines import EventLines, missing_for_watching, shown
from axistwin.cli.wire_faults import FAULT_ACTIONS, FAULTS, LINE, work_line
from axistwin.control.client import ControlClient
from axistwin.control.tls import CA_VARIABLE
from axistwin.control.token import TOKEN_VARIABLE, find_token
from axistwin.errors import AxistwinError, UsageError, nearest
from axistwin.wire.wire_fault import FAULT_FIELDS, FAULT_TYPES

ADDRESS: Final = "127.0.0.1:8080"
ON: Final = ("on", "true", "yes", "1")
OFF: Final = ("off", "false", "no", "0")
POWER_WORDS: Final = ("on", "off", "cycle")
WATCH: Final = "watch"


CommandT = TypeVar("CommandT", bound=Callable[..., Any])


def daemon_options(command: CommandT) -> CommandT:
    """Where the daemon is, and its token."""
    for option in (
        click.option(
            "--control-token-file",
            "token_file",
            metavar="FILE",
            help=f"The daemon's token, if it wants one (default: ${TOKEN_VARIABLE}).",
        ),
        click.option(
            "--control-ca",
            "authority",
            metavar="FILE",
            envvar=CA_VARIABLE,
            help="Certificates to trust at an https:// address, PEM (default: "
            f"${CA_VARIABLE}, or those that this machine trusts).",
        ),
        click.option(
            "--control",
            "control_address",
            metavar="[URL|HOST:PORT]",
            envvar="AXISTWIN_CONTROL",
            help="Where the daemon's control API is, https://HOST:PORT if it has a certificate "
            f"(default: $AXISTWIN_CONTROL, or {ADDRESS}).",
        ),
    ):
        command = option(command)
    return command


def complete_by(
    find: Callable[[ControlClient, dict[str, Any]], list[str]],
) -> Callable[[click.Context, click.Parameter, str], list[str]]:
    """Completes by what the daemon answers; by nothing if it does not."""

    def complete(context: click.Context, _: click.Parameter, begun: str) -> list[str]:
        try:
            address, authority = (context.params.get(x) for x in ("control_address", "authority"))
            client = make_client(address, None, authority)
            return [name for name in find(client, context.params) if name.startswith(begun)]
        except AxistwinError:
            return []

    return complete


def device_names(client: ControlClient, _: dict[str, Any]) -> list[str]:
    """What the daemon's devices are called."""
    return [each["name"] for each in client.get("devices")["devices"]]


def _first_words(client: ControlClient, given: dict[str, Any]) -> list[str]:
    return [*device_names(client, given), LINE]


def _control_names(client: ControlClient, given: dict[str, Any]) -> list[str]:
    if given["device"] == LINE:
        return [FAULTS, *(each["name"] for each in client.get("lines")["lines"])]
    controls = client.get("devices", given["device"], "controls")["controls"]
    return [*(each["name"] for each in controls), WATCH]


def _values(client: ControlClient, given: dict[str, Any]) -> list[str]:
    if given["device"] == LINE:
        return [*FAULT_ACTIONS, *FAULT_TYPES, *(f"{name}=" for name in FAULT_FIELDS[1:])]
    if given["control"] == "power":
        return list(POWER_WORDS)
    if given["control"] == WATCH:
        return _control_names(client, given)[:-1]
    info = client.get("devices", given["device"], "controls", given["control"])
    return ["on", "off"] if info["kind"] == "switch" else list(info["choices"])


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("device", required=False, shell_complete=complete_by(_first_words))
@click.argument("control", required=False, shell_complete=complete_by(_control_names))
@click.argument("values", metavar="[VALUE]", nargs=-1, shell_complete=complete_by(_values))
@daemon_options
@click.option("--json", "as_json", is_flag=True, help="Answers and events as JSON.")
def ctl(
    device: str | None,
    control: str | None,
    values: tuple[str, ...],
    control_address: str | None,
    token_file: str | None,
    authority: str | None,
    as_json: bool,
) -> None:
    """Work what is around the devices of a daemon: inputs, supply, power, load, faults.

    \b
    axistwin ctl                                 the devices
    axistwin ctl mac23:0                         its controls, with values
    axistwin ctl mac23:0 inputs.reference        one value
    axistwin ctl mac23:0 inputs.reference on     set it
    axistwin ctl mac23:0 push -25                a number may be negative
    axistwin ctl mac23:0 power cycle 0.5         off for half a second; on, off
    axistwin ctl mac23:0 watch position          lines as it changes, until Ctrl-C
    axistwin ctl line faults                     of the wire, with what they did
    axistwin ctl line faults add drop direction=to_host    lose the next reply
    axistwin ctl line NAME faults remove 1       of the line called so; or all

    The daemon is 'axistwin run MODEL --control HOST:PORT'.  What is set is set at once, and holds
    when the command returns.
    """
    for word in (device or "", control or "", *values):
        if word.startswith("-") and not word[1:2].isdigit():
            raise UsageError(f"no option {word}; see 'axistwin ctl --help'")
    client = make_client(control_address, token_file, authority)
    if device == LINE:
        work_line(client, tuple(word for word in (control, *values) if word), as_json)
    elif device is None:
        _show_devices(client, as_json)
    elif control is None:
        _show_controls(client, device, as_json)
    elif control == WATCH:
        _watch(client, device, values, as_json)
    elif control == "power" and values:
        _switch_power(client, device, values, as_json)
    else:
        _work(client, device, control, values, as_json)


def make_client(
    address: str | None, token_file: str | None, authority: str | None
) -> ControlClient:
    """Asks the daemon that the options name.  Raises UsageError."""
    return ControlClient(address or ADDRESS, find_token(token_file, os.environ), authority)


def _show_devices(client: ControlClient, as_json: bool) -> None:
    devices = client.get("devices")["devices"]
    endpoints = {each["name"]: each["endpoints"] for each in client.get("lines")["lines"]}
    for each in devices:
        if as_json:
            click.echo(json.dumps(each))
            continue
        where = " ".join(f"{port['kind']}={port['url']}" for port in endpoints[each["line"]])
        power = "on" if each["power"] else "off"
        click.echo(f"{each['name']:<14} {where}  power {power}, {each['state']}")


def _show_controls(client: ControlClient, device: str, as_json: bool) -> None:
    for info in client.get("devices", device, "controls")["controls"]:
        if as_json:
            click.echo(json.dumps(info))
            continue
        value = shown(info["value"]) if info["readable"] else ""
        if isinstance(info["value"], dict | list):
            value = f"({len(info['value'])})"
        name = info["name"]
        if info["numbers"] is not None:
            name, value = f"{name}.N", "N: {first}..{last}".format(**info["numbers"])
        sign = " " if info["writable"] else "!"
        click.echo(f"{sign} {name:<24} {value:<20} {_takes(info)}".rstrip())
    if not as_json:
        click.echo("! can only be read")


def _takes(info: dict[str, Any]) -> str:
    """What a control is, and what it takes."""
    limits = ""
    if info["high"] is not None:
        limits = f"{info['low']:g}..{info['high']:g} "
    return f"{limits}{info['unit'] or ' '.join(info['choices'])}".strip()


def _switch_power(
    client: ControlClient, device: str, values: tuple[str, ...], as_json: bool
) -> None:
    word, *rest = values
    if word not in POWER_WORDS:
        raise UsageError(f"power {word!r}: {nearest(word, POWER_WORDS)}")
    off_s = 0.0
    if rest:
        if word != "cycle" or len(rest) > 1:
            raise UsageError(f"power {word} {rest[-1]}: too many words; only 'cycle' has a time")
        off_s = _number(rest[0], float)
    done = client.post("devices", device, "power", action=word, off_s=off_s)
    if as_json:
        click.echo(json.dumps(done))


def _work(
    client: ControlClient, device: str, control: str, values: tuple[str, ...], as_json: bool
) -> None:
    """Read the control, or set it; one that is an action is worked."""
    if len(values) > 1:
        raise UsageError(f"{control}: {len(values)} values were given; give one, in quotes")
    info = client.get("devices", device, "controls", control)
    if not values and info["kind"] != "nothing":
        if not info["readable"]:
            raise UsageError(f"{control} is only worked, not read; give a value, {_wanted(info)}")
        click.echo(json.dumps(info) if as_json else shown(info["value"]))
        return
    value = _parsed(info, values[0]) if values else None
    done = client.put("devices", device, "controls", control, value=value)
    if as_json:
        click.echo(json.dumps(done))


def _parsed(info: dict[str, Any], word: str) -> object:
    """``word`` as a value of the control."""
    kind, name = info["kind"], info["name"]
    if kind == "nothing":
        raise UsageError(f"{name} takes no value; leave {word!r} out")
    if kind == "switch":
        if word.lower() not in (*ON, *OFF):
            raise UsageError(f"{name} {word!r}: set on or off")
        return word.lower() in ON
    if kind in ("number", "whole"):
        return _number(word, float if kind == "number" else lambda text: int(text, 0))
    return word


def _number(word: str, parse: Callable[[str], float]) -> float:
    try:
        return parse(word)
    except ValueError:
        raise UsageError(f"{word!r} is no number; give one, such as 25") from None


def _wanted(info: dict[str, Any]) -> str:
    return {"switch": "on or off", "choice": " or ".join(info["choices"])}.get(
        info["kind"], f"such as 25 {info['unit']}".strip()
    )


def _watch(client: ControlClient, device: str, names: tuple[str, ...], as_json: bool) -> None:
    """Lines as things change, until somebody ends it."""
    known = client.get("devices", device, "state")["values"]
    for name in names:
        if name not in known:
            raise UsageError(f"{device} shows no {name!r}: {nearest(name, known)}")
    try:
        event_lines = EventLines(names)
        for event in client.watch(device):
            for line in [json.dumps(event)] if as_json else event_lines.lines(event):
                click.echo(line)
    except ImportError as error:
        raise missing_for_watching(error) from None
