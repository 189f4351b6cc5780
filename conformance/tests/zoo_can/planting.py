"""The few ways in which a fault is planted into the CAN face of the twins of this process."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

from zoo.mutant import Any_, MonkeyPatch, mutant, wrap

from axistwin.devices.mac.can.device import MacCan
from axistwin.wire.can_frame import CanFrame

MODEL: Final = "mac23-can"
DOWNLOAD, UPLOAD, REFUSED = 0x23, 0x40, 0x80
LATENCY_NS: Final = 300_000  # of what a fault says of its own accord

can_mutant: Final = partial(mutant, model=MODEL)


def requests(patch: MonkeyPatch, act: Any_) -> None:
    """Let the module reply `act(serve, module, request)` to a request of 8 bytes; `serve(request)`
    is the reply as it should be, None is silence."""

    def make(serve: Any_) -> Any_:
        return lambda module, request: act(lambda r=request: serve(module, r), module, request)

    wrap(patch, MacCan, "_serve", make)


def replies(patch: MonkeyPatch, change: Any_) -> None:
    """Let the module reply `change(reply, request)` instead of each reply."""

    def act(serve: Any_, module: MacCan, request: bytes) -> bytes | None:
        reply = serve()
        return None if reply is None else bytes(change(reply, request))

    requests(patch, act)


def sends(patch: MonkeyPatch, act: Any_) -> None:
    """Let the module send by `act(send, module, identifier, data, start_ns)`; `send(identifier,
    data, start_ns)` sends as it should."""

    def make(send: Any_) -> Any_:
        def sending(module: MacCan, identifier: int, data: bytes, start_ns: int) -> Any:
            return act(partial(send, module), module, identifier, data, start_ns)

        return sending

    wrap(patch, MacCan, "_send", make)


def hears(patch: MonkeyPatch, takes: Any_, act: Any_) -> None:
    """Let the module hear frames of which `takes(module, frame)`, which it should not, and do
    `act(module, frame)` then, while it listens."""
    accepts, receive = MacCan.accepts, MacCan.receive

    def receiving(module: MacCan, frame: CanFrame, end_ns: int) -> Any:
        if accepts(module, frame) or not takes(module, frame):
            return receive(module, frame, end_ns)
        module._run_until(end_ns)
        if module._listens:
            module._now = end_ns
            act(module, frame)
        return module._settle(end_ns)

    patch.setattr(
        MacCan, "accepts", lambda module, frame: accepts(module, frame) or takes(module, frame)
    )
    patch.setattr(MacCan, "receive", receiving)


def around(patch: MonkeyPatch, name: str, act: Any_) -> None:
    """Let a method of the module be `act(go, module, *arguments)`; `go()` is the method as it
    should be, `go(*others)` with other arguments."""

    def make(method: Any_) -> Any_:
        def acting(module: MacCan, *arguments: Any, **named: Any) -> Any:
            def go(*others: Any) -> Any:
                return method(module, *(others or arguments), **named)

            return act(go, module, *arguments)

        return acting

    wrap(patch, MacCan, name, make)


def general_replies(patch: MonkeyPatch, change: Any_) -> None:
    """Let a general request be answered by `change(module, request, identifier, reply)`, which
    gives both; identifier None: not at all."""
    asked: list[bytes] = []

    def hear(go: Any_, _: MacCan, data: bytes) -> None:
        asked.append(data)
        go()
        asked.pop()

    def answer(go: Any_, module: MacCan, identifier: int | None, reply: bytes | None) -> None:
        if asked and reply is not None:
            go(*change(module, asked[-1], identifier, reply))
        else:
            go()

    around(patch, "_general_request", hear)
    around(patch, "_answer", answer)
