"""A twin with one fault, as the line or the bus meets it: what comes and what goes passes here."""

from __future__ import annotations

import contextlib
import copy
import inspect
import pkgutil
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from importlib import import_module
from typing import Any
from zlib import crc32

import pytest
from zoo.judge import Overrun, is_over, limited
from zoo.mutant import forget

from axistwin.kernel.effects import SendFrame, Transmit
from axistwin.runtime.control_access import DeviceAccess
from axistwin.runtime.device_network import DeviceNetwork
from axistwin.wire.can_frame import CanFrame
from sweeping.faults import CHANGES, Fault
from sweeping.formats import FORMATS, Format
from sweeping.runs import TRAVEL

UNENDING = "never comes to an end"
GHOST_NS = 60_000_000  # so long a device answers whose effects are forgotten
BYTE_NS = 1_000_000
# Of processor time, for one chunk or wake-up: a twin whose fault makes it turn on the spot is no
# device.
LIMIT_S = 5.0
ENOUGH_LOOKS = 2  # one reading may be noise
SWING = 100  # increments: an axis may swing, or be slow to stop, by fewer


@dataclass
class Tally:
    """What has happened: how often the fault could hit, and did; how many replies were said, and
    how many requests have come since; how far a shaft went.

    `asked_outside`: how often a host has asked for the place of a shaft that was outside the
    envelope.  Two answers are enough to know it: `stood` is how far out such a shaft then came to
    rest, and `went_on` whether it went on from there.  `wire`: a sum over all that was said, and
    when: where it is that of a sound twin, no host could see the fault.
    """

    asked: int = 0
    hits: int = 0
    said: int = 0
    unanswered: int = 0
    furthest: int = 0
    crash: str = ""
    first: dict[int, int] = field(default_factory=dict)
    last: dict[int, int] = field(default_factory=dict)
    asked_outside: dict[int, int] = field(default_factory=dict)
    stood: dict[int, int] = field(default_factory=dict)
    went_on: bool = False
    wire: int = 0

    def within(self, call: Callable[..., Any], *given: Any) -> Any:
        """What a device gives within `LIMIT_S`; raises what it falls over, and what it has."""
        if self.crash:
            raise RuntimeError(self.crash)
        try:
            with limited(LIMIT_S):
                return call(*given)
        except Overrun:
            if is_over():  # the run, and not for this chunk
                raise
            self.crash = UNENDING
            raise RuntimeError(UNENDING) from None
        except Exception as error:
            self.fall(f"{type(error).__name__}: {error}")
            raise

    def fall(self, reason: str) -> None:
        """The twin is no more; the first reason counts."""
        self.crash = self.crash or reason

    def look(self, device: Any, now: int, *, is_asked: bool = False) -> None:
        """Follow a shaft, if the device has one.  `is_asked`: a host has just asked where it is."""
        axis = getattr(device, "axis", None)
        if axis is not None:
            self.follow(id(device), axis.drive.plant.position_at(now), is_asked=is_asked)

    def follow(self, device: int, place: int, *, is_asked: bool) -> None:
        """That shaft is at that place."""
        far = abs(place - self.first.setdefault(device, place))
        self.furthest = max(self.furthest, far)
        known = self.asked_outside.get(device, 0)
        if known >= ENOUGH_LOOKS and self.last.get(device) == place:
            self.stood.setdefault(device, far)
        self.went_on |= far > self.stood.get(device, far) + SWING
        if far > TRAVEL:
            self.asked_outside[device] = known + is_asked
        self.last[device] = place

    @property
    def is_held(self) -> bool:
        """Whether every shaft that got outside was brought to rest once a host could know it, and
        stayed where it was then."""
        return not self.went_on and 0 < len(self.asked_outside) == len(self.stood)


