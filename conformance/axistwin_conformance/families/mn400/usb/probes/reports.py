"""What an MN400 says on USB where the manual does not tell (MN4-AMB-50)."""

from __future__ import annotations

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.mn400.codec import ReturnCode
from axistwin_conformance.families.mn400.usb.driver import UsbDriver


@probe()
def usb_error_form(driver: UsbDriver) -> Outcome:
    """The report that X3 draws."""
    reply = driver.ask("X3")
    if reply.code != ReturnCode.PARA_ERROR:
        return str(reply)
    return 0 if reply.has_command else 1


@probe()
def usb_outcome_codes(driver: UsbDriver) -> Outcome:
    """Whether K with nothing pending draws NOMOVEPENDING."""
    reply = driver.ask("K")
    if reply.is_silence:
        return 1
    return 0 if reply.code == ReturnCode.NOMOVEPENDING else str(reply)
