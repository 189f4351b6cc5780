"""Any frames: a MAC23 on CAN survives them and says nothing that the ledger does not admit."""

import random

import pytest
from mac_bench import MS, S

from axistwin.devices.mac.can.device import MacCan
from axistwin.kernel.effects import Effect, SendFrame, Store, Trace
from axistwin.wire.can_frame import CanFrame

pytestmark = pytest.mark.strength

FRAME_NS = 250_000
ZEROS = bytes(4)
DOWNLOADS = (*range(0x20), 0x20, 0xFF)
MOTIONS = (0x13, 0x14, 0x15, 0x16, 0x18, 0x1E, 0x10, 0x11)


def request(chance: random.Random) -> bytes:
    """Mostly a proper request; any byte may be another one."""
    command = chance.choice((0x23, 0x23, 0x23, 0x40, 0x40, chance.randrange(256)))
    index = chance.choice((chance.choice(DOWNLOADS), chance.choice(MOTIONS), chance.randrange(16)))
    if index in (0, 1) and chance.random() < 0.9:
        index = 0x0C  # restarts are many even so
    high = 0x20 if chance.random() < 0.97 else chance.randrange(256)
    sub_index = 0 if chance.random() < 0.9 else chance.randrange(256)
    value = chance.choice((0, 1, 9, 0x320, 0x00F60320, chance.getrandbits(32)))
    return bytes((command, index, high, sub_index)) + value.to_bytes(4, "big")


def random_frame(chance: random.Random, address: int) -> CanFrame:
    """Identifiers that mean something more often than others; lengths and kinds of all sorts."""
    kind = chance.random()
    if kind < 0.6:
        return CanFrame(chance.choice((0x600 + address, 0x600 + address, 0x600)), request(chance))
    if kind < 0.7:
        head = chance.choice((b"\4\1", b"\x11\5", b"\x11\x80", b"\4\0", chance.randbytes(2)))
        return CanFrame(0x7E5, head + bytes(chance.choice((0, 5, 6))))
    if kind < 0.8:
        return CanFrame(0x080, chance.randbytes(chance.choice((0, 0, 1, 8))))
    identifier = chance.choice((0x600 + address, 0x600, chance.randrange(0x7F0)))
    if kind < 0.84:
        return CanFrame(identifier, is_remote=True, length=chance.randrange(9))
    if kind < 0.88:
        return CanFrame(chance.getrandbits(29), request(chance), is_extended=True)
    return CanFrame(identifier, chance.randbytes(chance.randrange(9)))


class Ledger:
    """What may come of a frame, from the ledger alone: it knows address, mode, and who is deaf."""

    def __init__(self, device: MacCan) -> None:
        self.device = device
        self.configures = False
        self.last_ns = 0

    def judge(self, frame: CanFrame, sent: list[SendFrame[CanFrame]], now: int) -> None:
        """At most the one reply that ``frame``, complete at ``now``, may have."""
        replies = [each for each in sent if not self.is_spontaneous(each.frame)]
        assert len(replies) <= 1, (frame, replies)
        for start_ns, reply in replies:
            assert start_ns == now + MS
            assert not frame.is_extended
            assert not frame.is_remote
            if reply.identifier == 0x7E4:
                assert frame.identifier == 0x7E5
                assert self.configures
                self.judge_lmt(frame.data, reply.data)
            else:
                self.judge_sdo(frame, reply)
        if frame.identifier == 0x7E5 and not frame.is_extended and not frame.is_remote:
            self.configures = frame.data[:2] == b"\4\1" or (
                self.configures and frame.data[:2] != b"\4\0"
            )

    def is_spontaneous(self, frame: CanFrame) -> bool:
        """Boot-up, emergency, lifebeat."""
        if 0x700 < frame.identifier < 0x780:
            assert frame.data == b"\0"
            self.configures = False
            return True
        if 0x080 < frame.identifier < 0x100:
            assert len(frame.data) == 8
            assert frame.data[7] == 0
            return True
        return False

    @staticmethod
    def judge_lmt(asked: bytes, reply: bytes) -> None:
        """Only 11 is answered."""
        assert asked[0] == 0x11
        assert reply == bytes((0x11, 0 if 1 <= asked[1] <= 127 else 1)) + bytes(6)

    def judge_sdo(self, frame: CanFrame, reply: CanFrame) -> None:
        """The four forms; module 1 alone answers the general message."""
        asked, got, address = frame.data, reply.data, self.device.address
        general = frame.identifier == 0x600
        assert frame.identifier == 0x600 + address or (general and address == 1)
        assert reply.identifier == 0x580 + address
        assert len(asked) == len(got) == 8
        assert got[1:4] == asked[1:4]
        if got[0] == 0x42:
            assert asked[0] == 0x40
            assert asked[2] == 0x20
            assert asked[1] < 8
            return
        assert got[4:] == ZEROS
        assert got[0] == 0x80 or (got[0] == 0x60 and asked[0] == 0x23 and asked[2] == 0x20)


