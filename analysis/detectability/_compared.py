"""The observer ``changes``: how far a change stands out in a comparison of two photographs.

The comparison matches both photographs at one sharpness on the coarser one's pixels and looks for
changes behind Gaussians of several widths. d' is the significance that a change has by itself
behind the best of them. What noise leaves there is known in closed form; what aliasing leaves is
measured on pairs that the capture model makes from the photographs, without noise.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, log, pi, sqrt

import cv2
import numpy as np

from analysis.changes import ExpectedFilters, FilterWidth, LimitCurve, smoothing_for, unexplained
from analysis.detectability._artefact import ArtefactTiles, artefact_tiles
from analysis.detectability._curves import DetectabilityCurve
from analysis.detectability._dprime import (
    PSF_STEP_PX2,
    DPrime,
    DPrimeSlopes,
    drawn_shares,
    interval_of,
    scene_error,
)
from analysis.detectability._scenario import (
    ChangeSignal,
    ComparedPair,
    GaussianSignal,
    Scenario,
    compared_pair,
    frame_size_px,
    signal_offsets_px,
)
from simulation import Model, SamplingGrid
from simulation.arrays import FloatArray

_LEAST_ZOOM = 1.01
"""Zoom of the pair that shows what aliasing leaves: at 1 the pixels of a simulated pair coincide,
those of two photographs never do."""

_PROBES_PX = (1.0, 2.0)
"""Filters behind which a spot's height tells its width and peak."""

_LEAST_PX2 = 1e-6
_OFF_PX2 = 1 / 6
"""Mean squared distance of a change from the nearest pixel's centre."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _SeenSpot:
    """A change as a photograph shows it: the Gaussian spot that stands as high behind filters.

    ``sigma_px`` is in the photograph's pixels, ``peak`` that of a change of contrast 1.
    """

    sigma_px: float
    peak: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedChange:
    """A change of contrast 1 in a comparison.

    ``heights``: of the change behind each of their widths. ``spot``: the change as the follow-up
    shows it; None where it is no Gaussian.
    """

    filters: ExpectedFilters
    heights: tuple[float, ...]
    spot: _SeenSpot | None


def scene_residual(
    scene_dn: FloatArray, scenario: Scenario, model: Model, zoom: float, tiles_per_side: int = 4
) -> ArtefactTiles:
    """Measure what a comparison leaves of one scene image without noise, at its median place.

    ``scene_dn``: the image c, grey, shape ``(rows, cols)``, finite.
    """
    shape, zoom = (scene_dn.shape[0], scene_dn.shape[1]), max(zoom, _LEAST_ZOOM)
    pair = compared_pair(shape, scenario.psf, model, zoom, scenario.reference_zoom)
    far = SamplingGrid.centred(shape, scenario.reference_zoom * zoom)
    left = unexplained(
        pair.reference_of(scene_dn),
        np.asarray(pair.followup.apply(scene_dn), dtype=np.float64),
        np.linalg.inv(pair.reference_grid.matrix) @ far.matrix,
        comparison_filters(scenario, model, zoom).smoothing,
    )
    return artefact_tiles(left.at_the_median_place, scenario.window_px, tiles_per_side)


@lru_cache(maxsize=64)
def comparison_filters(scenario: Scenario, model: Model, zoom: float) -> ExpectedFilters:
    """Return the filters of a comparison, from how blurry both photographs show a small spot."""
    probe = GaussianSignal(sigma_px=scenario.reference_zoom)
    frame = _Frame.around(probe, scenario, model, zoom)
    near = frame.spot(frame.reference(probe), scenario.reference_zoom)
    far = frame.spot(frame.followup(probe), scenario.reference_zoom * zoom)
    blur_px2 = far.sigma_px**2 - near.sigma_px**2 / zoom**2
    return ExpectedFilters(zoom=zoom, smoothing=smoothing_for(blur_px2))


def compared_change(
    signal: ChangeSignal, scenario: Scenario, model: Model, zoom: float
) -> ComparedChange:
    """Work out what a comparison's filters show of a change of contrast 1."""
    filters = comparison_filters(scenario, model, zoom)
    frame = _Frame.around(signal, scenario, model, zoom)
    total = scenario.reference_zoom * zoom
    if isinstance(signal, GaussianSignal):
        spot = frame.spot(frame.followup(signal), total)
        own = tuple(_spot_height(filters, width, spot) for width in filters.widths)
        return ComparedChange(filters=filters, heights=own, spot=spot)
    images = [
        frame.followup(signal, offset) for offset in signal_offsets_px(scenario.positions, total)
    ]
    heights = []
    for width in filters.widths:
        peaks = [float(np.abs(_smoothed(image, width.width_px)).max()) for image in images]
        # Wider filters are sampled less densely.
        beside = np.exp(-_OFF_PX2 * (width.step_px**2 - 1) / (2 * width.width_px**2))
        heights.append(float(np.mean(peaks) * beside))
    return ComparedChange(filters=filters, heights=tuple(heights), spot=None)


