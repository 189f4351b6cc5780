"""Which worker serves which line of a rack."""

import tomllib

import pytest

from axistwin.cli.rack.division import check_count, divide, part_of
from axistwin.cli.rack.file import RackFile
from axistwin.errors import UsageError


def content(**devices: int) -> RackFile:
    """Lines by name, with so many devices each."""
    return RackFile.model_validate(
        {
            "line": [
                {"name": name, "devices": [f"mac23:{each}" for each in range(count)], "pty": name}
                for name, count in devices.items()
            ]
        }
    )


def test_workers_get_equal_numbers_of_devices() -> None:
    """The largest lines first; the same file is always divided in the same way."""
    file = content(a=1, b=2, c=5, d=1, e=1)
    assert divide(file, 2) == {"a": 1, "b": 1, "c": 0, "d": 1, "e": 1}
    assert divide(file, 3) == {"a": 2, "b": 1, "c": 0, "d": 2, "e": 1}
    assert divide(content(a=1, b=1), 2) == {"a": 0, "b": 1}


def test_what_is_placed_stays_and_others_fill_up() -> None:
    """As a reload needs it."""
    assert divide(content(a=3, b=1, c=1), 2, {"b": 0, "c": 0}) == {"a": 1, "b": 0, "c": 0}


def test_buses_that_join_the_same_one_are_together() -> None:
    """An interface of the process joins nobody elsewhere."""
    file = RackFile.model_validate(
        tomllib.loads(
            "".join(
                f'[[bus]]\nname = "{name}"\ndevices = "mac23-can:1"\ncan = "virtual:{place}"\n'
                for name, place in {"a": "x", "b": "y", "c": "x"}.items()
            )
        )
    )
    assert divide(file, 2) == {"a": 0, "b": 1, "c": 0}
    assert divide(file, 2, {"c": 1}) == {"a": 1, "b": 0, "c": 1}
    with pytest.raises(UsageError, match=r"--workers 3: .* rack\.toml has 2 .* give at most 2"):
        check_count("rack.toml", file, 3)


def test_a_part_is_a_file_with_the_same_state() -> None:
    """Nothing but other lines is missing; as JSON it is read as it was."""
    file = content(a=1, b=2).model_copy(update={"state": "memory"})
    part = part_of(file, {"b"})
    assert list(part.sections) == ["b"]
    assert part.state == "memory"
    assert RackFile.model_validate_json(part.model_dump_json(by_alias=True)) == part
