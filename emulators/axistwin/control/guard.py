"""Who may use the control API, and how much of it: checked before anything looks at a request.

Rules
-----
1. ``Host`` is one of this server's: else a page of another name that resolves to this machine (DNS
   rebinding) could read what it gets.  An address is none that a page can be rebound to.
2. A request of a web page carries ``Origin``: it has to be this server's own.
3. With a token, every request has it (``Authorization: Bearer``), compared in constant time.  A
   WebSocket of a browser, which can give no header, has it in base64url in a subprotocol.  Only
   the files of the panel, which hold nothing of this server, are read without it.
4. A body has at most ``BODY_MAX_BYTES`` and ``BODY_TIMEOUT_S`` to come; nothing else is read.
"""

import asyncio
import base64
import binascii
import contextlib
import hmac
import ipaddress
import json
import socket
from collections.abc import Awaitable, Callable, Collection, MutableMapping
from typing import Any, Final, TypeAlias

from axistwin.ports.tcp import is_loopback

BODY_MAX_BYTES: Final = 64 * 1024
BODY_TIMEOUT_S: Final = 10.0

SUBPROTOCOL: Final = "axistwin"
"""What a WebSocket that brings the token in a subprotocol names too, and is answered."""

Message: TypeAlias = MutableMapping[str, Any]
Receive: TypeAlias = Callable[[], Awaitable[Message]]
Send: TypeAlias = Callable[[Message], Awaitable[None]]
Application: TypeAlias = Callable[[Message, Receive, Send], Awaitable[None]]

_STATUS: Final = {
    400: "bad_request",
    401: "unauthorized",
    403: "forbidden",
    404: "not_found",
    405: "method_not_allowed",
    408: "timeout",
    413: "too_large",
    422: "not_allowed",
    503: "unavailable",
}


class RefusedError(Exception):
    """A request that is not for the application; ``status`` is HTTP's."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


def problem(status: int, message: str) -> dict[str, Any]:
    """The body of an error, as ``models.Problem`` has it."""
    return {"error": _STATUS.get(status, "bug"), "message": message, "allowed": None}


class Guard:
    """Lets through to ``application`` what obeys the rules.

    host: where the server listens.  token: what every request must have; None: nothing.
    count: told the method and the status of each answer.  public: paths read without the token.
    """

    def __init__(
        self,
        application: Application,
        host: str,
        token: str | None,
        count: Callable[[str, int], None] = lambda method, status: None,
        public: Collection[str] = (),
    ) -> None:
        self._application = application
        self._count = count
        self._names = {host.lower(), "localhost"}
        if not is_loopback(host):
            self._names.add(socket.gethostname().lower())
        self._is_local = is_loopback(host)
        self._token = token
        self._public = frozenset(public)

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """One request, or one WebSocket."""
        if scope["type"] == "lifespan":
            await self._application(scope, receive, send)
            return
        if scope["type"] == "http":
            send = self._counted(scope["method"], send)
        try:
            self._check(scope, _headers(scope))
            if scope["type"] == "http":
                body = await asyncio.wait_for(_body(scope, receive), BODY_TIMEOUT_S)
                receive = _once(body, receive)
        except TimeoutError:
            await _refuse(
                scope, send, RefusedError(408, f"the body took over {BODY_TIMEOUT_S:g} s")
            )
        except RefusedError as refused:
            await _refuse(scope, send, refused)
        else:
            await self._application(scope, receive, send)

    def _counted(self, method: str, send: Send) -> Send:
        async def counted(message: Message) -> None:
            if message["type"] == "http.response.start":
                self._count(method, message["status"])
            await send(message)

        return counted

    def _check(self, scope: Message, headers: dict[str, list[str]]) -> None:
        """Raise RefusedError by rules 1 to 3."""
        hosts, origins = headers.get("host", []), headers.get("origin", [])
        if len(hosts) != 1 or not self._is_own(hosts[0]):
            raise RefusedError(
                403, "Host is none of this server's; use the address that it printed"
            )
        scheme = "https" if scope["scheme"] in ("https", "wss") else "http"
        if origins and origins != [f"{scheme}://{hosts[0]}"]:
            raise RefusedError(403, "Origin is another site's; web pages of others are not served")
        is_public = scope["type"] == "http" and scope["path"] in self._public
        if self._token is not None and not is_public:
            given = _authorization(scope, headers).encode()
            if not hmac.compare_digest(given, f"Bearer {self._token}".encode()):
                raise RefusedError(401, "a token is needed: Authorization: Bearer TOKEN")

    def _is_own(self, host: str) -> bool:
        name = host.lower()
        bare, colon, port = name.rpartition(":")
        if colon and port.isdecimal() and not bare.endswith(":"):
            name = bare
        try:
            address = ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
        except ValueError:
            return name in self._names
        return address.is_loopback or not self._is_local


def _headers(scope: Message) -> dict[str, list[str]]:
    headers: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        headers.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return headers


def _authorization(scope: Message, headers: dict[str, list[str]]) -> str:
    """By rule 3; empty: none is given."""
    start = f"{SUBPROTOCOL}.bearer."
    if scope["type"] == "websocket" and "authorization" not in headers:
        for each in scope["subprotocols"]:
            code = each.removeprefix(start)
            if code != each:
                with contextlib.suppress(binascii.Error, ValueError):
                    return f"Bearer {base64.urlsafe_b64decode(code + '==').decode()}"
    return headers.get("authorization", [""])[-1]


async def _body(scope: Message, receive: Receive) -> bytes:
    """All of the body.  Raises RefusedError for one that is too long."""
    told = _headers(scope).get("content-length", ["0"])[0]
    body = bytearray()
    is_complete = False
    while not is_complete:
        if len(body) > BODY_MAX_BYTES or int(told) > BODY_MAX_BYTES:
            raise RefusedError(413, f"a body has at most {BODY_MAX_BYTES} bytes")
        message = await receive()
        if message["type"] != "http.request":
            raise RefusedError(400, "the client has gone")
        body += message.get("body", b"")
        is_complete = not message.get("more_body", False)
    if len(body) > BODY_MAX_BYTES:
        raise RefusedError(413, f"a body has at most {BODY_MAX_BYTES} bytes")
    return bytes(body)


def _once(body: bytes, receive: Receive) -> Receive:
    """Gives ``body``, and then what comes behind it."""
    waiting = [{"type": "http.request", "body": body, "more_body": False}]

    async def give() -> Message:
        return waiting.pop() if waiting else await receive()

    return give


async def _refuse(scope: Message, send: Send, refused: RefusedError) -> None:
    """Answer; whatever else comes on this connection is not read."""
    kind = "websocket.http.response" if scope["type"] == "websocket" else "http.response"
    headers = [(b"content-type", b"application/json"), (b"connection", b"close")]
    if refused.status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    body = json.dumps(problem(refused.status, str(refused))).encode()
    await send({"type": f"{kind}.start", "status": refused.status, "headers": headers})
    await send({"type": f"{kind}.body", "body": body})
