import numpy as np
import pytest

from simulation import SamplingGrid


def test_a_centred_grid_follows_the_stated_formula() -> None:
    zoom, rows, cols = 1.7, 30, 47
    grid = SamplingGrid.centred((rows, cols), zoom)
    n = int(rows / zoom)
    assert (grid.rows, grid.cols) == (17, 27)
    np.testing.assert_allclose(
        grid.rows_px, (np.arange(n) - (n - 1) / 2) * zoom + (rows - 1) / 2, atol=1e-12
    )


def test_a_size_that_divides_but_for_rounding_is_not_cut_by_a_pixel() -> None:
    assert 33 / 1.1 < 30  # rounding
    assert SamplingGrid.centred((33, 33), 1.1).rows == 30


@pytest.mark.parametrize("zoom", [0.999, 0.0, -1.0, float("nan"), float("inf")])
def test_a_zoom_that_is_not_a_zoom_out_is_refused(zoom: float) -> None:
    with pytest.raises(ValueError):
        SamplingGrid.centred((30, 30), zoom)


def test_an_image_smaller_than_the_zoom_is_refused() -> None:
    with pytest.raises(ValueError):
        SamplingGrid.centred((30, 3), 4)


@pytest.mark.parametrize(
    ("name", "value"),
    [("zoom_y", 0.98), ("zoom_x", np.nan), ("origin_y_px", np.inf), ("rows", 0)],
)
def test_a_grid_with_an_impossible_value_is_refused(name: str, value: float) -> None:
    values = {
        "zoom_y": 1.5, "zoom_x": 1.5, "origin_y_px": 0.0, "origin_x_px": 0.0, "rows": 4, "cols": 4,
    }  # fmt: skip
    with pytest.raises(ValueError):
        SamplingGrid(**{**values, name: value})  # type: ignore[arg-type]  # ints and floats mixed
