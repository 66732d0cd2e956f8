"""The guide's page and what it sends: frames to be judged, stills in parts, and what is asked."""

import asyncio
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from jinja2 import Environment, PackageLoader
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from acquisition.errors import ApplicationError
from acquisition.printable import on_one_line
from standoff.console.access import Access, AccessMiddleware
from standoff.console.entrance import Entrance, body_of
from standoff.console.guide._assessment import WITHOUT_CURVES, Judge
from standoff.console.guide._live import MOST_FRAME_BYTES, FrameError, LiveGuidance
from standoff.console.guide._stills import StillStore
from standoff.console.guide._uploads import PART_BYTES, UploadError

T = TypeVar("T")

FOLDER = Path(__file__).parent
OPEN_PATHS = ("/login", "/static/guide.css")
FRAMES_WAITING = 4
"""Frames that are on their way at one time; a phone sends two."""

WORK_WAITING = 32
"""Requests other than frames that are served at one time."""


def guide_app(
    store: StillStore,
    judge: Judge,
    *,
    token: str,
    fingerprint: str,
    tell: Callable[[str], None] = lambda _: None,
) -> Starlette:
    """Return the web application; whoever serves it starts and closes the store.

    ``fingerprint`` is the certificate's, ``tell`` is told who was let in and who guesses the token.
    """
    access = Access(token)
    pages = _Pages(store, judge, access, fingerprint)
    entrance = Entrance(
        access,
        pages.refusal,
        warn=lambda peer: tell(f"somebody at {peer} is guessing the token"),
        admitted=lambda peer: tell(f"paired with the phone at {peer}"),
    )
    return Starlette(
        routes=[
            Route("/", pages.page),
            Route("/login", entrance.login, methods=["GET", "POST"]),
            Route("/reference.jpg", pages.reference),
            Route("/frames", pages.frame, methods=["POST"]),
            Route("/stills", pages.stills),
            Route("/stills", pages.announce, methods=["POST"]),
            Route("/stills/{sha256}", pages.part, methods=["PUT"]),
            Route("/stills/{name}/{which}", pages.picture),
            Mount("/static", StaticFiles(directory=FOLDER / "static")),
        ],
        middleware=[
            Middleware(
                AccessMiddleware, access=access, refusal=pages.refusal(), open_paths=OPEN_PATHS
            )
        ],
        exception_handlers={HTTPException: _fault},
    )


