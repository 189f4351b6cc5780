"""The other end of the control API, for the command line: plain HTTP, one line for each mistake.

Needs nothing that is not in every installation, but for ``watch``.
"""

import http.client
import json
import ssl
from collections.abc import Iterator, Sequence
from typing import Any, Final
from urllib.parse import quote, urlencode

from axistwin.control.tls import CA_VARIABLE, client_context
from axistwin.errors import PortError, UsageError
from axistwin.ports.tcp import parse_address

TIMEOUT_S: Final = 30.0

HTTP: Final = "http://"
HTTPS: Final = "https://"

LET_GO: Final = 4002
"""The code with which the WebSocket closes when a line that is watched was removed, or one was
added to all that are watched.
"""


class ControlClient:
    """Asks the daemon at ``address``: HOST:PORT, or its URL.  Raises UsageError for a bad one.

    token: what it wants of who is not on its machine.  authority: of one at an https:// URL, the
    file with the certificates to trust; None: those that the machine trusts.
    """

    def __init__(
        self, address: str, token: str | None = None, authority: str | None = None
    ) -> None:
        self._tls: ssl.SSLContext | None = None
        if address.startswith(HTTPS):
            self._tls = client_context(authority)
        self.address = address.removeprefix(HTTPS).removeprefix(HTTP).rstrip("/")
        self._host, self._port = parse_address(self.address)
        self._headers = {} if token is None else {"Authorization": f"Bearer {token}"}

    def get(self, *path: str) -> Any:
        """What there is at ``path``, below /api/v1.  Raises UsageError and PortError."""
        return self._ask("GET", path)

    def put(self, *path: str, **body: object) -> Any:
        """Set what is there.  Raises UsageError and PortError."""
        return self._ask("PUT", path, body)

    def post(self, *path: str, **body: object) -> Any:
        """Have something done.  Raises UsageError and PortError."""
        return self._ask("POST", path, body)

    def delete(self, *path: str) -> Any:
        """Take away what is there.  Raises UsageError and PortError."""
        return self._ask("DELETE", path)

    def _ask(self, method: str, path: Sequence[str], body: dict[str, object] | None = None) -> Any:
        headers = dict(self._headers)
        if body is not None:
            headers["Content-Type"] = "application/json"
        connection = self._connection()
        try:
            url = "/".join(("/api/v1", *(quote(each, safe="") for each in path)))
            connection.request(method, url, json.dumps(body) if body is not None else None, headers)
            response = connection.getresponse()
            answer = json.loads(response.read())
        except (OSError, http.client.HTTPException) as error:
            raise self._nobody(error) from None
        except ValueError:
            raise PortError(f"control {self.address}: that is no axistwin's control API") from None
        finally:
            connection.close()
        if response.status >= 400:
            raise UsageError(str(answer["message"]))
        return answer

    def _connection(self) -> http.client.HTTPConnection:
        if self._tls is None:
            return http.client.HTTPConnection(self._host, self._port, timeout=TIMEOUT_S)
        return http.client.HTTPSConnection(
            self._host, self._port, timeout=TIMEOUT_S, context=self._tls
        )

    def watch(self, *devices: str) -> Iterator[dict[str, Any]]:
        """What happens to ``devices`` (none named: all), from now on: snapshots first, then events.

        When one of their lines is removed it begins again: a reload may have brought the line back.
        So it does, where none is named, when a line is added.
        Raises UsageError, also for a device that is gone, and PortError when the daemon ends.
        """
        while True:
            yield from self._watch_until_let_go(devices)

    def _watch_until_let_go(self, devices: Sequence[str]) -> Iterator[dict[str, Any]]:
        """Until a line of ``devices`` is removed.  Raises UsageError and PortError."""
        from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
        from websockets.sync.client import connect

        query = urlencode({"device": devices}, doseq=True)
        url = f"{'ws' if self._tls is None else 'wss'}://{self.address}/api/v1/events?{query}"
        try:
            with connect(
                url,
                additional_headers=self._headers,
                open_timeout=TIMEOUT_S,
                proxy=None,
                ssl=self._tls,
            ) as socket:
                for text in socket:
                    yield json.loads(text)
        except InvalidStatus as error:
            answer = json.loads(error.response.body or b"{}")
            raise UsageError(str(answer.get("message", error))) from None
        except ConnectionClosed as error:
            if error.rcvd is not None and error.rcvd.code == LET_GO:
                return
            raise PortError(f"control {self.address}: it has ended ({error})") from None
        except (OSError, InvalidHandshake) as error:
            raise self._nobody(error) from None
        raise PortError(f"control {self.address}: it has ended")

    def _nobody(self, error: Exception) -> PortError:
        if isinstance(error, ssl.SSLCertVerificationError):
            return PortError(
                f"control {self.address}: its certificate is not trusted ({error.verify_message}); "
                f"name the CA's file by --control-ca or {CA_VARIABLE}"
            )
        if isinstance(error, ssl.SSLError):
            return PortError(
                f"control {self.address}: no TLS is spoken there ({error.reason}); try {HTTP}"
            )
        if self._tls is None and isinstance(error, http.client.RemoteDisconnected):
            return PortError(
                f"control {self.address}: it hung up without an answer; if it has a certificate, "
                f"write {HTTPS}{self.address}"
            )
        reason = (getattr(error, "strerror", None) or str(error) or type(error).__name__).lower()
        return PortError(
            f"control {self.address}: no daemon answers there ({reason}); start one with "
            f"'axistwin run ... --control {self.address}', or name another --control"
        )
