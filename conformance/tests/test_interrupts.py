"""Signals that end a run are heard wherever they come."""

from __future__ import annotations

import gc
import importlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from axistwin_conformance.base import interrupts

pytestmark = pytest.mark.system

ENDING = pytest.mark.parametrize("number", interrupts.ENDING, ids=lambda one: one.name)


def soon(number: signal.Signals) -> None:
    """Send this process the signal; its handler runs before this returns."""
    os.kill(os.getpid(), number)
    for _ in range(100):
        pass


def is_interrupted_by(act: Callable[[], object]) -> bool:
    """Whether that is followed, soon, by an interrupt."""
    deadline = time.monotonic() + 30
    try:
        act()
        while time.monotonic() < deadline:
            # As a run does now and then; a signal that comes amid a collection in C may otherwise
            # be seen by Python only much later.
            time.sleep(0.001)
    except KeyboardInterrupt:
        return True
    return False


@ENDING
def test_each_of_them_interrupts(number: signal.Signals) -> None:
    """As Ctrl-C does."""
    before = signal.getsignal(number)
    with interrupts.heeded():
        assert is_interrupted_by(lambda: soon(number))
    assert signal.getsignal(number) is before


@ENDING
def test_one_amid_a_collection_of_garbage_is_not_lost(number: signal.Signals) -> None:
    """What is raised in a callback of the collector is dropped by Python."""

    def callback(phase: str, _: object) -> None:
        if phase == "start":
            soon(number)

    gc.callbacks.append(callback)
    try:
        with interrupts.heeded():
            assert is_interrupted_by(gc.collect)
    finally:
        gc.callbacks.remove(callback)


@ENDING
def test_one_amid_what_a_collection_finalises_is_not_lost(number: signal.Signals) -> None:
    """A generator that is collected runs its last words, and what they raise is dropped."""

    def speaking(own: list[object]) -> Iterator[None]:
        try:
            yield
        finally:
            soon(number)

    def leave_behind() -> None:
        own: list[object] = []
        one = speaking(own)
        next(one)
        own.append(one)

    with interrupts.heeded():
        leave_behind()
        assert is_interrupted_by(gc.collect)


@ENDING
def test_one_amid_a_finaliser_is_not_lost(number: signal.Signals) -> None:
    """Nor in `__del__`, however deep."""

    class Fleeting:
        def __del__(self) -> None:
            soon(number)

    with interrupts.heeded():
        assert is_interrupted_by(Fleeting)


def test_what_is_ignored_stays_ignored() -> None:
    """nohup is heeded."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interrupts.heeded():
            soon(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


@ENDING
def test_while_a_device_is_made_safe_none_is_heard(number: signal.Signals) -> None:
    """Afterwards they are again."""
    with interrupts.heeded():
        with interrupts.held_back():
            soon(number)
        assert is_interrupted_by(lambda: soon(number))


@ENDING
def test_an_interrupt_of_a_clean_up_hurries_it_and_then_cuts_it_short(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At once the axis is not driven any further; soon nothing is done any more."""
    monkeypatch.setattr(interrupts, "GRACE_S", 0.5)
    sent_s: list[float] = []
    hurries_s: list[float] = []

    def interrupt() -> None:
        sent_s.append(time.monotonic())
        os.kill(os.getpid(), number)

    with interrupts.heeded(), interrupts.held_back():
        threading.Timer(0.4, interrupt).start()
        limit_s = time.monotonic() + 60
        while time.monotonic() < limit_s:
            if interrupts.is_hurried():
                hurries_s.append(time.monotonic())
    ends_s = time.monotonic()
    assert sent_s[0] <= hurries_s[0]
    assert sent_s[0] + 0.5 <= ends_s < limit_s
    assert not interrupts.is_hurried()
    assert not interrupts.is_held_back()


def test_an_interrupt_while_a_module_is_imported_is_no_mistake_of_the_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python 3.11 turns what a descriptor's __set_name__ raises into a RuntimeError."""
    (tmp_path / "interrupted_module.py").write_text(
        "import os, signal, time\n"
        "class Name:\n"
        "    def __set_name__(self, owner, name):\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        for _ in range(1000): pass\n"
        "class Owner:\n"
        "    field = Name()\n"
        "is_whole = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with interrupts.heeded():
        assert is_interrupted_by(lambda: importlib.import_module("interrupted_module"))
    assert sys.modules.pop("interrupted_module").is_whole
