"""What an axis does that is sent home: one that goes away from there is not moved any more.

Nobody knows what such a device does with the next target, and each further attempt to bring it back
may lead it further away.  So it is stopped as soon as that is seen, and the run asks nothing more.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.errors import TargetError
from axistwin_conformance.families.mac.axis.driver.client import AxisClient

LOOK_S: Final = 0.1  # from one look at an axis on its way to the next
SWING: Final = 100  # increments: a shaft may swing, or be pushed, by fewer


def is_runaway(client: AxisClient, origin: int, home: int, here: int) -> bool:
    """True if an axis that was sent home is further from there than it was; what the run is then
    told by (`Run.runaway`).  Never of the twin made for the run, which harms nobody."""
    run = client.session.run
    if run.envelope.is_guarded and abs(here - home) > abs(origin - home) + SWING:
        run.runaway = f"sent from {origin} to {home}, the axis was at {here}: it is moved no more"
    return bool(run.runaway)


def wait_for_it(client: AxisClient, origin: int, home: int, until_ns: int) -> int:
    """Wait for an axis that has been sent home, and stop it; give where it then is.  Raises
    TargetError for one that goes astray."""
    slice_s = LOOK_S if client.session.envelope.is_guarded else float("inf")
    while (left_s := (until_ns - client.target.now_ns) / 1e9) > 0:
        client.wait(min(left_s, slice_s))
        if left_s > slice_s and is_runaway(client, origin, home, client.position()):
            break
    client.command(0x18)
    here = client.position()
    if is_runaway(client, origin, home, here):
        raise TargetError(client.session.run.runaway)
    return here
