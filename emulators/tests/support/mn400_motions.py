"""What the tests of the MN400's motion share."""

from axistwin.devices.mn400.motion import MotionRules, MotorStep, VectorMotion

S = 1_000_000_000


class DrawnQuirks:
    """A device's quirks: those of motion, by their names, and others."""

    response_delay_ms = 3

    def __init__(self, **changed: object) -> None:
        rules = MotionRules()
        for name in MotionRules.__dataclass_fields__:
            setattr(self, name, changed.get(name, getattr(rules, name)))


def rules(**changed: object) -> MotionRules:
    """The default rules with some readings changed."""
    return MotionRules.of(DrawnQuirks(**changed))


def end(motion: VectorMotion) -> int:
    """When the motion ends, which it does."""
    assert motion.end_ns is not None
    return motion.end_ns


def times(motion: VectorMotion, axis: int) -> list[int]:
    """Times of all commanded steps of ``axis``."""
    found = [motion.step_time_ns(axis, n + 1) for n in range(motion.path_left_at(-1)[axis])]
    assert None not in found
    return [at_ns for at_ns in found if at_ns is not None]


def negated(displacement: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """The same way backwards."""
    first, second, third, fourth = displacement
    return -first, -second, -third, -fourth


class Recorder:
    """Follows a motion through its changes and keeps all steps, if they are to be recorded."""

    def __init__(self, motion: VectorMotion, *, is_recorded: bool = True) -> None:
        self.motion = motion
        self.since_ns = motion.since_ns - 1
        self.steps: list[list[MotorStep]] = [[], [], [], []]
        self._is_recorded = is_recorded

    def until(self, now_ns: int) -> VectorMotion:
        """Take the steps up to ``now_ns``; the motion, to be changed then."""
        if self._is_recorded:
            for axis in range(4):
                self.steps[axis] += self.motion.steps(axis, self.since_ns, now_ns)
        self.since_ns = now_ns
        return self.motion

    def positions(self) -> tuple[int, ...]:
        """Where the steps lead."""
        return tuple(sum(step.direction for step in steps) for steps in self.steps)
