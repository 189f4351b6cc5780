"""What the control API answers: the devices of a rack, and their controls, as FastAPI's routes.

Everything comes from the tables of controls (``devices/controls.py``): no family is named here.
What is done to a device is done in the rack's loop, at a time of its line that the answer tells.
"""

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from typing import Annotated, Any, Final, TypeVar

from fastapi import APIRouter, Body, Path, Query, WebSocket
from starlette.responses import JSONResponse, Response

from axistwin.catalog import find_model
from axistwin.control import metrics
from axistwin.control.guard import RefusedError, problem
from axistwin.control.models import (
    AxesInfo,
    BitInfo,
    ControlDone,
    ControlInfo,
    ControlList,
    ControlOrder,
    ControlReading,
    DeviceInfo,
    DeviceList,
    Direction,
    EndpointInfo,
    FaultInfo,
    FaultList,
    FaultNumber,
    FaultOrder,
    LineInfo,
    LineList,
    Numbers,
    PowerDone,
    PowerOrder,
    Problem,
    StateInfo,
    TrafficList,
)
from axistwin.control.traffic import TrafficWords, select
from axistwin.control.watching import Watching, admit
from axistwin.devices.controls import AxisReadout
from axistwin.errors import UnknownNameError, UsageError
from axistwin.kernel.time import NS_PER_S
from axistwin.runtime.control_access import BoundControl
from axistwin.runtime.serving.live import Live
from axistwin.runtime.serving.rack import AnyServer, Rack, RackDevice
from axistwin.wire.faults import FaultReport

ANSWER_S: Final = 10.0
"""How long the loop may take; it is busy for much less."""

PROBLEMS: Final[dict[int | str, dict[str, Any]]] = {
    status: {"model": Problem, "description": description}
    for status, description in (
        (400, "The body cannot be read."),
        (401, "The token is missing, or wrong."),
        (403, "Host or Origin is not this server's."),
        (404, "Nothing is called so; the message has the nearest name."),
        (408, "The body did not come in time."),
        (413, "The body is too long."),
        (422, "The value is not allowed; the message says what is."),
        (503, "The line has failed."),
    )
}
"""What any route may answer instead."""

ResultT = TypeVar("ResultT")

DeviceName = Annotated[str, Path(description="its name, MODEL:ADDRESS, or its model alone")]
LineName = Annotated[str, Path(description="its name, or that of a device on it")]
ControlName = Annotated[str, Path(description="such as inputs.reference, or flags.200")]


class NotAllowedError(UsageError):
    """A value that ``control`` does not take."""

    def __init__(self, message: str, control: BoundControl) -> None:
        super().__init__(message)
        self.control = control


