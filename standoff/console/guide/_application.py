"""The guide's page and what it sends: frames to be judged, stills in parts, and what is asked."""

import asyncio
import re
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from acquisition.printable import on_one_line
from standoff.console.access import Access, AccessMiddleware
from standoff.console.entrance import Entrance
from standoff.console.guide._assessment import WITHOUT_CURVES, Judge
from standoff.console.guide._live import MOST_FRAME_BYTES, FrameError, LiveGuidance
from standoff.console.guide._stills import StillStore
from standoff.console.photographs import (
    SENDING_FOLDER,
    Received,
    Receiver,
    number_of,
    text_of,
    told_fault,
)

FOLDER = Path(__file__).parent
OPEN_PATHS = ("/login", "/static/guide.css")
FRAMES_OF_ONE = 4
"""Frames of one phone that are on their way at one time; its page sends two."""

FRAMES_WAITING = 32
"""Frames of all phones."""

TRIED_AT_ONCE = 3
"""References that a frame is compared with to find out which of them it shows."""

PHONES_SEARCHING = 64
"""Phones of which it is known where among the references each goes on."""

WORK_WAITING = 32
"""Requests other than frames that are served at one time."""


@dataclass(frozen=True, slots=True)
class GuidedReference:
    """A reference with all that is done with it; whoever serves it starts and closes the store."""

    judge: Judge
    store: StillStore
    live: LiveGuidance

    @classmethod
    def of(cls, judge: Judge, store: StillStore) -> "GuidedReference":
        """Return a reference that is ready to be guided to."""
        return cls(judge, store, LiveGuidance(judge))

    @property
    def name(self) -> str:
        """By which the page asks for it."""
        return self.judge.reference.name


def guide_app(
    references: Sequence[GuidedReference],
    *,
    token: str,
    fingerprint: str,
    tell: Callable[[str], None] = lambda _: None,
) -> Starlette:
    """Return the web application for one reference or several, of different names.

    ``fingerprint`` is the certificate's, ``tell`` is told who was let in and who guesses the token.
    """
    access = Access(token)
    pages = _Pages({one.name: one for one in references}, access, fingerprint)
    entrance = Entrance(
        access,
        pages.refusal,
        warn=lambda peer: tell(f"somebody at {peer} is guessing the token"),
        admitted=lambda peer: tell(f"paired with the phone at {peer}"),
    )
    return Starlette(
        routes=[
            Route("/login", entrance.login, methods=["GET", "POST"]),
            *pages.routes(),
        ],
        middleware=[
            Middleware(
                AccessMiddleware, access=access, refusal=pages.refusal(), open_paths=OPEN_PATHS
            )
        ],
        exception_handlers={HTTPException: told_fault},
    )


def guide_pages(references: Mapping[str, GuidedReference], access: Access, home: str) -> Starlette:
    """Return the pages alone, for an application that lets people in itself, at a path of its own.

    References may come and go; ``home`` is the page of that application where they are chosen.
    """
    pages = _Pages(references, access, home=home)
    return Starlette(routes=pages.routes(), exception_handlers={HTTPException: told_fault})


