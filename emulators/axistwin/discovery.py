"""What all families bring: whatever lies below ``axistwin.devices`` and has a ``family.py``."""

import importlib
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

from axistwin import devices
from axistwin.devices.family import Model
from axistwin.errors import UsageError


@cache
def models() -> Mapping[str, Model]:
    """All models by name: by their folders, and what a serial line has before what a bus has.

    Raises UsageError if two families declare the same model.
    """
    found: dict[str, Model] = {}
    for _, model in sorted(_declared(), key=lambda each: (each[0], each[1].carrier != "serial")):
        if found.setdefault(model.name, model) is not model:
            raise UsageError(f"two families declare the model {model.name}; remove one of them")
    return found


@cache
def profiles() -> Mapping[str, Path]:
    """The profiles that come with the families: ``profiles/NAME.toml`` beside a ``family.py``."""
    return {
        path.stem: path
        for root, parts in sorted(_folders())
        for path in sorted(root.joinpath(*parts, "profiles").glob("*.toml"))
    }


def _folders() -> set[tuple[Path, tuple[str, ...]]]:
    """Each folder with a ``family.py``, as its root and the way from there."""
    return {
        (root, path.relative_to(root).parent.parts)
        for root in map(Path, devices.__path__)
        for pattern in ("*/family.py", "*/*/family.py")
        for path in root.glob(pattern)
    }


def _declared() -> Iterator[tuple[str, Model]]:
    """Each model with the folder below ``axistwin.devices`` that it comes from."""
    for parts in sorted({parts for _, parts in _folders()}):
        module = importlib.import_module(".".join(("axistwin.devices", *parts, "family")))
        for model in module.MODELS:
            yield parts[0], model
