"""A twin behind the control API of a daemon: its controls, worked over HTTP as if it were here.

    http://127.0.0.1:8080            the one twin there that has the address of the device judged
    http://127.0.0.1:8080/mac23:0    this one

The token of a daemon that wants one comes from the environment.  So does the name of the file with
the certificates that are trusted at an https:// address, if it is not what the machine trusts.
"""

from __future__ import annotations

import http.client
import json
import os
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import quote, urlsplit

from axistwin_conformance.base.errors import RigError

SCHEMES: Final = ("http://", "https://")
TOKEN_VARIABLE: Final = "AXISTWIN_CONTROL_TOKEN"
CA_VARIABLE: Final = "AXISTWIN_CONTROL_CA"
TIMEOUT_S: Final = 30.0


class RefusedByTwin(Exception):  # noqa: N818 - what a twin does not take, not an error of ours
    """The twin does not take that, or has no such control; the message is the daemon's."""


@dataclass(frozen=True, slots=True)
class RemoteControl:
    """One control of a twin; RigError if nobody answers, RefusedByTwin if it is refused."""

    daemon: Daemon
    path: str

    @property
    def value(self) -> Any:
        """As it is now."""
        return self.daemon.ask("GET", self.path)["value"]

    def set(self, value: object) -> None:
        """Set it; it is set when this returns."""
        self.daemon.ask("PUT", self.path, {"value": value})


@dataclass(frozen=True, slots=True)
class Daemon:
    """The control API at `url`; nothing is kept open between two requests."""

    url: str

    @classmethod
    def of(cls, url: str) -> Daemon:
        """That of a `url`, whatever device it names."""
        parts = urlsplit(url)
        return cls(f"{parts.scheme}://{parts.netloc}")

    def _connection(self) -> http.client.HTTPConnection:
        """One that is not open yet; RigError for a CA file that is none."""
        parts = urlsplit(self.url)
        if parts.scheme == "http":
            return http.client.HTTPConnection(parts.netloc, timeout=TIMEOUT_S)
        trusted = os.environ.get(CA_VARIABLE)
        try:
            context = ssl.create_default_context(cafile=trusted)
        except OSError as error:
            reason = "it has no certificate in PEM form"
            if not isinstance(error, ssl.SSLError):
                reason = error.strerror or str(error)
            raise RigError(f"{CA_VARIABLE} {trusted}: cannot be used ({reason})") from error
        return http.client.HTTPSConnection(parts.netloc, timeout=TIMEOUT_S, context=context)

    def ask(self, method: str, path: str, body: Mapping[str, object] | None = None) -> Any:
        """The answer at a path below /api/v1; RigError if there is none, RefusedByTwin."""
        token = os.environ.get(TOKEN_VARIABLE)
        headers = {"Content-Type": "application/json"}
        if token:
            headers["Authorization"] = f"Bearer {token}"
        connection = self._connection()
        try:
            text = None if body is None else json.dumps(body)
            connection.request(method, f"/api/v1/{path}", text, headers)
            response = connection.getresponse()
            answer = json.loads(response.read())
        except ssl.SSLCertVerificationError as error:
            raise RigError(
                f"{self.url}: its certificate is not trusted ({error.verify_message}); "
                f"name the CA's file in {CA_VARIABLE}"
            ) from error
        except (OSError, http.client.HTTPException) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise RigError(f"no daemon answers at {self.url} ({reason})") from error
        except ValueError as error:
            raise RigError(f"{self.url} is no axistwin's control API") from error
        finally:
            connection.close()
        if response.status in (404, 422):
            raise RefusedByTwin(answer["message"])
        if response.status != 200:
            raise RigError(f"{self.url}: {answer['message']}")
        return answer


class RemoteTwin:
    """The twin that `url` names for a device with that address; `controls` by their names.

    Raises RigError if there is none, or more than one.
    """

    def __init__(self, url: str, address: int) -> None:
        self._daemon = Daemon.of(url)
        wanted = urlsplit(url).path.strip("/").removeprefix("api/v1/devices").strip("/")
        if wanted:
            try:
                found = [self._daemon.ask("GET", f"devices/{quote(wanted, safe='')}")]
            except RefusedByTwin as error:
                raise RigError(f"{self._daemon.url}: {error}") from error
        else:
            found = self._daemon.ask("GET", "devices")["devices"]
        alike = [each["name"] for each in found if each["address"] == address]
        if len(alike) != 1:
            there = ", ".join(f"{each['name']} (address {each['address']})" for each in found)
            raise RigError(
                f"{self._daemon.url} has {len(alike) or 'no'} twin{'s' * (len(alike) > 1)} at "
                f"address {address}, but {there}; name one: --rig {self._daemon.url}/DEVICE"
            )
        self._path = f"devices/{quote(alike[0], safe='')}/controls"

    @property
    def controls(self) -> RemoteTwin:
        """What can be worked and seen."""
        return self

    def __getitem__(self, name: str) -> RemoteControl:
        return RemoteControl(self._daemon, f"{self._path}/{quote(name, safe='')}")
