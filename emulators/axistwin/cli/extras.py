"""What to install where a module of an extra is missing."""

import re
from typing import Final

DISTRIBUTION: Final = "axistwin"


def needed(module: str | None, distribution: str = DISTRIBUTION) -> str:
    """What to pass to pip when ``module`` is missing: all that the extra with it asks for.

    Each by its own name: that of the extra's distribution is nothing that pip finds, unless it is
    published.
    """
    from importlib.metadata import requires

    extras: dict[str, list[str]] = {}
    for line in requires(distribution) or ():
        requirement, _, marker = line.partition(";")
        extras.setdefault(marker.strip(), []).append(requirement.strip())
    wanted = (module or "").partition(".")[0].replace("_", "-").lower()
    for marker, requirements in extras.items():
        names = {re.split(r"[^\w.-]", each, maxsplit=1)[0].lower() for each in requirements}
        if "extra ==" in marker and wanted in {name.replace("_", "-") for name in names}:
            return " ".join(f"'{requirement}'" for requirement in requirements)
    return wanted or distribution
