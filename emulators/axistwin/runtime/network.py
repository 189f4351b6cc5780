"""One line with its devices and the host's end of it: everything that happens, in order.

Rules
-----
1. Events run in the order of time.  At one nanosecond: first the bytes that are complete then (by
   station), then the devices that want to be woken, by index.  So a byte that arrives just when a
   motion ends is heard before the device is woken for that end.
2. Bytes are handed over in stretches, never beyond the next wake-up of any device, and never
   beyond the first byte to which any listener may react (``SerialDevice.quiet_prefix``): what a
   device does is on the line before anybody hears a later byte.  Quiet bytes are also expected not
   to bring a wake-up forward into the stretch that they are part of.
3. A ``Transmit`` goes out in the line format that the device has when its call returns, at its
   ``start_ns`` or when its earlier ones are sent.  ``Store`` and ``Trace`` are queued for the
   shell, which must perform the stores before it passes on any byte.
4. The host's receive buffer holds ``HOST_BUFFER_BYTES``; what arrives when it is full is lost and
   counted, as in a UART that is not read.
5. Whoever calls a device's methods from outside does so at ``now_ns``, and hands the effects to
   ``perform``.  The supply goes through ``power_off`` and ``power_on`` here: the line must know.
"""

from collections.abc import Iterable, Sequence
from typing import Final

from axistwin.devices.base import SerialDevice
from axistwin.kernel.effects import Effect, Silence, Store, Trace, Transmit
from axistwin.kernel.time import Nanos
from axistwin.runtime.audience import Audience
from axistwin.runtime.device_network import DeviceNetwork
from axistwin.wire.duplex_line import DuplexLine
from axistwin.wire.faults import Disturbance, WireFaults
from axistwin.wire.framing import Chunk, LineFormat
from axistwin.wire.instant_line import InstantLine
from axistwin.wire.serial_line import HOST, STRETCH_BYTES, SerialLine
from axistwin.wire.wire_fault import WireFault

HOST_BUFFER_BYTES: Final = 65536

RATE_TOLERANCE_PARTS: Final = 17
"""Rates may differ by one part in so many: half a bit, when bit 7 is sampled after 8.5 bits."""


