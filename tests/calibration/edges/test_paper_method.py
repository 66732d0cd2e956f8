from math import sqrt

import numpy as np
import pytest

from calibration.edges import EdgeImage, EdgeSamples, find_edges, fit_edge, measure_edges
from calibration.edges.measurement import BIN_PX, lsf_fit
from calibration.psf import calibrate_psf
from calibration.psf.covariance import median_width
from tests.calibration.closed_form import edge_image
from tests.calibration.edge_photographs import photographs


@pytest.mark.parametrize("sigma_px", [0.4, 0.5, 0.7, 1.0, 1.5])
def test_the_bias_is_that_of_the_bin_and_the_difference(sigma_px: float) -> None:
    # Closed form: a bin of h and a difference over 2 h add h^2 / 12 + (2 h)^2 / 12.
    expected = sqrt(sigma_px**2 + 5 * BIN_PX**2 / 12)
    widths = [
        measure_edges(EdgeImage(name="e", image_dn=edge_image(sigma_px, normal)), method="paper")[
            0
        ].sigma_px
        for normal in (3.0, 5.0, 8.0, 11.0, 97.0, 103.0)
    ]
    # How the pixels' places beat with the bins moves single edges by up to 3 % at 0.4 px.
    np.testing.assert_allclose(widths, expected, rtol=0.035 if sigma_px < 0.6 else 0.015)
    assert np.median(widths) == pytest.approx(expected, rel=0.01)


def test_the_bias_at_half_a_pixel_is_five_percent() -> None:
    sources = [EdgeImage(name=f"{n}", image_dn=edge_image(0.5, n)) for n in (4.0, 7.0, 94.0, 97.0)]
    psf = calibrate_psf(sources, method="paper")
    assert psf.sigma_x_px == pytest.approx(0.5 * 1.051, rel=0.01)
    assert psf.sigma_y_px == pytest.approx(0.5 * 1.051, rel=0.01)


def test_widths_are_medians_and_nothing_optical_and_no_rho_is_told() -> None:
    psf = calibrate_psf(photographs([2.0, 5.0, 8.0, 45.0, 93.0]), method="paper")
    upright = [e.sigma_px for e in psf.edges if e.orientation == "vertical"]
    assert psf.sigma_x_px == np.median(upright)
    assert psf.method == "paper"
    assert psf.rho is None
    assert psf.covariance_px2 is None
    assert psf.optical_sigma_x_px is None
    assert psf.field is None
    assert all(edge.optical_sigma_px is None for edge in psf.edges)
    assert all(edge.chi2_reduced is None for edge in psf.edges)


def test_diagonal_edges_alone_determine_nothing_in_the_papers_way() -> None:
    psf = calibrate_psf(photographs([45.0, 135.0]), method="paper")
    assert psf.sigma_x_px is None
    assert psf.sigma_y_px is None


def test_the_error_of_a_median_by_hand() -> None:
    # MAD of (1, 2, 3, 4, 10) about 3 is 1: err = sqrt(pi/2) / 0.6745 / sqrt(5).
    median = median_width(np.array([1.0, 2.0, 3.0, 4.0, 10.0]), np.ones(5))
    assert median.value == 3.0
    assert median.err == pytest.approx(sqrt(np.pi / 2) / 0.67449 / sqrt(5), rel=1e-4)
    assert median.high - median.value == pytest.approx(1.96 * median.err, rel=1e-3)
    assert median_width(np.array([0.7]), np.array([0.02])).err == 0.02
    with pytest.raises(ValueError):
        median_width(np.array([]), np.array([]))


@pytest.mark.parametrize(
    ("reach_px", "rise"),
    [
        pytest.param(0.7, 1.0, id="seven bins"),
        pytest.param(8.0, 0.0, id="no edge at all"),
        pytest.param(8.0, 1 / 16, id="a ramp over the whole band"),
    ],
)
def test_pixels_that_tell_no_width_have_none(reach_px: float, rise: float) -> None:
    image = edge_image(0.8, 5.0)
    fit = fit_edge(image, find_edges(image)[0])
    assert fit is not None
    distance = np.linspace(-reach_px, reach_px, 2000)
    samples = EdgeSamples(
        distance_px=distance,
        along_px=np.zeros_like(distance),
        levels_dn=100 + 900 * (0.5 + rise * distance),
        low_dn=100.0,
        high_dn=1000.0,
        normal_rad=0.1,
        half_length_px=30.0,
    )
    assert lsf_fit(samples, fit) is None
