"""The first word of a device: it may be late.

No manual names a time within which a device replies.  Who asks again after the usual limit takes a
late reply for that to his second question, and every reply after it for that to the question before
the last.  So what comes after a silence is not believed: once it is quiet, one question is asked
and listened to for as long as all of the silence was.
"""

from __future__ import annotations

from collections.abc import Callable

from axistwin_conformance.core.session import REPLY_TIMEOUT_S, Session

LATE_TRIES = 3  # noise may take one of them


def learn_delay(
    session: Session,
    since_ns: int,
    ask: Callable[[], bool],
    wait_until_quiet: Callable[[float], object] | None = None,
) -> None:
    """Find out how long the device takes to reply, of which nothing has come at first: from then on
    it is waited for (`Run.late_s`).

    `since_ns`: when it was asked first.  `ask`: one question with the usual patience, whether there
    was a reply to it.  `wait_until_quiet`: wait until nothing has come for so many seconds; the
    transport does it unless given.
    """
    transport, run = session.transport, session.run
    longest_s = (transport.now_ns - since_ns) / 1e9 + REPLY_TIMEOUT_S
    run.late_s = longest_s
    for _ in range(LATE_TRIES):
        (wait_until_quiet or transport.wait_until_quiet)(longest_s)
        began_ns = transport.now_ns
        if ask():
            took_s = (transport.now_ns - began_ns) / 1e9
            run.late_s = took_s if took_s > REPLY_TIMEOUT_S else 0.0
            return
    run.late_s = 0.0