class _Pages:
    """Answers the phone; what takes time is done in threads."""

    def __init__(self, store: StillStore, judge: Judge, access: Access, fingerprint: str) -> None:
        self._store = store
        self._judge = judge
        self._access = access
        self._fingerprint = fingerprint
        self._live = LiveGuidance(judge)
        self._frames = 0
        self._working = 0
        self._templates = Environment(
            loader=PackageLoader("standoff.console.guide", "templates"),
            autoescape=True,
            finalize=lambda value: on_one_line(value) if type(value) is str else value,
            trim_blocks=True,
            lstrip_blocks=True,
        )

    async def page(self, _: Request) -> Response:
        reference = self._judge.reference
        template = self._templates.get_template("guide.html")
        return HTMLResponse(
            template.render(
                reference=reference.path.name,
                width=reference.size[0],
                height=reference.size[1],
                fingerprint=self._fingerprint,
                judged_by="" if self._judge.has_curve else WITHOUT_CURVES,
            )
        )

    async def reference(self, _: Request) -> Response:
        return Response(self._judge.reference.jpeg, media_type="image/jpeg")

    async def frame(self, request: Request) -> Response:
        """Judge the newest frame; one that was overtaken is answered without a verdict."""
        self._require_own_page(request)
        if self._frames >= FRAMES_WAITING:
            raise HTTPException(
                429, "frames come faster than they are judged", {"Retry-After": "1"}
            )
        self._frames += 1
        try:
            data = await self._body(request, MOST_FRAME_BYTES)
            found = await self._live.judged(data)
        except FrameError as error:
            raise HTTPException(422, str(error)) from error
        except asyncio.CancelledError as error:  # Ctrl-C while a frame is judged
            raise HTTPException(503, "the guide has ended") from error
        finally:
            self._frames -= 1
        return JSONResponse({"passed_over": True} if found is None else found.to_json())

    async def stills(self, _: Request) -> Response:
        """What is known of every still, the newest first."""
        return JSONResponse([record.to_json() for record in self._store.records()])

    async def announce(self, request: Request) -> Response:
        """Say where a still goes on: 0 for a new one, its size for one that is stored."""
        self._require_own_page(request)
        sha256, size = _text(request, "sha256"), _number(request, "bytes")
        if self._store.record_of(sha256) is not None:
            return JSONResponse({"received": size, "is_stored": True})
        found = await self._in_thread(partial(self._store.uploads.begin, sha256, size))
        return JSONResponse({"received": found.received, "is_stored": False})

    async def part(self, request: Request) -> Response:
        """Add a part of a still; the last one is answered once the whole is verified."""
        self._require_own_page(request)
        data = await self._body(request, PART_BYTES)
        sha256 = request.path_params["sha256"]
        offset, size = _number(request, "offset"), _number(request, "bytes")
        add = partial(self._store.uploads.add, sha256, offset, data, size)
        found = await self._in_thread(add)
        if found.path is None:
            return JSONResponse({"received": found.received, "is_stored": False})
        is_removed = _text(request, "location") == "remove"
        record = self._store.take(found.path, is_location_removed=is_removed)
        return JSONResponse({"received": found.received, "is_stored": True, "name": record.name})

    async def picture(self, request: Request) -> Response:
        parameters = request.path_params
        read = partial(self._store.picture, parameters["name"], parameters["which"])
        data = await self._in_thread(read)
        if data is None:
            raise HTTPException(404, "there is no such picture")
        return Response(data, media_type="image/jpeg")

    def refusal(self, *, is_wrong: bool = False, is_early: bool = False) -> str:
        template = self._templates.get_template("entrance.html")
        return template.render(is_wrong=is_wrong, is_early=is_early)

    def _require_own_page(self, request: Request) -> None:
        """Refuse what a page from elsewhere makes the phone's browser send."""
        headers = request.headers
        if not self._access.is_own_page(
            origin=headers.get("origin"), host=headers.get("host", ""), scheme=request.url.scheme
        ):
            raise HTTPException(403, "this was not sent by the guide's own page")

    async def _body(self, request: Request, most_bytes: int) -> bytes:
        length = request.headers.get("content-length", "0")
        is_larger = length.isascii() and length.isdigit() and int(length[:20]) > most_bytes
        data = None if is_larger else await body_of(request, most_bytes, "it did not arrive")
        if data is None:
            raise HTTPException(413, f"at most {most_bytes // 1024} kB are taken at once")
        return data

    async def _in_thread(self, work: Callable[[], T]) -> T:
        if self._working >= WORK_WAITING:
            raise HTTPException(503, "the computer is busy: try again", {"Retry-After": "1"})
        self._working += 1
        try:
            return await asyncio.to_thread(work)
        except UploadError as error:
            raise HTTPException(422, str(error)) from error
        except ApplicationError as error:
            raise HTTPException(500, str(error)) from error
        except OSError as error:
            said = f"the computer cannot store it: {error.strerror or error}"
            raise HTTPException(507, said) from error
        finally:
            self._working -= 1


async def _fault(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    document: dict[str, Any] = {"text": error.detail}
    return JSONResponse(document, status_code=error.status_code, headers=error.headers)


def _text(request: Request, name: str) -> str:
    return request.query_params.get(name, "")


def _number(request: Request, name: str) -> int:
    text = _text(request, name)
    if not (text.isascii() and text.isdigit() and len(text) < 12):
        raise HTTPException(422, f"{name} is a number of bytes")
    return int(text)
