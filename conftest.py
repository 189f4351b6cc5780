"""What holds for all tests, of twins and of the suite."""

import signal


def pytest_configure() -> None:
    """Heed Ctrl-C and hang-ups, and let programs under test do so: a shell has what it starts in
    the background ignore SIGINT, and nohup SIGHUP, which whoever is started from there inherits."""
    for number, handler in (
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGHUP, signal.SIG_DFL),
    ):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)
