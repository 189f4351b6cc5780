"""Who hears what on a line, without asking every device: those who heed nothing cost nothing.

Devices that have heard the same share what they have of a message (``devices.base.Reception``); the
first byte that matters to any of them is found once, by their addresses.  Whoever is addressed, is
woken or is worked from outside leaves, with what it has heard, and is asked by itself; it comes
back when it is again where the others are.
"""

from bisect import bisect_left, insort
from collections.abc import Sequence

from axistwin.devices.base import Reception, SerialDevice, SharedListener
from axistwin.kernel.time import Nanos


class Audience:
    """The ``devices`` of a line, by their index."""

    def __init__(self, devices: Sequence[SerialDevice]) -> None:
        self._devices = devices
        self._listeners: list[SharedListener | None] = [
            getattr(each, "listener", None) for each in devices
        ]
        self._alone = list(range(len(devices)))
        self._shared: Reception | None = None
        self._address_of: dict[int, int] = {}
        self._at_address: dict[int, list[int]] = {}

    def heard_by(self, stations: Sequence[int]) -> list[int]:
        """Those of ``stations`` that are to be asked by themselves.

        All others hear it, too, from here on by what they share.
        """
        asked = [each for each in self._alone if _is_in(each + 1, stations)]
        members = len(stations) - len(asked) - (0 in stations[:1])
        if members != len(self._address_of):  # not all of them hear it
            for index in tuple(self._address_of):
                self.leave(index)
            return [each for each in self._alone if _is_in(each + 1, stations)]
        return asked

    def quiet_prefix(self, data: bytes, asked: Sequence[int]) -> int:
        """How many leading bytes surely make nobody react: those who are asked, or the rest."""
        quiet = len(data)
        if self._address_of:
            assert self._shared is not None
            quiet = self._shared.quiet_prefix(data, self._at_address)
        for index in asked:
            if not quiet:
                break
            quiet = min(quiet, self._devices[index].quiet_prefix(data))
        return quiet

    def only_one_to_react(self, data: bytes) -> int | None:
        """The one device that reacts to ``data``, not before its end; None: there are others.

        Any, if nobody reacts.
        """
        last, found = len(data) - 1, []
        for index in self._alone:
            quiet = self._devices[index].quiet_prefix(data)
            if quiet < last:
                return None
            if quiet == last:
                found.append(index)
        if self._address_of:
            assert self._shared is not None
            quiet = self._shared.quiet_prefix(data, self._at_address)
            if quiet < last:
                return None
            if quiet == last:
                found += self._shared.addressed(data, self._at_address)
        return None if len(found) > 1 else (*found, 0)[0]

    def others(self, index: int) -> list[int]:
        """Those who are to be asked by themselves, as device ``index`` is."""
        return [each for each in self._alone if each != index]

    def call_up(self, data: bytes, asked: Sequence[int]) -> list[int]:
        """Who has to hear ``data`` itself, to which nobody reacts before its last byte; the others
        have heard it now.
        """
        receivers = list(asked)
        if self._address_of:
            assert self._shared is not None
            for index in self._shared.addressed(data, self._at_address):
                self.leave(index)
                insort(receivers, index)
            self.overhear(data)
        return receivers

    def overhear(self, data: bytes) -> None:
        """Those who are not asked have heard ``data`` now, which concerns none of them."""
        if self._address_of:
            assert self._shared is not None
            self._shared.hear(data)

    def leave(self, index: int) -> None:
        """Let device ``index`` be asked by itself."""
        address = self._address_of.pop(index, None)
        if address is None:
            return
        insort(self._alone, index)
        self._at_address[address].remove(index)
        if not self._at_address[address]:
            del self._at_address[address]
        listener = self._listeners[index]
        assert listener is not None
        if listener.reception is self._shared:
            listener.reception = self._shared.copy()

    def come_back(self, index: int, now: Nanos) -> None:
        """Let device ``index`` be one of the others again, if it is where they are."""
        listener = self._listeners[index]
        if listener is None or len(self._devices) == 1 or index in self._address_of:
            return
        address = listener.heeded_address(now)
        if address is None:
            return
        if self._shared is None or not self._address_of:
            self._shared = listener.reception.copy()
        elif not self._shared.is_like(listener.reception):
            return
        listener.reception = self._shared
        self._alone.remove(index)
        self._address_of[index] = address
        self._at_address.setdefault(address, []).append(index)


def _is_in(station: int, stations: Sequence[int]) -> bool:
    """Whether ``station`` is one of ``stations``, which ascend."""
    at = bisect_left(stations, station)
    return at < len(stations) and stations[at] == station
