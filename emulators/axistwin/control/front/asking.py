"""Asks the control API of a worker, in threads: as many at once as clients may ask the front."""

import asyncio
import http.client
import json
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

from starlette.responses import Response

from axistwin.control.front.workforce import Worker
from axistwin.control.guard import RefusedError
from axistwin.control.listener import CONNECTIONS_MAX

ASK_S: Final = 30.0
"""How long an answer may take: longer than the longest cycle of a supply."""

_OF_ONE_CONNECTION: Final = ("connection", "content-length", "transfer-encoding")

_THREADS: Final = ThreadPoolExecutor(2 * CONNECTIONS_MAX, "axistwin-ask")


async def ask(
    worker: Worker, method: str, target: str, body: bytes = b"", content_type: str = ""
) -> Response:
    """What ``worker`` answers.  Raises RefusedError if it does not."""
    headers = dict(worker.headers)
    if content_type:
        headers["Content-Type"] = content_type
    loop = asyncio.get_running_loop()
    try:
        return await loop.run_in_executor(
            _THREADS, _ask, worker, method, target, body or None, headers
        )
    except (OSError, http.client.HTTPException):  # it has ended, or does not come back
        raise RefusedError(503, f"worker {worker.number} does not answer; try again") from None


async def get(worker: Worker, target: str) -> Any:
    """The JSON there.  Raises RefusedError, also if it is an error's."""
    answer = await ask(worker, "GET", target)
    content = json.loads(bytes(answer.body))
    if answer.status_code != 200:
        raise RefusedError(answer.status_code, content["message"])
    return content


def _ask(
    worker: Worker, method: str, target: str, body: bytes | None, headers: dict[str, str]
) -> Response:
    connection = http.client.HTTPConnection(worker.address, timeout=ASK_S)
    try:
        connection.request(method, target, body, headers)
        answer = connection.getresponse()
        kept = {  # a redirection leads to the front again
            name: value.replace(f"http://{worker.address}", "", 1)
            for name, value in answer.getheaders()
            if name.lower() not in _OF_ONE_CONNECTION
        }
        return Response(answer.read(), answer.status, kept)
    finally:
        connection.close()
