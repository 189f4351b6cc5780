"""What a run knows of the kind of device and of the one before it, beside what the wire shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from axistwin_conformance.transport.kinds import TransportKind


@dataclass(frozen=True, slots=True)
class Identity:
    """Who is there, as the probe found it: a line for people, named values for reports."""

    summary: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Model:
    """One model of a family.

    `facts`: what its checks must know of it (scalings, ranges).  `over`: the `Family` that judges
    it over each other kind of transport that it has, beside its family's own.  `weight_s`: the most
    seconds that a check of weight 1 takes of a sound device on a plain line.
    """

    name: str
    title: str
    facts: Any = None
    over: Mapping[TransportKind, Any] = field(default_factory=dict)
    weight_s: float = 0.8
