"""``axistwin models``: what can be run, and what can be switched in it."""

import json

import click

from axistwin import catalog
from axistwin.devices.family import Model


@click.command()
@click.argument("name", metavar="[MODEL]", required=False)
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def models(name: str | None, as_json: bool) -> None:
    """List the models, or one model's quirks.

    A quirk is a switch for a point that the manuals leave open or contradict one another in, or in
    which real units may differ.  The first value is the default.  The ID names the point.

    \b
    axistwin models
    axistwin models mac23
    axistwin run mac23 --quirk xon_byte=11h
    """
    known = catalog.models()
    if name is None:
        click.echo(json.dumps(_summaries(known)) if as_json else _table(known))
        return
    model = catalog.find_model(name)
    click.echo(json.dumps(_summary(model, with_quirks=True)) if as_json else _details(model))


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
    """One line per model."""
    rows = [("MODEL", "CARRIER", "ADDRESSES", "BIT/S", "DESCRIPTION")]
    rows += [
        (model.name, model.carrier, _addresses(model), str(model.default_baud), model.description)
        for model in known.values()
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    return "\n".join(
        "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[-1]])
        for row in rows
    )


def _details(model: Model) -> str:
    """One model and all its quirks, three lines each."""
    has_choice = len(model.bauds) > 1
    rates = {
        "serial": (
            f"rate from the factory: {model.default_baud} baud"
            if has_choice
            else f"rate: {model.default_baud} baud, always"
        ),
        "can": f"bit rate of the bus: {model.default_baud} bit/s, unless another is given",
    }
    lines = [
        f"{model.name}: {model.description}",
        f"addresses: {_addresses(model)}, default {model.default_address}",
        rates[model.carrier],
        "",
        "quirks (--quirk NAME=VALUE):",
    ]
    for quirk in model.quirks.values():
        lines += [
            "",
            f"  {quirk.name} = {quirk.default}    [{quirk.source}]",
            f"      {quirk.doc}",
            f"      values: {', '.join(quirk.allowed)}",
        ]
    return "\n".join(lines)