class Api:
    """The routes for ``rack``."""

    def __init__(self, rack: Rack, live: Live, counts: metrics.Counts) -> None:
        self._rack, self._live, self._counts = rack, live, counts

    def router(self) -> APIRouter:
        """All of them."""
        router = APIRouter(prefix="/api/v1", responses=PROBLEMS)
        device, control = "/devices/{device}", "/devices/{device}/controls/{control}"
        get, put, post = router.get, router.put, router.post
        get("/lines", summary="All lines and buses")(self.lines)
        get("/lines/{line}/traffic", summary="What went over a line lately")(self.traffic)
        get("/devices", summary="All devices")(self.devices)
        get(device, summary="One device")(self.device)
        get(f"{device}/state", summary="All that can be seen of it, at one instant")(self.state)
        get(f"{device}/controls", summary="Its controls, with what they take")(self.controls)
        get(control, summary="One control, as it is now")(self.read)
        put(control, summary="Set a control, or work an action")(self.work)
        post(f"{device}/power", summary="Switch its supply")(self.power)
        faults = "/lines/{line}/faults"
        get(faults, summary="Faults of its wire")(self.faults)
        post(faults, summary="Add a fault", status_code=201)(self.add_fault)
        router.delete(faults, summary="Remove all faults")(self.remove_faults)
        router.delete(f"{faults}/{{number}}", summary="Remove a fault")(self.remove_fault)
        router.add_api_websocket_route("/events", self.events)
        return router

    # -- what there is --

    async def lines(self) -> LineList:
        """Where each is found, and whether it is still served."""
        return LineList(lines=[self._line(*each) for each in self._rack.lines.items()])

    def _line(self, name: str, server: AnyServer) -> LineInfo:
        return LineInfo(
            name=name,
            devices=[each.name for each in self._rack.on_line(name)],
            endpoints=[EndpointInfo(kind=port.kind, url=port.url) for port in server.ports],
            failure=None if server.failure is None else str(server.failure),
        )

    async def traffic(
        self,
        line: LineName,
        last: Annotated[int, Query(ge=1, le=1000, description="how many at most")] = 200,
        text: Annotated[str, Query(description="only with this in its words")] = "",
        hexes: Annotated[str, Query(alias="hex", description="only with these bytes")] = "",
        direction: Annotated[Direction | None, Query(description="only from there")] = None,
    ) -> TrafficList:
        """Of those that the line keeps: the last 200 bursts, or 1000 frames."""
        server = self._find_line(line)
        chosen = select(
            TrafficWords(server),
            server.simulation.messages,
            last=last,
            text=text,
            hexes=hexes,
            direction=direction,
        )
        return TrafficList(line=line, messages=chosen)

    def _find_line(self, name: str) -> AnyServer:
        return self._rack.lines[self._rack.find_line(name)]

    async def devices(self) -> DeviceList:
        """Those of lines that are served."""
        return DeviceList(devices=await self._wait(self._rack.do_all(_device_info)))

    async def device(self, device: DeviceName) -> DeviceInfo:
        """As it is now."""
        return await self._do(device, _device_info)

    async def state(self, device: DeviceName) -> StateInfo:
        """Of controls with numbers, those of a few."""

        def read(found: RackDevice) -> StateInfo:
            time_ns, values = found.twin.controls.read_all()
            return StateInfo(device=found.name, time_ns=time_ns, values=values)

        return await self._do(device, read)

    async def controls(self, device: DeviceName) -> ControlList:
        """Names, kinds, limits and values."""

        def read(found: RackDevice) -> ControlList:
            time_ns, values = found.twin.controls.read_all()
            controls = [
                _control_info(each, values.get(name))
                for name, each in found.twin.controls.items()
                if each.kind != "program"
            ]
            return ControlList(device=found.name, time_ns=time_ns, controls=controls)

        return await self._do(device, read)

    # -- one control --

    async def read(self, device: DeviceName, control: ControlName) -> ControlReading:
        """NAME.NUMBER of a control with numbers; by the names of the device's program, too."""

        def read(found: RackDevice) -> ControlReading:
            bound = _find(found, control)
            with found.server.simulation.present() as time_ns:
                has_value = bound.is_readable and not bound.has_numbers
                info = _control_info(bound, bound.value if has_value else None)
                return ControlReading(**info.model_dump(), device=found.name, time_ns=time_ns)

        return await self._do(device, read)

    async def work(
        self, device: DeviceName, control: ControlName, order: Annotated[ControlOrder, Body()]
    ) -> ControlDone:
        """At the time of the line that the answer has."""

        def work(found: RackDevice) -> ControlDone:
            bound = _find(found, control)
            try:
                time_ns = bound.set(order.value)
            except UnknownNameError:
                raise
            except UsageError as error:
                raise NotAllowedError(str(error), bound) from None
            value = bound.value if bound.is_readable else None
            return ControlDone(device=found.name, control=bound.name, time_ns=time_ns, value=value)

        return await self._do(device, work)

    # -- the supply --

    async def power(self, device: DeviceName, order: Annotated[PowerOrder, Body()]) -> PowerDone:
        """Off, on, or both; answered when it is done."""
        off_ns = on_ns = None
        if order.action != "on":
            name, off_ns, delay_s = await self._do(
                device, lambda found: self._cut(found, order.off_s)
            )
        if order.action == "cycle":
            await asyncio.sleep(delay_s)
        if order.action != "off":
            name, on_ns = await self._do(device, self._apply)
        return PowerDone(
            device=name, power=order.action != "off", off_time_ns=off_ns, on_time_ns=on_ns
        )

    def _cut(self, found: RackDevice, off_s: float) -> tuple[str, int, float]:
        """Name, when the supply was cut, and seconds until ``off_s`` of its line have passed."""
        time_ns = found.twin.controls["power"].set(False)
        clock = found.server.simulation.clock
        return found.name, time_ns, clock.delay_s(time_ns + round(off_s * NS_PER_S))

    def _apply(self, found: RackDevice) -> tuple[str, int]:
        time_ns = found.twin.controls["power"].set(True)
        return found.name, time_ns

    # -- what goes wrong on the wire --

    async def faults(self, line: LineName) -> FaultList:
        """With what each has done so far."""
        return await self._on_line(line, _fault_list)

    async def add_fault(self, line: LineName, order: Annotated[FaultOrder, Body()]) -> FaultInfo:
        """It acts from now on."""

        def add(found: RackDevice) -> FaultInfo:
            faults = found.server.simulation.faults
            return _fault_info(found, faults[faults.add(**order.model_dump())])

        return await self._on_line(line, add)

    async def remove_faults(self, line: LineName) -> FaultList:
        """With what each has done."""

        def remove(found: RackDevice) -> FaultList:
            removed = _fault_list(found)
            found.server.simulation.faults.clear()
            return removed

        return await self._on_line(line, remove)

    async def remove_fault(self, line: LineName, number: FaultNumber) -> FaultInfo:
        """With what it has done; what it is doing ends."""
        return await self._on_line(
            line, lambda found: _fault_info(found, found.server.simulation.faults.remove(number))
        )

    # -- looking on --

    async def events(
        self,
        client: WebSocket,
        device: Annotated[list[str] | None, Query()] = None,
        traffic: Annotated[list[str] | None, Query()] = None,
    ) -> None:
        """What happens to the devices, and what goes over lines.

        ``?device=NAME`` and ``?traffic=LINE``, both repeatable; all devices without either.  Of all
        lines it is told when they come, go or fail; ``?device=`` alone: only that.
        """
        try:
            named = [each for each in device or () if each]
            names = [await self._do(each, lambda found: found.name) for each in named]
            words = {each: TrafficWords(self._find_line(each)) for each in traffic or ()}
            is_of_all = not device and not traffic
            if is_of_all:
                names = await self._wait(self._rack.do_all(_name))
        except UsageError as error:
            await client.send_denial_response(JSONResponse(problem(404, str(error)), 404))
            return
        live, counts = self._live, self._counts

        async def run() -> None:
            await Watching(
                self._rack, live, counts, client, names, words, is_of_all=is_of_all
            ).run()

        await admit(client, counts, run)

    async def metrics(self) -> Response:
        """For Prometheus."""
        values = await self._wait(
            self._rack.do_all(
                lambda found: (found.name, found.twin.controls.read_all(is_live=True))
            )
        )
        failures = {name: each.failure is not None for name, each in self._rack.lines.items()}
        acted = await self._wait(
            self._rack.do_all(lambda found: (found.line, found.server.simulation.faults.acted))
        )
        text = metrics.render(dict(values), failures, dict(acted), self._counts)
        return Response(text, media_type=metrics.CONTENT_TYPE)

    # -- in the rack's loop --

    async def _on_line(self, line: str, action: Callable[[RackDevice], ResultT]) -> ResultT:
        """Have ``action`` done to the first device on ``line``."""
        return await self._do(self._rack.on_line(self._rack.find_line(line))[0].name, action)

    async def _do(self, device: str, action: Callable[[RackDevice], ResultT]) -> ResultT:
        return await self._wait(self._rack.do(device, action))

    async def _wait(self, future: Future[ResultT]) -> ResultT:
        try:
            return await asyncio.wait_for(asyncio.wrap_future(future), ANSWER_S)
        except TimeoutError:
            raise RefusedError(503, "the devices are busy; try again") from None


