"""What a MAC module keeps: nonvolatile cells, their factory values, and both memories as bytes.

Rules
-----
1. A *cell* is one nonvolatile value, named after what it is.  Commands store theirs at once
   (MACS-PERS-01, -02); the position is saved by the hardware when the supply fails.
2. ``CELLS`` says under which index a cell is set, where it lies in the EEPROM, how wide, and from
   which quirk its factory value comes (ledger §5.10).
3. The manual fixes one address only: Imax is the RAM byte AFh (MACS-Q-28-01).  All others are this
   twin's own (MACS-AMB-65); what lies between reads 00 in RAM and FF (erased) in EEPROM.

    EEPROM  00 address      01 rate code   02 torque at rest  03 stops      04 torque
            05 catch-up     06 ramp        07 tolerance       08-09 period  0C-0F superior stop
            10-13 inferior stop            14-17 position
    RAM     80-83 position (00 first)      84 torque          85 ramp       86 catch-up
            88-89 period    AF Imax
"""

from collections.abc import Container, Mapping
from dataclasses import dataclass
from typing import Final

from axistwin.devices.mac.axis.quirks import RANGE_MAX, RANGE_MIN, MacQuirks

RATES: Final[dict[int, int]] = {1: 9600, 2: 19200, 3: 38400}
"""Code of 1Bh to baud (MACS-CMD-1B-01)."""

RATE_CODES: Final = {baud: code for code, baud in RATES.items()}


@dataclass(frozen=True, slots=True)
class Cell:
    """One nonvolatile value: where it lies in the EEPROM and what the factory put there.

    factory: a number, or the name of the quirk that holds it.  values: all it can ever hold.
    """

    name: str
    eeprom_address: int
    width: int
    factory: int | str
    values: Container[int]


BYTE: Final = range(0x100)
LONG: Final = range(-(1 << 31), 1 << 31)
STOPS_MODES: Final = (0, 1, 8, 9)
"""Values of 03h: bit 0 hardware, bit 3 software stops (MACS-CMD-03-01)."""

CELLS: Final[tuple[Cell, ...]] = (
    Cell("address", 0x00, 1, 0, range(0x80)),
    Cell("baud", 0x01, 1, 38400, RATE_CODES),
    Cell("standby", 0x02, 1, "factory_standby", (0, 1)),
    Cell("stops", 0x03, 1, "factory_stops", STOPS_MODES),
    Cell("torque", 0x04, 1, "factory_torque", BYTE),  # and not above Imax
    Cell("catchup", 0x05, 1, "factory_catchup", BYTE),
    Cell("ramp", 0x06, 1, "factory_ramp", BYTE),
    Cell("tolerance", 0x07, 1, "factory_tolerance", BYTE),
    Cell("period", 0x08, 2, "factory_period", range(1, 0x10000)),
    Cell("superior_stop", 0x0C, 4, "factory_superior_stop", LONG),
    Cell("inferior_stop", 0x10, 4, "factory_inferior_stop", LONG),
    Cell("position", 0x14, 4, 0, range(RANGE_MIN, RANGE_MAX + 1)),
)

MODES: Final = frozenset({"standby", "stops", "tolerance"})
"""Cells of 02h, 03h, 1Ch, whose storage is not said (MACS-AMB-24)."""

PARAMETERS: Final = tuple(
    cell.name for cell in CELLS if cell.name not in {"address", "baud", "position"}
)


SERIAL_ADDRESSES: Final = range(0x80)


def factory_values(quirks: MacQuirks, addresses: range = SERIAL_ADDRESSES) -> dict[str, int]:
    """Every cell as it leaves the factory (ledger §5.10); the torque limit is within Imax.

    The factory's address is the first of ``addresses`` (MACS-CMD-01-02, MACC-ID-01).
    """
    values = {
        cell.name: cell.factory if isinstance(cell.factory, int) else getattr(quirks, cell.factory)
        for cell in CELLS
    }
    values["torque"] = min(values["torque"], quirks.imax_value)
    values["address"] = addresses[0]
    return values


def admissible(
    cells: Mapping[str, int], quirks: MacQuirks, addresses: range = SERIAL_ADDRESSES
) -> dict[str, int]:
    """Those of ``cells`` that this device knows, with values it could have stored itself."""
    known = {cell.name: cell.values for cell in CELLS}
    known["torque"] = range(quirks.imax_value + 1)
    known["address"] = addresses
    return {name: value for name, value in cells.items() if value in known.get(name, ())}


def eeprom_image(cells: Mapping[str, int]) -> bytes:
    """The 256 bytes that 29h reads (MACS-Q-29-01)."""
    image = bytearray(b"\xff" * 256)
    for cell in CELLS:
        value = cells[cell.name]
        if cell.name == "baud":
            value = RATE_CODES[value]
        bits = (1 << 8 * cell.width) - 1
        end = cell.eeprom_address + cell.width
        image[cell.eeprom_address : end] = (value & bits).to_bytes(cell.width, "big")
    return bytes(image)


def ram_image(cells: Mapping[str, int], imax: int) -> bytes:
    """The 256 bytes that 28h reads; ``cells`` are the values in use (MACS-Q-28-01)."""
    image = bytearray(256)
    image[0x80:0x84] = (cells["position"] & 0xFFFFFFFF).to_bytes(4, "big")
    image[0x84:0x87] = bytes((cells["torque"], cells["ramp"], cells["catchup"]))
    image[0x88:0x8A] = cells["period"].to_bytes(2, "big")
    image[0xAF] = imax
    return bytes(image)


def four_bytes(image: bytes, address: int, *, wraps: bool) -> int:
    """Four bytes from ``address`` upward, first byte first (MACS-AMB-65 beyond FFh)."""
    tail = image if wraps else bytes(4)
    return int.from_bytes((image + tail)[address : address + 4], "big")
