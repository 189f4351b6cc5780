"""Re-initialisation, and several modules on one line (CMD-00, CMD-0B in a move, MULTI)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.mac_axis.bench import QUIET_S, SLOWEST, Exchange, segment, velocity
from axistwin_conformance.mac_axis.dialogue import Kind
from axistwin_conformance.mac_axis.forecast import Segment
from axistwin_conformance.mac_axis.probes_stops import restarted_ns
from axistwin_conformance.mac_axis.probing import MOVES
from axistwin_conformance.mac_serial import codec
from axistwin_conformance.mac_serial.bench import Bench
from axistwin_conformance.mac_serial.codec import GENERAL_ADDRESS
from axistwin_conformance.mac_serial.probes import general_replies
from axistwin_conformance.registry import check
from axistwin_conformance.session import Session

PARAMETER_QUERIES: Final = (0x22, 0x23, 0x25, 0x26)
POLL_S: Final = 0.05
# What MACS-CMD-00-02 leaves to MACS-AMB-21: a host may talk 2.5 s after 00h, and what it sends
# within 1.5 s must not count.
DEAF_MS: Final = range(1500, 2501)


def restart(bench: Bench) -> Exchange:
    """Send 00h and wait until the module surely listens again."""
    exchange = bench.command(0x00)
    bench.wait_awake()
    return exchange


@check("MACS-CMD-00-03", "MACS-CMD-00-02", "MACS-CMD-00-01", safety=MOVES)
def after_00h_it_is_deaf_for_two_seconds(session: Session) -> None:
    """00h is acknowledged, or not; then every frame is lost for 2 s, without reply or effect."""
    bench = Bench(session)
    start = bench.ready()
    exchange = bench.command(0x00)
    outcome: int | str = {Kind.ACCEPTED: 0, Kind.SILENCE: 1}.get(exchange.kind, exchange.kind.value)
    bench.reading("reset_reply", outcome, "MACS-CMD-00-03")
    from_ns = exchange.taken.earliest_ns
    deaf_until_ns = from_ns + round(bench.deaf_surely_s * 1e9)
    while session.target.now_ns < deaf_until_ns - 100_000_000:
        for frame in (
            bench.request(0x20),
            *bench.nacked_alone(bench.request(0x20)),  # not even a Nack
            bench.request(0x13, start + 500),
            bench.request(0x0F, 0x77),
        ):
            lost = bench.send(frame, POLL_S)
            if lost.taken.latest_ns < deaf_until_ns:
                bench.must(Kind.SILENCE, lost, "MACS-CMD-00-02")
    awake_ns = _first_answer_ns(bench, from_ns)
    deaf_ms = round((awake_ns - from_ns) / 1e6)
    session.expect(
        deaf_ms in DEAF_MS,
        "MACS-CMD-00-02",
        f"deaf for {DEAF_MS[0]}..{DEAF_MS[-1]} ms after 00h",
        f"the first answer after {deaf_ms} ms",
    )
    session.info("MACS-CMD-00-02", f"deaf for {deaf_ms} ms, to {POLL_S * 1000:.0f} ms")
    boot_ms = round(bench.deaf_s * 1000)
    is_held = abs(deaf_ms - boot_ms) <= 3 * POLL_S * 1000
    session.quirk("MACS-CMD-00-02", "boot_time_ms", str(boot_ms if is_held else deaf_ms))
    place, coefficient = bench.position(), bench.value(0x26) >> 24
    session.expect(
        place == start and coefficient != 0x77, ("MACS-CMD-00-02", "MACS-CMD-00-01"),
        "what was sent meanwhile had no effect", f"position {place}, AA {coefficient:02X}",
    )  # fmt: skip


def _first_answer_ns(bench: Bench, from_ns: int) -> int:
    """When the module was first heard again; far too late if never."""
    while bench.target.now_ns < from_ns + 4_000_000_000:
        exchange = bench.send(bench.request(0x20), POLL_S)
        if exchange.kind is Kind.ANSWER:
            return exchange.taken.earliest_ns
    return bench.target.now_ns


@check("MACS-CMD-00-01", "MACS-CMD-00-02", safety=MOVES)
def just_after_two_seconds_it_listens(session: Session) -> None:
    """A frame that ends 2.02 s after 00h's reply is answered, one at 1.98 s is lost."""
    bench = Bench(session)
    if not session.target.is_lossless:
        session.skip("needs exact timing: only virtual time without noise tells 1.98 s from 2.02 s")
    bench.ready()
    for after_s, kind in ((-0.02, Kind.SILENCE), (0.02, Kind.ANSWER)):
        since_ns = restarted_ns(bench)
        bench.wait_until(since_ns + round((bench.deaf_s + after_s) * 1e9) - bench.frame_ns)
        exchange = bench.send(bench.request(0x20), POLL_S)
        session.expect(
            exchange.kind is kind, "MACS-CMD-00-02",
            f"{kind.value} {bench.deaf_s + after_s:.2f} s after 00h", exchange.kind.value,
        )  # fmt: skip
        bench.wait_awake()
    bench.alive("MACS-CMD-00-01")