def comparison_d_prime(
    change: ComparedChange,
    residual: ArtefactTiles,
    noise_dn: float,
    *,
    seed: int = 0,
    by_psf: tuple[ComparedChange, ComparedChange] | None = None,
) -> DPrime:
    """Return how many standard deviations a change of contrast 1 stands out at its median place.

    ``residual``: from `scene_residual`, of all scene images in a fixed order. ``noise_dn``:
    standard deviation of the white noise in either image. ``by_psf``: for the slopes, the change
    with the Gaussian nearest to the PSF, and with one whose variance is larger by ``PSF_STEP_PX2``.
    """
    if not (noise_dn > 0 and np.isfinite(noise_dn)):
        raise ValueError(f"noise_dn must be positive, got {noise_dn}")
    drawn = drawn_shares(residual.pixels, seed)
    shares = residual.pixels / residual.pixels.sum()
    values: list[float] = []
    replicated: list[FloatArray] = []
    noise_shares: list[float] = []
    for width, height in zip(change.filters.widths, change.heights, strict=True):
        noise_dn2 = noise_dn**2 * change.filters.noise_gain(width)
        # Of each tile's pixels, the squared residual behind the width.
        averaging = change.filters.averaging(width, residual.products_dn2.shape[1] // 2)
        sums = np.asarray(np.tensordot(residual.products_dn2, averaging, axes=2))
        whole = max(float(shares @ (sums / residual.pixels)), 0.0)
        values.append(height / (width.allowance * sqrt(noise_dn2 + whole)))
        noise_shares.append(noise_dn2 / (noise_dn2 + whole))
        parts = np.maximum(drawn @ sums, 0.0)
        replicated.append(height / (width.allowance * np.sqrt(noise_dn2 + parts)))
    best = np.max(replicated, axis=0)
    low, high = interval_of(best)
    at = int(np.argmax(values))
    return DPrime(
        value=values[at],
        low=low,
        high=high,
        scene_err=scene_error(best, len(residual.pixels)),
        slopes=None if by_psf is None else _slopes(change, by_psf, at, noise_shares[at]),
    )


def _slopes(
    change: ComparedChange,
    by_psf: tuple[ComparedChange, ComparedChange],
    width: int,
    noise_share: float,
) -> DPrimeSlopes:
    """Slopes behind the filter of this index.

    A comparison matches focus and place of both photographs itself: what remains of the focus is
    that the follow-up shows the change softer.
    """
    narrow, wide = (one.heights[width] for one in by_psf)
    psf_per_px2 = by_followup = log(wide / narrow) / PSF_STEP_PX2
    if change.spot is not None:
        before, after = (
            _spot_height(change.filters, change.filters.widths[width], change.spot, more_px2)
            for more_px2 in (0.0, PSF_STEP_PX2)
        )
        by_followup = log(after / before) / PSF_STEP_PX2
    return DPrimeSlopes(psf_per_px2=psf_per_px2, signal_per_px2=by_followup, noise=-noise_share)


def _spot_height(
    filters: ExpectedFilters, width: FilterWidth, spot: _SeenSpot, more_px2: float = 0.0
) -> float:
    """Height behind a filter of a spot whose variance a blur has raised."""
    sigma_px2 = spot.sigma_px**2 + more_px2
    peak = spot.peak * spot.sigma_px**2 / sigma_px2
    return float(peak * filters.response(width, sqrt(sigma_px2)))


def expected_limits(curve: DetectabilityCurve) -> LimitCurve:
    """Turn a curve of observer ``changes`` round: the limit that comparisons should have."""
    if curve.observer != "changes" or curve.seen_sigma_px is None or curve.seen_dn is None:
        raise ValueError(
            f"{curve.name}: not of observer changes and a Gaussian change; only those say what a "
            "comparison finds"
        )
    d_primes = np.asarray(curve.dprime)
    never = np.full(len(d_primes), np.inf)
    limits = np.divide(np.asarray(curve.seen_dn), d_primes, out=never, where=d_primes > 0)
    return LimitCurve(
        zoom=tuple(curve.zoom),
        spot_sigma_px=tuple(curve.seen_sigma_px),
        dn_per_height=tuple(limits.tolist()),
        noise_dn=curve.noise_dn,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Frame:
    """Operators for a square frame of c in which a signal near the middle meets no border."""

    pair: ComparedPair
    side_px: int

    @classmethod
    def around(
        cls, signal: ChangeSignal, scenario: Scenario, model: Model, zoom: float
    ) -> "_Frame":
        total = scenario.reference_zoom * zoom
        reach_px = signal.reach_px + 8 * ceil(total)
        side = frame_size_px(
            scenario.psf, reach_px, scenario.window_px, zoom, scenario.reference_zoom
        )
        pair = compared_pair((side, side), scenario.psf, model, zoom, scenario.reference_zoom)
        return cls(pair=pair, side_px=side)

    def reference(self, signal: ChangeSignal) -> FloatArray:
        """The reference's pixels of a signal in the middle."""
        return self.pair.reference_of(signal.image(self.side_px, (0, 0)))

    def followup(self, signal: ChangeSignal, offset_px: tuple[int, int] = (0, 0)) -> FloatArray:
        """The follow-up's pixels of a signal, offset ``(y, x)`` from the middle."""
        scene = signal.image(self.side_px, offset_px)
        return np.asarray(self.pair.followup.apply(scene), dtype=np.float64)

    def spot(self, image: FloatArray, total_zoom: float) -> _SeenSpot:
        """The spot ``peak sigma^2 / (sigma^2 + w^2)`` high behind widths w, as an image's middle.

        ``total_zoom`` is that from c to the image.
        """
        grid = SamplingGrid.centred((self.side_px, self.side_px), total_zoom)
        at = (self.side_px // 2 - grid.rows_px) / total_zoom
        inverse = []
        for width_px in _PROBES_PX:
            line = np.exp(-(at**2) / (2 * width_px**2)) / (sqrt(2 * pi) * width_px)
            inverse.append(1 / float(line @ image @ line))
        # 1 / height is a straight line over w^2.
        (first, second), (narrow, wide) = inverse, _PROBES_PX
        slope = (second - first) / (wide**2 - narrow**2)
        start = first - slope * narrow**2
        return _SeenSpot(sigma_px=sqrt(max(start / slope, _LEAST_PX2)), peak=1 / start)


def _smoothed(image: FloatArray, width_px: float) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), width_px, borderType=cv2.BORDER_CONSTANT))
