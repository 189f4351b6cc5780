"""What every device offers to whoever drives it: on a serial line, on a CAN bus.

The driver calls with the time; the device returns effects and says when it wants to be woken.
Calls arrive in the order of time.  A device never looks at anything but its arguments.
"""

from collections.abc import Mapping
from typing import Any, Protocol

from axistwin.devices.snapshot import Snapshot
from axistwin.kernel.effects import Effect
from axistwin.kernel.time import Nanos
from axistwin.motion.plant import Load
from axistwin.wire.can_frame import CanFrame
from axistwin.wire.framing import Chunk, LineFormat


class Device(Protocol):
    """What is told the time, can be switched off, and remembers."""

    def next_event(self) -> Nanos | None:
        """When the device next wants ``wake``, or None."""

    def wake(self, now: Nanos) -> list[Effect]:
        """Do what is due at ``now``."""

    def power_off(self, now: Nanos) -> list[Effect]:
        """Cut the supply: everything volatile is gone, nothing more is sent or heard."""

    def power_on(self, now: Nanos) -> list[Effect]:
        """Apply the supply: start up from the nonvolatile cells."""

    def cells(self, now: Nanos) -> Mapping[str, int]:
        """All nonvolatile cells with their values at ``now`` (a moving axis' position included)."""

    def is_moving(self, now: Nanos) -> bool:
        """Whether cells change by themselves as time passes (the axis moves)."""


class SerialDevice(Device, Protocol):
    """A device with a UART."""

    @property
    def line_format(self) -> LineFormat:
        """Rate and framing that the UART uses now, in both directions."""

    @property
    def is_full_duplex(self) -> bool:
        """Whether each direction has wires of its own, so that both ends may send at a time."""

    def quiet_prefix(self, data: bytes) -> int:
        """How many leading bytes of ``data`` surely cause no effect, whatever follows.

        Lets the line hand over long stretches at once: the device will not react before the byte
        after that prefix.  0 is always a correct answer.
        """

    def receive(self, chunk: Chunk) -> list[Effect]:
        """Take the bytes of ``chunk``; byte i counts as heard at ``chunk.arrival_ns(i)``.

        At most the last byte of a chunk causes effects (the line keeps to ``quiet_prefix``).
        """


class CanDevice(Device, Protocol):
    """A device with a CAN controller."""

    def accepts(self, frame: CanFrame) -> bool:
        """Whether ``frame`` may have an effect here; False spares the call of ``receive``."""

    def receive(self, frame: CanFrame, end_ns: Nanos) -> list[Effect]:
        """Take a frame of another station, complete at ``end_ns``."""

    def sent(self, frame: CanFrame, end_ns: Nanos) -> list[Effect]:
        """Learn that ``frame``, a ``SendFrame`` of this device, was on the bus until ``end_ns``."""


class TwinDevice(Device, Protocol):
    """What a user can have a handle on; see ``runtime/twin.py``."""

    def describe(self, now: Nanos) -> Snapshot:
        """Everything worth showing; at least ``address`` and ``state_text``."""


class MotionDevice(TwinDevice, Protocol):
    """A device that turns a shaft, with the pins and the surroundings of one."""

    def set_input(self, now: Nanos, name: str, active: bool) -> list[Effect]:
        """Tie an input to ground (``active``) or open it.  Raises UsageError for unknown names."""

    def set_supply(self, now: Nanos, millivolts: int) -> list[Effect]:
        """Change the voltage of the supply, millivolts."""

    def set_temperature(self, now: Nanos, millidegrees: int) -> list[Effect]:
        """Change the temperature of the electronics, thousandths of a degree Celsius."""

    def set_load(self, now: Nanos, load: Load) -> list[Effect]:
        """Change what is coupled to the shaft."""

    def set_fault(self, now: Nanos, name: str, present: bool) -> list[Effect]:
        """Let a fault that is not measured be there or gone.  Raises UsageError for other names."""

    def push(self, now: Nanos, increments: int) -> list[Effect]:
        """Turn the shaft by hand, by signed ``increments``."""

    def position_at(self, now: Nanos) -> int:
        """Where the axis is, in increments."""

    def describe(self, now: Nanos) -> Snapshot:
        """Everything worth showing.

        At least ``address``, ``state_text``, ``supply_millivolts``, ``temperature_millidegrees``.
        """

    def input_at(self, now: Nanos, name: str) -> bool:
        """Whether an input is tied to ground."""

    def load_at(self, now: Nanos) -> Load:
        """What is coupled to the shaft."""


class ControllerDevice(TwinDevice, Protocol):
    """A device with flags, variables and a status word, in which a user's program runs."""

    def describe(self, now: Nanos) -> Snapshot:
        """Everything worth showing.

        At least ``address``, ``state_text``, ``battery``, ``program_error``, ``program_names``.
        """

    def flag_at(self, now: Nanos, number: int) -> bool:
        """Whether a flag is on, of any kind.  Raises UsageError for a number that is none."""

    def set_flag(self, now: Nanos, number: int, on: bool) -> list[Effect]:
        """Turn a flag of any kind on or off, as the machine or a hand does.  Raises UsageError."""

    def variable_at(self, now: Nanos, address: int) -> int:
        """The signed 32-bit value at ``address``.  Raises UsageError outside the data area."""

    def set_variable(self, now: Nanos, address: int, value: int) -> list[Effect]:
        """Store a signed 32-bit ``value`` at ``address``.  Raises UsageError out of range."""

    def status_at(self, now: Nanos) -> int:
        """The status word; looking at it changes nothing."""

    def set_status(self, now: Nanos, bit: int, on: bool) -> list[Effect]:
        """Let the condition of a status bit, 0..15, be there or gone.  Raises UsageError."""

    def status_bit_at(self, now: Nanos, bit: int) -> bool:
        """Whether a bit of the status word, 0..15, is on."""

    def program_at(self, now: Nanos) -> Any:
        """The program's object as it runs, or ran last; None before its first start."""

    def load_program(self, now: Nanos, program: Any) -> list[Effect]:
        """Put a program (``axistwin.macroprogram``) in, or with None take it out.

        It does not run yet.  Raises UsageError if it does not fit the device.
        """

    def start_program(self, now: Nanos) -> list[Effect]:
        """Start the program from its beginning.  Raises UsageError if there is none."""

    def stop_program(self, now: Nanos) -> list[Effect]:
        """Stop the program; flags, outputs and data stay as they are."""

    def clear_program(self, now: Nanos) -> list[Effect]:
        """Reset the system and clear the program, with the data."""

    def set_battery(self, now: Nanos, level: str) -> list[Effect]:
        """Let the memory's battery be ``good``, ``low`` or ``flat``.  Raises UsageError."""


class MotionSerialDevice(MotionDevice, SerialDevice, Protocol):
    """A device that turns a shaft, on a serial line."""


class MotionCanDevice(MotionDevice, CanDevice, Protocol):
    """A device that turns a shaft, on a CAN bus."""


class ControllerSerialDevice(ControllerDevice, SerialDevice, Protocol):
    """A controller with a program in it, on a serial line."""
