"""Compare a captured follow-up with what every model simulates from its reference."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from analysis.choices import ValidationModel
from analysis.validation.alignment import (
    Procedure,
    SharedWindow,
    bicubic_at,
    scaled_up,
    shared_window,
)
from analysis.validation.document import ModelAgreement
from analysis.validation.metrics import ImageMetrics, compare_images
from analysis.validation.models import ModelInputs
from analysis.validation.processing import FULL_SCALE_DN, process_for_comparison
from calibration.registration import DistortedPose
from simulation import SamplingGrid
from simulation.arrays import FloatArray, FloatImage
from simulation.sampling_grid import simulate_at


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProcessedFollowup:
    """A model's processed follow-up.

    Parameters
    ----------
    aligned
        Brought onto the reference's pixels.
    followup, captured
        The two that Table II compares: on common pixels, the simulated and the captured one.
    levels
        The simulated follow-up on the captured one's pixels, in the reference's levels, where it
        was simulated there.
    """

    aligned: FloatArray
    followup: FloatArray
    captured: FloatArray
    levels: FloatArray | None = None


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: what it computes is kept
class AlignedPair:
    """Grey levels of two captures of one target, and where the follow-up lies in the reference."""

    reference: FloatImage
    followup: FloatImage
    pose: DistortedPose

    def processed_reference(self) -> FloatArray:
        """Return the reference after the paper's processing."""
        return process_for_comparison(self.reference)

    @cached_property
    def places_px(self) -> tuple[FloatArray, FloatArray]:
        """Follow-up coordinates ``(y, x)`` of every reference pixel."""
        return self.pose.to_followup_px(*_pixels(self.reference.shape))

    @cached_property
    def window(self) -> SharedWindow:
        """Part of the follow-up that the reference covers.

        Raises
        ------
        OverlapError
            If the images share too little.
        """
        return shared_window(self.pose)

    @cached_property
    def captured_in_window(self) -> FloatArray:
        """The captured follow-up's part that the reference covers, processed."""
        return process_for_comparison(self.followup[self.window.rows, self.window.cols])

    def captured_on_reference(self) -> FloatArray:
        """Return the captured follow-up on the reference's pixels, processed as in the paper.

        The steps of the paper: align, then normalise, subtract the background, crop.
        """
        return process_for_comparison(bicubic_at(self.followup, *self.places_px))

    def scaled_up(self, inputs: ModelInputs, model: ValidationModel) -> FloatArray:
        """Return a model's follow-up in the paper's way: about the image centre, scaled up."""
        shape = self.reference.shape[0], self.reference.shape[1]
        zoom = max(self.pose.zoom, 1.0)
        simulate = inputs.simulator(self.reference, model, sampler="nearest")
        made = simulate(SamplingGrid.centred(shape, zoom))
        return process_for_comparison(scaled_up(made, zoom, shape))

    def on_followup_grid(self, inputs: ModelInputs, model: ValidationModel) -> ProcessedFollowup:
        """Return a model's follow-up in our way: on the captured one's own pixels.

        Raises
        ------
        OverlapError
            If the images share too little.
        """
        shape = self.reference.shape[0], self.reference.shape[1]
        window = self.window
        simulate = inputs.simulator(self.reference, model)
        made = simulate_at(simulate, shape, self.pose.zoom, window.y_px, window.x_px)
        back_y, back_x = self.places_px
        aligned = bicubic_at(made, back_y - window.rows.start, back_x - window.cols.start)
        return ProcessedFollowup(
            aligned=process_for_comparison(aligned),
            followup=process_for_comparison(made),
            captured=self.captured_in_window,
            levels=made,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairMetrics:
    """Metrics of the captured follow-up and of every model's; the fields of ``ValidatedPair``.

    ``levels`` are the models' follow-ups on the captured one's pixels, in the reference's levels.
    """

    captured_curves: Mapping[Procedure, ImageMetrics]
    models: tuple[ModelAgreement, ...]
    levels: Mapping[ValidationModel, FloatArray]


def compare_pair(pair: AlignedPair, feature_matrix: FloatArray, inputs: ModelInputs) -> PairMetrics:
    """Simulate the follow-up from the reference with every model, and compare both ways.

    Parameters
    ----------
    pair
        The captures.
    feature_matrix
        The homography of their features alone, for the paper's own alignment.
    inputs
        The models to try.

    Raises
    ------
    OverlapError
        If the images share too little.
    """
    reference, captured = pair.processed_reference(), pair.captured_on_reference()
    by_features = replace(pair.pose, matrix=feature_matrix, k1=0.0)
    captured_by_features = replace(pair, pose=by_features).captured_on_reference()
    curves: dict[Procedure, ImageMetrics] = {
        "as-in-paper": compare_images(reference, captured_by_features, FULL_SCALE_DN),
        "reference-grid": compare_images(reference, captured, FULL_SCALE_DN),
    }
    curves["followup-grid"] = curves["reference-grid"]
    models = []
    levels: dict[ValidationModel, FloatArray] = {}
    for model in inputs.kernels:
        scaled = pair.scaled_up(inputs, model)
        ways: dict[Procedure, ProcessedFollowup] = {
            "as-in-paper": ProcessedFollowup(
                aligned=scaled, followup=scaled, captured=captured_by_features
            ),
            "reference-grid": ProcessedFollowup(aligned=scaled, followup=scaled, captured=captured),
            "followup-grid": pair.on_followup_grid(inputs, model),
        }
        found = ways["followup-grid"].levels
        if found is not None:
            levels[model] = found
        models += [
            ModelAgreement(
                alignment=procedure,
                model=model,
                curve=compare_images(reference, made.aligned, FULL_SCALE_DN),
                agreement=compare_images(made.captured, made.followup, FULL_SCALE_DN),
            )
            for procedure, made in ways.items()
        ]
    return PairMetrics(captured_curves=curves, models=tuple(models), levels=levels)


def _pixels(shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return y, x
