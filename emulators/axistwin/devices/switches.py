"""Switches of a twin, as data: the points that a manual leaves open, each with its readings.

Rules
-----
1. A family of devices lists its switches as the fields of one frozen dataclass, made by ``quirk``
   and ``number``.  A face of it may have only some of them.
2. A choice is a ``Literal``: its values are what a user writes, the default first.  A ``bool`` is
   written ``true`` or ``false``.  A number may be written ``11h``, ``0x11`` or ``17``.  A text has
   a form and a check.
3. A class variable of text among the fields begins a group of that name.
4. Nobody compares or prints settings, and with a hundred fields the methods for it are dear to
   make: the dataclass has ``eq=False, repr=False``, which halves its share of a twin's start.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, TypeAlias, TypeVar, get_args, get_origin, get_type_hints

from axistwin.errors import UsageError, nearest, suggestion

Value: TypeAlias = str | int | bool

ANY_FACE: frozenset[str] = frozenset()
"""Of a switch that every face of its family has."""

DIGITS_MAX = 32
"""More than any switch has; Python itself refuses to read numbers of thousands of digits."""

_SIGNED_32 = (-(1 << 31), (1 << 31) - 1)
_TRUE, _FALSE = {"true", "yes", "on", "1"}, {"false", "no", "off", "0"}


def quirk(
    default: Any, source: str, doc: str, faces: frozenset[str] = ANY_FACE, **limits: Any
) -> Any:
    """A switch: its default, ledger ID, one-line meaning, faces, and what limits its values."""
    return field(default=default, metadata={"source": source, "doc": doc, "faces": faces, **limits})


def number(
    default: int,
    low: int,
    high: int,
    source: str,
    doc: str,
    digits: int = 0,
    faces: frozenset[str] = ANY_FACE,
) -> Any:
    """A numeric switch in ``low..high``; ``digits`` > 0 lists it in that many hex digits."""
    return quirk(default, source, doc, faces, low=low, high=high, digits=digits)


@dataclass(frozen=True, slots=True)
class Quirk:
    """One switch as the program lists it.

    allowed: the values in the order of the readings, or a single text describing a range.
    default: as a user would write it.  source: ledger ID.  kind: choice, bool, number or text.
    check: whether a text is allowed beside the default.  group: what it belongs to, in words.
    """

    name: str
    source: str
    doc: str
    allowed: tuple[str, ...]
    default: str
    kind: str
    choices: tuple[Value, ...] = ()
    low: int = 0
    high: int = 0
    check: Callable[[str], bool] | None = None
    group: str = ""

    def parse(self, value: Value) -> Value:
        """The setting that ``value`` (text of a command line, or a TOML value) means.

        Raises UsageError naming the value, what is allowed and the nearest of it.
        """
        parsed: Value | None = _PARSERS[self.kind](self, value)
        if parsed is None:
            hint = suggestion(str(value), self.allowed) if len(self.allowed) > 1 else ""
            raise UsageError(
                f"quirk {self.name}: {value!r} is not allowed; "
                f"allowed: {', '.join(self.allowed)}{hint and f'; {hint}'}"
            )
        return parsed


def _parse_number(text: Value) -> int | None:
    """``17``, ``11h``, ``0x11`` or an integer; None for anything else."""
    if isinstance(text, bool):
        return None
    if isinstance(text, int):
        return text
    body, base = text.strip().lower(), 10
    if body.endswith("h"):
        body, base = body[:-1], 16
    elif body.startswith("0x"):
        body, base = body[2:], 16
    digits = body[1:] if base == 10 and body[:1] == "-" else body
    allowed = "0123456789abcdef"[:base]
    is_number = 0 < len(digits) <= DIGITS_MAX and all(digit in allowed for digit in digits)
    return int(body, base) if is_number else None


def _parse_choice(quirk: Quirk, value: Value) -> Value | None:
    if value in quirk.choices and not isinstance(value, bool):
        return value
    if str(value) in quirk.allowed:
        return quirk.choices[quirk.allowed.index(str(value))]
    parsed = _parse_number(value)
    if parsed is not None and parsed in quirk.choices:
        return parsed
    return str(parsed) if parsed is not None and str(parsed) in quirk.choices else None


def _parse_bool(_: Quirk, value: Value) -> bool | None:
    text = str(value).strip().lower()
    return True if text in _TRUE else False if text in _FALSE else None


def _parse_ranged(quirk: Quirk, value: Value) -> int | None:
    parsed = _parse_number(value)
    if parsed is not None and quirk.low == _SIGNED_32[0] and parsed >> 31 == 1:
        parsed -= 1 << 32  # C0000000h: a signed field in hex digits
    return parsed if parsed is not None and quirk.low <= parsed <= quirk.high else None


def _parse_text(quirk: Quirk, value: Value) -> str | None:
    text = str(value).strip()
    assert quirk.check is not None
    return text if text == quirk.default or quirk.check(text) else None


_PARSERS: dict[str, Any] = {
    "choice": _parse_choice,
    "bool": _parse_bool,
    "number": _parse_ranged,
    "text": _parse_text,
}


def _spell(value: Value, digits: int = 0) -> str:
    """A value as a user would write it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int) and digits:
        return f"{value & ((1 << 4 * digits) - 1):0{digits}X}h"
    return str(value)


