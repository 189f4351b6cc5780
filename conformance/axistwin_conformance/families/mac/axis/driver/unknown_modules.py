"""Who answers at an address that is neither this module's nor named with --neighbour: the module
itself, which is a fault, or another one that the operator has not told of, which is none."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.families.mac.axis.driver.client import AxisClient, quiet_s
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind

# What stays as it is while an axis is at rest; the release differs between versions.
AT_REST: Final = (0x20, 0x22, 0x23, 0x24, 0x25, 0x26)
Value = int | None


def unknown_module_at(client: AxisClient, address: int) -> str:
    """Ask who answers at an address that nobody has been said to have.

    A module that differs from the one under test is another one: the check ends as inconclusive,
    with the remedy.  One that is alike may be this one, and is a failure for the caller to tell;
    the text returned goes with it.  Empty if nobody answers there, and on the built-in twin's line,
    of which it is known who is there.
    """
    session = client.session
    own = {client.address, *session.neighbours}
    if client.target.is_builtin or address in own:
        return ""
    other = type(client)(session, address)
    if not any(_answer_of(other, AT_REST[0]) is not None for _ in range(RETRY.alike)):
        return ""
    for index in AT_REST:
        here, there = _in_turn(client, other, index)
        is_steady = len(here) == len(there) == 1 and None not in here | there
        if is_steady and here != there:
            session.inconclusive(
                None,
                f"another module answers at {address} ({client.named(index)} tells it from"
                f" {client.address}): name it (--neighbour {address}) or take it off the"
                f" {client.target.word}",
            )
    return (
        f"who answers at {address} is like {client.address} in all that can be asked at rest; if"
        f" another module is there, name it (--neighbour {address})"
    )


def _in_turn(first: AxisClient, second: AxisClient, index: int) -> tuple[set[Value], set[Value]]:
    """All that two modules say to a query, asked in turn."""
    here, there = {_answer_of(first, index)}, set[Value]()
    for _ in range(RETRY.alike):  # what changes between them, on either side, proves nothing
        there.add(_answer_of(second, index))
        here.add(_answer_of(first, index))
    return here, there


def _answer_of(module: AxisClient, index: int) -> Value:
    """What a module answers, under its own address; None without such an answer."""
    reply = module.send(module.request(index), quiet_s(module.target)).reply
    is_own = reply.kind is ReplyKind.ANSWER and module.is_answer(index, reply, in_any_reading=True)
    data: Value = reply.data
    return data if is_own else None
