"""How an axis that is sent home is followed: to the end of its way, whichever that is.

What ends it is what is seen: it is home, it stands still elsewhere, it has run away (the travel
guard then lets nothing move it any more), or it takes longer than it should.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from axistwin_conformance.base import interrupts
from axistwin_conformance.families.mac.axis.driver.client import LONGEST_WAIT_S, AxisClient

LOOK_S: Final = 0.1  # from one look at an axis on its way to the next
STILL_S: Final = 0.5  # who has not moved for so long, has not heard that it should
MOST_LOOKS: Final = 1000  # in virtual time, where a way back of days is over in no time


def comes_back(
    client: AxisClient, home: int, lasting_s: Callable[[int], float], deadline_ns: int
) -> bool:
    """Follow an axis on its way home; False as soon as it stands still elsewhere, has run away,
    it is too late, or somebody wants it to end.  `lasting_s`: of a way of so many increments."""
    target = client.target
    last, since_ns, has_moved = None, target.now_ns, False
    least_s = max(LOOK_S, (deadline_ns - since_ns) / 1e9 / MOST_LOOKS)
    while target.now_ns < deadline_ns and not interrupts.is_hurried():
        here = client.position()
        if here == home:
            return True
        if client.session.run.runaway:
            return False
        if here != last:
            last, since_ns, has_moved = here, target.now_ns, last is not None
        elif target.now_ns - since_ns >= STILL_S * 1e9:
            return False
        left_s = min(lasting_s(abs(here - home)), LONGEST_WAIT_S)  # if it is where it says
        client.wait(max(least_s, left_s) if target.is_virtual and has_moved else LOOK_S)
    return False
