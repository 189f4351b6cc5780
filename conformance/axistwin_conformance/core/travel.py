"""How far and how fast a run may move axes: two options, shared by the families that have axes; and
where axes were seen in the motions of a check."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from axistwin_conformance.base.events import MotionSampled, PathSampled
from axistwin_conformance.core.option_types import Count
from axistwin_conformance.core.settings import Envelope, FamilyOption, Settings

MOST_TRAVEL: Final = 1 << 31  # increments: from one end of an axis's counter to the other
MOST_SPEED: Final = 8_000_000  # increments per second: the shortest period of a MAC, of one tick
TWIN_TRAVEL: Final = 1_000_000
TWIN_SPEED: Final = 1_000_000
# Motions per check: the first ones and the last, which is the one that failed, if any did.
MOTIONS_KEPT: Final = 8

MAX_TRAVEL: Final = FamilyOption(
    "max-travel",
    Count(1, MOST_TRAVEL),
    "STEPS",
    "Move each axis at most this far from the start position, in increments or steps; up to"
    f" {MOST_TRAVEL}.",
    100,
    " {value}: the suite drives no axis of {a_model}",
)
MAX_SPEED: Final = FamilyOption(
    "max-speed",
    Count(1, MOST_SPEED),
    "STEPS/S",
    f"Move at most this fast, in increments or steps per second; up to {MOST_SPEED}.",
    110,
    " {value}: the suite drives no axis of {a_model}",
)


@dataclass(frozen=True, slots=True)
class TravelSettings(Settings):
    """The bounds of motion; `unit`: what they are counted in."""

    envelope: Envelope
    eeprom_budget: int | None = None
    unit: str = "increments"

    def words(self, *, is_builtin: bool) -> list[str]:
        """Both bounds of motion, and the budget if there is one; nothing to the built-in twin."""
        if is_builtin:
            return []
        bounds = {
            "--max-travel": self.envelope.max_travel,
            "--max-speed": self.envelope.max_speed,
            "--eeprom-budget": self.eeprom_budget,
        }
        return [
            word
            for option, bound in bounds.items()
            if bound is not None
            for word in (option, str(bound))
        ]

    def within(self, safety: str) -> str:
        """How far and how fast axes are moved, and what becomes of what is stored."""
        if safety != "motion":
            return "read first and put back"
        if not self.envelope.is_guarded:
            return "without bounds: a twin cannot be harmed"
        return (
            f"not further than {self.envelope.max_travel} {self.unit} from where the axis is"
            f" found (--max-travel), not faster than {self.envelope.max_speed} per second"
            " (--max-speed)"
        )


def envelope(
    given: Mapping[str, Any], travel: int, speed: int, *, is_builtin: bool, is_twin: bool
) -> Envelope:
    """The bounds given; else `travel` and `speed` for a device, wide ones for the built-in twin.
    Enforced unless nobody has asked for any and a twin is moved."""
    asked_travel, asked_speed = given.get("max_travel"), given.get("max_speed")
    return Envelope(
        asked_travel or (TWIN_TRAVEL if is_builtin else travel),
        asked_speed or (TWIN_SPEED if is_builtin else speed),
        is_guarded=bool(asked_travel or asked_speed) or not is_twin,
    )


class Motions:
    """Where the axis was, and where it had to be, in the first motions of a check and the last."""

    def __init__(self, check: str) -> None:
        self._check = check
        self.count = 0  # sampled so far, kept or not
        self._kept: dict[str, MotionSampled] = {}
        self._paths: dict[str, PathSampled] = {}

    def sample(
        self,
        name: str,
        measured: Iterable[tuple[int, int]] = (),
        predicted: Iterable[tuple[int, int, int]] = (),
    ) -> None:
        """Record what was measured: (time_ns, position), and predicted: (time_ns, lowest, highest),
        both in the order of time on the target's clock.  Samples given under the same name belong
        to one motion."""
        before = self._kept.get(name)
        if before is None:
            self.count += 1
            if len(self._kept) == MOTIONS_KEPT:
                self._kept.popitem()
        so_far = before or MotionSampled(self._check, name, (), ())
        self._kept[name] = MotionSampled(
            self._check, name, (*so_far.measured, *measured), (*so_far.predicted, *predicted)
        )

    def trace(self, name: str, axes: tuple[str, str], point: tuple[int, ...]) -> None:
        """Record where two axes were together: a point as `PathSampled` has it."""
        before = self._paths.get(name)
        if before is None and len(self._paths) == MOTIONS_KEPT:
            self._paths.popitem()
        points = () if before is None else before.points
        self._paths[name] = PathSampled(self._check, name, axes, (*points, point))

    @property
    def paths(self) -> tuple[PathSampled, ...]:
        """The first ones and the last."""
        return tuple(self._paths.values())

    @property
    def kept(self) -> tuple[MotionSampled, ...]:
        """The first ones and the last."""
        return tuple(self._kept.values())
