"""Simulated follow-ups against captured ones: the paper's Table II, on any height series.

The follow-up is simulated on the captured one's own pixels, so that neither is resampled for
the comparison. Both are cut to the area they share and processed as in the paper.
"""

from dataclasses import dataclass
from math import inf, log10

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.validation import FULL_SCALE_DN, ImageMetrics, compare_images, process_for_comparison
from calibration.errors import RegistrationError
from calibration.registration import AxialRegistration, register_axial
from simulation import MODELS, GaussianPsf, Model, zoom_out_on_grid

__all__ = ["ModelMean", "PairComparison", "compare_pair", "mean_metrics"]

Image = NDArray[np.float32] | NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairComparison:
    """One reference and one captured follow-up, against what each model makes of the reference.

    ``captured`` and the images in ``simulated`` are processed (centre half, full scale 255).
    """

    registration: AxialRegistration
    metrics: dict[Model, ImageMetrics]
    captured: NDArray[np.float64]
    simulated: dict[Model, NDArray[np.float64]]


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelMean:
    """Means over pairs; ``psnr_of_mean_db`` is the PSNR of the mean MSE."""

    correlation: float
    mse_dn2: float
    nmi: float
    psnr_db: float
    psnr_of_mean_db: float
    ssim: float
    pairs: int


def compare_pair(
    reference: Image, followup: Image, psf: GaussianPsf, models: tuple[Model, ...] = MODELS
) -> PairComparison:
    """Simulate the follow-up from the reference with every model, and compare.

    Parameters
    ----------
    reference, followup
        Grey captures of one target, shape ``(rows, cols)``, in DN; the follow-up is the one
        from further away along the camera's axis.
    psf
        Total PSF of the camera.
    models
        The models to try.

    Raises
    ------
    AnalysisError
        If the two cannot be aligned or share too little; the message says why.
    """
    try:
        registration = register_axial(reference, followup, psf)
        overlap = registration.overlap
    except RegistrationError as error:
        raise AnalysisError(f"the captures cannot be aligned: {error}") from error
    captured = process_for_comparison(followup[overlap.rows, overlap.cols])
    simulated = {
        model: process_for_comparison(zoom_out_on_grid(reference, overlap.grid, psf, model))
        for model in models
    }
    return PairComparison(
        registration=registration,
        metrics={m: compare_images(captured, s, FULL_SCALE_DN) for m, s in simulated.items()},
        captured=captured,
        simulated=simulated,
    )


def mean_metrics(metrics: list[ImageMetrics]) -> ModelMean:
    """Average the metrics of several pairs of equal data range.

    Raises
    ------
    ValueError
        If there is none.
    """
    if not metrics:
        raise ValueError("no pairs to average")
    mse = float(np.mean([m.mse_dn2 for m in metrics]))
    return ModelMean(
        correlation=float(np.mean([m.correlation for m in metrics])),
        mse_dn2=mse,
        nmi=float(np.mean([m.nmi for m in metrics])),
        psnr_db=float(np.mean([m.psnr_db for m in metrics])),
        psnr_of_mean_db=10 * log10(metrics[0].data_range_dn ** 2 / mse) if mse > 0 else inf,
        ssim=float(np.mean([m.ssim for m in metrics])),
        pairs=len(metrics),
    )
