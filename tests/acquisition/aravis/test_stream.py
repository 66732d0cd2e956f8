"""Frames of a stream: their pixels, and the memory where they were received."""

import ctypes
import gc
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from acquisition.aravis._device import AravisLibrary
from acquisition.aravis._stream import (
    SENTINEL,
    _decode_pixels,
    _encoded_bytes,
    _FrameMemory,
    can_decode,
)
from tests.acquisition.aravis_bench import needs_aravis, opened, sent_image
from tests.hil_mocks.gige_bench import gige_bench


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


@pytest.mark.slow
def test_the_low_nibble_belongs_to_the_first_pixel_and_the_high_one_to_the_second() -> None:
    image_dn = _decode_pixels(bytes([0x12, 0x63, 0x45]), "Mono12Packed", (1, 2))  # by hand
    assert image_dn.tolist() == [[0x123, 0x456]]


def test_an_odd_last_pixel_takes_two_bytes() -> None:
    data = bytes([0x12, 0x63, 0x45, 0xAB, 0x0C])
    assert _decode_pixels(data, "Mono12Packed", (3, 1)).tolist() == [[0x123], [0x456], [0xABC]]
    assert _encoded_bytes("Mono12Packed", (3, 1)) == 5


@pytest.mark.slow
@pytest.mark.parametrize("pixel_format", ["Mono12Packed", "BayerRG12Packed", "BayerGB12Packed"])
@given(twelve_bit)
def test_packed_pixels_come_back_bit_exact(pixel_format: str, levels: NDArray[np.uint16]) -> None:
    data = pack_12(levels)
    assert _encoded_bytes(pixel_format, levels.shape) == len(data)
    np.testing.assert_array_equal(_decode_pixels(data, pixel_format, levels.shape), levels)


@pytest.mark.slow
@pytest.mark.parametrize("pixel_format", ["Mono12", "Mono16", "BayerGR12", "BayerBG16", "Mono10"])
@given(twelve_bit)
def test_two_byte_pixels_are_little_endian_in_the_low_bits(
    pixel_format: str, levels: NDArray[np.uint16]
) -> None:
    data = levels.astype("<u2").tobytes()
    image_dn = _decode_pixels(data, pixel_format, levels.shape)
    assert image_dn.dtype == np.uint16
    np.testing.assert_array_equal(image_dn, levels)


@pytest.mark.parametrize("pixel_format", ["Mono8", "BayerRG8"])
def test_one_byte_pixels_stay_bytes(pixel_format: str) -> None:
    image_dn = _decode_pixels(bytes(range(6)), pixel_format, (2, 3))
    assert image_dn.dtype == np.uint8
    assert image_dn.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_padding_after_the_picture_is_not_read() -> None:
    assert _decode_pixels(bytes([1, 2, 9, 9]), "Mono8", (1, 2)).tolist() == [[1, 2]]


@pytest.mark.parametrize("pixel_format", ["Mono8", "Mono12", "Mono12Packed"])
def test_a_short_block_is_refused_not_read_beyond_its_end(pixel_format: str) -> None:
    data = bytes(_encoded_bytes(pixel_format, (3, 5)) - 1)
    with pytest.raises(ValueError):
        _decode_pixels(data, pixel_format, (3, 5))


@pytest.mark.parametrize("pixel_format", ["Mono12p", "RGB8", "YUV422Packed", "Mono8Packed", ""])
def test_a_format_without_a_decoder_is_named(pixel_format: str) -> None:
    assert not can_decode(pixel_format)
    with pytest.raises(ValueError) as refused:
        _decode_pixels(bytes(64), pixel_format, (2, 2))
    assert repr(pixel_format) in str(refused.value)


IMAGE_BYTES, BUFFER_BYTES = 480, 512
BUFFERS, LENT_MOST = 3, 2


class FakeBuffer:
    """What ``Aravis.Buffer.new`` makes of memory that it is given."""

    def __init__(self, size: int, address: int) -> None:
        self._memory = (ctypes.c_uint8 * size).from_address(address)

    def fill(self, level: int, size: int = BUFFER_BYTES) -> None:
        ctypes.memset(self._memory, level, size)


class FakeStream:
    """The buffers that wait for frames, the next one first."""

    def __init__(self) -> None:
        self.waiting: list[FakeBuffer] = []

    def push_buffer(self, buffer: FakeBuffer) -> None:
        self.waiting.append(buffer)


