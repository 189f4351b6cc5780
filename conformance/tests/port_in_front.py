"""A port in front of the built-in twin's: what stands between suite and twin in tests."""

from __future__ import annotations

from typing import Any


class PortInFront:
    """Hands on what a `SerialTransport` asks of `port` beside reading and writing."""

    def __init__(self, port: Any) -> None:
        self.port = port
        self.timeout: float | None = 0.0

    @property
    def virtual_time_ns(self) -> int:
        """The twin's clock."""
        return int(self.port.virtual_time_ns)

    @property
    def twins(self) -> Any:
        """The twins behind it."""
        return self.port.twins

    @property
    def baudrate(self) -> int:
        """The rate of our end."""
        return int(self.port.baudrate)

    @baudrate.setter
    def baudrate(self, rate: int) -> None:
        self.port.baudrate = rate
