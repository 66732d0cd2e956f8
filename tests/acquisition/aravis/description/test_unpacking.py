import io
import struct
import zipfile
from contextlib import suppress

import pytest
from hypothesis import given, strategies as st

from acquisition.aravis.description import LARGEST_BYTES, DescriptionError
from acquisition.aravis.network import unpack

TEXT = b"<RegisterDescription/>" * 40


def packed(*files: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", method) as file:
        for place, data in enumerate(files):
            file.writestr(f"{place}.xml", data)
    return archive.getvalue()


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED])
def test_what_was_packed_comes_out(method: int) -> None:
    assert unpack(packed(TEXT, method=method)) == TEXT
    assert unpack(b"before the archive" + packed(TEXT, method=method) + b"\0" * 100) == TEXT


def test_of_several_files_it_is_the_last_which_aravis_takes() -> None:
    assert unpack(packed(b"one", TEXT)) == TEXT


def test_a_file_that_unpacks_to_more_than_any_description_is_refused_by_what_it_says() -> None:
    bomb = packed(bytes(LARGEST_BYTES + 1))
    assert len(bomb) < 20_000
    with pytest.raises(DescriptionError) as refused:
        unpack(bomb)
    assert refused.value.fault == "too large"


def test_a_file_that_unpacks_to_more_than_it_says_is_refused() -> None:
    archive = bytearray(packed(TEXT))
    entry = archive.index(b"PK\x01\x02")
    struct.pack_into("<I", archive, entry + 24, len(TEXT) - 1)
    with pytest.raises(DescriptionError) as refused:
        unpack(bytes(archive))
    assert refused.value.fault == "packed"


@pytest.mark.parametrize("place", [10, 12, 16])
def test_places_outside_the_archive_are_refused(place: int) -> None:
    archive = bytearray(packed(TEXT))
    end = archive.index(b"PK\x05\x06")
    struct.pack_into("<I", archive, end + place, 0x7FFFFFFF)
    with pytest.raises(DescriptionError):
        unpack(bytes(archive))


@given(st.data())
def test_a_damaged_archive_is_unpacked_or_refused(data: st.DataObject) -> None:
    archive = bytearray(packed(TEXT))
    for _ in range(data.draw(st.integers(1, 4))):
        archive[data.draw(st.integers(0, len(archive) - 1))] = data.draw(st.integers(0, 255))
    with suppress(DescriptionError):
        unpack(bytes(archive[: data.draw(st.integers(0, len(archive)))]))
    with suppress(DescriptionError):
        unpack(bytes(archive))