def _describe(name: str, hint: Any, default: Any, metadata: Mapping[str, Any]) -> Quirk:
    """One field as the program lists it."""
    if get_origin(hint) is Literal:
        choices = get_args(hint)
        assert choices[0] == default, f"{name}: the default is the first reading"
        highest = max((choice for choice in choices if isinstance(choice, int)), default=0)
        digits = len(f"{highest:02X}") if highest > 9 else 0
        allowed = tuple(_spell(choice, digits) for choice in choices)
        kind, shown = "choice", allowed[0]
        return Quirk(name, metadata["source"], metadata["doc"], allowed, shown, kind, choices)
    if hint is bool:
        allowed = (_spell(default), _spell(not default))
        return Quirk(name, metadata["source"], metadata["doc"], allowed, allowed[0], "bool")
    if hint is str:
        form, check = (metadata["form"],), metadata["check"]
        source, doc = metadata["source"], metadata["doc"]
        return Quirk(name, source, doc, form, str(default), "text", check=check)
    low, high, digits = metadata["low"], metadata["high"], metadata["digits"]
    allowed = (f"{_spell(low, digits)}..{_spell(high, digits)}",)
    shown = _spell(default, digits)
    source, doc = metadata["source"], metadata["doc"]
    return Quirk(name, source, doc, allowed, shown, "number", (), low, high)


def switches(settings: type[Any], face: str = "") -> dict[str, Quirk]:
    """All switches of ``settings`` that belong to ``face``, by name, in the order of the fields."""
    hints, groups = get_type_hints(settings), _groups(settings)
    return {
        f.name: replace(
            _describe(f.name, hints[f.name], f.default, f.metadata), group=groups[f.name]
        )
        for f in fields(settings)
        if not face or face in f.metadata["faces"] or not f.metadata["faces"]
    }


def _groups(settings: type[Any]) -> dict[str, str]:
    """The group of each switch (rule 3); what a face tells anew belongs to a group of that face."""
    groups: dict[str, str] = {}
    for kind in reversed(settings.__mro__[:-1]):
        group = ""
        for name in kind.__annotations__:
            if name.isupper():
                group = getattr(settings, name)
            else:
                groups[name] = group
    return groups


Settings: TypeAlias = Mapping[str, Value] | Iterable[tuple[str, Value]]
_Quirks = TypeVar("_Quirks")


def parse_settings(kind: type[_Quirks], known: Mapping[str, Quirk], settings: Settings) -> _Quirks:
    """The quirks with the given ``settings`` (name, value as text or TOML) over the defaults.

    Raises UsageError for an unknown name (with the nearest one) or a value that is not allowed.
    """
    parsed: dict[str, Value] = {}
    for name, value in dict(settings).items():
        if name not in known:
            raise UsageError(f"unknown quirk {name!r}: {nearest(name, known)}")
        parsed[name] = known[name].parse(value)
    return kind(**parsed)
