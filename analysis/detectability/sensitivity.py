"""What an error of the PSF, the focus or the registration does to d', to first order.

Each error adds to the artefact an image of its own, measured on a few photographs with the Gaussian
nearest to the PSF; a template's response to it is one sum over lags, as for the artefact.
``docs/how-sure.md`` has the definitions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from math import pi
from typing import Self

import numpy as np
from scipy.fft import dctn, idctn, idst

from analysis.detectability.artefact import faded_pixels, lagged_products, template_autocorrelation
from analysis.detectability.local import LocalChange, PlacedSignal, placed_signal
from analysis.detectability.pair import ComparedPair, compared_pair
from analysis.detectability.scenario import Scenario
from analysis.detectability.signal import ChangeSignal
from simulation import GaussianPsf, Model, Psf
from simulation.arrays import FloatArray

MOST_SCENES = 4
"""Photographs on which the sensitivities are measured."""

_SIDE_PX = 512
PSF_STEP_PX2 = 0.02
"""By how much the variance of the PSF is changed for a derivative."""

_NO_ARTEFACT = 1e-9
_FOCUS_STEP_PX2 = 0.1
"""As large as a focus scatters: the highest frequencies lose less than in proportion."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ArtefactResponse:
    """Lagged products of the artefact with what errors add to it, shape (2 n - 1, 2 n - 1) each.

    Parameters
    ----------
    own
        Of the artefact a with itself.
    with_psf, with_followup, with_reference
        Of a with its change per px^2 of variance: of the PSF, of the follow-up's focus and of the
        reference's.
    followup, reference, both
        Of the changes by the follow-up's and by the reference's focus with themselves, and with
        each other.
    gradient
        Of the reference's gradient with itself, summed over both axes: what a registration error
        of one px adds.
    pixels
        Number of pixels that the sums are over.
    """

    own: FloatArray
    with_psf: FloatArray
    with_followup: FloatArray
    with_reference: FloatArray
    followup: FloatArray
    reference: FloatArray
    both: FloatArray
    gradient: FloatArray
    pixels: float

    @classmethod
    def joined(cls, parts: Sequence["ArtefactResponse"]) -> Self:
        """Sum over photographs."""
        return cls(
            **{
                one.name: np.sum([getattr(part, one.name) for part in parts], axis=0)
                for one in fields(cls)
            }
        )

    def sums(self, template: FloatArray) -> dict[str, float]:
        """Sums over pixels of what a template makes of each, by name."""
        along = template_autocorrelation(template)
        return {
            one.name: float(np.vdot(getattr(self, one.name), along))
            for one in fields(self)
            if one.name != "pixels"
        }


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SignalResponse:
    """Change of a signal per px^2 of variance, in the window: of the PSF, of the follow-up's focus.

    Shape (n, n) each; the reference does not show the signal.
    """

    by_psf: FloatArray
    by_followup: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class DPrimeSlopes:
    """How d' follows each error.

    With f and r for the variances that focus adds to follow-up and reference, d' is multiplied by
    ``exp(signal f) / sqrt(1 + 2 A f + 2 B r + F f^2 + R r^2 + 2 C f r)``.

    Parameters
    ----------
    psf_per_px2
        Derivative of ln d' by the variance that the PSF is taken to have.
    signal_per_px2
        That of the logarithm of the signal by the follow-up's focus: ``signal``.
    with_followup_per_px2, with_reference_per_px2
        A and B.
    followup_per_px4, reference_per_px4, both_per_px4
        F, R and C.
    registration_per_px2
        What a registration error of one px along both axes adds to the variance of the decision,
        over that variance.
    noise
        Derivative of ln d' by the logarithm of the noise.
    """

    psf_per_px2: float
    signal_per_px2: float = 0.0
    with_followup_per_px2: float = 0.0
    with_reference_per_px2: float = 0.0
    followup_per_px4: float = 0.0
    reference_per_px4: float = 0.0
    both_per_px4: float = 0.0
    registration_per_px2: float = 0.0
    noise: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CaptureResponse:
    """What errors do at one zoom: to the artefact, and to the signal at each of its positions."""

    artefact: ArtefactResponse
    signals: tuple[SignalResponse, ...]

    def slopes(
        self, template: FloatArray, place: int, change: LocalChange, noise_dn2: float, whole: float
    ) -> DPrimeSlopes:
        """Slopes of d' for a template that stays as it is.

        Parameters
        ----------
        template
            Shape (n, n).
        place
            Index of the signal's position.
        change
            The signal there.
        noise_dn2, whole
            Variance of the template's response: by noise, and by the artefact of all photographs.
        """
        sums = self.artefact.sums(template)
        # The few photographs tell proportions, all of them the size; at zoom 1 there is none.
        has_artefact = sums["own"] > _NO_ARTEFACT * sums["gradient"]
        share = (whole / sums["own"] if has_artefact else 1 / self.artefact.pixels) / (
            noise_dn2 + whole
        )
        seen = float(np.vdot(template, change.signal))
        signal = self.signals[place]
        by_psf, by_followup = (
            float(np.vdot(template, one)) / seen for one in (signal.by_psf, signal.by_followup)
        )
        return DPrimeSlopes(
            psf_per_px2=by_psf - share * sums["with_psf"],
            signal_per_px2=by_followup,
            with_followup_per_px2=share * sums["with_followup"],
            with_reference_per_px2=share * sums["with_reference"],
            followup_per_px4=share * sums["followup"],
            reference_per_px4=share * sums["reference"],
            both_per_px4=share * sums["both"],
            registration_per_px2=share * sums["gradient"],
            noise=-noise_dn2 / (noise_dn2 + whole),
        )


