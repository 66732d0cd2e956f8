"""The record of one capture: everything about it except its pixels."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from functools import cache
from typing import Any, ClassVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from acquisition.bracket import BracketExposure
from acquisition.choices import CaptureKind
from acquisition.errors import SessionError
from acquisition.written_files import validation_keys, validation_lines

_LONGEST_PATH = 255
"""Bytes of a file's path in a session: no more than a file system takes for a single name."""

_UTC_TEXT = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z")


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureRecord:
    """One capture, as the journal and the Info of its TIFF hold it.

    ``height_mm`` was read back from the stage, ``height_asked_mm`` is the plan's. The two
    ``_utc`` texts are the computer's clock around the capture, the ``_timestamp_ns`` the
    camera's own of the first and last frame used. ``focus_value`` is None for flat and dark
    captures. What an imported photograph does not state is None too: exposure, gain, time stamps.
    ``gain`` and ``black_level`` are as the camera states them, in their units; ``gain_db`` is None
    and ``black_level_dn`` 0 where the unit is counts, whose scale the camera does not tell. Records
    of earlier versions have neither.
    ``bracket`` has the exposures of a bracket, shortest first, None for a capture of one exposure;
    ``exposure_us`` is then the shortest, whose DN the levels are in, and ``saturated_pixels`` are
    those that are saturated in all of them.
    ``file`` and ``frames_file`` are relative to the session, with forward slashes. ``sha256``
    is None inside the file itself.
    """

    index: int
    uid: str
    kind: CaptureKind
    target: str
    orientation_deg: float
    height_asked_mm: float
    height_mm: float
    frames_used: int
    incomplete_frames: int
    resent_packets: int
    saturated_pixels: int
    min_dn: float
    max_dn: float
    exposure_us: float | None
    gain_db: float | None
    pixel_format: str
    black_level_dn: float
    max_level_dn: float
    started_utc: str
    finished_utc: str
    first_timestamp_ns: int | None
    last_timestamp_ns: int | None
    focus_value: float | None
    scale_px_per_mm: float | None
    file: str
    frames_file: str | None
    frames_sha256: str | None
    sha256: str | None
    gain: float | None = None
    gain_unit: str | None = None
    black_level: float | None = None
    black_level_unit: str | None = None
    bracket: tuple[BracketExposure, ...] | None = None

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True)

    def __post_init__(self) -> None:
        for name in ("index", "incomplete_frames", "resent_packets", "saturated_pixels"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if self.frames_used < 1:
            raise ValueError(f"frames_used must be at least 1, got {self.frames_used}")
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"{field.name} must be finite, got {value}")
        for name in ("started_utc", "finished_utc"):
            if not _UTC_TEXT.fullmatch(getattr(self, name)):
                raise ValueError(f"{name} must be a time in UTC, got {getattr(self, name)!r}")
        for name in ("file", "frames_file"):
            path = getattr(self, name)
            if path is not None and not _is_inside(path):
                got = (
                    path if len(path) <= _LONGEST_PATH else f"{path[:20]}... ({len(path)} letters)"
                )
                raise ValueError(f"{name} must be a file inside the session, got {got}")

    def to_json(self) -> dict[str, Any]:
        """The record as a JSON object, which ``from_json`` reads back exactly.

        It is that of earlier versions where there is no bracket.
        """
        document = asdict(self)
        bracket = document.pop("bracket")
        return document if bracket is None else {**document, "bracket": list(bracket)}

    @staticmethod
    def from_json(
        document: Mapping[str, object], *, source: str = "capture record"
    ) -> "CaptureRecord":
        """Read a record; an error message starts with ``source``.

        Raises
        ------
        SessionError
            If a key is missing, unknown or of the wrong type; the message names it.
        """
        try:
            # pydantic's strict mode takes a dataclass from JSON text, not from a dict.
            return _adapter().validate_json(json.dumps(document))
        except ValidationError as error:
            raise SessionError(
                f"{source}: {validation_lines(error)}",
                fault="damaged",
                keys=validation_keys(error),
            ) from error


def _is_inside(path: str) -> bool:
    """Whether a relative path can be that of a file in its folder."""
    parts = path.split("/")
    is_short = len(path.encode(errors="surrogatepass")) <= _LONGEST_PATH
    return is_short and "" not in parts and ".." not in parts


def utc_text(moment: datetime) -> str:
    """ISO 8601 text of a moment in UTC, to the microsecond: ``2025-03-04T05:06:07.000008Z``."""
    text = moment.astimezone(UTC).isoformat(timespec="microseconds")
    return text.removesuffix("+00:00") + "Z"


@cache
def _adapter() -> TypeAdapter[CaptureRecord]:
    return TypeAdapter(CaptureRecord)
