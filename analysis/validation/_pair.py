"""A captured follow-up beside what every model simulates from its reference, and what is left.

That is measured over what is expected to be left: the noise of both captures, what the errors of
PSF and focus change, what the model `lmmse` states of itself, and the error of the place to which
the two were aligned. All models of a pair are measured by the same expectation, so that their
figures compare.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import gaussian_filter

from acquisition.session import CaptureImages
from analysis.choices import ValidationModel
from analysis.validation._document import ModelAgreement
from analysis.validation._kernels import ModelInputs
from analysis.validation._metrics import (
    FULL_SCALE_DN,
    ImageMetrics,
    Procedure,
    SharedWindow,
    bicubic_at,
    compare_images,
    crop_centre_half,
    process_for_comparison,
    scaled_up,
    shared_window,
    subtract_background,
)
from calibration.psf import PsfCalibration, focus_scatter_px2, psf_steps
from calibration.registration import DistortedPose
from simulation import PoseOptions, Psf, SamplingGrid
from simulation.arrays import FloatArray, FloatImage
from simulation.sampling_grid import simulate_at
from simulation.uncertainty import KnownErrors, SimulatedView, pixel_uncertainty


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _ProcessedFollowup:
    """A model's processed follow-up.

    ``aligned``: brought onto the reference's pixels. ``followup, captured``: the two that Table II
    compares: on common pixels, the simulated and the captured one. ``levels``: the simulated
    follow-up on the captured one's pixels, in the reference's levels, where it was simulated there.
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
        """Part of the follow-up that the reference covers."""
        return shared_window(self.pose)

    @cached_property
    def _captured_in_window(self) -> FloatArray:
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

    def on_followup_grid(self, inputs: ModelInputs, model: ValidationModel) -> _ProcessedFollowup:
        """Return a model's follow-up in our way: on the captured one's own pixels."""
        shape = self.reference.shape[0], self.reference.shape[1]
        window = self.window
        simulate = inputs.simulator(self.reference, model)
        made = simulate_at(simulate, shape, self.pose.zoom, window.y_px, window.x_px)
        back_y, back_x = self.places_px
        aligned = bicubic_at(made, back_y - window.rows.start, back_x - window.cols.start)
        return _ProcessedFollowup(
            aligned=process_for_comparison(aligned),
            followup=process_for_comparison(made),
            captured=self._captured_in_window,
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

    ``feature_matrix``: the homography of their features alone, for the paper's own alignment.
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
        ways: dict[Procedure, _ProcessedFollowup] = {
            "as-in-paper": _ProcessedFollowup(
                aligned=scaled, followup=scaled, captured=captured_by_features
            ),
            "reference-grid": _ProcessedFollowup(
                aligned=scaled, followup=scaled, captured=captured
            ),
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


_ROUNDING_DN2 = 1 / 12
_LIGHT_TERMS = 7
"""A gain of second order over the frame, and an offset."""


def noise_variance(capture: CaptureImages) -> FloatArray | None:
    """Variance of each pixel of a capture's mean; None if it has a single frame.

    A straight line over the level, through what the frames scattered: the variance of a few frames
    is itself too uncertain to divide by.
    """
    if capture.variance_dn2 is None:
        return None
    level = np.asarray(capture.mean_dn, dtype=np.float64)
    variance = np.asarray(capture.variance_dn2, dtype=np.float64) / capture.record.frames_used
    slope, start = np.polyfit(level.ravel(), variance.ravel(), 1)
    least = _ROUNDING_DN2 / capture.record.frames_used
    return np.asarray(np.maximum(start + slope * level, least))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairErrors:
    """What is known of the errors of a pair.

    ``reference_dn2, followup_dn2``: variance of the noise in each pixel of the two captures.
    ``place_err_px``: standard error of the place to which the follow-up was aligned, along either
    axis. ``psf, calibration``: the PSF that is simulated with, and the calibration that states its
    errors; None if there is none.
    """

    reference_dn2: FloatArray
    followup_dn2: FloatArray
    place_err_px: float
    psf: Psf
    calibration: PsfCalibration | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expectation:
    """Expected square of captured minus simulated, in the middle of a pair's window.

    ``captured`` is the window of the captured follow-up, ``variance_dn2`` has the shape of its
    middle half.
    """

    captured: FloatArray = field(repr=False)
    variance_dn2: FloatArray = field(repr=False)

    @classmethod
    def of(cls, pair: AlignedPair, errors: PairErrors) -> "Expectation":
        """Propagate the errors of a pair's inputs to the middle half of its window."""
        window = pair.window
        rows, cols = window.y_px.shape
        top, left = window.rows.start + rows // 4, window.cols.start + cols // 4
        middle = np.s_[top : top + rows // 2, left : left + cols // 2]
        shift = np.array([[1.0, 0.0, left], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
        shape = pair.reference.shape[0], pair.reference.shape[1]
        view = SimulatedView.of_pose(
            shape,
            pair.pose.matrix @ shift,
            (cols // 2, rows // 2),
            PoseOptions(distortion_k1=pair.pose.k1, origin_px=(float(left), float(top))),
        )
        calibration = errors.calibration
        known = KnownErrors(
            noise_dn2=errors.reference_dn2,
            psf_steps=None
            if calibration is None
            else psf_steps(calibration, errors.psf, max(view.zoom, 1.0)),
            focus_scatter_px2=None if calibration is None else focus_scatter_px2(calibration),
        )
        own = pixel_uncertainty(view, pair.reference, errors.psf, known).err
        assert own is not None  # the model states an error of its own
        captured = np.asarray(pair.followup, dtype=np.float64)
        slopes = np.gradient(gaussian_filter(captured, 0.5))
        place = errors.place_err_px**2 * (slopes[0] ** 2 + slopes[1] ** 2)[middle]
        return cls(
            captured=captured[window.rows, window.cols],
            variance_dn2=own**2 + errors.followup_dn2[middle] + place,
        )

    def chi2_reduced(self, made: FloatArray) -> float:
        """Return the mean square of captured minus simulated over what is expected.

        The light of the two is matched by a gain of second order over the window and an offset, and
        what varies slowly is subtracted, as for the metrics. ``made``: the simulated follow-up, of
        the window's shape.
        """
        rows, cols = made.shape
        y, x = np.mgrid[-1.0 : 1.0 : rows * 1j, -1.0 : 1.0 : cols * 1j]
        terms = (np.ones_like(made), x, y, x * x, x * y, y * y)
        design = np.stack([*(made * term for term in terms), terms[0]], axis=-1)
        flat = design.reshape(-1, _LIGHT_TERMS)
        # Levels of thousands and their offset: on a common scale.
        scale = np.linalg.norm(flat, axis=0)
        light = np.linalg.lstsq(flat / scale, self.captured.ravel(), rcond=None)[0] / scale
        left = crop_centre_half(subtract_background(self.captured - design @ light))
        return float(np.mean(left**2 / self.variance_dn2))
