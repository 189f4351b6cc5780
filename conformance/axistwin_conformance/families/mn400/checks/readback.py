"""What a board tells of itself, and what it tells again (RSP, CMD: E N S / [ : ? &)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.checks.queue import needs_flags
from axistwin_conformance.families.mn400.client import MEASURES_S, REPLY_LIMIT_S
from axistwin_conformance.families.mn400.driver import AXES, DATA, DONE, FLAGS, BoardDriver
from axistwin_conformance.families.mn400.snapshot import restoring

ORDER = 30

READS: Final = ("E", "N", "S", "/", "?", "[", ":")
PLAIN_ORDERS: Final = ("V2000", "Q")
# What makes the value of E long, and leaves a comma and a zero in it (MN4-AMB-02).
WIDE_LOAD: Final = "L-1000000000,0,-1000000000,-1000000000"
# What each read tells in numbers: the requirement, and how many.
FIELDS: Final = {
    "E": ("MN4-CMD-E-01", AXES), "N": ("MN4-CMD-N-01", AXES), "S": ("MN4-CMD-S-01", 1),
    "[": ("MN4-CMD-SHD-01", 1), ":": ("MN4-CMD-SW-01", len(FLAGS)),
}  # fmt: skip
IDLE_FLAGS: Final = ("PauseFlag", "PauseState")
MOST_INPUTS: Final = 65535


@check("MN4-RSP-12", "MN4-RSP-04", "MN4-RSP-10")
@restoring("L")
def every_value_ends_in_the_same_way(session: Session) -> None:
    """All data packets have one trailer, short ones and long ones, and all but the firmware are
    plain numbers."""
    driver = BoardDriver(session)
    driver.command(WIDE_LOAD)
    trailers = set()
    for text in driver.known(READS):
        exchange = driver.draws(text, DATA, "MN4-RSP-04")
        packet = exchange.value
        assert packet is not None, "the line above has seen to it"
        trailers.add(packet.trailer.hex().upper() or "none")
        if text != "?":
            told = packet.value
            session.expect(packet.fields is not None, "MN4-RSP-10", "plain numbers", told)
            if "0" in told.split(",")[1:]:
                seen = "dot_nul" if packet.is_dotted else "ascii"
                driver.follows("data_value_encoding", seen, "MN4-RSP-10")
    session.expect(len(trailers) == 1, "MN4-RSP-12", "one trailer", sorted(trailers))
    driver.follows("data_packet_trailer", trailers.pop(), "MN4-RSP-12")


@check("MN4-CMD-E-01", "MN4-CMD-N-01", "MN4-CMD-SHD-01", "MN4-CMD-SW-01", "MN4-CMD-FW-01",
       "MN4-CMD-S-01")  # fmt: skip
def reads_have_the_fields_of_the_manual(session: Session) -> None:
    """Four counters, four remainders, five flags, a shield, inputs within 16 bits, a revision."""
    driver = BoardDriver(session)
    for text in driver.known(FIELDS):
        name, count = FIELDS[text]
        fields = driver.value(text).fields or ()
        session.expect(len(fields) == count, name, f"{count} numbers", fields, f"to {text}")
        if text in "[:":
            session.expect({*fields} <= {0, 1}, name, "0 or 1", fields, f"to {text}")
        if text == "S" and driver.reading("limit_status_signed") == "false":
            session.expect(0 <= fields[0] <= MOST_INPUTS, name, "0 to 65535", fields[0])
    firmware = driver.value("?").value
    is_right = codec.REVISION.fullmatch(firmware) is not None
    session.expect(is_right, "MN4-CMD-FW-01", "MN400 V a.bb / c.dd", firmware)


@check("MN4-RSP-07", "MN4-CMD-FH-02", "MN4-CMD-SW-01")
@restoring(";")
def feed_hold_is_the_second_flag(session: Session) -> None:
    """;1 and ;0 answer START and DONE, and : shows them; at rest nothing is paused."""
    needs_flags(session)
    driver = BoardDriver(session)
    for mode in (1, 0, 1, 0):
        driver.draws(f";{mode}", DONE, "MN4-RSP-07")
        driver.draws(":", DATA, "MN4-RSP-07")
        flags = driver.flags()
        session.expect(flags["FeedHold"] == mode, "MN4-CMD-FH-02", mode, flags["FeedHold"])
        paused = [name for name in IDLE_FLAGS if flags[name]]
        session.expect(not paused, "MN4-CMD-SW-01", "no pause at rest", paused)


@check("MN4-CMD-SHD-01", "MN4-CMD-SW-01")
def both_tell_of_the_shield_in_one_sense(session: Session) -> None:
    """[ and the first flag of : are equal, or opposite throughout (MN4-AMB-36)."""
    needs_flags(session)
    driver = BoardDriver(session)
    for _ in range(3):
        shield, flag = driver.shield(), driver.flags()["ShieldFlag"]
        seen = "shield" if shield == flag else "switch"
        driver.follows("shield_status_sense", seen, ("MN4-CMD-SHD-01", "MN4-CMD-SW-01"))


@check("MN4-CMD-EXIT-03", "MN4-RSP-03")
def the_exit_code_can_be_cleared(session: Session) -> None:
    """| answers START and DONE, and / is 0 after it."""
    driver = BoardDriver(session)
    driver.draws("|", DONE, "MN4-RSP-03")
    code = driver.exit_code()
    session.expect(code == 0, "MN4-CMD-EXIT-03", 0, code)


@check("MN4-CMD-RTX-01", "MN4-CMD-RTX-02", "MN4-RSP-08")
@restoring("V")
def the_last_message_comes_again(session: Session) -> None:
    """& after each read, after orders and after errors: one packet, the last one of the reply, as
    before but for its command and sum; and so once more."""
    driver = BoardDriver(session)
    poll = driver.client.request("*")
    rate = codec.RATES.index(driver.target.baud)
    texts = driver.known((*READS, "*", f"~{rate}", "K", "X3", "W", *PLAIN_ORDERS))
    for raw in (*map(driver.client.request, texts), codec.with_wrong_checksum(poll)):
        said = driver.client.ask_raw(raw)
        name = "MN4-CMD-RTX-02" if said.codes[-1:] == ("DONE",) else "MN4-CMD-RTX-01"
        for _ in range(2):
            driver.repeats(said, name, "MN4-RSP-08")


@check("MN4-CMD-Q-03", "MN4-CMD-CC-08", "MN4-CMD-U-02", "MN4-CMD-M-04")
@restoring("L")
def at_rest_these_do_nothing(session: Session) -> None:
    """Q, a ) without (, an empty pair, and a move of no axis: START and DONE, E as before."""
    driver = BoardDriver(session)
    driver.command("L5,6,7,8")
    for texts, name in (
        (("Q",), "MN4-CMD-Q-03"), ((")",), "MN4-CMD-CC-08"), (("(", ")"), "MN4-CMD-CC-08"),
        (("M",), "MN4-CMD-M-04"), (("M,,,",), "MN4-CMD-M-04"),
    ):  # fmt: skip
        for text in texts:
            exchange = driver.ask(text)
            if name == "MN4-CMD-Q-03":
                driver.judge(exchange, DONE, name)
            else:
                driver.tells(exchange.says(*DONE), name, "START and DONE", exchange)
        position = driver.position()
        session.expect(position == (5, 6, 7, 8), name, "5, 6, 7, 8", position)
    session.not_run("MN4-CMD-U-02", "whether a program is stored is not known here")


@check("MN4-CMD-CC-01", "MN4-CMD-CC-03", "MN4-CMD-CC-04", "MN4-ERR-01", "MN4-ERR-02")
@restoring("LXVH;")
def while_a_contour_is_entered_little_is_served(session: Session) -> None:
    """Between ( and Q other commands draw what this board has for them, and do nothing."""
    driver = BoardDriver(session)
    model = driver.model()
    driver.command("L1,2,3,4")
    exchange = driver.draws("(50", DONE, "MN4-CMD-CC-01")
    model.accept("(50", driver.span(exchange))
    for text in ("E", "?", "L9,9,9,9", "X2", "*", "H", "N", ";0"):
        driver.meets(text, model.expect(text, driver.span(exchange)))
    driver.draws("V1a", driver.errors("PARA_ERROR"), "MN4-ERR-02")
    driver.draws("Q", DONE, "MN4-CMD-CC-04")
    if driver.reading("cc_unsupported") != "executed":
        position = driver.position()
        session.expect(position == (1, 2, 3, 4), "MN4-CMD-CC-03", "1, 2, 3, 4", position)


@check("MN4-CMD-E-04", "MN4-CMD-E-02", "MN4-MEA-01")
def at_rest_a_measurement_counts_nothing(session: Session) -> None:
    """E1 and E2 answer after 100 and 1000 ms with a fifth field of 0."""
    driver = BoardDriver(session)
    for mode, seconds in MEASURES_S.items():
        exchange = driver.draws(f"E{mode}", DATA, "MN4-CMD-E-02")
        fields = exchange.value.fields if exchange.value else None
        session.expect(len(fields or ()) == AXES + 1, "MN4-CMD-E-02", "five numbers", fields)
        assert fields is not None
        driver.tells(fields[-1] == 0, "MN4-CMD-E-04", "a count of 0", fields[-1])
        took_s = (exchange.done_ns - exchange.asked_ns) / 1e9
        most_s = seconds + REPLY_LIMIT_S + session.target.uncertainty_ns / 1e9
        is_right = seconds <= took_s <= most_s
        told = f"{seconds} s to {most_s:.2f} s"
        session.expect(is_right, "MN4-MEA-01", told, f"{took_s:.3f} s", f"to E{mode}")


@check("MN4-CMD-H-03", "MN4-CMD-H-02")
@restoring("LH")
def with_hold_on_and_nothing_pending_the_rest_is_served(session: Session) -> None:
    """H1, then settings and reads, then H0."""
    driver = BoardDriver(session)
    if driver.reading("hold_takes_arg") == "false":
        session.skip("this board's H has no parameter to turn it off for certain")
    driver.draws("H1", DONE, "MN4-CMD-H-02")
    driver.draws("L5,0,0,0", DONE, "MN4-CMD-H-03")
    position = driver.position()
    session.expect(position == (5, 0, 0, 0), "MN4-CMD-H-03", "5, 0, 0, 0", position)
    driver.draws("H0", DONE, "MN4-CMD-H-02")
