"""AUC of a detector whose d' is known in closed form, through files, pairs and scores."""

from math import pi, sqrt
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy.special import ndtr

import standoff
from simulation import GaussianPsf
from simulation.arrays import Float32Array, FloatArray

SIGMA_PX, NOISE_DN, CONTRAST_DN, CROP_PX = 2.5, 2.0, 24.0, 64


def total_light(reference: Float32Array, followup: Float32Array, homography: FloatArray) -> float:
    """A linear template of ones."""
    return float(followup.sum(dtype=np.float64))


@pytest.mark.slow
def test_the_auc_of_a_linear_template_is_phi_of_d_prime_over_the_root_of_two(
    tmp_path: Path,
) -> None:
    # d' of a sum over n pixels of independent noise: what the spot adds, over noise sqrt(n).
    folder = tmp_path / "photographs"
    folder.mkdir()
    for number in range(6):
        level = np.full((180 + number, 180), 500, np.float32)  # each another file
        tifffile.imwrite(folder / f"{number}.tif", level)
    zooms = (1.0, 1.6)
    found = standoff.evaluate(
        total_light,
        folder,
        GaussianPsf(sigma_px=0.8),
        standoff.EvaluationTask(
            zooms=zooms,
            noises_dn=(NOISE_DN,),
            contrasts_dn=(CONTRAST_DN / 5, CONTRAST_DN / 12),
            change=standoff.Spot(sigma_px=SIGMA_PX),
            model="matched",
            crop_px=CROP_PX,
            crops=60,
        ),
    ).evaluation
    assert found is not None
    for curve in found.curves:
        for zoom, auc, low, high in zip(
            curve.zoom, curve.auc, curve.auc_low, curve.auc_high, strict=True
        ):
            added = curve.contrast_dn * 2 * pi * SIGMA_PX**2 / zoom**2
            d_prime = added / (NOISE_DN * (CROP_PX // zoom))
            truth = float(ndtr(d_prime / sqrt(2)))
            # The interval of 95 % over six photographs, widened to 99.9 % of Student's with 5.
            middle, reach = auc, 2.7 * (high - low) / 2
            assert abs(truth - middle) < reach
            assert high - low < 0.16
        assert curve.dprime_bound[0] is not None
        # The bound knows the place.
        assert curve.auc_bound[0] is not None
        assert curve.auc_bound[0] > curve.auc_high[0]
