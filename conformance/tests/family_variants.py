"""A family that differs in some of what it is or does."""

import copy
from typing import Any, TypeVar

from axistwin_conformance.core.family import Family

F = TypeVar("F", bound=Family)


def vary(family: F, **changes: Any) -> F:
    """The family with these attributes, or with these functions in the place of its methods."""
    other = copy.copy(family)
    vars(other).update(changes)
    return other
