"""What is no straight edge between two even levels does not count; what is one stays as it was."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from benchmarks.truth.edges import with_edges, without_edges
from calibration.edges.image import EdgeImage
from calibration.edges.measurement import measure_edges
from calibration.edges.straightness import Deviations, _deviations
from calibration.errors import NoEdgeError
from calibration.psf.calibration import calibrate_psf
from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image

CONTRAST_DN = 44_000.0  # of `edge_image`
NEW_FLAGS = {"uneven", "curved", "too_noisy"}


def flags_of(image_dn: FloatArray, *, is_jpeg: bool = False) -> list[set[str]]:
    source = EdgeImage(name="edge", image_dn=image_dn, saturation_dn=65_535.0, is_jpeg=is_jpeg)
    return [set(edge.flags) for edge in measure_edges(source)]


def numbers_in(image_dn: FloatArray) -> int:
    source = EdgeImage(name="edge", image_dn=image_dn, saturation_dn=255.0)
    return sum(edge.is_used for edge in measure_edges(source))


def disc(radius_px: float, sigma_px: float, seed: int) -> FloatArray:
    """A bright disc whose border is a Gaussian's along the radius, in noise."""
    y, x = np.mgrid[:120, :150].astype(np.float64)
    away = np.hypot(x - 75.3, y - 60.4)
    noise = np.random.default_rng(seed).normal(0, 1.0, x.shape)
    return np.asarray(30 + 150 * ndtr((radius_px - away) / sigma_px) + noise)


def test_what_neighbours_share_is_their_covariance_and_not_their_noise() -> None:
    # Each pixel of a row is the sum of its own normal number and the one before, of variance 1e-4
    # each: neighbours have a covariance of 1e-4 and pixels a variance of 2e-4.
    rows, cols = 200, 21
    drawn = np.random.default_rng(5).normal(0, 0.01, (rows, cols + 1))
    levels = drawn[:, 1:] + drawn[:, :-1]
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    distance = (x - 10).ravel()
    levels += ndtr(distance / 0.8).reshape(rows, cols)
    found = Deviations(*_deviations(distance, y.ravel() - 99.5, levels.ravel(), 0.8, 0.0, 1.0))
    # Within 4 x 0.8 + 2 = 5.2 px of the edge lie 11 pixels of each row, and 10 pairs.
    assert found.pairs == 10 * rows
    # Of 2000 pairs; means of 200 pixels take 0.5 % off. The errors are some 3 % and 5 %.
    assert found.variance == pytest.approx(2e-4, rel=0.12)
    assert found.shared == pytest.approx(1e-4, rel=0.2)
    assert found.uneven == pytest.approx(0.01, rel=0.1)


def test_texture_beside_an_edge_is_refused_and_noise_of_the_same_size_is_not() -> None:
    clean = edge_image(0.8, 5.0)
    white = np.random.default_rng(2).normal(size=clean.shape)
    smooth = gaussian_filter(white, 1.0)
    size_dn = 0.05 * CONTRAST_DN
    textured = flags_of(clean + size_dn * smooth / smooth.std())
    assert textured
    assert all("uneven" in flags for flags in textured)
    assert not any(NEW_FLAGS & flags for flags in flags_of(clean + size_dn * white))


def test_texture_too_faint_to_matter_is_left() -> None:
    clean = edge_image(0.8, 5.0)
    smooth = gaussian_filter(np.random.default_rng(2).normal(size=clean.shape), 1.0)
    assert not any(NEW_FLAGS & flags for flags in flags_of(clean + 300.0 * smooth / smooth.std()))


def test_where_every_border_is_refused_the_error_says_what_to_photograph() -> None:
    clean = edge_image(0.8, 5.0)
    smooth = gaussian_filter(np.random.default_rng(2).normal(size=clean.shape), 1.0)
    textured = clean + 0.05 * CONTRAST_DN * smooth / smooth.std()
    with pytest.raises(NoEdgeError, match="uneven: photograph an edge between two even areas"):
        calibrate_psf([EdgeImage(name="cloth", image_dn=textured, saturation_dn=65_535.0)])


@pytest.mark.parametrize("radius_px", [20.0, 40.0])
def test_the_border_of_a_disc_gives_no_number(radius_px: float) -> None:
    assert [numbers_in(disc(radius_px, 0.9, seed)) for seed in range(4)] == [0] * 4


def test_an_edge_that_a_lens_bends_is_kept() -> None:
    # 0.5 px over half of 90 px: a radius of 2000 px, where 1 % of distortion makes 39,000.
    bent = edge_image(0.8, 5.0, sagitta_px=0.5)
    noise = np.random.default_rng(1).normal(0, 400, bent.shape)
    [flags] = flags_of(bent + noise)
    assert not NEW_FLAGS & flags


@pytest.mark.slow
def test_true_edges_are_not_refused() -> None:
    refused = 0
    for region in with_edges(60, seed=9001):
        assert region.sigma_px is not None
        near = [
            edge
            for edge in measure_edges(region.source)
            if abs(edge.sigma_px / region.sigma_px - 1) < 0.1
        ]
        assert near
        refused += any(NEW_FLAGS & set(edge.flags) for edge in near)
    # At 1 % each, four or more of sixty are refused once in three hundred times; measured is 0.1 %.
    assert refused <= 2


@pytest.mark.slow
def test_photographs_and_prints_without_an_edge_give_no_number() -> None:
    numbers = sum(
        any(edge.is_used and not set(edge.flags) - {"jpeg"} for edge in measure_edges(each.source))
        for each in without_edges(120, seed=9002)
    )
    # Before, 13 % of them did. At 1 % each, six or more of 120 do once in 800 times.
    assert numbers <= 5
