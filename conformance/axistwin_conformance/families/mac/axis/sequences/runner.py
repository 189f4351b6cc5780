"""Who plays operations on an axis, and from where."""

from __future__ import annotations

from functools import cache

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import Sample
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.model.axis_model import AxisModel
from axistwin_conformance.families.mac.axis.model.forecast import Forecast
from axistwin_conformance.families.mac.axis.sequences.operations import OPERATIONS, operations_of
from axistwin_conformance.families.mac.axis.sequences.sequence import (
    BYTES_PER_OPERATION,
    OPEN_STOPS,
    AxisSequence,
    begin,
    read_parameters,
)
from axistwin_conformance.sequences import runner
from axistwin_conformance.sequences.runner import Operations, OperationSequence, Runner


def split(data: bytes, kinds: int = len(OPERATIONS)) -> Operations:
    """Cut bytes into operations, each told by its lowest number."""
    return runner.split(data, kinds, BYTES_PER_OPERATION)


class AxisRunner(Runner):
    """Plays operations on one module, always from the same place."""

    operation_bytes = BYTES_PER_OPERATION
    arguments = (3, 1, 2)
    beginning = "00h"

    def __init__(self, driver: AxisDriver, home: int) -> None:
        super().__init__(driver.session)
        self.driver, self.home = driver, home
        self._last: AxisSequence | None = None
        driver.motion.is_plotting = False  # or the ways home of all sequences would fill the report

    @property
    def kinds(self) -> int:
        """How many operations there are on this face."""
        return len(operations_of(self.driver))

    def on(self, session: Session) -> AxisRunner:
        """The same on the twin of this module."""
        driver = driver_of(session)
        return AxisRunner(driver, driver.motion.ready())

    def begin(self) -> AxisSequence:
        """A sequence that begins where every sequence begins; fresh ones with 00h, which costs 2 s
        of deafness."""
        again = None if self.is_fresh or self._last is None else self._last.again()
        if again is None:
            if self.is_fresh:
                self.driver.motion.reinitialise()
            for index, parameter in OPEN_STOPS:
                self.driver.client.command(index, parameter)
            again = begin(self.driver, self.home, model_of, operations_of(self.driver))
        self._last = again
        return again

    def watched(self, run: OperationSequence) -> None:
        """Have the motion plotted."""
        assert isinstance(run, AxisSequence), "it has begun here"
        run.watch = self._plot

    def _plot(self, forecast: Forecast, sample: Sample, slack: int) -> None:
        self.driver.motion.is_plotting = True
        self.driver.motion.plot(forecast, sample, slack)
        self.driver.motion.is_plotting = False


def model_of(driver: AxisDriver) -> AxisModel:
    """The model of a module at rest, held to the readings it has shown.

    Speeds are changed under way only on a device that does so by the default law: see
    `UNRULED_CHANGES`.
    """
    return AxisModel(
        read_parameters(driver), Forecast.rest(0), cache(driver.readings.known),
        driver.readings.law_of(1), driver.client.face.acceptance,
    )  # fmt: skip
