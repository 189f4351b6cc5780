"""The application of the control API: routes, one shape for all errors, and the guard around it."""

from collections.abc import Callable
from typing import Any, cast

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Match

from axistwin import __version__
from axistwin.control.api import PROBLEMS, Api, NotAllowedError
from axistwin.control.guard import Application, Guard, RefusedError, problem
from axistwin.control.metrics import Counts
from axistwin.control.panel import make_panel, paths, read_page
from axistwin.errors import StateError, UnknownNameError, UsageError
from axistwin.runtime.serving.live import Live
from axistwin.runtime.serving.rack import Rack

_ABOUT = "What can be worked and seen of twins of motion controllers."


def make_application(
    rack: Rack, live: Live, counts: Counts, host: str, token: str | None
) -> Application:
    """The API for ``rack``, for a server that listens at ``host``; ``token``: None for none."""
    api = Api(rack, live, counts)
    page = read_page()
    # The pages that show the schema would come from other sites.
    application = FastAPI(
        title="axistwin", version=__version__, description=_ABOUT, docs_url=None, redoc_url=None
    )
    application.include_router(api.router())
    application.include_router(make_panel(page))
    application.get(
        "/metrics", summary="For Prometheus", response_class=Response, responses=PROBLEMS
    )(api.metrics)
    for kind, status in ((UnknownNameError, 404), (UsageError, 422), (StateError, 503)):
        application.add_exception_handler(kind, _answer(status))
    application.add_exception_handler(RefusedError, _refused)
    application.add_exception_handler(NotAllowedError, _not_allowed)
    application.add_exception_handler(RequestValidationError, _not_valid)
    application.add_exception_handler(HTTPException, _http)
    return Guard(cast(Application, application), host, token, counts.count, paths(page))


def _problem(status: int, message: str) -> JSONResponse:
    return JSONResponse(problem(status, message), status)


def _answer(status: int) -> Callable[[Request, Exception], JSONResponse]:
    return lambda _, error: _problem(status, str(error))


def _refused(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RefusedError)
    return _problem(error.status, str(error))


def _http(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    headers = dict(error.headers or {})
    if error.status_code == 405:  # what is raised knows of one route, where the path may have more
        headers["Allow"] = ", ".join(_methods_at(request))
    answer = _problem(error.status_code, f"{error.detail}; see /openapi.json")
    answer.headers.update(headers)
    return answer


def _methods_at(request: Request) -> list[str]:
    """What the path of ``request`` takes."""
    return [
        method
        for method in ("GET", "POST", "PUT", "DELETE")
        if any(
            route.matches({**request.scope, "method": method})[0] is Match.FULL
            for route in request.app.routes
        )
    ]


def _not_allowed(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, NotAllowedError)
    control = error.control
    allowed: dict[str, Any] = {
        "kind": control.kind,
        "unit": control.unit,
        "low": control.low,
        "high": control.high,
        "choices": list(control.choices),
    }
    return JSONResponse({**problem(422, str(error)), "allowed": allowed}, 422)


def _not_valid(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    if first["loc"][:2] == ("body", "value"):  # pydantic tells of each kind apart
        return _problem(422, "value: give true, false, a finite number, a text, or null")
    place = ".".join(map(str, first["loc"]))
    return _problem(422, f"{place}: {first['msg']}")
