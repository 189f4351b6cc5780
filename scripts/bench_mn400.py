"""The benchmarks of the MN400: a poll, a value, the look-ahead of contours, and an hour of motion.

A poll is answered by two packets, START and PRESENT.  The last two are measured in this process by
its CPU time, so that what else runs on the machine counts little.
"""

from __future__ import annotations

import gc
import time
from typing import Any

import serial
from scripts.bench_line import Dialogue, Twin, compare, compare_in_process, transports

from axistwin.devices.mn400.motion import ContourSegment, MoveSettings, contour

MODEL = "mn400:1"
MN400 = Twin(MODEL, ("response_delay_ms=0",), 9600)
SEGMENTS = (1_000, 2_000, 5_000, 10_000, 20_000)
TURNS = 3
HOUR_S = 3600
POLLS_PER_S = 10


def packet(payload: bytes) -> bytes:
    """A packet of board 1, of either direction."""
    head = b"\x81" + payload + b"\x81"
    return head + bytes((sum(head) & 0x7F,))


def dialogue(command: bytes, answered: bytes) -> Dialogue:
    """A command, and START and what else a board answers that has just started."""
    return Dialogue(packet(command), packet(command[:1] + b"\x03\x00") + packet(answered))


DIALOGUES = {
    "poll": dialogue(b"*", b"*\x16\x00"),
    "position": dialogue(b"E", b"E0,0,0,0\x06"),
}


def compare_mn400(folder: str, seconds: float) -> None:
    """All of them."""
    for way in transports(folder):
        compare("MN400", way, MN400, DIALOGUES, seconds)
    compare_in_process("MN400", f"axistwin://{MODEL}?time=virtual", MN400, DIALOGUES, seconds)
    measure_planner()
    measure_hour()


def zigzag(count: int) -> list[ContourSegment]:
    """A contour with soft and hard junctions and ramps across several segments."""
    return [
        ContourSegment((100 + k * 7 % 5, k * 11 % 13, -(k * 3 % 4), 1), 1000 + k * 37 % 4000)
        for k in range(count)
    ]


def best_s(count: int) -> float:
    """CPU time of planning so many segments, the best of some turns."""
    parts, settings, best = zigzag(count), MoveSettings(), float("inf")
    gc.disable()  # its passes grow with what else there is
    for _ in range(TURNS):
        begin = time.process_time()
        contour(0, settings, parts, 50)
        best = min(best, time.process_time() - begin)
    gc.enable()
    return best


def measure_planner() -> None:
    """Segments per second for contours of several lengths: linear if they are alike."""
    print("\nMN400: planning a contour, CPU time")
    for count in SEGMENTS:
        used_s = best_s(count)
        print(f"  {count:6} segments  {used_s * 1e3:8.1f} ms  {count / used_s:9.0f} segments/s")


def polled_hour_s(*commands: bytes, poll: bytes = b"E") -> float:
    """CPU time of an hour with so many polls a second, behind ``commands``."""
    port: Any = serial.serial_for_url(f"axistwin://{MODEL}?time=virtual", timeout=1)
    with port:
        for command in commands:
            port.write(packet(command))
            port.read(12)
        port.reset_input_buffer()
        port.timeout = 1 / POLLS_PER_S
        request, heard = packet(poll), 0
        begin = time.process_time()
        for _ in range(HOUR_S * POLLS_PER_S):
            port.write(request)
            heard += len(port.read(256))
        used_s = time.process_time() - begin
    if heard < HOUR_S * POLLS_PER_S * len(packet(b"E0,0,0,0\x06")):
        raise SystemExit(f"bench: {HOUR_S * POLLS_PER_S} polls have brought {heard} bytes")
    return used_s


MOTIONS = {
    "a move of 3 axes": (b"V1000", b"M4000000,-3000000,5"),
    "a helix of 900 turns": (b"V1000", b"+-1000,0,0,0,1,-50000,900"),
}


def measure_hour() -> None:
    """What motion adds to the polls of its position."""
    polls = HOUR_S * POLLS_PER_S
    idle_s = min(polled_hour_s() for _ in range(TURNS))
    print(f"\nMN400: an hour in virtual time with {POLLS_PER_S} reads of E a second, CPU time")
    print(f"  at rest               {idle_s:6.2f} s, {idle_s / polls * 1e6:5.1f} µs a read")
    for name, commands in MOTIONS.items():
        used_s = min(polled_hour_s(*commands) for _ in range(TURNS))
        print(f"  {name:<21} {used_s:6.2f} s, {used_s - idle_s:5.2f} s of it for the motion")
