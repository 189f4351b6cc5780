"""``axistwin run``: twins on a serial line or a CAN bus, served until a signal ends it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from axistwin.errors import UsageError

if TYPE_CHECKING:
    from axistwin.catalog import DeviceSpec
    from axistwin.devices.family import Carrier

_HELP_PTY = (
    "Pseudo terminal behind the symbolic link LINK (default: ./MODEL of the first device, "
    "and none with --tcp, --rfc2217 or --hid alone)."
)
_HELP_TCP = "Raw TCP, several clients; port 0: any free one.  For socket://HOST:PORT."
_HELP_HID = "USB port of an MN400, as a HID device of this machine (needs /dev/uhid: see doctor)."
_HELP_RFC2217 = "TCP with rate, framing and break, one client.  For rfc2217://HOST:PORT."
_HELP_BAUD = "Rate of modules that have none stored yet, bits per second (default: the factory's)."

_HELP_PROFILE = "Quirks from a TOML file, or the name of a profile that comes with a model: mn100."
_HELP_PROGRAM = (
    "Macroprogram of the controllers: FILE.py, FILE.py:CLASS, or a name such as bench; "
    "UNIT=PROGRAM for one of several."
)

# On CAN.
_HELP_CAN = (
    "Join a bus through any python-can interface: socketcan:vcan0, udp_multicast:239.74.163.2, "
    "slcan:/dev/ttyACM0 (default: socketcan:vcan0 if it is up, else --slcan ./MODEL)."
)
_HELP_SLCAN = "Be the bus: an slcan adapter behind the symbolic link LINK."
_HELP_SLCAN_TCP = "Be the bus: an slcan adapter for each client.  For socket://HOST:PORT."
_HELP_SOCKETCAND = "Be the bus: the daemon socketcand, with the bus vcan0."
_HELP_BITRATE = "Rate of the bus, bits per second (default: 125000)."

# Options that only one kind of model has: parameter, option.
_OWN_OPTIONS: Mapping[Carrier, Mapping[str, str]] = {
    "serial": {
        "links": "--pty",
        "tcp": "--tcp",
        "rfc2217": "--rfc2217",
        "hid": "--hid",
        "baud": "--baud",
        "programs": "--program",
    },
    "can": {
        "can": "--can",
        "slcan": "--slcan",
        "slcan_tcp": "--slcan-tcp",
        "socketcand": "--socketcand",
        "bitrate": "--bitrate",
    },
}
_LIVES_ON: Mapping[Carrier, str] = {"serial": "a serial line", "can": "a CAN bus"}


def _named(_: click.Context, option: click.Parameter, value: Any) -> Any:
    """A path, or several, none of them empty as an unset variable of a script leaves it."""
    if "" in ((value,) if isinstance(value, str) else value or ()):
        raise UsageError(f"{option.opts[0]}: needs a name, such as ./mac23")
    return value


@click.command(
    epilog="Ends on Ctrl-C or SIGTERM, with the link removed and the state saved.  "
    "Quirks: 'axistwin models MODEL'.  This machine: 'axistwin doctor'."
)
@click.argument("devices", metavar="MODEL[:ADDRESS]...", nargs=-1)
@click.option("--pty", "links", callback=_named, metavar="LINK", multiple=True, help=_HELP_PTY)
@click.option("--tcp", "tcp", metavar="HOST:PORT", multiple=True, help=_HELP_TCP)
@click.option("--rfc2217", "rfc2217", metavar="HOST:PORT", multiple=True, help=_HELP_RFC2217)
@click.option("--hid", is_flag=True, help=_HELP_HID)
@click.option(
    "--state",
    callback=_named,
    metavar="DIR",
    help="Folder that holds what the modules store (default: nothing outlives this run).",
)
@click.option("--profile", callback=_named, metavar="FILE", help=_HELP_PROFILE)
@click.option(
    "--quirk", "quirks", metavar="NAME=VALUE", multiple=True, help="One quirk; beats --profile."
)
@click.option("--baud", type=int, metavar="N", help=_HELP_BAUD)
@click.option(
    "--program",
    "programs",
    callback=_named,
    metavar="[UNIT=]PROGRAM",
    multiple=True,
    help=_HELP_PROGRAM,
)
@click.option("--can", "can", metavar="INTERFACE:CHANNEL", multiple=True, help=_HELP_CAN)
@click.option("--slcan", callback=_named, metavar="LINK", multiple=True, help=_HELP_SLCAN)
@click.option("--slcan-tcp", metavar="HOST:PORT", multiple=True, help=_HELP_SLCAN_TCP)
@click.option("--socketcand", metavar="HOST:PORT", multiple=True, help=_HELP_SOCKETCAND)
@click.option("--bitrate", type=int, metavar="N", help=_HELP_BITRATE)
@click.option(
    "--speed",
    type=float,
    default=1.0,
    metavar="X",
    show_default=True,
    help="Run X times as fast as real time.",
)
@click.option(
    "--no-pacing", is_flag=True, help="Bytes and frames take no time; the modules' own times stay."
)
@click.option(
    "--cold", is_flag=True, help="Apply the supply now: the modules are deaf for their first 2 s."
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    metavar="N",
    show_default=True,
    help="Seed of all random choices.",
)
@click.option(
    "--capture",
    callback=_named,
    metavar="FILE",
    help="Append the traffic to FILE: of a line, time in ms, > or <, bytes in hex, meaning; of a "
    "bus, as candump logs it.",
)
@click.option(
    "--control",
    metavar="HOST:PORT",
    help="Serve the control API there, for 'axistwin ctl' and programs; port 0: any free one.",
)
@click.option(
    "--control-token-file",
    callback=_named,
    metavar="FILE",
    help="Token that every request must have (else of AXISTWIN_CONTROL_TOKEN); needed at any "
    "address but the loopback.",
)
@click.option(
    "--control-certificate",
    callback=_named,
    metavar="FILE",
    help="Serve the control API over TLS, with the certificate (and those above it) in FILE, PEM.",
)
@click.option(
    "--control-key",
    callback=_named,
    metavar="FILE",
    help="Private key of the certificate, PEM (default: in the file of the certificate).",
)
@click.option("--json", "as_json", is_flag=True, help="Events on stdout, one JSON object per line.")
def run(devices: tuple[str, ...], as_json: bool, **options: Any) -> int:
    """Run twins on a serial line or a CAN bus that any program can open.

    Several devices share the line, as modules on RS-485 do, or the bus.  Several endpoints may be
    given; every client hears everything.  When clients can connect, one line per device says so:

    \b
    $ axistwin run mac23
    ready mac23:0 pty=./mac23 (/dev/pts/5)

    \b
    axistwin run mac23:0 mac34-1:5 --pty ./mac --state ./mac.state
    axistwin run mac23 --tcp 127.0.0.1:5000 --rfc2217 127.0.0.1:5001
    axistwin run mac23:7Fh --no-pacing --quirk reply_latency_us=0
    axistwin run msc-250 --program table.py
    axistwin run mn400 --hid
    axistwin run mac23-can:1 mac23-can:2 --can socketcan:vcan0
    axistwin run mac23-can --slcan ./can --socketcand 127.0.0.1:29536

    ADDRESS: 0..127, also as 7Fh or 0x7F; default 0.  On CAN: 1..127; of an MSC: 1..15; default 1.
    """
    if not devices:
        raise UsageError("run: which devices? such as 'axistwin run mac23'; see 'axistwin models'")
    from axistwin import catalog
    from axistwin.cli.run.reporter import Reporter
    from axistwin.cli.run.serving import Shared, perform

    specs = [catalog.parse_device(text) for text in devices]
    carrier = _common_carrier(specs)
    own = _own_options(carrier, str(specs[0]), options)
    shared, reporter = Shared(**options), Reporter(as_json)
    if carrier == "can":
        from axistwin.cli.run.can import CanRun

        return perform(CanRun(specs, shared, **own), reporter)
    from axistwin.cli.run.serial import SerialRun

    return perform(SerialRun(specs, shared, **own), reporter)


def _common_carrier(specs: list[DeviceSpec]) -> Carrier:
    """What all devices live on.  Raises UsageError if that is not the same."""
    from axistwin import catalog

    first = specs[0]
    carrier = catalog.find_model(first.model).carrier
    for spec in specs:
        other = catalog.find_model(spec.model).carrier
        if other != carrier:
            raise UsageError(
                f"{first} lives on {_LIVES_ON[carrier]} and {spec} on {_LIVES_ON[other]}: they "
                "cannot share one run; start 'axistwin run' once for each"
            )
    return carrier


def _own_options(carrier: Carrier, device: str, options: dict[str, Any]) -> dict[str, Any]:
    """The options of ``carrier``, taken out of ``options`` with those of the other one.

    Raises UsageError if one of the latter is given.
    """
    taken = {each: {name: options.pop(name) for name in own} for each, own in _OWN_OPTIONS.items()}
    for other, values in taken.items():
        for name, value in values.items():
            if other != carrier and value not in (None, ()) and value is not False:
                raise UsageError(
                    f"{_OWN_OPTIONS[other][name]} is for {_LIVES_ON[other]}, and {device} lives on "
                    f"{_LIVES_ON[carrier]}: use {', '.join(_OWN_OPTIONS[carrier].values())}"
                )
    return taken[carrier]
