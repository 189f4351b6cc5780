"""The classes of the suite: one name, one thing; none so large that nobody holds it in his head."""

import importlib
import inspect
import pkgutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis.stateful import RuleBasedStateMachine

import axistwin_conformance

BASES_DEEP_MAX = 2
PUBLIC_MEMBERS_MAX = 40
FOLDER_FILES_MAX = 14
SUITE = Path(axistwin_conformance.__file__).parent


def _classes() -> Iterator[type]:
    """Every class that a file of the suite defines."""
    packages = pkgutil.walk_packages(axistwin_conformance.__path__, "axistwin_conformance.")
    for found in packages:
        if found.name.endswith("__main__"):
            continue
        module = importlib.import_module(found.name)
        for value in vars(module).values():
            if inspect.isclass(value) and value.__module__ == found.name:
                yield value


CLASSES = tuple(_classes())


def own_bases(cls: type) -> list[type]:
    """The class and those of its bases that are the suite's."""
    return [base for base in cls.__mro__ if base.__module__.startswith("axistwin_conformance")]


def public_members(cls: type) -> set[str]:
    """Methods, properties, fields and attributes that the suite gives its instances."""
    members: set[str] = set()
    for base in own_bases(cls):
        members |= {*vars(base), *inspect.get_annotations(base)}
        source = inspect.getsource(base)
        members |= set(_assigned(source))
    return {name for name in members if not name.startswith("_")}


def _assigned(source: str) -> Iterator[str]:
    for line in source.splitlines():
        target, sign, _ = line.strip().partition(" = ")
        for name in target.split(", ") if sign else ():
            attribute = name.removeprefix("self.").partition(":")[0]
            if name.startswith("self.") and attribute.isidentifier():
                yield attribute


def test_class_names_are_unique() -> None:
    """A word stands for one thing in all families."""
    assert len(CLASSES) > 100
    counts = Counter(cls.__name__ for cls in CLASSES)
    assert not [name for name, count in counts.items() if count > 1]


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_a_class_is_shallow_and_small(cls: type) -> None:
    """At most two bases deep and 40 public members."""
    assert len(own_bases(cls)) - 1 <= BASES_DEEP_MAX
    # A state machine has a method for each rule, which nobody but Hypothesis calls.
    if not issubclass(cls, RuleBasedStateMachine):
        assert len(public_members(cls)) <= PUBLIC_MEMBERS_MAX


def test_no_folder_of_the_suite_has_more_than_fourteen_files() -> None:
    """Checks and probes apart, of which a family has as many as it needs."""
    folders = {path.parent for path in SUITE.rglob("*.py")}
    counts = {folder: len(list(folder.glob("*.py"))) for folder in folders}
    assert not [
        folder
        for folder, count in counts.items()
        if count > FOLDER_FILES_MAX and folder.name not in ("checks", "probes")
    ]
