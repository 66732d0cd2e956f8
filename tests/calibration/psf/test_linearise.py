import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.choices import Channel
from calibration.psf.linearise import luma_plane, srgb_to_linear


@pytest.mark.parametrize(
    ("code", "linear"),
    [
        # IEC 61966-2-1 by hand: c / 12.92 up to 0.04045, ((c + 0.055) / 1.055)^2.4 above.
        (0.0, 0.0),
        (10.0, 0.00303526984),
        (51.0, 0.03310476657),
        (128.0, 0.21586050011),
        (255.0, 1.0),
    ],
)
def test_srgb_codes_of_8_bits_by_hand(code: float, linear: float) -> None:
    assert srgb_to_linear(np.array([code]), 255.0)[0] == pytest.approx(255.0 * linear, rel=1e-8)


def test_the_two_pieces_of_the_srgb_curve_meet() -> None:
    below, above = srgb_to_linear(np.array([0.04045, 0.04045 + 1e-9]), 1.0)
    # The standard's rounded constants leave a step of 3e-8.
    assert above - below == pytest.approx(0.0, abs=1e-7)


@given(value=st.floats(0.0, 1.0), full_scale=st.sampled_from([1.0, 255.0, 65_535.0]))
def test_the_curve_is_the_inverse_of_the_encoding(value: float, full_scale: float) -> None:
    encoded = 12.92 * value if value <= 0.0031308 else 1.055 * value ** (1 / 2.4) - 0.055
    decoded = srgb_to_linear(np.array([encoded * full_scale]), full_scale)[0]
    assert decoded == pytest.approx(value * full_scale, abs=1e-7 * full_scale)


def test_integer_codes_are_decoded_in_double_precision() -> None:
    decoded = srgb_to_linear(np.array([[0, 128, 255]], dtype=np.uint8), 255.0)
    assert decoded.dtype == np.float64
    assert decoded[0, 1] == pytest.approx(55.044427528)


@pytest.mark.parametrize("full_scale", [0.0, -1.0, float("nan")])
def test_a_full_scale_that_is_not_positive_is_refused(full_scale: float) -> None:
    with pytest.raises(ValueError):
        srgb_to_linear(np.ones(3), full_scale)


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
