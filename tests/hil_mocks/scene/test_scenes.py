from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_mocks.truth.scenes import (
    CellGrid,
    Edge,
    Placed,
    Rectangle,
    Scene,
    SumOfScenes,
    Uniform,
    ZonePlate,
    gaussian_step,
)
from hil_mocks.truth.targets import TARGETS, scene_of

X_MM, Y_MM = np.random.default_rng(3).uniform(-4, 4, size=(2, 40))


def blurred_by_quadrature(
    sharp: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
    sigma_mm: float,
) -> NDArray[np.float64]:
    """Gaussian mean of a smooth scene about the places, by Gauss-Hermite quadrature."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    dx, dy = np.meshgrid(nodes * sigma_mm, nodes * sigma_mm)
    x = X_MM[:, None, None] + dx
    y = Y_MM[:, None, None] + dy
    values = sharp(x, y) * np.outer(weights, weights)
    return np.asarray(values.sum(axis=(1, 2)) / (2 * np.pi))


def test_a_step_without_blur_is_sharp() -> None:
    np.testing.assert_array_equal(gaussian_step(np.array([-1e-9, 1e-9]), 0.0), [0, 1])


def test_a_blurred_step_passes_16_50_and_84_percent_at_one_sigma() -> None:
    # Phi(-1), Phi(0), Phi(1) from tables.
    levels = gaussian_step(np.array([-2.0, 0.0, 2.0]), 2.0)
    np.testing.assert_allclose(levels, [0.15865525, 0.5, 0.84134475], atol=1e-8)


def test_the_edge_is_bright_below_its_line_and_turns_with_y_down() -> None:
    # At 30 degrees from +x towards +y, the point (0, 1) is below the line, (1, 0) above it.
    scene = Placed(scene=Edge(low=0.1, high=0.9), angle_deg=30.0)
    level = scene.reflectance(np.array([0.0, 1.0]), np.array([1.0, 0.0]), 0.01)
    np.testing.assert_allclose(level, [0.9, 0.1], atol=1e-12)


def test_a_blurred_zone_plate_is_the_gaussian_mean_of_the_sharp_one() -> None:
    plate = ZonePlate(amplitude=0.4, window_mm=1.5, freq_cy_per_mm=0.5)
    blurred = plate.reflectance(X_MM, Y_MM, 0.25)
    mean = blurred_by_quadrature(lambda x, y: np.asarray(plate.reflectance(x, y, 0.0)), 0.25)
    np.testing.assert_allclose(blurred, mean, atol=1e-8)


@pytest.mark.parametrize("sigma_mm", [0.05, 0.5, 2.0])
def test_a_cell_grid_is_the_sum_of_its_cells_as_rectangles(sigma_mm: float) -> None:
    cells = np.random.default_rng(1).uniform(0, 1, size=(3, 5))
    grid = CellGrid(cells=cells, cell_mm=1.2, margin=1.0)
    expected = np.ones(X_MM.shape)
    for (row, col), level in np.ndenumerate(cells):
        cell = Placed(
            scene=Rectangle(width_mm=1.2, height_mm=1.2, contrast=level - 1.0),
            x_mm=(col - 2) * 1.2,
            y_mm=(row - 1) * 1.2,
        )
        expected += cell.reflectance(X_MM, Y_MM, sigma_mm)
    np.testing.assert_allclose(grid.reflectance(X_MM, Y_MM, sigma_mm), expected, atol=1e-8)


def test_a_sum_of_scenes_asks_only_parts_in_reach_and_loses_nothing() -> None:
    square = Rectangle(width_mm=1.0, height_mm=2.0, contrast=-0.5)
    parts = [(Placed(scene=square, x_mm=float(x), angle_deg=10.0), 1.2) for x in range(-9, 10, 3)]
    together = SumOfScenes(Uniform(level=0.8), parts).reflectance(X_MM, Y_MM, 0.2)
    each = np.stack([part.reflectance(X_MM, Y_MM, 0.2) for part, _ in parts])
    one_by_one = 0.8 + each.sum(axis=0)
    np.testing.assert_allclose(together, one_by_one, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS)
def test_every_target_reflects_between_nothing_and_white_paper(target: str) -> None:
    scene: Scene = scene_of(target)
    x_mm, y_mm = np.meshgrid(np.arange(-80, 80, 0.37), np.arange(-60, 60, 0.37))
    level = scene.reflectance(x_mm, y_mm, 0.05)
    assert level.shape == x_mm.shape
    assert level.min() >= -0.01  # a print's interpolation may overshoot by a little
    assert level.max() <= 1.01


def test_the_step_tablet_has_25_steps_from_1_to_a_ten_thousandth() -> None:
    x_mm, y_mm = np.meshgrid(24.0 * np.arange(-2, 3), 24.0 * np.arange(-2, 3))
    level = scene_of("step tablet").reflectance(x_mm, y_mm, 0.5)
    # Blur reaches six widths, 3 mm, and the middle of a step is 12 mm from its border.
    assert sorted(level.ravel()) == pytest.approx(np.geomspace(1e-4, 1.0, 25), rel=1e-12)
    outside = scene_of("step tablet").reflectance(np.array([80.0]), np.array([0.0]), 0.5)
    np.testing.assert_allclose(outside, 1e-4, rtol=1e-12)


def test_an_unknown_target_is_an_error_that_lists_the_known_ones() -> None:
    with pytest.raises(ValueError) as refused:
        scene_of("egde")
    assert all(name in str(refused.value) for name in ("edge", "brick", "flat"))
