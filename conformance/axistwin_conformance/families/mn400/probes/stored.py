"""Which readings a board follows in what it stores: its program, and how its memory is counted."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mn400.driver import DONE, BoardDriver
from axistwin_conformance.families.mn400.persistence.programs import (
    FillResult,
    emptied_afterwards,
    end_program,
    enter_configuration,
    enter_program,
    fill_store,
    leave_entry,
    listing,
    program_entry,
)
from axistwin_conformance.families.mn400.persistence.supply import power_cycle

ORDER = 110  # of this module in a run; see `Family.modules`

STORED: Final = ("stored",)
RUNNING: Final = ("motion", "stored")
EVERYTHING: Final = ("stored", "destructive")
CTRL_D, DEVICE_CONTROL_4 = 0x04, 0x14
WHICH_OF_TWO: Final[dict[tuple[bool, ...], int]] = {
    (True, False): 0,
    (False, True): 1,
    (True, True): 2,
}
KNOWN_PROGRAM: Final = ("V2000", "X1")


def _ends(driver: BoardDriver, byte: int, *, is_bare: bool) -> bool:
    """Whether a byte, in a packet or bare, ends the entry of a program; it is over in any case."""
    driver.command("Z")
    raw = bytes([byte])
    driver.client.send(raw if is_bare else driver.client.request(raw))
    driver.client.listen(driver.session.reply_timeout_s)
    return driver.is_present() or not leave_entry(driver.client)


@probe(safety=STORED)
def eof_byte(driver: BoardDriver) -> Outcome:
    """Z, 04h and then 14h, in a packet or bare, and a poll after each."""
    seen = tuple(
        _ends(driver, byte, is_bare=False) or _ends(driver, byte, is_bare=True)
        for byte in (CTRL_D, DEVICE_CONTROL_4)
    )
    return WHICH_OF_TWO.get(seen, "neither ends it")


@probe(safety=STORED)
def eof_framing(driver: BoardDriver) -> Outcome:
    """Z, the byte in a packet and bare, and a poll after each."""
    byte = DEVICE_CONTROL_4 if driver.reading("eof_byte") == "14" else CTRL_D
    seen = tuple(_ends(driver, byte, is_bare=is_bare) for is_bare in (False, True))
    return WHICH_OF_TWO.get(seen, "neither ends it")


@probe(safety=STORED)
def prog_check(driver: BoardDriver) -> Outcome:
    """W in the entry of a program."""
    with program_entry(driver):
        exchange = driver.ask("W")
        end_program(driver)
    if exchange.codes[-1:] == ("INVALIDPROGCOMM",):
        return 0
    return 1 if exchange.says(*DONE) else str(exchange)


@probe(safety=STORED)
def retransmit_in_entry(driver: BoardDriver) -> Outcome:
    """& in the entry of a program."""
    with program_entry(driver):
        exchange = driver.ask("&")
        end_program(driver)
    readings: dict[tuple[str, ...], int] = {("DONE",): 0, DONE: 1}
    return readings.get(exchange.codes, str(exchange))


@probe(safety=STORED)
def readprogram_framing(driver: BoardDriver) -> Outcome:
    """R after a program of two lines: how many packets have text."""
    enter_program(driver, KNOWN_PROGRAM)
    exchange = driver.ask("R")
    texts = [packet for packet in exchange.found if packet.code is None and packet.value]
    return {2: 0, 1: 1}.get(len(texts), str(exchange))


@probe(safety=STORED)
def readprogram_end(driver: BoardDriver) -> Outcome:
    """R after a program of two lines: the last packet."""
    enter_program(driver, KNOWN_PROGRAM)
    exchange = driver.ask("R")
    if not exchange.found:
        return str(exchange)
    last = exchange.found[-1]
    if last.code is None:
        return 0 if last.value else 2
    if exchange.codes[-1] != "DONE":
        return str(exchange)
    # A line without text, behind which such a trailer stands, may look like DONE, or be the same.
    trailer = driver.reading("data_packet_trailer")
    if last.payload[1:] != (b"" if trailer == "none" else bytes.fromhex(trailer)):
        return 1
    return (1, 2) if last.has_null == (driver.reading("outcome_null") == "true") else 2


@probe(safety=RUNNING)
def program_replies(driver: BoardDriver) -> Outcome:
    """U with the program E: whether more comes than START and DONE."""
    enter_program(driver, ("E",))
    driver.command("U")
    return int(bool(driver.client.listen(driver.session.reply_timeout_s)))


@probe(safety=("stored", "rig"), needs=("rig:power",))
def nvm_commit(driver: BoardDriver) -> Outcome:
    """A power cut in the entry of a program: whether the one before is listed."""
    enter_program(driver, KNOWN_PROGRAM)
    driver.command("Z")
    driver.command("X2")
    power_cycle(driver)
    seen = listing(driver.client)
    readings: dict[tuple[str, ...] | None, int] = {KNOWN_PROGRAM: 0, ("X2",): 1}
    return readings.get(seen, str(seen))


# --- how the memory is counted --------------------------------------------------------------------


def _filled(driver: BoardDriver, longest: int) -> FillResult:
    """What fits of lines so long, down to the last byte; the configuration is empty."""
    enter_program(driver, ())  # the old program may count as long as it is not replaced
    with program_entry(driver):
        filled = fill_store(driver, longest)
        end_program(driver)
    return filled


@probe(safety=EVERYTHING)
def nvm_line_overhead(driver: BoardDriver) -> Outcome:
    """Lines of 69 and of 20 characters until MEMORY_FULL, with an empty configuration."""
    with emptied_afterwards(driver):
        enter_configuration(driver, ())
        long, short = (_filled(driver, longest) for longest in (69, 20))
    more_lines = len(short.lines) - len(long.lines)
    less_text = long.text_bytes - short.text_bytes
    if more_lines <= 0:
        return f"{long} and {short}"
    # What is left over takes no line of one character more: it is no larger than the overhead.
    overhead = round(less_text / more_lines)
    is_told = abs(less_text - overhead * more_lines) <= overhead
    return Measured(str(overhead)) if is_told else f"{long} and {short}"


@probe(safety=EVERYTHING)
def nvm_size(driver: BoardDriver) -> Outcome:
    """Lines until MEMORY_FULL, with an empty configuration."""
    with emptied_afterwards(driver):
        enter_configuration(driver, ())
        filled = _filled(driver, 69)
    overhead = int(driver.reading("nvm_line_overhead"))
    least = filled.text_bytes + overhead * len(filled.lines)
    usual = int(driver.session.run.ledger.ambiguity_of("nvm_size").default_of("nvm_size"))
    return Measured(str(usual if least <= usual <= least + overhead else least))
