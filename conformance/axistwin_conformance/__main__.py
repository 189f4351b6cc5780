"""`python -m axistwin_conformance` is `axistwin conform`."""

from axistwin_conformance.cli import conform

if __name__ == "__main__":
    conform(prog_name="axistwin conform")