class SerialNetwork(DeviceNetwork[SerialDevice]):
    """The pair, the devices on it, and the host's end.

    paced: bytes take their time; otherwise none (see ``wire/instant_line.py``).  Each direction has
    wires of its own if all devices are made for that.
    host_format: the host's format; by default that of the first device.
    ``host_overruns`` counts the bytes lost because the host's buffer was full.
    ``is_host_understood``: whether the host's rate is near enough to a device's for its UART.
    """

    def __init__(
        self,
        devices: Sequence[SerialDevice],
        *,
        start_ns: Nanos = 0,
        paced: bool = True,
        host_format: LineFormat | None = None,
        faults: WireFaults | None = None,
    ) -> None:
        assert devices, "a line has at least one device"
        super().__init__(devices, start_ns, faults or WireFaults("serial"))
        self.host_overruns = 0
        formats = [each.line_format for each in self.devices]
        all_formats = [host_format or formats[0], *formats]
        self._line: SerialLine | InstantLine | DuplexLine
        if all(device.is_full_duplex for device in self.devices):
            self._line = DuplexLine(all_formats, start_ns, paced=paced)
        else:
            self._line = (SerialLine if paced else InstantLine)(all_formats, start_ns)
        self._formats = formats
        self.is_host_understood = self._understands_host()
        self._is_paced = paced
        self._is_lone = len(devices) == 1
        self._hear_one_another = not (self._is_lone or isinstance(self._line, DuplexLine))
        self._audience = Audience(self.devices)
        self._drops_bad = [getattr(each, "drops_bad_characters", False) for each in self.devices]
        self.asked_ns: Nanos | None = None
        self._received = bytearray()
        self._unpowered: set[int] = set()

    # -- time --

    def next_wake(self) -> Nanos | None:
        """When the next device wants to be woken."""
        return self._schedule.next_event()

    def next_event(self, host_bytes: int = 1) -> Nanos | None:
        """When something is next due: a wake-up, bytes for the host, a possible reaction.

        host_bytes: of a stretch that goes to the host, the byte (from 1) worth waiting for; the
        last of the stretch if it is shorter.  May be too early, never too late; None when nothing
        can happen any more by itself.
        """
        due_ns = self._schedule.next_event()
        if self._line.is_silent:
            return due_ns
        stretch = self._line.peek_stretch()
        if stretch is None:
            arrival_ns = self._line.next_arrival()
        else:
            chunk, stations = stretch
            last = len(chunk.data) - 1
            if HOST in stations:
                last = min(last, host_bytes - 1)
            quiet = self._quiet_bytes(chunk.data, stations) if last else 0
            arrival_ns = chunk.arrival_ns(min(quiet, last))
        if arrival_ns is None or (due_ns is not None and due_ns < arrival_ns):
            return due_ns
        return arrival_ns

    @property
    def is_silent(self) -> bool:
        """Whether no byte is on its way."""
        return self._line.is_silent

    def run_until(self, now: Nanos) -> None:
        """Let everything happen that is due by ``now``, then stand at ``now``."""
        schedule = self._schedule
        assert now >= schedule.now, f"time went back from {schedule.now} to {now} ns"
        if now == self.settled_ns:
            return
        if self._line.is_silent and schedule.is_idle_until(now):
            self._line.now_ns = schedule.now = self.settled_ns = now  # by far the most common
            return
        while True:
            due_ns = schedule.next_event()
            horizon_ns = now if due_ns is None or due_ns > now else due_ns
            while (offer := self._line.offer(horizon_ns)) is not None:
                self._hear(*offer)
                due_ns = schedule.next_event()
                if due_ns is not None and due_ns < horizon_ns:
                    horizon_ns = due_ns
            if not schedule.run_next(horizon_ns) and horizon_ns == now:
                break
        schedule.now = self.settled_ns = now

    def run_until_heard(self, count: int, limit_ns: Nanos | None) -> Nanos:
        """Let things happen until the host has ``count`` bytes, but none behind ``limit_ns``.

        Stops earlier when there are effects to take and, without a limit, when nothing can happen
        any more by itself.  Returns the time reached, at which more may be due (``run_until``).
        """
        schedule, line = self._schedule, self._line
        self.settled_ns = None
        while len(self._received) < count and not self._effects:
            due_ns = schedule.next_event()
            horizon_ns = due_ns
            if due_ns is None or (limit_ns is not None and limit_ns < due_ns):
                horizon_ns = self._next_stretch_ns() if limit_ns is None else limit_ns
            if horizon_ns is None:
                break
            offer = line.offer(horizon_ns)
            if offer is not None:
                chunk, stations = offer
                if HOST in stations:
                    chunk = chunk.first(count - len(self._received))
                self._hear(chunk, stations)
            elif horizon_ns == due_ns:
                schedule.run_next(horizon_ns)
            else:
                schedule.now = horizon_ns
                if horizon_ns == limit_ns:
                    break
        return schedule.now

    def _next_stretch_ns(self) -> Nanos | None:
        """When what is on its way is complete, or its first part of it; None: nothing is."""
        stretch = self._line.peek_stretch()
        if stretch is None:
            return self._line.next_arrival()
        data = stretch[0].data
        return stretch[0].arrival_ns(len(data) - 1)

    def _hear(self, chunk: Chunk, stations: tuple[int, ...]) -> None:
        """Hand over as much of ``chunk`` as surely happens before anybody reacts."""
        if not self.faults.is_idle:
            stations = self._still_heard(chunk, stations)
            if not stations:
                self._line.accept(len(chunk.data))
                self._schedule.now = self._line.now_ns
                return
        if stations == (HOST,):
            self._line.accept(len(chunk.data))
            self._schedule.now = self._line.now_ns
            self._host_hears(chunk.data)
            return
        heard, errors = chunk, chunk.errors
        if errors:
            if all(self._drops_bad[station - 1] for station in stations):
                heard = chunk.without_errors()
            else:  # a bad one comes alone
                errors = ()
                heard = chunk = chunk.first(chunk.errors[0] or 1)
        asked = self._audience.heard_by(stations)
        last = self._audience.quiet_prefix(heard.data, asked)
        if last < len(heard.data):
            heard = heard.first(last + 1)
            for place in errors:
                last += place <= last
            self._line.accept(last + 1)
        else:
            self._line.accept(len(chunk.data))
        self._schedule.now = self._line.now_ns
        if not heard.data:
            return
        if stations[:1] == (HOST,):
            self._host_hears(heard.data)
        self._devices_hear(heard, asked)

    def _devices_hear(self, chunk: Chunk, asked: Sequence[int]) -> None:
        """Let ``asked`` and those who heed it take ``chunk``; the rest has heard it then."""
        audience, now = self._audience, self._schedule.now
        for index in audience.call_up(chunk.data, asked):
            device = self.devices[index]
            if not (chunk.errors and self._drops_bad[index]):
                effects = device.receive(chunk)
                if effects or device.line_format is not self._formats[index]:
                    self.apply(index, effects)
                self._schedule.touch(index)
                audience.come_back(index, now)

    def _quiet_bytes(self, data: bytes, stations: tuple[int, ...]) -> int:
        """How many leading bytes of ``data`` surely make none of ``stations`` react."""
        if stations == (HOST,):
            return len(data)
        return self._audience.quiet_prefix(data, self._audience.heard_by(stations))

    def _host_hears(self, data: bytes) -> None:
        room = HOST_BUFFER_BYTES - len(self._received)
        if len(data) > room:
            self.host_overruns += len(data) - room
            data = data[:room]
        self._received += data

    # -- the devices --

    def apply(self, index: int, effects: Iterable[Effect]) -> None:
        """Put ``effects`` on the line or in the queue; the caller sees to the next event."""
        self.settled_ns = None
        self._audience.leave(index)
        self._follow_format(index)
        for effect in effects:
            if type(effect) is Transmit:
                self._send(index + 1, effect.start_ns, effect.data)
            elif type(effect) is Silence:
                self._line.switch_off(index + 1)
                self._line.switch_on(index + 1)
            else:
                assert isinstance(effect, Store | Trace), "a line has no frames"
                self._effects.append((index, effect))

    def _follow_format(self, index: int) -> None:
        line_format = self.devices[index].line_format
        if line_format is not self._formats[index]:
            self._formats[index] = line_format
            self._line.set_format(index + 1, line_format)
            self.is_host_understood = self._understands_host()

    def _switch(self, index: int, *, on: bool) -> None:
        (self._unpowered.discard if on else self._unpowered.add)(index)
        self._audience.leave(index)
        (self._line.switch_on if on else self._line.switch_off)(index + 1)

    # -- the host's end --

    @property
    def host_format(self) -> LineFormat:
        """The host's rate and framing; setting it affects what is queued and heard from now on."""
        return self._line.format_of(HOST)

    @host_format.setter
    def host_format(self, line_format: LineFormat) -> None:
        self.settled_ns = None
        self._line.set_format(HOST, line_format)
        self.is_host_understood = self._understands_host()

    def host_send(self, data: bytes) -> None:
        """Queue ``data`` behind what the host still sends."""
        if not self._is_paced:  # else it takes time until something is heard of it
            self.settled_ns = None
        self._send(HOST, self.now_ns, data)

    def host_exchange(self, now: Nanos, data: bytes) -> None:
        """Let all happen that is due by ``now``, send ``data``, and let happen what that brings."""
        if not self._reacts_at_once(now, data):
            self.run_until(now)
            self.host_send(data)
        self.run_until(now)

    def _reacts_at_once(self, now: Nanos, data: bytes) -> bool:
        """Send ``data`` at ``now`` the short way, if there is one; the outcome is the same.

        Without pacing a lone device hears the host's bytes when they are sent, and the host its
        answer: neither needs to wait on the line for others that might disturb it.
        """
        line, schedule = self._line, self._schedule
        if not (
            line.is_transparent
            and self._is_lone
            and self.faults.is_idle
            and 0 < len(data) <= STRETCH_BYTES
            and schedule.is_idle_until(now)
        ):
            return False
        device = self.devices[0]
        if device.quiet_prefix(data) < len(data) - 1:
            return False
        line.now_ns = schedule.now = now
        effects: Sequence[Effect] = device.receive(Chunk(now, data, None))
        if device.line_format is self._formats[0] and (
            len(effects) == 1 and type(reply := effects[0]) is Transmit and reply.start_ns <= now
        ):
            self._host_hears(reply.data)
            effects = ()
        self.apply(0, effects)
        schedule.touch(0)
        return True

    def host_ask(self, data: bytes, size: int, limit_ns: Nanos) -> bytes | None:
        """Send ``data``, and be where the host has ``size`` bytes, or at ``limit_ns``: heard.

        No ``data``: only what is still being sent, and listen.
        None: there is no short way, nothing has happened, and ``data`` is to be sent; or it is sent
        and the outcome to be waited for, since something else happens before, or the answer is
        longer.  ``asked_ns`` tells which: when ``data`` began to be sent.  Effects may be left to
        take.
        """
        line, schedule, line_format = self._line, self._schedule, self._formats[0]
        self.asked_ns = None
        is_direct = self.faults.is_idle and not self._received
        ahead = line.ahead_of_host() if is_direct else None
        if ahead is None:
            return None
        began_ns, sending, skipped = ahead
        start_ns = began_ns
        if sending:
            start_ns += line_format.span_ns(skipped + len(sending))
            data = sending + data
        if not data:
            self.asked_ns = start_ns
            return b"" if self._stays_silent(limit_ns) else None
        count = len(data)
        heard_ns = began_ns + line_format.span_ns(skipped + count)
        index: int | None = 0
        if not self._is_lone or self.devices[0].quiet_prefix(data) < count - 1:
            index = self._audience.only_one_to_react(data)
        if (
            index is None
            or heard_ns > limit_ns
            or count > STRETCH_BYTES
            or not schedule.is_idle_until(heard_ns)
        ):
            return None
        if sending:
            line.forget()
        self.asked_ns = start_ns
        line.now_ns = schedule.now = heard_ns
        chunk = Chunk(began_ns, data, line_format, skipped)
        if not self._is_lone:
            self._audience.leave(index)
            self._others_hear(index, chunk)
        return self._hear_out(index, self.devices[index].receive(chunk), size, limit_ns)

    def _hear_out(
        self, index: int, effects: Sequence[Effect], size: int, limit_ns: Nanos
    ) -> bytes | None:
        """What device ``index`` says, whose ``effects`` have come now: ``host_ask``."""
        device, schedule, line_format = self.devices[index], self._schedule, self._formats[index]
        now = begin_ns = end_ns = schedule.now
        sent = 0  # of the stretch that began then
        answers: list[tuple[Nanos, bytes, int]] = []
        while True:
            former, rest = len(answers), []
            for effect in effects:
                if type(effect) is Transmit:
                    start_ns, data = effect
                    if start_ns >= end_ns or now >= end_ns:
                        begin_ns, sent = start_ns if start_ns > now else now, 0
                    answers.append((begin_ns, data, sent))
                    sent += len(data)
                    end_ns = begin_ns + line_format.span_ns(sent)
                    size -= len(data)
                else:
                    rest.append(effect)
            until_ns = limit_ns if size else end_ns
            if (
                size < 0
                or end_ns > limit_ns
                or device.line_format is not line_format
                or not (self._is_lone or self._lets_pass(index, answers, until_ns))
            ):
                for begin_ns, data, _ in answers[:former]:
                    self._line.transmit(index + 1, begin_ns, data)
                self.apply(index, effects)
                schedule.touch(index)
                return None
            if rest:
                self.apply(index, rest)
            due_ns = schedule.touch(index)
            if due_ns > until_ns or (due_ns == end_ns and not size):
                break
            schedule.now = now = due_ns
            effects = device.wake(due_ns)
        if self._hear_one_another:
            for begin_ns, data, sent in answers:
                self._others_hear(index, Chunk(begin_ns, data, line_format, sent))
        self._line.now_ns = schedule.now = until_ns
        if due_ns == until_ns:  # what it says now is none of this answer
            self.perform(index, device.wake(due_ns))
        self.settled_ns = until_ns
        return answers[0][1] if len(answers) == 1 else b"".join([data for _, data, _ in answers])

    def _lets_pass(
        self, index: int, answers: Sequence[tuple[Nanos, bytes, int]], until_ns: Nanos
    ) -> bool:
        """Whether nobody but ``index`` has anything to do until then, its ``answers`` heard."""
        if not self._schedule.is_idle_until(until_ns, but=index):
            return False
        if not self._hear_one_another:
            return True
        data, audience = b"".join([said for _, said, _ in answers]), self._audience
        return audience.quiet_prefix(data, audience.others(index)) == len(data)

    def _stays_silent(self, limit_ns: Nanos) -> bool:
        """Be at ``limit_ns`` if nobody sends anything by then; False: somebody does, before."""
        line, schedule = self._line, self._schedule
        while (due_ns := schedule.next_event()) is not None and due_ns <= limit_ns:
            line.now_ns = due_ns
            schedule.run_next(due_ns)
            if not line.is_silent:
                return False
        line.now_ns = schedule.now = self.settled_ns = limit_ns
        return True

    def _others_hear(self, index: int, chunk: Chunk) -> None:
        """All devices but ``index``, which is asked by itself, take ``chunk`` without reacting."""
        audience = self._audience
        audience.overhear(chunk.data)
        for place in audience.others(index):
            assert not self.devices[place].receive(chunk), "a device has reacted that would not"
            self._schedule.touch(place)
            audience.come_back(place, self._schedule.now)

    def send_break(self, duration_ns: Nanos) -> None:
        """Hold the line at space for ``duration_ns`` (> 0), queued behind the host's bytes."""
        self.settled_ns = None
        self._line.send_break(HOST, self.now_ns, duration_ns)

    def host_purge_output(self) -> None:
        """Drop the host's bytes whose start bit has not begun."""
        self.settled_ns = None
        self._line.purge(HOST)

    @property
    def device_bauds(self) -> tuple[int, ...]:
        """The rates that the devices listen at now, each once, in their order."""
        return tuple(dict.fromkeys(each.baud for each in self._formats))

    def _understands_host(self) -> bool:
        rate = self._line.format_of(HOST).baud
        return any(
            abs(each.baud - rate) * RATE_TOLERANCE_PARTS <= each.baud for each in self._formats
        )

    @property
    def host_backlog(self) -> int:
        """How many of the host's bytes are not on the line yet."""
        return self._line.backlog(HOST)

    @property
    def host_sent_ns(self) -> Nanos:
        """When the last of the host's bytes has left it; now, if nothing is queued."""
        return self._line.sent_ns(HOST)

    @property
    def host_available(self) -> int:
        """How many bytes have arrived at the host and were not taken."""
        return len(self._received)

    @property
    def host_upcoming(self) -> bytes:
        """What the host will take next: what has arrived, and what surely follows on the line."""
        stretch = self._line.peek_stretch()
        if stretch is None or HOST not in stretch[1]:
            return bytes(self._received)
        return bytes(self._received) + stretch[0].data

    def host_take(self, limit: int | None = None) -> bytes:
        """Take the bytes that have arrived by now, ``limit`` (>= 0) of them at most."""
        if limit is None or limit >= len(self._received):
            data = bytes(self._received)
            self._received.clear()
        else:
            data = bytes(self._received[:limit])
            del self._received[:limit]
        return data

    def next_host_byte_ns(self) -> Nanos | None:
        """When the next byte under way to the host is complete, as far as is known; else None."""
        return self._line.next_arrival_at(HOST)

    # -- what goes wrong on the line --

    def _send(self, station: int, start_ns: Nanos, data: bytes) -> None:
        """Put on the line what the faults make of ``data``."""
        line, passage = self._line, None
        if not self.faults.is_idle and data:
            first_ns, bits = max(start_ns, line.sent_ns(station)), line.format_of(station).data_bits
            passage = self.faults.passage(first_ns, data, to_host=station != HOST, data_bits=bits)
            self._touch_faults()
        if passage is None:
            line.transmit(station, start_ns, data)
            return
        if passage.break_ns:
            line.send_break(station, start_ns, passage.break_ns)
        for gap_ns, piece in passage.pieces:
            line.transmit(station, max(start_ns, line.sent_ns(station)) + gap_ns, piece)

    def _still_heard(self, chunk: Chunk, stations: tuple[int, ...]) -> tuple[int, ...]:
        """Those of ``stations`` to whom the line is not cut."""
        arrival_ns = chunk.arrival_ns(0)
        if self.faults.is_lost(arrival_ns, to_host=True):
            stations = tuple(each for each in stations if each != HOST)
        if self.faults.is_lost(arrival_ns, to_host=False):
            stations = tuple(each for each in stations if each == HOST)
        return stations

    def _disturb(self, disturbance: Disturbance) -> None:
        kind, fault, value = disturbance
        if kind == "break":
            for station in (HOST, 1):
                if fault.concerns(to_host=station != HOST):
                    self._line.send_break(station, self.now_ns, value)
        elif kind == "busy":
            self._all_hear(Chunk(self.now_ns, b"\0", None, errors=(0,)), fault)
        elif self._line.is_silent:
            self._all_hear(Chunk(self.now_ns, bytes([value]), None), fault)

    def _all_hear(self, chunk: Chunk, fault: WireFault) -> None:
        """Let everybody in the direction of ``fault`` take the one byte of ``chunk``, now."""
        if fault.concerns(to_host=True):
            self._host_hears(chunk.data)
        if fault.concerns(to_host=False):
            stations = [at + 1 for at in range(len(self.devices)) if at not in self._unpowered]
            if not (chunk.errors and all(self._drops_bad[each - 1] for each in stations)):
                self._devices_hear(chunk, self._audience.heard_by(stations))
