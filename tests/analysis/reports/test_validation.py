import numpy as np
import pytest

from acquisition.session import Session
from analysis.choices import VALIDATION_MODELS
from analysis.detectability import MODEL_COLOURS
from analysis.reports import plot_curves, plot_furthest
from analysis.validation import METRICS, ShownPair, Validation, drawn_procedure, furthest_pair
from simulation import MODELS
from tests.analysis.bench_session import PSF


@pytest.fixture(scope="module")
def furthest(session: Session, validation: Validation) -> ShownPair:
    return furthest_pair(session, validation, PSF)


def test_every_model_that_can_be_validated_has_a_colour_of_its_own() -> None:
    colours = {MODEL_COLOURS[model] for model in VALIDATION_MODELS}
    assert len(colours) == len(VALIDATION_MODELS)


def test_every_model_has_a_line_of_each_metric_over_zoom(validation: Validation) -> None:
    panels = plot_curves(validation).axes
    assert [axes.get_ylabel() for axes in panels] == [
        "correlation",
        "MSE",
        "NMI",
        "PSNR / dB",
        "SSIM",
    ]
    pairs = [pair for pair in validation.pairs if pair.reference == validation.pairs[0].reference]
    zooms = [pair.zoom for pair in pairs]
    for axes, metric in zip(panels, METRICS, strict=True):
        lines = {line.get_label(): line for line in axes.get_lines()}
        for model in MODELS:
            curves = [pair.of(drawn_procedure(model), model).curve for pair in pairs]
            np.testing.assert_array_equal(
                lines[model].get_ydata(), [getattr(curve, metric) for curve in curves]
            )
            np.testing.assert_array_equal(lines[model].get_xdata(), zooms)
        captured = [getattr(pair.captured_curves["reference-grid"], metric) for pair in pairs]
        np.testing.assert_array_equal(lines["captured"].get_ydata(), captured)


def test_the_capture_stands_beside_every_model_and_its_difference(furthest: ShownPair) -> None:
    assert furthest.pair.zoom == pytest.approx(2.0, rel=2e-4)
    figure = plot_furthest(furthest, crop_px=40)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[: len(MODELS) + 1] == ["captured", *MODELS]
    images = [
        np.asarray(axes.get_images()[0].get_array()) for axes in figure.axes if axes.get_images()
    ]
    assert len(images) == 1 + 2 * len(MODELS)
    rows, cols = furthest.captured.shape
    window = np.s_[(rows - 40) // 2 : (rows + 40) // 2, (cols - 40) // 2 : (cols + 40) // 2]
    np.testing.assert_allclose(images[0], furthest.captured[window])
    difference = furthest.simulated[MODELS[-1]] - furthest.captured
    np.testing.assert_allclose(images[-1], difference[window])


def test_a_crop_larger_than_the_image_shows_all_of_its_square(furthest: ShownPair) -> None:
    shown = plot_furthest(furthest, crop_px=10_000).axes[0].get_images()[0].get_array()
    assert shown is not None
    assert shown.shape == (min(furthest.captured.shape),) * 2
