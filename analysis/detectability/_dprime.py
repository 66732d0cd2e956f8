"""Detectability of a change between two photographs from different distances: d' at one zoom.

``K = sigma^2 (I + U U^T) + K_artefact`` and ``s_z = U A_rz s`` give every observer's d' without
any random number. Every d' is an upper bound: exposure, registration, gloss, parallax, defocus
and motion are outside the model. ``docs/theory-detectability.md`` derives all of it.

What an error of the PSF, the focus or the registration does to d' is known to first order: each
adds to the artefact an image of its own, measured on a few photographs with the Gaussian nearest to
the PSF; a template's response to it is one sum over lags, as for the artefact.
``docs/how-sure.md`` has the definitions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from math import pi, sqrt
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import dctn, idctn, idst
from scipy.special import stdtrit

from analysis.choices import OBSERVERS, Observer
from analysis.detectability._artefact import (
    ArtefactTiles,
    WindowCovariance,
    artefact_tiles,
    faded_pixels,
    lagged_products,
    observer_templates,
    template_autocorrelation,
)
from analysis.detectability._scenario import (
    ChangeSignal,
    ComparedPair,
    LocalChange,
    PlacedSignal,
    Scenario,
    compared_pair,
    placed_signal,
)
from calibration.estimate import NORMAL_95
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
class _ArtefactResponse:
    """Lagged products of the artefact with what errors add to it, shape (2 n - 1, 2 n - 1) each.

    ``own``: of the artefact a with itself. ``with_psf, with_followup, with_reference``: of a with
    its change per px^2 of variance: of the PSF, of the follow-up's focus and of the reference's.
    ``followup, reference, both``: of the changes by the follow-up's and by the reference's focus
    with themselves, and with each other. ``gradient``: of the reference's gradient with itself,
    summed over both axes: what a registration error of one px adds. ``pixels``: number of pixels
    that the sums are over.
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
    def joined(cls, parts: Sequence["_ArtefactResponse"]) -> Self:
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
class _SignalResponse:
    """Change of a signal per px^2 of variance, in the window: of the PSF, of the follow-up's focus.

    Shape (n, n) each; the reference does not show the signal.
    """

    by_psf: FloatArray
    by_followup: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class DPrimeSlopes:
    """How d' follows each error.

    With f and r for the variances that focus adds to follow-up and reference, d' is multiplied by
    ``exp(signal f) / sqrt(1 + 2 A f + 2 B r + F f^2 + R r^2 + 2 C f r)``. ``psf_per_px2``:
    derivative of ln d' by the variance that the PSF is taken to have. ``signal_per_px2``: that of
    the logarithm of the signal by the follow-up's focus: ``signal``. ``registration_per_px2``: what
    a registration error of one px along both axes adds to the variance of the decision, over that
    variance. ``noise``: derivative of ln d' by the logarithm of the noise.
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
class _CaptureResponse:
    """What errors do at one zoom: to the artefact, and to the signal at each of its positions."""

    artefact: _ArtefactResponse
    signals: tuple[_SignalResponse, ...]

    def slopes(
        self, template: FloatArray, place: int, change: LocalChange, noise_dn2: float, whole: float
    ) -> DPrimeSlopes:
        """Slopes of d' for a template that stays as it is.

        ``template``: shape (n, n). ``noise_dn2, whole``: variance of the template's response: by
        noise, and by the artefact of all photographs.
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


