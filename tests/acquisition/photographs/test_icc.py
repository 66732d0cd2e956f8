"""Profiles by littlecms, by imagecodecs and byte by byte; the standard's formulas are the truth."""

import io
import struct
import tracemalloc

import imagecodecs
import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from PIL import Image, ImageCms

from acquisition.photographs.encoding import ProfileError, read_profile
from tests.acquisition.photographs.profiles import (
    DISPLAY_P3,
    SRGB_CURVE,
    curve_of,
    gamma_curve,
    parametric,
    profile,
)

X = np.linspace(0.0, 1.0, 501)
TOLERANCE = 1e-3  # of white: the reader's own, for calling a curve by its name


def decoded(data: bytes) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """What green decodes to."""
    three = np.repeat(X[np.newaxis, :, np.newaxis], 3, axis=2)
    return read_profile(data).encoding.decode(three, 1.0)[0, :, 1]


def test_the_profile_of_littlecms_is_srgb() -> None:
    made = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    found = read_profile(made)
    assert found.encoding.name == "srgb"
    assert "sRGB" in found.name


@pytest.mark.parametrize(
    ("made", "name"),
    [
        (imagecodecs.cms_profile("srgb"), "srgb"),
        (imagecodecs.cms_profile("adobergb"), "gamma:2.199"),
        (imagecodecs.cms_profile("rgb", gamma=1.8), "gamma:1.8"),
    ],
)
def test_profiles_of_imagecodecs_have_their_usual_names(made: bytes, name: str) -> None:
    assert read_profile(made).encoding.name == name


def test_display_p3_has_the_curve_of_srgb() -> None:
    found = read_profile(DISPLAY_P3)
    assert (found.encoding.name, found.name) == ("srgb", "Display P3")


@pytest.mark.parametrize(
    ("curve", "name"),
    [
        (curve_of(), "linear"),
        (curve_of(256), "linear"),
        (curve_of(0, 65535), "linear"),
        (curve_of(563), "gamma:2.199"),  # Adobe RGB (1998), 4.3.4.2: 2 and 51/256
        (curve_of(461), "gamma:1.801"),  # ProPhoto RGB, 1.8 in u8Fixed8
        (curve_of(*(round(65535 * (i / 1023) ** 2.2) for i in range(1024))), "gamma:2.2"),
        (parametric(0, 2.2), "gamma:2.2"),
        (parametric(0, 1.0), "linear"),
        (parametric(3, 1.8, 1.0, 0.0, 1 / 16, 1 / 32), "gamma:1.8"),  # ROMM RGB, with its toe
        (SRGB_CURVE, "srgb"),
        (parametric(4, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045, 0.0, 0.0), "srgb"),
    ],
)
def test_a_usual_curve_has_its_usual_name(curve: bytes, name: str) -> None:
    for space in (b"RGB ", b"GRAY"):
        assert read_profile(profile(curve, space=space)).encoding.name == name


@pytest.mark.parametrize(
    ("curve", "expected"),
    [
        # Kinds 1 and 2: a power that is cut off at -b/a; 2 adds c everywhere, of which white
        # takes the part that keeps it at 1.
        (parametric(1, 2.0, 1.2, -0.2), np.maximum(1.2 * X - 0.2, 0) ** 2),
        (parametric(2, 2.0, 0.9, 0.0, 0.19), (0.9 * X) ** 2 + 0.19),
        (parametric(2, 2.0, 1.1, -0.2, 0.19), np.maximum(1.1 * X - 0.2, 0) ** 2 + 0.19),
        # Kind 4 in full: both pieces with an offset.
        (
            parametric(4, 2.0, 0.9, 0.0, 0.5, 0.5, 0.19, 0.1425),
            np.where(X >= 0.5, (0.9 * X) ** 2 + 0.19, 0.5 * X + 0.1425),
        ),
        (curve_of(0, 10000, 65535), np.interp(X, [0, 0.5, 1], [0, 10000 / 65535, 1])),
        # CIE L*: a cube with a straight foot.
        (
            parametric(3, 3.0, 1 / 1.16, 0.16 / 1.16, 1 / 9.033, 0.08),
            np.where(X >= 0.08, ((X + 0.16) / 1.16) ** 3, X / 9.033),
        ),
    ],
)
def test_another_curve_is_taken_as_it_is_with_white_at_white(
    curve: bytes, expected: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
) -> None:
    data = profile(curve)
    assert read_profile(data).encoding.name == "icc"
    np.testing.assert_allclose(decoded(data), expected / expected[-1], atol=3e-4)


def test_three_curves_are_kept_apart() -> None:
    encoding = read_profile(profile(gamma_curve(1.0), gamma_curve(2.0), gamma_curve(3.0))).encoding
    assert encoding.name == "icc"
    np.testing.assert_allclose(
        encoding.decode(np.full((1, 1, 3), 0.5), 1.0)[0, 0], [0.5, 0.25, 0.125], atol=1e-6
    )


def cmyk_profile() -> bytes:
    return profile(space=b"CMYK")


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\0" * 200,
        cmyk_profile(),
        profile(),  # of tables alone
        ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes(),
        profile(curve_of(0)),  # everything is white
        profile(curve_of(65535, 0)),
        profile(curve_of(30000, 30001)),
        profile(parametric(7, 1.0)),
        profile(parametric(3, 1.0)),
        profile(b"mft2" + bytes(40)),
    ],
)
def test_a_profile_without_a_rising_curve_is_refused(data: bytes) -> None:
    with pytest.raises(ProfileError) as refused:
        read_profile(data)
    assert "--encoding" in str(refused.value)


def test_a_thousand_tags_on_the_same_megabytes_are_not_copied() -> None:
    size = 4 << 20
    tags = b"".join(struct.pack(">4sII", b"%04d" % i, 132, size) for i in range(999))
    data = DISPLAY_P3[:128] + struct.pack(">I", 999) + tags + bytes(size)
    tracemalloc.start()
    with pytest.raises(ProfileError):
        read_profile(data)
    assert tracemalloc.get_traced_memory()[1] < size
    tracemalloc.stop()


@given(
    at=st.integers(0, len(DISPLAY_P3) - 1),
    bits=st.integers(1, 255),
    length=st.integers(0, len(DISPLAY_P3)),
)
@example(at=128, bits=255, length=len(DISPLAY_P3))
def test_a_damaged_profile_is_read_or_refused(at: int, bits: int, length: int) -> None:
    damaged = bytearray(DISPLAY_P3)
    damaged[at] ^= bits
    for data in (bytes(damaged), DISPLAY_P3[:length]):
        try:
            found = decoded(data)
        except ProfileError:
            continue
        assert np.isfinite(found).all()
        assert (np.diff(found) >= 0).all()
        assert found[-1] == pytest.approx(1.0)


def test_pillow_carries_our_profile_unchanged() -> None:
    buffer = io.BytesIO()
    Image.new("L", (4, 4)).save(buffer, "JPEG", icc_profile=DISPLAY_P3)
    assert Image.open(buffer).info["icc_profile"] == DISPLAY_P3
    assert ImageCms.getProfileName(ImageCms.ImageCmsProfile(io.BytesIO(DISPLAY_P3)))
