"""Recordings of conversations with twins, made in virtual time, as ``--capture`` writes them."""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from axistwin import catalog
from axistwin.cli.replay.host_port import TwinSetup
from axistwin.cli.run.capture import recording_line
from axistwin.cli.run.capture_can import recording_bus
from axistwin.cli.send import request_of
from axistwin.devices.family import Value
from axistwin.kernel.time import NS_PER_MS, NS_PER_S
from axistwin.runtime.bus import Bus
from axistwin.runtime.serving.loop import Loop, LoopShare

CONVERSATIONS: Mapping[str, Sequence[str]] = {
    "mac23": ("position?", "go to 300", "go to 5", "wait 400 ms", "stop", "99h", "status?"),
    "mac23-can": ("position?", "go to 300", "go to 5", "wait 400 ms", "stop", "status?"),
    "msc-250": ("RQSTAT", "DWRITE 2008 -5", "DREAD 2008", "SFLAG 200", "RFLAG 200", "DREAD 9"),
    "mn400": ("V500", "M100,50", "wait 50 ms", "E", "wait 400 ms", "E", "X3"),
}
"""Of every family."""

EPOCH_NS = 1_795_284_668 * NS_PER_S
REPLY_NS = 100 * NS_PER_MS


def fail(reason: object) -> None:
    """A recording has ended early."""
    raise AssertionError(reason)


def record(
    path: Path, name: str, texts: Sequence[str], quirks: Mapping[str, Value] | None = None
) -> None:
    """Say ``texts`` to a twin, one after the other, and record it."""
    model = catalog.find_model(name)
    port = TwinSetup(model, model.default_address, quirks or {}).open()
    simulation = port.simulation
    with simulation, contextlib.closing(Loop()) as whole_loop:
        loop = LoopShare(whole_loop, fail)
        recording: Any
        if isinstance(simulation, Bus):
            recording = recording_bus(simulation, str(path), loop, EPOCH_NS, fail)
        else:
            recording = recording_line(simulation, str(path), model.explain, loop, fail)
        with recording:
            for text in texts:
                content = request_of(model, model.default_address, text)
                if isinstance(content, float):
                    simulation.advance(round(content * NS_PER_S))
                    continue
                port.send(content)
                heard: list[Any] = []
                until_ns = simulation.sync() + REPLY_NS
                while (now_ns := port.listen(until_ns)) < until_ns:
                    heard += port.received()
                    whole = b"".join(heard) if model.carrier == "serial" else b""
                    if whole and (thanks := model.family.acknowledgement(whole)):
                        port.send(thanks)
                        until_ns = now_ns + 20 * NS_PER_MS
