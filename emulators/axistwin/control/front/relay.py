"""The WebSocket of a front: one client hears what several workers tell.

A client that reads slowly makes this wait, and then a worker drops it (``control.watching``).
"""

import asyncio
import contextlib
from collections.abc import Mapping, Sequence
from typing import Final
from urllib.parse import urlencode

from starlette.websockets import WebSocket
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from axistwin.control.client import LET_GO
from axistwin.control.front.workforce import Worker
from axistwin.control.metrics import Counts
from axistwin.control.watching import NOT_EXPECTED, TOO_SLOW

REASONS: Final = {
    TOO_SLOW: "reads too slowly; come again",
    NOT_EXPECTED: "nothing is expected here",
    LET_GO: "the lines have changed; come again",
}

Query = Sequence[tuple[str, str]]
"""What is watched of one worker: pairs of ``device`` or ``traffic`` and a name; all if empty."""


class Relay:
    """Tells ``client`` what the workers of ``queries`` tell, until either has had enough."""

    def __init__(self, client: WebSocket, queries: Mapping[Worker, Query], counts: Counts) -> None:
        self._client, self._queries, self._counts = client, queries, counts
        self._loop = asyncio.get_running_loop()
        self._own: asyncio.Queue[str | None] = asyncio.Queue()
        # Who has heard a first snapshot misses nothing that any worker tells from then on.
        self._all_are_joined = asyncio.Barrier(max(1, len(queries)))

    def tell(self, text: str | None) -> None:
        """Tell the client ``text``, from any thread.

        None: let it go, so that it comes again, for what there is then.
        """
        with contextlib.suppress(RuntimeError):  # the server's loop has ended
            self._loop.call_soon_threadsafe(self._own.put_nowait, text)

    async def run(self) -> None:
        """Until the client goes, or is let go."""
        receiving = asyncio.create_task(self._receive())
        ends = [
            receiving,
            asyncio.create_task(self._tell_own()),
            *(asyncio.create_task(self._pass_on(*each)) for each in self._queries.items()),
        ]
        try:
            done, _ = await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for each in ends:
                each.cancel()
            await asyncio.gather(*ends, return_exceptions=True)
        codes = {each.result() for each in done if each.exception() is None}
        if 0 in codes or not codes:  # it has gone
            return
        self._counts.dropped += TOO_SLOW in codes
        code = max(codes, key=list(REASONS)[::-1].index)
        await self._client.close(code, REASONS[code])

    async def _receive(self) -> int:
        """With which code to end, since the client has said something; 0: it has gone."""
        message = await self._client.receive()
        return NOT_EXPECTED if message["type"] == "websocket.receive" else 0

    async def _tell_own(self) -> int:
        while (text := await self._own.get()) is not None:
            await self._client.send_text(text)
        return LET_GO

    async def _pass_on(self, worker: Worker, query: Query) -> int:
        """Tell what ``worker`` tells; with which code to end since it does not any more."""
        url = f"ws://{worker.address}/api/v1/events?{urlencode(query)}"
        try:
            async with connect(
                url,
                additional_headers=worker.headers,
                proxy=None,
                compression=None,
                max_size=None,
            ) as upstream:
                await self._all_are_joined.wait()
                while True:
                    text = await upstream.recv(decode=True)
                    await self._client.send_text(text)
        except ConnectionClosed as closed:
            if closed.rcvd is not None and closed.rcvd.code in (TOO_SLOW, LET_GO):
                return closed.rcvd.code
            return await asyncio.Future[int]()  # it has ended: others go on
        except (OSError, InvalidHandshake):  # it is just ending, or what is watched has just gone
            return LET_GO
