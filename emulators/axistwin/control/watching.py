"""The WebSocket: what happens to devices, told to one client.

Rules
-----
1. A text per event, JSON, with its kind under ``event`` (``runtime.serving.live``): a ``snapshot``
   of each device first, changes then.
2. At most ``QUEUE_MAX`` changes wait for a client.  One that reads slower is dropped with the code
   ``TOO_SLOW``; it may come again, and begins with a snapshot.
3. A client tells nothing here: what it sends ends it, with the code ``NOT_EXPECTED``.
"""

import asyncio
import contextlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Final

from starlette.websockets import WebSocket

from axistwin.control.metrics import Counts
from axistwin.runtime.serving.live import Live, RackEvent
from axistwin.runtime.serving.rack import Rack

QUEUE_MAX: Final = 512
WATCHERS_MAX: Final = 64
TOO_SLOW: Final = 4001
NOT_EXPECTED: Final = 1003


def as_text(event: RackEvent) -> str:
    """``event`` as it goes over the WebSocket."""
    return json.dumps({"event": event.event, **asdict(event)})


class Watching:
    """One client of the WebSocket ``client``, who watches ``devices``."""

    def __init__(
        self, rack: Rack, live: Live, counts: Counts, client: WebSocket, devices: Sequence[str]
    ) -> None:
        self._rack, self._live, self._counts = rack, live, counts
        self._client = client
        self._devices = devices
        self._loop = asyncio.get_running_loop()
        self._waiting: asyncio.Queue[str] = asyncio.Queue()
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

    # -- in the rack's loop --

    def _join(self) -> None:
        self._leave = self._live.watch(self._devices, self._hear)

    def _part(self) -> None:
        self._leave()

    def _hear(self, event: RackEvent) -> None:
        text = as_text(event)
        with contextlib.suppress(RuntimeError):  # the server's loop has ended
            self._loop.call_soon_threadsafe(self._put, text)

    # -- in the server's --

    def _put(self, text: str) -> None:
        if self._waiting.qsize() < self._room:
            self._waiting.put_nowait(text)
        else:
            self._is_too_slow.set()

    async def _send(self) -> None:
        while True:
            await self._client.send_text(await self._waiting.get())

    async def _receive(self) -> bool:
        """Whether the client has said something; else it has gone."""
        message = await self._client.receive()
        return bool(message["type"] == "websocket.receive")
