"""Braking ordered again and again while the shaft still runs out."""

import serial
from mac_frames import ACCEPTED, ANSWER_LENGTH, answer_value, request

import axistwin as _axistwin  # noqa: F401  registers the URL scheme

ORDERS = 60


def test_a_row_of_stops_while_the_shaft_runs_out_is_answered_like_one() -> None:
    """The exact speed of a shaft that brakes does not grow without bound with each 18h."""
    url = "axistwin://mac23:0?time=virtual&quirk.brake_increments=65535"
    with serial.serial_for_url(url, baudrate=38400, timeout=0.1) as port:

        def send(index: int, parameter: int = 0, length: int = 3) -> bytes:
            port.write(request(index, parameter))
            return bytes(port.read(length))

        for index, parameter in ((0x02, 0), (0x0F, 0), (0x15, 100)):
            assert send(index, parameter) == ACCEPTED
        places = []
        for _ in range(ORDERS):
            assert send(0x18) == ACCEPTED
            places.append(answer_value(send(0x20, 0, ANSWER_LENGTH)))
        assert places == sorted(places)
        assert places[0] < places[-1]
