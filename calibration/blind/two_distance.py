"""The PSF from two photographs of any textured scene at two distances, without an edge target.

Smooth corrections to the position and brightness of far pixels in a near photograph. A homography
leaves out the lens's distortion, and two photographs see the same point under different vignetting.
Both change slowly over the frame: a cubic displacement and a quartic gain are added to the
homography, found by Gauss-Newton from coarse to fine.

The camera blurs both photographs equally in its own pixels. In near pixels, the far PSF is the same
PSF stretched by A = d near / d far, so that the kernel between the photographs tells the lens: see
`_transfer`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Self

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from calibration.blind._cosine_blocks import before_rounding
from calibration.blind._lens_estimate import GaussianElements, LensEstimate, lens_of
from calibration.blind._lens_prior import lens_prior
from calibration.blind._resampled_pair import resampled
from calibration.blind._transfer import (
    DISPLACEMENT_DEGREE,
    GAIN_DEGREE,
    LensFit,
    PairModel,
    monomials,
)
from calibration.edges import JpegCompression
from calibration.errors import PairError
from simulation.arrays import BoolArray, FloatArray

_BLURS_PX = (6.0, 3.0, 1.5, 0.8, 0.8, 0.8)  # of the far image, level by level
_PSF_GUESS_PX = 0.7
_MARGIN_PX = 4.0
_LEAST_PIXELS = 2000
_CLIPPED_REACH_PX = 3.0
"""Distance from a clipped pixel, in far ones, that the blur of the finest level reaches."""

_FINE_PX = 1.5
"""Levels at which the correlation is looked at: the coarse ones leave little in small frames, the
finest more noise."""

_MOSTLY = 0.5

_SLOW_PX = 8.0
"""Width beyond which what both photographs show is taken for their light."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClippedPixels:
    """Pixels of the near and of the far photograph that are clipped, each of its own shape."""

    near: BoolArray
    far: BoolArray

    @classmethod
    def none(cls, near_shape: tuple[int, ...], far_shape: tuple[int, ...]) -> Self:
        """Nothing is clipped."""
        return cls(near=np.zeros(near_shape, dtype=bool), far=np.zeros(far_shape, dtype=bool))

    def away(self, y_px: FloatArray, x_px: FloatArray, reach_px: float, zoom: float) -> BoolArray:
        """Far pixels with no clipped one within reach in either photograph; near coordinates."""
        beside = _within(self.near, reach_px * zoom)
        rows, cols = (
            np.clip(np.rint(at), 0, most - 1).astype(np.intp)
            for at, most in zip((y_px, x_px), beside.shape, strict=True)
        )
        return np.asarray(~beside[rows, cols] & ~_within(self.far, reach_px))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothAlignment:
    """Near coordinates and gain of every far pixel, each in the shape of the far image.

    ``far(p) = gain(p) (blurred near)(y(p), x(p)) + offset``. ``jacobian``, shape (2, 2), is the
    mean of d(near x, near y) / d(far x, far y), ``correlation`` that of the aligned photographs.
    """

    y_px: FloatArray
    x_px: FloatArray
    gain: FloatArray
    jacobian: FloatArray
    correlation: float

    @property
    def zoom(self) -> float:
        """How many times as far away the far photograph is."""
        return sqrt(abs(float(np.linalg.det(self.jacobian))))


