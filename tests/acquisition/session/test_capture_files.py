"""The files of a capture, and its record."""

import hashlib
import io
import json
import struct
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import tifffile
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from PIL import Image

from acquisition.errors import SessionError
from acquisition.session._capture_files import (
    CaptureImages,
    capture_seal,
    frames_parts,
    is_sealed,
    parse_capture,
    read_capture,
)
from acquisition.session._record import CaptureRecord, utc_text
from tests.acquisition.records import PHOTOGRAPH, RECORD, capture_bytes, images

X_RESOLUTION, RESOLUTION_UNIT, COMPRESSION = 282, 296, 259


@pytest.mark.parametrize("record", [RECORD, PHOTOGRAPH])
def test_a_capture_reads_back_bit_for_bit_with_its_record(record: CaptureRecord) -> None:
    stored = images(record)
    read = parse_capture(capture_bytes(stored), source="file")
    assert read.record == replace(record, sha256=None)
    np.testing.assert_array_equal(read.mean_dn, stored.mean_dn)
    assert read.mean_dn.dtype == np.dtype("=f4")
    if stored.variance_dn2 is None:
        assert read.variance_dn2 is None
    else:
        np.testing.assert_array_equal(read.variance_dn2, stored.variance_dn2)


def test_the_same_capture_gives_the_same_bytes() -> None:
    assert capture_bytes(images()) == capture_bytes(images())


@pytest.mark.slow
@given(st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=50))
def test_any_text_survives_in_the_info(target: str) -> None:
    stored = images(replace(RECORD, target=target))
    assert parse_capture(capture_bytes(stored), source="file").record.target == target


def test_the_bytes_are_those_that_tifffile_writes_and_a_seal() -> None:
    stored = images(replace(RECORD, scale_px_per_mm=None))
    pages = np.stack([stored.mean_dn, cast("NDArray[np.float32]", stored.variance_dn2)])
    document = replace(stored.record, sha256=None).to_json()
    peer = io.BytesIO()
    tifffile.imwrite(
        peer,
        pages,
        imagej=True,
        byteorder="<",
        photometric="minisblack",
        metadata={
            "axes": "ZYX",
            "seal": "sha256",
            "Labels": ["mean", "variance"],
            "Info": json.dumps(document, indent=1),
        },
    )
    assert capture_bytes(stored) == peer.getvalue()
    sha256 = hashlib.sha256(peer.getvalue()).hexdigest()
    assert capture_seal(sha256) == (f"\nSHA-256 of this file before this line: {sha256}\n".encode())


def sealed_file() -> bytes:
    data = capture_bytes(images())
    return data + capture_seal(hashlib.sha256(data).hexdigest())


def test_a_sealed_file_is_read_and_vouches_for_itself() -> None:
    data = sealed_file()
    assert is_sealed(data) is True
    np.testing.assert_array_equal(parse_capture(data, source="file").mean_dn, images().mean_dn)


