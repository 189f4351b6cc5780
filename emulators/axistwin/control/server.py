"""The control server of a rack, or of its front: where it may listen, and its life."""

import ssl

from axistwin.control.application import make_application
from axistwin.control.front.application import make_front
from axistwin.control.front.workforce import Workforce
from axistwin.control.listener import HttpListener
from axistwin.control.metrics import Counts
from axistwin.control.token import TOKEN_VARIABLE
from axistwin.errors import UsageError
from axistwin.ports.tcp import is_loopback
from axistwin.runtime.serving.live import Live
from axistwin.runtime.serving.rack import Rack


class ControlServer:
    """Serves the control API of ``served`` at ``address`` (HOST:PORT), to who has ``token``;
    with ``tls``: over TLS.

    Raises UsageError for an address of which others than this machine are asked for no token.
    """

    def __init__(
        self,
        served: Rack | Workforce,
        address: str,
        token: str | None,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        self._listener = HttpListener(address, tls)
        host = self._listener.host
        if token is None and not is_loopback(host):
            raise UsageError(
                f"control {address}: whoever reaches this address could drive the twins; give a "
                f"token by --control-token-file or {TOKEN_VARIABLE}, or listen at 127.0.0.1"
            )
        self.counts = Counts()
        if isinstance(served, Rack):
            self.live = Live(served)
            self._application = make_application(served, self.live, self.counts, host, token)
        else:
            self._application = make_front(served, self.counts, host, token)

    @property
    def url(self) -> str:
        """Where it is found; the real port once it is open."""
        return self._listener.url

    def open(self) -> None:
        """Claim the address.  Raises PortError."""
        self._listener.open()

    def serve(self) -> None:
        """Answer from now on, in a thread of its own; while the rack runs."""
        self._listener.serve(self._application)

    def close(self) -> None:
        """Answer nobody any more."""
        self._listener.close()
