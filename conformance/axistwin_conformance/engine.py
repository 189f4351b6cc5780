"""The engine: plans a run, runs it safely, and says what it means."""

from __future__ import annotations

from axistwin_conformance.session import Envelope, Session

__all__ = ["Envelope", "Session"]
