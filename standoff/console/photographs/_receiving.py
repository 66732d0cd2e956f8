"""What pages send: from the page's own origin alone, bounded, and worked on a few at a time."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from acquisition.errors import ApplicationError, ImageFileError
from standoff.console.access import Access
from standoff.console.entrance import body_of
from standoff.console.photographs._uploads import PART_BYTES, TryAgainError, UploadError

T = TypeVar("T")

SENDING_FOLDER = Path(__file__).parent / "static"
"""Of the script that sends photographs in parts, for the pages of every application."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SentPart:
    """A part of a photograph: of which, where it begins, its bytes, and the size of the whole."""

    sha256: str
    offset: int
    data: bytes
    size: int


class Receiver:
    """Reads requests, and does their work in threads; ``page`` is whose pages may send them.

    More than ``most_at_once`` at work are refused until one is done.
    """

    def __init__(self, access: Access, *, page: str, most_at_once: int) -> None:
        self._access = access
        self._page = page
        self._most = most_at_once
        self._working = 0

    def require_own_page(self, request: Request) -> None:
        """Refuse what a page from elsewhere makes a browser send."""
        headers = request.headers
        if not self._access.is_own_page(
            origin=headers.get("origin"), host=headers.get("host", ""), scheme=request.url.scheme
        ):
            raise HTTPException(403, f"this was not sent by {self._page} own page")

    async def body(self, request: Request, most_bytes: int) -> bytes:
        """Return what is sent; refuse more than that."""
        length = request.headers.get("content-length", "0")
        is_larger = length.isascii() and length.isdigit() and int(length[:20]) > most_bytes
        data = None if is_larger else await body_of(request, most_bytes, "it did not arrive")
        if data is None:
            raise HTTPException(413, f"at most {most_bytes // 1024} kB are taken at once")
        return data

    async def part(self, request: Request) -> SentPart:
        """Return a part of a photograph from its own page."""
        self.require_own_page(request)
        return SentPart(
            data=await self.body(request, PART_BYTES),
            sha256=request.path_params["sha256"],
            offset=number_of(request, "offset"),
            size=number_of(request, "bytes"),
        )

    async def in_thread(self, work: Callable[[], T]) -> T:
        """Do some work, and answer what goes wrong with its status."""
        if self._working >= self._most:
            raise HTTPException(503, "the computer is busy: try again", {"Retry-After": "1"})
        self._working += 1
        try:
            return await asyncio.to_thread(work)
        except TryAgainError as error:
            raise HTTPException(409, str(error)) from error
        except (UploadError, ImageFileError) as error:
            raise HTTPException(422, str(error)) from error
        except ApplicationError as error:
            raise HTTPException(500, str(error)) from error
        except OSError as error:
            said = f"the computer cannot store it: {error.strerror or error}"
            raise HTTPException(507, said) from error
        finally:
            self._working -= 1


async def told_fault(_: Request, error: Exception) -> Response:
    """Answer what is wrong as JSON, with ``text``."""
    assert isinstance(error, HTTPException)
    document: dict[str, Any] = {"text": error.detail}
    return JSONResponse(document, status_code=error.status_code, headers=error.headers)


def text_of(request: Request, name: str) -> str:
    """A value of the address; empty without it."""
    return request.query_params.get(name, "")


def number_of(request: Request, name: str) -> int:
    """A number of bytes in the address."""
    text = text_of(request, name)
    if not (text.isascii() and text.isdigit() and len(text) < 12):
        raise HTTPException(422, f"{name} is a number of bytes")
    return int(text)
