"""What the engine must know of the MSC family beside its checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from axistwin_conformance.msc import codec
from axistwin_conformance.msc.bench import Bench
from axistwin_conformance.msc.blame import blame
from axistwin_conformance.msc.keeping import probe, remember, restore, sanity, stop
from axistwin_conformance.msc.link import SHOUTING
from axistwin_conformance.msc.safety import DEEDS, objection
from axistwin_conformance.msc.survey import survey
from axistwin_conformance.msc.trial import try_flags
from axistwin_conformance.registry import Family, Grounds, Model
from axistwin_conformance.rig import OF_A_CONTROLLER
from axistwin_conformance.session import Session
from axistwin_conformance.targets import line_opener
from axistwin_conformance.transcript import told_by
from axistwin_conformance.ways import LINE

BAUD: Final = 9600  # MSC-PHY-01
TWIN_GROUNDS: Final = Grounds(range(1024, 5120), range(128, 192), (240, 6144))


@dataclass(frozen=True, slots=True)
class Facts:
    """What differs between the models on the wire (MSC-MOD-01)."""

    has_rflags: bool


MODELS: Final = {
    model.name: model
    for model in (
        Model("msc-generic", "MSC of any model", Facts(has_rflags=False)),
        Model("msc-250", "MSC-250", Facts(has_rflags=True)),
        Model("msc-850", "MSC-850", Facts(has_rflags=False)),
        Model("msc-850-32", "MSC-850/32", Facts(has_rflags=True)),
    )
}


def guard(session: Session, data: bytes) -> str | None:
    """Why these bytes must not be sent; see `safety`."""
    return objection(session, data)


def twin_url(model: str, address: int, neighbours: tuple[int, ...]) -> str:
    """The built-in twin, in virtual time, with its neighbours on one line and the bench program in
    each of them."""
    return f"{LINE.twin_url(model, address, neighbours)}&program=bench"


def disturbs(readings: Mapping[str, str]) -> bool:
    """Whether idle units of such readings answer what is said to, or by, another one."""
    return any(readings.get(switch) == reading for switch, reading in SHOUTING)


FAMILY: Final = Family(
    name="msc",
    ledger="msc",
    models=MODELS,
    modules=(
        "axistwin_conformance.msc.checks_packets",
        "axistwin_conformance.msc.checks_link",
        "axistwin_conformance.msc.checks_time",
        "axistwin_conformance.msc.checks_line",
        "axistwin_conformance.msc.checks_wire",
        "axistwin_conformance.msc.checks_commands",
        "axistwin_conformance.msc.checks_data",
        "axistwin_conformance.msc.checks_flags",
        "axistwin_conformance.msc.checks_status",
        "axistwin_conformance.msc.checks_random",
        "axistwin_conformance.msc.checks_golden",
        "axistwin_conformance.msc.checks_sequences",
        "axistwin_conformance.msc.checks_machines",
        "axistwin_conformance.msc.checks_program",
        "axistwin_conformance.msc.checks_bench",
        "axistwin_conformance.msc.checks_rig",
    ),
    addresses=range(codec.UNITS.start, codec.UNITS.stop),
    default_address=1,
    default_rate=BAUD,
    rates=(BAUD,),
    probe=probe,
    sanity=sanity,
    stop=stop,
    remember=remember,
    restore=restore,
    explain=told_by(codec.explain_request, codec.explain),
    twin_url=twin_url,
    open=line_opener(BAUD),
    guard=guard,
    capabilities=OF_A_CONTROLLER,
    grounds=TWIN_GROUNDS,
    has_axis=False,
    disturbs=disturbs,
    survey=survey,
    trials={"flags": try_flags},
    deeds=DEEDS,
    blame=blame,
    bench=Bench,
    replay_module="axistwin_conformance.msc.checks_sequences",
    operation_bytes=4,
    probe_modules=(
        "axistwin_conformance.msc.probes",
        "axistwin_conformance.msc.probes_writes",
        "axistwin_conformance.msc.probes_bench",
        "axistwin_conformance.msc.probes_program",
    ),
)
