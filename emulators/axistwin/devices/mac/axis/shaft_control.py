"""Who has the shaft of a MAC axis: one tagged value, with what belongs to it and nothing else."""

from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from axistwin.devices.mac.axis.acceptance import State
from axistwin.motion.ramp import RampedMotion


@dataclass(frozen=True, slots=True)
class Rest:
    """Nothing moves by itself, but for a shaft that is ``coasting`` without power."""

    kind: ClassVar[None] = None
    coasting: bool = False


@dataclass(slots=True)
class Profile:
    """A ``motion`` with ramps, to the count ``number`` (PO) or without a target of its own (VE)."""

    motion: RampedMotion
    number: int | None

    @property
    def kind(self) -> State:
        """PO or VE."""
        return State.VE if self.number is None else State.PO

    @property
    def signed_target(self) -> int | None:
        """Where the profile is to end, as a displacement; None if it has no end."""
        target = self.motion.target
        return None if target is None else self.motion.trajectory.direction * target


@dataclass(slots=True)
class Segments:
    """The interpolator; ``number_after`` is the count to go to when it has run out."""

    kind: ClassVar[State] = State.IN
    number_after: int | None = None


@dataclass(slots=True)
class Brake:
    """The shaft runs out, in the state ``kind`` until it rests.

    Then the count ``number_after`` is to be gone to, or segments may follow.
    """

    kind: State
    segments_follow: bool = False
    number_after: int | None = None


ShaftControl: TypeAlias = Rest | Profile | Segments | Brake
