"""The front panel: its files, as they lie in the folder ``page``, for a browser.

Rules
-----
1. Only files of that folder are served, read once; no path of the network reaches a file system.
2. A page loads nothing from elsewhere, runs no script of its text, and is in no other's frame.
"""

from collections.abc import Mapping
from importlib import resources
from typing import Annotated, Final

from fastapi import APIRouter, Path
from starlette.exceptions import HTTPException
from starlette.responses import Response

HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",  # a daemon of another version may be there next time
}

_TYPES: Final = {
    "html": "text/html",
    "js": "text/javascript",
    "css": "text/css",
    "svg": "image/svg+xml",
    "txt": "text/plain",
}


def read_page() -> Mapping[str, bytes]:
    """The files of the panel by name."""
    folder = resources.files("axistwin.control") / "page"
    return {each.name: each.read_bytes() for each in folder.iterdir() if each.is_file()}


def paths(files: Mapping[str, bytes]) -> list[str]:
    """Where the panel and its ``files`` are found."""
    return ["/", *(f"/panel/{name}" for name in files)]


def make_panel(files: Mapping[str, bytes]) -> APIRouter:
    """The routes of the panel: ``/``, and its ``files`` below ``/panel/``."""
    router = APIRouter(include_in_schema=False)

    @router.get("/")
    async def index() -> Response:
        return _file("index.html")

    @router.get("/panel/{name}")
    async def file(name: Annotated[str, Path()]) -> Response:
        return _file(name)

    def _file(name: str) -> Response:
        if name not in files:
            raise HTTPException(404, f"no file {name!r}")
        media_type = _TYPES[name.rpartition(".")[2]]
        return Response(files[name], media_type=media_type, headers=HEADERS)

    return router
