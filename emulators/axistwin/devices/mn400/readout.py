"""What commands read: values, measurements, the listing, and the last message once more.

Rules
-----
1. A value is that of the moment in which START has left, of one instant for all axes (MN4-RSP-15).
2. Numbers are decimal, with a minus and commas between them, and nothing else (MN4-RSP-10).
"""

from collections.abc import Callable, Sequence
from typing import Any, Final

from axistwin.devices.mn400.grammar import Arguments
from axistwin.devices.mn400.inputs import Inputs
from axistwin.devices.mn400.jog import Jogger
from axistwin.devices.mn400.link.packets import ReturnCode
from axistwin.devices.mn400.link.ports import Answer, BoardLine, Port, status_part
from axistwin.devices.mn400.link.sender import Reply, ReplyPart
from axistwin.devices.mn400.mover import Mover
from axistwin.devices.mn400.orders import added
from axistwin.devices.mn400.quirks import Mn400Quirks
from axistwin.devices.mn400.store import ProgramStore
from axistwin.kernel.time import NS_PER_MS, Nanos

MEASURES_MS: Final = {1: 100, 2: 1000}
"""How long E1 and E2 count."""


class ReadOut:
    """What a host can read of one board."""

    def __init__(
        self,
        quirks: Mn400Quirks,
        port: Port,
        inputs: Inputs,
        mover: Mover,
        jogger: Jogger,
        store: ProgramStore,
    ) -> None:
        self._quirks = quirks
        self._port = port
        self._inputs = inputs
        self._mover = mover
        self._jogger = jogger
        self._store = store
        self._values: dict[str, Callable[[Nanos], str]] = {
            "/": lambda now: str(self._mover.exit_code),
            "?": lambda now: self._quirks.firmware,
            "S": lambda now: str(self._inputs.status),
            "N": lambda now: self._fields(self._mover.left_at(now)),
            "E": lambda now: self._fields(self.position_at(now)),
            "[": self._shield_status,
            ":": self._switch_status,
        }

    def position_at(self, now: Nanos) -> tuple[int, int, int, int]:
        """The counters, with what the axes jog."""
        return added(self._mover.position_at(now), self._jogger.moved_at(now))

    def _fields(self, values: Sequence[int]) -> str:
        """One field for each axis."""
        return _joined(values[: self._quirks.axes])

    def value(self, line: BoardLine, letter: str, given: Arguments) -> Answer:
        """START, and a value (rule 3)."""
        address, command, give = self._port.address, line.command, self._values[letter]
        start = status_part(address, command, ReturnCode.START)
        measured_ms = MEASURES_MS.get(given[0] or 0) if letter == "E" else None
        if measured_ms is not None:
            return Answer([start, *self._measure(line, measured_ms)])

        def tell(now: Nanos) -> Reply:
            return Reply(address, command, value=give(now))

        return Answer([start, ReplyPart(tell)])

    def _measure(self, line: BoardLine, measured_ms: int) -> list[ReplyPart]:
        """E1 and E2: count for a while, then tell (MN4-MEA-01, MN4-MEA-04)."""
        address, command, mover = self._port.address, line.command, self._mover
        began: list[tuple[int, str]] = []

        def begin(now: Nanos) -> None:
            began.append((mover.phantom_at(now), self._fields(self.position_at(now))))

        def tell(now: Nanos) -> Reply:
            phantom, position = began[0]
            if self._quirks.measure_position_sample == "end":
                position = self._fields(self.position_at(now))
            return Reply(address, command, value=f"{position},{mover.phantom_at(now) - phantom}")

        return [ReplyPart(begin), ReplyPart(tell, measured_ms * NS_PER_MS)]

    def _shield_status(self, _: Nanos) -> str:
        """[ (MN4-AMB-36)."""
        is_closed = not self._inputs.is_shield_open
        return str(int(is_closed == (self._quirks.shield_status_sense == "shield")))

    def _switch_status(self, now: Nanos) -> str:
        """: tells ShieldFlag, FeedHold, PauseFlag, PauseState, AbortFlag (MN4-CMD-SW-01)."""
        mover = self._mover
        is_shut = not self._inputs.is_shield_open
        flags = (is_shut, mover.has_feed_hold, mover.is_paused, mover.stands_at(now))
        text = _joined((*flags, mover.is_aborted))
        if self._quirks.abort_flag_clear == "read":
            mover.is_aborted = False
        return text

    def listing(self, line: BoardLine) -> Answer:
        """R: the user program, line by line (MN4-NVM-02, MN4-AMB-41)."""
        address, command, quirks = self._port.address, line.command, self._quirks
        texts = [text.decode("latin-1") for text in self._store.lines("program")]
        if quirks.readprogram_framing == "single" and texts:
            texts = [" ".join(texts)]
        if quirks.readprogram_end == "empty_line":
            texts.append("")
        parts = [status_part(address, command, ReturnCode.START)]
        parts += [ReplyPart(Reply(address, command, value=text)) for text in texts]
        if quirks.readprogram_end == "done":
            parts.append(status_part(address, command, ReturnCode.DONE))
        return Answer(parts)

    def retransmit(self, line: BoardLine) -> Answer:
        """&: the last message once more, from the present number (MN4-CMD-RTX-01..04)."""
        is_replaced = self._quirks.retransmit_cmd == "replaced"

        def again(_: Nanos) -> Reply | None:
            last = self._port.last_message(line.origin)
            if last is None:
                return None
            command = line.command if is_replaced else last.command
            return last._replace(address=self._port.address, command=command)

        return Answer([ReplyPart(again)])


def _joined(values: Any) -> str:
    return ",".join(str(int(value)) for value in values)
