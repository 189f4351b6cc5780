"""Which worker serves which line of a rack."""

from collections.abc import Mapping
from types import MappingProxyType

from axistwin.cli.rack.file import BusSection, RackFile, Section
from axistwin.errors import UsageError


def divide(
    content: RackFile, count: int, placed: Mapping[str, int] = MappingProxyType({})
) -> dict[str, int]:
    """The number of the worker, below ``count``, of each line: by the numbers of devices, the
    largest first.  Those in ``placed`` stay where they are.

    Buses that join the same one are together: an interface may be one of the process.
    """
    loads = [0] * count
    where: dict[str, int] = {}
    free = []
    for unit in _units(content):
        known = next((placed[each.name] for each in unit if each.name in placed), None)
        if known is None:
            free.append(unit)
        else:
            loads[known] += _size(unit)
            where |= {each.name: known for each in unit}
    for unit in sorted(free, key=_size, reverse=True):
        number = loads.index(min(loads))
        loads[number] += _size(unit)
        where |= {each.name: number for each in unit}
    return where


def check_count(path: str, content: RackFile, count: int) -> None:
    """Raise UsageError if there is not a line for each worker."""
    most = len(_units(content))
    if count > max(most, 1):
        raise UsageError(
            f"--workers {count}: a line or bus is served by one worker, and {path} has {most} that "
            f"can be apart; give at most {most}"
        )


def part_of(content: RackFile, names: set[str]) -> RackFile:
    """Only the lines and buses called so."""
    return content.model_copy(
        update={
            "line": [each for each in content.line if each.name in names],
            "bus": [each for each in content.bus if each.name in names],
        }
    )


def _units(content: RackFile) -> list[list[Section]]:
    units: dict[str, list[Section]] = {}
    for section in content.sections.values():
        joined = section.can if isinstance(section, BusSection) else []
        units.setdefault(f"can {joined[0]}" if joined else section.name, []).append(section)
    return list(units.values())


def _size(unit: list[Section]) -> int:
    return sum(len(each.devices) for each in unit)
