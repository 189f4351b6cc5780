"""Writes docs/reference from the code; ``--check`` only compares."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import click

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from scripts import reference_mac_pages, reference_mn400, reference_msc  # noqa: E402
from scripts.reference_tables import table  # noqa: E402

from axistwin import catalog  # noqa: E402
from axistwin.cli.program import main as program  # noqa: E402
from axistwin_conformance.base import ledger  # noqa: E402

DOCS = ROOT / "docs"
NOTE = "<!-- Written by scripts/reference from the code; do not edit. -->\n\n"


def commands() -> str:
    """The help text of every command."""
    # As the program itself shows it: a context made by hand knows no settings of its command.
    context = click.Context(program, info_name="axistwin", **program.context_settings)
    page = ["# Commands\n\n", f"```text\n{program.get_help(context)}\n```\n"]
    for name in program.list_commands(context):
        command = program.get_command(context, name)
        assert command is not None
        inner = click.Context(command, info_name=name, parent=context)
        page.append(f"\n## axistwin {name}\n\n```text\n{command.get_help(inner)}\n```\n")
    return "".join(page)


def quirks() -> str:
    """Every quirk of the MAC serial twins."""
    return quirks_of(
        "mac23",
        "# Quirks of the MAC twins\n\n"
        "The manual can be read in several ways. A quirk chooses one: `--quirk NAME=VALUE`,\n"
        "`[quirks]` of a profile, `quirk.NAME=VALUE` in a URL, or `quirks={...}` of the\n"
        "fixture.\n\n",
    )


def can_quirks() -> str:
    """Every quirk of the MAC23 on CAN."""
    return quirks_of(
        "mac23-can",
        "# Quirks of the MAC23 on CAN\n\n"
        "The manual can be read in several ways. A quirk chooses one: `--quirk NAME=VALUE`,\n"
        "`[quirks]` of a profile, `quirk.NAME=VALUE` in a channel's name, or `quirks={...}` of\n"
        "`can.Bus`. Entries `MACS-` concern the axis, which is the same as on the serial line.\n\n",
    )


def msc_quirks() -> str:
    """Every quirk of the MSC controllers."""
    return quirks_of(
        "msc-250",
        "# Quirks of the MSC controllers\n\n"
        "The manual can be read in several ways. A quirk chooses one: `--quirk NAME=VALUE`,\n"
        "`[quirks]` of a profile, `quirk.NAME=VALUE` in a URL, or `quirks={...}` of the fixture.\n"
        "The quirks from `data_size` on are settings: each unit has its own.\n\n",
    )


def mn400_quirks() -> str:
    """Every switch of the MN400."""
    return quirks_of(
        "mn400",
        "# Quirks of the MN400\n\n"
        "The manual can be read in several ways. A switch chooses one: `--quirk NAME=VALUE`,\n"
        "`[quirks]` of a profile, `quirk.NAME=VALUE` in a URL, or `quirks={...}` of the fixture.\n"
        "The switches from `firmware` on are settings: each board has its own. The profile\n"
        "[`mn100`](../how-to/run-mn100-programs.md) sets those of the predecessor.\n\n",
    )


def quirks_of(name: str, head: str) -> str:
    """A page with the quirks of a model."""
    model = catalog.find_model(name)
    rows = (
        (f"`{name}`", quirk.source, f"`{quirk.default}`", ", ".join(quirk.allowed), quirk.doc)
        for name, quirk in model.quirks.items()
    )
    return head + table(["quirk", "entry", "default", "values", "meaning"], rows)


def requirements() -> str:
    """The ledger that the suite judges MAC serial devices by."""
    return requirements_of("mac_serial", "# Requirements of the MAC serial interface\n\n")


def can_requirements() -> str:
    """The ledger that the suite judges the MAC23 on CAN by."""
    return requirements_of(
        "mac_can",
        "# Requirements of the MAC23 on CAN\n\n"
        "The checks of the serial interface judge the axis of this module too. The last column\n"
        "names [their requirements](mac-serial-requirements.md).\n\n",
    )


def msc_requirements() -> str:
    """The ledger that the suite judges MSC controllers by."""
    return requirements_of("msc", "# Requirements of the MSC executive port\n\n")


def mn400_requirements() -> str:
    """The ledger that the suite judges MN400 boards by."""
    return requirements_of("mn400", "# Requirements of the MN400\n\n")


def requirements_of(name: str, head: str) -> str:
    """A page with the requirements of a ledger, and the questions it leaves open."""
    book = ledger.load_ledger(name)
    has_axis = any(each.covers for each in book.requirements.values())
    rows = (
        (
            *(each.id, each.kind, ", ".join(sorted(each.safety)), each.where, each.text),
            *([", ".join(each.covers) or "-"] if has_axis else []),
        )
        for each in book.requirements.values()
    )
    doubts = (
        (
            each.id,
            each.question,
            "; ".join(f"`{name}`: {', '.join(r)}" for name, r in each.switches.items()) or "-",
        )
        for each in book.ambiguities.values()
    )
    columns = ["requirement", "kind", "safety", "source", "text"]
    return (
        head
        + table([*columns, "axis"] if has_axis else columns, rows)
        + "\n## Where the manual leaves it open\n\n"
        + table(["entry", "question", "readings, the default first"], doubts)
    )


PAGES = {
    "reference/commands.md": commands,
    "reference/mac-can-commands.md": reference_mac_pages.can_page,
    "reference/mac-can-quirks.md": can_quirks,
    "reference/mac-can-requirements.md": can_requirements,
    "reference/mac-serial-commands.md": reference_mac_pages.serial_page,
    "reference/mac-serial-quirks.md": quirks,
    "reference/mac-serial-requirements.md": requirements,
    "reference/mn400-protocol.md": reference_mn400.page,
    "reference/mn400-quirks.md": mn400_quirks,
    "reference/mn400-requirements.md": mn400_requirements,
    "reference/msc-protocol.md": reference_msc.page,
    "reference/msc-quirks.md": msc_quirks,
    "reference/msc-requirements.md": msc_requirements,
}


def main() -> int:
    """Write the pages, or say which are stale."""
    parser = argparse.ArgumentParser(description=__doc__, prog="scripts/reference")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if stale")
    check = parser.parse_args().check
    stale = []
    for name, make in PAGES.items():
        path, text = DOCS / name, NOTE + make()
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        stale.append(name)
        if not check:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    if check and stale:
        print(f"stale: {', '.join(stale)}; run scripts/reference", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
