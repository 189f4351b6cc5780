"""``axistwin watch``: a screen that follows a daemon's devices, or lines where there is none."""

from __future__ import annotations

import os
import sys
from typing import Any

import click

from axistwin.cli.ctl import complete_by, daemon_options, device_names, make_client
from axistwin.cli.event_lines import EventLines, missing_for_watching
from axistwin.control.client import HTTP, HTTPS, ControlClient
from axistwin.errors import UsageError


@click.command()
@click.argument(
    "target", metavar="[URL|NAME]", required=False, shell_complete=complete_by(device_names)
)
@daemon_options
def watch(
    target: str | None,
    control_address: str | None,
    token_file: str | None,
    authority: str | None,
) -> None:
    """Show what the devices of a daemon do, until Ctrl-C.

    \b
    axistwin watch                               all devices
    axistwin watch mac23:0                       one device, with all it shows
    axistwin watch http://127.0.0.1:8080         another daemon
    axistwin watch http://127.0.0.1:8080/mac23:0

    The daemon is 'axistwin run MODEL --control HOST:PORT' or 'axistwin rack FILE'.  Where standard
    output is no terminal, each change is a line.
    """
    name = target or ""
    if name.startswith((HTTP, HTTPS)):
        if (
            control_address
            and click.get_current_context().get_parameter_source("control_address")
            is click.core.ParameterSource.COMMANDLINE
        ):
            raise UsageError(f"{target}: it says where the daemon is; leave out --control")
        scheme, _, rest = name.partition("://")
        place, _, name = rest.partition("/")
        control_address = f"{scheme}://{place}"
    client = make_client(control_address, token_file, authority)
    devices = [client.get("devices", name)] if name else client.get("devices")["devices"]
    try:
        if sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb":
            _show(client, devices, is_detailed=bool(name))
        else:
            _print(client, *([devices[0]["name"]] if name else ()))
    except ImportError as error:
        raise missing_for_watching(error) from None


def _print(client: ControlClient, *devices: str) -> None:
    event_lines = EventLines()
    for event in client.watch(*devices):
        for line in event_lines.lines(event):
            click.echo(line)


def _show(client: ControlClient, devices: list[dict[str, Any]], *, is_detailed: bool) -> None:
    from axistwin.cli.watch.screen import DetailScreen, OverviewScreen, follow

    if is_detailed:
        (device,) = devices
        controls = client.get("devices", device["name"], "controls")["controls"]
        screen: OverviewScreen | DetailScreen = DetailScreen(device, controls)
        follow(screen, client.watch(device["name"]))
    else:
        screen = OverviewScreen(devices, lambda name: client.get("devices", name))
        follow(screen, client.watch())
