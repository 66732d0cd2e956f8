"""Photographs that arrive in the console: in parts, from any page that is let in."""

from typing import Any
from urllib.parse import quote

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from acquisition.choices import CaptureKind
from acquisition.errors import SessionError
from acquisition.regular_files import read_regular_file, size_text
from standoff.console.access import Access
from standoff.console.photographs import (
    PhotographInbox,
    Received,
    Receiver,
    number_of,
    text_of,
    told_fault,
)
from standoff.console.session_library import SessionLibrary
from standoff.console.web._session_commands import MOST_COMPARED, MOST_IMPORTED

AT_WORK = 4
"""Requests about photographs that are served at one time."""

SHOWN = 200
"""Photographs of sessions to choose a pair from, the newest first."""

SESSIONS_READ = 50
"""The newest, to find photographs in."""

PICTURE_POLICY = "default-src 'none'; sandbox"

KINDS: dict[CaptureKind, str] = {
    "texture": "a scene, as reference or follow-up",
    "edge": "a slanted edge, for the PSF",
    "chart": "a test chart",
    "board": "a ChArUco board, for the geometry",
    "flat": "an evenly lit surface, for the noise",
    "dark": "nothing: the lens was covered, for the noise",
}
"""What each kind of photograph shows, the commonest first."""


def arrivals_app(inbox: PhotographInbox, access: Access) -> Starlette:
    """Return the application that takes photographs; its faults are told as JSON."""
    arrivals = _Arrivals(inbox, access)
    return Starlette(
        routes=[
            Route("/", arrivals.announce, methods=["POST"]),
            Route("/{sha256}", arrivals.part, methods=["PUT"]),
            Route("/{sha256}", arrivals.picture),
        ],
        exception_handlers={HTTPException: told_fault},
    )


class _Arrivals:
    """Takes what a page sends; headers are read in threads, pixels nowhere here."""

    def __init__(self, inbox: PhotographInbox, access: Access) -> None:
        self._inbox = inbox
        self._receiver = Receiver(access, page="the console's", most_at_once=AT_WORK)

    async def announce(self, request: Request) -> Response:
        """Say where a photograph goes on: 0 for a new one, its size for one that is here."""
        self._receiver.require_own_page(request)
        sha256, size = text_of(request, "sha256"), number_of(request, "bytes")
        name = text_of(request, "name")
        found = await self._receiver.in_thread(lambda: self._inbox.begin(sha256, size, name))
        return await self._received(request, sha256, found)

    async def part(self, request: Request) -> Response:
        """Add a part; the last one is answered once the whole is verified and checked."""
        part = await self._receiver.part(request)
        found = await self._receiver.in_thread(
            lambda: self._inbox.add(part.sha256, part.offset, part.data, part.size)
        )
        return await self._received(request, part.sha256, found)

    async def picture(self, request: Request) -> Response:
        """A photograph that waits, for a browser to show, which decodes it."""
        inbox, sha256 = self._inbox, request.path_params["sha256"]
        found = await self._receiver.in_thread(
            lambda: [one for one in inbox.arrived() if one.sha256 == sha256 and one.media_type]
        )
        if not found:
            raise HTTPException(404, "there is no photograph here that a browser shows")
        data = await self._receiver.in_thread(lambda: read_regular_file(found[0].path))
        headers = {"Content-Security-Policy": PICTURE_POLICY}
        return Response(data, media_type=found[0].media_type, headers=headers)

    async def _received(self, request: Request, sha256: str, found: Received) -> Response:
        name = text_of(request, "name")
        if found.path is not None:
            is_removed = text_of(request, "location") == "remove"
            await self._receiver.in_thread(
                lambda: self._inbox.receive(sha256, name, is_location_removed=is_removed)
            )
        return JSONResponse({"received": found.received, "is_stored": found.path is not None})


def photographs_document(library: SessionLibrary, inbox: PhotographInbox) -> dict[str, Any]:
    """What has arrived, and the photographs of the sessions, to choose a pair from."""
    arrived = inbox.arrived()
    return {
        "kinds": KINDS,
        "most_imported": MOST_IMPORTED,
        "most_compared": MOST_COMPARED,
        "revision": inbox.revision,
        "arrived": [
            {
                "sha256": one.sha256,
                "name": one.path.name,
                "size": size_text(one.size_bytes),
                "when": one.arrived_utc,
                "is_shown": bool(one.media_type),
            }
            for one in arrived
        ],
        "captures": _captures(library),
    }


def _captures(library: SessionLibrary) -> list[dict[str, Any]]:
    """Captures of scenes, those of the newest sessions first."""
    found: list[dict[str, Any]] = []
    for summary in library.summaries()[:SESSIONS_READ]:
        if summary.fault:
            continue
        try:
            session = library.read(summary.name)
        except SessionError:  # it was changed meanwhile
            continue
        address = f"/sessions/{quote(summary.name)}"
        found += [
            {
                "session": summary.name,
                "index": record.index,
                "name": record.target,
                "height": "" if (at := session.known_height_mm(record)) is None else f"{at:g} mm",
                "address": f"{address}/captures/{record.index}",
                "thumbnail": f"{address}/captures/{record.index}/thumbnail",
            }
            for record in session.records
            if record.kind in ("texture", "chart")
        ]
        if len(found) >= SHOWN:
            break
    return found[:SHOWN]
