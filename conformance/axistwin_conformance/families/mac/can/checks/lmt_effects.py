"""What the address procedure leaves as it is, and what stores no address (LMT, PERS, Q-00); and
what the address is for (GEN, EMCY)."""

from __future__ import annotations

from functools import partial
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.base.transcript import Direction
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import RIG, Observation
from axistwin_conformance.families.mac.axis.driver import factory
from axistwin_conformance.families.mac.axis.driver.rig import OFF_S
from axistwin_conformance.families.mac.axis.probes.sync import is_held
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.boot_up import (
    await_boot_up,
    boot_silence_limit_s,
    restart,
)
from axistwin_conformance.families.mac.can.checks.lmt import (
    NEW_ADDRESSES,
    serves_meanwhile,
    stays,
    take_address,
)
from axistwin_conformance.families.mac.can.checks.messages import (
    beat,
    is_free,
    judge_due,
    silenced,
)
from axistwin_conformance.families.mac.can.checks.sync_frames import PERIOD, started
from axistwin_conformance.families.mac.can.collect_replies import described, replies
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.probes.destructive import (
    ALONE,
    DESTRUCTIVE,
    LMT_STORE,
    address_put_back,
    answers,
    configure,
    give_address,
)
from axistwin_conformance.families.mac.can.probes.messages import LIFEBEAT_S
from axistwin_conformance.families.mac.can.settings import TORQUE
from axistwin_conformance.transport.can_frame import Frame, unpack_all

ORDER = 295  # of this module in a run; see `Family.modules`

POWERED: Final = (*DESTRUCTIVE, "rig")
AWAY: Final = 25  # increments, so that the counter is not 0
MODES: Final = 0x0000FFFF  # K, m and TT of 2006h: whether they are stored is open (MACS-AMB-24)


@check(
    "MACC-Q-00-01", "MACC-PERS-01", "MACC-PERS-02", "MACC-LMT-03", safety=DESTRUCTIVE, needs=ALONE
)
def the_address_procedure_changes_the_address_alone(session: Session) -> None:
    """Position, parameters and modes are what they were before the procedure."""
    driver = CanDriver(session)
    driver.motion.finish(driver.motion.go(driver.motion.ready() + AWAY))
    before = factory.overwrite(driver, 0)
    place = driver.client.position()
    new = next(address for address in NEW_ADDRESSES if address != driver.client.address)
    with address_put_back(driver):
        give_address(driver, new)
        driver.client.address = new
        wanted = f"an answer at address {new}"
        session.expect(answers(driver, new), "MACC-LMT-03", wanted, "silence")
        kept, after = driver.client.position(), factory.answers(driver)
        session.expect(kept == place, "MACC-Q-00-01", f"position {place}", kept)
        words = [
            " ".join(f"{value & ~(MODES if index == 0x26 else 0):08X}" for index, value in one)
            for one in (before.items(), after.items())
        ]
        session.expect(words[0] == words[1], "MACC-PERS-01", *words)
        driver.judge.reading("persist_modes", int(before != after), "MACC-PERS-02")


@check("MACC-LMT-07", "MACC-CMD-10-01", safety=DESTRUCTIVE, needs=ALONE)
def the_configuration_mode_leaves_what_2010h_has_begun(session: Session) -> None:
    """Entering and leaving without an address neither disarm, nor start or drop what is preloaded:
    SYNC starts it then."""
    driver = CanDriver(session)
    if session.reading("lmt_incomplete") != "ignore":
        session.skip("leaving without an address restarts it (MACC-AMB-10)")
    names = ("MACC-LMT-07", "MACC-CMD-10-01")
    start = driver.motion.ready(PERIOD)
    with address_put_back(driver):
        driver.judge.accepted(0x10)
        for _ in range(2):
            configure(driver, codec.lmt_enter())
            configure(driver, codec.lmt_leave())
            driver.client.command(0x13, start + AWAY)  # a second one may be refused
            is_waiting = is_held(driver, start)
            session.expect(is_waiting, names, f"held at {start}", driver.client.position())
        configure(driver, codec.lmt_enter())
        configure(driver, codec.lmt_leave())
        exchange = started(driver, codec.sync())
        driver.motion.finish(driver.motion.to_position(exchange, start, start + AWAY), names)


