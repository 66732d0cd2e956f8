"""The place is removed from a JPEG, and nothing of its pixels."""

import io

import numpy as np
import pytest
from hypothesis import given, strategies as st
from PIL import Image, ImageCms

from standoff.console.photographs._jpeg import JpegError, jpeg_size, without_location

GPS, MAKE, EXIF_IFD, EXPOSURE = 0x8825, 0x010F, 0x8769, 0x829A
PLACE = b"51.4778"


def photograph(*, is_progressive: bool = False) -> bytes:
    pixels = np.random.default_rng(1).integers(0, 255, (64, 80, 3), np.uint8)
    exif = Image.Exif()
    exif[MAKE] = "Maker"
    exif.get_ifd(EXIF_IFD)[EXPOSURE] = 0.01
    exif.get_ifd(GPS)[2] = (51.0, 28.0, 40.0)
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    made = io.BytesIO()
    Image.fromarray(pixels).save(
        made, "JPEG", quality=90, exif=exif, icc_profile=profile, progressive=is_progressive,
        comment=b"taken at " + PLACE, restart_marker_rows=1,
    )  # fmt: skip
    data = made.getvalue()
    xmp = b"http://ns.adobe.com/xap/1.0/\0<exif:GPSLatitude>" + PLACE
    segment = b"\xff\xe1" + (len(xmp) + 2).to_bytes(2, "big") + xmp
    return data[:2] + segment + data[2:]


def decoded(data: bytes) -> Image.Image:
    opened = Image.open(io.BytesIO(data))
    opened.load()
    return opened


@pytest.mark.parametrize("is_progressive", [False, True])
def test_the_place_goes_and_all_else_stays(is_progressive: bool) -> None:
    data = photograph(is_progressive=is_progressive)
    assert GPS in decoded(data).getexif()
    assert data.count(PLACE) == 2
    film = b"ftypmp42 with its own place " + PLACE
    found = without_location(data + film)
    assert PLACE not in found
    before, after = decoded(data), decoded(found)
    np.testing.assert_array_equal(np.asarray(before), np.asarray(after))
    assert GPS not in after.getexif()
    assert after.getexif()[MAKE] == "Maker"
    assert float(after.getexif().get_ifd(EXIF_IFD)[EXPOSURE]) == pytest.approx(0.01)
    assert after.info["icc_profile"] == before.info["icc_profile"]


def test_texts_that_may_name_the_place_go_and_the_way_up_stays() -> None:
    exif = Image.Exif()
    exif[0x010E] = "seen at " + PLACE.decode()
    exif[0x9C9C] = PLACE.decode().encode("utf-16-le")
    exif[0x0112] = 6
    within = exif.get_ifd(EXIF_IFD)
    within[0x9286] = b"ASCII\0\0\0" + PLACE
    within[0x927C] = b"Maker\0" + PLACE
    within[EXPOSURE] = 0.01
    made = io.BytesIO()
    Image.new("L", (64, 48)).save(made, "JPEG", exif=exif)
    data = made.getvalue()
    wide = PLACE.decode().encode("utf-16-le")
    assert (data.count(PLACE), data.count(wide)) == (3, 1)
    found = without_location(data)
    assert (found.count(PLACE), found.count(wide)) == (0, 0)
    after = decoded(found).getexif()
    assert after[0x0112] == 6
    assert float(after.get_ifd(EXIF_IFD)[EXPOSURE]) == pytest.approx(0.01)


def test_of_exif_that_cannot_be_read_nothing_stays() -> None:
    made = io.BytesIO()
    Image.new("L", (64, 48)).save(made, "JPEG")
    body = b"Exif\0\0no tags at all " + PLACE
    segment = b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body
    found = without_location(made.getvalue()[:2] + segment + made.getvalue()[2:])
    assert PLACE not in found
    assert decoded(found).size == (64, 48)


def test_it_is_done_once_and_for_all() -> None:
    once = without_location(photograph())
    np.testing.assert_array_equal(
        np.asarray(decoded(without_location(once))), np.asarray(decoded(once))
    )


@given(st.integers(0, 4000), st.binary(max_size=8))
def test_a_damaged_file_is_refused_or_read_and_never_crashes(at: int, damage: bytes) -> None:
    data = photograph()
    at %= len(data)
    try:
        jpeg_size(data[:at] + damage + data[at + len(damage) :])
        without_location(data[:at] + damage + data[at + len(damage) :])
    except JpegError:
        pass


@pytest.mark.parametrize("data", [b"", b"\xff", b"\x89PNG\r\n", photograph()[:300]])
def test_what_is_no_whole_jpeg_file_is_refused(data: bytes) -> None:
    with pytest.raises(JpegError):
        without_location(data)


@pytest.mark.parametrize("marker", [0x00, 0x01, *range(0xD0, 0xDA)])
def test_a_marker_without_a_length_does_not_hide_the_size(marker: int) -> None:
    data = b"\xff\xd8\xff" + bytes([marker]) + photograph()[2:]
    for read in (jpeg_size, without_location):
        with pytest.raises(JpegError, match="headers"):
            read(data)


@pytest.mark.parametrize("is_progressive", [False, True])
def test_the_size_is_read_before_anything_is_decoded(is_progressive: bool) -> None:
    assert jpeg_size(photograph(is_progressive=is_progressive)) == (80, 64)
    assert jpeg_size(photograph(is_progressive=is_progressive)[:1500]) == (80, 64)
