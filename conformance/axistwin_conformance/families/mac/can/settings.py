"""What a download sets and an upload tells: where it stands in both, and values to set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from axistwin_conformance.families.mac.can.driver import CanDriver

PARAMETERS: Final = (0x22, 0x23, 0x25, 0x26)


@dataclass(frozen=True, slots=True)
class Setting:
    """A download whose value an upload tells: there in these bits, and two values to set."""

    index: int
    query: int
    shift: int
    mask: int
    values: tuple[int, int]
    shown_by: int = 0  # how far left the value stands in the download

    def read(self, driver: CanDriver) -> int:
        """What the module holds."""
        return driver.client.value(self.query) >> self.shift & self.mask

    def parameter(self, value: int) -> int:
        """The parameter that sets it."""
        return value << self.shown_by

    def other(self, driver: CanDriver) -> int:
        """One of the two values that the module does not hold."""
        first, second = self.values
        return second if self.read(driver) == first else first


SETTINGS: Final[Mapping[int, Setting]] = {
    setting.index: setting
    for setting in (
        Setting(0x02, 0x26, 12, 0xF, (0, 1)),
        Setting(0x03, 0x26, 8, 0xF, (0, 8)),
        Setting(0x09, 0x22, 0, 0xFFFFFFFF, (0x12345678, 0x3FFFFFFF)),
        Setting(0x0A, 0x23, 0, 0xFFFFFFFF, (0xEDCBA988, 0xC0000000)),
        Setting(0x0C, 0x26, 16, 0xFF, (0x21, 0x40)),
        Setting(0x0D, 0x25, 0, 0xFFFF, (0xF012, 0xF1F0)),
        Setting(0x0E, 0x25, 24, 0xFF, (0x0A, 0x14), shown_by=8),
        Setting(0x0F, 0x26, 24, 0xFF, (0x03, 0x05)),
        Setting(0x1C, 0x26, 0, 0xFF, (0x02, 0x07)),
    )
}
TORQUE: Final = SETTINGS[0x0C]


def held(driver: CanDriver) -> list[int]:
    """All that a request which is no request must not change."""
    return [driver.client.value(index) for index in (0x20, *PARAMETERS)]


def unchanged(driver: CanDriver, before: list[int], requirement: str) -> None:
    """Judge that position and parameters are what they were."""
    after = held(driver)
    words = [" ".join(f"{value:08X}" for value in row) for row in (before, after)]
    driver.session.expect(after == before, requirement, *words)
