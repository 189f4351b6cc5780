"""``axistwin replay``: would a twin have said what was recorded?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import click

from axistwin import catalog
from axistwin.kernel.time import NS_PER_MS

if TYPE_CHECKING:
    from axistwin.cli.replay.capture import Exchange
    from axistwin.cli.replay.comparison import Difference, SameSoon
    from axistwin.cli.replay.host_port import TwinSetup
    from axistwin.devices.family import Model, Value
    from axistwin.wire.can_frame import CanFrame

EXIT_DIFFERENT: Final = 1

SHOWN_MAX: Final = 10
"""Exchanges that are shown; of the rest only how many there are."""

_HELP: Final = {
    "against": "Model of the twin, and its address (default: the model's).",
    "window": "By how much the times of messages and replies may differ.",
    "profile": "Quirks of the twin, as for 'axistwin run'.",
    "quirk": "One quirk of the twin; beats --profile.",
    "set": "Work a control of the twin before: inputs.m1_plus=on.",
    "infer": "Look for the quirks that explain the differences, and print them as a profile.",
}


@click.command(
    epilog="Exit status: 0 the twin says the same, or does so with the profile of --infer; "
    "1 it does not; 2 wrong usage."
)
@click.argument("capture")
@click.option(
    "--against", "device", metavar="MODEL[:ADDRESS]", required=True, help=_HELP["against"]
)
@click.option(
    "--window",
    "window_ms",
    type=click.FloatRange(0, 3_600_000),
    default=50.0,
    show_default=True,
    metavar="MS",
    help=_HELP["window"],
)
@click.option("--profile", metavar="FILE", help=_HELP["profile"])
@click.option("--quirk", "quirks", metavar="NAME=VALUE", multiple=True, help=_HELP["quirk"])
@click.option("--set", "settings", metavar="NAME=VALUE", multiple=True, help=_HELP["set"])
@click.option("--infer", is_flag=True, help=_HELP["infer"])
def replay(
    capture: str,
    device: str,
    window_ms: float,
    profile: str | None,
    quirks: tuple[str, ...],
    settings: tuple[str, ...],
    infer: bool,
) -> int:
    """Compare a recording with what a twin would have said.

    CAPTURE is a recording of 'axistwin tap' or 'axistwin run --capture'.  A twin gets what the host
    said, at the recorded times but in virtual time.  Each exchange in which it replies otherwise is
    shown: '-' is what was recorded, '+' what the twin says.

    \b
    axistwin replay capture.txt --against mac23
    axistwin replay candump.log --against mac23-can:2 --window 5
    axistwin replay capture.txt --against msc-250 --infer > my-msc.toml
    """
    from axistwin.cli.replay.capture import read_capture
    from axistwin.cli.replay.comparison import differences
    from axistwin.cli.replay.host_port import TwinSetup, parse_control

    spec = catalog.parse_device(device)
    model = catalog.find_model(spec.model)
    chosen = catalog.all_settings([spec], profile, catalog.parse_settings(quirks))
    controls = dict(map(parse_control, settings))
    setup = TwinSetup(model, spec.address, chosen, controls)
    exchanges = read_capture(model, capture)
    window_ns = round(window_ms * NS_PER_MS)
    known: SameSoon = {}
    found = differences(setup, exchanges, window_ns, known)
    if infer:
        return _infer(capture, setup, exchanges, window_ns, found, known)
    for difference in found[:SHOWN_MAX]:
        _show(model, difference, len(exchanges))
    if len(found) > SHOWN_MAX:
        click.echo(f"… {len(found) - SHOWN_MAX} more")
    counted = f"{len(exchanges)} exchange{'s' * (len(exchanges) > 1)}"
    if not found:
        click.echo(f"{capture}: {counted}, {device} says the same")
        return 0
    click.echo(f"{capture}: {counted}, {device} says something else in {len(found)}")
    return EXIT_DIFFERENT


def _show(model: Model, difference: Difference, count: int) -> None:
    """One exchange in which the twin replies otherwise."""
    from axistwin.cli.send import row_of

    def show(sign: str, parts: tuple[bytes | CanFrame, ...]) -> None:
        for part in parts:
            click.echo(row_of(model, sign, part))
        if not parts:
            click.echo(f"{sign} nothing")

    request = difference.exchange.request
    at_ms = request.at_ns / NS_PER_MS
    click.echo(f"exchange {difference.index + 1} of {count}, at {at_ms:.3f} ms")
    click.echo(row_of(model, ">", request.content))
    if difference.is_content:
        show("-", difference.recorded)
        show("+", difference.told)
    else:
        show("=", difference.told)
    if difference.late_ns:
        way = "later" if difference.late_ns > 0 else "earlier"
        click.echo(f"  the twin: {abs(difference.late_ns) / NS_PER_MS:.3f} ms {way} than recorded")
    click.echo("")


def _infer(
    capture: str,
    setup: TwinSetup,
    exchanges: list[Exchange],
    window_ns: int,
    found: list[Difference],
    known: SameSoon,
) -> int:
    """Print the profile that explains most."""
    from axistwin.cli.replay.inference import inferred

    proposal = inferred(setup, exchanges, found, window_ns, known)
    if found and not proposal.added:
        click.echo(
            f"axistwin: {capture}: no quirk of {setup.model.name} explains any of {len(found)} "
            "differences alone; leave --infer out to see them",
            err=True,
        )
        return EXIT_DIFFERENT
    explained = len(found) - proposal.left
    click.echo(f"# {capture}: explains {explained} of {len(found)} exchanges that differ")
    for name, value in proposal.ties:
        click.echo(f"# {_setting(setup, name, value)} explains as many")
    click.echo(f'model = "{setup.model.name}"\n\n[quirks]')
    for name, value in {**setup.quirks, **proposal.added}.items():
        click.echo(_setting(setup, name, value))
    return EXIT_DIFFERENT if proposal.left else 0


def _setting(setup: TwinSetup, name: str, value: Value) -> str:
    """A quirk as a profile has it."""
    quirk = setup.model.quirks[name]
    value = quirk.parse(value)
    if value in quirk.choices:
        value = quirk.allowed[quirk.choices.index(value)]
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'{name} = "{escaped}"'
    return f"{name} = {str(value).lower()}"
