"""What goes over the control API, as pydantic models: their descriptions are the schema's."""

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field

from axistwin.devices.controls import Kind
from axistwin.wire.wire_fault import (
    COUNT_MAX,
    DURATION_MS_MAX,
    DURATION_MS_MIN,
    PER_S_MAX,
    PER_S_MIN,
    TEXT_MAX,
    FaultDirection,
    FaultKind,
)

OFF_MAX_S = 20.0

Value: TypeAlias = bool | int | float | str | None
"""What a control is set to."""

Nanoseconds = Annotated[int, Field(description="time of the device's line, in nanoseconds")]
Direction: TypeAlias = Literal["host", "device"]
"""Who sent a message."""

DeviceName = Annotated[str, Field(description="name of the device, such as mac23:0")]


class Described(BaseModel):
    """Base of all: nothing that is not named here."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class EndpointInfo(Described):
    """Where programs find a line."""

    kind: str = Field(description="pty, tcp, slcan, ...")
    url: str = Field(description="what a program opens")


class LineInfo(Described):
    """A line, or a bus."""

    name: str = Field(description="name of the line: that of its first device")
    devices: list[str] = Field(description="names of the devices on it")
    endpoints: list[EndpointInfo] = Field(description="where programs find it")
    failure: str | None = Field(description="why it is not served any more; null while it is")


class LineList(Described):
    """All lines."""

    lines: list[LineInfo]


class AxesInfo(Described):
    """The axes of a device, to be drawn: the controls have one number, or one for each axis."""

    names: list[str]
    unit: str = Field(description="of positions; of rates, the same per second")
    position: str = Field(description="the control that has the positions")
    rate: str = Field(description="the control that has the rates")


class DeviceInfo(Described):
    """A device."""

    name: DeviceName
    model: str = Field(description="such as mac23; 'axistwin models' lists them")
    address: int = Field(description="the address at which it answers now")
    line: str = Field(description="name of its line")
    power: bool = Field(description="whether its supply is applied")
    state: str = Field(description="what it is doing now, in words")
    axes: AxesInfo | None = Field(description="null: it has none")


class DeviceList(Described):
    """All devices that are served."""

    devices: list[DeviceInfo]


class Numbers(Described):
    """Numbers that are keys: NAME.NUMBER is a control too."""

    first: int
    last: int


class BitInfo(Described):
    """One bit of a number."""

    bit: int = Field(description="0 for the lowest")
    name: str = Field(description="what it is called")
    requirement: str = Field(description="the requirement that tells of it, such as MACS-Q-21-01")


class ControlInfo(Described):
    """One thing that can be worked or seen of a device."""

    name: str = Field(description="such as inputs.reference")
    kind: Kind = Field(description="what a value is; an action of kind nothing takes null")
    doc: str = Field(description="what it is, in words")
    unit: str = Field(description="unit of a number; may be empty")
    low: float | None = Field(description="least number")
    high: float | None = Field(description="largest number")
    choices: list[str] = Field(description="allowed values of a choice")
    numbers: Numbers | None = Field(description="keys, of a control that stands for many values")
    bits: list[BitInfo] = Field(description="what the bits of a number mean; empty: they have none")
    queue: bool = Field(description="whether it tells how many commands wait")
    readable: bool = Field(description="whether it has a value")
    writable: bool = Field(description="whether it can be set")
    value: Any = Field(description="as it is now; null if it cannot be read, or has numbers")


class ControlList(Described):
    """The controls of a device, at one instant."""

    device: DeviceName
    time_ns: Nanoseconds
    controls: list[ControlInfo]


class ControlReading(ControlInfo):
    """One control, with the time at which it was read."""

    device: DeviceName
    time_ns: Nanoseconds


class ControlOrder(Described):
    """What a control is set to."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    value: Value = Field(None, description="the value; null for an action that takes nothing")


class ControlDone(Described):
    """A control was set, at a definite time of its line."""

    device: DeviceName
    control: str
    time_ns: Nanoseconds
    value: Any = Field(description="as it is then; null if it cannot be read")


class PowerOrder(Described):
    """What to do to the supply."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    action: Literal["on", "off", "cycle"] = Field(description="cycle: off, and on again")
    off_s: float = Field(
        0.0, ge=0.0, le=OFF_MAX_S, description="how long a cycle takes, in seconds of the line"
    )


class PowerDone(Described):
    """The supply was switched."""

    device: DeviceName
    power: bool = Field(description="whether it is applied now")
    off_time_ns: int | None = Field(description="when it was cut, of the line; null: it was not")
    on_time_ns: int | None = Field(description="when it was applied, of the line; null: it was not")


class StateInfo(Described):
    """All that can be seen of a device, at one instant."""

    device: DeviceName
    time_ns: Nanoseconds
    values: dict[str, Any] = Field(description="values by the names of controls")


class TrafficMessage(Described):
    """What went over a line or bus in one piece: bytes without a pause, or a frame."""

    time_ns: Nanoseconds
    direction: Direction = Field(description="who sent it: a host, or a device")
    hex: str = Field(description="its bytes, or the frame as candump writes it: 601#4000")
    text: str = Field(description="what it says; empty if nobody knows")
    unit: int | None = Field(description="address of the first device named in it; null: none is")


class TrafficList(Described):
    """The last messages of a line, oldest first."""

    line: str
    messages: list[TrafficMessage]


FaultNumber = Annotated[int, Field(ge=1, description="its number, from 1; never used again")]


class FaultOrder(Described):
    """A fault of the wire: what goes wrong, how often, and with which messages."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    kind: FaultKind = Field(description="what goes wrong; not every wire can have every one")
    direction: FaultDirection | None = Field(None, description="where the message goes; null: both")
    message: str = Field(
        "", max_length=TEXT_MAX, description="words of its meaning, as a transcript shows it"
    )
    hex: str = Field(
        "", max_length=TEXT_MAX, description="bytes in it, '..' for any; '581#' for an identifier"
    )
    count: int | None = Field(
        None, ge=1, le=COUNT_MAX, description="how many times; null: once, or without end by rate"
    )
    chance: float | None = Field(None, ge=0.0, le=1.0, description="rate: of each message")
    per_s: float | None = Field(
        None, ge=PER_S_MIN, le=PER_S_MAX, description="rate: times a second, by itself"
    )
    duration_ms: float | None = Field(
        None, ge=DURATION_MS_MIN, le=DURATION_MS_MAX, description="how long, of kinds that last"
    )


class FaultInfo(FaultOrder):
    """A fault of the wire, with what it has done so far."""

    number: FaultNumber
    line: str = Field(description="name of its line")
    seen: int = Field(description="messages that it could have acted on")
    acted: int = Field(description="how many times it did something")
    over: bool = Field(description="whether it has acted as often as it may")
    last_ns: Nanoseconds | None = Field(description="when it acted last; null: never")
    last: str = Field(description="what it did then")


class FaultList(Described):
    """Faults of a wire."""

    line: str
    faults: list[FaultInfo]


class Allowed(Described):
    """What a control takes."""

    kind: str
    unit: str
    low: float | None
    high: float | None
    choices: list[str]


class Problem(Described):
    """What went wrong, for programs and for people; of every error."""

    error: Literal[
        "bad_request",
        "unauthorized",
        "forbidden",
        "not_found",
        "method_not_allowed",
        "timeout",
        "too_large",
        "not_allowed",
        "unavailable",
        "bug",
    ] = Field(description="what kind of problem")
    message: str = Field(description="one line, with the remedy")
    allowed: Allowed | None = Field(None, description="what the control takes, of a wrong value")
