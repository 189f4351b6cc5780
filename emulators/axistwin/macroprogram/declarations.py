"""What a program names: flags by number, variables and arrays by address."""

from collections.abc import Iterator, Sequence
from typing import ClassVar, Final, Generic, Self, TypeVar, overload

from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_MS
from axistwin.macroprogram.scan import Condition, ProgramError, Scan, ScannedProgram, wrapped

FLAGS: Final = 256
ADDRESSES: Final = 0x10000

# -- flags --------------------------------------------------------------------------------------


class _Edge(Condition):
    """A change of a flag from the previous scan to this one."""

    __slots__ = ("_mask", "_scan", "_to_on")

    def __init__(self, scan: Scan, mask: int, to_on: bool) -> None:
        self._scan, self._mask, self._to_on = scan, mask, to_on

    def holds(self) -> bool:
        scan = self._scan
        is_on = scan.flags & self._mask
        return bool(is_on != scan.flags_before & self._mask and bool(is_on) is self._to_on)


class FlagInUse(Condition):
    """A flag as a running program has it; as a condition it holds while the flag is on."""

    __slots__ = ("_mask", "_scan", "number")

    def __init__(self, scan: Scan, number: int) -> None:
        self.number = number
        self._scan = scan
        self._mask = 1 << number

    def __repr__(self) -> str:
        return f"<flag {self.number} {'on' if self.holds() else 'off'}>"

    def holds(self) -> bool:
        """Whether it is on."""
        return bool(self._scan.flags & self._mask)

    @property
    def rise(self) -> Condition:
        """It is on, and was off in the previous scan."""
        return _Edge(self._scan, self._mask, to_on=True)

    @property
    def fall(self) -> Condition:
        """It is off, and was on in the previous scan."""
        return _Edge(self._scan, self._mask, to_on=False)

    def set(self) -> None:
        """Turn it on at the end of the scan; the same as assigning True."""
        self._scan.new_flags[self.number] = True

    def clear(self) -> None:
        """Turn it off at the end of the scan; the same as assigning False."""
        self._scan.new_flags[self.number] = False


class TimerInUse(FlagInUse):
    """A timer as a running program has it: its flag is on while it runs.

    On a unit with the quirk ``timer_flag=expired`` the flag is on when the time is over instead;
    ``expired`` means the same on both.
    """

    __slots__ = ()

    def start(self, duration_ms: float) -> None:
        """Let it run for ``duration_ms`` (> 0) from now, anew if it runs.  Raises ProgramError."""
        if not 0 < duration_ms < 1e12:
            raise ProgramError(f"a timer cannot run for {duration_ms} ms; give more than 0")
        scan = self._scan
        scan.new_timers[self.number] = scan.now_ns + round(duration_ms * NS_PER_MS)

    def stop(self) -> None:
        """Let it run no more; it does not expire."""
        self._scan.new_timers[self.number] = None

    @property
    def expired(self) -> Condition:
        """Its time ran out since the previous scan."""
        return _Expired(self._scan, self._mask)

    def set(self) -> None:
        """Not for a timer.  Raises ProgramError."""
        raise ProgramError(f"timer {self.number} is started, not set: use start(duration_ms)")

    def clear(self) -> None:
        """Not for a timer.  Raises ProgramError."""
        raise ProgramError(f"timer {self.number} is stopped, not cleared: use stop()")


class _Expired(Condition):
    __slots__ = ("_mask", "_scan")

    def __init__(self, scan: Scan, mask: int) -> None:
        self._scan, self._mask = scan, mask

    def holds(self) -> bool:
        return bool(self._scan.expired & self._mask)


_Flag = TypeVar("_Flag", bound=FlagInUse)


class FlagDeclaration(Generic[_Flag]):
    """A flag by its number, 0..255, as an attribute of a program.  Raises UsageError."""

    kind: ClassVar[str]
    """What the controller's flag map has to call it."""

    _in_use: type[_Flag]

    def __init__(self, number: int) -> None:
        self.number = _checked_number(f"{type(self).__name__}", number, FLAGS)
        self.name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, program: None, owner: type) -> Self: ...
    @overload
    def __get__(self, program: ScannedProgram, owner: type) -> _Flag: ...
    def __get__(self, program: ScannedProgram | None, owner: type) -> "Self | _Flag":
        if program is None:
            return self
        known = program._in_use
        if self.name not in known:
            known[self.name] = self._in_use(program._scan, self.number)
        return known[self.name]  # type: ignore[no-any-return]  # it holds all kinds

    def __set__(self, program: ScannedProgram, on: object) -> None:
        flag = self.__get__(program, type(program))
        if on:
            flag.set()
        else:
            flag.clear()


class Input(FlagDeclaration[FlagInUse]):
    """An input: the machine's, or a model of the machine, turns it on and off."""

    kind = "input"
    _in_use = FlagInUse


class Output(FlagDeclaration[FlagInUse]):
    """An output, which the host may set too."""

    kind = "output"
    _in_use = FlagInUse


class Timer(FlagDeclaration[TimerInUse]):
    """A timer; see ``TimerInUse``."""

    kind = "timer"
    _in_use = TimerInUse


