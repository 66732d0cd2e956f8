"""Edges compressed again: the transform is scipy's, the file libjpeg's."""

import numpy as np
import pytest
from scipy.fft import dctn, idctn

from benchmarks.studies.edge_levels import compressed, mtf50_errors
from calibration.edges import JpegCompression, find_edges, fit_edge
from calibration.edges._compressed import compressed_codes, mtf50_error_behind
from calibration.edges._esfr import esfr_half_width_px, measure_esfr
from calibration.edges._samples import bin_edge, edge_samples
from tests.calibration.closed_form import edge_image
from tests.calibration.draws import rms_range


@pytest.mark.parametrize("quality", [50, 75, 95])
def test_codes_come_back_as_from_the_file(quality: int) -> None:
    rng = np.random.default_rng(quality)
    codes = np.rint(rng.uniform(30, 220, (48, 64)) + 20 * rng.standard_normal((48, 64)))
    decoded, compression = compressed(codes, quality)
    codes = np.clip(codes, 0, 255)
    found = compressed_codes(codes, compression)
    block = codes[8:16, 24:32]
    kept = np.rint(dctn(block - 128, norm="ortho") / compression.steps) * compression.steps
    assert np.array_equal(
        found[8:16, 24:32], np.clip(np.rint(idctn(kept, norm="ortho") + 128), 0, 255)
    )
    # libjpeg's whole numbers round otherwise where a cosine is half a step: then a block differs.
    away = np.abs(found - decoded).reshape(6, 8, 8, 8).max(axis=(1, 3))
    assert np.median(away) <= 1
    assert np.mean(away <= 1) > 0.6
    assert np.abs(found - decoded).mean() < 0.2 * np.abs(codes - decoded).mean()


def test_a_file_that_loses_nothing_adds_nothing() -> None:
    image = edge_image(1.0, 12.0, low_dn=40.0, high_dn=180.0)
    image = np.rint(image + np.random.default_rng(1).normal(0.0, 1.0, image.shape))
    segment = max(find_edges(image, cell_px=1000.0), key=lambda edge: edge.length_px)
    fit = fit_edge(image, segment)
    assert fit is not None
    binned = bin_edge(edge_samples(image, segment, fit, esfr_half_width_px(fit.sigma_px)), fit)
    assert binned is not None
    esfr = measure_esfr(binned)
    assert esfr is not None
    fine = JpegCompression(steps=np.ones((8, 8)), code_levels_dn=np.arange(256.0))
    coarse = JpegCompression(steps=np.full((8, 8), 12.0), code_levels_dn=np.arange(256.0))
    alone, lossy = (mtf50_error_behind(each, segment, fit, esfr) for each in (fine, coarse))
    assert esfr.mtf50_cy_per_px is not None
    assert esfr.mtf50_err_cy_per_px is not None
    assert alone == pytest.approx(esfr.mtf50_err_cy_per_px / esfr.mtf50_cy_per_px, rel=0.25)
    assert lossy > 2 * alone


@pytest.mark.slow
@pytest.mark.parametrize(("sigma_px", "quality"), [(0.7, 95), (1.5, 95), (2.0, 90), (1.5, 85)])
def test_errors_of_mtf50_are_nearly_as_large_as_stated(sigma_px: float, quality: int) -> None:
    errors = np.array(mtf50_errors(80, sigma_px, quality, seed=0).scaled)
    low, high = rms_range(errors.size)
    # They hold what another lens would add, which a Gaussian does not have: a quarter at most.
    assert low / 1.25 < np.sqrt(np.mean(errors**2)) < high
