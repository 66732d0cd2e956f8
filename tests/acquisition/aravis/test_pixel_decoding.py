import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from acquisition.aravis.stream import can_decode, decode_pixels, encoded_bytes


def pack_12(levels: NDArray[np.uint16]) -> bytes:
    """Encoder written pixel by pixel from the standard's picture."""
    packed = bytearray()
    flat = [int(level) for level in levels.ravel()]
    for first, second in zip(flat[::2], flat[1::2], strict=False):
        packed += bytes([first >> 4, (first & 15) | (second & 15) << 4, second >> 4])
    if len(flat) % 2:
        packed += bytes([flat[-1] >> 4, flat[-1] & 15])
    return bytes(packed)


twelve_bit = hnp.arrays(
    np.uint16,
    st.tuples(st.integers(1, 7), st.integers(1, 7)),
    elements=st.integers(0, 4095),
)


def test_the_low_nibble_belongs_to_the_first_pixel_and_the_high_one_to_the_second() -> None:
    image_dn = decode_pixels(bytes([0x12, 0x63, 0x45]), "Mono12Packed", (1, 2))  # by hand
    assert image_dn.tolist() == [[0x123, 0x456]]


def test_an_odd_last_pixel_takes_two_bytes() -> None:
    data = bytes([0x12, 0x63, 0x45, 0xAB, 0x0C])
    assert decode_pixels(data, "Mono12Packed", (3, 1)).tolist() == [[0x123], [0x456], [0xABC]]
    assert encoded_bytes("Mono12Packed", (3, 1)) == 5


@pytest.mark.slow
@pytest.mark.parametrize("pixel_format", ["Mono12Packed", "BayerRG12Packed", "BayerGB12Packed"])
@given(twelve_bit)
def test_packed_pixels_come_back_bit_exact(pixel_format: str, levels: NDArray[np.uint16]) -> None:
    data = pack_12(levels)
    assert encoded_bytes(pixel_format, levels.shape) == len(data)
    np.testing.assert_array_equal(decode_pixels(data, pixel_format, levels.shape), levels)


@pytest.mark.slow
@pytest.mark.parametrize("pixel_format", ["Mono12", "Mono16", "BayerGR12", "BayerBG16", "Mono10"])
@given(twelve_bit)
def test_two_byte_pixels_are_little_endian_in_the_low_bits(
    pixel_format: str, levels: NDArray[np.uint16]
) -> None:
    data = levels.astype("<u2").tobytes()
    image_dn = decode_pixels(data, pixel_format, levels.shape)
    assert image_dn.dtype == np.uint16
    np.testing.assert_array_equal(image_dn, levels)


@pytest.mark.parametrize("pixel_format", ["Mono8", "BayerRG8"])
def test_one_byte_pixels_stay_bytes(pixel_format: str) -> None:
    image_dn = decode_pixels(bytes(range(6)), pixel_format, (2, 3))
    assert image_dn.dtype == np.uint8
    assert image_dn.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_padding_after_the_picture_is_not_read() -> None:
    assert decode_pixels(bytes([1, 2, 9, 9]), "Mono8", (1, 2)).tolist() == [[1, 2]]


@pytest.mark.parametrize("pixel_format", ["Mono8", "Mono12", "Mono12Packed"])
def test_a_short_block_is_refused_not_read_beyond_its_end(pixel_format: str) -> None:
    data = bytes(encoded_bytes(pixel_format, (3, 5)) - 1)
    with pytest.raises(ValueError):
        decode_pixels(data, pixel_format, (3, 5))


@pytest.mark.parametrize("pixel_format", ["Mono12p", "RGB8", "YUV422Packed", "Mono8Packed", ""])
def test_a_format_without_a_decoder_is_named(pixel_format: str) -> None:
    assert not can_decode(pixel_format)
    with pytest.raises(ValueError) as refused:
        decode_pixels(bytes(64), pixel_format, (2, 2))
    assert repr(pixel_format) in str(refused.value)
