import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.choices import Channel
from calibration.psf import luma_plane


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
