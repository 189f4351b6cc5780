"""``python -m axistwin`` is the program ``axistwin``."""

from axistwin.cli.main import main

main()
