"""What the command line says of one kind of device alone.

A family declares its options as data in a module `options` of its folder, whose `OPTIONS` is a
`FamilyOptions`.  The command line finds these modules without loading the families; what was given
becomes the family's own `Settings`, which the engine asks what they meet, how they are typed again,
and what they allow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final


@dataclass(frozen=True, slots=True)
class Envelope:
    """The bounds of motion on this device: `max_travel` increments or steps either way from where
    the run found each axis, `max_speed` per second."""

    max_travel: int
    max_speed: int
    is_guarded: bool = True  # False: nobody holds back what asks for more (built-in twin)


NO_MOTION: Final = Envelope(0, 0, is_guarded=False)


@dataclass(frozen=True, slots=True)
class FamilyOption:
    """One option of a family.

    `name`: as typed, without dashes.  `kind`: a type of click.  `order`: its place in `--help`
    among the options of all families.  `refusal`: why other models do not take it, behind its name;
    {value}, {model} and {a_model} are filled in.
    """

    name: str
    kind: Any
    metavar: str
    help: str
    order: int
    refusal: str

    @property
    def parameter(self) -> str:
        """The name under which its value is handed on."""
        return self.name.replace("-", "_")


class Settings:
    """What a family's options have been set to.  These are the ones of a family without any.

    `envelope`: the bounds of motion.  `eeprom_budget`: how many writes to an EEPROM a run may ask
    for; None: any number, or there is none.
    """

    __slots__ = ()
    envelope: Envelope = NO_MOTION
    eeprom_budget: int | None = None

    @property
    def met(self) -> frozenset[str]:
        """The needs of the family's checks that they meet."""
        return frozenset()

    @property
    def withheld(self) -> Mapping[str, str]:
        """What no rig may do as long as a need is not met: capability → need."""
        return {}

    @property
    def named(self) -> Mapping[str, str]:
        """What of the device is the suite's to use, by the name of its option, as typed there."""
        return {}

    def words(self, *, is_builtin: bool) -> list[str]:
        """The options that say the same again; `is_builtin`: to the built-in twin."""
        return []

    def within(self, safety: str) -> str:
        """The bounds that are kept to in what a check of that safety class does to the device."""
        return {"motion": "without bounds", "stored": "read first and put back"}.get(safety, "")


class FamilyOptions:
    """The options of a family, in `declared`, and what they mean.  These are those of a family that
    has none.  `needs`: what only they meet, and how that is said to who has not given them."""

    declared: ClassVar[tuple[FamilyOption, ...]] = ()
    needs: ClassVar[Mapping[str, str]] = {}

    def settings(self, given: Mapping[str, Any], *, is_builtin: bool, is_twin: bool) -> Settings:
        """Make settings of what was given, by `FamilyOption.parameter`; None: it was not.

        Raises UsageError for what cannot be meant.
        """
        return Settings()
