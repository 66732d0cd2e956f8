"""Edges in few levels and behind JPEG: the truth is a closed form, the file is made by OpenCV."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from benchmarks.studies.edge_levels import compressed, level_errors
from calibration.edges import JpegCompression, find_edges, fit_edge
from calibration.noise import LevelNoise
from tests.calibration.closed_form import edge_image
from tests.calibration.draws import rms_range
from tests.calibration.known import known

LINEAR_CODES = np.arange(256.0)


def scaled(noise_dn: float, seed: int, edges: int = 40) -> NDArray[np.float64]:
    tally = level_errors(edges, (20.0, 60.0), (noise_dn, noise_dn), (0.7, 1.5), seed)
    assert tally.missed == 0
    return np.array(tally.scaled)


def largest(edges: int) -> float:
    """What none of so many unit normals exceeds 999 times of 1000."""
    return float(norm.isf(0.5 * (1 - 0.999 ** (1 / edges))))


@pytest.mark.slow
@pytest.mark.parametrize("noise_dn", [0.2, 0.4, 0.8])
def test_errors_in_eight_bits_are_as_large_as_stated(noise_dn: float) -> None:
    errors = scaled(noise_dn, seed=0)
    low, high = rms_range(errors.size)
    assert low < np.sqrt(np.mean(errors**2)) < high
    assert np.abs(errors).max() < largest(errors.size)


@pytest.mark.slow
def test_an_edge_without_noise_has_an_error_of_the_size_stated() -> None:
    errors = scaled(0.0, seed=8)
    assert np.sqrt(np.mean(errors**2)) < 1.6
    assert np.abs(errors).max() < 6.0


def test_known_noise_that_contains_rounding_counts_it_once() -> None:
    clean = edge_image(1.0, 12.0, low_dn=23.3, high_dn=65.1)
    image = np.rint(clean + np.random.default_rng(5).normal(0.0, 0.3, clean.shape))
    segment = find_edges(image, cell_px=1000.0)[0]
    line = LevelNoise(offset_dn2=0.3**2 + 1 / 12, slope_dn=0.0, floor_dn2=1e-6)
    known, own = fit_edge(image, segment, noise=line), fit_edge(image, segment)
    assert known is not None
    assert own is not None
    assert known.sigma_err_px == pytest.approx(own.sigma_err_px, rel=0.1)
    assert known.sigma_px == pytest.approx(own.sigma_px, abs=0.2 * own.sigma_err_px)


def test_light_from_gamma_codes_gives_the_width_in_light() -> None:
    light = edge_image(1.0, 12.0, low_dn=8.3, high_dn=31.1)
    rng = np.random.default_rng(6)
    codes = np.rint(255 * (light / 255) ** (1 / 2.2) + rng.normal(0.0, 0.25, light.shape))
    image = 255 * (codes / 255) ** 2.2
    fit = known(fit_edge(image, find_edges(image, cell_px=1000.0)[0]))
    assert abs(fit.sigma_px - 1.0) < 4 * fit.sigma_err_px
    assert fit.sigma_err_px < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("quality", [75, 85, 95])
def test_a_jpeg_gives_the_width_before_compression(quality: int) -> None:
    clean = edge_image(0.9, 12.0, low_dn=40.0, high_dn=180.0, has_pixel=True)
    rng = np.random.default_rng(quality)
    errors = []
    for _ in range(6):
        image, how = compressed(clean + rng.normal(0.0, 1.0, clean.shape), quality)
        segment = max(find_edges(image, cell_px=1000.0), key=lambda e: e.length_px)
        fit = known(fit_edge(image, segment, compression=how))
        assert fit.optical_sigma_px is not None
        assert fit.optical_sigma_err_px is not None
        errors.append((fit.optical_sigma_px - 0.9) / fit.optical_sigma_err_px)
        assert fit.optical_sigma_err_px < 0.02
    assert np.sqrt(np.mean(np.square(errors))) < rms_range(len(errors))[1]


@pytest.mark.slow
@pytest.mark.parametrize("quality", [75, 80])
def test_ringing_beside_an_edge_is_no_edge_and_takes_none_of_its_length(quality: int) -> None:
    # Faint edges ring by as much as strong ones: steps of cosines are the same for both.
    for seed in range(12):
        clean = edge_image(0.9, 20.0 + 5 * seed, low_dn=60.0, high_dn=105.0, has_pixel=True)
        noisy = clean + np.random.default_rng(seed).normal(0.0, 1.0, clean.shape)
        image, how = compressed(noisy, quality)
        segments = find_edges(image, cell_px=1000.0, artefacts=how.artefacts)
        plain = find_edges(np.rint(noisy), cell_px=1000.0)
        assert len(segments) == len(plain) == 1
        assert segments[0].clearance_px == np.inf
        assert segments[0].length_px == pytest.approx(plain[0].length_px, abs=2.0)


def test_a_crop_of_a_jpeg_keeps_the_grid_of_its_blocks() -> None:
    clean = edge_image(0.9, 12.0, low_dn=40.0, high_dn=180.0)
    image, how = compressed(clean + np.random.default_rng(2).normal(0.0, 1.0, clean.shape), 80)
    segment = max(find_edges(image, cell_px=1000.0), key=lambda e: e.length_px)
    whole = known(fit_edge(image, segment, compression=how))
    cut = known(
        fit_edge(
            np.ascontiguousarray(image[:, 3:]),
            type(segment)(
                **{
                    **{k: getattr(segment, k) for k in segment.__slots__},
                    "x_px": segment.x_px - 3.0,
                }
            ),
            compression=how.cropped(0, 3),
        )
    )
    # The same blocks; all that differs is where Newton's steps end.
    assert cut.sigma_px == pytest.approx(whole.sigma_px, abs=0.1 * whole.sigma_err_px)


def test_tables_that_are_none_are_refused() -> None:
    with pytest.raises(ValueError, match="8 x 8"):
        JpegCompression(steps=np.zeros((8, 8)), code_levels_dn=LINEAR_CODES)
    with pytest.raises(ValueError, match="256 rising"):
        JpegCompression(steps=np.ones((8, 8)), code_levels_dn=LINEAR_CODES[::-1])
