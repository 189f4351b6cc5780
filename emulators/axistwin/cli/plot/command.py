"""``axistwin plot``: the motion of commands, of a recording, or of a device as a picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from axistwin import catalog
from axistwin.errors import UsageError

if TYPE_CHECKING:
    from axistwin.cli.plot.track import MotionTrack
    from axistwin.cli.plot.twin_motion import HostMessage, PlayedMotion
    from axistwin.cli.replay.capture import Exchange
    from axistwin.cli.replay.host_port import TwinSetup
    from axistwin.devices.controls import AxisReadout
    from axistwin.devices.family import Model

LIMIT_S: Final = 60.0
LIVE_S: Final = 10.0
_SPAN: Final = click.FloatRange(0.001, 86_400)

_HELP: Final = {
    "program": "Commands from a file, one in a line; each is sent when all axes stand.  # begins a "
    "remark.",
    "capture": "What the host sends in a recording of 'axistwin run --capture', at its times.",
    "live": "Positions that the device at PORT tells when it is asked, after the commands: as "
    "many as its line carries.",
    "output": "Picture to write, .png or .svg (default: MODEL.png).",
    "axes": "Axes over time (default: those that move).",
    "planes": "Planes of the path (default: those of the first three axes that move).",
    "title": "Title (default: the device and the source).",
    "seconds": "Longest motion that is waited for, in the twin's time (default: "
    f"{LIMIT_S:g}); with --live, how long to ask (default: {LIVE_S:g}).",
    "set": "Work a control of the twin before: spindle_hz=1000, inputs.m1_plus=on.",
    "profile": "Quirks of the twin, as for 'axistwin run'.",
    "quirk": "One quirk of the twin; beats --profile.",
    "baud": "Rate of PORT (default: the model's).",
}


@dataclass(frozen=True, slots=True)
class PlotOptions:
    """What is to be drawn of which device: one of the four sources.

    commands: in words.  live: the port of a device, which may be told commands first.
    settings: of the twin's controls.  seconds: how long at most, behind the last command; of a live
    device how long it is asked.
    """

    device: str
    commands: tuple[str, ...]
    program: str | None
    capture: str | None
    live: str | None
    profile: str | None
    quirks: tuple[str, ...]
    settings: tuple[str, ...]
    baud: int | None
    seconds: float | None


@click.command(epilog="Exit status: 0 the picture is written, 2 wrong usage, or nothing moves.")
@click.argument("device", metavar="MODEL[:ADDRESS]")
@click.argument("commands", metavar="[COMMAND]...", nargs=-1)
@click.option("--program", metavar="FILE", help=_HELP["program"])
@click.option("--capture", metavar="FILE", help=_HELP["capture"])
@click.option("--live", metavar="PORT", help=_HELP["live"])
@click.option("-o", "--output", "target", metavar="FILE", help=_HELP["output"])
@click.option("--axes", metavar="M1,M3", help=_HELP["axes"])
@click.option("--planes", metavar="M1-M3,...", help=_HELP["planes"])
@click.option("--title", metavar="TEXT", help=_HELP["title"])
@click.option("--seconds", type=_SPAN, metavar="N", help=_HELP["seconds"])
@click.option("--set", "settings", metavar="NAME=VALUE", multiple=True, help=_HELP["set"])
@click.option("--profile", metavar="FILE", help=_HELP["profile"])
@click.option("--quirk", "quirks", metavar="NAME=VALUE", multiple=True, help=_HELP["quirk"])
@click.option("--baud", type=int, metavar="N", help=_HELP["baud"])
def plot(
    device: str,
    commands: tuple[str, ...],
    target: str | None,
    axes: str | None,
    planes: str | None,
    title: str | None,
    **source: Any,
) -> None:
    """Draw how a device moves: its path, and position and rate of each axis.

    A twin gets the commands in virtual time, and its exact motion is drawn.  COMMAND is one of
    those of 'axistwin send', pauses too.  The time counts from the first step.

    \b
    axistwin plot mac23 'go to 1000' -o ramp.svg
    axistwin plot mn400 V3000 M2000,-500 'wait 300 ms' '{'
    axistwin plot mn400 --program part.txt --planes M1-M2
    axistwin plot mn400 --capture traffic.txt -o contour.png
    axistwin plot mn400 --live /dev/ttyUSB0 M5000 --seconds 4

    A device tells positions only when it is asked: what --live draws between them is a straight
    line, and the rate is the mean between two answers.
    """
    from axistwin.cli.plot import drawing
    from axistwin.cli.plot.track import chosen_axes, chosen_planes

    options = PlotOptions(device, commands, **source)
    spec = catalog.parse_device(device)
    target = target or f"{spec.model}.png"
    drawing.check_target(target)
    track = _track(options, spec).trimmed()
    shown = chosen_axes(track, axes)
    over = chosen_planes(track, planes, shown)
    drawing.draw(track, shown, over, _title(options) if title is None else title, target)
    names = ", ".join(track.names[axis] for axis in shown)
    click.echo(f"{target}: {names}, {track.span_s:.3f} s")


def _title(options: PlotOptions) -> str:
    source = options.live or options.capture or options.program
    return f"{options.device}: {Path(source).name if source else ' '.join(options.commands)}"


def _track(options: PlotOptions, spec: catalog.DeviceSpec) -> MotionTrack:
    """What moves.  Raises UsageError and PortError."""
    from axistwin.cli.plot import sources

    model = catalog.find_model(spec.model)
    view = model.family.axis_readout()
    if view is None:
        known = (each.name for each in catalog.models().values() if each.family.axis_readout())
        raise UsageError(f"{model.name} has no axes to draw; those with axes: {', '.join(known)}")
    _check(options)
    words = sources.from_words(model, spec.address, options.commands)
    exchanges: list[Exchange] = []
    if options.live is not None:
        requests = [message.content for message in words]
        span_s, baud = options.seconds or LIVE_S, options.baud
        return sources.read_out(model, view, options.live, spec.address, requests, baud, span_s)
    if options.program is not None:
        words = sources.from_program(model, spec.address, options.program)
    elif options.capture is not None:
        from axistwin.cli.replay.capture import read_capture

        exchanges = read_capture(model, options.capture)
        words = sources.from_exchanges(exchanges)
    return _of_twin(options, spec, model, view, words, exchanges)


def _check(options: PlotOptions) -> None:
    """One source, and options that belong to it.  Raises UsageError."""
    sources = {
        "commands": options.commands if options.live is None else (),
        "--program": options.program,
        "--capture": options.capture,
        "--live": options.live,
    }
    given = [name for name, value in sources.items() if value]
    if len(given) != 1:
        found = f"{' and '.join(given)} are given" if given else "nothing to draw is given"
        raise UsageError(f"{found}; give commands, or one of --program, --capture and --live")
    if options.live is None:
        if options.baud is not None:
            raise UsageError("--baud: is for --live; a twin is talked to at its rate")
        return
    of_twin = {"profile": options.profile, "quirk": options.quirks, "set": options.settings}
    for name, value in of_twin.items():
        if value:
            raise UsageError(f"--{name}: is for a twin, not for the device at {options.live}")
    if options.live.startswith("axistwin:"):
        raise UsageError(f"--live {options.live}: nothing else moves that twin; leave --live out")


def _of_twin(
    options: PlotOptions,
    spec: catalog.DeviceSpec,
    model: Model,
    view: AxisReadout,
    messages: list[HostMessage],
    exchanges: list[Exchange],
) -> MotionTrack:
    """The exact motion of a twin, with what it replied."""
    from axistwin.cli.plot.twin_motion import moved_twin
    from axistwin.cli.replay.host_port import TwinSetup, parse_control

    quirks = catalog.all_settings([spec], options.profile, catalog.parse_settings(options.quirks))
    controls = dict(parse_control(text) for text in options.settings)
    setup = TwinSetup(model, spec.address, quirks, controls)
    limit_s = options.seconds or LIMIT_S
    played, track = moved_twin(setup, view, messages, limit_s)
    if options.capture is None:
        _show_replies(model, messages, played)
    else:
        _show_differences(options.capture, setup, exchanges)
    if played.is_cut:
        click.echo(
            f"axistwin: an axis still moves, or waits for pulses, {limit_s:g} s behind the last "
            "command; the picture ends there (--seconds)",
            err=True,
        )
    return track


def _show_replies(model: Model, messages: list[HostMessage], played: PlayedMotion) -> None:
    """As ``axistwin send`` does."""
    from axistwin.cli.send import row_of

    for message, reply in zip(messages, played.replies, strict=True):
        if isinstance(message.content, float):
            click.echo(f"> wait {message.content:g} s")
        else:
            click.echo(row_of(model, ">", message.content))
        for part in reply:
            click.echo(row_of(model, "<", part))


def _show_differences(capture: str, setup: TwinSetup, exchanges: list[Exchange]) -> None:
    """Where the twin does not say what was recorded."""
    from axistwin.cli.replay.comparison import differences

    found = [each for each in differences(setup, exchanges) if each.is_content]
    if not found:
        return
    recorded, told = (
        "; ".join(map(setup.model.explain, parts)) or "nothing"
        for parts in (found[0].recorded, found[0].told)
    )
    click.echo(
        f"axistwin: {capture}: {len(found)} of {len(exchanges)} replies of the twin are not those "
        f"recorded, first {told!r} for {recorded!r}; 'axistwin replay' shows all, and may find the "
        "quirk",
        err=True,
    )
