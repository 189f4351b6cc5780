"""``python -m axistwin`` is the program ``axistwin``."""

from axistwin.cli.main import main

if __name__ == "__main__":
    main()
