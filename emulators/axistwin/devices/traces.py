"""What devices of more than one family tell of themselves; a family adds its own.

A trace changes nothing: it is for whoever looks on.
"""

from dataclasses import dataclass, field

from axistwin.kernel.effects import Trace


@dataclass(frozen=True, slots=True)
class StateChanged(Trace):
    """The device is in another ``state``, in the words or the code of its family."""

    state: str
    text: str = field(default="", compare=False)

    def __str__(self) -> str:
        return self.text or self.state


@dataclass(frozen=True, slots=True)
class Refused(Trace):
    """The device refused what it was asked; ``reason`` in one sentence."""

    reason: str

    def __str__(self) -> str:
        return self.reason


@dataclass(frozen=True, slots=True)
class ReportReady(Trace):
    """The device has an IN report on USB for its host; ``content`` is without the padding."""

    content: bytes

    def __str__(self) -> str:
        return f"USB < {report_text(self.content)}"


def report_text(content: bytes) -> str:
    """What a report holds, as far as it is text, else in hex; without the nulls at its end."""
    told = content.rstrip(b"\0")
    is_text = told.isascii() and told.decode("latin-1").isprintable()
    return told.decode("ascii") if is_text else told.hex(" ").upper()