class WrongDevice:
    """One device of a network with a fault; all that is not here is the twin's."""

    def __init__(self, inner: Any, fault: Fault, form: Format, tally: Tally) -> None:
        self._inner, self._fault, self._form, self._tally = inner, fault, form, tally
        self._is_on_bus = hasattr(inner, "accepts")
        self._true: Any = None  # the device, while another one answers in its place
        self._ghost_until_ns = 0
        self._kind = ""
        self._numbers: dict[str, int] = {}  # how many messages so far, of each sort
        self._before: dict[str, bytes] = {}  # the last of each sort
        self._first: dict[str, bytes] = {}
        self._held: list[Any] = []
        self._due: list[tuple[int, Callable[[int], list[Any]]]] = []
        self._sent: dict[Any, Any] = {}  # frame as it left → as the twin made it
        rate = fault.amount if fault.part == "clock" else 1000
        self._rate = Fraction(rate, 1000)
        self._origin_ns: int | None = None if rate != 1000 else 0
        tally.hits += rate != 1000

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    # --- its clock --------------------------------------------------------------------------------

    def _own(self, now: int) -> int:
        """That instant by the device's clock."""
        if self._rate == 1:
            return now
        if self._origin_ns is None:
            self._origin_ns = now
        return self._origin_ns + int((now - self._origin_ns) * self._rate)

    def _ours(self, now: int) -> int:
        if self._rate == 1 or self._origin_ns is None:
            return now
        return self._origin_ns - int((self._origin_ns - now) / self._rate // 1)

    def next_event(self) -> int | None:
        """The twin's, or what is still to come of a fault."""
        if self._tally.crash:
            return None
        due = [when for when, _ in self._due]
        due += [self._ghost_until_ns] if self._true is not None else []
        if (inner := self._inner.next_event()) is not None:
            due.append(self._ours(inner))
        return min(due, default=None)

    def wake(self, now: int) -> list[Any]:
        """Do what is due."""
        found: list[Any] = []
        if self._true is not None and now >= self._ghost_until_ns:
            self._lay_ghost(now)
        ready = [act for when, act in self._due if when <= now]
        self._due = [(when, act) for when, act in self._due if when > now]
        for act in ready:
            found += act(now)
        own = self._inner.next_event()
        if own is not None and self._ours(own) <= now:
            found += self._out(self._guarded(self._inner.wake, self._own(now)), now)
        self._tally.look(self._inner, self._own(now))
        due = self.next_event()
        if due is not None and due <= now and not self._tally.crash:
            self._tally.crash = UNENDING  # the schedule would say so in words of its own
            raise RuntimeError(UNENDING)
        return found

    def power_off(self, now: int) -> list[Any]:
        """As the twin."""
        return self._guarded(self._inner.power_off, self._own(now))

    def power_on(self, now: int) -> list[Any]:
        """As the twin."""
        return self._guarded(self._inner.power_on, self._own(now))

    def cells(self, now: int) -> Any:
        """As the twin."""
        return self._seen((self._true or self._inner).cells, now)

    def is_moving(self, now: int) -> bool:
        """As the twin."""
        return bool(self._seen(self._inner.is_moving, now))

    def describe(self, now: int) -> Any:
        """As the twin."""
        return self._seen(self._inner.describe, now)

    # --- what comes -------------------------------------------------------------------------------

    def receive(self, message: Any, end_ns: int = -1) -> list[Any]:
        """A stretch of bytes, or a frame that is complete at `end_ns`."""
        lead = 0 if isinstance(message, CanFrame) else self._form.lead(message.data)
        parts = [message]
        if lead:
            rest, skipped = message.data[lead:], message.skipped + lead
            parts = [message.first(lead), message._replace(data=rest, skipped=skipped)]
        try:
            return [effect for part in parts for effect in self._receive(part, end_ns)]
        except Exception as error:  # of the fault itself: that is no device's either
            self._tally.crash = self._tally.crash or f"{type(error).__name__}: {error}"
            raise

    def _receive(self, message: Any, end_ns: int) -> list[Any]:
        is_frame = isinstance(message, CanFrame)
        data = _packed(message) if is_frame else message.data
        now = end_ns if is_frame else message.arrival_ns(len(message.data) - 1)

        def tell(other: bytes, at_ns: int) -> list[Any]:
            if is_frame:
                given: tuple[Any, ...] = (_frame(other), self._own(at_ns))
            else:
                begun = self._own(message.start_ns + at_ns - now)
                given = (message._replace(start_ns=begun, data=other),)
            return self._guarded(self._inner.receive, *given)

        if self._true is not None:
            self._lay_ghost(now)
        found: list[Any] = []
        kind = self._form.kind(data)
        is_for_others = not is_frame and self.quiet_prefix(data) == len(data)
        if kind and not is_for_others and not (is_frame and message.is_remote):
            self._kind = kind
            self._tally.unanswered += 1
            found += self._obey(kind, data, now, tell)
        else:
            found += self._out(tell(data, now), now)
        self._tally.look(
            self._inner, self._own(now), is_asked=bool(kind) and kind == self._form.place
        )
        return found

    def quiet_prefix(self, data: bytes) -> int:
        """As the twin; one that would hear fewer bytes than none never hears the next."""
        count = int(self._inner.quiet_prefix(data))
        if count < 0:
            self._tally.fall(UNENDING)
            raise RuntimeError(UNENDING)
        return count

    def sent(self, frame: CanFrame, end_ns: int) -> list[Any]:
        """A frame has left; the twin knows it as it has made it."""
        made = self._sent.pop(frame, frame)
        return self._out(self._guarded(self._inner.sent, made, self._own(end_ns)), end_ns)

    def _guarded(self, call: Callable[..., Any], *given: Any) -> list[Any]:
        return [] if self._tally.crash else list(self._tally.within(call, *given))

    def _seen(self, look: Callable[[int], Any], now: int) -> Any:
        """What somebody who looks on sees; to see it, the twin has to come up to that instant."""
        return self._tally.within(look, self._own(now))

    def _hits(self, sort: str, kind: str) -> bool:
        """Whether the fault hits this message; counts it."""
        if not self._fault.concerns(kind):
            return False
        number = self._numbers.get(sort, 0)
        self._numbers[sort] = number + 1
        self._tally.asked += 1
        return self._fault.when.is_due(number)

    def _obey(
        self, kind: str, data: bytes, now: int, tell: Callable[[bytes, int], list[Any]]
    ) -> list[Any]:
        fault = self._fault
        before, self._before[kind] = self._before.get(kind, data), data
        if fault.part not in ("value that is understood", "effect", "state"):
            return self._out(tell(data, now), now)
        if not self._hits("request", kind):
            return self._out(tell(data, now), now)
        if fault.part == "value that is understood":
            values = self._form.values(data)
            wrong = fault.changed(values)
            if wrong != values:
                self._tally.hits += self._form.means_other(kind, values, wrong)
                data = self._form.with_values(data, wrong)
            return self._out(tell(data, now), now)
        self._tally.hits += 1
        if fault.part == "state":
            found = self.power_off(now) + self.power_on(now)
            return found + self._out(tell(data, now), now)
        return self._misdo(data, before, now, tell)

    def _misdo(
        self, data: bytes, before: bytes, now: int, tell: Callable[[bytes, int], list[Any]]
    ) -> list[Any]:
        """Carry out something else than was asked for."""
        fault = self._fault
        match fault.how:
            case "none, no reply":
                return []
            case "refused":
                return self._say(self._form.refusal(data), now + BYTE_NS)
            case "none" | "late":
                if fault.how == "late":
                    self._later(now + fault.amount, lambda at: _mute(tell(data, at)))
                self._true, self._inner = self._inner, _ghost(self._inner)
                self._ghost_until_ns = now + min(GHOST_NS, fault.amount or GHOST_NS)
                return self._out(tell(data, now), now, is_ghost=True)
            case "twice":
                self._later(now + fault.amount, lambda at: _mute(tell(data, at)))
                return self._out(tell(data, now), now)
            case "that of the one before":
                self._tally.hits -= before == data
                return self._out(tell(before, now), now)
            case _:
                other = fault.how.removeprefix("that of ")
                return self._out(tell(self._form.with_kind(data, other), now), now)

    def _later(self, when: int, act: Callable[[int], list[Any]]) -> None:
        self._due.append((when, act))

    def _lay_ghost(self, now: int) -> None:
        """Let the device itself go on; what it has to say comes with the next wake-up."""
        self._inner, self._true = self._true, None
        if found := self._out(self._guarded(self._inner.wake, self._own(now)), now):
            self._later(now, lambda at: found)

    # --- what goes --------------------------------------------------------------------------------

    def _say(self, data: bytes, start_ns: int) -> list[Any]:
        if self._form.is_reply(data):
            self._tally.said += 1
            self._tally.unanswered = 0
        self._tally.wire = crc32(b"%d %b " % (start_ns, data), self._tally.wire)
        if self._is_on_bus:
            return [SendFrame(start_ns, _frame(data))]
        return [Transmit(start_ns, data)]

    def _out(self, effects: Iterable[Any], now: int, *, is_ghost: bool = False) -> list[Any]:
        """What the twin wants done, with the fault in it."""
        is_ghost |= self._true is not None
        found: list[Any] = []
        for effect in effects:
            if isinstance(effect, Transmit):
                start_ns = max(self._ours(effect.start_ns), now)
                found += self._reply(effect.data, start_ns, now)
            elif isinstance(effect, SendFrame):
                start_ns = max(self._ours(effect.start_ns), now)
                data = _packed(effect.frame)
                said = self._reply(data, start_ns, now)
                for one in said:
                    if one.frame != effect.frame:
                        self._sent[one.frame] = effect.frame
                if not said:
                    self._later(start_ns + BYTE_NS, partial(self.sent, effect.frame))
                found += said
            elif not is_ghost:
                found.append(effect)
        return found

    def _reply(self, data: bytes, start_ns: int, now: int) -> list[Any]:
        """What becomes of something said."""
        fault = self._fault
        kind = self._form.kind(data) or self._kind
        if fault.part not in ("byte of a reply", "value of an answer", "reply"):
            return self._say(data, start_ns)
        if not self._hits("reply", kind):
            return self._say(data, start_ns)
        if fault.part == "reply":
            self._tally.hits += 1
            return self._flow(kind, data, start_ns)
        if fault.part == "byte of a reply":
            wrong = self._byte(data)
        else:
            values = self._form.values(data)
            wrong = fault.changed(values)
            wrong = data if wrong == values else self._form.with_values(data, wrong)
        # What a frame has no room for never leaves.
        is_same = _frame(wrong) == _frame(data) if self._is_on_bus else wrong == data
        self._tally.hits += not is_same
        return self._say(wrong, start_ns)

    def _byte(self, data: bytes) -> bytes:
        fault = self._fault
        least = 2 if self._is_on_bus and fault.how in ("dropped", "doubled") else 0
        at = fault.at if fault.at >= 0 else len(data) + fault.at
        if not least <= at < len(data):
            return data
        match fault.how:
            case "dropped":
                return data[:at] + data[at + 1 :]
            case "doubled":
                return data[: at + 1] + data[at:]
            case "zero":
                return data[:at] + b"\0" + data[at + 1 :]
        flipped = data[:at] + bytes([data[at] ^ fault.amount]) + data[at + 1 :]
        return self._form.resummed(flipped) if fault.how.endswith("right") else flipped

    def _flow(self, kind: str, data: bytes, start_ns: int) -> list[Any]:
        fault, say = self._fault, self._say
        sort = f"{kind} {len(data)}"
        match fault.how:
            case "late":
                return say(data, start_ns + fault.amount)
            case "lost":
                return []
            case "twice":
                return say(data, start_ns) + say(data, start_ns + BYTE_NS)
            case "that of the one before":
                before = self._before.get(f"reply {sort}", data)
                self._before[f"reply {sort}"] = data
                self._tally.hits -= before == data
                return say(before, start_ns)
            case "always the first":
                first = self._first.setdefault(sort, data)
                self._tally.hits -= first == data
                return say(first, start_ns)
            case "cut short":
                return say(data[: -fault.amount], start_ns) if len(data) > fault.amount else []
            case "longer":
                if self._is_on_bus:  # a frame holds no more than 8 bytes
                    self._tally.hits -= _frame(data) == _frame(data + bytes(fault.amount))
                return say(data + bytes(fault.amount), start_ns)
            case "broken by a pause":
                half = len(data) // 2
                if not half:  # a lone character has no middle
                    self._tally.hits -= 1
                    return say(data, start_ns)
                if self._is_on_bus:
                    return say(data, start_ns + fault.amount)
                return say(data[:half], start_ns) + say(data[half:], start_ns + fault.amount)
            case "unasked too":
                self._later(start_ns + fault.amount, lambda at: say(data, at))
                return say(data, start_ns)
            case _:  # before the one that is due
                held, self._held = self._held, []
                if held:
                    return say(data, start_ns) + held
                self._held = say(data, start_ns)
                return []


def _ghost(device: Any) -> Any:
    """A copy of the device; a program in it that goes on step by step stands still there."""
    steps = getattr(getattr(device, "_runner", None), "_steps", None)
    return copy.deepcopy(device, {} if steps is None else {id(steps): None})


def _mute(effects: Iterable[Any]) -> list[Any]:
    return [one for one in effects if not isinstance(one, Transmit | SendFrame)]


def _packed(frame: CanFrame) -> bytes:
    return frame.identifier.to_bytes(4 if frame.is_extended else 2) + frame.data


def _frame(data: bytes) -> CanFrame:
    return CanFrame(int.from_bytes(data[:2]) & 0x7FF, data[2:10])


# --- faults inside --------------------------------------------------------------------------------

MODULES = {
    "mac23": ("axistwin.devices.mac.axis", "axistwin.devices.mac.serial", "axistwin.motion"),
    "mac23-can": ("axistwin.devices.mac.axis", "axistwin.devices.mac.can", "axistwin.motion"),
    "msc-250": ("axistwin.devices.msc",),
}
# What only a reader of the twin sees, and what is not of the device at all.
BESIDE = (
    "controls", "words", "decode", "describe", "snapshot", "quirks", "family", "traces", "models",
    "take_effects", "next_event", "quiet_prefix", "_text",
)  # fmt: skip


def functions(model: str) -> list[tuple[type, str, str]]:
    """Every method of the twin that gives a number, a truth, or nothing: owner, name, what."""
    found: list[tuple[type, str, str]] = []
    for package in MODULES[model]:
        root = import_module(package)
        for info in pkgutil.iter_modules(root.__path__, f"{package}."):
            if info.ispkg or any(word in info.name for word in BESIDE):
                continue
            for owner in vars(import_module(info.name)).values():
                if isinstance(owner, type) and owner.__module__ == info.name:
                    found += _methods(owner)
    return sorted(found, key=lambda one: (one[0].__module__, one[0].__qualname__, one[1]))


def _methods(owner: type) -> Iterator[tuple[type, str, str]]:
    for name, value in vars(owner).items():
        if not inspect.isfunction(value) or name.startswith("__"):
            continue
        gives = str(value.__annotations__.get("return", ""))
        kind = {"int": "number", "<class 'int'>": "number", "Nanos": "number", "bool": "truth",
                "<class 'bool'>": "truth", "None": "nothing"}.get(gives, "")  # fmt: skip
        if kind and not any(word in name for word in BESIDE):
            yield owner, name, kind


@contextlib.contextmanager
def planted(fault: Fault, model: str, tally: Tally) -> Iterator[str]:
    """Let every twin built in this process have the fault; gives where it is.

    Inside, a method that gives a number gives another one; one that gives a truth, the contrary;
    and one that gives nothing is not done.
    """
    with pytest.MonkeyPatch.context() as patch:
        if fault.part == "inside":
            known = functions(model)
            owner, name, kind = known[fault.at % len(known)]
            right = vars(owner)[name]
            _put(patch, owner, right, _wrong_method(right, kind, fault, tally))
            wrapped = Fault("none", "")
            place = f"{owner.__qualname__}.{name}"
        else:
            wrapped, place = fault, ""
        made = DeviceNetwork.__init__

        def making(self: Any, devices: Any, *given: Any) -> None:
            wrong = [WrongDevice(one, wrapped, FORMATS[model], tally) for one in devices]
            made(self, wrong, *given)

        value = DeviceAccess._value  # it has the twin itself

        def looking(self: Any, *given: Any) -> Any:
            return tally.within(value, self, *given)

        patch.setattr(DeviceNetwork, "__init__", making)
        patch.setattr(DeviceAccess, "_value", looking)
        forget()
        try:
            yield place
        finally:
            patch.undo()
            forget()


def _put(patch: pytest.MonkeyPatch, owner: type, right: Any, wrong: Any) -> None:
    """Replace a method, in the tables of the twins too."""

    def swapped(value: Any) -> Any:
        if isinstance(value, tuple) and type(value) is tuple:
            return tuple(swapped(one) for one in value)
        return wrong if value is right else value

    patch.setattr(owner, right.__name__, wrong)
    for path, module in list(sys.modules.items()):
        for name, table in list(vars(module).items()) if path.startswith("axistwin.") else ():
            if type(table) is tuple and (other := swapped(table)) != table:
                patch.setattr(module, name, other)
            for key, value in list(table.items()) if type(table) is dict else ():
                if (other := swapped(value)) != value:
                    patch.setitem(table, key, other)


def _wrong_method(
    method: Callable[..., Any], kind: str, fault: Fault, tally: Tally
) -> Callable[..., Any]:
    def wrong(*given: Any, **named: Any) -> Any:
        tally.asked += 1
        if not fault.when.is_due(tally.asked - 1):
            return method(*given, **named)
        if kind == "nothing":
            tally.hits += 1
            return None
        value = method(*given, **named)
        if kind == "truth":
            tally.hits += 1
            return not value
        other = CHANGES[fault.how](value, 64) if fault.how in CHANGES else 0
        tally.hits += other != value
        return other

    return wrong
