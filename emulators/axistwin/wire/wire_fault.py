"""What can go wrong on a wire, as a value: the kind, how often, and to which messages.

Rules
-----
1. A message is what its sender hands to the wire at once: a reply of a device, a write of the
   host, a CAN frame.
2. A fault that chooses messages acts on those of its direction that contain its words and its
   bytes.  It acts once; ``count`` times; or on each with the probability ``chance``.
3. A break, a disconnect and a busy wire choose messages too, if a direction, words, bytes, a count
   or a chance is given.  Else they come at once; or by themselves, ``per_s`` times a second on the
   average.  Noise only comes by itself.
"""

import math
import re
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any, Final, Literal, NamedTuple, TypeAlias, get_args

from axistwin.errors import UsageError, nearest
from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.wire.can_frame import CanFrame

Wire: TypeAlias = Literal["serial", "can"]
FaultKind: TypeAlias = Literal[
    "corrupt",
    "drop",
    "duplicate",
    "delay",
    "jitter",
    "break",
    "noise",
    "disconnect",
    "busy",
    "error_frame",
]
FaultDirection: TypeAlias = Literal["both", "to_device", "to_host"]
Message: TypeAlias = bytes | CanFrame

DIRECTIONS: Final = get_args(FaultDirection)
COUNT_MAX: Final = 1_000_000_000
PER_S_MIN: Final = 0.001
PER_S_MAX: Final = 1000.0
DURATION_MS_MIN: Final = 0.001
DURATION_MS_MAX: Final = 60_000.0
TEXT_MAX: Final = 200


class FaultType(NamedTuple):
    """A kind of fault: on which wires it may be, and what it does, in words.

    duration_ms: how long it lasts unless said otherwise; None: it has no duration.
    """

    wires: tuple[Wire, ...]
    doc: str
    duration_ms: float | None = None
    comes: bool = False
    """Whether it can come by itself, without a message."""
    chooses: bool = True
    """Whether it can choose messages."""


_SERIAL: Final[tuple[Wire, ...]] = ("serial",)
_BOTH: Final[tuple[Wire, ...]] = ("serial", "can")

FAULT_TYPES: Final[dict[FaultKind, FaultType]] = {
    "corrupt": FaultType(_BOTH, "one bit of the message is flipped"),
    "drop": FaultType(_BOTH, "the message is lost"),
    "duplicate": FaultType(_BOTH, "the message comes twice"),
    "delay": FaultType(_BOTH, "the message comes later by the duration", 20.0),
    "jitter": FaultType(_BOTH, "each byte or frame waits up to the duration", 5.0),
    "break": FaultType(_SERIAL, "the sender holds its line at space, then sends", 5.0, True),
    "noise": FaultType(
        _SERIAL, "a byte that nobody sent comes on a line at rest", None, True, False
    ),
    "disconnect": FaultType(_BOTH, "nothing is heard for the duration", 100.0, True),
    "busy": FaultType(
        _BOTH, "the wire is held dominant for the duration: nothing passes", 100.0, True
    ),
    "error_frame": FaultType(("can",), "an error frame destroys it; the sender tries again"),
}


