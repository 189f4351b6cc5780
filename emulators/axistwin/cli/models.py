"""``axistwin models``: the models, and the quirks of each."""

import json
from collections.abc import Iterable
from itertools import chain
from textwrap import wrap
from typing import Final

import click

from axistwin import catalog
from axistwin.devices.family import Model
from axistwin.devices.switches import Quirk
from axistwin.errors import UsageError, suggestion

ALL: Final = "all"
UNGROUPED: Final = "Quirks"
SCREEN_COLUMNS: Final = 80


@click.command()
@click.argument("name", metavar="[MODEL]", required=False)
@click.argument("word", metavar="[WORD]", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def models(name: str | None, word: str | None, as_json: bool) -> None:
    """List the models, or one model's quirks.

    A quirk is a point that the manuals leave open, or contradict one another in, or in which real
    units may differ.  WORD selects the quirks that have it in their name, ID, group or meaning, and
    shows these with their values: the first value is the default, the ID names the point.

    \b
    axistwin models                          every model
    axistwin models mac23                    the names of its quirks
    axistwin models mac23 reply              those about replies, with values
    axistwin models mac23 all                all, with values
    axistwin run mac23 --quirk xon_byte=11h  a twin with another value
    """
    known = catalog.models()
    if name is None:
        click.echo(json.dumps(_summaries(known)) if as_json else _table(known))
        return
    model = catalog.find_model(name)
    if as_json:
        click.echo(json.dumps(_summary(model, with_quirks=True)))
    else:
        click.echo(_overview(model) if word is None else _details(model, word))


def _summaries(known: dict[str, Model]) -> list[dict[str, object]]:
    return [_summary(model) for model in known.values()]


def _summary(model: Model, *, with_quirks: bool = False) -> dict[str, object]:
    summary: dict[str, object] = {
        "name": model.name,
        "description": model.description,
        "carrier": model.carrier,
        "addresses": [model.addresses[0], model.addresses[-1]],
        "default_address": model.default_address,
        "default_baud": model.default_baud,
    }
    if with_quirks:
        summary["quirks"] = [
            {
                "name": quirk.name,
                "source": quirk.source,
                "allowed": list(quirk.allowed),
                "default": quirk.default,
                "meaning": quirk.doc,
            }
            for quirk in model.quirks.values()
        ]
    return summary


def _addresses(model: Model) -> str:
    return f"{model.addresses[0]}..{model.addresses[-1]}"


def _table(known: dict[str, Model]) -> str:
    """One line per model; a description that is too long for it goes on below."""
    rows = [("MODEL", "TRANSPORT", "ADDRESSES", "BIT/S", "DESCRIPTION")]
    rows += [
        (model.name, model.carrier, _addresses(model), str(model.default_baud), model.description)
        for model in known.values()
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    lines = []
    for *cells, description in rows:
        start = "".join(cell.ljust(width + 2) for cell, width in zip(cells, widths, strict=True))
        lines += wrap(
            description,
            SCREEN_COLUMNS,
            initial_indent=start,
            subsequent_indent=" " * len(start),
            drop_whitespace=True,
        )
    return "\n".join(lines)


def _overview(model: Model) -> str:
    """One model, and the names of its quirks in groups: a screen."""
    has_choice = len(model.bauds) > 1
    rates = {
        "serial": (
            f"default rate: {model.default_baud} baud"
            if has_choice
            else f"rate: {model.default_baud} baud, always"
        ),
        "can": f"bit rate of the bus: {model.default_baud} bit/s, unless another is given",
    }
    lines = [
        f"{model.name}: {model.description}",
        f"addresses: {_addresses(model)}, default {model.default_address}; {rates[model.carrier]}",
        "Each quirk is a point that the manual leaves open, with a default.",
        f"  meaning and values  axistwin models {model.name} WORD  (WORD: a part of its name)",
        f"  another value       axistwin run {model.name} --quirk NAME=VALUE",
    ]
    if profiles := catalog.profiles_of(model.name):
        lines.append(
            f"  a set of values     axistwin run {model.name} --profile {'|'.join(profiles)}"
        )
    for group, quirks in _grouped(model.quirks.values()).items():
        lines.append(f"{group or UNGROUPED}: {' '.join(quirk.name for quirk in quirks)}")
    wrapped = (wrap(line, SCREEN_COLUMNS, subsequent_indent="    ") for line in lines)
    return "\n".join(chain.from_iterable(wrapped))


def _grouped(quirks: Iterable[Quirk]) -> dict[str, list[Quirk]]:
    groups: dict[str, list[Quirk]] = {}
    for quirk in quirks:
        groups.setdefault(quirk.group, []).append(quirk)
    return groups


def _details(model: Model, word: str) -> str:
    """The quirks that have ``word`` somewhere, by groups, three lines each.  Raises UsageError."""
    found = [
        quirk
        for quirk in model.quirks.values()
        if word == ALL
        or any(
            word.lower() in text.lower()
            for text in (quirk.name, quirk.source, quirk.group, quirk.doc)
        )
    ]
    if not found:
        remedy = suggestion(word, model.quirks) or f"see 'axistwin models {model.name}'"
        raise UsageError(f"no quirk of {model.name} has the word {word!r}; {remedy}")
    lines: list[str] = []
    for group, quirks in _grouped(found).items():
        heading = group or UNGROUPED
        lines += ["", heading] if lines else [heading]
        for quirk in quirks:
            lines += [
                "",
                f"  {quirk.name} = {quirk.default}    [{quirk.source}]",
                f"      {quirk.doc}",
                f"      values: {', '.join(quirk.allowed)}",
            ]
    return "\n".join(lines)