@check("MACS-CMD-00-01", "MACS-CMD-18-03", safety=MOVES)
def after_00h_parameters_and_position_are_kept(session: Session) -> None:
    """00h keeps position and stored parameters at rest; sync, preload and stop bits are gone."""
    bench = Bench(session)
    start = bench.ready(0x1000, 3)
    bench.finish(bench.go(start + 30))
    for index, parameter in (
        (0x09, start + 40), (0x0A, start - 5000), (0x0C, 0x33), (0x0E, 0x0700), (0x1C, 0x02),
        (0x03, 8),
    ):  # fmt: skip
        bench.command(index, parameter)
    bench.accepted(0x13, start + 100)
    bench.wait(0.4)
    bench.run_out()
    before = [bench.value(index) for index in PARAMETER_QUERIES]
    place = bench.position()
    stopped_on = bench.stopped_on()
    bench.command(0x10)
    bench.command(0x13, start)
    restart(bench)
    after = [bench.value(index) for index in PARAMETER_QUERIES]
    modes = 0x0000FFFF  # K, m and TT of 26h: whether they are stored is open (MACS-AMB-24)
    if after[:3] == before[:3] and after[3] & ~modes == before[3] & ~modes:
        bench.reading("persist_modes", int(after != before), "MACS-CMD-00-01")
    else:
        session.fail("MACS-CMD-00-01", _hex(before), _hex(after))
    session.expect(
        bench.position() == place, "MACS-CMD-00-01", f"position {place}", bench.position()
    )
    session.expect(
        bench.stopped_on() == 0 or bench.known("ff_lifetime") == 1,
        "MACS-CMD-00-01", f"ff 00 (was {stopped_on:02X})",
        f"{bench.stopped_on():02X}",
    )  # fmt: skip
    bench.command(0x11)
    bench.wait(0.1)
    session.expect(
        bench.position() == place, ("MACS-CMD-00-01", "MACS-CMD-18-03"),
        "nothing preloaded any more", bench.position(),
    )  # fmt: skip


@check("MACS-CMD-00-01", "MACS-CMD-18-03", safety=MOVES, level="full")
def in_motion_00h_drops_the_motion(session: Session) -> None:
    """00h during a move or segments: the axis stands, nothing resumes or is locked."""
    bench = Bench(session)
    for begin in ((0x13, 100), (0x16, segment(60, SLOWEST))):
        start = bench.ready(SLOWEST)
        index, parameter = begin
        for _ in range(2):
            bench.command(index, start + parameter if index == 0x13 else parameter)
        bench.wait(0.2)
        restart(bench)
        place = bench.position()
        session.expect(
            abs(place - start) < 60, "MACS-CMD-00-01", "motion dropped", f"{place - start}"
        )
        bench.wait(0.5)
        session.expect(
            bench.position() == place, ("MACS-CMD-00-01", "MACS-CMD-18-03"),
            f"at rest at {place}", bench.position(),
        )  # fmt: skip
        bench.accepted(0x0F, 0, requirement="MACS-CMD-00-01")
        bench.finish(bench.go(start), "MACS-CMD-00-01")