def _name(found: RackDevice) -> str:
    return found.name


def _device_info(found: RackDevice) -> DeviceInfo:
    twin = found.twin
    axes = find_model(twin.model).family.axis_readout()
    return DeviceInfo(
        name=found.name,
        model=twin.model,
        address=twin.address,
        line=found.line,
        power=twin.is_powered,
        state=twin.controls["state"].value,
        axes=None if axes is None else _axes_info(axes),
    )


def _axes_info(axes: AxisReadout) -> AxesInfo:
    return AxesInfo(names=list(axes.names), unit=axes.unit, position=axes.position, rate=axes.rate)


def _fault_info(found: RackDevice, report: FaultReport) -> FaultInfo:
    return FaultInfo(
        **report.fault.selection(),
        number=report.number,
        line=found.line,
        seen=report.seen,
        acted=report.acted,
        over=report.is_over,
        last_ns=report.last_ns,
        last=report.last,
    )


def _fault_list(found: RackDevice) -> FaultList:
    reports = found.server.simulation.faults
    return FaultList(line=found.line, faults=[_fault_info(found, each) for each in reports])


def _find(found: RackDevice, name: str) -> BoundControl:
    """The control called ``name``; none that takes a program, which the network does not give."""
    try:
        bound = found.twin.controls[name]
    except UsageError as error:  # also a name that the device's program has not
        raise UnknownNameError(str(error)) from None
    if bound.kind == "program":
        raise UnknownNameError(f"{name} takes a program, and none is taken from the network")
    return bound


def _numbers(bound: BoundControl) -> Numbers | None:
    keys = bound.keys
    return Numbers(first=keys[0], last=keys[-1]) if isinstance(keys, range) else None


def _control_info(bound: BoundControl, value: Any) -> ControlInfo:
    return ControlInfo(
        name=bound.name,
        kind=bound.kind,
        doc=bound.doc,
        unit=bound.unit,
        low=bound.low,
        high=bound.high,
        choices=list(bound.choices),
        numbers=_numbers(bound),
        bits=[BitInfo(bit=n, name=name, requirement=law) for n, name, law in bound.bits],
        queue=bound.is_queue,
        readable=bound.is_readable,
        writable=bound.is_writable,
        value=value,
    )
