"""Asks whether a pinned package has a known vulnerability (by pip-audit, at the OSV database).

Ends with 1 if one has; without an answer from the database it says so, and ends with 0.  Arguments
are pip-audit's: ``--osv-url URL`` names another place of the database, ``--ignore-vuln ID`` a flaw
that does not concern this project.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

PINS = Path(__file__).parents[1] / "constraints.txt"
TIMEOUT_S = 120.0
SOCKET_TIMEOUT_S = 5
# Just the pins: nothing is resolved, and no package index is asked.
COMMAND = (
    *(sys.executable, "-m", "pip_audit", "--requirement", str(PINS), "--no-deps", "--disable-pip"),
    *("--vulnerability-service", "osv", "--timeout", str(SOCKET_TIMEOUT_S)),
    *("--format", "json", "--progress-spinner", "off"),
)
NO_ANSWER = ("ConnectionError", "HTTPError", "Timeout", "SSLError", "JSONDecodeError", "blocking")
"""Words of what pip-audit says in vain of the network; its status is that of a vulnerability."""


def verdict(status: int, out: str, err: str) -> tuple[int, str]:
    """The status of this program, and what it says."""
    if not out.strip():
        for reason in NO_ANSWER:
            if reason in err:
                return 0, f"not done, the vulnerability database gives no answer ({reason})"
        return 1, f"pip-audit ended with {status}:\n{err.strip()}"
    packages: list[dict[str, Any]] = json.loads(out)["dependencies"]
    looked_up = [each for each in packages if "skip_reason" not in each]
    told = f"{len(looked_up)} of {len(packages)} pins looked up"
    flaws = [
        f"{package['name']} {package['version']}: {flaw['id']}, "
        f"mended in {', '.join(flaw['fix_versions']) or 'no version yet'}"
        for package in looked_up
        for flaw in package["vulns"]
    ]
    if flaws:
        return 1, "\n".join((f"{told}, known vulnerabilities:", *flaws))
    return 0, f"{told}, no known vulnerability"


def main(arguments: list[str]) -> int:
    """Ask, and say what came of it."""
    try:
        asked = subprocess.run(
            (*COMMAND, *arguments), capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
        status, text = verdict(asked.returncode, asked.stdout, asked.stderr)
    except subprocess.TimeoutExpired:
        status, text = verdict(1, "", f"Timeout after {TIMEOUT_S:g} s")
    print(f"audit: {text}")
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