def align_smoothly(
    near_dn: FloatArray,
    far_dn: FloatArray,
    far_to_near: FloatArray,
    clipped: ClippedPixels | None = None,
) -> SmoothAlignment:
    """Refine a homography, right to a few px, by a smooth displacement and gain."""
    rows, cols = np.mgrid[: far_dn.shape[0], : far_dn.shape[1]].astype(np.float64)
    start_y, start_x = _projected(far_to_near, rows, cols)
    inside = _inside(start_y, start_x, near_dn.shape) & _inside(rows, cols, far_dn.shape)
    if np.count_nonzero(inside) < _LEAST_PIXELS:
        raise PairError(
            "the two photographs hardly overlap: photograph the same scene in both",
            reason="little_overlap",
        )
    clipped = clipped or ClippedPixels.none(near_dn.shape, far_dn.shape)
    u, v = _normalised(cols, inside), _normalised(rows, inside)
    moves, gains = monomials(u, v, DISPLACEMENT_DEGREE), monomials(u, v, GAIN_DEGREE)
    zoom = sqrt(abs(float(np.linalg.det(_mean_jacobian(start_y, start_x, inside)))))
    move_x, move_y = np.zeros(len(moves)), np.zeros(len(moves))
    gain = np.zeros(len(gains))
    correlation = 0.0
    for blur in _BLURS_PX:
        x = start_x + np.tensordot(move_x, moves, axes=1)
        y = start_y + np.tensordot(move_y, moves, axes=1)
        used = inside & _inside(y, x, near_dn.shape)
        used &= clipped.away(y, x, _CLIPPED_REACH_PX, zoom)
        _refuse_too_few(used)
        own_px = sqrt((zoom * blur) ** 2 + _PSF_GUESS_PX**2 * (zoom**2 - 1))
        smooth = gaussian_filter(near_dn, own_px)
        slope_y, slope_x = _slopes(smooth)
        points = np.stack([y[used], x[used]])
        seen = map_coordinates(smooth, points, order=1)
        seen_y = map_coordinates(slope_y, points, order=1)
        seen_x = map_coordinates(slope_x, points, order=1)
        blurred = gaussian_filter(far_dn, blur)
        target = blurred[used]
        shapes, lights = moves[:, used], gains[:, used]
        brightness = 1.0 if not gain.any() else gain @ lights
        design = np.vstack([
            brightness * seen_x * shapes,
            brightness * seen_y * shapes,
            seen * lights,
            np.ones_like(seen)[None],
        ])  # fmt: skip
        normal = design @ design.T
        solution: FloatArray = np.asarray(np.linalg.lstsq(normal, design @ target)[0], np.float64)
        count = len(moves)
        move_x, move_y = move_x + solution[:count], move_y + solution[count : 2 * count]
        gain = solution[2 * count : -1]
        residual = solution @ design - target
        if blur <= _FINE_PX:
            correlation = max(correlation, _correlation(blurred, residual, used))
    x = start_x + np.tensordot(move_x, moves, axes=1)
    y = start_y + np.tensordot(move_y, moves, axes=1)
    seen_by_both = inside & _inside(y, x, near_dn.shape)
    return SmoothAlignment(
        y_px=y,
        x_px=x,
        gain=np.tensordot(gain, gains, axes=1),
        jacobian=_mean_jacobian(y, x, seen_by_both),
        correlation=correlation,
    )


