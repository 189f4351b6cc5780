"""The WebSocket: what happens to devices, told to one client.

Rules
-----
1. A text per event, JSON, with its kind under ``event`` (``runtime.serving.live``): a ``snapshot``
   of each device first, changes then.
2. At most ``QUEUE_MAX`` changes wait for a client.  One that reads slower is dropped with the code
   ``TOO_SLOW``; it may come again, and begins with a snapshot.
   Messages of a line are no reason for that: of what does not fit ``TRAFFIC_MAX`` they are left
   out and counted.
3. A client tells nothing here: what it sends ends it, with the code ``NOT_EXPECTED``.
4. A client that watches something of a line that is removed is told so, and let go with the code
   ``LET_GO``.  It may come again, for what there is then.  So is one that watches all devices when
   a line is added.
"""

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Final

from starlette.responses import JSONResponse
from starlette.websockets import WebSocket

from axistwin.control.client import LET_GO
from axistwin.control.guard import SUBPROTOCOL, problem
from axistwin.control.metrics import Counts
from axistwin.control.traffic import TrafficWords
from axistwin.runtime.serving.live import LineTold, Live, RackEvent
from axistwin.runtime.serving.rack import Rack
from axistwin.runtime.serving.traffic import LineTraffic

QUEUE_MAX: Final = 512
TRAFFIC_MAX: Final = 64
"""Of the texts that wait for a client; as long as more do, messages are left out."""

WATCHERS_MAX: Final = 64
TOO_SLOW: Final = 4001
NOT_EXPECTED: Final = 1003


def as_text(event: RackEvent) -> str:
    """``event`` as it goes over the WebSocket."""
    return json.dumps({"event": event.event, **asdict(event)})


async def admit(client: WebSocket, counts: Counts, run: Callable[[], Awaitable[None]]) -> None:
    """Take ``client`` in, and ``run`` what tells it; refuse it if too many watch already."""
    if counts.watchers >= WATCHERS_MAX:
        text = f"{WATCHERS_MAX} clients watch already; come again"
        await client.send_denial_response(JSONResponse(problem(503, text), 503))
        return
    counts.watchers += 1
    try:
        offered = client.scope["subprotocols"]
        await client.accept(SUBPROTOCOL if SUBPROTOCOL in offered else None)
        await run()
    finally:
        counts.watchers -= 1


class Watching:
    """One client of the WebSocket ``client``, who watches ``devices``, and the ``lines``."""

    def __init__(
        self,
        rack: Rack,
        live: Live,
        counts: Counts,
        client: WebSocket,
        devices: Sequence[str],
        lines: Mapping[str, TrafficWords],
        *,
        is_of_all: bool = False,
    ) -> None:
        self._is_of_all = is_of_all
        self._rack, self._live, self._counts = rack, live, counts
        self._client = client
        self._devices = devices
        self._lines = lines
        self._left_out = dict.fromkeys(lines, 0)
        self._loop = asyncio.get_running_loop()
        self._waiting: asyncio.Queue[str | None] = asyncio.Queue()
        self._room = QUEUE_MAX + len(devices)  # for their snapshots
        self._is_too_slow = asyncio.Event()
        self._leave: Callable[[], None] = lambda: None

    async def run(self) -> None:
        """Tell everything until the client goes, or is dropped."""
        self._rack.loop.call_soon(self._join)
        ends = [
            asyncio.create_task(each)
            for each in (self._send(), self._receive(), self._is_too_slow.wait())
        ]
        try:
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._rack.loop.call_soon(self._part)
            for each in ends:
                each.cancel()
            results = await asyncio.gather(*ends, return_exceptions=True)
        if self._is_too_slow.is_set():
            self._counts.dropped += 1
            await self._client.close(TOO_SLOW, "reads too slowly; come again")
        elif results[1] is True:
            await self._client.close(NOT_EXPECTED, "nothing is expected here")
        elif results[0] is None:
            await self._client.close(LET_GO, "the lines have changed; come again")

    # -- in the rack's loop --

    def _join(self) -> None:
        self._leave = self._live.watch(self._devices, self._hear, self._lines)

    def _part(self) -> None:
        self._leave()

    def _hear(self, event: RackEvent) -> None:
        with contextlib.suppress(RuntimeError):  # the server's loop has ended
            if isinstance(event, LineTraffic):
                self._loop.call_soon_threadsafe(self._put_traffic, event)
            else:
                self._loop.call_soon_threadsafe(self._put, as_text(event))
                if isinstance(event, LineTold) and self._is_stale(event):
                    self._loop.call_soon_threadsafe(self._waiting.put_nowait, None)

    def _is_stale(self, event: LineTold) -> bool:
        """Whether something that the client watches was removed, or something came to all."""
        if event.kind == "line_added":
            return self._is_of_all
        if event.kind != "line_removed":
            return False
        removed = event.details["devices"]
        return event.line in self._lines or any(each in removed for each in self._devices)

    # -- in the server's --

    def _put(self, text: str) -> None:
        if self._waiting.qsize() < self._room:
            self._waiting.put_nowait(text)
        else:
            self._is_too_slow.set()

    def _put_traffic(self, event: LineTraffic) -> None:
        """Explained here: the loop of the lines has better things to do."""
        dropped = self._left_out[event.line] + event.dropped
        if self._waiting.qsize() >= TRAFFIC_MAX:
            self._left_out[event.line] = dropped + len(event.messages)
            return
        self._left_out[event.line] = 0
        describe = self._lines[event.line].describe
        messages = [describe(each).model_dump() for each in event.messages]
        self._put(
            json.dumps(
                {"event": "traffic", "line": event.line, "messages": messages, "dropped": dropped}
            )
        )

    async def _send(self) -> None:
        """Until the client has been told of all that it was to hear (rule 4)."""
        while (text := await self._waiting.get()) is not None:
            await self._client.send_text(text)

    async def _receive(self) -> bool:
        """Whether the client has said something; else it has gone."""
        message = await self._client.receive()
        return bool(message["type"] == "websocket.receive")
