from io import BytesIO

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from PIL import Image

from analysis.sr_dataset import png_bytes

SHAPES = st.one_of(
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(3)),
)


@given(shape=SHAPES, dtype=st.sampled_from([np.uint8, np.uint16]), seed=st.integers(0, 99))
def test_opencv_and_pillow_read_every_level_back(
    shape: tuple[int, ...], dtype: type[np.unsignedinteger], seed: int
) -> None:
    top = int(np.iinfo(dtype).max)
    levels = np.random.default_rng(seed).integers(0, top, shape, dtype, endpoint=True)
    data = png_bytes(levels)
    read = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))
    np.testing.assert_array_equal(read[:, :, ::-1] if levels.ndim == 3 else read, levels)
    with Image.open(BytesIO(data)) as image:
        image.verify()  # every checksum
    if dtype == np.uint8 or levels.ndim == 2:  # Pillow rounds colours to 8 bits
        with Image.open(BytesIO(data)) as image:
            np.testing.assert_array_equal(np.asarray(image), levels)


def test_a_crop_is_written_as_a_copy_of_it_is() -> None:
    image = np.arange(24 * 30, dtype=np.uint16).reshape(24, 30)
    assert png_bytes(image[3:9, 5:20]) == png_bytes(image[3:9, 5:20].copy())


@pytest.mark.parametrize("levels", [np.zeros((4, 4)), np.zeros((4, 4, 2), np.uint8)])
def test_what_no_png_holds_is_refused(levels: NDArray[np.generic]) -> None:
    with pytest.raises(ValueError, match="no PNG holds"):
        png_bytes(levels)
