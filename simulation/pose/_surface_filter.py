"""The prefilter of a scene with depth, whose warp turns and stretches with every surface.

Over a plane the kernels change slowly from place to place, and are interpolated between the nodes
of a coarse lattice. Over surfaces they do not; but they change slowly with the derivative of the
warp. So kernels are computed for some of the derivatives that occur, expanded in separable terms,
and the terms' weights are fitted by polynomials of the derivative's four elements, and of the place
in the frame where the PSF depends on that.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.choices import PoseModel
from simulation.pose._prefilter import SAMPLING_KERNELS, LocalPose, prefilter
from simulation.pose._varying_filter import VaryingFilter, separable_terms
from simulation.pose._view_filter import ORDERS, kernel_radius, squares_series
from simulation.pose.depth import DepthView
from simulation.pose.view import without_sharpening
from simulation.psf import Psf, PsfField

_MOST_NODES = 512
"""Along an axis."""

_LEAST_PITCH_PX = 2
_DEGREE, _FIELD_DEGREE = 3, 2
_FOR_EACH = 3
"""Kernels for each coefficient of the polynomials."""

_TERMS_TOLERANCE = 7e-4
"""Error that the separable terms leave, over the image's standard deviation."""

_BEYOND = 1.25
_TINY = 1e-6
_DECIMALS = 6
"""Of the derivatives, so that rounding decides nothing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalPoses:
    """Derivatives of the warp at the nodes of a lattice over the reference.

    ``rows_px, cols_px``: the lattice. ``features``, shape ``(rows, cols, n)``: the derivative by
    which a follow-up is nowhere sharper than the reference, four elements, and with a PSF field the
    place in the reference's frame. ``missing_px2``: the least variance that the reference's blur
    lacks in a direction. ``sample``: nodes, by number, with a kernel each, of ``poses``.
    """

    rows_px: FloatArray
    cols_px: FloatArray
    features: FloatArray
    missing_px2: FloatArray
    sample: IntArray
    poses: tuple[LocalPose, ...]


def lattice(reference: tuple[int, int]) -> tuple[IntArray, IntArray]:
    """Rows and columns of the nodes, which are pixels."""
    pitch = max(-(-max(reference) // _MOST_NODES), _LEAST_PITCH_PX)
    rows, cols = (np.arange(0, size, pitch) for size in reference)
    return rows, cols


def local_poses(
    view: DepthView,
    psf: Psf | PsfField,
    places_px: FloatArray,
    slopes: FloatArray,
    is_seen: BoolArray,
) -> LocalPoses:
    """Poses at the nodes of the view's lattice, row by row.

    ``places_px``, shape (n, 2): where the follow-up sees the nodes; ``slopes``, shape (n, 2, 2):
    derivative of the way back, NaN where it does not. ``is_seen``, shape (n,): of the nodes that
    count.
    """
    rows, cols = lattice(view.reference)
    y, x = (one.ravel().astype(np.float64) for one in np.meshgrid(rows, cols, indexing="ij"))
    # Of a node at an unknown depth, any place will do: no pixel is seen there.
    places_px = np.where(np.isfinite(places_px), places_px, np.column_stack([x, y]))
    near, far = _covariances(psf, x, y), _covariances(psf, *places_px.T)
    known = np.asarray(np.isfinite(slopes).all(axis=(1, 2)))
    used = np.flatnonzero(known & is_seen)
    if len(used) == 0:
        raise ValueError("the follow-up shows nothing of the reference")
    largest = np.linalg.norm(slopes[used], 2, axis=(1, 2)).max()
    slopes = np.where(known[:, np.newaxis, np.newaxis], slopes, np.median(slopes[used], axis=0))
    excess = np.linalg.norm(slopes, 2, axis=(1, 2)) / (_BEYOND * largest)
    slopes = slopes / np.maximum(excess, 1.0)[:, None, None]
    missing = slopes @ far @ slopes.swapaxes(1, 2) - near
    kept = np.round(without_sharpening(slopes, near, far), _DECIMALS)
    features = kept.reshape(-1, 4)
    if isinstance(psf, PsfField):
        features = np.column_stack([features, x, y])
    degree = _FIELD_DEGREE if isinstance(psf, PsfField) else _DEGREE
    count = _FOR_EACH * _polynomials(features[:1], degree).shape[1]
    sample = used[_spread(features[used], count)]
    shape = len(rows), len(cols)
    return LocalPoses(
        rows_px=rows.astype(np.float64),
        cols_px=cols.astype(np.float64),
        features=features.reshape(*shape, -1),
        missing_px2=np.asarray(np.linalg.eigvalsh(missing)[:, 0].reshape(shape), np.float64),
        sample=sample,
        poses=tuple(_pose(psf, (x[k], y[k]), places_px[k], kept[k]) for k in sample.tolist()),
    )


def _covariances(psf: Psf | PsfField, x: FloatArray, y: FloatArray) -> FloatArray:
    if isinstance(psf, PsfField):
        inside_x, inside_y = np.clip(x, 0, psf.width_px - 1), np.clip(y, 0, psf.height_px - 1)
        return psf.covariance_px2(inside_x, inside_y)
    return np.broadcast_to(psf.covariance_px2, (len(x), 2, 2))


def _pose(
    psf: Psf | PsfField, near_px: tuple[float, float], far_px: FloatArray, kept: FloatArray
) -> LocalPose:
    def at(x: float, y: float) -> Psf:
        if not isinstance(psf, PsfField):
            return psf
        return psf.at(min(max(x, 0), psf.width_px - 1), min(max(y, 0), psf.height_px - 1))

    a, b, c, d = kept.ravel().tolist()
    far_x, far_y = far_px.tolist()
    return LocalPose(near=at(*near_px), far=at(far_x, far_y), slopes=(a, b, c, d))


def _spread(features: FloatArray, count: int) -> IntArray:
    """Number of so many features: half of them the farthest apart, half of them at random."""
    if len(features) <= count:
        return np.arange(len(features))
    scaled = features / np.maximum(np.ptp(features, axis=0), _TINY)
    apart = np.full(len(scaled), np.inf)
    chosen = [int(np.argmax(np.linalg.norm(scaled - scaled.mean(axis=0), axis=1)))]
    for _ in range(count // 2):
        apart = np.minimum(apart, ((scaled - scaled[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(apart)))
    random = np.random.default_rng(0).choice(len(features), count - len(chosen), replace=False)
    return np.union1d(chosen, random)


def _polynomials(scaled: FloatArray, degree: int) -> FloatArray:
    """Monomials of features ``(n, k)``, shape (n, terms)."""
    terms = [np.ones(len(scaled))]
    for power in range(1, degree + 1):
        every = combinations_with_replacement(range(scaled.shape[1]), power)
        terms += [np.prod(scaled[:, factors], axis=1) for factors in every]
    return np.stack(terms, axis=1)


def _fitted(local: LocalPoses, values: FloatArray) -> FloatArray:
    """Values at the nodes, shape ``(m, rows, cols)``, from those of the sample, ``(n, m)``."""
    features = local.features.reshape(-1, local.features.shape[-1])
    known = features[local.sample]
    low, high = known.min(axis=0), known.max(axis=0)
    half = np.maximum((high - low) / 2, _TINY)
    degree = _DEGREE if features.shape[1] == 4 else _FIELD_DEGREE

    def terms(of: FloatArray) -> FloatArray:
        return _polynomials((np.clip(of, low, high) - (low + high) / 2) / half, degree)

    coefficients = np.linalg.lstsq(terms(known), values, rcond=1e-9)[0]
    made = np.stack([terms(row) @ coefficients for row in local.features])
    return np.asarray(np.moveaxis(made, 2, 0))


def surface_filter(local: LocalPoses, model: PoseModel, noise_ratio: float) -> VaryingFilter:
    """Prefilter over surfaces, with model and noise as for ``prefilter``."""
    kernels = _kernels(local, model, noise_ratio)
    columns, rows, weights = separable_terms(kernels, _TERMS_TOLERANCE)
    return VaryingFilter(
        along_y=columns,
        along_x=rows,
        weights=_fitted(local, weights),
        rows_px=local.rows_px,
        cols_px=local.cols_px,
    )


def _kernels(local: LocalPoses, model: PoseModel, noise_ratio: float) -> FloatArray:
    radius = kernel_radius(local.poses, model, noise_ratio)
    return np.stack([prefilter(one, model, noise_ratio, radius).kernel for one in local.poses])


def surface_noise_gain(
    local: LocalPoses, model: PoseModel, noise_ratio: float, places_px: FloatArray
) -> FloatArray:
    """Variance at reference positions ``(y, x)``, shape (2, ...), if each pixel's there is 1."""
    sampling = SAMPLING_KERNELS[model]
    kernels = _kernels(local, model, noise_ratio)
    series = _fitted(local, np.stack([squares_series(one, sampling) for one in kernels]))
    y, x = places_px
    at = nodes_at((local.rows_px, local.cols_px), y, x)
    waves = [np.cos(2 * np.pi * (m * x + n * y)) for m, n in ORDERS[1:]]
    return np.asarray(
        series[0][at] + 2 * sum(one[at] * wave for one, wave in zip(series[1:], waves, strict=True))
    )


def nodes_at(
    axes: tuple[IntArray | FloatArray, IntArray | FloatArray], y: FloatArray, x: FloatArray
) -> tuple[IntArray, IntArray]:
    """Row and column of the lattice's node nearest to each reference position; NaN: the first."""
    found = []
    for at, axis in zip((y, x), axes, strict=True):
        pitch = float(axis[1] - axis[0]) if len(axis) > 1 else 1.0
        nearest = np.rint(np.nan_to_num(at) / pitch).astype(np.int64)
        found.append(np.clip(nearest, 0, len(axis) - 1))
    return found[0], found[1]
