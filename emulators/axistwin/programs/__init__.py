"""Macroprograms by name: those that come with axistwin, and those in a user's files."""

import contextlib
import importlib
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Final, TypeAlias

from axistwin.errors import UsageError, nearest
from axistwin.macroprogram.program import Macroprogram, Program, located

__all__ = ["BUILT_IN", "Program", "ProgramSource", "find_program"]

ProgramSource: TypeAlias = str | Path | Program
"""``FILE.py``, ``FILE.py:CLASS``, the name of a program that comes with axistwin, or a class."""

BUILT_IN: Final = {"bench": ("axistwin.programs.bench", "Bench")}
"""Module and class of each program that comes with axistwin."""


def find_program(source: ProgramSource) -> Program:
    """The program that ``source`` means.

    A file is run anew each time.  Raises UsageError: one line with the file and, where there is
    one, the line that is wrong.
    """
    if not isinstance(source, str | Path):
        return source
    text = str(source)
    path, colon, name = text.rpartition(":")
    if not (colon and path.endswith(".py")):
        path, name = text, ""
    if path.endswith(".py"):
        return _class_of(_run(Path(path)), path, name)
    if text not in BUILT_IN:
        raise UsageError(
            f"unknown program {text!r}: {nearest(text, BUILT_IN)}; one of yours is FILE.py or "
            "FILE.py:CLASS"
        )
    module, name = BUILT_IN[text]
    found: Program = getattr(importlib.import_module(module), name)
    return found


def _run(path: Path) -> ModuleType:
    """The module that the file at ``path`` makes."""
    try:
        source = path.read_bytes()
    except OSError as error:
        raise UsageError(
            f"program {path}: cannot be read ({error.strerror}); give an existing file"
        ) from None
    module = ModuleType(f"axistwin_program_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # as dataclasses and pickles want it
    try:
        with _importable(path.parent):
            exec(_compiled(source, str(path)), vars(module))
    except SyntaxError as error:
        place = f"{error.filename or path}:{error.lineno}" if error.lineno else str(path)
        raise UsageError(f"program {place}: {error.msg}") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever it is, it is the file's mistake
        raise UsageError(f"program {located(error)}") from error
    return module


def _compiled(source: bytes, path: str) -> CodeType:
    """The code in ``source``; whatever is wrong with it is a SyntaxError, as from Python 3.11.4 on:
    before, a NUL was a ValueError."""
    try:
        return compile(source, path, "exec")
    except ValueError as error:
        raise SyntaxError(str(error)) from error


@contextlib.contextmanager
def _importable(folder: Path) -> Iterator[None]:
    """What stands beside a program can be imported by it, as if Python ran it."""
    entry = str(folder.resolve())
    sys.path.insert(0, entry)
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):
            sys.path.remove(entry)


def _class_of(module: ModuleType, path: str, name: str) -> Program:
    """The program called ``name``, or the only one, in the module of the file at ``path``."""
    found = {
        each: value
        for each, value in vars(module).items()
        if inspect.isclass(value)
        and issubclass(value, Macroprogram)
        and value.__module__ == module.__name__
    }
    if name:
        if name not in found:
            remedy = nearest(name, found) if found else "it has no class of Macroprogram"
            raise UsageError(f"program {path}: no class {name}: {remedy}")
        return found[name]
    if len(found) != 1:
        if not found:
            raise UsageError(f"program {path}: has no class derived from Macroprogram; write one")
        classes = " or ".join(f"{path}:{each}" for each in found)
        raise UsageError(f"program {path}: has {len(found)} programs; write {classes}")
    (program,) = found.values()
    return program
