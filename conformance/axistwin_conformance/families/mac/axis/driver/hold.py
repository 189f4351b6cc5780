"""How an axis is held that went where nothing leads that it was asked for.

Nothing is believed of it but what is seen: any command may be the one that moves it, the stop as
well.  So an axis that stands gets none, and one that moves gets one after the other, each followed
by a look.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.errors import OutsideEnvelope
from axistwin_conformance.families.mac.axis.driver.client import AxisClient
from axistwin_conformance.families.mac.axis.exchanges import signed

STOPS: Final = (0x18, 0x17, 0x1A, 0x00)  # maximum braking, the ramp, no power, the start-up state
LOOK_S: Final = 0.1  # the slowest catch-up takes two increments in that time
SWING: Final = 1  # increments: standby (MACS-CMD-02-03)


def hold(client: AxisClient, *, is_seen_moving: bool = False) -> bool:
    """Bring it to rest if it moves; True if it stands.

    `is_seen_moving`: no time is to be lost with a look before the first stop.
    """
    for index in STOPS:
        if not is_seen_moving and _stands(client):
            return True
        is_seen_moving = False
        try:
            client.command(index)
        except OutsideEnvelope:  # it is one of those that may have moved it
            continue
    return _stands(client)


def _stands(client: AxisClient) -> bool:
    before = client.ask(0x20).reply.data
    client.wait(LOOK_S)
    after = client.ask(0x20).reply.data
    if before is None or after is None:
        return False
    return abs(signed(after - before & 0xFFFF_FFFF)) <= SWING