@dataclass(frozen=True, slots=True)
class WireFault:
    """A fault, checked: raises UsageError with the name of the field in front.

    message: words that its meaning contains, as a transcript shows it; letters of either case.
    hex: bytes that follow one another in it, ``..`` for any; of CAN frames, ``581#`` in front for
    the identifier.  count: how many times it acts.  chance: 0 to 1, of each message.
    per_s: how many times a second of the line.  duration_ms: see ``FAULT_TYPES``.
    """

    kind: FaultKind
    direction: FaultDirection | None = None
    message: str = ""
    hex: str = ""
    count: int | None = None
    chance: float | None = None
    per_s: float | None = None
    duration_ms: float | None = None
    _pattern: "_Pattern" = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.kind not in FAULT_TYPES:
            raise UsageError(f"kind {self.kind!r}: {nearest(str(self.kind), FAULT_TYPES)}")
        if self.direction is not None and self.direction not in DIRECTIONS:
            remedy = nearest(str(self.direction), DIRECTIONS)
            raise UsageError(f"direction {self.direction!r}: {remedy}")
        _check("count", self.count, 1, COUNT_MAX)
        _check("chance", self.chance, 0.0, 1.0)
        _check("per_s", self.per_s, PER_S_MIN, PER_S_MAX)
        _check("duration_ms", self.duration_ms, DURATION_MS_MIN, DURATION_MS_MAX)
        for name in ("message", "hex"):
            text = getattr(self, name)
            if not isinstance(text, str) or len(text) > TEXT_MAX:
                raise UsageError(f"{name}: write a text of at most {TEXT_MAX} characters")
        object.__setattr__(self, "_pattern", _pattern(self.hex))
        self._check_together()

    def _check_together(self) -> None:
        found = FAULT_TYPES[self.kind]
        if self.duration_ms is not None and found.duration_ms is None:
            raise UsageError(f"duration_ms: {self.kind} has none; leave it out")
        if self.per_s is None:
            if not found.chooses:
                raise UsageError(f"per_s is missing: {self.kind} comes so many times a second")
            return
        if not found.comes:
            raise UsageError(f"per_s: {self.kind} needs a message to act on; give a chance instead")
        for name in ("message", "hex", "chance"):
            if getattr(self, name):
                raise UsageError(f"{name}: with per_s it chooses no message; leave one of them out")

    @property
    def duration_ns(self) -> Nanos:
        """How long it lasts, of those that do."""
        default = FAULT_TYPES[self.kind].duration_ms
        given = self.duration_ms if self.duration_ms is not None else default
        return 0 if given is None else round(given * NS_PER_MS)

    @property
    def is_immediate(self) -> bool:
        """Whether it comes at once (rule 3)."""
        chooses = (
            self.message or self.hex or (self.direction, self.count, self.chance) != (None,) * 3
        )
        return FAULT_TYPES[self.kind].comes and self.per_s is None and not chooses

    @property
    def chooses_messages(self) -> bool:
        """Whether it acts on messages (rule 3)."""
        return self.per_s is None and not self.is_immediate

    @property
    def limit(self) -> int | None:
        """How many times it acts at most; None: until it is removed."""
        if self.count is not None:
            return self.count
        return 1 if self.chance is None and self.per_s is None else None

    @property
    def gap_max_ns(self) -> Nanos:
        """What lies between two times that it comes by itself, at most; half of it on average."""
        assert self.per_s is not None
        return round(2 * NS_PER_S / self.per_s)

    def concerns(self, *, to_host: bool) -> bool:
        """Whether what goes there is in its direction."""
        return self.direction in (None, "both", "to_host" if to_host else "to_device")

    def fits(self, message: Message) -> bool:
        """Whether ``message`` contains its bytes."""
        return self._pattern.fits(message)

    def selection(self) -> dict[str, Any]:
        """Its fields by name, those that were given."""
        values = {each.name: getattr(self, each.name) for each in fields(self) if each.init}
        return {name: value for name, value in values.items() if value not in (None, "")}

    def __str__(self) -> str:
        chosen = self.selection()
        return " ".join([chosen.pop("kind"), *(f"{name}={each}" for name, each in chosen.items())])


FAULT_FIELDS: Final = tuple(each.name for each in fields(WireFault) if each.init)


def make_fault(wire: Wire, **selection: Any) -> WireFault:
    """The fault with the fields ``selection``, if ``wire`` can have it.  Raises UsageError."""
    for name in selection:
        if name not in FAULT_FIELDS:
            raise UsageError(f"{name}: a fault has no such field: {nearest(name, FAULT_FIELDS)}")
    if "kind" not in selection:
        raise UsageError(f"kind is missing: {nearest('', FAULT_TYPES)}")
    fault = WireFault(**selection)
    if wire not in FAULT_TYPES[fault.kind].wires:
        known = [kind for kind, each in FAULT_TYPES.items() if wire in each.wires]
        noun = {"serial": "a serial line", "can": "a CAN bus"}[wire]
        raise UsageError(f"kind {fault.kind!r} is not for {noun}: known: {', '.join(known)}")
    if wire == "serial" and "#" in fault.hex:
        raise UsageError(f"hex {fault.hex!r}: a serial line has no identifiers; write bytes only")
    return fault


def _check(name: str, value: Any, low: float, high: float) -> None:
    if value is None:
        return
    is_whole = isinstance(low, int)
    if isinstance(value, bool) or not isinstance(value, int if is_whole else int | float):
        raise UsageError(f"{name} {value!r}: write a {'whole ' if is_whole else ''}number")
    if not (math.isfinite(value) and low <= value <= high):
        raise UsageError(f"{name} {value:.12g} is out of range: {low:.12g}..{high:.12g}")


class _Pattern(NamedTuple):
    identifier: str
    bytes: re.Pattern[bytes]

    def fits(self, message: Message) -> bool:
        if isinstance(message, CanFrame):
            own = str(message).partition("#")[0]
            if self.identifier and own.lstrip("0") != self.identifier.lstrip("0"):
                return False
            message = message.data
        return self.bytes.search(message) is not None


@cache
def _pattern(text: str) -> _Pattern:
    """What ``text`` stands for: ``31 .. 0D``, or ``581#60``.  Raises UsageError."""
    bare = "".join(text.split()).upper()
    found = re.fullmatch(r"(?:([0-9A-F]{1,8})#)?((?:[0-9A-F]{2}|\.\.)*)", bare)
    if found is None:
        raise UsageError(
            f"hex {text!r}: write bytes as two digits each, '..' for any, such as '02 .. 0D'"
        )
    pairs = re.findall("..", found[2])
    parts = [b"." if pair == ".." else re.escape(bytes.fromhex(pair)) for pair in pairs]
    return _Pattern(found[1] or "", re.compile(b"".join(parts), re.DOTALL))
