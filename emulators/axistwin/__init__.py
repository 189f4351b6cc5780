"""Firmware-faithful twins of industrial motion controllers.

Importing this package registers the ``axistwin://`` URL scheme with pyserial::

    import serial, axistwin
    port = serial.serial_for_url("axistwin://mac23?address=0&time=virtual")
"""

try:  # before anything else is loaded, which takes its time
    from axistwin import _starting

    if _starting.is_program():
        _starting.install_signal_handler()
except KeyboardInterrupt:  # amid these very lines
    from axistwin import _starting

    if _starting.is_program():
        _starting.end()
    raise

import serial

__version__ = "0.1.0"

_URL_HANDLERS = "axistwin.urlhandler"
if _URL_HANDLERS not in serial.protocol_handler_packages:
    serial.protocol_handler_packages.append(_URL_HANDLERS)
    _open = serial.Serial.open

    def _open_device(port: serial.Serial) -> None:
        """``serial.Serial.open``, which takes a URL for the name of a file."""
        if str(port.port).startswith("axistwin://"):
            raise serial.SerialException(
                f"{port.port} is a URL: open it with serial.serial_for_url(...) in place of "
                "serial.Serial(...)"
            )
        _open(port)

    serial.Serial.open = _open_device  # type: ignore[method-assign, assignment]