@check("MACS-CMD-0B-02", "MACS-CMD-0B-01", safety=MOVES, level="full")
def clearing_the_counter_during_a_move(session: Session) -> None:
    """0Bh half-way through 13h: the target stays a number, or the remaining distance stays."""
    bench = Bench(session)
    start = bench.ready(0x4000, 0)
    if abs(start) > bench.room() // 2:
        session.skip("the counter's origin could not be put back: it is too far away")
    distance = 150
    target = start + distance
    forecast = bench.go(target)
    bench.wait(0.15)
    cleared = bench.accepted(0x0B)
    lowest, highest = forecast.bounds(cleared.taken)
    bench.wait(0.8 + abs(target) * 2 * bench.period * 125e-9)
    final = bench.position()
    # 0Bh made some place in lowest..highest the new 0.
    remaining = range(target - highest - 1, target - lowest + 2)
    outcome: int | str = f"rest at {final}"
    if final == target and final not in remaining:
        outcome = 0
    elif final in remaining:
        outcome = 1
    bench.reading("reset_in_motion", outcome, "MACS-CMD-0B-02")
    session.expect(True, "MACS-CMD-0B-01", "", "")
    bench.at_rest()
    here = lowest
    if abs(here) <= bench.room():
        bench.finish(bench.go(-here))
        bench.command(0x0B)


def _hex(values: list[int]) -> str:
    return " ".join(f"{value:08X}" for value in values)


# --- several modules -----------------------------------------------------------------------------


def general(bench: Bench, index: int, parameter: int = 0) -> Exchange:
    """Send a frame to the general address."""
    return bench.send(bench.request(index, parameter, address=GENERAL_ADDRESS), QUIET_S * 2)


def _everybody(session: Session) -> list[Bench]:
    return [Bench(session, address) for address in (session.address, *session.neighbours)]


@check("MACS-MULTI-03", "MACS-REPLY-08", needs=("alone",))
def the_general_address_is_answered_by_module_00(session: Session) -> None:
    """A query to FF is answered by module 00 with address FF; others keep silent."""
    bench = Bench(session)
    _judge_general_reply(bench, general(bench, 0x20).reply)
    bench.alive("MACS-MULTI-03")


def _judge_general_reply(bench: Bench, reply: codec.Reply) -> None:
    """Who answered a query to FF (MACS-AMB-16), and as whom (MACS-AMB-17)."""
    session = bench.session
    if reply.kind not in (Kind.ANSWER, Kind.SILENCE, Kind.GARBAGE):
        session.fail("MACS-MULTI-03", "one answer, or silence", reply)
    bench.reading("general_reply_policy", general_replies(bench, reply.kind), "MACS-MULTI-03")
    if reply.kind is Kind.ANSWER:
        own = dict.fromkeys((session.address, *session.neighbours), 1)
        echo = {**own, GENERAL_ADDRESS: 0}.get(reply.address or 0, f"{reply}")
        bench.reading("general_echo", echo, "MACS-REPLY-08")
    else:
        session.not_run("MACS-REPLY-08", "nobody is heard alone, so the address cannot be read")


@check("MACS-MULTI-01", "MACS-REPLY-13", "MACS-FRAME-07", needs=("neighbour",))
def modules_with_distinct_addresses_answer_for_themselves(session: Session) -> None:
    """Each module on the line answers its own address, and only that."""
    session.info("MACS-MULTI-01", "why one has to be 00 shows in frames to all (MACS-MULTI-03)")
    for bench in _everybody(session):
        reply = bench.must(Kind.ANSWER, bench.ask(0x24)).reply
        session.expect(
            reply.address == bench.address,
            ("MACS-MULTI-01", "MACS-REPLY-13", "MACS-FRAME-07"),
            f"{bench.address:02X}",
            f"{reply.address:02X}",
        )


@check("MACS-MULTI-03", "MACS-REPLY-08", "MACS-REPLY-12", needs=("neighbour",))
def one_module_answers_for_all(session: Session) -> None:
    """A query to FF on a shared line gets exactly one answer, module 00's, as address FF."""
    bench = Bench(session)
    reply = general(bench, 0x20).reply
    extra = session.target.receive(1, QUIET_S)
    if extra:  # several speak on top of one another
        reply = codec.Reply(Kind.GARBAGE, reply.raw + extra)
    _judge_general_reply(bench, reply)
    bench.wait(QUIET_S)
    session.target.drain()
    bench.alive("MACS-REPLY-12")


