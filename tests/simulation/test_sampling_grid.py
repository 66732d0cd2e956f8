"""Pixels of a follow-up on a grid and scattered over the reference."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from simulation import MODELS, GaussianPsf, Model, SamplingGrid, zoom_out_on_grid
from simulation.arrays import FloatArray
from simulation.sampling_grid import simulate_at
from tests.simulation.closed_form import photograph, random_scene


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


PSF = GaussianPsf(sigma_x_px=0.72, sigma_y_px=0.64, rho=0.2)
SHAPE = (90, 120)
IMAGE = photograph(random_scene(5, 300, 250), SHAPE, 1.0, 0.6, (-45, -60))


def on_grid(grid: SamplingGrid, model: Model) -> NDArray[np.floating]:
    return zoom_out_on_grid(IMAGE, grid, PSF, model)


def shifted_grid(zoom: float) -> SamplingGrid:
    return SamplingGrid(
        zoom_y=zoom, zoom_x=zoom, origin_y_px=3.3, origin_x_px=5.8,
        rows=int(84 / zoom), cols=int(110 / zoom),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("zoom", [1.0, 1.4, 2.2])
def test_places_that_lie_on_a_grid_get_what_the_model_gives_there(
    model: Model, zoom: float
) -> None:
    grid = shifted_grid(zoom)
    y, x = np.meshgrid(grid.rows_px, grid.cols_px, indexing="ij")
    # One more place moves the grids that are used inside away from these places.
    places_y, places_x = np.append(y, 2.17), np.append(x, 4.63)
    found = simulate_at(partial(on_grid, model=model), SHAPE, zoom, places_y, places_x)[:-1]
    expected = on_grid(grid, model)
    # The antialiased cubic has kinks, which a spline rounds: 0.6 % of the contrast at most.
    limit = 6e-3 if model in ("bicubic", "paper") else 1e-3
    # The paper's blur mirrors at the border of the grid, which is another one inside.
    inner = np.s_[8:-8, 8:-8]
    error = np.sqrt(np.mean((found.reshape(expected.shape) - expected)[inner] ** 2))
    assert error < limit * expected.std()


@settings(max_examples=10)
@given(zoom=st.floats(1.0, 3.0), turn=st.floats(-0.1, 0.1))
def test_it_is_linear_in_the_image_wherever_the_places_lie(zoom: float, turn: float) -> None:
    y, x = np.meshgrid(np.arange(25.0, 60.0, 3.0), np.arange(30.0, 80.0, 3.0), indexing="ij")
    places = (y + turn * (x - 55.0), x - turn * (y - 42.0))
    ramp = np.add.outer(2.0 * np.arange(SHAPE[0]), 3.0 * np.arange(SHAPE[1]))

    def simulate(image: FloatArray, grid: SamplingGrid) -> NDArray[np.floating]:
        return zoom_out_on_grid(image, grid, PSF, "bicubic")

    flat = simulate_at(partial(simulate, np.full(SHAPE, 7.0)), SHAPE, zoom, *places)
    np.testing.assert_allclose(flat, 7.0, rtol=1e-9)
    # Pillow's taps make a ramp wavy by some thousandths of a pixel.
    sloped = simulate_at(partial(simulate, ramp + 7.0), SHAPE, zoom, *places)
    np.testing.assert_allclose(sloped, 7.0 + 2 * places[0] + 3 * places[1], atol=0.25)


def test_places_outside_the_reference_are_refused() -> None:
    with pytest.raises(ValueError):
        simulate_at(
            partial(on_grid, model="matched"), SHAPE, 1.5, np.array([91.0]), np.array([5.0])
        )
