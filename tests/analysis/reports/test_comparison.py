import numpy as np

from analysis.comparison_plots import plot_error_by_zoom, plot_processed
from analysis.series import SeriesComparison
from simulation import MODELS


def test_every_model_has_a_line_of_its_errors_over_zoom(comparison: SeriesComparison) -> None:
    [axes] = plot_error_by_zoom(comparison).axes
    lines = dict(zip(MODELS, axes.get_lines(), strict=True))
    for model, line in lines.items():
        assert line.get_label() == f"{model}, leaves"
        errors = [pair.comparison.metrics[model].mse_dn2 for pair in comparison.pairs]
        np.testing.assert_array_equal(line.get_ydata(), errors)
        zooms = [pair.comparison.registration.zoom for pair in comparison.pairs]
        np.testing.assert_array_equal(line.get_xdata(), zooms)
    assert axes.get_yscale() == "log"


def test_the_capture_stands_beside_every_model_and_its_difference(
    comparison: SeriesComparison,
) -> None:
    pair = comparison.pairs[-1]
    figure = plot_processed(pair, crop_px=40)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[: len(MODELS) + 1] == ["captured", *MODELS]
    images = [
        np.asarray(axes.get_images()[0].get_array()) for axes in figure.axes if axes.get_images()
    ]
    assert len(images) == 1 + 2 * len(MODELS)
    rows, cols = pair.comparison.captured.shape
    window = np.s_[(rows - 40) // 2 : (rows + 40) // 2, (cols - 40) // 2 : (cols + 40) // 2]
    np.testing.assert_allclose(images[0], pair.comparison.captured[window])
    difference = pair.comparison.simulated[MODELS[-1]] - pair.comparison.captured
    np.testing.assert_allclose(images[-1], difference[window])


def test_a_crop_larger_than_the_image_shows_all_of_its_square(comparison: SeriesComparison) -> None:
    pair = comparison.pairs[0]
    shown = plot_processed(pair, crop_px=10_000).axes[0].get_images()[0].get_array()
    assert shown is not None
    assert shown.shape == (min(pair.comparison.captured.shape),) * 2
