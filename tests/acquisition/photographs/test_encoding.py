"""Encodings between files, light and screens, and the colour profiles that state them."""

import io
import struct
import tracemalloc
from typing import Any

import imagecodecs
import numpy as np
import pytest
import skimage.data
from hypothesis import example, given, strategies as st
from numpy.typing import NDArray
from PIL import Image, ImageCms

from acquisition.photographs import linear_to_srgb, luma_plane, on_screen, white_level_dn
from acquisition.photographs._encoding import LINEAR, SRGB, Encoding, ProfileError, read_profile
from calibration.choices import Channel
from tests.acquisition.photographs.made import (
    DISPLAY_P3,
    SRGB_CURVE,
    curve_of,
    gamma_curve,
    parametric,
    profile,
)

GAMMA = Encoding(name="gamma:2.2")
LOW, HIGH = np.linspace(0.0, 1.0, 4096), np.linspace(0.0, 1.0, 4096) ** 1.7
CURVE = Encoding(name="icc", curves=(HIGH,))
ENCODINGS = (LINEAR, SRGB, GAMMA, Encoding(name="gamma:0.45"), CURVE)
levels = st.floats(min_value=-2.0, max_value=3.0, allow_subnormal=False)


def one(value: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array([[value]])


@pytest.mark.parametrize(
    ("encoded", "linear"),
    [
        (0.0, 0.0),
        (10 / 255, 10 / 255 / 12.92),  # on the linear segment
        (0.04045, 0.04045 / 12.92),  # its end
        (0.5, 0.214041140482),
        (0.735357, 0.5),
        (1.0, 1.0),
    ],
)
def test_srgb_is_that_of_the_standard(encoded: float, linear: float) -> None:
    assert SRGB.decode(one(encoded), 1.0)[0, 0] == pytest.approx(linear, abs=1e-6)
    assert SRGB.encode(one(linear), 1.0)[0, 0] == pytest.approx(encoded, abs=1e-6)


def test_a_gamma_is_a_power_of_the_fraction_of_white() -> None:
    assert GAMMA.decode(np.array([[51]], np.uint8), 255.0)[0, 0] == pytest.approx(
        255 * 0.2**2.2, rel=1e-12
    )


@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
@pytest.mark.parametrize("white", [np.uint8(255), np.uint16(65535), np.float64(1.0)])
def test_white_keeps_its_level_and_black_too(encoding: Encoding, white: np.generic) -> None:
    both = np.array([[0, white]], dtype=white.dtype)
    np.testing.assert_allclose(encoding.decode(both, float(white)), both, rtol=1e-15)
    np.testing.assert_allclose(encoding.encode(both, float(white)), both, rtol=1e-15)


@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
@given(level=levels)
def test_encoding_undoes_decoding_below_black_and_beyond_white_too(
    encoding: Encoding, level: float
) -> None:
    back = encoding.encode(encoding.decode(one(level), 1.0), 1.0)[0, 0]
    # The standard's two segments of sRGB meet to 1e-8; a cell of the table is 1/4095 wide and
    # its lowest one is straight, with a slope of 1e-3.
    assert back == pytest.approx(level, rel=1e-9, abs=1e-7)


@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
@given(first=levels, second=levels)
def test_more_light_is_a_higher_level(encoding: Encoding, first: float, second: float) -> None:
    low, high = sorted((first, second))
    dark, bright = encoding.decode(np.array([[low, high]]), 1.0)[0]
    # To the width of the joint of sRGB's segments.
    assert dark <= bright + 1e-8


@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
@given(level=levels)
def test_a_level_below_black_mirrors_the_one_above(encoding: Encoding, level: float) -> None:
    up, down = (encoding.decode(one(value), 1.0)[0, 0] for value in (level, -level))
    assert down == -up


def test_beyond_white_levels_go_on_as_steeply_as_they_reach_it() -> None:
    at, beyond = GAMMA.decode(np.array([[1.0, 1.5]]), 1.0)[0]
    assert (beyond - at) / 0.5 == pytest.approx(2.2, rel=1e-3)  # the derivative of x ** 2.2 at 1


@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_large_images_give_what_single_pixels_give(
    encoding: Encoding, kind: type[np.unsignedinteger[Any]]
) -> None:
    white = float(np.iinfo(kind).max)
    every: NDArray[Any] = np.arange(int(white) + 1, dtype=kind).reshape(-1, 1)
    large = np.concatenate([every, every], axis=1)
    np.testing.assert_allclose(
        encoding.decode(large, white)[:, 0],
        encoding.decode(every.astype(np.float64), white)[:, 0],
        rtol=1e-14,
    )


def test_each_channel_has_its_own_curve() -> None:
    encoding = Encoding(name="icc", curves=(LOW, LOW**2, LOW**3))
    half = np.full((2, 2, 3), 0.5)
    np.testing.assert_allclose(
        encoding.decode(half, 1.0), np.broadcast_to([0.5, 0.25, 0.125], (2, 2, 3)), atol=1e-7
    )
    with pytest.raises(ValueError):
        encoding.decode(half[:, :, 0], 1.0)


def test_a_curve_that_leaves_light_at_black_keeps_it() -> None:
    encoding = Encoding(name="icc", curves=(0.1 + 0.9 * LOW,))
    assert encoding.decode(np.zeros((1, 1)), 1.0)[0, 0] == pytest.approx(0.1)


def test_a_curve_that_is_flat_at_white_has_a_finite_inverse() -> None:
    encoding = Encoding(name="icc", curves=(np.minimum(1.25 * LOW, 1.0),))
    assert np.isfinite(encoding.encode(one(1.2), 1.0)).all()


@pytest.mark.parametrize(
    "name",
    [
        *("", "gamma", "gamma:", "gamma:0", "gamma:nan", "gamma:inf", "gamma:-2", "gamma:1e1"),
        *("gamma:0.1", "gamma:11", "gamma:2,2", " gamma:2.2", "gamma:٢", "sRGB", "Linear", "icc"),
    ],
)
def test_a_name_is_of_one_spelling_and_in_its_range(name: str) -> None:
    with pytest.raises(ValueError):
        Encoding(name=name)


astronaut: Any = skimage.data.astronaut  # it states no types


def test_a_file_of_srgb_is_shown_as_it_is() -> None:
    stored = astronaut()
    shown = on_screen(SRGB.decode(stored, 255.0), 255.0)
    np.testing.assert_allclose(255 * shown, stored, atol=0.01)
    # Its brightest pixels are white already: the stretch leaves it as a viewer shows it.
    assert white_level_dn(SRGB.decode(stored, 255.0)) == pytest.approx(255.0, rel=0.01)


def test_one_white_for_all_channels_keeps_their_ratios() -> None:
    # Worked example: twice the light of all channels is the same picture.
    dark = np.random.default_rng(0).uniform(0, 50, (40, 50, 3)) * (1.0, 0.5, 0.2)
    pictures = [on_screen(levels, white_level_dn(levels)) for levels in (dark, 2 * dark)]
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=1e-12)
    red, _, blue = on_screen(np.array([[[50.0, 25.0, 10.0]]]), 50.0)[0, 0]
    assert (red, blue) == pytest.approx((1.0, 1.055 * 0.2 ** (1 / 2.4) - 0.055), rel=1e-12)


