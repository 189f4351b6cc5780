"""Short cuts of virtual time change nothing: the same bytes at the same nanosecond."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msc_bench import ACK, NAK, bread, broken, dread, dwrite, flag, rqstat

from axistwin.catalog import build_line, parse_device
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.programs import ProgramSource
from axistwin.runtime.clock import VirtualClock
from axistwin.runtime.line import Line

REQUESTS = st.sampled_from(
    [
        *(rqstat(), dread(8), bread(8), dwrite(8, 5), flag("SFLAG", 200), broken(rqstat())),
        *(ACK, NAK, ACK + rqstat(), rqstat() + rqstat(), dread(8)[:9], b"", b"\x02", rqstat(2)),
    ]
)
STEPS = st.lists(
    st.tuples(REQUESTS, st.integers(0, 150), st.sampled_from([0, 1, 20, 60, 200, 1500])),
    max_size=10,
)


def line_of(*devices: str, program: str = "") -> Line:
    """A line in virtual time."""
    programs: dict[int | None, ProgramSource] = {None: program} if program else {}
    specs = [parse_device(device) for device in devices]
    return build_line(specs, clock=VirtualClock(), programs=programs)


def asked(line: Line, data: bytes, size: int, patience_ns: Nanos) -> tuple[Nanos, bytes]:
    """Send, and take up to ``size`` bytes within some time: the short way if there is one."""
    until_ns = line.sync() + patience_ns
    done = line.ask(data, size, patience_ns) if size else None
    if done is not None and done[1] is not None:
        return done[2], done[1]
    if done is None and data:
        line.send(data)
    reached_ns = line.wait(until_ns, size or None) if patience_ns else line.sync()
    return reached_ns, line.receive(size)


def stepped(line: Line, data: bytes, size: int, patience_ns: Nanos) -> tuple[Nanos, bytes]:
    """The same, always the long way."""
    until_ns = line.sync() + patience_ns
    if data:
        line.send(data)
    return line.wait(until_ns, size or None) if patience_ns else line.sync(), line.receive(size)


@pytest.mark.strength
@pytest.mark.parametrize(
    ("devices", "program"),
    [(("msc-250",), ""), (("msc-250",), "bench"), (("msc-250:1", "msc-250:2"), "")],
)
@settings(max_examples=60)
@given(steps=STEPS)
def test_asking_is_sending_and_waiting(
    devices: tuple[str, ...], program: str, steps: list[tuple[bytes, int, int]]
) -> None:
    """``Line.ask``, wherever it finds a short way, and ``send`` with ``wait`` agree."""
    with line_of(*devices, program=program) as short, line_of(*devices, program=program) as long:
        for data, size, patience_ms in steps:
            patience_ns = patience_ms * NS_PER_MS
            assert asked(short, data, size, patience_ns) == stepped(long, data, size, patience_ns)
        ends = []
        for line in (short, long):
            line.advance(20_000 * NS_PER_MS)
            ends.append((line.receive(), line.twins[0].cells, line.twins[0].describe()))
        assert ends[0] == ends[1]
