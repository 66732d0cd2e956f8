"""The base of every document that is read and written, and where a document comes from."""

from datetime import UTC, datetime

from pydantic import BaseModel, ConfigDict


class StoredModel(BaseModel):
    """A document or part of one, not changed once made; what later versions add is ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class InputFile(StoredModel):
    """A file that was read, with the SHA-256 of its bytes.

    Of a capture session it is the journal, which holds the hashes of all its captures.
    """

    path: str
    sha256: str


class Provenance(StoredModel):
    """How a document was made.

    ``version`` is of standoff, ``created`` in UTC, ``command`` a command line or a function.
    ``encoding`` is how the levels of the photographs follow from light: ``linear``, ``srgb``,
    ``gamma:G`` or ``icc``; a list where they differ.
    """

    version: str
    created: str
    command: str
    inputs: tuple[InputFile, ...] = ()
    encoding: str | tuple[str, ...] = "linear"


def utc_now() -> str:
    """Return the time in UTC to the second, as ISO 8601."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