def memory_of(stream: FakeStream, lent_most: int = LENT_MOST) -> _FrameMemory:
    library = SimpleNamespace(api=SimpleNamespace(Buffer=SimpleNamespace(new=FakeBuffer)))
    return _FrameMemory(
        cast(AravisLibrary, library),
        stream,
        buffers=BUFFERS,
        buffer_bytes=BUFFER_BYTES,
        image_bytes=IMAGE_BYTES,
        lent_most=lent_most,
    )


def received(memory: _FrameMemory, stream: FakeStream, level: int) -> Any:
    """An image of one level, received into the next buffer that waits."""
    buffer = stream.waiting.pop(0)
    buffer.fill(level)
    data = memory.lend(buffer, IMAGE_BYTES)
    assert data is not None
    return np.frombuffer(data, np.uint8)


def test_an_image_lends_its_buffer_until_the_last_view_of_it_is_gone() -> None:
    stream = FakeStream()
    memory = memory_of(stream)
    image = received(memory, stream, 7)
    view = image.reshape(20, 24)[3:5]
    del image
    gc.collect()
    assert len(stream.waiting) == BUFFERS + LENT_MOST - 1
    assert set(view.ravel().tolist()) == {7}
    del view
    assert len(stream.waiting) == BUFFERS + LENT_MOST


def test_images_cannot_be_written_to() -> None:
    stream = FakeStream()
    image = received(memory_of(stream), stream, 7)
    with pytest.raises(ValueError, match="read-only"):
        image[0] = 1


@pytest.mark.parametrize("kept", [LENT_MOST, LENT_MOST + 1, 20])
def test_as_many_buffers_wait_as_were_asked_for_however_many_images_are_kept(kept: int) -> None:
    stream = FakeStream()
    memory = memory_of(stream)
    images = [received(memory, stream, level) for level in range(kept)]
    assert len(stream.waiting) == BUFFERS
    assert [int(image.max()) for image in images] == list(range(kept))
    assert [int(image.min()) for image in images] == list(range(kept))


@pytest.mark.parametrize("size", [0, 1, IMAGE_BYTES - len(SENTINEL)])
def test_an_image_that_came_too_short_is_none_and_its_buffer_goes_back(size: int) -> None:
    stream = FakeStream()
    memory = memory_of(stream)
    received(memory, stream, 200)
    buffer = stream.waiting.pop(0)
    buffer.fill(7, size)
    assert memory.lend(buffer, IMAGE_BYTES) is None
    assert len(stream.waiting) == BUFFERS + LENT_MOST


def test_an_image_larger_than_a_buffer_is_none() -> None:
    stream = FakeStream()
    memory = memory_of(stream)
    buffer = stream.waiting.pop(0)
    buffer.fill(7)
    assert memory.lend(buffer, BUFFER_BYTES + 1) is None


def test_an_image_of_another_size_is_a_copy() -> None:
    stream = FakeStream()
    memory = memory_of(stream)
    buffer = stream.waiting.pop(0)
    buffer.fill(7, 100)
    data = memory.lend(buffer, 100)
    buffer.fill(9)
    assert data == bytes([7]) * 100


def test_an_image_outlives_its_stream() -> None:
    stream = FakeStream()
    memory = memory_of(stream)
    image = received(memory, stream, 7)
    waiting = len(stream.waiting)
    memory.detach()
    memory.release()
    del memory
    gc.collect()
    assert set(image.tolist()) == {7}
    del image
    assert len(stream.waiting) == waiting


@pytest.mark.slow
@needs_aravis
@pytest.mark.parametrize("pixel_format", ["Mono12", "Mono8", "Mono12Packed"])
def test_kept_frames_stay_what_the_camera_sent_while_the_stream_goes_on(pixel_format: str) -> None:
    with gige_bench() as bench, opened(bench, pixel_format=pixel_format) as camera:
        camera.start()
        frames = [camera.next_frame(2.0) for _ in range(40)]
        camera.stop()
        sent = [sent_image(bench, camera, frame) for frame in frames]
    for frame, image in zip(frames, sent, strict=True):
        np.testing.assert_array_equal(frame.image_dn, image)
    assert len({frame.image_dn.tobytes() for frame in frames}) == 40
