"""The members of the family, as far as the manual tells them apart (ledger §5.1)."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class MscModel:
    """One model.  has_rflags: it knows RFLAGS (MSC-MOD-01, MSC-MOD-02)."""

    name: str
    has_rflags: bool


MODELS: Final[dict[str, MscModel]] = {
    model.name: model
    for model in (
        MscModel("msc-250", has_rflags=True),
        MscModel("msc-850-32", has_rflags=True),
        MscModel("msc-850", has_rflags=False),
        MscModel("msc-generic", has_rflags=False),
    )
}
"""By name."""
