import numpy as np
import pytest

from simulation.arrays import IntArray
from simulation.resampling import BandedMatrix, apply_separable, put_separable


def random_banded(rng: np.random.Generator, rows: int, columns: int, band: int) -> BandedMatrix:
    starts = np.sort(rng.integers(0, columns - band + 1, rows))
    return BandedMatrix(starts, rng.normal(size=(rows, band)), columns)


# Sizes below, at and above the strip of 64 rows and the groups of 8, bands of any length.
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("shape", "out_shape", "bands"),
    [((3, 5), (1, 2), (2, 3)), ((64, 65), (64, 8), (8, 16)), ((131, 90), (70, 131), (11, 24))],
)
def test_the_compiled_kernel_equals_the_dense_product(
    dtype: type[np.floating], shape: tuple[int, int], out_shape: tuple[int, int],
    bands: tuple[int, int],
) -> None:  # fmt: skip
    rng = np.random.default_rng(1)
    along_y = random_banded(rng, out_shape[0], shape[0], bands[0])
    along_x = random_banded(rng, out_shape[1], shape[1], bands[1])
    image = rng.normal(size=shape).astype(dtype)
    out = apply_separable(along_y, along_x, image)
    expected = along_y.dense() @ image.astype(np.float64) @ along_x.dense().T
    assert out.dtype == dtype
    np.testing.assert_allclose(out, expected, atol=20 * np.finfo(dtype).eps * abs(expected).max())


def test_a_view_with_gaps_is_read_like_its_copy() -> None:
    rng = np.random.default_rng(2)
    matrix = random_banded(rng, 9, 20, 8)
    image = rng.normal(size=(40, 60))[::2, ::3]
    np.testing.assert_array_equal(
        apply_separable(matrix, matrix, image), apply_separable(matrix, matrix, image.copy())
    )


def test_entries_at_one_place_add_up() -> None:
    places: IntArray = np.array([0, 0, 1], dtype=np.int64)
    columns: IntArray = np.array([2, 2, 0], dtype=np.int64)
    matrix = BandedMatrix.from_entries(2, 3, places, columns, np.array([1.0, 2.0, 4.0]))
    np.testing.assert_array_equal(matrix.dense(), [[0, 0, 3], [4, 0, 0]])


def test_an_image_of_another_size_is_refused() -> None:
    matrix = random_banded(np.random.default_rng(5), 3, 6, 2)
    with pytest.raises(ValueError):
        apply_separable(matrix, matrix, np.zeros((6, 7)))


def test_two_threads_give_the_same_bits() -> None:
    rng = np.random.default_rng(6)
    along_y, along_x = random_banded(rng, 801, 900, 7), random_banded(rng, 70, 90, 5)
    image = rng.normal(size=(900, 90)).astype(np.float32)
    results = [np.empty((801, 70), np.float32) for _ in range(2)]
    for threads, out in zip((1, 2), results, strict=True):
        put_separable(((along_y, (along_x,)),) * 2, image, out, threads=threads)
    np.testing.assert_array_equal(results[0], results[1])