@check("MACC-LMT-03", "MACC-LMT-09", safety=DESTRUCTIVE, needs=ALONE)
def storing_before_the_end_stores_no_address(session: Session) -> None:
    """17h amid the procedure, then a restart: the module has the address it had."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    if not serves_meanwhile(driver) or driver.readings.known("lmt_other"):
        session.skip("it takes no reset meanwhile, or obeys 17h (MACC-AMB-11, -12)")
    new = next(address for address in NEW_ADDRESSES if address != driver.client.address)
    with address_put_back(driver):
        configure(driver, codec.lmt_enter())
        take_address(driver, codec.lmt_address(new), "MACC-LMT-03")
        configure(driver, codec.lmt(LMT_STORE))
        names = ("MACC-LMT-03", "MACC-LMT-09")
        wanted = f"a boot-up message from {driver.client.address}"
        session.expect(restart(driver).boot_up is not None, names, wanted, "none")
        stays(driver, "MACC-LMT-03", new)


@check("MACC-EMCY-05", safety=DESTRUCTIVE, needs=ALONE)
def the_address_procedure_does_not_put_the_lifebeat_off(session: Session) -> None:
    """Ten seconds after the module's own last request it speaks, whatever came on 7E5h since: an
    address that is given and not yet taken over, or nothing given at all."""
    driver = CanDriver(session)
    if silenced(driver) or is_free(driver):
        session.skip("it sends no such message, or sends it in any case")
    driver.motion.at_rest()
    procedures = [(codec.lmt_enter(), codec.lmt_address(NEW_ADDRESSES[0]))]
    if session.reading("lmt_incomplete") == "ignore":  # first: nothing is given yet
        procedures.insert(0, (codec.lmt_enter(), codec.lmt_leave()))
    with address_put_back(driver):
        for frames in procedures:
            own = driver.client.ask(0x20).taken
            driver.client.target.take_spontaneous()
            driver.client.wait(LIFEBEAT_S / 2)
            for frame in frames:
                configure(driver, frame)
            message = beat(driver)
            if message is None:
                session.fail(None, "a lifebeat", "none")
            judge_due(driver, own, message, "MACC-EMCY-05")


@check("MACC-EMCY-03", safety=DESTRUCTIVE, needs=ALONE)
def the_lifebeat_comes_under_the_address_it_has(session: Session) -> None:
    """A module that was given another address speaks under 080h plus that one."""
    driver = CanDriver(session)
    if silenced(driver):
        session.skip("it sends no such message")
    driver.motion.at_rest()
    with address_put_back(driver):
        new = next(address for address in NEW_ADDRESSES if address != driver.client.address)
        give_address(driver, new)
        driver.client.address = new
        session.step(answers(driver, new), f"an answer at address {new}", "silence")
        driver.client.target.take_spontaneous()
        message = beat(driver)
        texts = [str(arrival.frame) for arrival in driver.client.target.take_spontaneous()]
        wanted_text = f"a message under {codec.EMERGENCY + new:03X}h"
        session.expect(message is not None, None, wanted_text, " ".join(texts) or "none")


@check("MACC-GEN-01", "MACC-GEN-02", "MACC-ID-01", safety=DESTRUCTIVE, needs=ALONE)
def a_lone_module_other_than_1_obeys_all_in_silence(session: Session) -> None:
    """A module that is not 1 obeys 600h and answers none of it; the same module as 1 answers."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    with address_put_back(driver):
        for address in (*NEW_ADDRESSES, codec.SPOKESMAN):
            give_address(driver, address)
            driver.client.address = address
            session.expect(
                answers(driver, address), "MACC-ID-01", f"an answer at address {address}", "silence"
            )
            _judge_told_all(driver)
            restart(driver)  # what it is then, is read anew
            _judge_told_all(driver)


def _judge_told_all(driver: CanDriver) -> None:
    """A setting on 600h is taken, and acknowledged by a module 1 only; nor does any other answer an
    upload."""
    session, client, address = driver.session, driver.client, driver.client.address
    is_one, value = address == codec.SPOKESMAN, TORQUE.other(driver)
    requests = [client.to_all(0x0C, TORQUE.parameter(value))]
    if not is_one or session.reading("general_upload") == "answer":
        requests.append(client.to_all(0x26))
    for request in requests:
        received = replies(driver, request.frame(), is_awaited=is_one)
        wanted = f"{'one reply' if is_one else 'silence'} of module {address}"
        session.expect(len(received) == is_one, "MACC-GEN-02", wanted, described(received))
    seen = TORQUE.read(driver)
    wanted = f"torque {value:02X} after 200Ch to all, at address {address}"
    session.expect(seen == value, "MACC-GEN-01", wanted, f"{seen:02X}")


@check("MACC-LMT-03", "MACC-PERS-01", safety=POWERED, needs=("alone", "rig:power"))
def the_address_outlives_the_supply_once_it_holds(session: Session) -> None:
    """After a power cycle during the address procedure the module has its old address; after one
    behind the procedure, the new one."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    old, new = (
        driver.client.address,
        next(address for address in NEW_ADDRESSES if address != driver.client.address),
    )
    with address_put_back(driver):
        configure(driver, codec.lmt_enter())
        configure(driver, codec.lmt_address(new))
        _cycle(driver, old, "MACC-LMT-03")
        stays(driver, "MACC-LMT-03", new)
        give_address(driver, new)
        driver.client.address = new
        _cycle(driver, new, "MACC-PERS-01")
        stays(driver, "MACC-PERS-01", old)


def _cycle(driver: CanDriver, address: int, requirement: str) -> None:
    driver.session.rig.work("power", False)
    driver.client.wait(OFF_S)
    driver.client.target.take_spontaneous()
    driver.session.rig.work("power", True)
    boot_up, _ = await_boot_up(driver, address=address)
    driver.session.expect(
        boot_up is not None,
        requirement,
        f"a boot-up message from address {address}",
        partial(_boot_up_seen, driver, address, is_whole=requirement == "MACC-PERS-01"),
    )


def _boot_up_seen(driver: CanDriver, address: int, *, is_whole: bool) -> Observation:
    """What a module said after a power cycle in place of its boot-up message, in words; `is_whole`:
    the procedure before it had been brought to its end."""
    frames: list[Frame] = []
    for record in reversed(driver.session.records()):
        if record.direction is Direction.NOTE and record.text.startswith(RIG):
            break
        frames += unpack_all(record.data) if record.direction is Direction.DEVICE else []
    ups = [one for one in frames if codec.boot_up_form(one) is not None]
    what = f"no boot-up message came within {boot_silence_limit_s(driver):.1f} s"
    if ups:
        came = codec.spontaneous_from(ups[0])
        what = f"the module sent its boot-up message from address {came} ({ups[0].identifier:03X}h)"
    done = "an address procedure (LMT) without its last step"
    if is_whole:
        done = f"the address procedure (LMT), by which the module came to address {address},"
    return Observation(
        f"after {done} and a power cycle, {what}",
        value="none",
        wanted=f"a boot-up message from address {address} ({codec.BOOT_UP + address:03X}h)",
        causes=("LMT: enter", "LMT: new address", "LMT: return"),
    )
