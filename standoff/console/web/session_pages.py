"""Pages about what is on the disk: captures with their images, results, and plans."""

from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, Protocol, TypeVar, get_args

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from acquisition.choices import CaptureKind
from acquisition.errors import PlanError
from standoff.console.bench_hub import BenchHub
from standoff.console.plan_drafts import PlanDraft, TargetDraft, draft_of
from standoff.console.web.capture_page import (
    CaptureLevels,
    Thumbnails,
    capture_document,
    capture_levels,
    find_capture,
)
from standoff.console.web.report_page import REPORT_POLICY, report_response
from standoff.errors import ApplicationError

T = TypeVar("T")

NEW_TARGET = TargetDraft(kind="edge", target="edge", orientations="5 95")

Facts = Callable[[], dict[str, Any]]


class InTurn(Protocol):
    """Does the work of a page in a thread, a few at a time."""

    def __call__(self, request: Request, make: Callable[[], T]) -> Awaitable[T]:
        """Return what ``make`` returns; its errors become answers."""
        ...


class SessionPages:
    """Renders the pages of captures and serves what belongs to them.

    Parameters
    ----------
    hub
        The bench.
    made
        Renders a template from facts.
    in_turn
        Does work in a thread.
    """

    def __init__(
        self,
        hub: BenchHub,
        made: Callable[[Request, str, Facts], Awaitable[Response]],
        in_turn: InTurn,
    ) -> None:
        self._hub = hub
        self._made = made
        self._in_turn = in_turn
        self._thumbnails = Thumbnails()

    def routes(self) -> list[Route]:
        """Where the pages are."""
        capture = "/sessions/{name}/captures/{index:int}"
        return [
            Route("/sessions/{name}/results/{page:path}", self.result),
            Route("/plans/edit", self.plan),
            Route(capture, self.capture),
            Route(f"{capture}/thumbnail", self.thumbnail),
            Route(f"{capture}/levels/{{image}}", self.levels),
        ]

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

    async def capture(self, request: Request) -> Response:
        """The page of one capture."""
        name, index, uid = _named(request)
        return await self._made(
            request,
            "capture.html",
            lambda: {"capture": capture_document(self._hub.sessions, name, index, uid)},
        )

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

    async def thumbnail(self, request: Request) -> Response:
        """A small JPEG of a capture."""
        name, index, uid = _named(request)

        def make() -> bytes:
            session = self._hub.sessions.read(name)
            return self._thumbnails.of(session, find_capture(session, index, uid).record)

        return Response(await self._in_turn(request, make), media_type="image/jpeg")

    async def levels(self, request: Request) -> Response:
        """The levels of one image of a capture, as float32 row by row."""
        name, index, uid = _named(request)
        image = request.path_params["image"]

        def make() -> CaptureLevels | None:
            session = self._hub.sessions.read(name)
            return capture_levels(session, find_capture(session, index, uid).record, image)

        found = await self._in_turn(request, make)
        if found is None:
            raise HTTPException(404, f"capture {index} has no image {image}")

        async def parts() -> AsyncIterator[memoryview]:
            for part in found.chunks():
                yield part

        rows, cols = found.levels.shape
        headers = {"X-Rows": str(rows), "X-Cols": str(cols), "Content-Length": str(4 * rows * cols)}
        return StreamingResponse(parts(), media_type="application/octet-stream", headers=headers)


def _named(request: Request) -> tuple[str, int, str | None]:
    """Session, index, and identity of a capture where one is asked for."""
    parameters = request.path_params
    return parameters["name"], parameters["index"], request.query_params.get("uid")