@check("MACS-MULTI-02", "MACS-MULTI-03", safety=MOVES, needs=("neighbour",))
def general_commands_are_executed_by_all(session: Session) -> None:
    """0Dh, 0Fh and 13h to FF change and move every module on the line; one reply comes."""
    everybody = _everybody(session)
    first = everybody[0]
    before = [(bench.ready(0x1000), bench.value(0x25), bench.value(0x26)) for bench in everybody]
    try:
        period = first.slowed(0x0ABC)
        for index, parameter in ((0x0D, period), (0x0F, 2)):
            _general_reply(first, general(first, index, parameter))
        for bench in everybody:
            seen = (bench.value(0x25) & 0xFFFF, bench.value(0x26) >> 24)
            session.expect(
                seen == (period, 2), "MACS-MULTI-02", f"{(period, 2)} at {bench.address:02X}", seen
            )
        general(first, 0x15, velocity(1, 0x2000))
        first.wait(0.3)
        general(first, 0x18)
        for bench, (start, _, _) in zip(everybody, before, strict=True):
            moved = bench.position() - start
            session.expect(
                moved > 10, "MACS-MULTI-02", f"{bench.address:02X} moved with all", moved
            )
    finally:
        for bench, (start, speeds, modes) in zip(everybody, before, strict=True):
            bench.command(0x18)
            bench.command(0x0D, speeds & 0xFFFF)
            bench.command(0x0F, modes >> 24)
            bench.finish(bench.go_plainly(start))


def _general_reply(bench: Bench, exchange: Exchange) -> None:
    kind = Kind.ANSWER if exchange.kind is Kind.ACCEPTED else exchange.kind
    bench.reading("general_reply_policy", general_replies(bench, kind), "MACS-MULTI-03")


@check("MACS-MULTI-02", "MACS-CMD-11-01", safety=MOVES, needs=("neighbour",))
def one_11h_starts_all_preloaded_axes_together(session: Session) -> None:
    """10h and 13h to each module, 11h to FF: all start on the same frame."""
    everybody = _everybody(session)
    starts = [bench.ready(0x2000) for bench in everybody]
    try:
        for bench, start in zip(everybody, starts, strict=True):
            bench.accepted(0x10)
            bench.accepted(0x13, start + 200)
        sync = general(everybody[0], 0x11)
        for bench, start in zip(everybody, starts, strict=True):
            forecast = bench.to_position(sync, start, start + 200)
            bench.follow(forecast, ("MACS-MULTI-02", "MACS-CMD-11-01"), bench.allowance(0x2000))
        for bench, start in zip(everybody, starts, strict=True):
            bench.finish(
                bench.to_position(sync, start, start + 200), ("MACS-MULTI-02", "MACS-CMD-11-01")
            )
    finally:
        _all_back(everybody, starts)


@check("MACS-MULTI-02", "MACS-CMD-1E-01", "MACS-CMD-16-01", safety=MOVES, needs=("neighbour",))
def axes_keep_step_through_virtual_segments(session: Session) -> None:
    """While one axis moves, the other waits the same ticks: afterwards both are in step."""
    everybody = _everybody(session)[:2]
    starts = [bench.ready() for bench in everybody]
    one = (Segment(40, 0x2000), Segment(30, 0x3000, moves=False), Segment(20, 0x2000))
    other = (Segment(40, 0x2000, moves=False), Segment(30, 0x3000), Segment(20, 0x2000))
    try:
        forecasts = [
            bench.feed(start, *row)
            for bench, start, row in zip(everybody, starts, (one, other), strict=True)
        ]
        for _ in range(6):
            for bench, forecast in zip(everybody, forecasts, strict=True):
                bench.follow(
                    forecast,
                    ("MACS-MULTI-02", "MACS-CMD-1E-01", "MACS-CMD-16-01"),
                    bench.allowance(0x2000),
                )
        for bench, forecast in zip(everybody, forecasts, strict=True):
            bench.finish(forecast, ("MACS-MULTI-02", "MACS-CMD-1E-01", "MACS-CMD-16-01"))
    finally:
        _all_back(everybody, starts)


def _all_back(everybody: list[Bench], starts: list[int]) -> None:
    for bench, start in zip(everybody, starts, strict=True):
        bench.at_rest()
        bench.finish(bench.go_plainly(start))
