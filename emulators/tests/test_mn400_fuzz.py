"""An MN400 under anything that comes: commands, inputs, pulses, power, in every reading."""

import random
from typing import Any

import pytest
from mn400_bench import Mn400Bench
from mn400_lines import drawn_line

from axistwin.devices.mn400.inputs import NAMES
from axistwin.devices.mn400.link.packets import packet
from axistwin.devices.mn400.quirks import QUIRKS

ROUNDS = 40


def drawn_quirks(rng: random.Random) -> dict[str, Any]:
    """Any reading of those that are choices."""
    return {
        name: rng.choice(quirk.allowed)
        for name, quirk in QUIRKS.items()
        if quirk.kind in ("choice", "bool") and rng.random() < 0.3
    }


def act(bench: Mn400Bench, rng: random.Random) -> None:
    """Do one thing to the board."""
    device, choice = bench.device, rng.random()
    if choice < 0.7:
        line = drawn_line(rng)
        if not line.startswith((b"=", b"~")):
            bench.send(packet(1, line))
    elif choice < 0.85:
        bench.switch(rng.choice(NAMES), rng.random() < 0.5)
    elif choice < 0.9:
        bench.perform(device.feed_pulses(bench.now, rng.choice((0, 1, 7, 500, 5000))))
    elif choice < 0.92:
        bench.perform(device.index_pulse(bench.now))
    elif choice < 0.94:
        bench.perform(device.turn_spindle(bench.now, rng.choice((0, 1000, 5_000_000))))
    elif choice < 0.96:
        bench.perform(device.set_feed_pot(bench.now, rng.choice((0, 1, 500, 1000))))
    elif choice < 0.98:
        bench.perform(device.set_jog_pot(bench.now, rng.choice((0, 500, 1000))))
    elif choice < 0.985:
        bench.power_cycle()
    else:
        bench.perform(device.send_usb(bench.now, drawn_line(rng).decode()))


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_whatever_comes_a_board_answers_in_the_end(seed: int) -> None:
    """No order of commands, inputs and times breaks it; a power cycle brings it back."""
    rng = random.Random(seed)
    settings = drawn_quirks(rng) if seed % 2 else {}
    bench = Mn400Bench(**settings)
    for _ in range(60):
        act(bench, rng)
        bench.wait(rng.choice((1, 30, 300, 300, 1500)))
        before = bench.device.describe(bench.now)
        assert before == bench.device.describe(bench.now), "looking changes nothing"
        rates = bench.device.step_rates_at(bench.now)
        assert bench.device.moves_at(bench.now) or not any(rates), "what stands has no rate"
    for name in NAMES:
        bench.switch(name, on=False)
    bench.perform(bench.device.turn_spindle(bench.now, 0))
    bench.wait(3000)
    bench.power_cycle()
    assert bench.say("*") == "S PR"
    assert bench.say("M5") == "S D"
    bench.wait(100)
    assert bench.peek()[0] - bench.quirks.power_on_position == 5