def test_the_curve_is_that_of_the_standard() -> None:
    # IEC 61966-2-1: a linear share of 0.0031308 is 0.04045, 18 % is 0.4614.
    values = linear_to_srgb(np.array([0.0, 0.0031308, 0.18, 1.0]))
    np.testing.assert_allclose(values, [0.0, 0.04045, 0.4614, 1.0], atol=1e-4)


def test_the_luma_weights_are_those_of_rec_601() -> None:
    primaries = np.eye(3)[None] * 1000.0
    np.testing.assert_allclose(luma_plane(primaries)[0], [299.0, 587.0, 114.0])


@given(level=st.integers(0, 65_535))
def test_the_luma_of_a_grey_is_that_grey(level: int) -> None:
    image = np.full((2, 3, 3), level, dtype=np.uint16)
    np.testing.assert_allclose(luma_plane(image), np.full((2, 3), float(level)), rtol=1e-12)


@pytest.mark.parametrize(("channel", "level"), [("red", 1.0), ("green", 2.0), ("blue", 3.0)])
def test_a_channel_is_taken_as_it_is(channel: Channel, level: float) -> None:
    image = np.tile(np.array([1.0, 2.0, 3.0, 99.0]), (4, 5, 1))
    np.testing.assert_array_equal(luma_plane(image, channel), np.full((4, 5), level))
    np.testing.assert_array_equal(luma_plane(image[:, :, :3], channel), np.full((4, 5), level))


def test_opacity_is_left_out() -> None:
    grey = np.arange(12).reshape(3, 4)
    with_opacity = np.stack([grey, np.full_like(grey, 255)], axis=-1)
    np.testing.assert_array_equal(luma_plane(with_opacity), grey)
    np.testing.assert_array_equal(luma_plane(grey[:, :, None]), grey)


def test_a_grey_image_has_no_colour_to_select() -> None:
    with pytest.raises(ValueError):
        luma_plane(np.ones((3, 4)), "green")
    with pytest.raises(ValueError):
        luma_plane(np.ones((3, 4, 2)), "red")


@pytest.mark.parametrize("shape", [(3,), (3, 4, 5), (2, 3, 4, 3)])
def test_what_is_no_image_is_refused_with_its_shape(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError):
        luma_plane(np.ones(shape))


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