def mean_slopes(slopes: Sequence[DPrimeSlopes]) -> DPrimeSlopes:
    """Mean over positions of the signal."""
    return DPrimeSlopes(
        **{
            one.name: float(np.mean([getattr(each, one.name) for each in slopes]))
            for one in fields(DPrimeSlopes)
        }
    )


def capture_response(
    scenes_dn: Sequence[FloatArray],
    signal: ChangeSignal,
    scenario: Scenario,
    model: Model,
    zoom: float,
) -> CaptureResponse:
    """Measure what errors do to the artefact of a few photographs, and to a signal.

    Parameters
    ----------
    scenes_dn
        Photographs c, from `response_scenes`.
    signal, scenario, model, zoom
        As for d'.
    """
    scenario = replace(scenario, psf=gaussian_psf(scenario.psf))
    own = [_artefact_response(scene, scenario, model, zoom) for scene in scenes_dn]
    placed = placed_signal(signal, scenario, model, zoom)
    return CaptureResponse(
        artefact=ArtefactResponse.joined(own),
        signals=_signal_responses(placed, scenario, model, zoom),
    )


def response_scenes(scenes_dn: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the middles of the first few photographs."""
    middles = []
    for scene in scenes_dn[:MOST_SCENES]:
        (top, left) = (max((size - _SIDE_PX) // 2, 0) for size in scene.shape)
        middles.append(scene[top : top + _SIDE_PX, left : left + _SIDE_PX])
    return middles


def _artefact_response(
    scene_dn: FloatArray, scenario: Scenario, model: Model, zoom: float
) -> ArtefactResponse:
    shape = scene_dn.shape[0], scene_dn.shape[1]
    pair = compared_pair(shape, scenario.psf, model, zoom, scenario.reference_zoom)
    reference = pair.reference_of(scene_dn)
    own = pair.artefact_of(scene_dn)
    by_psf = np.zeros_like(own)
    softer = softer_psf(scenario.psf)
    if softer is not None:
        changed = compared_pair(shape, softer, model, zoom, scenario.reference_zoom)
        by_psf = (changed.artefact_of(scene_dn) - own) / PSF_STEP_PX2
    by_followup = pair.within_border(_blurred_followup(pair, scene_dn))
    by_reference = pair.within_border(-_blur_per_px2(reference))
    slopes = [pair.within_border(_derivative(reference, axis)) for axis in (0, 1)]
    window_px = scenario.window_px

    def products(first: FloatArray, second: FloatArray) -> FloatArray:
        return lagged_products(first, second, window_px)

    return ArtefactResponse(
        own=products(own, own),
        with_psf=products(own, by_psf),
        with_followup=products(own, by_followup),
        with_reference=products(own, by_reference),
        followup=products(by_followup, by_followup),
        reference=products(by_reference, by_reference),
        both=products(by_followup, by_reference),
        gradient=products(slopes[0], slopes[0]) + products(slopes[1], slopes[1]),
        pixels=float(faded_pixels(own.shape, window_px)),
    )


def _signal_responses(
    placed: PlacedSignal, scenario: Scenario, model: Model, zoom: float
) -> tuple[SignalResponse, ...]:
    softer, pair = softer_psf(scenario.psf), placed.pair
    changed = pair
    if softer is not None:
        changed = compared_pair(placed.shape, softer, model, zoom, scenario.reference_zoom)
    found = []
    for scene, window in placed.scenes():
        by_psf = (changed.aligned_of(scene) - pair.aligned_of(scene)) / PSF_STEP_PX2
        found.append(
            SignalResponse(
                by_psf=by_psf[window], by_followup=_blurred_followup(pair, scene)[window]
            )
        )
    return tuple(found)


def gaussian_psf(psf: Psf | None) -> GaussianPsf | None:
    """Return the Gaussian nearest to a PSF; None for none."""
    return None if psf is None else psf.gaussian


def softer_psf(psf: Psf | None) -> GaussianPsf | None:
    """Return the Gaussian nearest to a PSF, a little wider; None for none."""
    if psf is None:
        return None
    return GaussianPsf.from_covariance(psf.covariance_px2 + PSF_STEP_PX2 * np.eye(2))


def _blurred_followup(pair: ComparedPair, scene: FloatArray) -> FloatArray:
    """Change of the aligned follow-up per px^2 of its focus."""
    followup = np.asarray(pair.followup.apply(scene), dtype=np.float64)
    return pair.upscaled(_blur_per_px2(followup))


def _blur_per_px2(image: FloatArray) -> FloatArray:
    """Change of an image by a Gaussian blur, per px^2 of its variance; mirrored at the border."""
    fy, fx = (np.arange(size) / (2 * size) for size in image.shape)
    passed = np.exp(-2 * pi**2 * (fy[:, None] ** 2 + fx**2) * _FOCUS_STEP_PX2)
    spectrum = dctn(image, norm="ortho") * (passed - 1) / _FOCUS_STEP_PX2
    return np.asarray(idctn(spectrum, norm="ortho"))


def _derivative(image: FloatArray, axis: int) -> FloatArray:
    """Derivative along an axis of the image's cosine series."""
    along = np.moveaxis(image, axis, -1)
    size = along.shape[-1]
    waves = dctn(along, axes=(-1,), norm=None)[..., 1:] * (-pi * np.arange(1, size) / size)
    sines = np.concatenate([waves, np.zeros((*waves.shape[:-1], 1))], axis=-1)
    return np.asarray(np.moveaxis(idst(sines, axis=-1), -1, axis))
