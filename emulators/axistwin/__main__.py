"""``python -m axistwin`` is the program ``axistwin``."""

import signal

# Ctrl-C while the program is still being loaded ends it without a word.
_asks_python = signal.getsignal(signal.SIGINT) is signal.default_int_handler
if __name__ == "__main__" and _asks_python:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from axistwin.cli.main import main  # noqa: E402

if __name__ == "__main__":
    if _asks_python:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    main()
