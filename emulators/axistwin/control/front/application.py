"""The application of a front: what concerns all workers is put together, all else passed on.

Rules
-----
1. A request that names a line, or a device, is answered by the worker that serves it.  One that
   names neither, such as for the panel, is answered by any worker: they are all alike.
2. Lists, metrics and live state are those of all workers, in the order of the file.
3. A line whose worker has ended is shown as one that has failed.
"""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from itertools import chain
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.websockets import WebSocket

from axistwin.control import metrics
from axistwin.control.front.asking import ask, get
from axistwin.control.front.relay import Query, Relay
from axistwin.control.front.workforce import WorkedLine, Worker, Workforce
from axistwin.control.guard import (
    Application,
    Guard,
    Message,
    Receive,
    RefusedError,
    Send,
    problem,
)
from axistwin.control.metrics import Counts
from axistwin.control.models import EndpointInfo, LineInfo
from axistwin.control.panel import paths, read_page
from axistwin.control.watching import admit, as_text
from axistwin.errors import StateError, UnknownNameError, nearest
from axistwin.runtime.serving.live import LineTold
from axistwin.runtime.serving.rack import find_name

Answering = Callable[[], Awaitable[Response]]


def make_front(workforce: Workforce, counts: Counts, host: str, token: str | None) -> Application:
    """The API for the lines of ``workforce``, for a server that listens at ``host``."""
    front = FrontApi(workforce, counts)
    workforce.viewers = front
    return Guard(front, host, token, counts.count, paths(read_page()))


