"""One capture with every field set, and the same with every field that may be unknown, unknown."""

from dataclasses import replace

import numpy as np

from acquisition.session._capture_files import CaptureImages, capture_parts
from acquisition.session._record import CaptureRecord

RECORD = CaptureRecord(
    index=7,
    uid="u7",
    kind="edge",
    target="Kante µ, 日本 😀",
    orientation_deg=90.0,
    height_asked_mm=123.4,
    height_mm=123.398,
    frames_used=10,
    incomplete_frames=1,
    resent_packets=2,
    saturated_pixels=3,
    min_dn=60.0,
    max_dn=4095.0,
    exposure_us=2000.5,
    gain_db=0.0,
    pixel_format="Mono12",
    black_level_dn=64.0,
    max_level_dn=4095.0,
    started_utc="2025-03-04T05:06:07.000000Z",
    finished_utc="2025-03-04T05:06:08.000000Z",
    first_timestamp_ns=123_456_789_012_345_678,
    last_timestamp_ns=123_456_789_212_345_678,
    focus_value=0.0123,
    scale_px_per_mm=12.345,
    file="captures/0007_edge-090_h0123.400mm.tif",
    frames_file="frames/0007_edge-090_h0123.400mm.tif",
    frames_sha256="ab" * 32,
    sha256="cd" * 32,
    gain=0.0,
    gain_unit="dB",
    black_level=1.5625,
    black_level_unit="%",
)

PHOTOGRAPH = replace(
    RECORD,
    frames_used=1,
    exposure_us=None,
    gain_db=None,
    gain=None,
    gain_unit=None,
    black_level=None,
    black_level_unit=None,
    first_timestamp_ns=None,
    last_timestamp_ns=None,
    focus_value=None,
    scale_px_per_mm=None,
    frames_file=None,
    frames_sha256=None,
    sha256=None,
)


def images(record: CaptureRecord = RECORD, rows: int = 5, cols: int = 9) -> CaptureImages:
    """Levels that tell every pixel and page apart; no symmetry in shape or content."""
    mean_dn = (np.arange(rows * cols).reshape(rows, cols) / 7).astype(np.float32)
    return CaptureImages(
        mean_dn=mean_dn,
        variance_dn2=None if record.frames_used == 1 else mean_dn + np.float32(1000),
        record=record,
    )


def capture_bytes(images: CaptureImages) -> bytes:
    """The whole file of a capture."""
    return b"".join(capture_parts(images))
