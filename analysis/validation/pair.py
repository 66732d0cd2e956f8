"""One reference and one captured follow-up against what every model makes of the reference."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.session import CaptureRecord
from analysis.validation.alignment import (
    Procedure,
    bicubic_at,
    scaled_up,
    shared_window,
)
from analysis.validation.metrics import ImageMetrics, compare_images
from analysis.validation.models import ValidationModel, simulator
from analysis.validation.processing import FULL_SCALE_DN, process_for_comparison
from calibration.registration import DistortedRegistration
from simulation import GaussianPsf, SamplingGrid
from simulation.kernelgan import EstimatedKernel
from simulation.resampling import simulate_at

__all__ = ["ModelAgreement", "PairValidation", "ProcessedImages", "validate_pair"]

FloatArray = NDArray[np.float64]
Image = NDArray[np.float32] | NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelAgreement:
    """What one model gives by one procedure.

    Parameters
    ----------
    curve
        Processed reference against the processed simulated follow-up, aligned to it: a point of
        the curves of Figure 3.
    agreement
        Processed captured follow-up against the processed simulated one: what Table II averages.
    """

    curve: ImageMetrics
    agreement: ImageMetrics


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProcessedImages:
    """Processed images on the reference's pixels: what Figure 2 shows."""

    reference: FloatArray
    captured: FloatArray
    simulated: Mapping[tuple[Procedure, ValidationModel], FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairValidation:
    """A pair of captures, their metrics, and those of every model and procedure.

    ``captured_curves`` compare the processed reference with the processed captured follow-up;
    ``images`` are kept where they were asked for.
    """

    reference: CaptureRecord
    followup: CaptureRecord
    registration: DistortedRegistration
    captured_curves: Mapping[Procedure, ImageMetrics]
    models: Mapping[tuple[Procedure, ValidationModel], ModelAgreement]
    images: ProcessedImages | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Simulated:
    """A model's follow-up aligned to the reference, and the two that Table II compares."""

    aligned: FloatArray
    captured: FloatArray
    followup: FloatArray


def validate_pair(
    records: tuple[CaptureRecord, CaptureRecord],
    reference: Image,
    followup: Image,
    registration: DistortedRegistration,
    psf: GaussianPsf,
    kernels: Mapping[ValidationModel, EstimatedKernel | None],
    *,
    keep_images: bool = False,
) -> PairValidation:
    """Simulate the follow-up from the reference with every model, and compare both ways.

    Parameters
    ----------
    records
        Of the reference and of the follow-up.
    reference, followup
        Their grey levels.
    registration
        Of the follow-up in the reference.
    psf
        Total PSF of the camera.
    kernels
        The models to try, each with its kernel where it is a learned one.
    keep_images
        Keep the processed images for a figure.

    Raises
    ------
    AnalysisError
        If the images share too little.
    """
    processed_reference = process_for_comparison(reference)
    # The steps of the paper: align, then normalise, subtract the background, crop.
    places_px = registration.pose.to_followup_px(*_pixels(reference.shape))
    captured = process_for_comparison(bicubic_at(followup, *places_px))
    by_features = replace(registration.pose, matrix=registration.feature_matrix, k1=0.0)
    places_px = by_features.to_followup_px(*_pixels(reference.shape))
    captured_by_features = process_for_comparison(bicubic_at(followup, *places_px))
    curves: dict[Procedure, ImageMetrics] = {
        "as-in-paper": compare_images(processed_reference, captured_by_features, FULL_SCALE_DN),
        "reference-grid": compare_images(processed_reference, captured, FULL_SCALE_DN),
    }
    curves["followup-grid"] = curves["reference-grid"]
    models: dict[tuple[Procedure, ValidationModel], ModelAgreement] = {}
    shown: dict[tuple[Procedure, ValidationModel], FloatArray] = {}
    for model, kernel in kernels.items():
        scaled = _scaled_up(reference, registration, psf, model, kernel)
        ways: dict[Procedure, _Simulated] = {
            "as-in-paper": replace(scaled, captured=captured_by_features),
            "reference-grid": replace(scaled, captured=captured),
            "followup-grid": _on_followup_grid(
                reference, followup, registration, psf, model, kernel
            ),
        }
        for procedure, made in ways.items():
            models[procedure, model] = ModelAgreement(
                curve=compare_images(processed_reference, made.aligned, FULL_SCALE_DN),
                agreement=compare_images(made.captured, made.followup, FULL_SCALE_DN),
            )
            if keep_images:
                shown[procedure, model] = made.aligned
    return PairValidation(
        reference=records[0],
        followup=records[1],
        registration=registration,
        captured_curves=curves,
        models=models,
        images=ProcessedImages(reference=processed_reference, captured=captured, simulated=shown)
        if keep_images
        else None,
    )


def _scaled_up(
    reference: Image,
    registration: DistortedRegistration,
    psf: GaussianPsf,
    model: ValidationModel,
    kernel: EstimatedKernel | None,
) -> _Simulated:
    """The paper's way: a follow-up about the image centre, simply scaled up; none captured."""
    shape = reference.shape[0], reference.shape[1]
    zoom = max(registration.zoom, 1.0)
    simulate = simulator(reference, model, psf, kernel, sampler="nearest")
    followup = simulate(SamplingGrid.centred(shape, zoom))
    processed = process_for_comparison(scaled_up(followup, zoom, shape))
    return _Simulated(aligned=processed, captured=processed, followup=processed)


def _on_followup_grid(
    reference: Image,
    followup: Image,
    registration: DistortedRegistration,
    psf: GaussianPsf,
    model: ValidationModel,
    kernel: EstimatedKernel | None,
) -> _Simulated:
    """Ours: the captured follow-up's own pixels, and its own way back onto the reference."""
    shape = reference.shape[0], reference.shape[1]
    window = shared_window(registration.pose)
    simulate = simulator(reference, model, psf, kernel)
    made = simulate_at(simulate, shape, registration.zoom, window.y_px, window.x_px)
    back_y, back_x = registration.pose.to_followup_px(*_pixels(shape))
    aligned = bicubic_at(made, back_y - window.rows.start, back_x - window.cols.start)
    return _Simulated(
        aligned=process_for_comparison(aligned),
        captured=process_for_comparison(followup[window.rows, window.cols]),
        followup=process_for_comparison(made),
    )


def _pixels(shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return y, x