def _projected(
    far_to_near: FloatArray, y_px: FloatArray, x_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Near coordinates ``(y, x)`` of far ones."""
    x, y, scale = np.tensordot(far_to_near, np.stack([x_px, y_px, np.ones_like(x_px)]), axes=1)
    return y / scale, x / scale


def _refuse_too_few(used: BoolArray) -> None:
    if np.count_nonzero(used) < _LEAST_PIXELS:
        raise PairError(
            f"without clipped pixels and their neighbours, {np.count_nonzero(used)} pixels that "
            f"both photographs show are left, but {_LEAST_PIXELS} are needed; shorten the "
            "exposure",
            reason="saturated",
        )


def _correlation(seen: FloatArray, residual: FloatArray, used: BoolArray) -> float:
    """Correlation of what is seen with what was fitted to it, without what is slow."""
    fitted, target = np.zeros((2, *seen.shape))
    target[used] = seen[used]
    fitted[used] = seen[used] + residual
    share = np.maximum(gaussian_filter(used.astype(np.float64), _SLOW_PX), 1e-9)
    fitted, target = (
        (image - gaussian_filter(image, _SLOW_PX) / share)[used] for image in (fitted, target)
    )
    power = float(np.sqrt(np.sum(fitted**2) * np.sum(target**2)))
    return float(fitted @ target) / power if power > 0 else 0.0


def _within(mask: BoolArray, reach_px: float) -> BoolArray:
    """Pixels so near to one of the mask."""
    if not mask.any():
        return mask
    return np.asarray(distance_transform_edt(~mask) <= reach_px)


def _inside(y: FloatArray, x: FloatArray, shape: tuple[int, ...]) -> BoolArray:
    within_y = (y >= _MARGIN_PX) & (y <= shape[0] - 1 - _MARGIN_PX)
    return np.asarray(within_y & (x >= _MARGIN_PX) & (x <= shape[1] - 1 - _MARGIN_PX))


def _normalised(coordinate: FloatArray, inside: BoolArray) -> FloatArray:
    low, high = float(coordinate[inside].min()), float(coordinate[inside].max())
    return np.asarray(2 * (coordinate - low) / max(high - low, 1.0) - 1)


def _mean_jacobian(y: FloatArray, x: FloatArray, inside: BoolArray) -> FloatArray:
    (x_down, x_right), (y_down, y_right) = _slopes(x), _slopes(y)
    mean = [float(slope[inside].mean()) for slope in (x_right, x_down, y_right, y_down)]
    return np.array(mean).reshape(2, 2)


def _slopes(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    down, right = np.gradient(image)
    return np.asarray(down), np.asarray(right)


LEAST_ZOOM = 1.1
_LEAST_CORRELATION = 0.6
"""Of aligned photographs; scenes that do not match reach 0.47, as their shapes are bent to fit."""
_REACH_PX = 4.2  # of the kernel between both at zoom sqrt(2), near px; it grows with the blur
_SHARPEST_PX2 = 0.06  # the pixel alone has 1/12
_FEWEST_BLOCKS = 100
MOST_PIXELS = 150_000
_COARSE_PX = 8
_BESIDE_PX = 32.0  # near, beside the middle: more than the kernel reaches


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NearAndFar:
    """Two photographs of a scene; what is not known is None.

    ``near_noise_dn2`` is the noise of a near pixel, ``near_codes`` and ``far_codes`` say how the
    files were compressed.
    """

    near_dn: FloatArray
    far_dn: FloatArray
    clipped: ClippedPixels
    near_noise_dn2: float | None = None
    near_codes: JpegCompression | None = None
    far_codes: JpegCompression | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairPsf:
    """What two photographs tell of the lens of lens and pixel, and their zoom."""

    zoom: float
    fit: LensFit

    @property
    def gaussian(self) -> GaussianElements:
        """The Gaussian nearest to the lens that this pair tells alone."""
        return lens_of([self.fit]).nearest_gaussian()


def pair_psf(pair: NearAndFar, far_to_near: FloatArray) -> PairPsf:
    """Total PSF from a near and a far photograph, and a homography right to a few px.

    Of large photographs the middle of what both show is measured: `MOST_PIXELS` of the far one.
    """
    pair, far_to_near = _middle(pair, far_to_near)
    if pair.near_codes is not None:
        pair = replace(pair, near_dn=before_rounding(pair.near_dn, pair.near_codes))
    alignment = align_smoothly(pair.near_dn, pair.far_dn, far_to_near, pair.clipped)
    if alignment.correlation < _LEAST_CORRELATION:
        raise PairError(
            "the photographs do not match where they were expected to; their correlation is "
            f"{alignment.correlation:.2f}",
            reason="not_aligned",
        )
    if alignment.zoom < LEAST_ZOOM:
        raise PairError(
            f"the second photograph is {alignment.zoom:.3f} times as far away as the first; at "
            f"least {LEAST_ZOOM} is needed, and 2 is good",
            reason="one_distance",
        )
    first = _model(pair, alignment)
    gaussian = first.fitted(first.start(lens_prior().mean), is_gaussian=True)
    # The first fit's displacement is linear in the pixels, which blurs: they are resampled by it.
    second = _model(pair, _moved(alignment, first, gaussian))
    found = second.fitted(second.start(gaussian.lens))
    noise_dn2 = pair.near_noise_dn2
    if noise_dn2 is None:
        noise_dn2 = second.found_noise_dn2(found)
    fit = second.with_true_share(found, noise_dn2).fitted(found)
    told = PairPsf(zoom=alignment.zoom, fit=fit)
    (xx, xy, yy) = told.gaussian.px2
    if np.linalg.eigvalsh([[xx, xy], [xy, yy]])[0] < _SHARPEST_PX2:
        raise PairError(
            "the far photograph is not softer than the near one: was it taken in focus?",
            reason="sharp",
        )
    return told


def _middle(pair: NearAndFar, far_to_near: FloatArray) -> tuple[NearAndFar, FloatArray]:
    """The middle of what both show, where that is more than is needed, and its homography."""
    rows, cols = np.mgrid[: pair.far_dn.shape[0] : _COARSE_PX, : pair.far_dn.shape[1] : _COARSE_PX]
    rows, cols = rows.astype(np.float64), cols.astype(np.float64)
    both = _inside(*_projected(far_to_near, rows, cols), pair.near_dn.shape)
    shown = np.count_nonzero(both) * _COARSE_PX**2
    if shown <= MOST_PIXELS:
        return pair, far_to_near
    y, x = rows[both], cols[both]
    share = sqrt(MOST_PIXELS / shown)
    (bottom, top), (right, left) = (
        (int(mean + half), max(int(mean - half), 0))
        for mean, half in ((one.mean(), share * np.ptp(one) / 2) for one in (y, x))
    )
    corner_y, corner_x = np.meshgrid([top, bottom], [left, right], indexing="ij")
    near_y, near_x = _projected(far_to_near, corner_y.astype(float), corner_x.astype(float))
    near_top, near_left = (max(int(one.min() - _BESIDE_PX), 0) for one in (near_y, near_x))
    near_end = int(near_y.max() + _BESIDE_PX), int(near_x.max() + _BESIDE_PX)
    near = np.s_[near_top : near_end[0], near_left : near_end[1]]
    far = np.s_[top:bottom, left:right]
    cut = replace(
        pair,
        near_dn=pair.near_dn[near],
        far_dn=pair.far_dn[far],
        clipped=ClippedPixels(near=pair.clipped.near[near], far=pair.clipped.far[far]),
        near_codes=pair.near_codes and pair.near_codes.cropped(near_top, near_left),
        far_codes=pair.far_codes and pair.far_codes.cropped(top, left),
    )
    to_far = np.array([[1, 0, left], [0, 1, top], [0, 0, 1.0]])
    to_near = np.array([[1, 0, -near_left], [0, 1, -near_top], [0, 0, 1.0]])
    return cut, to_near @ far_to_near @ to_far


def _model(pair: NearAndFar, alignment: SmoothAlignment) -> PairModel:
    """The model of aligned photographs; their blocks are those of the far file."""
    codes = pair.far_codes
    first = (0, 0) if codes is None else (codes.first_row, codes.first_col)
    reach_px = _REACH_PX * max(1.0, sqrt(alignment.zoom**2 - 1))
    away = pair.clipped.away(alignment.y_px, alignment.x_px, 1.0, reach_px)
    model = PairModel(
        resampled(pair.near_dn, pair.far_dn, alignment, away, first),
        pair.near_noise_dn2 or 0.0,
        codes,
    )
    if model.blocks < _FEWEST_BLOCKS:
        is_clipped = float(np.mean(away)) < _MOSTLY
        raise PairError(
            f"only {model.blocks} blocks of 8 x 8 pixels of the far image are inside the near one"
            f"{' and away from clipped pixels' if is_clipped else ''}, but {_FEWEST_BLOCKS} are "
            f"needed: {'shorten the exposure' if is_clipped else 'use larger photographs'}",
            reason="saturated" if is_clipped else "little_overlap",
        )
    return model


def _moved(alignment: SmoothAlignment, model: PairModel, fit: LensFit) -> SmoothAlignment:
    """The alignment with the displacement that a fit has found."""
    pair, shape = model.pair, alignment.y_px.shape
    place = np.mgrid[: shape[0], : shape[1]] - np.array([pair.top, pair.left])[:, None, None]
    x, y = (
        map_coordinates(field, place, order=1, mode="nearest") for field in model.displacement(fit)
    )
    (xx, xy), (yx, yy) = pair.near_per_far
    return replace(
        alignment,
        x_px=alignment.x_px + xx * x + xy * y,
        y_px=alignment.y_px + yx * x + yy * y,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CombinedPairs:
    """The lens of all pairs, and the Gaussian nearest to it, whose errors hold the disagreement."""

    lens: LensEstimate
    gaussian: GaussianElements


def combined(pairs: Sequence[PairPsf]) -> CombinedPairs:
    """The lens that all pairs tell, with errors that hold how they disagree."""
    if not pairs:
        raise ValueError("there is no pair of photographs")
    lens = lens_of([pair.fit for pair in pairs])
    factor = disagreement([pair.gaussian for pair in pairs])
    lens = replace(lens, covariance=factor * lens.covariance)
    return CombinedPairs(lens=lens, gaussian=lens.nearest_gaussian())


def disagreement(found: Sequence[GaussianElements]) -> float:
    """Reduced chi-squared of covariances about their weighted mean, at least 1."""
    if len(found) < 2:
        return 1.0
    weights = [np.linalg.inv(one.covariance) for one in found]
    total = np.linalg.inv(np.sum(weights, axis=0))
    mean = total @ np.sum([w @ one.px2 for w, one in zip(weights, found, strict=True)], axis=0)
    chi2 = sum(
        float((one.px2 - mean) @ weight @ (one.px2 - mean))
        for weight, one in zip(weights, found, strict=True)
    )
    return max(1.0, chi2 / (3 * (len(found) - 1)))