class MotorStatus(FlagDeclaration[FlagInUse]):
    """A flag that tells of a motor."""

    kind = "motor"
    _in_use = FlagInUse


class UserFlag(FlagDeclaration[FlagInUse]):
    """A flag between host and program."""

    kind = "user"
    _in_use = FlagInUse


# -- data ---------------------------------------------------------------------------------------


class Variable:
    """The signed 32-bit value at an address, as an attribute of a program: an ``int``.

    initial: what it has when the program is loaded into a memory that holds nothing there yet.
    Raises UsageError.
    """

    def __init__(self, address: int, initial: int | None = None) -> None:
        self.address = _checked_number("Variable", address, ADDRESSES)
        self.initial = () if initial is None else (_checked_value(self.address, initial),)
        self.name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, program: None, owner: type) -> Self: ...
    @overload
    def __get__(self, program: ScannedProgram, owner: type) -> int: ...
    def __get__(self, program: ScannedProgram | None, owner: type) -> "Self | int":
        return self if program is None else program._scan.read(self.address)

    def __set__(self, program: ScannedProgram, value: int) -> None:
        program._scan.new_data[self.address] = _whole(self.name, value)


class ScanCount(Variable):
    """A variable to which the controller itself adds 1 in every scan; the program only reads it.

    So a program that counts its scans can wait, and need not be run in each of them.
    """

    def __set__(self, program: ScannedProgram, value: int) -> None:
        raise ProgramError(f"{self.name} = {value!r}: the controller counts its scans there")


class ArrayInUse(Sequence[int]):
    """An array as a running program has it: a sequence of ``int`` whose elements can be set."""

    __slots__ = ("_scan", "address", "name", "size")

    def __init__(self, scan: Scan, name: str, address: int, size: int) -> None:
        self._scan = scan
        self.name = name
        self.address = address
        self.size = size

    def __len__(self) -> int:
        return self.size

    @overload
    def __getitem__(self, index: int) -> int: ...
    @overload
    def __getitem__(self, index: slice) -> list[int]: ...
    def __getitem__(self, index: int | slice) -> int | list[int]:
        scan = self._scan
        if isinstance(index, slice):
            places = range(self.size)[index]
            return [scan.read(self.address + place * scan.stride) for place in places]
        return scan.read(self._address_of(index))

    def __setitem__(self, index: int, value: int) -> None:
        self._scan.new_data[self._address_of(index)] = _whole(f"{self.name}[{index}]", value)

    def __iter__(self) -> Iterator[int]:
        return iter(self[:])

    def _address_of(self, index: int) -> int:
        if not -self.size <= index < self.size:
            raise ProgramError(
                f"{self.name}[{index}]: its elements are 0..{self.size - 1} or, from the end, "
                f"-1..{-self.size}"
            )
        return self.address + index % self.size * self._scan.stride


class Array:
    """``size`` values (>= 1) from an address on, as an attribute of a program.

    Neighbours are as far apart as the unit has it (quirk ``data_address_stride``, 4).
    initial: its first values when the program is loaded into a memory that holds nothing there yet.
    Raises UsageError.
    """

    def __init__(self, address: int, size: int, initial: Sequence[int] = ()) -> None:
        self.address = _checked_number("Array", address, ADDRESSES)
        if type(size) is not int or not 1 <= size <= ADDRESSES:
            raise UsageError(f"Array({address}, {size!r}): its size is a whole number, 1 or more")
        if len(initial) > size:
            raise UsageError(
                f"Array({address}, {size}): {len(initial)} initial values are too many"
            )
        self.size = size
        self.initial = tuple(_checked_value(address, value) for value in initial)
        self.name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, program: None, owner: type) -> Self: ...
    @overload
    def __get__(self, program: ScannedProgram, owner: type) -> ArrayInUse: ...
    def __get__(self, program: ScannedProgram | None, owner: type) -> "Self | ArrayInUse":
        if program is None:
            return self
        known = program._in_use
        if self.name not in known:
            known[self.name] = ArrayInUse(program._scan, self.name, self.address, self.size)
        return known[self.name]  # type: ignore[no-any-return]  # it holds all kinds

    def __set__(self, program: ScannedProgram, values: Sequence[int]) -> None:
        array = self.__get__(program, type(program))
        if len(values) != self.size:
            raise ProgramError(f"{self.name} has {self.size} elements, not {len(values)}")
        for index, value in enumerate(values):
            array[index] = value


# -- checks -------------------------------------------------------------------------------------


def _checked_number(what: str, number: object, limit: int) -> int:
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < limit:
        raise UsageError(f"{what}({number!r}) is not allowed; give a whole number, 0..{limit - 1}")
    return number


def _checked_value(address: int, value: object) -> int:
    if isinstance(value, int) and not isinstance(value, bool) and wrapped(value) == value:
        return value
    raise UsageError(
        f"initial value {value!r} of address {address} is not allowed; give a whole number, "
        f"{-(1 << 31)}..{(1 << 31) - 1}"
    )


def _whole(name: str, value: object) -> int:
    if not isinstance(value, int):
        raise ProgramError(f"{name} = {value!r}: a variable takes whole numbers; round it first")
    return wrapped(value)