class FrontApi:
    """See above."""

    def __init__(self, workforce: Workforce, counts: Counts) -> None:
        self._workforce, self._counts = workforce, counts
        self._relays: dict[Relay, bool] = {}
        """Who watches, and whether all."""
        self._merged: dict[tuple[str, str], Answering] = {
            ("GET", "/api/v1/lines"): self._lines,
            ("GET", "/api/v1/devices"): self._devices,
            ("GET", "/metrics"): self._metrics,
        }

    def lines_came(self, lines: Sequence[WorkedLine], *, by_new_worker: bool) -> None:
        """Let those go who watch all, or would not hear of them; perhaps they know already."""
        added = [LineTold(each.name, "line_added", {"devices": each.devices}) for each in lines]
        for relay, is_of_all in tuple(self._relays.items()):
            if is_of_all or by_new_worker:
                for event in added:
                    relay.tell(as_text(event))
                relay.tell(None)

    def line_failed(self, line: WorkedLine) -> None:
        """Tell it as the worker would have."""
        details = {"line": line.name, "devices": list(line.devices), "error": line.failure}
        event = LineTold(line.name, "line_failed", details)
        for relay in tuple(self._relays):
            relay.tell(as_text(event))

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """One request, or one WebSocket."""
        is_socket = scope["type"] == "websocket"
        if is_socket and scope["path"] != "/api/v1/events":
            await send({"type": "websocket.close"})
            return
        try:
            if is_socket:
                await self._watch(WebSocket(scope, receive, send))
                return
            merged = self._merged.get((scope["method"], scope["path"]))
            response = await (merged() if merged else self._pass_on(Request(scope, receive)))
        except (UnknownNameError, StateError, RefusedError) as error:
            status = error.status if isinstance(error, RefusedError) else 503
            status = 404 if isinstance(error, UnknownNameError) else status
            response = JSONResponse(problem(status, str(error)), status)
            if is_socket:
                await WebSocket(scope, receive, send).send_denial_response(response)
                return
        await response(scope, receive, send)

    # -- of one worker --

    async def _pass_on(self, request: Request) -> Response:
        unknown: UnknownNameError | None = None
        try:
            worker = await self._who_answers(request.scope["path"])
        except UnknownNameError as error:  # which is no matter, if something else is wrong too
            unknown, worker = error, self._any()
        target = request.scope["raw_path"].decode("latin-1")
        if request.scope["query_string"]:
            target += "?" + request.scope["query_string"].decode("latin-1")
        content_type = request.headers.get("content-type", "")
        answer = await ask(worker, request.method, target, await request.body(), content_type)
        if unknown is not None and answer.status_code == 404:
            raise unknown
        return answer

    async def _who_answers(self, path: str) -> Worker:
        """By rule 1.  Raises UnknownNameError, and StateError if nobody does any more."""
        parts = path.split("/")
        if parts[1:3] == ["api", "v1"] and len(parts) > 4:
            if parts[3] == "devices":
                return (await self._find(parts[4])).reach()
            if parts[3] == "lines":
                return (await self._find_line(parts[4])).reach()
        return self._any()

    def _any(self) -> Worker:
        for worker in self._workforce.workers:
            return worker
        raise StateError("no line is served any more")

    async def _find(self, wanted: str) -> WorkedLine:
        """The line of the device that ``wanted`` names, as ``Rack.find`` finds it."""
        owners = self._workforce.owners
        if wanted not in owners:
            served = [(each["name"], each["model"], each["address"]) for each in await self._all()]
            wanted = find_name(wanted, owners, served)
        return owners[wanted]

    async def _find_line(self, wanted: str) -> WorkedLine:
        """As ``Rack.find_line`` finds it."""
        lines = self._workforce.lines
        if wanted in lines:
            return lines[wanted]
        try:
            return await self._find(wanted)
        except UnknownNameError:
            raise UnknownNameError(f"no line {wanted!r}: {nearest(wanted, lines)}") from None

    # -- of all --

    async def _lines(self) -> Response:
        answers = await self._gather("lines")
        served = {each["name"]: each for each in answers}
        lines = [
            served.get(line.name) or _line_info(line).model_dump()
            for line in self._workforce.lines.values()
            if line.name in served or line.worker is None
        ]
        return JSONResponse({"lines": lines})

    async def _devices(self) -> Response:
        return JSONResponse({"devices": await self._all()})

    async def _all(self) -> list[dict[str, Any]]:
        """All devices that are served, as ``models.DeviceInfo`` has them."""
        served = {each["name"]: each for each in await self._gather("devices")}
        return [served[name] for name in self._workforce.owners if name in served]

    async def _gather(self, what: str) -> list[dict[str, Any]]:
        """What the lists of all workers have."""
        requests = [get(each, f"/api/v1/{what}") for each in self._workforce.workers]
        return list(chain.from_iterable(each[what] for each in await asyncio.gather(*requests)))

    async def _metrics(self) -> Response:
        workers = self._workforce.workers
        answers = await asyncio.gather(*(ask(each, "GET", "/metrics") for each in workers))
        pages = {
            worker.number: bytes(answer.body).decode()
            for worker, answer in zip(workers, answers, strict=True)
        }
        ended = [each.name for each in self._workforce.lines.values() if each.worker is None]
        text = metrics.render_all(pages, ended, self._counts)
        return Response(text, media_type=metrics.CONTENT_TYPE)

    async def _watch(self, client: WebSocket) -> None:
        named: dict[Worker, list[tuple[str, str]]] = {}
        for key, find in (("device", self._find), ("traffic", self._find_line)):
            for name in client.query_params.getlist(key):
                line = await find(name) if name else None
                if line is None or (key == "traffic" and line.worker is None):
                    continue  # nothing goes over it until it comes again
                named.setdefault(line.reach(), []).append((key, name))
        is_of_all = not {"device", "traffic"} & set(client.query_params)
        rest: Query = [] if is_of_all else [("device", "")]
        queries: dict[Worker, Query] = dict.fromkeys(self._workforce.workers, rest)

        async def run() -> None:
            relay = Relay(client, queries | named, self._counts)
            self._relays[relay] = is_of_all
            if not set(self._workforce.workers) <= set(queries):
                relay.tell(None)  # one has come meanwhile
            try:
                await relay.run()
            finally:
                del self._relays[relay]

        await admit(client, self._counts, run)


def _line_info(line: WorkedLine) -> LineInfo:
    return LineInfo(
        name=line.name,
        devices=list(line.devices),
        endpoints=[EndpointInfo(kind=kind, url=url) for kind, url in line.endpoints],
        failure=line.failure,
    )