def let_pass(device: MacCan, until: int, leaving: list[tuple[int, CanFrame]]) -> list[Effect]:
    """Wake the device, and let its frames leave, until then."""
    effects: list[Effect] = []
    while True:
        due = device.next_event()
        if leaving and leaving[0][0] <= min(until, until if due is None else due):
            end_ns, frame = leaving.pop(0)
            new = device.sent(frame, end_ns)
        elif due is not None and due <= until:
            new = device.wake(due)
        else:
            return effects
        effects += new
        leave(new, leaving)


def leave(effects: list[Effect], leaving: list[tuple[int, CanFrame]]) -> None:
    """Put the frames among ``effects`` on their way."""
    for effect in effects:
        if isinstance(effect, SendFrame):
            after = leaving[-1][0] if leaving else 0
            leaving.append((max(effect.start_ns, after) + FRAME_NS, effect.frame))


def survive(seed: int, count: int) -> None:
    """``count`` frames, each judged; a good upload afterwards."""
    chance = random.Random(seed)
    device = MacCan(1)
    ledger = Ledger(device)
    leaving: list[tuple[int, CanFrame]] = []
    now, answered = S, 0
    for _ in range(count):
        gap = chance.random()
        now += FRAME_NS + (20 * S if gap < 0.002 else 3 * S if gap < 0.02 else int(gap * 3 * MS))
        for effect in let_pass(device, now, leaving):
            if isinstance(effect, SendFrame):
                assert ledger.is_spontaneous(effect.frame)
        frame = random_frame(chance, device.address)
        effects = device.receive(frame, now)
        leave(effects, leaving)
        sent = [effect for effect in effects if isinstance(effect, SendFrame)]
        answered += len(sent)
        ledger.judge(frame, sent, now)
        assert all(isinstance(effect, SendFrame | Store | Trace) for effect in effects)
    assert answered > count // 10, "the module was deaf nearly all the time"
    now += 30 * S
    let_pass(device, now, leaving)
    read = device.receive(CanFrame(0x600 + device.address, b"\x40\0\x20\0" + ZEROS), now)
    (reply,) = [effect.frame for effect in read if isinstance(effect, SendFrame)]
    assert reply.data[:4] == b"\x42\0\x20\0"
    position = device.position_at(now)
    assert int.from_bytes(reply.data[4:], "big", signed=True) == position


@pytest.mark.parametrize("seed", range(4))
def test_any_frames_are_survived(seed: int) -> None:
    """25 000 seeded frames each: no exception, only admitted frames, a good upload afterwards."""
    survive(seed, 25_000)


@pytest.mark.soak
def test_five_million_frames_are_survived() -> None:
    """The same, longer: 50 modules."""
    for seed in range(50):
        survive(1000 + seed, 100_000)
