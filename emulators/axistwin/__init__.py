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
