"""Edges in bins of distance, against profiles from a Fourier integral."""

import numpy as np
import pytest

from calibration.edges import BinnedEdge, EdgeImage, bin_centres_px, measure_edges
from simulation.arrays import FloatArray
from tests.calibration.lens_edges import (
    HIGH_DN,
    LOW_DN,
    Lens,
    edge_photograph,
    edge_photographs,
    profile,
)

LENS = Lens(0.37, 0.37)


def only_binned(source: EdgeImage) -> BinnedEdge:
    (edge,) = measure_edges(source)
    assert edge.binned is not None
    return edge.binned


def misfit(edge: BinnedEdge, truth: FloatArray) -> FloatArray:
    """Residuals in standard deviations, the edge's own levels and place fitted."""
    slope = np.gradient(truth, edge.distance_px)
    columns = np.stack([np.ones_like(truth), truth, slope], axis=1)
    root = np.sqrt(edge.weights)
    found = np.linalg.lstsq(columns * root[:, None], edge.levels * root, rcond=None)[0]
    return np.asarray((edge.levels - columns @ found) * root)


@pytest.mark.parametrize("normal_deg", [2.0, 4.0, 27.0, 45.0, 88.0])
def test_the_bins_lie_on_the_profile(normal_deg: float) -> None:
    image = edge_photograph(LENS, normal_deg, length_px=90)
    edge = only_binned(EdgeImage(name="edge", image_dn=image))
    truth = profile(LENS, normal_deg)(edge.distance_px)
    left = misfit(edge, truth) / np.sqrt(edge.weights)
    # Means left where they fall would be off by up to 1e-2: 1/50 px on a slope of 0.7 per px.
    assert np.abs(left).max() < 1e-3
    assert np.sqrt(np.mean(left**2)) < 2e-4


def test_the_weights_are_those_of_the_noise() -> None:
    squares, count = 0.0, 0
    for source in edge_photographs(LENS, [5.0, 38.0, 100.0], snr=100, seed=3, length_px=90):
        edge = only_binned(source)
        squares += float(
            np.sum(misfit(edge, profile(LENS, float(source.name))(edge.distance_px)) ** 2)
        )
        count += edge.levels.size - 3
    # The sum of squares scatters by sqrt(2 n), and the noise is known to 2 %.
    assert squares / count == pytest.approx(1.0, abs=4 * np.sqrt(2 / count) + 0.02)


def test_a_colour_plane_is_binned_in_pixels_of_the_sensor() -> None:
    image = edge_photograph(LENS, 12.0, length_px=180, half_width_px=45)
    plane = image[::2, ::2].copy()
    edge = only_binned(
        EdgeImage(name="green", image_dn=plane, pitch_px=2, sensor_shape=image.shape)
    )
    truth = profile(LENS, 12.0)(edge.distance_px)
    left = misfit(edge, truth) / np.sqrt(edge.weights)
    # A quarter of the pixels, at two thirds of the bins: means lie further from the centres.
    assert np.abs(left).max() < 2e-3


def test_light_that_falls_off_along_and_across_the_edge_is_taken_out() -> None:
    image = edge_photograph(LENS, 8.0, length_px=160, half_width_px=60)
    rows, cols = image.shape
    light = 1 + 0.10 * np.linspace(-1, 1, cols)[None, :] + 0.05 * np.linspace(-1, 1, rows)[:, None]
    rng = np.random.default_rng(1)
    noise = rng.normal(size=image.shape) * (HIGH_DN - LOW_DN) / 500
    (edge,) = measure_edges(EdgeImage(name="edge", image_dn=image * light + noise))
    assert "shaded" in edge.flags
    assert edge.binned is not None
    left = misfit(edge.binned, profile(LENS, 8.0)(edge.binned.distance_px))
    # In parts of the contrast: 0.0070 if the light is left in, 0.0012 with it taken out.
    assert np.sqrt(np.mean(left**2 / edge.binned.weights)) < 0.002


def test_dust_is_left_out() -> None:
    (source,) = edge_photographs(LENS, [20.0], snr=500, seed=1, length_px=90)
    rows, cols = source.image_dn.shape
    source.image_dn[rows // 2, cols // 2 + 9] *= 0.2
    left = misfit(only_binned(source), profile(LENS, 20.0)(only_binned(source).distance_px))
    assert np.abs(left).max() < 5.0  # of 230 bins; a pixel of 0.8 of the contrast would be 100


def test_the_centres_are_a_sixteenth_apart_at_the_edge_and_wider_outside() -> None:
    steps = np.diff(bin_centres_px(np.arange(0, 100)))
    assert steps[0] == pytest.approx(1 / 16, rel=1e-3)
    assert np.all(np.diff(steps) > 0)


def test_an_edge_that_ends_too_near_is_not_binned() -> None:
    image = edge_photograph(LENS, 3.0, length_px=60, half_width_px=2.4)
    assert all(edge.binned is None for edge in measure_edges(EdgeImage(name="", image_dn=image)))