def _mean_slopes(slopes: Sequence[DPrimeSlopes]) -> DPrimeSlopes:
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
) -> _CaptureResponse:
    """Measure what errors do to the artefact of a few photographs, and to a signal."""
    scenario = replace(scenario, psf=gaussian_psf(scenario.psf))
    own = [_artefact_response(scene, scenario, model, zoom) for scene in scenes_dn]
    placed = placed_signal(signal, scenario, model, zoom)
    return _CaptureResponse(
        artefact=_ArtefactResponse.joined(own),
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
) -> _ArtefactResponse:
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

    return _ArtefactResponse(
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
) -> tuple[_SignalResponse, ...]:
    softer, pair = softer_psf(scenario.psf), placed.pair
    changed = pair
    if softer is not None:
        changed = compared_pair(placed.shape, softer, model, zoom, scenario.reference_zoom)
    found = []
    for scene, window in placed.scenes():
        by_psf = (changed.aligned_of(scene) - pair.aligned_of(scene)) / PSF_STEP_PX2
        found.append(
            _SignalResponse(
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


_REPLICATES = 1000
_INTERVAL_PERCENT = (2.5, 97.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class DPrime:
    """Detectability index of contrast 1, with its 95 % interval over images and positions.

    ``scene_err`` is the standard error of its logarithm over images, widened by Student's quantile;
    ``slopes`` say how it follows errors of the capture, None where that was not asked for.
    """

    value: float
    low: float
    high: float
    scene_err: float
    slopes: DPrimeSlopes | None = None


def scene_artefact(
    scene_dn: FloatArray, scenario: Scenario, model: Model, zoom: float, tiles_per_side: int = 4
) -> ArtefactTiles:
    """Measure the artefact that one scene image makes, tile by tile.

    ``scene_dn``: the image c, grey, shape ``(rows, cols)``, finite.
    """
    shape = scene_dn.shape[0], scene_dn.shape[1]
    pair = compared_pair(shape, scenario.psf, model, zoom, scenario.reference_zoom)
    return artefact_tiles(pair.artefact_of(scene_dn), scenario.window_px, tiles_per_side)


def d_primes(
    changes: Sequence[LocalChange],
    artefact: ArtefactTiles,
    noise_dn: float,
    observers: tuple[Observer, ...] = OBSERVERS,
    *,
    seed: int = 0,
    response: _CaptureResponse | None = None,
) -> dict[Observer, DPrime]:
    """Detectability index of a signal of contrast 1, analytic in the noise.

    ``changes``: the signal at several positions, from ``local_changes``; d' is the mean over them.
    ``artefact``: artefact of the scene images, joined in a fixed order. ``noise_dn``: standard
    deviation of the white noise in either image. ``seed``: for the bootstrap over tiles. It keeps
    each observer's template, so that the interval is that of the observer trained on all of them.
    ``response``: what errors of the capture do, for the slopes.
    """
    if not (noise_dn > 0 and np.isfinite(noise_dn)):
        raise ValueError(f"noise_dn must be positive, got {noise_dn}")
    artefact_dn2 = artefact.autocovariance_dn2
    drawn = drawn_shares(artefact.pixels, seed)
    values: dict[Observer, list[float]] = {name: [] for name in observers}
    replicated: dict[Observer, FloatArray] = {name: np.zeros(_REPLICATES) for name in observers}
    slopes: dict[Observer, list[DPrimeSlopes]] = {name: [] for name in observers}
    for place, change in enumerate(changes):
        covariance = WindowCovariance(noise_dn**2, change.up_y, change.up_x, artefact_dn2)
        templates = observer_templates(change.signal, covariance, observers)
        for name, template in templates.items():
            seen = float(np.sum(template * change.signal))
            noise_dn2 = noise_dn**2 * change.noise_variance(template)
            sums = artefact.template_sums(template)
            whole = max(float(sums.sum() / artefact.pixels.sum()), 0.0)
            values[name].append(seen / np.sqrt(noise_dn2 + whole))
            # Sums of single tiles reach into their neighbours and may fall below zero.
            parts = np.maximum(drawn @ sums, 0.0)
            replicated[name] += seen / np.sqrt(noise_dn2 + parts) / len(changes)
            if response is not None:
                slopes[name].append(response.slopes(template, place, change, noise_dn2, whole))
    found: dict[Observer, DPrime] = {}
    for name in observers:
        low, high = interval_of(replicated[name])
        found[name] = DPrime(
            value=float(np.mean(values[name])),
            low=low,
            high=high,
            scene_err=scene_error(replicated[name], len(artefact.pixels)),
            slopes=_mean_slopes(slopes[name]) if slopes[name] else None,
        )
    return found


def scene_error(replicated: FloatArray, tiles: int) -> float:
    """Standard error of ln d' from its bootstrap over so many tiles.

    The spread of resampled means is too small by sqrt((n - 1) / n), and uncertain itself: normal
    quantiles of the result are Student's.
    """
    if tiles < 2:
        return 0.0
    widened = sqrt(tiles / (tiles - 1)) * student_factor(tiles - 1)
    return float(np.std(np.log(replicated)) * widened)


def interval_of(replicated: FloatArray) -> tuple[float, float]:
    """Return the ends of the 95 % interval of bootstrap replicates."""
    low, high = np.percentile(replicated, _INTERVAL_PERCENT).tolist()
    return low, high


def drawn_shares(pixels: FloatArray, seed: int) -> FloatArray:
    """Weights of the tiles' sums in each bootstrap replicate, shape (replicates, tiles)."""
    tiles = len(pixels)
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(tiles, np.full(tiles, 1.0 / tiles), size=_REPLICATES)
    return np.asarray(counts / (counts @ pixels)[:, None])


def d_prime_between(zooms: ArrayLike, d_primes: ArrayLike, zoom: ArrayLike) -> FloatArray:
    """Interpolate d' at any zoom, 1/d' linear between those computed; outside, the nearest one.

    The artefact of the alignment grows about as z - 1 and adds to the noise in quadrature, so that
    1/d' is much like a hyperbola, which bends upwards: its chord reads d' a little too low, where
    the chord of d' itself reads up to several times too much. A step just beyond zoom 1 is the
    exception; docs/theory-detectability.md has the figures. ``zooms, d_primes``: what was computed:
    zooms in rising order, d' of 0 or more. Beside a d' of 0 it is 0 in the whole open interval:
    nothing says where it vanished. ``zoom``: any shape; NaN gives NaN.
    """
    nodes, values = np.asarray(zooms, np.float64), np.asarray(d_primes, np.float64)
    within = np.clip(np.asarray(zoom, np.float64), nodes[0], nodes[-1])
    straight = np.interp(within, nodes, values)
    with np.errstate(divide="ignore", over="ignore"):  # a d' of 0, or next to it
        # Rounding must not lift it above the chord of d' itself.
        reciprocal = np.maximum(np.interp(within, nodes, 1 / values), 1 / straight)
    # 1 / (1 / d') is not always d', and a threshold may be a computed value.
    return np.asarray(np.where(np.isin(within, nodes), straight, 1 / reciprocal))


def student_factor(freedom: float) -> float:
    """Student's 97.5 % quantile over the normal one."""
    return float(stdtrit(freedom, 0.975)) / NORMAL_95
