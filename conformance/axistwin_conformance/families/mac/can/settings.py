"""What a download sets and an upload tells: where it stands in both, and values to set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from axistwin_conformance.families.mac.axis.parameters import (
    PARAMETER_QUERIES,
    PARAMETERS,
    AxisParameter,
)
from axistwin_conformance.families.mac.can.driver import CanDriver


@dataclass(frozen=True, slots=True)
class SettingTrial:
    """A download whose value an upload tells, and two values to set."""

    stored: AxisParameter
    values: tuple[int, int]

    @property
    def index(self) -> int:
        """Of the download."""
        return self.stored.index

    def read(self, driver: CanDriver) -> int:
        """What the module holds."""
        return driver.client.parameter(self.index)

    def parameter(self, value: int) -> int:
        """The parameter that sets it."""
        return self.stored.parameter(value)

    def other(self, driver: CanDriver) -> int:
        """One of the two values that the module does not hold."""
        first, second = self.values
        return second if self.read(driver) == first else first


VALUES: Final[Mapping[int, tuple[int, int]]] = {
    0x02: (0, 1),
    0x03: (0, 8),
    0x09: (0x12345678, 0x3FFFFFFF),
    0x0A: (0xEDCBA988, 0xC0000000),
    0x0C: (0x21, 0x40),
    0x0D: (0xF012, 0xF1F0),
    0x0E: (0x0A, 0x14),
    0x0F: (0x03, 0x05),
    0x1C: (0x02, 0x07),
}
SETTINGS: Final = {
    index: SettingTrial(PARAMETERS[index], values) for index, values in VALUES.items()
}
TORQUE: Final = SETTINGS[0x0C]


def held(driver: CanDriver) -> list[int]:
    """All that a request which is no request must not change."""
    return [driver.client.value(index) for index in (0x20, *PARAMETER_QUERIES)]


def unchanged(driver: CanDriver, before: list[int], requirement: str) -> None:
    """Judge that position and parameters are what they were."""
    after = held(driver)
    words = [" ".join(f"{value:08X}" for value in row) for row in (before, after)]
    driver.session.expect(after == before, requirement, *words)