@given(st.data())
def test_a_sealed_file_with_any_bit_flipped_or_cut_short_does_not_vouch(
    data: st.DataObject,
) -> None:
    whole = sealed_file()
    at = data.draw(st.integers(0, 8 * len(whole) - 1))
    flipped = bytearray(whole)
    flipped[at // 8] ^= 1 << at % 8
    assert is_sealed(bytes(flipped)) is not True
    assert is_sealed(whole[: data.draw(st.integers(0, len(whole) - 1))]) is not True


def test_a_file_that_lost_its_seal_alone_is_not_taken_for_one_of_an_older_version() -> None:
    data = capture_bytes(images())
    assert is_sealed(data) is False
    older = data.replace(b"\nseal=sha256\n", b"\nmake=other.\n")
    assert is_sealed(older) is None


@pytest.mark.parametrize("turn", [np.transpose, np.flip])
def test_an_image_may_lie_in_memory_as_it_likes(
    turn: Callable[[NDArray[np.float32]], NDArray[np.float32]],
) -> None:
    stored = images()
    mean, variance = turn(stored.mean_dn), turn(cast("NDArray[np.float32]", stored.variance_dn2))
    turned = replace(stored, mean_dn=mean, variance_dn2=variance)
    read = parse_capture(capture_bytes(turned), source="file")
    np.testing.assert_array_equal(read.mean_dn, mean)
    np.testing.assert_array_equal(cast("NDArray[np.float32]", read.variance_dn2), variance)


def test_imagej_finds_two_labelled_slices_the_scale_in_mm_and_the_info() -> None:
    with tifffile.TiffFile(io.BytesIO(capture_bytes(images()))) as tiff:
        metadata = tiff.imagej_metadata
        tags = tiff.pages.first.tags
        assert len(tiff.pages) == 2
    assert metadata is not None
    assert metadata["Labels"] == ["mean", "variance"]
    assert (metadata["slices"], metadata["unit"]) == (2, "mm")
    assert json.loads(metadata["Info"])["target"] == RECORD.target
    numerator, denominator = tags[X_RESOLUTION].value
    assert numerator / denominator == pytest.approx(RECORD.scale_px_per_mm)
    assert tags[RESOLUTION_UNIT].value == 1  # ImageJ takes the unit from its own metadata
    assert tags[COMPRESSION].value == 1


def test_a_capture_without_a_scale_claims_none() -> None:
    data = capture_bytes(images(replace(RECORD, scale_px_per_mm=None)))
    with tifffile.TiffFile(io.BytesIO(data)) as tiff:
        assert "unit" not in (tiff.imagej_metadata or {})


def test_another_reader_sees_the_same_pages() -> None:
    stored = images()
    assert stored.variance_dn2 is not None
    with Image.open(io.BytesIO(capture_bytes(stored))) as picture:
        np.testing.assert_array_equal(np.asarray(picture), stored.mean_dn)
        picture.seek(1)
        np.testing.assert_array_equal(np.asarray(picture), stored.variance_dn2)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_raw_frames_are_a_page_each_in_order(dtype: type) -> None:
    frames: list[NDArray[Any]] = [np.full((3, 5), level, dtype) for level in (7, 200, 9)]
    data = b"".join(frames_parts(frames))
    with tifffile.TiffFile(io.BytesIO(data)) as tiff:
        assert len(tiff.pages) == 3
        pages = tiff.asarray()
    assert pages.dtype == np.uint16
    np.testing.assert_array_equal(pages, frames)


def test_a_file_that_is_no_capture_says_so(tmp_path: Path) -> None:
    path = tmp_path / "other.tif"
    tifffile.imwrite(path, np.zeros((4, 4), np.uint8))
    with pytest.raises(SessionError) as refused:
        read_capture(path)
    assert refused.value.fault == "not a session"
    path.write_bytes(b"II")
    with pytest.raises(SessionError) as refused:
        read_capture(path)
    assert refused.value.fault == "damaged"
    with pytest.raises(SessionError) as refused:
        read_capture(tmp_path / "absent.tif")
    assert refused.value.path == tmp_path / "absent.tif"


CAPTURE = capture_bytes(images())


@given(st.integers(0, len(CAPTURE) - 1))
def test_a_file_cut_short_anywhere_is_refused_or_whole(length: int) -> None:
    try:
        read = parse_capture(CAPTURE[:length], source="file")
    except SessionError:
        return
    np.testing.assert_array_equal(read.mean_dn, images().mean_dn)


def test_a_variance_belongs_to_more_than_one_frame() -> None:
    image = np.zeros((2, 3), np.float32)
    with pytest.raises(ValueError):
        CaptureImages(mean_dn=image, variance_dn2=None, record=RECORD)
    with pytest.raises(ValueError):
        CaptureImages(mean_dn=image, variance_dn2=image, record=PHOTOGRAPH)
    with pytest.raises(ValueError):
        CaptureImages(mean_dn=image, variance_dn2=image.T, record=RECORD)
    with pytest.raises(ValueError):
        CaptureImages(mean_dn=image[0], variance_dn2=None, record=PHOTOGRAPH)


def test_the_file_is_little_endian_as_the_machines_that_read_it() -> None:
    assert struct.unpack("<2sH", CAPTURE[:4]) == (b"II", 42)


@pytest.mark.parametrize("record", [RECORD, PHOTOGRAPH])
def test_a_record_survives_json_text_and_back_exactly(record: CaptureRecord) -> None:
    assert CaptureRecord.from_json(json.loads(json.dumps(record.to_json()))) == record


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"index": "7"}, "index"),
        ({"index": True}, "index"),
        ({"index": -1}, "index"),
        ({"frames_used": 0}, "frames_used"),
        ({"height_mm": None}, "height_mm"),
        ({"height_mm": float("nan")}, "height_mm"),
        ({"kind": "edges"}, "kind"),
        ({"started_utc": "yesterday"}, "started_utc"),
        ({"started_utc": "2025-03-04T05:06:07"}, "started_utc"),
        ({"started_utc": "2025-03-04T05:06:07+01:00"}, "started_utc"),
        ({"file": "/etc/passwd"}, "file"),
        ({"frames_file": "frames/../../x.tif"}, "frames_file"),
        ({"file": "x" * 100_000}, "file"),
        ({"file": "é" * 200}, "file"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_a_record_that_is_not_one_names_the_key(changed: dict[str, object], key: str) -> None:
    with pytest.raises(SessionError) as refused:
        CaptureRecord.from_json({**RECORD.to_json(), **changed}, source="line 3")
    assert refused.value.fault == "damaged"
    # A key that pydantic cannot check alone is named in the text only.
    assert refused.value.keys in ((key,), ("",))
    assert key in str(refused.value)
    assert str(refused.value).startswith("line 3: ")
    assert len(str(refused.value)) < 400


STATED_SINCE = ("gain", "gain_unit", "black_level", "black_level_unit")
"""Keys that the records of earlier versions lack."""


def test_a_record_of_before_the_units_were_recorded_is_read() -> None:
    document = RECORD.to_json()
    for key in STATED_SINCE:
        del document[key]
    assert CaptureRecord.from_json(document) == replace(
        RECORD, gain=None, gain_unit=None, black_level=None, black_level_unit=None
    )


@pytest.mark.parametrize("key", [key for key in RECORD.to_json() if key not in STATED_SINCE])
def test_no_key_may_be_missing(key: str) -> None:
    document = RECORD.to_json()
    del document[key]
    with pytest.raises(SessionError) as refused:
        CaptureRecord.from_json(document)
    assert refused.value.keys == (key,)


def test_a_height_that_is_not_a_number_cannot_be_recorded() -> None:
    with pytest.raises(ValueError):
        replace(RECORD, height_mm=float("inf"))


def test_a_moment_is_written_in_utc_to_the_microsecond() -> None:
    assert utc_text(datetime(2025, 3, 4, 5, 6, 7, 8, tzinfo=UTC)) == "2025-03-04T05:06:07.000008Z"
    east = timezone(timedelta(hours=2))
    assert utc_text(datetime(2025, 3, 4, 7, 6, 7, tzinfo=east)) == "2025-03-04T05:06:07.000000Z"
