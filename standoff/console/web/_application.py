"""The console's pages and its one websocket; the work is done behind them."""

import asyncio
import shutil
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, TypeVar, get_args
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import (
    FileResponse,
    HTMLResponse,
    JSONResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles

from acquisition.aravis import route_to
from acquisition.bench import resolve_address
from acquisition.choices import CaptureKind
from acquisition.errors import DeviceError, PlanError, SessionError
from acquisition.printable import on_one_line
from acquisition.session import CaptureRecord, Session
from standoff.console.access import Access, AccessMiddleware
from standoff.console.bench_hub import BenchHub, ConsoleHub
from standoff.console.devices import DeviceStatus
from standoff.console.entrance import Entrance, body_of
from standoff.console.guide import guide_pages
from standoff.console.page_words import page_words
from standoff.console.photographs import SENDING_FOLDER
from standoff.console.plans import PlanDraft, TargetDraft, draft_of
from standoff.console.pose_curves import MOST_BYTES
from standoff.console.reference_picture import OverlayView
from standoff.console.session_library import UnknownSessionError
from standoff.console.web._live_sockets import LiveSockets
from standoff.console.web._photograph_pages import arrivals_app, photographs_document
from standoff.console.web._session_pages import (
    REPORT_POLICY,
    Thumbnails,
    capture_document,
    capture_levels,
    find_capture,
    report_response,
    session_document,
    sessions_document,
)
from standoff.console.web._zip_stream import zipped
from standoff.doctor import (
    Check,
    advice_on,
    check_disk,
    check_libraries,
    check_mtu,
    check_receive_buffer,
    check_route,
    check_stage_port,
)
from standoff.errors import REPORTED_ERRORS, ApplicationError

T = TypeVar("T")

FOLDER = Path(__file__).parent
PART_BYTES = 2**20
"""Of the levels of an image, which a connection sends one by one."""

PAGES_AT_ONCE, PAGES_WAITING = 2, 64
"""Pages that are made at the same time, beside the bench's own threads, and that wait for it."""

VIEWER_HEADER = "X-Viewer"
"""The identity of the page that sends a file: the one it has on its websocket."""

METRICS = ("squared-gradient", "brenner", "tenengrad", "laplacian")
NEW_TARGET = TargetDraft(kind="edge", target="edge", orientations="5 95")


def console_app(hub: ConsoleHub, *, token: str | None = None) -> Starlette:
    """Return the web application of a console; whoever serves it starts and closes the hub.

    Whoever has the token is let in from any computer; None lets in only this computer.
    """
    access = Access(token)
    bench = BenchPages(hub, access) if isinstance(hub, BenchHub) else None
    pages = SessionPages(hub, access) if bench is None else bench
    capture = "/sessions/{name}/captures/{index:int}"
    return Starlette(
        routes=[
            Route("/", pages.photographs if bench is None else bench.bench),
            Route("/photographs", pages.photographs),
            Mount("/photographs/arrived", arrivals_app(hub.photographs, access)),
            Route("/sessions", pages.sessions),
            Route("/sessions/{name}", pages.session),
            Route("/sessions/{name}/report", pages.report),
            Route("/sessions/{name}/results/{page:path}", pages.result),
            Route("/sessions/{name}/exports/{file}", pages.export),
            Route(capture, pages.capture),
            Route(f"{capture}/thumbnail", pages.thumbnail),
            Route(f"{capture}/levels/{{image}}", pages.levels),
            *(_guide_routes(hub, pages, access) if bench is None else bench.routes()),
            Route("/login", pages.entrance.login, methods=["GET", "POST"]),
            WebSocketRoute("/live", LiveSockets(hub).serve),
            Mount("/sending", StaticFiles(directory=SENDING_FOLDER)),
            Mount("/static", StaticFiles(directory=FOLDER / "static")),
        ],
        middleware=[Middleware(AccessMiddleware, access=access, refusal=pages.refusal())],
        exception_handlers={HTTPException: pages.fault},
    )


def _guide_routes(hub: ConsoleHub, pages: "SessionPages", access: Access) -> list[Route | Mount]:
    """The guide for any browser's camera.

    A console with a bench has none: photographs are decoded in its own process, which must not end
    while a stage moves, and the bench's own camera is guided on its page.
    """
    return [
        Route("/guide/to/{name}/{index:int}", pages.choose_reference, methods=["POST"]),
        Mount("/guide", guide_pages(hub.references, access, home="/photographs")),
    ]


class SessionPages:
    """Renders the pages that need no bench; what changes on them comes over the websocket."""

    def __init__(self, hub: ConsoleHub, access: Access) -> None:
        self._hub = hub
        self._access = access
        self.entrance = Entrance(access, self.refusal, warn=self._warn_of_guesses)
        self._thumbnails = Thumbnails()
        self._turns = asyncio.Semaphore(PAGES_AT_ONCE)
        self._asked = 0
        self._templates = Environment(
            loader=PackageLoader("standoff.console.web", "templates"),
            autoescape=True,
            finalize=_printable,
            trim_blocks=True,
            lstrip_blocks=True,
        )

    async def sessions(self, request: Request) -> Response:
        number = _page_number(request)
        return await self._made(
            request, "sessions.html", lambda: sessions_document(self._hub.sessions, number)
        )

    async def photographs(self, request: Request) -> Response:
        """What has arrived and is to be imported, and pairs to compare."""
        hub = self._hub

        def facts() -> dict[str, Any]:
            return photographs_document(hub.sessions, hub.photographs)

        return await self._made(request, "photographs.html", facts)

    async def choose_reference(self, request: Request) -> Response:
        """Read a photograph as the guide's reference, and name the address of its page."""
        headers = request.headers
        if not self._access.is_own_page(
            origin=headers.get("origin"), host=headers.get("host", ""), scheme=request.url.scheme
        ):
            raise HTTPException(403, "this was not sent by the console's own page")
        hub, (name, index, uid) = self._hub, _named(request)

        def choose() -> str:
            session = hub.sessions.read(name)
            record = find_capture(session, index, uid).record
            return hub.references.choose(
                session.path, record, hub.curves.curve, hub.curves.view.min_dprime
            )

        try:
            chosen = await self._in_turn(request, choose)
        except REPORTED_ERRORS as error:
            return JSONResponse({"text": str(error)}, 409)
        return JSONResponse({"address": f"/guide/?of={quote(chosen, safe='')}"})

    async def session(self, request: Request) -> Response:
        name, number, hub = request.path_params["name"], _page_number(request), self._hub

        def facts() -> dict[str, Any]:
            has_curves = hub.results.has_curves
            return {"session": session_document(hub.sessions, name, number, has_curves=has_curves)}

        return await self._made(request, "session.html", facts)

    async def report(self, request: Request) -> Response:
        name = request.path_params["name"]
        report = await self._in_turn(request, lambda: self._hub.sessions.report_of(name))
        if report is None:
            raise HTTPException(404, f"{name} has no report yet")
        return report_response(report)

    async def result(self, request: Request) -> Response:
        """The page or picture that a command wrote, in a sandbox."""
        name, page = request.path_params["name"], request.path_params["page"]
        data = await self._in_turn(request, lambda: self._hub.sessions.result_page(name, page))
        if data is None:
            raise HTTPException(404, f"{name} has no result {page}")
        if page.endswith(".png"):
            headers = {"Content-Security-Policy": REPORT_POLICY}
            return Response(data, media_type="image/png", headers=headers)
        return report_response(data)

    async def export(self, request: Request) -> Response:
        """A file that the session was exported to."""
        name, file = request.path_params["name"], request.path_params["file"]
        path = await self._in_turn(request, lambda: self._hub.sessions.export_of(name, file))
        if path is None:
            raise HTTPException(404, f"{name} has no export {file}")
        if path.is_dir():
            shown = quote(f"{name} {file}.zip", safe="")
            headers = {"Content-Disposition": f"attachment; filename*=utf-8''{shown}"}
            return StreamingResponse(zipped(path), media_type="application/zip", headers=headers)
        return FileResponse(path, media_type="application/octet-stream", filename=f"{name} {file}")

    async def capture(self, request: Request) -> Response:
        name, index, uid = _named(request)
        return await self._made(
            request,
            "capture.html",
            lambda: {"capture": capture_document(self._hub.sessions, name, index, uid)},
        )

    async def thumbnail(self, request: Request) -> Response:
        """A small JPEG of a capture."""
        data = await self._in_turn(request, lambda: self._thumbnails.of(*self._captured(request)))
        return Response(data, media_type="image/jpeg")

    async def levels(self, request: Request) -> Response:
        """The levels of one image of a capture, as float32 row by row, little-endian."""
        image = request.path_params["image"]
        levels = await self._in_turn(
            request, lambda: capture_levels(*self._captured(request), image)
        )
        if levels is None:
            index = request.path_params["index"]
            raise HTTPException(404, f"capture {index} has no image {image}")
        data = memoryview(np.ascontiguousarray(levels, dtype="<f4").data).cast("B")

        async def parts() -> AsyncIterator[memoryview]:
            for start in range(0, len(data), PART_BYTES):
                yield data[start : start + PART_BYTES]

        rows, cols = levels.shape
        headers = {"X-Rows": str(rows), "X-Cols": str(cols), "Content-Length": str(len(data))}
        return StreamingResponse(parts(), media_type="application/octet-stream", headers=headers)

    def refusal(self, *, is_wrong: bool = False, is_early: bool = False) -> str:
        template = self._templates.get_template("refusal.html")
        return template.render(
            needs_token=self._access.needs_token, is_wrong=is_wrong, is_early=is_early
        )

    async def fault(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        return HTMLResponse(
            self._page("fault.html", status=error.status_code, text=page_words(error.detail)),
            status_code=error.status_code,
            headers=error.headers,
        )

    def _warn_of_guesses(self, peer: str) -> None:
        self._hub.tell(f"Somebody at {peer} is guessing the console's token.")

    def _captured(self, request: Request) -> tuple[Session, CaptureRecord]:
        """The capture that is asked for, and its session."""
        name, index, uid = _named(request)
        session = self._hub.sessions.read(name)
        return session, find_capture(session, index, uid).record

    async def _made(
        self, request: Request, template: str, facts: Callable[[], dict[str, Any]]
    ) -> Response:
        """Collect the facts of a page and render it."""
        page = await self._in_turn(request, lambda: self._page(template, **facts()))
        return HTMLResponse(page)

    async def _in_turn(self, request: Request, make: Callable[[], T]) -> T:
        """Do the work of a page in a thread, a few at a time: the bench shares the processor."""
        if self._asked >= PAGES_AT_ONCE + PAGES_WAITING:
            raise HTTPException(503, "the console is busy: try again", {"Retry-After": "1"})
        self._asked += 1
        try:
            async with self._turns:
                if await request.is_disconnected():
                    raise HTTPException(400, "nobody is waiting for this page any more")
                return await asyncio.to_thread(make)
        except UnknownSessionError as error:
            raise HTTPException(404, str(error)) from error
        except SessionError as error:
            raise HTTPException(409, str(error)) from error
        finally:
            self._asked -= 1

    def _page(self, name: str, **facts: object) -> str:
        has_bench = isinstance(self._hub, BenchHub)
        return self._templates.get_template(name).render(
            path=f"/{name}", has_bench=has_bench, **facts
        )


class BenchPages(SessionPages):
    """Renders the pages of a bench as well."""

    _hub: BenchHub

    def __init__(self, hub: BenchHub, access: Access) -> None:
        super().__init__(hub, access)

    def routes(self) -> list[Route]:
        """The routes besides those of every console."""
        return [
            Route("/snapshots/{name}", self.snapshot),
            Route("/plans/edit", self.plan),
            Route("/pose/reference.png", self.reference),
            Route("/pose/curves", self.curves),
            Route("/pose/curves", self.take_curves, methods=["POST"]),
            Route("/doctor", self.doctor),
        ]

    async def bench(self, request: Request) -> Response:
        def facts() -> dict[str, Any]:
            summaries = self._hub.sessions.summaries()
            return {
                "plans": self._hub.plans.names(),
                "unfinished": [
                    each.name for each in summaries if not each.fault and not each.is_complete
                ],
                "metrics": METRICS,
                "bench": self._hub.bench,
            }

        return await self._made(request, "bench.html", facts)

    async def snapshot(self, request: Request) -> Response:
        name = request.path_params["name"]
        data = await self._in_turn(request, lambda: self._hub.snapshots.read(name))
        if data is None:
            raise HTTPException(404, "there is no such snapshot")
        headers = {"Content-Disposition": f'attachment; filename="{name}"'}
        return Response(data, media_type="image/tiff", headers=headers)

    async def plan(self, request: Request) -> Response:
        """The plan editor, empty or with a plan to start from."""
        name = request.query_params.get("plan", "")

        def facts() -> dict[str, Any]:
            plans, limits_mm = self._hub.plans, self._hub.bench.stage.limits_mm
            middle_mm = sum(limits_mm) / 2
            new = PlanDraft(name="new plan", heights=f"{middle_mm:g}", targets=(NEW_TARGET,))
            try:
                draft = draft_of(plans.load(name)) if name else new
            except (ApplicationError, PlanError) as error:
                raise HTTPException(404, str(error)) from error
            return {
                "chosen": name,
                "draft": draft.model_dump(mode="json"),
                "names": plans.names(),
                "kinds": get_args(CaptureKind),
                "limits_mm": limits_mm,
                "bench_frames": self._hub.bench.capture.frames_per_capture,
            }

        return await self._made(request, "plan.html", facts)

    async def reference(self, request: Request) -> Response:
        """The pose's reference that has a number, as a photograph or as its edges alone."""
        number, asked = request.query_params.get("of"), request.query_params.get("view", "photo")
        picture = self._hub.pose.view.picture
        view = next((each for each in get_args(OverlayView) if each == asked), None)
        if picture is None or number != str(picture.number) or view is None:
            raise HTTPException(404, "there is no such reference any more")
        data = await self._in_turn(request, lambda: picture.png(view))
        return Response(data, media_type="image/png")

    async def curves(self, request: Request) -> Response:
        """The files of curves to choose from, and the curves in the one that is chosen."""

        def lists() -> dict[str, Any]:
            view, files = self._hub.curves.view, self._hub.curves.files()
            return {"revision": view.revision, "files": files, "curves": view.curves}

        return JSONResponse(await self._in_turn(request, lists))

    async def take_curves(self, request: Request) -> Response:
        """Keep a file of curves that the page in control sends; say in one line why not."""
        hub, name = self._hub, request.query_params.get("name", "")
        headers = request.headers
        viewer = headers.get(VIEWER_HEADER, "")
        # A page from elsewhere may send a form here, unlike a websocket's message.
        if not self._access.is_own_page(
            origin=headers.get("origin"), host=headers.get("host", ""), scheme=request.url.scheme
        ) or not (viewer and hub.control.is_holder(viewer)):
            return _told(403, "You are not in control: take control first.")
        length = headers.get("content-length", "0")
        is_larger = length.isascii() and length.isdigit() and int(length[:20]) > MOST_BYTES
        data = None if is_larger else await body_of(request, MOST_BYTES, "the file did not arrive")
        if data is None:
            return _told(413, f"A file of curves has at most {MOST_BYTES // 2**20} MiB.")
        try:
            file = await self._in_turn(request, lambda: hub.curves.store(name, data))
        except ApplicationError as error:
            return _told(422, str(error))
        return JSONResponse({"file": file})

    async def doctor(self, request: Request) -> Response:
        return await self._made(request, "doctor.html", lambda: {"checks": bench_checks(self._hub)})


def _told(status: int, text: str) -> Response:
    return JSONResponse({"text": text}, status_code=status)


def _named(request: Request) -> tuple[str, int, str | None]:
    """Session, index, and identity of a capture where one is asked for."""
    parameters = request.path_params
    return parameters["name"], parameters["index"], request.query_params.get("uid")


def _page_number(request: Request) -> int:
    """Number of the page that is asked for, from 1 on."""
    text = request.query_params.get("page", "1")
    if not (text.isascii() and text.isdigit() and len(text) < 9 and int(text) > 0):
        raise HTTPException(404, "pages are numbered from 1 on")
    return int(text)


def _printable(value: object) -> object:
    """Escape what a page would obey in a text, such as marks that turn the direction of reading."""
    return on_one_line(value) if type(value) is str else value


def bench_checks(hub: BenchHub) -> tuple[Check, ...]:
    """Run all checks; camera and stage as the console sees them, since only it may open them."""
    bench = hub.bench
    checks = [check_libraries(needed=bench.camera.driver == "aravis"), check_receive_buffer()]
    if bench.camera.driver == "aravis" and bench.camera.address is not None:
        try:
            route = route_to(resolve_address(bench.camera.address))
        except DeviceError as error:
            remedy = advice_on(error)
            checks.append(Check(name="network", status="fail", found=str(error), remedy=remedy))
        else:
            checks += [check_route(route), check_mtu(route)]
    info, settings = hub.camera.info, hub.camera.settings
    found = (
        "" if info is None else f"{info.vendor} {info.model}, serial number {info.serial_number}"
    )
    checks.append(_device("camera", hub.camera.status, found))
    if settings is not None:
        counts = hub.frames.counts
        text = (
            f"{counts.complete} complete, {counts.incomplete} incomplete, {counts.lost} lost; "
            f"{counts.rate_hz:.1f} per second"
        )
        is_good = counts.incomplete + counts.lost <= 1e-3 * max(counts.complete, 1)
        checks.append(
            Check(
                name="frames",
                status="ok" if is_good else "warn",
                found=text,
                remedy="" if is_good else "check cable, switch, packet size and receive buffer",
            )
        )
    if not hub.stage.status.is_ready:
        checks.append(check_stage_port(bench.stage))
    stage = hub.stage.view
    found = "" if stage.info is None else f"{stage.info.vendor} {stage.info.model}".strip()
    checks.append(_device("stage", stage.status, found))
    folder = hub.sessions.folder
    while not folder.exists():
        folder = folder.resolve().parent
    checks.append(check_disk(folder, lambda path: shutil.disk_usage(path).free))
    checks += [
        Check(name=name, status="warn", found=warning)
        for name, warnings in (("camera", hub.camera.warnings), ("stage", stage.warnings))
        for warning in warnings
        if "receive buffer" not in warning
    ]
    return tuple(checks)


def _device(name: str, status: DeviceStatus, found: str) -> Check:
    if status.is_ready:
        return Check(name=name, status="ok", found=found or "responding")
    level = "warn" if status.state == "opening" else "fail"
    return Check(name=name, status=level, found=status.text, remedy=status.remedy)  # type: ignore[arg-type]  # of two literals
