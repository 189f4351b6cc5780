"""The inputs of one board: limits, auxiliary inputs, shield, control panel, potentiometers.

Rules
-----
1. An input is on while its contact is closed.  The shield's switch is closed while the shield is
   open (MN4-SHD-01): an input that nobody touches is safe.
2. Each limit and auxiliary input has an ON value; S is the sum of those that are on (MN4-CMD-S-01).
3. The feedrate potentiometer has an effect while the input Feedrate EN is on (MN4-IO-01).
"""

from collections.abc import Iterator
from typing import Final

from axistwin.devices.mn400.quirks import Mn400Quirks
from axistwin.errors import UsageError, nearest

SIGNS: Final = (("minus", -1), ("plus", 1))
LIMITS: Final = {
    f"m{axis + 1}_{word}": (axis, direction) for axis in range(4) for word, direction in SIGNS
}
"""Axis, from 0, and direction of each limit, in the order of the ON values."""

AUXILIARY: Final = tuple(f"aux_{number}" for number in range(1, 9))
JOGS: Final = {f"jog_{name}": place for name, place in LIMITS.items()}
"""Axis and direction of each jog input."""

PANEL: Final = ("run_jog", "start", "stop", "pause", "jog_res_0", "jog_res_1", "feedrate_enable")
NAMES: Final = (*LIMITS, *AUXILIARY, "shield", *PANEL, *JOGS)
ON_VALUES: Final = {name: 1 << bit for bit, name in enumerate((*LIMITS, *AUXILIARY))}

FULL_PERMILLE: Final = 1000


class Inputs:
    """All inputs, off; the potentiometers turned up."""

    def __init__(self, quirks: Mn400Quirks) -> None:
        self._has_feed_pot = quirks.feedrate_pot == "scale"
        self._is_signed = quirks.limit_status_signed
        self._descends = quirks.jog_res_code == "r4_first"
        self._on: set[str] = set()
        self.feed_pot_permille = FULL_PERMILLE
        self.jog_pot_permille = FULL_PERMILLE

    def is_on(self, name: str) -> bool:
        """Whether an input is on.  Raises UsageError for a name that is none."""
        if name not in NAMES:
            raise UsageError(f"input {name!r} does not exist: {nearest(name, NAMES)}")
        return name in self._on

    def set(self, name: str, on: bool) -> bool:
        """Turn an input on or off; whether that changes it.  Raises UsageError."""
        if self.is_on(name) == on:
            return False
        (self._on.add if on else self._on.discard)(name)
        return True

    @property
    def is_shield_open(self) -> bool:
        """Whether the shield is open (rule 1)."""
        return "shield" in self._on

    @property
    def limits_on(self) -> Iterator[tuple[int, int, int]]:
        """Axis, direction and ON value of the limits that are on."""
        for name, (axis, direction) in LIMITS.items():
            if name in self._on:
                yield axis, direction, ON_VALUES[name]

    def blocks(self, axis: int, direction: int) -> bool:
        """Whether a limit is on for ``axis`` in ``direction``."""
        return any(LIMITS[name] == (axis, direction) for name in self._on if name in LIMITS)

    @property
    def status(self) -> int:
        """What S tells (rule 2, MN4-AMB-35)."""
        word = sum(ON_VALUES.get(name, 0) for name in self._on)
        return word - 0x10000 if self._is_signed and word & 0x8000 else word

    @property
    def feed_permille(self) -> int:
        """How much of its speed a motion has (rule 3)."""
        if self._has_feed_pot and "feedrate_enable" in self._on:
            return self.feed_pot_permille
        return FULL_PERMILLE

    @property
    def tap_resolution(self) -> int:
        """The parameter of G that Jog Res 1 and 0 select, from 0 (MN4-JOG-02)."""
        code = ("jog_res_0" in self._on) + 2 * ("jog_res_1" in self._on)
        return 3 - code if self._descends else code
