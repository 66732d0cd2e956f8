import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from hil_mocks.gige._wire import PIXEL_LAYOUTS, image_of_levels, pixel_formats_of, wire_bytes

LEVELS = arrays(np.uint16, (3, 4), elements=st.integers(0, 4095))


def test_two_packed_pixels_take_three_bytes() -> None:
    # By hand, GigE Vision 1.2, "Mono12Packed": A = 0xABC, B = 0x123.
    level_dn = np.array([[0xABC, 0x123]], np.uint16)
    assert wire_bytes(level_dn, PIXEL_LAYOUTS["Mono12Packed"]).tobytes() == b"\xab\x3c\x12"


def test_mono12_is_little_endian_with_the_level_in_its_lower_bits() -> None:
    assert wire_bytes(np.array([[0xABC]], np.uint16), PIXEL_LAYOUTS["Mono12"]).tobytes() == (
        b"\xbc\x0a"
    )


def test_mono8_cuts_off_and_mono16_shifts_up() -> None:
    level_dn = np.array([[0xABF]], np.uint16)
    assert image_of_levels(level_dn, PIXEL_LAYOUTS["Mono8"])[0, 0] == 0xAB
    assert image_of_levels(level_dn, PIXEL_LAYOUTS["Mono16"])[0, 0] == 0xABF0


@given(LEVELS)
def test_packed_pixels_come_back_as_they_went(level_dn: np.ndarray) -> None:
    packed = wire_bytes(level_dn, PIXEL_LAYOUTS["Mono12Packed"]).astype(np.uint16).reshape(-1, 3)
    first = packed[:, 0] << 4 | packed[:, 1] & 0xF
    second = packed[:, 2] << 4 | packed[:, 1] >> 4
    np.testing.assert_array_equal(np.stack([first, second], axis=1).ravel(), level_dn.ravel())


def test_an_odd_number_of_packed_pixels_is_refused() -> None:
    with pytest.raises(ValueError):
        wire_bytes(np.zeros((3, 3), np.uint16), PIXEL_LAYOUTS["Mono12Packed"])


def test_the_code_of_a_format_holds_its_bits_per_pixel() -> None:
    bits = {name: layout.bits_per_pixel for name, layout in PIXEL_LAYOUTS.items()}
    assert bits["Mono8"] == bits["BayerRG8"] == 8
    assert bits["Mono12Packed"] == bits["BayerRG12Packed"] == 12
    assert bits["Mono12"] == bits["BayerRG12"] == bits["Mono16"] == 16


def test_the_colour_model_adds_the_formats_of_its_filter() -> None:
    assert pixel_formats_of("GR")[-3:] == ("BayerGR8", "BayerGR12", "BayerGR12Packed")
    assert not any("Bayer" in name for name in pixel_formats_of(None))
