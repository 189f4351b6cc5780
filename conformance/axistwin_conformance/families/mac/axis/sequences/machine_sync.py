"""The machine where a frame to all modules does what 11h does: two rules more."""

from __future__ import annotations

from hypothesis.stateful import precondition, rule

from axistwin_conformance.families.mac.axis.sequences.machine import PAUSES, AxisMachine, if_


class SyncMachine(AxisMachine):
    """The rules of the axis, and SYNC beside 11h."""

    @precondition(if_(lambda view: view.is_held))
    @rule(pause=PAUSES)
    def trigger_by_sync(self, pause: int) -> None:
        """SYNC: what is held starts."""
        self.do("trigger by SYNC", 0, 0, pause)

    @precondition(if_(lambda view: view.mode == "HD" and not view.is_held))
    @rule(pause=PAUSES)
    def trigger_nothing_by_sync(self, pause: int) -> None:
        """SYNC where nothing is held."""
        self.do("trigger by SYNC", 0, 0, pause)
