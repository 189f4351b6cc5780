"""What was typed, before it means anything: no empty words, and none that would change nothing."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

import click
from click.core import ParameterSource

from axistwin_conformance.base.errors import UsageError

# What goes with an option that runs nothing, by the name of its parameter; all else would be lost.
BESIDE_COMPARE = frozenset({"compare", "is_json", "model"})  # a model is refused by its name
LOST_BESIDE_LIST = frozenset(
    {"dry_run", "report", "detect", "exitfirst", "duration", "replay", "restore", "verbose"}
)


class SectionedCommand(click.Command):
    """A command whose help shows its options under headings.

    `sections`: the parameter that begins each section, and its heading.
    """

    def __init__(self, *arguments: Any, sections: Mapping[str, str], **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._sections = sections

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options in their order, with equal columns in all sections."""
        headings: list[str] = []
        rows: list[list[tuple[str, str]]] = []
        for parameter in self.get_params(ctx):
            row = parameter.get_help_record(ctx)
            if row is None or not isinstance(parameter, click.Option):
                continue
            if parameter.name in self._sections or not rows:
                headings.append(self._sections.get(parameter.name or "", "Options"))
                rows.append([])
            rows[-1].append(row)
        widest = max((len(option) for section in rows for option, _ in section), default=0)
        for heading, section in zip(headings, rows, strict=True):
            with formatter.section(heading):
                padded = [(option.ljust(widest), text) for option, text in section]
                formatter.write_dl(padded)


class Word(click.ParamType[str]):
    """Text that is there: a variable of the shell that is not set is a mistake, not a default."""

    name = "text"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Take it as it is."""
        return str(_there(self, value, param, ctx))


class WordPath(click.Path):
    """The path of a file or folder, which `''` is not."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Take it as click does."""
        return super().convert(_there(self, value, param, ctx), param, ctx)


def _there(
    kind: click.ParamType[Any], value: Any, param: click.Parameter | None, ctx: click.Context | None
) -> Any:
    if not str(value).strip():
        kind.fail("it is empty: write something, or leave it out", param, ctx)
    try:
        str(value).encode()
    except UnicodeEncodeError:  # it goes into reports and profiles, which are
        shown = os.fsencode(str(value)).decode("utf-8", "backslashreplace")
        kind.fail(f"{shown} is not UTF-8: give it another name", param, ctx)
    return value


def refuse_lost(ctx: click.Context) -> None:
    """Raise UsageError for options beside --compare or --list that would be dropped in silence."""
    typed = [
        parameter
        for parameter in ctx.command.params
        if parameter.name and _is_typed(ctx, parameter.name)
    ]
    names = {parameter.name for parameter in typed}
    if "compare" in names:
        _refuse(
            "--compare", (parameter for parameter in typed if parameter.name not in BESIDE_COMPARE)
        )
    elif "is_list" in names:
        _refuse("--list", (parameter for parameter in typed if parameter.name in LOST_BESIDE_LIST))


def _is_typed(ctx: click.Context, name: str) -> bool:
    return ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE and bool(ctx.params[name])


def _refuse(option: str, lost: Iterable[click.Parameter]) -> None:
    for parameter in lost:
        word = next((name for name in parameter.opts if name.startswith("--")), "the ID")
        raise UsageError(f"{option} runs nothing: leave out {word}")
