"""What is fetched for the pose card or sent from it: the reference's pictures, files of curves."""

from collections.abc import Awaitable, Callable
from typing import Any, Protocol, TypeVar

from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from standoff.console.bench_hub import BenchHub
from standoff.console.devices import OverlayView
from standoff.console.pose_curves import MOST_BYTES
from standoff.console.serving import Access
from standoff.errors import ApplicationError

T = TypeVar("T")

VIEWS: tuple[OverlayView, ...] = ("photo", "edges")
VIEWER_HEADER = "X-Viewer"
"""The identity of the page that sends a file: the one it has on its websocket."""


class InTurn(Protocol):
    """Does the work of a page in a thread, a few at a time."""

    def __call__(self, request: Request, make: Callable[[], T]) -> Awaitable[T]:
        """Return what ``make`` returns; its errors become answers."""
        ...


class PosePages:
    """Serves the reference and the files of curves.

    Parameters
    ----------
    hub
        The bench.
    in_turn
        Does work in a thread.
    access
        Knows the console's own pages.
    """

    def __init__(self, hub: BenchHub, in_turn: InTurn, access: Access) -> None:
        self._hub = hub
        self._in_turn = in_turn
        self._access = access

    def routes(self) -> list[Route]:
        """Where they are."""
        return [
            Route("/pose/reference.png", self.reference),
            Route("/pose/curves", self.curves),
            Route("/pose/curves", self.take_curves, methods=["POST"]),
        ]

    async def reference(self, request: Request) -> Response:
        """The reference that has a number, as a photograph or as its edges alone."""
        number, asked = request.query_params.get("of"), request.query_params.get("view", "photo")
        picture = self._hub.pose.view.picture
        view = next((each for each in VIEWS if each == asked), None)
        if picture is None or number != str(picture.number) or view is None:
            raise HTTPException(404, "there is no such reference any more")
        data = await self._in_turn(request, lambda: picture.png(view))
        return Response(data, media_type="image/png")

    async def curves(self, request: Request) -> Response:
        """The files to choose from, and the curves in the one that is chosen."""

        def lists() -> dict[str, Any]:
            view = self._hub.curves.view
            return {
                "revision": view.revision,
                "files": self._hub.curves.files(),
                "curves": view.curves,
            }

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
            return _refused(403, "You are not in control: take control first.")
        data = await _body(request)
        if data is None:
            return _refused(413, f"A file of curves has at most {MOST_BYTES // 2**20} MiB.")
        try:
            file = await self._in_turn(request, lambda: hub.curves.store(name, data))
        except ApplicationError as error:
            return _refused(422, str(error))
        return JSONResponse({"file": file})


def _refused(status: int, text: str) -> Response:
    return JSONResponse({"text": text}, status_code=status)


async def _body(request: Request) -> bytes | None:
    """What is sent; None if that is too much."""
    length = request.headers.get("content-length", "0")
    if length.isascii() and length.isdigit() and int(length[:20]) > MOST_BYTES:
        return None
    data = bytearray()
    try:
        async for chunk in request.stream():
            data += chunk
            if len(data) > MOST_BYTES:
                return None
    except ClientDisconnect as error:  # it took too long, or left
        raise HTTPException(400, "the file did not arrive") from error
    return bytes(data)
