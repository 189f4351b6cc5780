"""What a check changes beside what is remembered of a device, it is given back on every way out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from axistwin_conformance.core.probing import Seen
from axistwin_conformance.core.session import Session

MOVE = "MACS-CMD-13-01"
GIVEN_BACK = "B"  # what is sent then


class Giver:
    """Gives back, unless something comes between; `befalls`: what, at which time."""

    def __init__(self, **befalls: Callable[[], None]) -> None:
        self.befalls = befalls
        self.times = 0

    def __call__(self, session: Session) -> bool:
        """Send it, as often as it takes."""
        self.times += 1
        self.befalls.get(f"at_{self.times}", bool)()
        session.target.send(GIVEN_BACK.encode())
        return session.target.receive(1, 0.01) == b"b"


def interrupted() -> None:
    """Ctrl-C."""
    raise KeyboardInterrupt


def run(toy: Any, giver: Giver, within: Callable[[Session], None]) -> Any:
    """A run of one check that does that while it owes something."""

    def away(session: Session) -> None:
        with session.restore_on_exit("address 00h", lambda: giver(session)):
            within(session)

    toy.add(away, MOVE, safety=("motion", "stored"))
    return toy.run()


def fine(session: Session) -> None:
    """A check that holds."""
    session.expect(True, None, "", "")


def wrong(session: Session) -> None:
    """A check that fails."""
    session.expect(False, None, "z", "q")


@pytest.mark.parametrize(("within", "status"), [(fine, 0), (wrong, 1)])
def test_the_check_itself_gives_back(toy: Any, within: Any, status: int) -> None:
    """At the end of the block, once, whether it held or failed; then the device is stopped."""
    giver = Giver()
    result = run(toy, giver, within)
    assert (result.exit_status, result.problems, giver.times) == (status, [], 1)
    assert toy.port.sent.index(GIVEN_BACK) < toy.port.sent.index("S")


def test_interrupted_the_keeper_gives_back_before_it_stops(toy: Any) -> None:
    """A device that is elsewhere would not hear the stop."""
    giver = Giver()
    result = run(toy, giver, lambda session: interrupted())
    assert (result.exit_status, result.problems, giver.times) == (130, [], 1)
    assert toy.port.sent.index(GIVEN_BACK) < toy.port.sent.index("S")


def test_interrupted_while_it_gives_back_the_keeper_does_it_again(toy: Any) -> None:
    """What was begun may have done half."""
    giver = Giver(at_1=interrupted)
    result = run(toy, giver, fine)
    assert (result.exit_status, result.problems, giver.times) == (130, [], 2)


def test_what_does_not_work_is_tried_again_and_then_told(toy: Any) -> None:
    """The keeper, who has released the rig before, tries once; what is lost is named."""

    def mute() -> None:
        toy.port.is_mute = True

    def loud() -> None:
        toy.port.is_mute = False

    giver = Giver(at_1=mute, at_2=loud)
    assert run(toy, giver, fine).problems == []
    assert giver.times == 2
    toy.port.is_mute = False
    giver = Giver(at_1=mute)
    result = run(toy, giver, fine)
    assert "not put back: address 00h" in result.problems
    assert giver.times == 2
    assert result.exit_status != 0


def test_of_several_the_last_is_given_back_first(toy: Any) -> None:
    """Each may need the one it was made within."""
    order: list[str] = []

    def back(name: str) -> bool:
        order.append(name)
        return True

    def away(session: Session) -> None:
        with (
            session.restore_on_exit("one", lambda: back("one")),
            session.restore_on_exit("two", lambda: back("two")),
        ):
            interrupted()

    toy.add(away, MOVE, safety=("motion",))
    assert toy.run().exit_status == 130
    assert order == ["two", "one"]


def test_a_probe_gives_back_before_the_next_one_asks(toy: Any) -> None:
    """One that could not give back by itself is helped at once."""
    tries: list[str] = []

    def in_vain() -> bool:
        tries.append("once more")
        return False

    def owing(session: Session) -> Seen:
        with session.restore_on_exit("address 00h", in_vain):
            return Seen(("1Ah",), "as asked")

    def next_one(session: Session) -> Seen:
        assert session.run.cleanups == []
        tries.append("the next one")
        return Seen((), "nothing")

    toy.probe("xon_byte", owing, ("motion",))
    toy.probe("abort_flush", next_one)
    toy.add(fine, MOVE, safety=("motion",))
    result = toy.run()
    assert tries == ["once more", "once more", "the next one"]
    assert result.problems == ["not put back: address 00h"]


def test_the_reply_to_what_was_interrupted_is_not_taken_for_another(real_toy: Any) -> None:
    """It may come when the stop has been sent; then each reply would be read one request late."""
    port, held = real_toy.port, [b"q"]  # what is still on its way
    write, read = port.write, port.read

    def write_late(data: bytes) -> int:
        count: int = write(data)
        if held and GIVEN_BACK in port.sent:
            held.append(port._answers)
            port._answers = held.pop(0)
        return count

    def read_late(size: int = 1) -> bytes:
        taken: bytes = read(size)
        if not taken and GIVEN_BACK in port.sent:  # now it has come
            port._answers = b"".join(held)
            held.clear()
        return taken

    def interrupted_amid(session: Session) -> None:
        session.target.send(GIVEN_BACK.encode())
        session.target.drain()
        interrupted()

    port.write, port.read = write_late, read_late
    real_toy.add(interrupted_amid, MOVE, safety=("motion", "stored"))
    result = real_toy.run()
    assert (result.exit_status, result.problems) == (130, [])