class _Pages:
    """Answers the phone; what takes time is done in threads."""

    def __init__(
        self,
        references: Mapping[str, GuidedReference],
        access: Access,
        fingerprint: str = "",
        home: str = "",
    ) -> None:
        self._references = references
        self._home = home
        self._next: dict[str, int] = {}
        self._fingerprint = fingerprint
        self._frames: Counter[str] = Counter()
        self._receiver = Receiver(access, page="the guide's", most_at_once=WORK_WAITING)
        self._templates = Environment(
            loader=PackageLoader("standoff.console.guide", "templates"),
            autoescape=True,
            finalize=lambda value: on_one_line(value) if type(value) is str else value,
            trim_blocks=True,
            lstrip_blocks=True,
        )

    def routes(self) -> list[Route | Mount]:
        """All pages, and what they ask for."""
        return [
            Route("/", self.page),
            Route("/reference.jpg", self.reference),
            Route("/frames", self.frame, methods=["POST"]),
            Route("/find", self.find, methods=["POST"]),
            Route("/stills", self.stills),
            Route("/stills", self.announce, methods=["POST"]),
            Route("/stills/{sha256}", self.part, methods=["PUT"]),
            Route("/stills/{name}", self.still),
            Route("/stills/{name}/{which}", self.picture),
            Mount("/sending", StaticFiles(directory=SENDING_FOLDER)),
            Mount("/static", StaticFiles(directory=FOLDER / "static")),
        ]

    async def page(self, request: Request) -> Response:
        """The page of a reference, or the list of them unless there is one.

        So it is for one that is not there any more, as after a restart of the console.
        """
        name = request.query_params.get("of")
        is_missing = bool(name) and name not in self._references
        if is_missing or (name is None and len(self._references) != 1):
            template = self._templates.get_template("references.html")
            page = template.render(references=self._listed(), home=self._home, missing=name)
            return HTMLResponse(page, 404 if name else 200)
        one = self._of(request)
        reference = one.judge.reference
        template = self._templates.get_template("guide.html")
        return HTMLResponse(
            template.render(
                reference=one.name,
                width=reference.size[0],
                height=reference.size[1],
                fingerprint=self._fingerprint,
                judged_by="" if one.judge.has_curve else WITHOUT_CURVES,
                is_one_of_several=len(self._references) > 1,
                home=self._home,
            )
        )

    async def reference(self, request: Request) -> Response:
        return Response(self._of(request).judge.reference.jpeg, media_type="image/jpeg")

    async def frame(self, request: Request) -> Response:
        """Judge the newest frame; one that was overtaken is answered without a verdict."""
        self._receiver.require_own_page(request)
        live = self._of(request).live
        async with self._one_frame(request):
            data = await self._receiver.body(request, MOST_FRAME_BYTES)
            found = await live.judged(
                data,
                phone=_phone(request),
                taken_s=_taken_s(request),
                is_fine=text_of(request, "fine") == "1",
            )
        return JSONResponse({"passed_over": True} if found is None else found.to_json())

    async def find(self, request: Request) -> Response:
        """Name the reference whose scene a frame shows; a few are tried with each frame."""
        self._receiver.require_own_page(request)
        async with self._one_frame(request):
            data = await self._receiver.body(request, MOST_FRAME_BYTES)
            names, phone = list(self._references), _phone(request)
            first = self._next.pop(phone, 0)
            if not names:
                return JSONResponse({"of": None})
            tried = [names[(first + k) % len(names)] for k in range(TRIED_AT_ONCE)]
            if len(self._next) < PHONES_SEARCHING:
                self._next[phone] = (first + TRIED_AT_ONCE) % len(names)
            for name in dict.fromkeys(tried):
                found = await self._references[name].live.judged(data, phone=phone)
                if found is not None and found.deviation is not None:
                    return JSONResponse({"of": name})
        return JSONResponse({"of": None})

    @asynccontextmanager
    async def _one_frame(self, request: Request) -> AsyncIterator[None]:
        """Let a few frames of each phone in at a time, and say what is wrong with one."""
        phone = _phone(request)
        if self._frames[phone] >= FRAMES_OF_ONE or self._frames.total() >= FRAMES_WAITING:
            raise HTTPException(
                429, "frames come faster than they are judged", {"Retry-After": "1"}
            )
        self._frames[phone] += 1
        try:
            yield
        except FrameError as error:
            raise HTTPException(422, str(error)) from error
        except asyncio.CancelledError as error:  # Ctrl-C while a frame is judged
            raise HTTPException(503, "the guide has ended") from error
        finally:
            self._frames[phone] -= 1
            if not self._frames[phone]:
                del self._frames[phone]

    def _of(self, request: Request) -> GuidedReference:
        """The reference that is asked for; the only one needs no name."""
        only = next(iter(self._references)) if len(self._references) == 1 else ""
        found = self._references.get(request.query_params.get("of", only))
        if found is None:
            raise HTTPException(404, "there is no such reference")
        return found

    def _listed(self) -> list[dict[str, Any]]:
        """Each reference, with the number of its stills and the verdict on the newest."""
        listed = []
        for one in list(self._references.values()):
            records = one.store.records()
            pose = records[0].pose if records else None
            verdict = "" if pose is None else pose["verdict"]
            listed.append({"name": one.name, "stills": len(records), "verdict": verdict})
        return listed

    async def stills(self, request: Request) -> Response:
        """How far every still is, the newest first; its changes are asked for once it is done."""
        records = self._of(request).store.records()
        shown = [record.to_json() for record in records]
        for one in shown:
            one["count"] = len(one.pop("changes"))
        return JSONResponse(shown)

    async def still(self, request: Request) -> Response:
        """All that is known of one still."""
        name = request.path_params["name"]
        for record in self._of(request).store.records():
            if record.name == name:
                return JSONResponse(record.to_json())
        raise HTTPException(404, "there is no such photograph")

    async def announce(self, request: Request) -> Response:
        """Say where a still goes on: 0 for a new one, its size for one that is stored."""
        self._receiver.require_own_page(request)
        sha256, size = text_of(request, "sha256"), number_of(request, "bytes")
        store = self._of(request).store
        if store.record_of(sha256) is not None:
            return JSONResponse({"received": size, "is_stored": True})
        found = await self._receiver.in_thread(partial(store.uploads.begin, sha256, size))
        return await self._received(request, store, found)

    async def part(self, request: Request) -> Response:
        """Add a part of a still; the last one is answered once the whole is verified."""
        part = await self._receiver.part(request)
        store = self._of(request).store
        add = partial(store.uploads.add, part.sha256, part.offset, part.data, part.size)
        found = await self._receiver.in_thread(add)
        return await self._received(request, store, found)

    async def _received(self, request: Request, store: StillStore, found: Received) -> Response:
        """Take a still that is whole, and answer how far it is."""
        if found.path is not None:
            is_removed = text_of(request, "location") == "remove"
            judge = self._of(request).live.judge_of(_phone(request))
            take = partial(store.take, found.path, is_location_removed=is_removed, judge=judge)
            await self._receiver.in_thread(take)
        document = {"received": found.received, "is_stored": found.path is not None}
        return JSONResponse(document)

    async def picture(self, request: Request) -> Response:
        parameters = request.path_params
        read = partial(self._of(request).store.picture, parameters["name"], parameters["which"])
        data = await self._receiver.in_thread(read)
        if data is None:
            raise HTTPException(404, "there is no such picture")
        return Response(data, media_type="image/jpeg")

    def refusal(self, *, is_wrong: bool = False, is_early: bool = False) -> str:
        template = self._templates.get_template("entrance.html")
        return template.render(is_wrong=is_wrong, is_early=is_early)


def _phone(request: Request) -> str:
    """Its address, by which phones are told apart."""
    return request.client.host if request.client else ""


def _taken_s(request: Request) -> float | None:
    """When a frame was taken by the phone's clock, which it tells in ms; None if it does not."""
    text = text_of(request, "at")
    if not text:
        return None
    if not re.fullmatch(r"[0-9]{1,12}(\.[0-9]{1,6})?", text, re.ASCII):
        raise HTTPException(422, "at is a number of milliseconds")
    return float(text) / 1000
